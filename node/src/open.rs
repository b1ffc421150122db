//! Opens a scene on a node: file, renderer, memory, I/O thread.

use crate::NodeError;
use crate::budget::{self, TooSmall};
use crate::choose::choose_backend;
use crate::io_thread::IoThread;
use crate::resident::Loader;
use crate::role::{RoleError, Stage};
use farfield::field::FarField;
use farfield::select::Budget;
use protocol::format::Skeleton;
use protocol::id::BlobId;
use protocol::message::FailureKind;
use protocol::path_text;
use protocol::settings::{Far, Residency as Promise, RunSettings};
use protocol::sun::Sun;
use scene::backend::{Backend, Shading, Upload, light, warm_up};
use scene::front::FrontEntry;
use scene::prefetch::Forecaster;
use scene::stand_in::coarsest_cut;
use scene::store::Store;
use scene::view_cells::Cells;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

/// An opened scene: what its file claims to be, and the stage.
pub(crate) struct Scene<'a> {
    pub(crate) digest: [u8; 32],
    pub(crate) stage: Stage<'a>,
}

/// Opens what `settings` name. `peak` follows the most bytes held.
pub(crate) fn open<'a>(
    settings: &'a RunSettings,
    peak: &Arc<AtomicU64>,
) -> Result<Scene<'a>, NodeError> {
    open_on(settings, peak, |budget| Ok(choose_backend(settings.backend, settings.size, budget)?))
}

/// The same on a backend that is made with a budget.
pub(crate) fn open_on<'a>(
    settings: &'a RunSettings,
    peak: &Arc<AtomicU64>,
    backend: impl FnOnce(u64) -> Result<Box<dyn Backend>, NodeError>,
) -> Result<Scene<'a>, NodeError> {
    let store = Arc::new(Store::open(&path_text::from_text(&settings.scene_path))?);
    let skeleton = Arc::clone(store.skeleton());
    let always = always(&skeleton, settings.residency);
    let memory = settings.memory.unwrap_or_else(budget::by_itself);
    let drawable = drawable(&skeleton, settings.far);
    let budget = budget::share_out(memory, &skeleton, &drawable, &always)?;
    check_sun(settings.sun, &skeleton, settings.far)?;
    let far = Distance::open(&skeleton, settings);
    let mut backend = backend(budget.device)?;
    let room = backend.declare_textures(&skeleton.textures, budget.textures);
    if room.map_err(RoleError::from)? == Upload::Full {
        return Err(RoleError::Textures.into());
    }
    let RunSettings { size, lod_px, prefetch, sun, cull, .. } = *settings;
    let blobs = drawable.iter().map(|&blob| skeleton.blob(blob));
    let shading = Shading::Lit { sun: sun.unit() };
    warm_up(backend.as_mut(), blobs, size, shading, cull).map_err(RoleError::from)?;
    let cells = Arc::clone(&far.cells);
    let forecaster = Forecaster::new(Arc::clone(&skeleton), cells, size, lod_px);
    let digest = store.digest();
    let cubes = far.field.clone();
    let buffers = [budget.host, budget.reserve];
    let io = IoThread::start(store, Arc::clone(&skeleton), forecaster, cubes, buffers).map_err(
        |error| {
            let reason = format!("cannot start the I/O thread: {error}");
            NodeError::new(FailureKind::Unavailable, reason)
        },
    )?;
    let known = Arc::clone(&skeleton);
    let mut loader = Loader::new(known, io, budget, prefetch, Arc::clone(peak));
    loader.load_for_good(backend.as_mut(), &always)?;
    Ok(Scene { digest, stage: Stage::new(skeleton, backend, loader, far, settings) })
}

/// What a run draws of what is far: which cells have another way than geometry, and that way.
pub(crate) struct Distance {
    pub(crate) cells: Arc<Cells>,
    pub(crate) field: Option<Arc<dyn FarField>>,
}

impl Distance {
    fn open(skeleton: &Arc<Skeleton>, settings: &RunSettings) -> Self {
        let Some(method) = method(settings.far) else {
            return Self { cells: Arc::default(), field: None };
        };
        let cells = Arc::new(Cells::new(skeleton, method.number() as u32));
        let budget = Budget { cubes: settings.far_cubes, triangles: settings.far_triangles };
        let field = method.open(Arc::clone(skeleton), Arc::clone(&cells), budget);
        Self { cells, field: Some(field) }
    }
}

/// The way that a run asked for, none for geometry alone.
fn method(far: Far) -> Option<&'static dyn farfield::method::Method> {
    let tag = match far {
        Far::Off => return None,
        Far::Tdm => "tdm",
        Far::Itdm => "itdm",
    };
    farfield::method::METHODS.into_iter().find(|method| method.tag() == tag)
}

/// Blobs that a run may draw: all meshes, and the cubes of the far fields it was asked for.
fn drawable(skeleton: &Skeleton, far: Far) -> Vec<BlobId> {
    let wanted = method(far).map(|method| method.number() as u32);
    let cells = skeleton.view_cells.iter().filter(|cell| Some(cell.method) == wanted);
    let cubes = cells.flat_map(|cell| skeleton.cubes_of(cell)).flat_map(|cube| cube.blobs());
    let meshes = (0..).zip(&skeleton.blobs).filter(|(_, blob)| !blob.is_projected());
    let mut all: Vec<BlobId> = meshes.map(|(id, _)| id).chain(cubes).map(BlobId).collect();
    all.sort_unstable();
    all
}

/// Whether `memory` bytes a node suffice for a scene.
pub fn check_memory(
    memory: Option<u64>,
    skeleton: &Skeleton,
    promise: Promise,
    far: Far,
) -> Result<(), TooSmall> {
    let memory = memory.unwrap_or_else(budget::by_itself);
    let drawable = drawable(skeleton, far);
    budget::share_out(memory, skeleton, &drawable, &always(skeleton, promise)).map(drop)
}

/// The far fields of a scene hold the light of another sun, and no normals to be lit again by (exit code 78).
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the far fields of this scene hold the light of the default sun and no normals: leave out --sun, draw all \
     as geometry with --far off, or bake them again with `bake --far-relight`"
)]
pub struct OtherSun;

/// Whether what is drawn of what is far can have the light of `sun`.
pub fn check_sun(sun: Sun, skeleton: &Skeleton, far: Far) -> Result<(), OtherSun> {
    let keeps_its_light = |blob: BlobId| {
        let blob = skeleton.blob(blob);
        blob.is_projected() && !blob.has_normals()
    };
    let is_moved = sun.unit() != light::baked_sun();
    if is_moved && drawable(skeleton, far).into_iter().any(keeps_its_light) {
        return Err(OtherSun);
    }
    Ok(())
}

/// What stays from the start: in `deadline` something must always be there to stand in.
fn always(skeleton: &Skeleton, promise: Promise) -> Vec<FrontEntry> {
    match promise {
        Promise::Exact => Vec::new(),
        Promise::Deadline => coarsest_cut(skeleton),
    }
}
