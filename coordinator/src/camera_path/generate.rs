//! Camera paths made for a scene.

use super::grid::{Grid, MAX_CELLS};
use super::{FOV_Y_DEG, Pose, voxels, walk, wander};
use protocol::format::Skeleton;
use protocol::id::BlobId;
use rand::{Rng, SeedableRng, rngs::StdRng};

/// How a generated path moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PathKind {
    /// At eye height through free space, at a person's pace.
    Walk,
    /// Once around the whole scene, looking in, slightly from above.
    Orbit,
    /// From far outside into the densest part.
    Zoom,
    /// Through everything, walls included, turning, looking up and down.
    Wander,
}

impl std::str::FromStr for PathKind {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "walk" => Ok(Self::Walk),
            "orbit" => Ok(Self::Orbit),
            "zoom" => Ok(Self::Zoom),
            "wander" => Ok(Self::Wander),
            _ => Err(format!("no camera path {name}: walk, orbit, zoom or wander")),
        }
    }
}

/// Why no path was made.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// No hlods, or no finite box around them.
    #[error("the scene is empty or has no finite bounds")]
    EmptyScene,
    /// A blob could not be read.
    #[error("blob {blob}: {source}")]
    Blob {
        /// The blob.
        blob: BlobId,
        /// The reader's reason.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A blob's bytes are no mesh.
    #[error("blob {blob}: {reason}")]
    Geometry {
        /// The blob.
        blob: BlobId,
        /// What is wrong.
        reason: &'static str,
    },
}

/// Height of an orbit over the horizon: sine and cosine of 20 degrees.
const ORBIT_ELEVATION: (f64, f64) = (0.342_020_143_325_668_7, 0.939_692_620_785_908_4);
/// Distance of an orbit from the middle, in diagonals: the bounding sphere fills the picture's height.
const ORBIT_DISTANCE: f64 = 1.0;
/// Where a zoom starts and ends, in diagonals from its target.
const ZOOM_DISTANCE: [f64; 2] = [3.0, 0.03];
/// Cells along a side of the grid that finds the densest part.
const DENSITY_CELLS: usize = 8;

/// Makes `frames` poses for a scene. `read_blob` gives a blob's bytes; only a walk asks for any.
///
/// The same scene, kind and seed give the same path. A walk of more frames goes on where one of fewer
/// ends, and so does one that wanders; where a scene has no room to walk it becomes an orbit. Orbit and zoom divide their one
/// movement by the number of frames.
///
/// # Errors
/// See [`GenerateError`].
pub fn generate<B: AsRef<[u8]>, E: std::error::Error + Send + Sync + 'static>(
    kind: PathKind,
    skeleton: &Skeleton,
    read_blob: impl FnMut(BlobId) -> Result<B, E>,
    frames: u32,
    seed: u64,
) -> Result<Vec<Pose>, GenerateError> {
    generate_within(MAX_CELLS, kind, skeleton, read_blob, frames, seed)
}

/// [`generate`] with a grid of at most `max_cells` for the walk.
pub(super) fn generate_within<B: AsRef<[u8]>, E: std::error::Error + Send + Sync + 'static>(
    max_cells: usize,
    kind: PathKind,
    skeleton: &Skeleton,
    read_blob: impl FnMut(BlobId) -> Result<B, E>,
    frames: u32,
    seed: u64,
) -> Result<Vec<Pose>, GenerateError> {
    let root = skeleton.hlods.first().ok_or(GenerateError::EmptyScene)?;
    let finite = root.min.iter().chain(&root.max).all(|c| c.is_finite());
    if !finite || (0..3).any(|k| root.min[k] > root.max[k]) {
        return Err(GenerateError::EmptyScene);
    }
    let scene = Scene::new(skeleton);
    Ok(match kind {
        PathKind::Orbit => scene.orbit(frames, seed),
        PathKind::Zoom => scene.zoom(skeleton, frames, seed),
        PathKind::Wander => wander::wander(skeleton, scene.up, scene.level, frames, seed),
        PathKind::Walk => {
            let mut grid = Grid::around(root.min, root.max, scene.up, max_cells);
            voxels::fill(&mut grid, skeleton, read_blob)?;
            walk::walk(&grid, scene.diagonal, scene.up, frames, seed)
                .unwrap_or_else(|| scene.orbit(frames, seed))
        }
    })
}

/// What all paths need of a scene.
struct Scene {
    center: [f64; 3],
    /// Positive: 1 for a scene without extent.
    diagonal: f64,
    up: [f64; 3],
    /// Two directions that make a right-handed frame with `up`.
    level: [[f64; 3]; 2],
}

impl Scene {
    fn new(skeleton: &Skeleton) -> Self {
        let root = &skeleton.hlods[0];
        let diagonal = skeleton.diagonal();
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let unit = |v: [f64; 3]| {
            let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
            (length.is_finite() && length > 0.0).then(|| v.map(|c| c / length))
        };
        // A scene that does not know its up is taken for a glTF one.
        let up = unit(skeleton.info.up).unwrap_or([0.0, 1.0, 0.0]);
        let least = (0..3).fold(0, |best, k| if up[k].abs() < up[best].abs() { k } else { best });
        let mut helper = [0.0; 3];
        helper[least] = 1.0;
        let first = unit(cross(helper, up)).unwrap_or(helper);
        Self {
            center: std::array::from_fn(|k| 0.5 * (root.min[k] + root.max[k])),
            diagonal: if diagonal > 0.0 { diagonal } else { 1.0 },
            up,
            level: [first, cross(up, first)],
        }
    }

    /// A pose that looks at `target` from a distance, at an angle around up.
    fn pose(&self, target: [f64; 3], distance: f64, angle: f64) -> Pose {
        let (rise, run) = ORBIT_ELEVATION;
        let (sin, cos) = angle.sin_cos();
        let eye = std::array::from_fn(|k| {
            let level = cos * self.level[0][k] + sin * self.level[1][k];
            target[k] + distance * (run * level + rise * self.up[k])
        });
        Pose { eye, target, up: self.up, fov_y_deg: FOV_Y_DEG, near: None }
    }

    fn orbit(&self, frames: u32, seed: u64) -> Vec<Pose> {
        let start = start_angle(seed);
        (0..frames)
            .map(|frame| {
                let turns = f64::from(frame) / f64::from(frames);
                let angle = start + std::f64::consts::TAU * turns;
                self.pose(self.center, ORBIT_DISTANCE * self.diagonal, angle)
            })
            .collect()
    }

    fn zoom(&self, skeleton: &Skeleton, frames: u32, seed: u64) -> Vec<Pose> {
        let target = densest_part(skeleton);
        let angle = start_angle(seed);
        let [far, near] = ZOOM_DISTANCE;
        (0..frames)
            .map(|frame| {
                // Every frame the same factor nearer.
                let done = f64::from(frame) / f64::from(frames.saturating_sub(1).max(1));
                let distance = self.diagonal * far * (near / far).powf(done);
                self.pose(target, distance, angle)
            })
            .collect()
    }
}

fn start_angle(seed: u64) -> f64 {
    StdRng::seed_from_u64(seed).random_range(0.0..std::f64::consts::TAU)
}

/// Mean of the leaves, weighted by triangles, in the cell of a coarse grid that holds most of those.
fn densest_part(skeleton: &Skeleton) -> [f64; 3] {
    let root = &skeleton.hlods[0];
    // Triangles, and the sum of middles weighted with them.
    let mut cells = vec![(0.0f64, [0.0f64; 3]); DENSITY_CELLS.pow(3)];
    for leaf in skeleton.hlods.iter().filter(|h| h.child_count == 0) {
        let middle: [f64; 3] = std::array::from_fn(|k| 0.5 * (leaf.min[k] + leaf.max[k]));
        let index = (0..3).fold(0, |index, k| {
            let extent = (root.max[k] - root.min[k]).max(f64::MIN_POSITIVE);
            let at = (middle[k] - root.min[k]) / extent * DENSITY_CELLS as f64;
            index * DENSITY_CELLS + (at as usize).min(DENSITY_CELLS - 1)
        });
        let weight = leaf.source_triangles.max(1) as f64;
        let (sum, weighted) = &mut cells[index];
        *sum += weight;
        for k in 0..3 {
            // Relative to the root's corner: a scene far from its origin loses no digits.
            weighted[k] += weight * (middle[k] - root.min[k]);
        }
    }
    let best = cells.iter().fold(&cells[0], |best, cell| if cell.0 > best.0 { cell } else { best });
    std::array::from_fn(|k| root.min[k] + best.1[k] / best.0.max(1.0))
}
