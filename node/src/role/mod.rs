//! What a seat does in a phase: functions of the scene, a backend, a camera and sets.

pub(crate) mod audit;
pub(crate) mod hardware_cull;
pub(crate) mod occlusion_representation;
pub(crate) mod render_visible_geometry;

#[cfg(test)]
mod tests;

use crate::open::Distance;
use crate::resident::{Drawn, Loader, Needs};
use protocol::camera::Camera;
use protocol::format::Skeleton;
use protocol::id::{FrameIndex, HlodId};
use protocol::settings::{Residency as Promise, RunSettings};
use protocol::telemetry::{BackendInfo, IoCounts};
use protocol::visible::VisibleSet;
use scene::backend::{Backend, BackendError, Completion, Draw, Draws, Part, Pass, Shading, View};
use scene::draw_list::draw_list;
use scene::front::{Front, FrontEntry, front_of, whole_cut};
use scene::occludee::Rules;
use scene::stand_in::{Available, available};
use scene::view_cells::{Cells, Composition};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Why a role cannot do its work.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RoleError {
    /// The renderer gave up.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// The room that is set apart for them is not to be had.
    #[error("the textures find no room in the memory that --memory allows; raise it")]
    Textures,
    /// What is held for good leaves no stretch of memory long enough for a mesh.
    #[error("a mesh finds no room beside what is held for good; raise --memory")]
    NoRoom,
    /// The I/O thread broke down.
    #[error("the I/O thread broke down; see its message above")]
    IoThread,
    /// V_i names what this node's own front does not have.
    #[error(
        "hlod {0} of the visible set is not on this node's front: do all nodes run one version?"
    )]
    ForeignHlod(HlodId),
}

/// What a seat knows of the frames to come as a phase begins.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Coming {
    /// The newest camera, if the phase brings one.
    pub(crate) newest: Option<(FrameIndex, Camera)>,
    /// The camera that this phase's work is about.
    pub(crate) front: Option<Camera>,
    /// Frames whose geometry this seat draws from this phase on, the first few.
    pub(crate) draws: Vec<FrameIndex>,
}

/// What roles work on: one scene, one backend, and what is remembered between phases.
pub(crate) struct Stage<'a> {
    skeleton: Arc<Skeleton>,
    backend: Box<dyn Backend>,
    loader: Loader,
    far: Distance,
    settings: &'a RunSettings,
    rules: Rules,
    /// The last front made. A seat culls a frame right after it made the frame's depth, so one is enough.
    front: Option<(Camera, Arc<Front>)>,
    /// Whose depth there is, of the last front made, sorted.
    occluders: Vec<HlodId>,
    /// Hlods whose boxes passed when their triangles last did not.
    hidden: BTreeSet<HlodId>,
    /// Frames culled here.
    turn: u32,
    /// Of passes that test, not looked at yet.
    completions: Vec<Completion>,
}

impl<'a> Stage<'a> {
    /// A stage on which nothing is drawn yet.
    pub(crate) fn new(
        skeleton: Arc<Skeleton>,
        backend: Box<dyn Backend>,
        loader: Loader,
        far: Distance,
        settings: &'a RunSettings,
    ) -> Self {
        Self {
            skeleton,
            backend,
            loader,
            far,
            settings,
            rules: Rules::default(),
            front: None,
            occluders: Vec::new(),
            hidden: BTreeSet::new(),
            turn: 0,
            completions: Vec::new(),
        }
    }

    /// The renderer.
    pub(crate) fn backend_info(&self) -> BackendInfo {
        self.backend.info()
    }

    /// Prepares a phase, before what it waits for has come.
    pub(crate) fn prepare(&mut self, coming: Coming) {
        self.loader.look_ahead(coming.newest, coming.draws);
        if let Some(camera) = coming.front {
            self.front(&camera);
        }
    }

    /// The front of `camera`: in view cells with far fields, of their near fields alone.
    fn front(&mut self, camera: &Camera) -> Arc<Front> {
        match &self.front {
            Some((of, front)) if of == camera => Arc::clone(front),
            _ => {
                let RunSettings { size, lod_px, .. } = *self.settings;
                let field = self.far.cells.field_at(camera.eye);
                let made = Arc::new(front_of(&self.skeleton, camera, size, lod_px, &field));
                self.front = Some((*camera, Arc::clone(&made)));
                made
            }
        }
    }

    /// The cells that have a far field in this run.
    fn cells(&self) -> Arc<Cells> {
        Arc::clone(&self.far.cells)
    }

    fn view(&self, camera: &Camera) -> View {
        View::new(camera, self.settings.size)
    }

    fn shading(&self) -> Shading {
        Shading::Lit { sun: self.settings.sun.unit() }
    }

    /// The whole cut at a camera, in the frustum or not, made anew.
    fn whole_cut(&self, camera: &Camera) -> Vec<FrontEntry> {
        let RunSettings { size, lod_px, .. } = *self.settings;
        let field = self.far.cells.field_at(camera.eye);
        whole_cut(&self.skeleton, camera, size, lod_px, &field)
    }

    /// What `promise` lets be drawn of `entries` now.
    fn available(&self, entries: &[FrontEntry], promise: Promise) -> Available {
        available(&self.skeleton, entries, |level| {
            self.loader.offers_level(level, promise, Needs::Look)
        })
    }

    /// What is drawn of the far field of a composition, behind all else in the list.
    fn far_draws(&self, of: &Composition<'_>, camera: &Camera) -> Vec<Draw> {
        match (&self.far.field, of.cell) {
            (Some(field), Some((cell, _))) => field.draws(cell, camera, self.settings.size),
            _ => Vec::new(),
        }
    }

    /// Draws those of `entries` that a composition has and its far field, or what stands in for them, and waits for what
    /// comes of it. `pass` makes a pass of a part of the list.
    fn draw(
        &mut self,
        of: &Composition<'_>,
        camera: &Camera,
        entries: &[FrontEntry],
        promise: Promise,
        pass: impl Fn(View, Draws, Part) -> Pass,
    ) -> Result<(Completion, Available, Draws), RoleError> {
        let entries: Vec<FrontEntry> =
            entries.iter().filter(|entry| of.has(entry.hlod)).copied().collect();
        if promise == Promise::Deadline {
            let blobs = entries.iter().flat_map(|entry| self.skeleton.blobs_of(entry.level));
            let far = self.far_draws(of, camera).into_iter().map(|draw| draw.blob);
            self.loader.order_missing(blobs.chain(far).collect::<Vec<_>>(), Needs::Look);
        }
        loop {
            let mut shown = self.available(&entries, promise);
            let (draws, missing) = self.list(of, camera, &shown.entries, promise);
            // Nothing stands in for a cube.
            shown.holes += missing;
            if let Some(completion) = self.draw_list(camera, &draws, Needs::Look, &pass)? {
                return Ok((completion, shown, draws));
            }
        }
    }

    /// The draws of `entries`, which can be drawn, and of those of a composition's cubes that can; and how
    /// many cubes cannot.
    fn list(
        &self,
        of: &Composition<'_>,
        camera: &Camera,
        entries: &[FrontEntry],
        promise: Promise,
    ) -> (Draws, u32) {
        let mut draws = draw_list(&self.skeleton, entries, camera.eye);
        let mut far = self.far_draws(of, camera);
        let wanted = far.len();
        far.retain(|draw| self.loader.offers(draw.blob, promise, Needs::Look));
        let missing = (wanted - far.len()) as u32;
        draws.solid.extend(far);
        (draws, missing)
    }

    /// Draws a list; none where a mesh or a texture turned out to be unreadable.
    fn draw_list(
        &mut self,
        camera: &Camera,
        draws: &Draws,
        what: Needs,
        pass: impl Fn(View, Draws, Part) -> Pass,
    ) -> Result<Option<Completion>, RoleError> {
        let view = self.view(camera);
        let submit = |backend: &mut dyn Backend, draws, part| {
            backend.submit(pass(view, draws, part))?;
            Ok(())
        };
        let drawn = self.loader.stream(self.backend.as_mut(), draws, what, submit)?;
        Ok(Some(self.completion()?).filter(|_| drawn == Drawn::Whole))
    }

    /// Draws a list all of which is there: nothing is read for it, and nothing counts as used.
    fn draw_held(
        &mut self,
        camera: &Camera,
        draws: Draws,
        pass: impl Fn(View, Draws, Part) -> Pass,
    ) -> Result<Completion, RoleError> {
        self.backend.submit(pass(self.view(camera), draws, Part::WHOLE))?;
        self.completion()
    }

    /// Waits for the answer to the one pass that was submitted.
    fn completion(&mut self) -> Result<Completion, RoleError> {
        let mut completions = Vec::new();
        while completions.is_empty() {
            self.backend.poll(&mut completions)?;
        }
        assert_eq!(completions.len(), 1, "one pass, one answer");
        Ok(completions.remove(0))
    }

    /// Triangles of `entries` at their levels.
    fn triangles(&self, entries: &[FrontEntry]) -> u64 {
        let levels = &self.skeleton.levels;
        entries.iter().map(|entry| u64::from(levels[entry.level as usize].triangles)).sum()
    }

    /// Triangles of cubes in a list.
    fn far_triangles(&self, draws: &Draws) -> u64 {
        let blobs = draws.solid.iter().map(|draw| self.skeleton.blob(draw.blob));
        blobs.filter(|blob| blob.is_projected()).map(|blob| u64::from(blob.triangles)).sum()
    }

    /// Begins the work of a phase that draws.
    fn begin_drawing(&mut self) -> Result<(), RoleError> {
        self.loader.begin_drawing(self.backend.as_mut())
    }

    /// Learns what is visible in a frame, as the phase's work is done.
    pub(crate) fn note_visible(&mut self, frame: FrameIndex, visible: &Arc<VisibleSet>) {
        self.loader.note_visible(frame, visible);
    }

    /// The next job; geometry that was read ahead is taken in meanwhile. None once there are no more.
    pub(crate) fn next_job<J>(
        &mut self,
        jobs: &crossbeam_channel::Receiver<J>,
    ) -> Result<Option<J>, RoleError> {
        self.loader.take_in_until(self.backend.as_mut(), jobs)
    }

    /// Hlods of the scene.
    pub(crate) fn hlods(&self) -> u32 {
        self.skeleton.hlods.len() as u32
    }

    /// Loading since the last call.
    pub(crate) fn take_io(&mut self) -> IoCounts {
        self.loader.take_counts()
    }
}

/// First 8 bytes, little-endian, of the BLAKE3 of a picture's RGBA bytes.
pub(crate) fn picture_hash(rgba: &[u8]) -> u64 {
    let hash = blake3::hash(rgba);
    let first: [u8; 8] = std::array::from_fn(|k| hash.as_bytes()[k]);
    u64::from_le_bytes(first)
}
