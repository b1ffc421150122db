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
    // What hides must be drawn in every picture that is mixed into the one.
    let cells = stage.cells();
    let mixed = cells.compositions(camera.eye);
    wanted.retain(|entry| mixed.iter().all(|of| of.has(entry.hlod)));
    let promise = stage.settings.residency;
    if promise == Promise::Deadline {
        let skeleton = &stage.skeleton;
        let blobs = wanted.iter().flat_map(|entry| skeleton.blobs_of(entry.level));
        stage.loader.order_missing(blobs.collect::<Vec<_>>(), Needs::Shape);
    }
    // What is not there is left out: less is culled, and never too much.
    loop {
        let offered =
            |entry: &&FrontEntry| stage.loader.offers_level(entry.level, promise, Needs::Shape);
        let entries: Vec<FrontEntry> = wanted.iter().filter(offered).copied().collect();
        let draws = draw_list(&stage.skeleton, &entries, camera.eye);
        let pass = |view, draws: Draws, part| Pass::Occluders {
            view,
            draws: draws.solid,
            adds: false,
            part,
        };
        let Some(completion) =
            stage.draw_list(camera, &Draws { blending: vec![], ..draws }, Needs::Shape, pass)?
        else {
            continue;
        };
        assert!(matches!(completion, Completion::Occluders { .. }), "occluders answer as such");
        let replaced = (wanted.len() - entries.len()) as u32;
        stage.occluders = entries.iter().map(|entry| entry.hlod).collect();
        return Ok(DrawCounts {
            hlods: entries.len() as u32,
            triangles: stage.triangles(&entries),
            missing: Missing { replaced, ..Missing::default() },
            ..DrawCounts::default()
        });
    }
}
