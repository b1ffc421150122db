//! Vertex welding and clustering: positions closer than epsilon become one.
//!
//! With a small epsilon this closes the seams between parts that merely touch, so that a simplifier
//! may work across them; with a large one it is vertex clustering (Rossignac and Borrel 1993), which
//! reduces whatever an edge-collapse simplifier cannot, at a displacement known exactly.

use crate::mesh::{Mesh, MeshVertex, face_normal};
use glam::{DVec3, Vec3};
use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasherDefault, Hasher};

/// Least cosine between a source normal and the face it is to shade, 60 degrees: beyond it the face
/// has turned so far that its own normal is the better one.
const LEAST_NORMAL_COSINE: f32 = 0.5;

/// A mesh whose vertices are the distinct (shared position, colour) pairs of another.
#[derive(Debug, Clone)]
pub struct Welded {
    /// Position of each vertex; vertices that differ in colour alone have bitwise the same.
    pub positions: Vec<DVec3>,
    /// Colour of each vertex.
    pub colors: Vec<[u8; 4]>,
    /// Triangles that kept three different positions, without repeats.
    pub triangles: Vec<[u32; 3]>,
    /// Farthest any vertex was moved; at most epsilon.
    pub displacement: f64,
    /// Source normals of vertex `v`: `normals[normal_start[v]..normal_start[v + 1]]`.
    normals: Vec<Vec3>,
    normal_start: Vec<u32>,
}

/// Joins positions at most `epsilon` apart (0: only equal ones). Each vertex moves to the nearest
/// representative within reach, or becomes one; representatives are vertices of the mesh, found in
/// vertex order. Triangles that lose a side vanish, and so do repeats of the same three vertices,
/// whichever way they face: everything is drawn two-sided.
pub fn weld(mesh: &Mesh, epsilon: f64) -> Welded {
    assert!(epsilon >= 0.0 && epsilon.is_finite());
    let (representative, displacement) = representatives(mesh, epsilon);
    let mut ids: HashMap<(u32, u32), u32, FastHash> = HashMap::default();
    let mut welded = Welded {
        positions: Vec::new(),
        colors: Vec::new(),
        triangles: Vec::new(),
        displacement,
        normals: Vec::new(),
        normal_start: Vec::new(),
    };
    let mut sources = Vec::new();
    let vertex_of: Vec<u32> = std::iter::zip(&mesh.vertices, &representative)
        .map(|(vertex, &shared)| {
            let color = u32::from_le_bytes(vertex.color);
            *ids.entry((shared, color)).or_insert_with(|| {
                welded.positions.push(mesh.vertices[shared as usize].position);
                welded.colors.push(vertex.color);
                sources.push(shared);
                welded.positions.len() as u32 - 1
            })
        })
        .collect();
    let mut seen: HashSet<[u32; 3], FastHash> = HashSet::default();
    for triangle in &mesh.triangles {
        let corners = triangle.map(|index| vertex_of[index as usize]);
        let [a, b, c] = corners.map(|vertex| sources[vertex as usize]);
        let mut key = corners;
        key.sort_unstable();
        if a != b && b != c && c != a && seen.insert(key) {
            welded.triangles.push(corners);
        }
    }
    welded.gather_normals(mesh, &vertex_of);
    welded
}

impl Welded {
    /// Sorts the source normals by welded vertex.
    fn gather_normals(&mut self, mesh: &Mesh, vertex_of: &[u32]) {
        let mut start = vec![0u32; self.positions.len() + 1];
        vertex_of.iter().for_each(|&vertex| start[vertex as usize + 1] += 1);
        (1..start.len()).for_each(|i| start[i] += start[i - 1]);
        let mut next = start.clone();
        self.normals = vec![Vec3::ZERO; vertex_of.len()];
        for (source, &vertex) in mesh.vertices.iter().zip(vertex_of) {
            self.normals[next[vertex as usize] as usize] = source.normal;
            next[vertex as usize] += 1;
        }
        self.normal_start = start;
    }

    /// The mesh of `triangles`, which name vertices of this one. Each corner gets the source normal
    /// of its vertex that is nearest to the triangle's own, whichever way that faces, so that smooth
    /// parts stay smooth; where none is near, the triangle's own. Triangles without area are left out.
    pub fn with_triangles(&self, triangles: &[[u32; 3]]) -> Mesh {
        let mut mesh = Mesh::default();
        let mut ids: HashMap<(u32, [u32; 3]), u32, FastHash> = HashMap::default();
        for triangle in triangles {
            let corners = triangle.map(|vertex| self.positions[vertex as usize]);
            let Some(face) = face_normal(corners) else { continue };
            mesh.triangles.push(triangle.map(|vertex| {
                let normal = self.nearest_normal(vertex as usize, face.as_vec3());
                *ids.entry((vertex, normal.to_array().map(f32::to_bits))).or_insert_with(|| {
                    let position = self.positions[vertex as usize];
                    let color = self.colors[vertex as usize];
                    mesh.vertices.push(MeshVertex::plain(position, normal, color));
                    mesh.vertices.len() as u32 - 1
                })
            }));
        }
        mesh
    }

    fn nearest_normal(&self, vertex: usize, face: Vec3) -> Vec3 {
        let range = self.normal_start[vertex] as usize..self.normal_start[vertex + 1] as usize;
        let mut best = (LEAST_NORMAL_COSINE, face);
        for &normal in &self.normals[range] {
            let cosine = normal.dot(face).abs();
            if cosine > best.0 {
                best = (cosine, normal);
            }
        }
        best.1
    }
}

/// For each vertex the vertex whose position it takes, and the farthest move.
fn representatives(mesh: &Mesh, epsilon: f64) -> (Vec<u32>, f64) {
    let origin = mesh.bounds().min;
    // A cell twice as wide as the reach: whatever is within reach lies in the eight cells nearest.
    // An epsilon too small for 64-bit cell numbers saturates them: slower, still right.
    let cells_per_unit = if epsilon > 0.0 { 0.5 / epsilon } else { 0.0 };
    let mut newest: HashMap<[i64; 3], u32, FastHash> = HashMap::default();
    let mut older = vec![u32::MAX; mesh.vertices.len()];
    let mut farthest = 0.0f64;
    let mut representative = Vec::with_capacity(mesh.vertices.len());
    for (index, vertex) in mesh.vertices.iter().enumerate() {
        let p = vertex.position;
        let scaled = (p - origin) * cells_per_unit;
        let floor = scaled.floor();
        let (cell, neighbours) = if epsilon > 0.0 {
            let step = |k: usize| if scaled[k] - floor[k] < 0.5 { -1 } else { 1 };
            (floor.to_array().map(|c| c as i64), [step(0), step(1), step(2)])
        } else {
            // Adding zero makes -0 and 0 the same key.
            (p.to_array().map(|c| (c + 0.0).to_bits() as i64), [0; 3])
        };
        let mut best = (epsilon * epsilon, u32::MAX);
        for corner in 0..if epsilon > 0.0 { 8 } else { 1 } {
            let key = std::array::from_fn(|k| {
                cell[k].wrapping_add(if corner >> k & 1 == 1 { neighbours[k] } else { 0 })
            });
            let mut candidate = newest.get(&key).copied().unwrap_or(u32::MAX);
            while candidate != u32::MAX {
                let d = mesh.vertices[candidate as usize].position.distance_squared(p);
                if (d, candidate) <= best {
                    best = (d, candidate);
                }
                candidate = older[candidate as usize];
            }
        }
        if best.1 == u32::MAX {
            representative.push(index as u32);
            if let Some(before) = newest.insert(cell, index as u32) {
                older[index] = before;
            }
        } else {
            representative.push(best.1);
            farthest = farthest.max(best.0);
        }
    }
    (representative, farthest.sqrt())
}

/// Look-up tables here are never iterated, so their order is free; the default hasher is slow.
type FastHash = BuildHasherDefault<Multiplicative>;

/// Multiplies and rotates each word in (the scheme of rustc's FxHasher).
#[derive(Default)]
struct Multiplicative(u64);

impl Hasher for Multiplicative {
    fn finish(&self) -> u64 {
        // The table takes its slot from the low bits, which a product mixes least.
        self.0 ^ self.0 >> 32
    }

    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0u8; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.write_u64(u64::from_le_bytes(word));
        }
    }

    fn write_u32(&mut self, word: u32) {
        self.write_u64(u64::from(word));
    }

    fn write_u64(&mut self, word: u64) {
        self.0 = (self.0.rotate_left(5) ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::tests::{mesh_of, sphere};

    #[test]
    fn nothing_and_a_point_weld_to_nothing() {
        assert!(weld(&Mesh::default(), 1.0).triangles.is_empty());
        let point = mesh_of(&[[5.0; 3]; 3], &[[0, 1, 2]]);
        let welded = weld(&point, 0.0);
        assert!(welded.triangles.is_empty());
        assert_eq!(welded.positions.len(), 1);
        assert_eq!(welded.displacement, 0.0);
    }

    #[test]
    fn repeats_go_whichever_way_they_face() {
        let p = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, -0.0]];
        let mesh = mesh_of(&[p[0], p[1], p[2], p[2], p[1], p[0]], &[[0, 1, 2], [3, 4, 5]]);
        assert_eq!(weld(&mesh, 0.0).triangles, [[0, 1, 2]]);
    }

    #[test]
    fn a_seam_within_reach_closes_and_one_beyond_stays() {
        let gap = 0.01;
        let mesh = mesh_of(
            &[
                [0.0; 3],
                [1.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [1.0 + gap, 0.0, 0.0],
                [1.0, 1.0, 0.0],
                [0.0, 1.0 + gap, 0.0],
            ],
            &[[0, 1, 2], [3, 4, 5]],
        );
        let closed = weld(&mesh, gap * 1.001);
        assert_eq!(closed.positions.len(), 4);
        assert!((closed.displacement - gap).abs() < 1e-12);
        assert_eq!(weld(&mesh, gap * 0.999).positions.len(), 6);
    }

    #[test]
    fn colours_stay_apart_at_one_shared_position() {
        let mut mesh =
            mesh_of(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.01, 0.0, 0.0]], &[[0, 1, 2]]);
        mesh.vertices[3].color = [255, 0, 0, 255];
        let welded = weld(&mesh, 0.1);
        assert_eq!(welded.positions.len(), 4);
        assert_eq!(welded.positions[3], welded.positions[0]);
    }

    #[test]
    fn every_pair_within_reach_in_a_cloud_is_found_far_from_the_origin() {
        // Pairs half an epsilon apart, in every direction, across cell borders.
        let epsilon = 0.5;
        let mut positions = Vec::new();
        for i in 0..500u32 {
            let base = DVec3::new(f64::from(i % 10), f64::from(i / 10 % 10), f64::from(i / 100))
                * 1.7
                + 1e7;
            let a = f64::from(i) * 0.77;
            let other = base + DVec3::new(a.cos(), a.sin() * 0.6, a.sin() * 0.8) * 0.25;
            positions.extend([base.to_array(), other.to_array()]);
        }
        let welded = weld(&mesh_of(&positions, &[]), epsilon);
        assert_eq!(welded.positions.len(), 500);
        assert!(welded.displacement <= epsilon);
    }

    #[test]
    fn corners_keep_smooth_normals_and_turned_faces_get_their_own() {
        let ball = sphere(16, 32);
        let welded = weld(&ball, 0.0);
        let smooth = welded.with_triangles(&welded.triangles);
        assert_eq!(smooth.triangles.len(), ball.triangles.len());
        assert!(smooth.vertices.iter().all(|v| v.normal.dot(v.position.as_vec3()) > 0.999));
        let mut wall = mesh_of(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], &[[0, 1, 2]]);
        wall.vertices[0].normal = Vec3::Y;
        let welded = weld(&wall, 0.0);
        let shaded = welded.with_triangles(&welded.triangles);
        assert!(shaded.vertices.iter().all(|v| v.normal.y.abs() > 0.999), "{shaded:?}");
    }
}
