//! Quantising positions to a power-of-two grid, and meshes to the bytes of a blob.
//!
//! All grids share the origin of their space: every position is a whole multiple of its step. So
//! a coarser grid is a subset of a finer one; `grid` says how pieces on different ones close.

use crate::bytes::{Decoder, Encoder, Torn};
use crate::source::{Alpha, Surface};
use geometry::hash::FastHash;
use geometry::mesh::{Mesh, MeshVertex};
use glam::DVec3;
use protocol::format::vertex::{MAX_BLOB_VERTICES, POSITION_MAX};
use protocol::format::{Class, NONE, TexturedVertex, Vertex, Vertices};
use std::collections::HashMap;

/// Bits of a grid coordinate in its space that stay exact in `f64`, with room to add two.
const EXACT_BITS: i32 = 50;
/// Finest step: far above the least normal `f32`, which steps are handed to a GPU in.
const FINEST_STEP: f64 = 1.0 / (1u128 << 100) as f64;

/// A mesh as it will lie in the file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Packed {
    /// Position of grid point 0.
    pub(crate) origin: [f64; 3],
    /// Size of a grid step.
    pub(crate) step: f64,
    /// Vertices, where none needs a texture or a mask.
    plain: Vec<Vertex>,
    /// Vertices, where one does.
    textured: Vec<TexturedVertex>,
    pub(crate) indices: Vec<u16>,
    /// Triangles by class, in which order they lie.
    pub(crate) classes: [u32; Class::COUNT],
}

impl Packed {
    /// Its vertices, as a writer takes them.
    pub(crate) fn vertices(&self) -> Vertices<'_> {
        if self.textured.is_empty() {
            Vertices::Plain(&self.plain)
        } else {
            Vertices::Textured(&self.textured)
        }
    }

    /// Positions as a reader decodes them.
    pub(crate) fn positions(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        let vertices = self.plain.iter().chain(self.textured.iter().map(|vertex| &vertex.plain));
        vertices.map(|vertex| {
            let grid = vertex.grid();
            std::array::from_fn(|k| self.origin[k] + self.step * f64::from(grid[k]))
        })
    }

    /// Length of the longest edge of its triangles, mesh units.
    pub(crate) fn longest_edge(&self) -> f64 {
        let positions: Vec<DVec3> = self.positions().map(DVec3::from_array).collect();
        let corner = |index: u16| positions[usize::from(index)];
        let triangles = self.indices.chunks_exact(3);
        let edges = triangles.flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
        let squared = edges.map(|(a, b)| corner(a).distance_squared(corner(b)));
        squared.fold(0.0, f64::max).sqrt()
    }

    pub(crate) fn triangles(&self) -> u32 {
        (self.indices.len() / 3) as u32
    }

    pub(crate) fn encode(&self, out: &mut Encoder) {
        out.put(self.origin);
        out.put(self.step);
        out.put_slice(&self.plain);
        out.put_slice(&self.textured);
        out.put_slice(&self.indices);
        out.put(self.classes);
    }

    pub(crate) fn decode(from: &mut Decoder<'_>) -> Result<Self, Torn> {
        Ok(Self {
            origin: from.take()?,
            step: from.take()?,
            plain: from.take_slice()?,
            textured: from.take_slice()?,
            indices: from.take_slice()?,
            classes: from.take()?,
        })
    }
}

/// How triangles of a surface are drawn.
fn class_of(surface: &Surface) -> Class {
    match (surface.alpha, surface.double_sided) {
        (Alpha::Opaque, false) => Class::OpaqueSingle,
        (Alpha::Opaque, true) => Class::OpaqueDouble,
        (Alpha::Mask(_), false) => Class::MaskSingle,
        (Alpha::Mask(_), true) => Class::MaskDouble,
        (Alpha::Blend, false) => Class::BlendSingle,
        (Alpha::Blend, true) => Class::BlendDouble,
    }
}

/// Whether vertices of a surface are textured ones: they hold the cutoff, too.
fn needs_texture(surface: &Surface) -> bool {
    surface.texture.is_some() || matches!(surface.alpha, Alpha::Mask(_))
}

/// The finest step on which something of this extent fits a blob, its coordinates being at most
/// `farthest` from 0.
pub(crate) fn finest_step(extent: f64, farthest: f64) -> f64 {
    // One step of room for the rounding of either end.
    let by_extent = power_of_two_at_least(extent / f64::from(POSITION_MAX - 1));
    by_extent.max(coarsest_exact(farthest)).max(FINEST_STEP)
}

/// The step below which coordinates as large as `farthest` are no longer exact.
fn coarsest_exact(farthest: f64) -> f64 {
    power_of_two_at_least(farthest * 0.5f64.powi(EXACT_BITS))
}

/// The least power of two that is at least `x`; [`FINEST_STEP`] for anything smaller.
pub(crate) fn power_of_two_at_least(x: f64) -> f64 {
    assert!(x.is_finite());
    let x = x.max(FINEST_STEP);
    // Clearing the mantissa rounds down to a power of two.
    let below = f64::from_bits(x.to_bits() & 0x7ff0_0000_0000_0000);
    if below < x { below * 2.0 } else { below }
}

/// Moves every vertex to the nearest grid point; returns the farthest move, at most
/// `step * sqrt(3) / 2`. Triangles stay, even where they lose their area.
pub(crate) fn snap(mesh: &mut Mesh, step: f64) -> f64 {
    let mut farthest = 0.0f64;
    for vertex in &mut mesh.vertices {
        let snapped = snapped(vertex.position, step);
        farthest = farthest.max(snapped.distance_squared(vertex.position));
        vertex.position = snapped;
    }
    farthest.sqrt()
}

/// The nearest grid point. Exact but for the rounding itself: dividing by a power of two is.
pub(crate) fn snapped(p: DVec3, step: f64) -> DVec3 {
    (p / step).round() * step
}

/// A vertex on the grid that begins at `origin`.
///
/// # Panics
/// If it lies off the grid.
pub(crate) fn vertex(vertex: &MeshVertex, origin: DVec3, step: f64) -> Vertex {
    let grid = (vertex.position - origin) / step;
    assert!(grid == grid.round() && grid.max_element() <= f64::from(POSITION_MAX), "{grid} {step}");
    Vertex {
        position: Vertex::pack_position(grid.to_array().map(|c| c as u32)),
        normal: Vertex::pack_normal(vertex.normal.to_array()),
        color: u32::from_le_bytes(vertex.color),
    }
}

/// Packs a mesh whose vertices lie on the grid of `step`; `None` when no triangle has three different
/// corners. Triangles are sorted by class, and equal vertices become one, in order of first use.
///
/// # Panics
/// If a vertex lies off the grid, or the mesh is too large for it or for 16-bit indices.
pub(crate) fn pack(mesh: &Mesh, step: f64, surfaces: &[Surface]) -> Option<Packed> {
    let surface_of = |t: &[u32; 3]| &surfaces[usize::from(mesh.vertices[t[0] as usize].surface)];
    let mut used: Vec<[u32; 3]> = Vec::with_capacity(mesh.triangles.len());
    let mut classes = [0; Class::COUNT];
    for triangle in &mesh.triangles {
        let [a, b, c] = mesh.corners(*triangle);
        if a != b && b != c && c != a {
            used.push(*triangle);
            classes[class_of(surface_of(triangle)) as usize] += 1;
        }
    }
    if used.is_empty() {
        return None;
    }
    if classes.iter().filter(|&&count| count > 0).count() > 1 {
        used.sort_by_key(|triangle| class_of(surface_of(triangle)));
    }
    let is_textured = used.iter().any(|triangle| needs_texture(surface_of(triangle)));
    let corners = used.iter().flat_map(|t| mesh.corners(*t));
    let origin = corners.fold(DVec3::INFINITY, DVec3::min);
    let mut packed = Packed {
        origin: origin.to_array(),
        step,
        plain: Vec::new(),
        textured: Vec::new(),
        indices: Vec::with_capacity(3 * used.len()),
        classes,
    };
    let mut ids: HashMap<[u64; 4], u16, FastHash> =
        HashMap::with_capacity_and_hasher(mesh.vertices.len(), FastHash::default());
    let mut place: Vec<Option<u16>> = vec![None; mesh.vertices.len()];
    for index in used.into_iter().flatten() {
        let id = *place[index as usize].get_or_insert_with(|| {
            let source = &mesh.vertices[index as usize];
            let plain = vertex(source, origin, step);
            let textured = is_textured.then(|| textured(source, plain, surfaces));
            let [u, v, texture, cutoff] = textured.map_or([0; 4], |t| {
                [t.tex_coord[0].to_bits(), t.tex_coord[1].to_bits(), t.texture, t.cutoff.to_bits()]
            });
            let [x, y] = plain.position;
            let pair = |a: u32, b: u32| u64::from(a) << 32 | u64::from(b);
            let key =
                [pair(x, y), pair(plain.normal, plain.color), pair(u, v), pair(texture, cutoff)];
            *ids.entry(key).or_insert_with(|| {
                match textured {
                    Some(vertex) => packed.textured.push(vertex),
                    None => packed.plain.push(plain),
                }
                let count = packed.plain.len() + packed.textured.len();
                assert!(count <= MAX_BLOB_VERTICES, "a mesh outgrew its indices");
                (count - 1) as u16
            })
        });
        packed.indices.push(id);
    }
    Some(packed)
}

fn textured(source: &MeshVertex, plain: Vertex, surfaces: &[Surface]) -> TexturedVertex {
    let surface = &surfaces[usize::from(source.surface)];
    let cutoff = if let Alpha::Mask(cutoff) = surface.alpha { cutoff } else { 0.0 };
    let texture = surface.texture.unwrap_or(NONE);
    TexturedVertex { plain, tex_coord: source.tex_coord, texture, cutoff }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::mesh::MeshVertex;
    use glam::Vec3;

    fn triangle(corners: [[f64; 3]; 3]) -> Mesh {
        let vertex = |p| MeshVertex::plain(DVec3::from_array(p), Vec3::Z, [1, 2, 3, 4]);
        Mesh { vertices: corners.map(vertex).to_vec(), triangles: vec![[0, 1, 2]] }
    }

    #[test]
    fn powers_of_two() {
        assert_eq!(power_of_two_at_least(0.0), FINEST_STEP);
        assert_eq!(power_of_two_at_least(1.0), 1.0);
        assert_eq!(power_of_two_at_least(1.0 + f64::EPSILON), 2.0);
        assert_eq!(power_of_two_at_least(0.3), 0.5);
        assert_eq!(power_of_two_at_least(1e20), 147573952589676412928.0);
    }

    #[test]
    fn what_has_no_area_on_the_grid_is_not_packed() {
        assert_eq!(pack(&Mesh::default(), 1.0, &[Surface::PLAIN]), None);
        assert_eq!(pack(&triangle([[1e7; 3]; 3]), 1.0, &[Surface::PLAIN]), None);
        let mut needle = triangle([[0.0; 3], [0.2, 0.0, 0.0], [4.0, 0.0, 0.0]]);
        assert_eq!(snap(&mut needle, 1.0), 0.2);
        assert_eq!(pack(&needle, 1.0, &[Surface::PLAIN]), None);
    }

    #[test]
    fn decoding_is_exact_at_any_scale_and_distance() {
        for (scale, offset) in [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1e-3, 1e7), (3.0, -1e7)] {
            let mut mesh =
                triangle([[0.0; 3], [scale, 0.1 * scale, 0.0], [0.0, scale, 0.7 * scale]]);
            mesh.vertices.iter_mut().for_each(|v| v.position += offset);
            let before = mesh.clone();
            let step = finest_step(scale, offset.abs() + scale);
            let moved = snap(&mut mesh, step);
            assert!(moved <= step * 0.867, "{moved} {step}");
            let packed = pack(&mesh, step, &[Surface::PLAIN]).unwrap();
            for (decoded, vertex) in packed.positions().zip(&mesh.vertices) {
                assert_eq!(decoded, vertex.position.to_array());
            }
            for (decoded, vertex) in packed.positions().zip(&before.vertices) {
                assert!(DVec3::from_array(decoded).distance(vertex.position) <= step * 0.867);
            }
            // A step of 2^-21 of the extent, or the last bits of the coordinates.
            assert!(step <= scale / (1 << 20) as f64 || step <= offset.abs() * 1e-14, "{step}");
        }
    }

    #[test]
    #[should_panic(expected = "1")]
    fn a_mesh_off_its_grid_is_a_bug() {
        pack(&triangle([[0.0; 3], [1.5, 0.0, 0.0], [0.0, 1.0, 0.0]]), 1.0, &[Surface::PLAIN]);
    }

    #[test]
    fn equal_vertices_become_one() {
        let mut mesh = triangle([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        mesh.append(&triangle([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]));
        let packed = pack(&mesh, 1.0, &[Surface::PLAIN]).unwrap();
        assert_eq!(packed.vertices().count(), 4);
        assert_eq!(packed.indices, [0, 1, 2, 3, 2, 1]);
    }

    #[test]
    fn triangles_lie_by_class_and_textures_cost_only_where_they_are() {
        let mut mesh = triangle([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        for surface in 1..4 {
            let mut other = triangle([[0.0; 3], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]);
            other.vertices.iter_mut().for_each(|vertex| vertex.surface = 4 - surface);
            mesh.append(&other);
        }
        let plain = |alpha, double_sided| Surface { alpha, double_sided, texture: None };
        let mut surfaces = vec![
            plain(Alpha::Blend, true),
            plain(Alpha::Opaque, false),
            Surface::PLAIN,
            plain(Alpha::Opaque, true),
        ];
        let packed = pack(&mesh, 1.0, &surfaces).unwrap();
        assert_eq!(packed.classes, [1, 2, 0, 0, 0, 1]);
        assert!(matches!(packed.vertices(), Vertices::Plain(vertices) if vertices.len() == 3));
        surfaces[3] = Surface { alpha: Alpha::Mask(0.25), double_sided: false, texture: Some(7) };
        let packed = pack(&mesh, 1.0, &surfaces).unwrap();
        assert_eq!(packed.classes, [1, 1, 1, 0, 0, 1]);
        let Vertices::Textured(vertices) = packed.vertices() else { panic!("not textured") };
        let masked = packed.indices[6] as usize;
        assert_eq!((vertices[masked].texture, vertices[masked].cutoff), (7, 0.25));
        assert_eq!((vertices[0].texture, vertices[0].cutoff), (NONE, 0.0));
        let mut out = Encoder::default();
        packed.encode(&mut out);
        assert_eq!(Packed::decode(&mut Decoder(&out.0)), Ok(packed));
    }
}
