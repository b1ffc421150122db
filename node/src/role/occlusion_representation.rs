//! OR(i): the depth of V_{i-1}, mapped onto the front of C_i, under C_i (paper 004, section 4.3).
//!
//! The depth stays with the backend, where HC(i) tests against it in the next phase.

use super::{RoleError, Stage};
use protocol::camera::Camera;
use protocol::settings::Cull;
use protocol::telemetry::DrawCounts;
use protocol::visible::VisibleSet;
use scene::backend::{Completion, Part, Pass};
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
    let front = stage.front(camera);
    let entries = map_onto_front(stage.store.skeleton(), previous, &front);
    let draws = stage.draws(camera, &entries)?.solid;
    let view = stage.view(camera);
    let pass = Pass::Occluders { view, draws, part: Part::WHOLE };
    let completion = stage.complete(pass)?;
    assert!(matches!(completion, Completion::Occluders { .. }), "occluders answer as such");
    Ok(DrawCounts {
        hlods: entries.len() as u32,
        triangles: stage.triangles(&entries),
        ..DrawCounts::default()
    })
}
