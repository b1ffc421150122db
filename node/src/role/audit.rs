//! Measures a picture after it was drawn: is it the one that no culling would have given, how many of
//! the drawn hlods can be seen in it, and how far does what stands in for others stray?

use super::render_visible_geometry::{Drawn, Layer};
use super::{RoleError, Stage};
use protocol::camera::Camera;
use protocol::settings::Residency as Promise;
use protocol::telemetry::Audit;
use scene::backend::{Completion, NO_ITEM, Pass, Picture};
use scene::stand_in::{Seen, seen_error};
use std::collections::BTreeSet;

/// What was asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Measured {
    /// Against the picture without culling.
    pub(crate) audit: Option<Audit>,
    /// Hlods with at least one pixel.
    pub(crate) hlods_with_pixels: Option<u32>,
    /// Pixels by which what stands in for others strays at most.
    pub(crate) stand_in_error_px: f64,
}

/// Measures `drawn`, which must have its depth if it is to be `audited`. None where nothing is asked for and
/// nothing stands in: then nothing is done.
pub(crate) fn measure(
    stage: &mut Stage<'_>,
    camera: &Camera,
    drawn: &Drawn,
    audited: bool,
    counted: bool,
) -> Result<Option<Measured>, RoleError> {
    if !audited && !counted && drawn.layers.iter().all(|layer| layer.replaced.is_empty()) {
        return Ok(None);
    }
    let audit = audited.then(|| against_unculled(stage, camera, drawn)).transpose()?;
    let (mut seen, mut stand_in_error_px) = (BTreeSet::new(), 0.0);
    for layer in &drawn.layers {
        let is_whole = layer.replaced.is_empty();
        let items = if counted || !is_whole { items_of(stage, camera, layer)? } else { None };
        match &items {
            Some(items) => seen.extend(items.hlods()),
            // A mesh cannot be read any more: the next picture shows something else.
            None if counted => seen.extend(layer.shown.iter().map(|entry| entry.hlod.0)),
            None => {}
        }
        if !is_whole {
            stand_in_error_px = stray(stage, camera, layer, items)?.max(stand_in_error_px);
        }
    }
    let hlods_with_pixels = counted.then_some(seen.len() as u32);
    Ok(Some(Measured { audit, hlods_with_pixels, stand_in_error_px }))
}

/// Draws everything of the front that is in the frustum, on the same device, and compares each of the pictures that
/// are mixed.
fn against_unculled(
    stage: &mut Stage<'_>,
    camera: &Camera,
    drawn: &Drawn,
) -> Result<Audit, RoleError> {
    let front = stage.front(camera);
    let shading = stage.shading();
    let pass = |view, draws, part| Pass::Shade { view, shading, draws, with_depth: true, part };
    let mut differing = 0;
    for (of, layer) in stage.cells().compositions(camera.eye).iter().zip(&drawn.layers) {
        let (completion, ..) = stage.draw(of, camera, &front.entries, Promise::Exact, pass)?;
        let Completion::Picture { picture: whole, .. } = completion else {
            unreachable!("a picture answers as such")
        };
        differing += differing_pixels(&layer.picture, &whole);
    }
    Ok(Audit { differing_pixels: differing })
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

/// Which hlods a picture shows.
struct Items {
    /// By pixel, the nearest.
    nearest: Vec<u32>,
    /// Those that blend over some pixel.
    blended: Vec<u32>,
}

impl Items {
    fn hlods(&self) -> impl Iterator<Item = u32> {
        self.nearest.iter().chain(&self.blended).copied().filter(|&item| item != NO_ITEM)
    }
}

/// None where a mesh cannot be read any more.
fn items_of(
    stage: &mut Stage<'_>,
    camera: &Camera,
    drawn: &Layer,
) -> Result<Option<Items>, RoleError> {
    let pass = |view, draws, part| Pass::Items { view, draws, part };
    Ok(stage.draw_list(camera, &drawn.draws, pass)?.map(|completion| {
        let Completion::Items { items, blended, .. } = completion else {
            unreachable!("items answer as such")
        };
        Items { nearest: items, blended }
    }))
}

/// How far what stands in strays, pixels. Where a mesh cannot be read any more all of it counts as if it
/// were at the nearest point of its box.
fn stray(
    stage: &mut Stage<'_>,
    camera: &Camera,
    drawn: &Layer,
    items: Option<Items>,
) -> Result<f64, RoleError> {
    let shading = stage.shading();
    let pass = |view, draws, part| Pass::Shade { view, shading, draws, with_depth: true, part };
    let depth = match stage.draw_list(camera, &drawn.draws, pass)? {
        Some(Completion::Picture { picture, .. }) => picture.depth,
        _ => None,
    };
    let all = || drawn.replaced.iter().map(|(_, by)| by.hlod.0).collect();
    let (items, depth) = match (items, depth) {
        (Some(items), Some(depth)) => (items, depth),
        _ => (Items { nearest: Vec::new(), blended: all() }, Vec::new()),
    };
    let seen = Seen { items: &items.nearest, depth: &depth, blended: &items.blended };
    Ok(seen_error(&stage.skeleton, &drawn.replaced, camera, stage.settings.size, &seen))
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
