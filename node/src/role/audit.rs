//! Measures a picture after it was drawn: is it the one that no culling would have given, how many of
//! the drawn hlods can be seen in it, and how far does what stands in for others stray?
//!
//! # What an audit compares where something is missing
//!
//! The picture without culling has the same stand-ins, and of the rest what may be drawn: in `deadline`
//! what is there, so that nothing is read for the audit's sake and the next frames are the same with and
//! without it. Let a culled hlod X show at a pixel of it. OR drew its occluders at their own levels, and
//! so one of them, O, was before X there; it is visible by its own box. If O was drawn here, too, X does
//! not show. If it was not, the pixel is one of those that can show O's box. They are not compared: an audit
//! counts them as unknown. What differs elsewhere is a fault of the culling.

use super::render_visible_geometry::{Drawn, Layer, is_among};
use super::{RoleError, Stage};
use crate::resident::Needs;
use protocol::camera::Camera;
use protocol::id::HlodId;
use protocol::settings::{AuditAgainst, Residency as Promise};
use protocol::telemetry::Audit;
use scene::backend::{Completion, NO_ITEM, Pass, Picture};
use scene::cut_check::faults;
use scene::front::{FrontEntry, box_from_eye};
use scene::stand_in::{Seen, seen_error, unculled};
use scene::view::pixels_of;
use scene::view_cells::Composition;
use std::collections::BTreeSet;

/// What was asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Measured {
    /// Against the picture without culling.
    pub(crate) audit: Option<Audit>,
    /// Hlods with at least one pixel.
    pub(crate) hlods_with_pixels: Option<u32>,
    /// Hlods on the front, in the frustum or not.
    pub(crate) front: Option<u32>,
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
    let front = counted.then(|| stage.whole_cut(camera).len() as u32);
    Ok(Some(Measured { audit, hlods_with_pixels, front, stand_in_error_px }))
}

/// Draws what no culling would leave out on the same device, and compares each of the pictures that are
/// mixed.
fn against_unculled(
    stage: &mut Stage<'_>,
    camera: &Camera,
    drawn: &Drawn,
) -> Result<Audit, RoleError> {
    let front = stage.front(camera);
    let mut audit = Audit::default();
    let whole = match stage.settings.audit_against {
        AuditAgainst::Front => front.entries.clone(),
        AuditAgainst::Scene => {
            let cut = stage.whole_cut(camera);
            audit.front_faults = front_faults(stage, camera, &front.entries, &cut);
            cut
        }
    };
    for (of, layer) in stage.cells().compositions(camera.eye).iter().zip(&drawn.layers) {
        let entries: Vec<FrontEntry> =
            whole.iter().filter(|entry| of.has(entry.hlod)).copied().collect();
        let unculled = unculled_picture(stage, of, camera, &entries, layer)?;
        let unknown = unknown_pixels(stage, camera, &layer.lacking);
        audit.differing_pixels += differing_pixels(&layer.picture, &unculled, &unknown);
        audit.unknown_pixels += unknown.iter().filter(|&&unknown| unknown).count() as u64;
    }
    Ok(audit)
}

/// Hlods that the whole cut does not have as it should, or that the front has otherwise than the cut.
fn front_faults(
    stage: &Stage<'_>,
    camera: &Camera,
    front: &[FrontEntry],
    cut: &[FrontEntry],
) -> u32 {
    let field = stage.far.cells.field_at(camera.eye);
    let (size, lod_px) = (stage.settings.size, stage.settings.lod_px);
    let mut wrong: BTreeSet<HlodId> =
        faults(&stage.skeleton, camera, size, lod_px, &field, cut).into_iter().collect();
    wrong.extend(front.iter().filter(|entry| !is_among(cut, entry)).map(|entry| entry.hlod));
    wrong.len() as u32
}

/// The picture of `whole` beside what stands in for others in a layer.
fn unculled_picture(
    stage: &mut Stage<'_>,
    of: &Composition<'_>,
    camera: &Camera,
    whole: &[FrontEntry],
    layer: &Layer,
) -> Result<Picture, RoleError> {
    let (shading, promise) = (stage.shading(), stage.settings.residency);
    let pass = |view, draws, part| Pass::Shade { view, shading, draws, with_depth: true, part };
    loop {
        let is_there = |level| stage.loader.offers_level(level, promise, Needs::Look);
        let entries = unculled(&stage.skeleton, whole, &layer.replaced, is_there);
        let (draws, _) = stage.list(of, camera, &entries, promise);
        let completion = match promise {
            // None where a mesh cannot be read any more: it is left out then.
            Promise::Exact => stage.draw_list(camera, &draws, Needs::Look, pass)?,
            Promise::Deadline => Some(stage.draw_held(camera, draws, pass)?),
        };
        match completion {
            Some(Completion::Picture { picture, .. }) => return Ok(picture),
            Some(_) => unreachable!("a picture answers as such"),
            None => {}
        }
    }
}

/// By pixel, whether it can show something of what is lacking.
fn unknown_pixels(stage: &Stage<'_>, camera: &Camera, lacking: &[HlodId]) -> Vec<bool> {
    let size = stage.settings.size;
    let mut unknown = vec![false; size.width as usize * size.height as usize];
    for &hlod in lacking {
        let bounds = box_from_eye(stage.skeleton.hlod(hlod), camera.eye);
        let [columns, rows] = pixels_of(&bounds, camera, size);
        for row in rows {
            let first = (row * size.width) as usize;
            unknown[first + columns.start as usize..first + columns.end as usize].fill(true);
        }
    }
    unknown
}

/// Pixels whose colour or depth bits differ, but for the `unknown` ones.
fn differing_pixels(a: &Picture, b: &Picture, unknown: &[bool]) -> u64 {
    let (Some(depth_a), Some(depth_b)) = (&a.depth, &b.depth) else {
        panic!("an audit compares depth")
    };
    assert_eq!((depth_a.len(), depth_b.len()), (unknown.len(), unknown.len()), "one size");
    assert_eq!((a.rgba.len(), b.rgba.len()), (4 * depth_a.len(), 4 * depth_b.len()));
    let colours = a.rgba.chunks_exact(4).zip(b.rgba.chunks_exact(4));
    let depths = depth_a.iter().zip(depth_b);
    let differs =
        colours.zip(depths).zip(unknown).filter(|(((a, b), (depth_a, depth_b)), unknown)| {
            !**unknown && (a != b || depth_a.to_bits() != depth_b.to_bits())
        });
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
    Ok(stage.draw_list(camera, &drawn.draws, Needs::Look, pass)?.map(|completion| {
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
    let depth = match stage.draw_list(camera, &drawn.draws, Needs::Look, pass)? {
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
        let known = [false; 2];
        assert_eq!(differing_pixels(&a, &a, &known), 0);
        let colour = picture(&[0, 0, 0, 0, 0, 0, 1, 0], &[0.5, 0.25]);
        assert_eq!(differing_pixels(&a, &colour, &known), 1);
        assert_eq!(differing_pixels(&a, &colour, &[true, false]), 1);
        assert_eq!(differing_pixels(&a, &colour, &[false, true]), 0);
        let depth = picture(&[0; 8], &[0.5, 0.25f32.next_up()]);
        assert_eq!(differing_pixels(&a, &depth, &known), 1);
        assert_eq!(differing_pixels(&a, &picture(&[1; 8], &[0.0, 0.0]), &known), 2);
        let [plus, minus] = [0.0, -0.0].map(|depth| picture(&[0; 4], &[depth]));
        assert_eq!(differing_pixels(&plus, &minus, &[false]), 1);
    }

    #[test]
    #[should_panic(expected = "an audit compares depth")]
    fn a_picture_without_depth_cannot_be_audited() {
        let bare = Picture { rgba: vec![], depth: None };
        differing_pixels(&bare, &bare, &[]);
    }
}
