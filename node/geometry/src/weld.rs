//! Vertex welding and clustering: positions closer than epsilon become one.
//!
//! With a small epsilon this closes the seams between parts that merely touch, so that a simplifier
//! may work across them; with a large one it is vertex clustering (Rossignac and Borrel 1993), which
//! reduces whatever an edge-collapse simplifier cannot, at a displacement known exactly.

use crate::hash::FastHash;
use crate::lists::Lists;
use crate::mesh::{Mesh, MeshVertex, face_normal};
use glam::{DVec3, Vec3};
use std::collections::HashMap;

/// Steps a texture is divided into: wedges that differ by less are joined where positions are.
const TEXTURE_STEPS: f32 = 32.0;

/// Least cosine between a source normal and the face it is to shade, 60 degrees: beyond it the face
/// has turned so far that its own normal is the better one.
const LEAST_NORMAL_COSINE: f32 = 0.5;

/// Height over length below which a triangle's own normal says nothing.
const NEEDLE: f32 = 1e-5;
/// A normal turns no farther than this for a chord, radians.
const MOST_TURN: f64 = 1.0;
/// Rounding of the cosines that are compared.
const TURN_ROUNDING: f32 = 1e-3;

/// What becomes of triangles that have come to lie in one place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Repeats {
    /// One is enough, whichever way they face: it is seen from both sides.
    One,
    /// One for each way to face.
    EachWay,
    /// All stay: each takes its share of the light that passes.
    All,
}

/// How a mesh is welded.
#[derive(Debug, Clone, Copy)]
pub struct Weld<'a> {
    /// Positions at most this far apart are joined; 0: only equal ones.
    pub epsilon: f64,
    /// Depth of the hlod that is being made: vertices with a lesser `seam` stay where they are.
    pub depth: u8,
    /// By surface. Of surfaces beyond the end one triangle is enough.
    pub repeats: &'a [Repeats],
}

impl Weld<'_> {
    /// Joins by distance alone.
    pub fn within(epsilon: f64) -> Self {
        Self { epsilon, depth: 0, repeats: &[] }
    }
}

/// A mesh whose vertices are the distinct wedges of another: a shared position with a colour, a
/// surface and texture coordinates.
#[derive(Debug, Clone)]
pub struct Welded {
    /// The wedges. Those that share a position have bitwise the same; `normal` is the mean of what
    /// was joined, or zero.
    pub vertices: Vec<MeshVertex>,
    /// Wedges on a border that must stay.
    pub locked: Vec<bool>,
    /// Triangles that kept three different positions, without repeats.
    pub triangles: Vec<[u32; 3]>,
    /// Farthest any vertex was moved; at most epsilon.
    pub displacement: f64,
    /// By wedge, the vertex of the mesh that its position is from.
    sources: Vec<u32>,
    /// Source normals of vertex `v`, `normals[normal_start[v]..normal_start[v + 1]]`, each with the
    /// cosine of how far it turned from any face it shaded.
    normals: Vec<(Vec3, f32)>,
    normal_start: Vec<u32>,
}

/// Joins positions at most epsilon apart. Each vertex moves to the nearest representative within
/// reach, or becomes one; representatives are vertices of the mesh: first those that must stay, then
/// the others in vertex order. Triangles that lose a side vanish, and so do repeats of the same three
/// vertices, as `how.repeats` says.
pub fn weld(mesh: &Mesh, how: Weld<'_>) -> Welded {
    assert!(how.epsilon >= 0.0 && how.epsilon.is_finite());
    let stays: Vec<bool> = mesh.vertices.iter().map(|vertex| vertex.seam < how.depth).collect();
    let (representative, displacement) = representatives(mesh, how.epsilon, &stays);
    let mut wedges = Lists::new(mesh.vertices.len());
    let mut welded = Welded {
        vertices: Vec::new(),
        locked: Vec::new(),
        triangles: Vec::new(),
        displacement,
        sources: Vec::new(),
        normals: Vec::new(),
        normal_start: Vec::new(),
    };
    let vertex_of: Vec<u32> = std::iter::zip(&mesh.vertices, &representative)
        .map(|(vertex, &shared)| {
            let attributes = attribute_key(vertex, how.epsilon);
            let known = wedges.find(shared, |wedge| {
                let other = &welded.vertices[wedge as usize];
                other.color == vertex.color && attribute_key(other, how.epsilon) == attributes
            });
            known.unwrap_or_else(|| {
                let at = &mesh.vertices[shared as usize];
                welded.vertices.push(MeshVertex {
                    position: at.position,
                    seam: at.seam,
                    ..*vertex
                });
                welded.locked.push(stays[shared as usize]);
                welded.sources.push(shared);
                wedges.put(shared)
            })
        })
        .collect();
    let mut seen = Lists::new(welded.vertices.len());
    let mut keys: Vec<[u32; 3]> = Vec::new();
    for triangle in &mesh.triangles {
        let corners = triangle.map(|index| vertex_of[index as usize]);
        let [a, b, c] = corners.map(|vertex| welded.sources[vertex as usize]);
        if a == b || b == c || c == a {
            continue;
        }
        let surface = mesh.vertices[triangle[0] as usize].surface;
        let repeats = how.repeats.get(usize::from(surface)).copied().unwrap_or(Repeats::One);
        let key = repeat_key(corners, repeats == Repeats::EachWay);
        let is_kept = repeats == Repeats::All
            || seen.find(key[0], |triangle| keys[triangle as usize] == key).is_none();
        if is_kept {
            seen.put(key[0]);
            keys.push(key);
            welded.triangles.push(corners);
        }
    }
    welded.gather_normals(mesh, &vertex_of);
    welded
}

/// What else two vertices must share to become one wedge.
fn attribute_key(vertex: &MeshVertex, epsilon: f64) -> u64 {
    let [u, v] = vertex.tex_coord;
    if u == 0.0 && v == 0.0 {
        return u64::from(vertex.surface);
    }
    let bits = |c: f32| if epsilon > 0.0 { (c * TEXTURE_STEPS).round() + 0.0 } else { c }.to_bits();
    // Equal keys of different vertices only let one take the other's coordinates, which differ by
    // less than a step or by a chance of 2^-48.
    let mixed = (u64::from(bits(u)) << 32 | u64::from(bits(v))).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    mixed << 16 | u64::from(vertex.surface)
}

/// Corners in an order that repeats share, the least first.
fn repeat_key([a, b, c]: [u32; 3], each_way: bool) -> [u32; 3] {
    if each_way {
        return match a.min(b).min(c) {
            least if least == a => [a, b, c],
            least if least == b => [b, c, a],
            _ => [c, a, b],
        };
    }
    let mut key = [a, b, c];
    key.sort_unstable();
    key
}

impl Welded {
    /// Whether any wedge has texture coordinates.
    pub fn has_texture(&self) -> bool {
        self.vertices.iter().any(|vertex| vertex.tex_coord != [0.0; 2])
    }

    /// Where a wedge stands: the same number for all wedges of a position, below [`Self::places`].
    pub(crate) fn place(&self, wedge: u32) -> usize {
        self.sources[wedge as usize] as usize
    }

    /// How many numbers there are for places.
    pub(crate) fn places(&self) -> usize {
        self.sources.iter().max().map_or(0, |&last| last as usize + 1)
    }

    /// Way on the surface, mesh units, for a step of 1 in texture coordinates: the mean over the area
    /// that has any; 0 if none has.
    pub(crate) fn way_per_texture(&self) -> f64 {
        let mut areas = (0.0f64, 0.0f64);
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|vertex| &self.vertices[vertex as usize]);
            let side = |from: &MeshVertex, to: &MeshVertex| {
                let [u, v]: [f64; 2] =
                    std::array::from_fn(|k| f64::from(to.tex_coord[k] - from.tex_coord[k]));
                (to.position - from.position, u, v)
            };
            let ((ab, bu, bv), (ac, cu, cv)) = (side(a, b), side(a, c));
            let on_texture = (bu * cv - bv * cu).abs();
            if on_texture > 0.0 {
                areas.0 += ab.cross(ac).length();
                areas.1 += on_texture;
            }
        }
        if areas.1 > 0.0 { (areas.0 / areas.1).sqrt() } else { 0.0 }
    }

    /// Sorts the source normals by welded vertex, and takes their means.
    fn gather_normals(&mut self, mesh: &Mesh, vertex_of: &[u32]) {
        let mut start = vec![0u32; self.vertices.len() + 1];
        vertex_of.iter().for_each(|&vertex| start[vertex as usize + 1] += 1);
        (1..start.len()).for_each(|i| start[i] += start[i - 1]);
        let mut next = start.clone();
        self.normals = vec![(Vec3::ZERO, 1.0); vertex_of.len()];
        for ((source, turned), &vertex) in mesh.vertices.iter().zip(turned(mesh)).zip(vertex_of) {
            self.normals[next[vertex as usize] as usize] = (source.normal, turned);
            next[vertex as usize] += 1;
        }
        for (vertex, range) in self.vertices.iter_mut().zip(start.windows(2)) {
            let own = &self.normals[range[0] as usize..range[1] as usize];
            vertex.normal = own.iter().map(|own| own.0).sum::<Vec3>().normalize_or_zero();
        }
        self.normal_start = start;
    }

    /// The mesh of `triangles`, which name vertices of this one. Each corner gets the source normal
    /// of its vertex that is nearest to the triangle's own, whichever way that faces, so that smooth
    /// parts stay smooth. Where that is too far from it, the face has left a bend that the normal stood
    /// for, and gets its own. A chord of a curve as long as `h` that strays by `e` turns from either end
    /// by `4 e / h` radians. `strayed` is how far the triangles are from those before, at most; few are
    /// as far, so half of that turn is not too far, beside what the normal turned from its faces
    /// before. Triangles without area are left out. With it, for each of its vertices, the vertex of the
    /// mesh welded that its position is from.
    pub fn with_triangles(&self, triangles: &[[u32; 3]], strayed: f64) -> (Mesh, Vec<u32>) {
        let mut mesh = Mesh::default();
        let mut sources = Vec::new();
        let mut made = Lists::new(self.vertices.len());
        for triangle in triangles {
            let corners = triangle.map(|wedge| self.vertices[wedge as usize].position);
            let Some(face) = face_normal(corners) else { continue };
            let turn = Turn::of((2.0 * strayed / height(corners)).min(MOST_TURN));
            mesh.triangles.push(triangle.map(|wedge| {
                let normal = self.nearest_normal(wedge as usize, face.as_vec3(), turn);
                let bits = normal.to_array().map(f32::to_bits);
                let known = made.find(wedge, |vertex| {
                    mesh.vertices[vertex as usize].normal.to_array().map(f32::to_bits) == bits
                });
                known.unwrap_or_else(|| {
                    mesh.vertices.push(MeshVertex { normal, ..self.vertices[wedge as usize] });
                    sources.push(self.sources[wedge as usize]);
                    made.put(wedge)
                })
            }));
        }
        (mesh, sources)
    }

    /// `turn`: how far a normal may turn more than before.
    fn nearest_normal(&self, vertex: usize, face: Vec3, turn: Turn) -> Vec3 {
        let range = self.normal_start[vertex] as usize..self.normal_start[vertex + 1] as usize;
        let mut best = (LEAST_NORMAL_COSINE, face);
        for &(normal, before) in &self.normals[range] {
            let cosine = normal.dot(face).abs();
            let least = before * turn.cos - (1.0 - before * before).max(0.0).sqrt() * turn.sin;
            if cosine > best.0 && cosine >= least - TURN_ROUNDING {
                best = (cosine, normal);
            }
        }
        best.1
    }
}

/// An angle by its cosine and sine, which no library's own rounding reaches.
#[derive(Debug, Clone, Copy)]
struct Turn {
    cos: f32,
    sin: f32,
}

impl Turn {
    /// The turn by about `radians`, at most a right angle: exactly by twice the angle whose tangent is half
    /// of it.
    fn of(radians: f64) -> Self {
        let t = 0.5 * radians;
        let square = t * t;
        Self {
            cos: ((1.0 - square) / (1.0 + square)) as f32,
            sin: (2.0 * t / (1.0 + square)) as f32,
        }
    }
}

/// By vertex, the cosine of how far its normal turns from any face that it shades, whichever way that
/// faces.
fn turned(mesh: &Mesh) -> Vec<f32> {
    let mut least = vec![1.0f32; mesh.vertices.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = mesh.corners(*triangle);
        let (ab, ac) = ((b - a).as_vec3(), (c - a).as_vec3());
        let across = ab.cross(ac);
        let length = across.length();
        // A needle faces nowhere.
        if length <= NEEDLE * ab.length_squared().max(ac.length_squared()) {
            continue;
        }
        let face = across / length;
        for &v in triangle {
            let cosine = mesh.vertices[v as usize].normal.dot(face).abs();
            least[v as usize] = least[v as usize].min(cosine);
        }
    }
    least
}

/// The least height of a triangle.
fn height([a, b, c]: [DVec3; 3]) -> f64 {
    let longest2 = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
    ((b - a).cross(c - a).length_squared() / longest2).sqrt()
}

/// Vertices by place, to find those near a point.
struct Places<'a> {
    mesh: &'a Mesh,
    epsilon: f64,
    origin: DVec3,
    /// A cell is twice as wide as the reach: whatever is within reach lies in the eight cells
    /// nearest. An epsilon too small for 64-bit cell numbers saturates them: slower, still right.
    cells_per_unit: f64,
    newest: HashMap<(i64, i64, i64), u32, FastHash>,
    older: Vec<u32>,
}

impl<'a> Places<'a> {
    fn new(mesh: &'a Mesh, epsilon: f64) -> Self {
        Self {
            mesh,
            epsilon,
            origin: mesh.bounds().min,
            cells_per_unit: if epsilon > 0.0 { 0.5 / epsilon } else { 0.0 },
            newest: HashMap::with_capacity_and_hasher(mesh.vertices.len(), FastHash::default()),
            older: vec![u32::MAX; mesh.vertices.len()],
        }
    }

    /// The cell of a point, and for each axis on which side the nearest neighbour lies.
    fn cell(&self, p: DVec3) -> ([i64; 3], [i64; 3]) {
        if self.epsilon == 0.0 {
            // Adding zero makes -0 and 0 the same key.
            return (p.to_array().map(|c| (c + 0.0).to_bits() as i64), [0; 3]);
        }
        let scaled = (p - self.origin) * self.cells_per_unit;
        let floor = scaled.floor();
        let side = |k: usize| if scaled[k] - floor[k] < 0.5 { -1 } else { 1 };
        (floor.to_array().map(|c| c as i64), [side(0), side(1), side(2)])
    }

    /// The nearest vertex put in so far that is within reach, the last one of several, and the
    /// square of its distance.
    fn nearest(&self, p: DVec3) -> Option<(u32, f64)> {
        let (cell, sides) = self.cell(p);
        let mut best = (self.epsilon * self.epsilon, u32::MAX);
        for corner in 0..if self.epsilon > 0.0 { 8 } else { 1 } {
            let key: [i64; 3] = std::array::from_fn(|k| {
                cell[k].wrapping_add(if corner >> k & 1 == 1 { sides[k] } else { 0 })
            });
            let mut candidate = self.newest.get(&key.into()).copied().unwrap_or(u32::MAX);
            while candidate != u32::MAX {
                let d = self.mesh.vertices[candidate as usize].position.distance_squared(p);
                if (d, candidate) <= best {
                    best = (d, candidate);
                }
                candidate = self.older[candidate as usize];
            }
        }
        (best.1 != u32::MAX).then_some((best.1, best.0))
    }

    fn put(&mut self, index: usize) {
        let (cell, _) = self.cell(self.mesh.vertices[index].position);
        if let Some(before) = self.newest.insert(cell.into(), index as u32) {
            self.older[index] = before;
        }
    }
}

/// For each vertex the vertex whose position it takes, and the farthest move.
fn representatives(mesh: &Mesh, epsilon: f64, stays: &[bool]) -> (Vec<u32>, f64) {
    let mut places = Places::new(mesh, epsilon);
    let mut representative: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    for (index, vertex) in mesh.vertices.iter().enumerate().filter(|(i, _)| stays[*i]) {
        // Only a vertex in the very same place is the same corner of the border.
        match places.nearest(vertex.position) {
            Some((other, 0.0)) => representative[index] = other,
            _ => places.put(index),
        }
    }
    let mut farthest = 0.0f64;
    for (index, vertex) in mesh.vertices.iter().enumerate().filter(|(i, _)| !stays[*i]) {
        match places.nearest(vertex.position) {
            Some((other, squared)) => {
                representative[index] = other;
                farthest = farthest.max(squared);
            }
            None => places.put(index),
        }
    }
    (representative, farthest.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::tests::{mesh_of, sphere};

    #[test]
    fn nothing_and_a_point_weld_to_nothing() {
        assert!(weld(&Mesh::default(), Weld::within(1.0)).triangles.is_empty());
        let point = mesh_of(&[[5.0; 3]; 3], &[[0, 1, 2]]);
        let welded = weld(&point, Weld::within(0.0));
        assert!(welded.triangles.is_empty());
        assert_eq!(welded.vertices.len(), 1);
        assert_eq!(welded.displacement, 0.0);
    }

    #[test]
    fn repeats_go_whichever_way_they_face() {
        let p = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, -0.0]];
        let mesh = mesh_of(&[p[0], p[1], p[2], p[2], p[1], p[0]], &[[0, 1, 2], [3, 4, 5]]);
        assert_eq!(weld(&mesh, Weld::within(0.0)).triangles, [[0, 1, 2]]);
    }

    #[test]
    fn a_side_that_is_seen_from_one_side_keeps_its_back() {
        let p = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let mesh = mesh_of(&p, &[[0, 1, 2], [2, 1, 0], [1, 2, 0]]);
        let how = Weld { repeats: &[Repeats::EachWay], ..Weld::within(0.0) };
        assert_eq!(weld(&mesh, how).triangles, [[0, 1, 2], [2, 1, 0]]);
        let how = Weld { repeats: &[Repeats::All], ..Weld::within(0.0) };
        assert_eq!(weld(&mesh, how).triangles, [[0, 1, 2], [2, 1, 0], [1, 2, 0]]);
    }

    #[test]
    fn borders_stay_until_both_sides_have_met() {
        let mut mesh = mesh_of(
            &[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.01, 0.0, 0.0], [0.02, 0.0, 0.0]],
            &[[0, 1, 2], [3, 1, 2], [4, 1, 2]],
        );
        mesh.vertices[3].seam = 2;
        mesh.vertices[4].seam = 2;
        let deep = weld(&mesh, Weld { depth: 3, ..Weld::within(0.1) });
        assert_eq!(deep.locked, [true, false, false, true]);
        assert_eq!(deep.vertices[0].position.x, 0.01, "the free vertex moves to the border");
        assert_eq!(deep.triangles.len(), 2);
        let above = weld(&mesh, Weld { depth: 2, ..Weld::within(0.1) });
        assert!(above.locked.iter().all(|locked| !locked));
        assert_eq!(above.triangles.len(), 1);
    }

    #[test]
    fn texture_coordinates_and_surfaces_stay_apart() {
        let mut mesh = mesh_of(&[[0.0; 3]; 5], &[]);
        mesh.vertices[1].tex_coord = [0.5, 0.25];
        mesh.vertices[2].tex_coord = [0.5, 0.26];
        mesh.vertices[3].tex_coord = [0.25, 0.5];
        mesh.vertices[4].surface = 3;
        assert_eq!(weld(&mesh, Weld::within(0.0)).vertices.len(), 5);
        assert_eq!(weld(&mesh, Weld::within(0.1)).vertices.len(), 4);
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
        let closed = weld(&mesh, Weld::within(gap * 1.001));
        assert_eq!(closed.vertices.len(), 4);
        assert!((closed.displacement - gap).abs() < 1e-12);
        assert_eq!(weld(&mesh, Weld::within(gap * 0.999)).vertices.len(), 6);
    }

    #[test]
    fn colours_stay_apart_at_one_shared_position() {
        let mut mesh =
            mesh_of(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.01, 0.0, 0.0]], &[[0, 1, 2]]);
        mesh.vertices[3].color = [255, 0, 0, 255];
        let welded = weld(&mesh, Weld::within(0.1));
        assert_eq!(welded.vertices.len(), 4);
        assert_eq!(welded.vertices[3].position, welded.vertices[0].position);
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
        let welded = weld(&mesh_of(&positions, &[]), Weld::within(epsilon));
        assert_eq!(welded.vertices.len(), 500);
        assert!(welded.displacement <= epsilon);
    }

    #[test]
    fn corners_keep_smooth_normals_and_turned_faces_get_their_own() {
        let ball = sphere(16, 32);
        let welded = weld(&ball, Weld::within(0.0));
        let (smooth, sources) = welded.with_triangles(&welded.triangles, 0.0);
        for (vertex, source) in smooth.vertices.iter().zip(sources) {
            assert_eq!(vertex.position, ball.vertices[source as usize].position);
        }
        assert_eq!(smooth.triangles.len(), ball.triangles.len());
        assert!(smooth.vertices.iter().all(|v| v.normal.dot(v.position.as_vec3()) > 0.999));
        let mut wall = mesh_of(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], &[[0, 1, 2]]);
        wall.vertices[0].normal = Vec3::Y;
        let welded = weld(&wall, Weld::within(0.0));
        let shaded = welded.with_triangles(&welded.triangles, 0.0).0;
        assert!(shaded.vertices.iter().all(|v| v.normal.y.abs() > 0.999), "{shaded:?}");
    }

    #[test]
    fn a_face_that_has_left_its_bend_is_flat_unless_it_may_be_a_chord() {
        // A floor, and the narrow slope along its edge.
        let p =
            [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -0.1, -0.05], [1.0, -0.1, -0.05]];
        let mut bent = mesh_of(&p, &[[0, 1, 2], [0, 3, 1], [3, 4, 1]]);
        let slope = Vec3::new(0.0, -0.5, 1.0).normalize();
        bent.vertices[3..].iter_mut().for_each(|vertex| vertex.normal = slope);
        let welded = weld(&bent, Weld::within(0.0));
        let normal_of = |strayed| welded.with_triangles(&[[3, 4, 2]], strayed).0.vertices[0].normal;
        assert!(normal_of(0.0).dot(slope) < 0.95);
        assert_eq!(normal_of(1.0), slope);
    }
}
