//! RVG(i): the picture of frame i, V_i drawn under C_i (paper 004, section 4.3). Where view cells meet it is a mix
//! of as many pictures (paper 000, section 5.4.2).

use super::{RoleError, Stage};
use protocol::camera::Camera;
use protocol::id::HlodId;
use protocol::telemetry::DrawCounts;
use protocol::visible::VisibleSet;
use scene::backend::{Completion, Draws, Pass, Picture};
use scene::front::{Front, FrontEntry};
use scene::view_cells::WHOLE;
use std::collections::BTreeSet;

/// A frame that was drawn.
pub(crate) struct Drawn {
    /// What was drawn; hash and what is measured are yet to be filled in.
    pub(crate) counts: DrawCounts,
    /// What it is made of, as [`scene::view_cells::Cells::compositions`] names them.
    pub(crate) layers: Vec<Layer>,
    /// Their pictures mixed, where there are several.
    mix: Option<Vec<u8>>,
}

impl Drawn {
    /// The picture's RGBA bytes.
    pub(crate) fn into_rgba(mut self) -> Vec<u8> {
        self.mix.unwrap_or_else(|| self.layers.remove(0).picture.rgba)
    }
}

/// The picture of one composition.
pub(crate) struct Layer {
    /// Its part of [`WHOLE`].
    weight: u32,
    /// The picture.
    pub(crate) picture: Picture,
    /// The draws it is made of.
    pub(crate) draws: Draws,
    /// What was shown: entries of the front, or what stood in for them.
    pub(crate) shown: Vec<FrontEntry>,
    /// Hlods that should be seen, and what stands for each instead.
    pub(crate) replaced: Vec<(HlodId, FrontEntry)>,
    /// Hlods that should be seen and are not drawn at their level: the replaced ones, and holes.
    pub(crate) lacking: Vec<HlodId>,
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
    let mut counts = DrawCounts::default();
    let mut layers = Vec::new();
    for of in stage.cells().compositions(camera.eye) {
        let (completion, shown, draws) = stage.draw(&of, camera, &entries, promise, pass)?;
        let Completion::Picture { picture, .. } = completion else {
            unreachable!("a picture answers as such")
        };
        let far_triangles = stage.far_triangles(&draws);
        counts.far_triangles += far_triangles;
        counts.triangles += stage.triangles(&shown.entries) + far_triangles;
        counts.missing.holes += shown.holes;
        let is_lacking =
            |entry: &&FrontEntry| of.has(entry.hlod) && !is_among(&shown.entries, entry);
        let lacking = entries.iter().filter(is_lacking).map(|entry| entry.hlod).collect();
        let (shown, replaced) = (shown.entries, shown.replaced);
        layers.push(Layer { weight: of.weight, picture, draws, shown, replaced, lacking });
    }
    counts.hlods = distinct(&layers, |layer| layer.shown.iter().map(|entry| entry.hlod));
    counts.missing.replaced = distinct(&layers, |layer| layer.replaced.iter().map(|(id, _)| *id));
    let mix = (layers.len() > 1).then(|| mixed(&layers));
    Ok(Drawn { counts, layers, mix })
}

/// Whether `entries`, sorted by hlod, have this one at its level.
pub(crate) fn is_among(entries: &[FrontEntry], entry: &FrontEntry) -> bool {
    let found = entries.binary_search_by_key(&entry.hlod, |other| other.hlod);
    found.is_ok_and(|at| entries[at] == *entry)
}

/// How many hlods there are in all of the layers.
fn distinct<'a, I: ExactSizeIterator<Item = HlodId>>(
    layers: &'a [Layer],
    of: impl Fn(&'a Layer) -> I,
) -> u32 {
    match layers {
        [only] => of(only).len() as u32,
        _ => layers.iter().flat_map(of).collect::<BTreeSet<_>>().len() as u32,
    }
}

/// Every channel by the layers' weights, rounded. What all show alike stays as it is.
fn mixed(layers: &[Layer]) -> Vec<u8> {
    let mut sums: Vec<u32> = Vec::new();
    for Layer { weight, picture, .. } in layers {
        sums.resize(picture.rgba.len(), WHOLE / 2);
        sums.iter_mut().zip(&picture.rgba).for_each(|(sum, &c)| *sum += weight * u32::from(c));
    }
    sums.into_iter().map(|sum| (sum / WHOLE) as u8).collect()
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
    fn a_mix_is_rounded_by_weight_and_keeps_what_all_show() {
        let layer = |weight, rgba: &[u8]| Layer {
            weight,
            picture: Picture { rgba: rgba.to_vec(), depth: None },
            draws: Draws::default(),
            shown: vec![],
            replaced: vec![],
            lacking: vec![],
        };
        let [a, b] = [[0, 255, 7, 255], [10, 255, 8, 0]];
        for (weight, expected) in [
            (WHOLE / 2, [5, 255, 8, 128]),
            (WHOLE / 4, [8, 255, 8, 64]),
            (1, [10, 255, 8, 0]),
            (WHOLE - 1, [0, 255, 7, 255]),
        ] {
            assert_eq!(mixed(&[layer(weight, &a), layer(WHOLE - weight, &b)]), expected);
        }
        let third = WHOLE / 3;
        let three = [layer(third, &[9]), layer(third, &[9]), layer(WHOLE - 2 * third, &[9])];
        assert_eq!(mixed(&three), [9]);
    }

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
