//! OR(i): the depth of V_{i-1}, mapped onto the front of C_i, under C_i (paper 004, section 4.3).
//!
//! The depth stays with the backend, where HC(i) tests against it in the next phase.

use super::{RoleError, Stage};
use crate::resident::Needs;
use protocol::camera::Camera;
use protocol::settings::{Cull, Residency as Promise};
use protocol::telemetry::DrawCounts;
use protocol::telemetry::Missing;
use protocol::visible::VisibleSet;
use scene::backend::Draws;
use scene::backend::{Completion, Pass};
use scene::draw_list::draw_list;
use scene::front::FrontEntry;
use scene::occluders::map_onto_front;

/// Renders the occluders' depth and waits until it is made. Without culling nobody asks for it.
pub(crate) fn run(
    stage: &mut Stage<'_>,
    camera: &Camera,
    previous: &VisibleSet,
) -> Result<DrawCounts, RoleError> {
    if stage.settings.cull == Cull::Off {
        return Ok(DrawCounts::default());
    }
    stage.begin_drawing()?;
    let front = stage.front(camera);
    let mut wanted = map_onto_front(&stage.skeleton, previous, &front);
    retain_what_hides(stage, camera, &mut wanted);
    let promise = stage.settings.residency;
    if promise == Promise::Deadline {
        let skeleton = &stage.skeleton;
        let blobs = wanted.iter().flat_map(|entry| skeleton.blobs_of(entry.level));
        stage.loader.order_missing(blobs.collect::<Vec<_>>(), Needs::Shape);
    }
    let asked = wanted.len();
    let entries = draw_depth(stage, camera, wanted, false)?;
    stage.occluders = entries.iter().map(|entry| entry.hlod).collect();
    Ok(DrawCounts {
        hlods: entries.len() as u32,
        triangles: stage.triangles(&entries),
        missing: Missing { replaced: (asked - entries.len()) as u32, ..Missing::default() },
        ..DrawCounts::default()
    })
}

/// Leaves what may hide: it must be drawn in every picture that is mixed into the one.
pub(super) fn retain_what_hides(stage: &Stage<'_>, camera: &Camera, entries: &mut Vec<FrontEntry>) {
    let cells = stage.cells();
    let mixed = cells.compositions(camera.eye);
    entries.retain(|entry| mixed.iter().all(|of| of.has(entry.hlod)));
}

/// Draws `wanted` as occluders, to the depth there is or to an empty one, and returns what was drawn: what is not
/// there is left out, so that less is culled, and never too much.
pub(super) fn draw_depth(
    stage: &mut Stage<'_>,
    camera: &Camera,
    mut wanted: Vec<FrontEntry>,
    adds: bool,
) -> Result<Vec<FrontEntry>, RoleError> {
    let promise = stage.settings.residency;
    let pass = |view, draws: Draws, part| Pass::Occluders { view, draws: draws.solid, adds, part };
    loop {
        wanted.retain(|entry| stage.loader.offers_level(entry.level, promise, Needs::Shape));
        let draws = draw_list(&stage.skeleton, &wanted, camera.eye);
        let draws = Draws { blending: vec![], ..draws };
        // None where a mesh turned out to be unreadable: it is drawn anew without.
        if let Some(completion) = stage.draw_list(camera, &draws, Needs::Shape, pass)? {
            assert!(matches!(completion, Completion::Occluders { .. }), "occluders answer as such");
            return Ok(wanted);
        }
    }
}
