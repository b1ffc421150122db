//! What a seat does in a phase: functions of the scene, a backend, a camera and sets.

pub(crate) mod audit;
pub(crate) mod hardware_cull;
pub(crate) mod occlusion_representation;
pub(crate) mod render_visible_geometry;

#[cfg(test)]
mod tests;

use crate::resident::Residency;
use protocol::camera::Camera;
use protocol::id::HlodId;
use protocol::settings::RunSettings;
use protocol::telemetry::IoCounts;
use scene::backend::{Backend, BackendError, Completion, Draws, Pass, View};
use scene::draw_list::draw_list;
use scene::front::{Front, FrontEntry, front};
use scene::occludee::Rules;
use scene::store::{Store, StoreError};
use std::sync::Arc;

/// Why a role cannot do its work.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RoleError {
    /// The renderer gave up.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// Geometry cannot be read.
    #[error(transparent)]
    Geometry(#[from] StoreError),
    /// V_i names what this node's own front does not have.
    #[error(
        "hlod {0} of the visible set is not on this node's front: do all nodes run one version?"
    )]
    ForeignHlod(HlodId),
}

/// What roles work on: one scene, one backend, and what is remembered between phases.
pub(crate) struct Stage<'a> {
    store: &'a Store,
    backend: Box<dyn Backend>,
    residency: Residency,
    settings: &'a RunSettings,
    rules: Rules,
    /// The last front made. A seat culls a frame right after it made the frame's depth, so one is enough.
    front: Option<(Camera, Arc<Front>)>,
}

impl<'a> Stage<'a> {
    /// A stage on which nothing is loaded.
    pub(crate) fn new(
        store: &'a Store,
        backend: Box<dyn Backend>,
        residency: Residency,
        settings: &'a RunSettings,
    ) -> Self {
        Self { store, backend, residency, settings, rules: Rules::default(), front: None }
    }

    /// Makes the front of `camera` unless it is the last one made.
    pub(crate) fn foresee(&mut self, camera: &Camera) {
        self.front(camera);
    }

    /// The front of `camera`.
    fn front(&mut self, camera: &Camera) -> Arc<Front> {
        match &self.front {
            Some((of, front)) if of == camera => Arc::clone(front),
            _ => {
                let RunSettings { size, lod_px, .. } = *self.settings;
                let made = Arc::new(front(self.store.skeleton(), camera, size, lod_px));
                self.front = Some((*camera, Arc::clone(&made)));
                made
            }
        }
    }

    fn view(&self, camera: &Camera) -> View {
        View::new(camera, self.settings.size)
    }

    /// Draws for `entries`, their geometry with the backend.
    fn draws(&mut self, camera: &Camera, entries: &[FrontEntry]) -> Result<Draws, RoleError> {
        let draws = draw_list(self.store.skeleton(), entries, camera.eye);
        self.residency.ensure(self.store, self.backend.as_mut(), &draws)?;
        Ok(draws)
    }

    /// Triangles of `entries` at their levels.
    fn triangles(&self, entries: &[FrontEntry]) -> u64 {
        let levels = &self.store.skeleton().levels;
        entries.iter().map(|entry| u64::from(levels[entry.level as usize].triangles)).sum()
    }

    /// Runs a pass that is answered at once, with nothing else under way.
    fn complete(&mut self, pass: Pass) -> Result<Completion, RoleError> {
        self.backend.submit(pass)?;
        let mut completions = Vec::new();
        while completions.is_empty() {
            self.backend.poll(&mut completions)?;
        }
        assert_eq!(completions.len(), 1, "one pass, one answer");
        Ok(completions.remove(0))
    }

    /// Demand loading since the last call.
    pub(crate) fn take_io(&mut self) -> IoCounts {
        self.residency.take_counts()
    }
}

/// First 8 bytes, little-endian, of the BLAKE3 of a picture's RGBA bytes.
pub(crate) fn picture_hash(rgba: &[u8]) -> u64 {
    let hash = blake3::hash(rgba);
    let first: [u8; 8] = std::array::from_fn(|k| hash.as_bytes()[k]);
    u64::from_le_bytes(first)
}
