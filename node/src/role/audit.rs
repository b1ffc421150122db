//! Measures a picture after it was drawn: is it the one that no culling would have given, and how
//! many of the drawn hlods can be seen in it?

use super::render_visible_geometry::Drawn;
use super::{RoleError, Stage};
use protocol::camera::Camera;
use protocol::telemetry::Audit;
use scene::backend::{Completion, NO_ITEM, Part, Pass, Picture};

/// What was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Measured {
    /// Against the picture without culling.
    pub(crate) audit: Option<Audit>,
    /// Hlods with at least one pixel.
    pub(crate) hlods_with_pixels: Option<u32>,
}

/// Measures `drawn`, which must have its depth if it is to be `audited`.
pub(crate) fn measure(
    stage: &mut Stage<'_>,
    camera: &Camera,
    drawn: &Drawn,
    audited: bool,
    counted: bool,
) -> Result<Measured, RoleError> {
    let audit = audited.then(|| against_unculled(stage, camera, &drawn.picture)).transpose()?;
    let hlods_with_pixels = counted.then(|| count_items(stage, camera, drawn)).transpose()?;
    Ok(Measured { audit, hlods_with_pixels })
}

/// Draws everything of the front that is in the frustum, on the same device, and compares.
fn against_unculled(
    stage: &mut Stage<'_>,
    camera: &Camera,
    culled: &Picture,
) -> Result<Audit, RoleError> {
    let front = stage.front(camera);
    let draws = stage.draws(camera, &front.entries)?;
    let view = stage.view(camera);
    let pass = Pass::Shade { view, draws, with_depth: true, part: Part::WHOLE };
    let Completion::Picture { picture: whole, .. } = stage.complete(pass)? else {
        unreachable!("a picture answers as such")
    };
    Ok(Audit { differing_pixels: differing_pixels(culled, &whole) })
}

/// Pixels whose colour or depth bits differ.
fn differing_pixels(a: &Picture, b: &Picture) -> u64 {
    let (Some(depth_a), Some(depth_b)) = (&a.depth, &b.depth) else {
        panic!("an audit compares depth")
    };
    assert_eq!(depth_a.len(), depth_b.len(), "pictures of one size");
    assert_eq!((a.rgba.len(), b.rgba.len()), (4 * depth_a.len(), 4 * depth_b.len()));
    let colours = a.rgba.chunks_exact(4).zip(b.rgba.chunks_exact(4));
    let depths = depth_a.iter().zip(depth_b);
    let differs = colours
        .zip(depths)
        .filter(|((a, b), (depth_a, depth_b))| a != b || depth_a.to_bits() != depth_b.to_bits());
    differs.count() as u64
}

fn count_items(stage: &mut Stage<'_>, camera: &Camera, drawn: &Drawn) -> Result<u32, RoleError> {
    let view = stage.view(camera);
    let pass = Pass::Items { view, draws: drawn.draws.clone(), part: Part::WHOLE };
    let Completion::Items { mut items, blended, .. } = stage.complete(pass)? else {
        unreachable!("items answer as such")
    };
    items.extend(blended);
    items.retain(|&item| item != NO_ITEM);
    items.sort_unstable();
    items.dedup();
    Ok(items.len() as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(rgba: &[u8], depth: &[f32]) -> Picture {
        Picture { rgba: rgba.to_vec(), depth: Some(depth.to_vec()) }
    }

    #[test]
    fn a_bit_of_colour_or_depth_is_a_difference() {
        let a = picture(&[0; 8], &[0.5, 0.25]);
        assert_eq!(differing_pixels(&a, &a), 0);
        assert_eq!(differing_pixels(&a, &picture(&[0, 0, 0, 0, 0, 0, 1, 0], &[0.5, 0.25])), 1);
        assert_eq!(differing_pixels(&a, &picture(&[0; 8], &[0.5, 0.25f32.next_up()])), 1);
        assert_eq!(differing_pixels(&a, &picture(&[1; 8], &[0.0, 0.0])), 2);
        assert_eq!(differing_pixels(&picture(&[0; 4], &[0.0]), &picture(&[0; 4], &[-0.0])), 1);
    }

    #[test]
    #[should_panic(expected = "an audit compares depth")]
    fn a_picture_without_depth_cannot_be_audited() {
        let bare = Picture { rgba: vec![], depth: None };
        differing_pixels(&bare, &bare);
    }
}
