//! Far fields for a scene that is baked: samples, cubes, and the file with both (paper 000).
//!
//! The scene file is read through its store and written anew beside it, geometry and textures as they
//! are, cubes behind the geometry. The bytes depend on the scene, the settings and the renderer that takes the
//! samples, never on the number of threads.

use crate::progress::Progress;
use farfield::capture::{CaptureError, OfCell, Studio};
pub use farfield::cells::CELL_TRIANGLES as DEFAULT_CELL_TRIANGLES;
use farfield::cells::{Cell, Division, MARGIN, cells_along, up_axis};
use farfield::cube::{BakedCube, BakedFace, Viewpoints};
use farfield::patches::BakedPatch;
use farfield::placement;
use farfield::sample::Sample;
use farfield::worth::Views;
use farfield::{itdm, tdm};
use glam::DVec3;
use protocol::camera::{Camera, near_plane};
use protocol::format::projected::{NewPatch, SUBPIXELS, TILE};
use protocol::format::{
    Cube, Method, NONE, SceneWriter, Skeleton, Tables, Vertex, ViewCell, WriteError,
};
use protocol::message::FailureKind;
use protocol::settings::FAR_CUBES;
use scene::backend::{Backend, BackendError};
use scene::near_field::with_margin;
use scene::store::{OpenError, Store, StoreError};
use serde::Serialize;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What is made.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Tdm or Itdm.
    pub method: Method,
    /// Pictures that will be taken: their viewpoints are to lie in cells with far fields.
    pub views: Vec<Camera>,
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
    pub fn new(method: Method, views: Vec<Camera>) -> Self {
        Self {
            method,
            views,
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
        hasher.update(&of).update(format!("{self:?}").as_bytes());
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
            Self::Write(_) => FailureKind::Io,
        }
    }
}

/// What was made of one cell.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CellSummary {
    /// Least corner.
    pub min: [f64; 3],
    /// Greatest corner.
    pub max: [f64; 3],
    /// Its far field is worth cubes.
    pub kept: bool,
    /// Samples.
    pub samples: usize,
    /// Greatest void surface seen from any candidate after the corners, then after each further
    /// sample, steradians.
    pub objective: Vec<f64>,
    /// Points of all samples.
    pub points: u64,
    /// Of those, removed.
    pub redundant: u64,
    /// Triangles of all cubes that were made.
    pub triangles: u64,
    /// Triangles that the views have in sight of the cubes drawn by default, mean.
    pub cubes_in_view: u64,
    /// And of the same as geometry, at one pixel of error.
    pub geometry_in_view: u64,
    /// Triangles of the source in the near field.
    pub near_triangles: u64,
    /// Bytes of all faces.
    pub bytes: u64,
    /// Seconds spent placing, sampling and encoding.
    pub seconds: [f64; 3],
}

/// What was made.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct FarSummary {
    /// By cell.
    pub cells: Vec<CellSummary>,
    /// Bytes of the file.
    pub file_bytes: u64,
}

impl std::fmt::Display for FarSummary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (at, cell) in self.cells.iter().enumerate() {
            let [least, most] =
                [cell.min, cell.max].map(|c| c.map(|c| format!("{c:.1}")).join(" "));
            writeln!(f, "cell {at:<10} {least} to {most}, {} triangles near", cell.near_triangles)?;
            let shown: Vec<String> = cell.objective.iter().map(|sr| format!("{sr:.2}")).collect();
            writeln!(f, "  samples       {}, unseen sr {}", cell.samples, shown.join(" "))?;
            let removed = 100.0 * cell.redundant as f64 / cell.points.max(1) as f64;
            writeln!(f, "  points        {}, {removed:.1}% redundant", cell.points)?;
            let fate = match (cell.kept, cell.cubes_in_view < cell.geometry_in_view) {
                (true, true) => "kept",
                (true, false) => "geometry is cheaper: kept all the same",
                (false, _) => "geometry is cheaper: left out",
            };
            writeln!(
                f,
                "  triangles     {} in cubes; in view {}, as geometry {}: {fate}",
                cell.triangles, cell.cubes_in_view, cell.geometry_in_view
            )?;
            let [place, sample, encode] = cell.seconds;
            writeln!(
                f,
                "  bytes         {}; seconds: place {place:.1}, sample {sample:.1}, encode {encode:.1}",
                cell.bytes
            )?;
        }
        write!(f, "file            {} bytes", self.file_bytes)
    }
}

/// Makes renderers for square pictures.
pub type MakeBackend<'a> = dyn FnMut(u32) -> Result<Box<dyn Backend>, BackendError> + 'a;

/// Adds far fields to the scene at `input`, in place of any it has, and writes `output`.
pub fn add_far(
    input: &Path,
    output: &Path,
    settings: &Settings,
    make_backend: &mut MakeBackend<'_>,
    progress: &dyn Progress,
) -> Result<FarSummary, FarError> {
    let store = Store::open(input)?;
    let skeleton = store.skeleton();
    let viewpoints: Vec<DVec3> = settings.views.iter().map(|view| view.eye.into()).collect();
    let cells = cells_along(skeleton, &viewpoints, &settings.division);
    if cells.is_empty() {
        return Err(FarError::Nowhere(input.to_owned()));
    }
    // That of pictures.
    let near = near_plane(skeleton.diagonal()) as f32;
    let mut studio = |side: u32| -> Result<Studio<'_>, FarError> {
        let backend = make_backend(side).map_err(CaptureError::from)?;
        Ok(Studio::new(&store, backend, side, near)?)
    };
    let mut search = studio(settings.search_side)?;
    let fine = studio(settings.side)?;
    let mut fine = if settings.relight { fine.with_normals() } else { fine };
    let mut file = FarFile::begin(&store, output)?;
    let mut summary = FarSummary::default();
    progress.stage("cells", cells.len() as u64);
    for cell in &cells {
        let made = far_field(cell, settings, skeleton, &mut search, &mut fine)?;
        summary.cells.push(file.add(made, settings)?);
        progress.advance(1);
    }
    progress.finish();
    summary.file_bytes = file.finish(settings.key(skeleton.info.key))?;
    Ok(summary)
}

/// A cell's cubes before they are written.
struct FarFieldOf {
    cubes: Vec<BakedCube>,
    summary: CellSummary,
}

fn far_field(
    cell: &Cell,
    settings: &Settings,
    skeleton: &Skeleton,
    search: &mut Studio<'_>,
    fine: &mut Studio<'_>,
) -> Result<FarFieldOf, FarError> {
    let region = cell.region(up_axis(skeleton), settings.in_space);
    let [min, max] = with_margin(cell.min.to_array(), cell.max.to_array(), MARGIN).map(DVec3::from);
    let viewpoints = Viewpoints { min, max };
    let placing = Instant::now();
    let (eyes, objective) = match settings.method {
        Method::Tdm => (region.grid(1), Vec::new()),
        _ => {
            let how = placement::Settings {
                epsilon_sr: settings.epsilon_sr,
                budget: settings.samples,
                ..placement::Settings::default()
            };
            let mut source = OfCell { studio: search, near: &cell.near };
            let placed = placement::place(&region, &how, &mut source)?;
            let eyes = placed.samples.iter().map(|(sample, _)| sample.eye).collect();
            (eyes, placed.worst_sr)
        }
    };
    let placed = placing.elapsed().as_secs_f64();
    let sampling = Instant::now();
    let samples = eyes
        .iter()
        .map(|&eye| fine.sample(eye, &cell.near))
        .collect::<Result<Vec<Sample>, CaptureError>>()?;
    let sampled = sampling.elapsed().as_secs_f64();
    let encoding = Instant::now();
    let views = views_of(cell, settings);
    let geometry_in_view = views.of_geometry(skeleton, &cell.near);
    let pays = |cubes: &[BakedCube]| settings.always || views.of_cubes(cubes) < geometry_in_view;
    let (cubes, points, redundant) = match settings.method {
        Method::Tdm => (vec![tdm::encode(&samples[0], &viewpoints, settings.tolerance_px)], 0, 0),
        _ => {
            let tolerance = settings.tolerance_px;
            // The first cube is drawn from everywhere, all of them where they are few.
            let are_few = samples.len() <= FAR_CUBES as usize;
            let goes_on = |cubes: &[BakedCube]| (cubes.len() > 1 && !are_few) || pays(cubes);
            let encoded =
                itdm::encode(&samples, &viewpoints, tolerance, settings.all_intra, goes_on);
            (encoded.cubes, encoded.points, encoded.redundant)
        }
    };
    let summary = CellSummary {
        min: cell.min.to_array(),
        max: cell.max.to_array(),
        kept: pays(&cubes),
        samples: eyes.len(),
        objective,
        points,
        redundant,
        triangles: cubes.iter().map(BakedCube::triangles).sum(),
        cubes_in_view: views.of_cubes(&cubes),
        geometry_in_view,
        near_triangles: cell.near.triangles(skeleton),
        bytes: 0,
        seconds: [placed, sampled, encoding.elapsed().as_secs_f64()],
    };
    Ok(FarFieldOf { cubes, summary })
}

/// The pictures that are taken in a cell.
fn views_of(cell: &Cell, settings: &Settings) -> Views {
    let inside = |view: &&Camera| cell.viewpoints.contains(&view.eye.into());
    let cameras: Vec<Camera> = settings.views.iter().filter(inside).copied().collect();
    Views::new(&cameras, settings.side)
}

/// The vertices that indices name, in the order they do, and the indices into those.
fn own_vertices(indices: &[u32]) -> (Vec<u32>, Vec<u16>) {
    let mut used = Vec::new();
    let mut places = HashMap::new();
    let local = indices.iter().map(|&vertex| {
        *places.entry(vertex).or_insert_with(|| {
            used.push(vertex);
            used.len() as u16 - 1
        })
    });
    let local = local.collect();
    (used, local)
}

/// The file with far fields while it is written.
struct FarFile<'a> {
    store: &'a Store,
    writer: SceneWriter,
    /// By blob of the scene, its number in this file; none for cubes it had before.
    blobs: Vec<u32>,
    cells: Vec<ViewCell>,
    cubes: Vec<Cube>,
}

impl<'a> FarFile<'a> {
    fn begin(store: &'a Store, output: &Path) -> Result<Self, FarError> {
        let mut writer = SceneWriter::create(output)?;
        let mut blobs = Vec::new();
        for (blob, id) in store.skeleton().blobs.iter().zip(0..) {
            if blob.is_projected() {
                blobs.push(NONE);
                continue;
            }
            let bytes = store.load_blob(protocol::id::BlobId(id))?;
            blobs.push(writer.copy_blob(blob, &bytes)?.0);
        }
        Ok(Self { store, writer, blobs, cells: Vec::new(), cubes: Vec::new() })
    }

    /// Writes a cell's cubes, or notes that its far field is cheaper as geometry.
    fn add(&mut self, made: FarFieldOf, settings: &Settings) -> Result<CellSummary, FarError> {
        let mut summary = made.summary;
        let first_cube = self.cubes.len() as u32;
        let cubes = if summary.kept { &made.cubes[..] } else { &[] };
        for cube in cubes {
            let mut patches = [0; 7];
            for (face, start) in cube.faces.iter().zip(&mut patches) {
                *start = self.writer.blob_count();
                if let Some(face) = face {
                    summary.bytes += self.add_face(face)?;
                }
            }
            patches[6] = self.writer.blob_count();
            self.cubes.push(Cube {
                eye: cube.eye.to_array(),
                patches,
                side: settings.side,
                parent: cube.parent.map_or(NONE, |parent| first_cube + parent as u32),
                triangles: cube.triangles() as u32,
            });
        }
        self.cells.push(ViewCell {
            min: summary.min,
            max: summary.max,
            first_cube,
            cube_count: cubes.len() as u32,
            method: if summary.kept { settings.method } else { Method::None } as u32,
            margin: MARGIN,
            objective: summary.objective.last().copied().unwrap_or(0.0),
        });
        Ok(summary)
    }

    /// Writes the patches of a face; returns their bytes.
    fn add_face(&mut self, face: &BakedFace) -> Result<u64, FarError> {
        let mut bytes = 0;
        for BakedPatch { triangles, window, picture } in &face.patches {
            let at = window.at.map(|tile| tile * TILE);
            let triangles = face.mesh.triangles[triangles.clone()].as_flattened();
            let (used, indices) = own_vertices(triangles);
            let local = |&vertex: &u32| {
                let [u, v, disparity] = face.mesh.vertices[vertex as usize];
                Vertex::pack_position([u - at[0] * SUBPIXELS, v - at[1] * SUBPIXELS, disparity])
            };
            let vertices: Vec<[u32; 2]> = used.iter().map(local).collect();
            let blob = self.writer.add_patch(&NewPatch {
                step: face.mesh.step,
                at,
                side: window.across * TILE,
                vertices: &vertices,
                indices: &indices,
                table: &picture.table,
                tiles: picture.tiles.as_chunks().0,
                normals: picture.normals.as_ref().map(|normals| normals.as_chunks().0),
            })?;
            bytes += self.writer.blob(blob).bytes;
        }
        Ok(bytes)
    }

    fn finish(mut self, key: [u8; 32]) -> Result<u64, FarError> {
        let skeleton = self.store.skeleton();
        for (texture, index) in skeleton.textures.iter().zip(0..) {
            self.writer.copy_texture(texture, &self.store.load_texture(index)?)?;
        }
        let mut tables = Tables {
            info: skeleton.info,
            hlods: skeleton.hlods.clone(),
            levels: skeleton.levels.clone(),
            parts: skeleton.parts.clone(),
            transforms: skeleton.transforms.clone(),
            view_cells: self.cells,
            cubes: self.cubes,
        };
        tables.info.key = key;
        for part in &mut tables.parts {
            part.blob = self.blobs[part.blob as usize];
        }
        Ok(self.writer.finish(tables)?.bytes)
    }
}
