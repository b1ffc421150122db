//! The grids that pieces lie on.
//!
//! All have a power of two for their step, and a point in common: so a coarser grid is a subset of a finer
//! one. The pieces of a mesh lie on one that suits mesh and scene; one that is too long for it lies on a coarser
//! one of its own. A vertex that several pieces share is moved to the coarsest grid among theirs, and to the
//! same place in all of them: seams close, and a long piece costs its neighbours the corners they share. Only
//! a grid that is [`MOST_COARSE`] times as coarse moves nothing but its own: its triangles are off by so much
//! that they meet the others nowhere.

use crate::pack::{finest_step, power_of_two_at_least, snapped};
use crate::seams::hash_of;
use geometry::hash::FastHash;
use geometry::mesh::Mesh;
use std::collections::HashMap;

/// Steps that a mesh's diagonal is divided into at least, however large the scene is.
const STEPS_PER_MESH: f64 = (1u32 << 16) as f64;
/// Steps that the scene's diagonal is divided into, unless a mesh demands finer or a piece coarser ones.
const STEPS_PER_SCENE: f64 = (1u32 << 23) as f64;

/// A grid so many times as coarse as the finest of a mesh does not move what it shares with finer ones: to
/// these it would be far away.
const MOST_COARSE: f64 = (1u32 << 18) as f64;
/// What a piece must be longer by to fit its grid once it has corners of such a grid at both ends, each moved
/// by less than [`MOST_COARSE`] steps: `1.5 * 2^20` steps and twice `2^18` are `2^21`.
const ROOM: f64 = 4.0 / 3.0;

/// The step that suits a mesh and a scene of these diagonals, strays left out.
pub(crate) fn common_step(mesh: f64, scene: f64) -> f64 {
    let wanted = mesh / STEPS_PER_MESH;
    let wanted = match scene.is_finite() {
        true => wanted.min(scene / STEPS_PER_SCENE),
        false => wanted,
    };
    power_of_two_at_least(wanted)
}

/// The step of a piece so long, whose coordinates are at most `farthest` from 0: `common` if it is coarse
/// enough.
pub(crate) fn step(common: f64, extent: f64, farthest: f64) -> f64 {
    common.max(finest_step(extent * ROOM, farthest))
}

/// Where vertices lie that pieces of one mesh on different grids share.
pub(crate) struct Shared {
    /// The finest step of all pieces.
    finest: f64,
    /// By the hash of a place on the finest grid: the coarsest step of a piece that has a vertex there. Only
    /// of pieces with a coarser step than the finest. Two places with one hash are only moved without need.
    coarse: HashMap<u64, f64, FastHash>,
}

impl Shared {
    /// For pieces with these steps; those that are coarse are still to be noted.
    pub(crate) fn new(steps: &[f64]) -> Self {
        let finest = steps.iter().copied().fold(f64::INFINITY, f64::min);
        Self { finest, coarse: HashMap::default() }
    }

    /// Whether a piece with this step must be noted before any is moved.
    pub(crate) fn is_coarse(&self, step: f64) -> bool {
        step > self.finest
    }

    /// Notes the vertices of a piece, which are on no grid yet.
    pub(crate) fn note(&mut self, mesh: &Mesh, step: f64) {
        if step > MOST_COARSE * self.finest {
            return;
        }
        for vertex in &mesh.vertices {
            let place = hash_of(snapped(vertex.position, self.finest));
            let known = self.coarse.entry(place).or_insert(step);
            *known = known.max(step);
        }
    }

    /// Moves the vertices of a piece to its grid, or to the coarser one of who shares them. Returns how far
    /// it has moved any at most.
    pub(crate) fn snap(&self, mesh: &mut Mesh, step: f64) -> f64 {
        let mut coarsest = step;
        for vertex in &mut mesh.vertices {
            // Places that are one on the finest grid stay one, whoever has them.
            let place = snapped(vertex.position, self.finest);
            let shared = match self.coarse.is_empty() {
                true => step,
                false => self.coarse.get(&hash_of(place)).map_or(step, |&shared| shared.max(step)),
            };
            coarsest = coarsest.max(shared);
            vertex.position = snapped(place, shared);
        }
        // Each of the two moves is less than sqrt(3)/2 of its step.
        if coarsest > self.finest { coarsest + self.finest } else { coarsest }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::mesh::MeshVertex;
    use glam::{DVec3, Vec3};

    fn mesh(points: &[DVec3]) -> Mesh {
        let vertex = |&at: &DVec3| MeshVertex::plain(at, Vec3::Z, [0; 4]);
        Mesh { vertices: points.iter().map(vertex).collect(), triangles: Vec::new() }
    }

    #[test]
    fn shared_vertices_lie_where_the_coarsest_piece_has_them() {
        let points: Vec<DVec3> =
            (0..9).map(|i| DVec3::new(f64::from(i) * 0.3, 1.7, -0.4)).collect();
        // The same corner, as two triangles may write it.
        let twin = points[4] + 1e-9;
        let mut shared = Shared::new(&[0.125, 4.0, 1.0]);
        assert!(!shared.is_coarse(0.125) && shared.is_coarse(1.0));
        shared.note(&mesh(&points[..3]), 1.0);
        shared.note(&mesh(&[points[2], twin]), 4.0);
        let (mut fine, mut coarse) = (mesh(&points), mesh(&[points[2], twin]));
        assert_eq!(shared.snap(&mut fine, 0.125), 4.125);
        shared.snap(&mut coarse, 4.0);
        assert_eq!(fine.vertices[2].position, coarse.vertices[0].position);
        assert_eq!(fine.vertices[4].position, coarse.vertices[1].position);
        for (i, (vertex, at)) in fine.vertices.iter().zip(&points).enumerate() {
            let step = [1.0, 1.0, 4.0, 0.125, 4.0].get(i).copied().unwrap_or(0.125);
            assert_eq!(vertex.position, snapped(vertex.position, step));
            assert!(vertex.position.distance(*at) <= 0.867 * (step + 0.125), "{i}");
        }
    }

    #[test]
    fn one_grid_is_one_rounding() {
        let shared = Shared::new(&[0.25; 3]);
        let mut one = mesh(&[DVec3::splat(0.3)]);
        assert_eq!(shared.snap(&mut one, 0.25), 0.25);
        assert_eq!(one.vertices[0].position, DVec3::splat(0.25));
    }
}
