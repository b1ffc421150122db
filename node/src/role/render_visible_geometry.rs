//! RVG(i): the picture of frame i, V_i drawn under C_i (paper 004, section 4.3).

use super::{RoleError, Stage};
use protocol::camera::Camera;
use protocol::id::HlodId;
use protocol::telemetry::{DrawCounts, Missing};
use protocol::visible::VisibleSet;
use scene::backend::Draws;
use scene::backend::{Completion, Pass, Picture};
use scene::front::{Front, FrontEntry};

/// A frame that was drawn.
pub(crate) struct Drawn {
    /// What was drawn; hash and what is measured are yet to be filled in.
    pub(crate) counts: DrawCounts,
    /// The picture.
    pub(crate) picture: Picture,
    /// The draws it is made of.
    pub(crate) draws: Draws,
    /// Hlods that should be seen, and what stands for each instead.
    pub(crate) replaced: Vec<(HlodId, FrontEntry)>,
}

/// Draws V_i at the levels of this camera's own front, or what stands in for what is not there.
pub(crate) fn run(
    stage: &mut Stage<'_>,
    camera: &Camera,
    visible: &VisibleSet,
    with_depth: bool,
) -> Result<Drawn, RoleError> {
    stage.begin_drawing()?;
    let front = stage.front(camera);
    let entries = entries_of(&front, visible.ids())?;
    let shading = stage.shading();
    let pass = |view, draws, part| Pass::Shade { view, shading, draws, with_depth, part };
    let promise = stage.settings.residency;
    let (completion, shown, draws) = stage.draw(camera, &entries, promise, pass)?;
    let Completion::Picture { picture, .. } = completion else {
        unreachable!("a picture answers as such")
    };
    let far_triangles = stage.far_triangles(&draws);
    let replaced = shown.replaced.len() as u32;
    let counts = DrawCounts {
        hlods: shown.entries.len() as u32,
        triangles: stage.triangles(&shown.entries) + far_triangles,
        far_triangles,
        missing: Missing { replaced, holes: shown.holes, error_px: 0.0 },
        ..DrawCounts::default()
    };
    Ok(Drawn { counts, picture, draws, replaced: shown.replaced })
}

/// The entries of `front` for `visible`, both sorted by id.
fn entries_of(front: &Front, visible: &[HlodId]) -> Result<Vec<FrontEntry>, RoleError> {
    let mut rest = front.entries.iter();
    visible
        .iter()
        .map(|&id| {
            let entry = rest.find(|entry| entry.hlod >= id).filter(|entry| entry.hlod == id);
            entry.copied().ok_or(RoleError::ForeignHlod(id))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn visible_hlods_are_found_on_the_front_or_reported() {
        let entry = |id, level| FrontEntry { hlod: HlodId(id), level };
        let entries = vec![entry(1, 4), entry(3, 2), entry(7, 0)];
        let front = Front { entries, ..Front::default() };
        let find =
            |ids: &[u32]| entries_of(&front, &ids.iter().copied().map(HlodId).collect::<Vec<_>>());
        assert_eq!(find(&[]).unwrap(), []);
        assert_eq!(find(&[1, 7]).unwrap(), [entry(1, 4), entry(7, 0)]);
        assert!(matches!(find(&[1, 2]), Err(RoleError::ForeignHlod(HlodId(2)))));
        assert!(matches!(find(&[8]), Err(RoleError::ForeignHlod(HlodId(8)))));
    }
}
