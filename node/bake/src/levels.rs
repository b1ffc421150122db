//! Levels of detail of one mesh: welded, simplified, and clustered where that is not enough.

use crate::options::{MAX_MESH_TRIANGLES, Options};
use geometry::deviation::{Surface, deviation, fine_samples, inner_samples};
use geometry::mesh::Mesh;
use geometry::simplify::simplify;
use geometry::weld::weld;

/// First welding distance as a share of the mesh's diagonal: at the scale where a mesh is drawn
/// coarser at all, far below a pixel.
const FIRST_EPSILON: f64 = 1.0 / 2048.0;
/// Last one: 16 clusters along the diagonal.
const LAST_EPSILON: f64 = 1.0 / 16.0;
/// How far simplification may go in a round, in welding distances, before more is welded instead.
const ERROR_PER_EPSILON: f64 = 4.0;
/// A level is kept only if it has at most this share of the triangles of the one before.
const PAYING_SHARE: f64 = 0.75;
/// A result this much above its target is near enough.
const NEAR_TARGET: f64 = 1.25;
/// Allowance for what lies between the samples of a measured deviation.
const SAMPLING_FACTOR: f64 = 1.25;
/// Least growth of an error from one level to the next, so that the order is strict.
pub(crate) const ERROR_GROWTH: f64 = 1.0 + 1.0 / (1 << 20) as f64;

/// One coarser form of a mesh. Its vertices are vertices of that mesh.
#[derive(Debug, Clone)]
pub(crate) struct CoarseMesh {
    pub(crate) mesh: Mesh,
    /// Deviation from the original surface, mesh units.
    pub(crate) error: f64,
    /// Distance it was welded within, mesh units.
    pub(crate) epsilon: f64,
}

/// How far a chain of levels is to go.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Goal {
    /// Triangles of the first level; each further one has half of the one before.
    pub(crate) first_target: usize,
    /// Most levels.
    pub(crate) most: usize,
    /// Distance within which parts of the mesh have been welded before: less has been tried there.
    pub(crate) epsilon: f64,
}

/// Levels of `mesh`, which deviates by `error` from the original, as long as they pay. Errors grow
/// strictly.
///
/// A level's error is the lesser of two: the moves of its vertices added up step by step, and its
/// deviation from `mesh` measured both ways. The first counts a part that vanished by its own size,
/// since no more than that was there to be seen, but adds up far more than comes together in one
/// place; the second counts a part that vanished by its distance to what is left.
pub(crate) fn levels(mesh: &Mesh, error: f64, goal: Goal, options: &Options) -> Vec<CoarseMesh> {
    if mesh.triangles.len() <= options.level_least_triangles {
        return Vec::new();
    }
    let mut reducer = Reducer::new(mesh, &goal);
    let original = Surface::new(mesh);
    let mut levels: Vec<CoarseMesh> = Vec::new();
    let mut target = goal.first_target;
    let mut finer = error;
    while levels.len() < goal.most {
        let before = levels.last().map_or(mesh, |level| &level.mesh);
        if before.triangles.len() <= options.level_least_triangles {
            break;
        }
        let Some(mut coarse) = reducer.reduce(before, finer, target) else { break };
        let back = deviation(inner_samples(&coarse.mesh), &original, 0.0);
        let measured =
            deviation(fine_samples(mesh), &Surface::new(&coarse.mesh), back) * SAMPLING_FACTOR;
        coarse.error = coarse.error.min(error + measured).max(finer * ERROR_GROWTH);
        target = coarse.mesh.triangles.len() / 2;
        finer = coarse.error;
        levels.push(coarse);
    }
    levels
}

/// Remembers how far welding has gone: a coarser level never needs less.
struct Reducer {
    epsilon: f64,
    last_epsilon: f64,
}

impl Reducer {
    fn new(mesh: &Mesh, goal: &Goal) -> Self {
        let diagonal = mesh.bounds().diagonal();
        let last_epsilon = diagonal * LAST_EPSILON;
        Self { epsilon: goal.epsilon.max(diagonal * FIRST_EPSILON).min(last_epsilon), last_epsilon }
    }

    /// A mesh of about `target` triangles, or as near as the last epsilon gets; `None` if that does
    /// not pay. Errors of the rounds add up.
    fn reduce(&mut self, mesh: &Mesh, error: f64, target: usize) -> Option<CoarseMesh> {
        let enough = (target as f64 * NEAR_TARGET) as usize;
        let mut best: Option<CoarseMesh> = None;
        loop {
            let (before, so_far) = best.as_ref().map_or((mesh, error), |b| (&b.mesh, b.error));
            let welded = weld(before, self.epsilon);
            let simplified = simplify(&welded, target, self.epsilon * ERROR_PER_EPSILON);
            let coarse = welded.with_triangles(&simplified.triangles);
            if coarse.triangles.is_empty() {
                break;
            }
            let error =
                (so_far + welded.displacement + simplified.error).max(so_far * ERROR_GROWTH);
            let done = coarse.triangles.len() <= enough;
            best = Some(CoarseMesh { mesh: coarse, error, epsilon: self.epsilon });
            if done || self.epsilon >= self.last_epsilon {
                break;
            }
            self.epsilon *= 2.0;
        }
        let most = (mesh.triangles.len() as f64 * PAYING_SHARE) as usize;
        best.filter(|b| b.mesh.triangles.len() <= most.min(MAX_MESH_TRIANGLES))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::mesh::MeshVertex;
    use glam::{DVec3, Vec3};

    fn flat(positions: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Mesh {
        let vertex = |position| MeshVertex::plain(position, Vec3::Z, [9, 9, 9, 255]);
        Mesh { vertices: positions.into_iter().map(vertex).collect(), triangles }
    }

    /// Quads in a square grid that do not share vertices and leave gaps between them.
    fn quads(side: u32, gap: f64) -> Mesh {
        let mut positions = Vec::new();
        let mut triangles = Vec::new();
        for i in 0..side * side {
            let corner = DVec3::new(f64::from(i % side), f64::from(i / side), 0.0);
            let size = 1.0 - gap;
            positions.extend([
                corner,
                corner + DVec3::X * size,
                corner + DVec3::Y * size,
                corner + (DVec3::X + DVec3::Y) * size,
            ]);
            let first = 4 * i;
            triangles.extend([[first, first + 1, first + 2], [first + 1, first + 3, first + 2]]);
        }
        flat(positions, triangles)
    }

    fn area(mesh: &Mesh) -> f64 {
        let of = |t: &[u32; 3]| {
            let [a, b, c] = mesh.corners(*t);
            (b - a).cross(c - a).length() * 0.5
        };
        mesh.triangles.iter().map(of).sum()
    }

    fn goal(first_target: usize) -> Goal {
        Goal { first_target, most: 20, epsilon: 0.0 }
    }

    #[test]
    fn nothing_and_little_have_no_levels() {
        let options = Options::default();
        assert!(levels(&Mesh::default(), 0.1, goal(4), &options).is_empty());
        assert!(levels(&quads(2, 0.1), 0.1, goal(4), &options).is_empty());
        let heap = flat(
            vec![DVec3::splat(1e7); 60],
            (0..20).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        );
        assert!(levels(&heap, 0.1, goal(10), &options).is_empty());
    }

    #[test]
    fn nearly_touching_quads_become_few_and_keep_their_area() {
        let mesh = quads(40, 0.01);
        let levels = levels(&mesh, 1e-6, goal(1600), &Options::default());
        let last = levels.last().unwrap();
        assert!(last.mesh.triangles.len() <= 16, "{}", last.mesh.triangles.len());
        for level in &levels {
            assert!((area(&level.mesh) / 1600.0 - 1.0).abs() < 0.1, "{}", area(&level.mesh));
        }
    }

    #[test]
    fn far_apart_parts_are_reduced_too_and_errors_grow_strictly() {
        let levels = levels(&quads(40, 0.5), 1e-6, goal(1600), &Options::default());
        assert!(levels.len() >= 4, "{}", levels.len());
        assert!(levels.windows(2).all(|w| w[0].error < w[1].error));
        assert!(levels.windows(2).all(|w| {
            w[1].mesh.triangles.len() as f64 <= w[0].mesh.triangles.len() as f64 * PAYING_SHARE
        }));
    }
}
