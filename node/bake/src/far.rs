//! Far fields for a scene that is baked: samples, cubes, and the file with both (paper 000).
//!
//! The scene file is read through its store and written anew beside it, geometry and textures as they
//! are, cubes behind the geometry. The bytes depend on the scene, the settings and the renderer that takes the
//! samples, never on the number of threads.

mod cell;
mod file;
mod kept;
mod summary;

use crate::bytes::Torn;
use crate::progress::Progress;
use crate::work::{Work, WorkError};
use cell::far_field;
use farfield::capture::{CaptureError, Studio};
pub use farfield::cells::CELL_TRIANGLES as DEFAULT_CELL_TRIANGLES;
use farfield::cells::{Division, cells_along};
use file::FarFile;
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::{Method, WriteError};
use protocol::message::FailureKind;
use scene::backend::{Backend, BackendError};
use scene::store::{OpenError, Store, StoreError};
use std::path::{Path, PathBuf};
pub use summary::{CellSummary, FarSummary};

/// Counts up whenever the same settings would give other bytes, or kept cells would be read in another way.
const FAR_VERSION: u32 = 2;

/// What is made.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Tdm or Itdm.
    pub method: Method,
    /// Pictures that will be taken: their viewpoints are to lie in cells with far fields.
    pub views: Vec<Camera>,
    /// Distance of the near plane of samples, scene units.
    pub near: f32,
    /// How the scene is divided into cells.
    pub division: Division,
    /// Cells hold viewpoints at all heights, not only at that of the views.
    pub in_space: bool,
    /// Pixels along a side of a face.
    pub side: u32,
    /// Likewise while viewpoints for samples are looked for.
    pub search_side: u32,
    /// Void surface that may be seen from anywhere, steradians.
    pub epsilon_sr: f64,
    /// Most samples of a cell.
    pub samples: usize,
    /// Error of meshes, pixels of a face.
    pub tolerance_px: f64,
    /// Cubes are kept where geometry is cheaper, too.
    pub always: bool,
    /// Every cube is whole: what the removal of redundant points is measured against.
    pub all_intra: bool,
    /// Cubes hold normals, so that they can be drawn under another sun.
    pub relight: bool,
}

impl Settings {
    /// The paper's: 512x512 faces, 0.2 steradians, half a pixel.
    pub fn new(method: Method, views: Vec<Camera>, near: f32) -> Self {
        Self {
            method,
            views,
            near,
            division: Division::default(),
            in_space: false,
            side: 512,
            search_side: 128,
            epsilon_sr: 0.2,
            samples: 16,
            tolerance_px: 0.5,
            always: false,
            all_intra: false,
            relight: false,
        }
    }

    /// Digest of a scene made with these from one with the key `of`.
    fn key(&self, of: [u8; 32]) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        hasher
            .update(&of)
            .update(&FAR_VERSION.to_le_bytes())
            .update(format!("{self:?}").as_bytes());
        hasher.finalize().into()
    }
}

/// Why there is no far field.
#[derive(Debug, thiserror::Error)]
pub enum FarError {
    /// The scene cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// No viewpoint lies in the scene.
    #[error("{}: none of the viewpoints lies inside the scene's box; give a path through it", .0.display())]
    Nowhere(PathBuf),
    /// No samples can be taken.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// Something of the scene is damaged.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The working folder cannot be used.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// The file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

impl FarError {
    /// The class, which decides the exit code.
    pub fn kind(&self) -> FailureKind {
        match self {
            Self::Open(error) => scene::store::failure_kind(error),
            Self::Nowhere(_) => FailureKind::BadData,
            Self::Capture(CaptureError::NoRoom(_) | CaptureError::Textures) => FailureKind::Config,
            Self::Capture(CaptureError::Backend(_)) => FailureKind::Unavailable,
            Self::Capture(CaptureError::Store(error)) | Self::Store(error) => error.kind(),
            Self::Work(_) | Self::Write(_) => FailureKind::Io,
        }
    }
}

/// Makes renderers for square pictures.
pub type MakeBackend<'a> = dyn FnMut(u32) -> Result<Box<dyn Backend>, BackendError> + 'a;

/// Adds far fields to the scene at `input`, in place of any it has, and writes `output`. Cells that are finished are kept
/// in a folder beside it until all are, so that a bake that was cut short goes on.
pub fn add_far(
    input: &Path,
    output: &Path,
    settings: &Settings,
    make_backend: &mut MakeBackend<'_>,
    progress: &dyn Progress,
) -> Result<FarSummary, FarError> {
    let store = Store::open(input)?;
    let work = Work::open_far(output)?;
    let done = written(&store, output, settings, &work, make_backend, progress);
    match &done {
        Ok(_) => work.remove()?,
        // Better told than that traces cannot be removed.
        Err(_) if !work.path(&name_of(0)).exists() => drop(work.remove()),
        Err(_) => work.forget(SCENE),
    }
    done
}

/// The scene file in the working folder.
const SCENE: &str = "scene";

/// The file of a finished cell there.
fn name_of(cell: u32) -> String {
    format!("cell-{cell}")
}

/// Makes the cells that are not kept, then the file with all of them.
fn written(
    store: &Store,
    output: &Path,
    settings: &Settings,
    work: &Work,
    make_backend: &mut MakeBackend<'_>,
    progress: &dyn Progress,
) -> Result<FarSummary, FarError> {
    let skeleton = store.skeleton();
    let viewpoints: Vec<DVec3> = settings.views.iter().map(|view| view.eye.into()).collect();
    let cells = cells_along(skeleton, &viewpoints, &settings.division);
    if cells.is_empty() {
        return Err(FarError::Nowhere(store.path().to_owned()));
    }
    let mut renderer = String::new();
    let mut studio = |side: u32| -> Result<Studio<'_>, FarError> {
        let backend = make_backend(side).map_err(CaptureError::from)?;
        renderer = format!("{:?}", backend.info());
        Ok(Studio::new(store, backend, side, settings.near)?)
    };
    let mut search = studio(settings.search_side)?;
    let fine = studio(settings.side)?;
    let mut fine = if settings.relight { fine.with_normals() } else { fine };
    let key = settings.key(skeleton.info.key);
    let key_of = keys_of_cells(&key, &renderer);
    let kept = |number| {
        let bytes = work.load(&name_of(number), &key_of(number))?;
        kept::decode(&bytes).ok()
    };
    progress.stage("cells", cells.len() as u64);
    for (cell, number) in cells.iter().zip(0..) {
        if kept(number).is_none() {
            let made = far_field(cell, settings, skeleton, &mut search, &mut fine)?;
            work.save(&name_of(number), &key_of(number), &kept::encode(&made))?;
        }
        progress.advance(1);
    }
    progress.finish();
    let mut file = FarFile::begin(store, &work.path(SCENE), output)?;
    let mut summary = FarSummary::default();
    for number in 0..cells.len() as u32 {
        let made =
            kept(number).ok_or_else(|| WorkError::io(&work.path(&name_of(number)), Torn.into()))?;
        summary.cells.push(file.add(made, settings)?);
    }
    summary.file_bytes = file.finish(key)?;
    Ok(summary)
}

/// Digests of all that a cell's cubes depend on, by its number.
fn keys_of_cells(scene: &[u8; 32], renderer: &str) -> impl Fn(u32) -> [u8; 32] {
    let mut all = blake3::Hasher::new();
    all.update(scene).update(renderer.as_bytes());
    move |number| all.clone().update(&number.to_le_bytes()).finalize().into()
}
