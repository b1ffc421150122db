//! Pieces: what leaves are made of. Each lies on a grid, and knows which of its vertices other pieces
//! share.

use crate::bytes::{Decoder, Encoder, Torn};
use crate::pack;
use geometry::bounds::Aabb;
use geometry::hash::FastHash;
use geometry::mesh::{Mesh, MeshVertex};
use glam::{DVec3, Vec3};
use protocol::format::Vertex;
use std::collections::HashMap;

/// Stands for all pieces of a mesh.
pub(crate) const ALL_PIECES: u32 = u32::MAX;

/// Part of a mesh on its grid, in the world or in the space of a shared mesh.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PieceMesh {
    /// Position of grid point (0, 0, 0).
    pub(crate) origin: DVec3,
    /// Size of a grid step.
    pub(crate) step: f64,
    /// How far rounding has moved a vertex at most. More than a step where it shares one with a piece on a
    /// coarser grid.
    pub(crate) error: f64,
    pub(crate) vertices: Vec<Vertex>,
    /// One a vertex, or none.
    tex_coords: Vec<[f32; 2]>,
    /// One a vertex, or a single one for all.
    surfaces: Vec<u16>,
    pub(crate) triangles: Vec<[u16; 3]>,
    /// Vertices that other pieces of the mesh have, too: (vertex, other piece counted within the
    /// mesh, or [`ALL_PIECES`]).
    pub(crate) seams: Vec<[u32; 2]>,
    /// Triangles of the source in it, those included that have no area on the grid.
    pub(crate) source_triangles: u64,
}

impl PieceMesh {
    /// Packs a mesh whose vertices lie on the grid of `step`, moved there by `error` at most; `None` when no triangle has three
    /// different corners. Equal vertices become one, in order of first use.
    pub(crate) fn of(mesh: &Mesh, step: f64, error: f64) -> Option<Self> {
        let has_area = |t: &&[u32; 3]| {
            let [a, b, c] = mesh.corners(**t);
            a != b && b != c && c != a
        };
        let used: Vec<[u32; 3]> = mesh.triangles.iter().filter(has_area).copied().collect();
        let corners = used.iter().flat_map(|t| mesh.corners(*t));
        let origin = corners.fold(DVec3::INFINITY, DVec3::min);
        let mut piece = Self {
            origin,
            step,
            error,
            vertices: Vec::new(),
            tex_coords: Vec::new(),
            surfaces: Vec::new(),
            triangles: Vec::with_capacity(used.len()),
            seams: Vec::new(),
            source_triangles: mesh.triangles.len() as u64,
        };
        let mut ids: HashMap<([u32; 4], [u32; 2], u16), u16, FastHash> = HashMap::default();
        let mut place = vec![u16::MAX; mesh.vertices.len()];
        for triangle in &used {
            let corners = triangle.map(|index| {
                let index = index as usize;
                if place[index] == u16::MAX {
                    let vertex = &mesh.vertices[index];
                    let packed = pack::vertex(vertex, origin, step);
                    let [x, y] = packed.position;
                    let key = (
                        [x, y, packed.normal, packed.color],
                        vertex.tex_coord.map(f32::to_bits),
                        vertex.surface,
                    );
                    place[index] = *ids.entry(key).or_insert_with(|| {
                        piece.vertices.push(packed);
                        piece.tex_coords.push(vertex.tex_coord);
                        piece.surfaces.push(vertex.surface);
                        (piece.vertices.len() - 1) as u16
                    });
                }
                place[index]
            });
            piece.triangles.push(corners);
        }
        if piece.tex_coords.iter().all(|&coords| coords == [0.0; 2]) {
            piece.tex_coords = Vec::new();
        }
        if piece.surfaces.windows(2).all(|pair| pair[0] == pair[1]) {
            piece.surfaces.truncate(1);
        }
        (!used.is_empty()).then_some(piece)
    }

    /// Position of a vertex.
    pub(crate) fn position(&self, vertex: &Vertex) -> DVec3 {
        self.origin + DVec3::from_array(vertex.grid().map(f64::from)) * self.step
    }

    /// The box around its vertices.
    pub(crate) fn bounds(&self) -> Aabb {
        Aabb::of(self.vertices.iter().map(|vertex| self.position(vertex)))
    }

    /// Its mesh. `seam` tells for another piece of the mesh at which depth it is met.
    pub(crate) fn mesh(&self, mut seam: impl FnMut(u32) -> u8) -> Mesh {
        let vertex = |(i, vertex): (usize, &Vertex)| MeshVertex {
            tex_coord: self.tex_coords.get(i).copied().unwrap_or_default(),
            surface: self.surfaces[i.min(self.surfaces.len() - 1)],
            ..MeshVertex::plain(
                self.position(vertex),
                Vec3::from_array(Vertex::unpack_normal(vertex.normal)).normalize_or_zero(),
                vertex.color.to_le_bytes(),
            )
        };
        let mut mesh = Mesh {
            vertices: self.vertices.iter().enumerate().map(vertex).collect(),
            triangles: self.triangles.iter().map(|t| t.map(u32::from)).collect(),
        };
        for &[vertex, other] in &self.seams {
            let own = &mut mesh.vertices[vertex as usize].seam;
            *own = (*own).min(seam(other));
        }
        mesh
    }

    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut out = Encoder::default();
        out.put(self.origin.to_array());
        out.put([self.step, self.error]);
        out.put(self.source_triangles);
        out.put_slice(&self.vertices);
        out.put_slice(&self.tex_coords);
        out.put_slice(&self.surfaces);
        out.put_slice(&self.triangles);
        out.put_slice(&self.seams);
        out.0
    }

    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, Torn> {
        let mut from = Decoder(bytes);
        let origin = DVec3::from_array(from.take()?);
        let [step, error] = from.take()?;
        let piece = Self {
            origin,
            step,
            error,
            source_triangles: from.take()?,
            vertices: from.take_slice()?,
            tex_coords: from.take_slice()?,
            surfaces: from.take_slice()?,
            triangles: from.take_slice()?,
            seams: from.take_slice()?,
        };
        from.end()?;
        let count = piece.vertices.len();
        let sound = !piece.surfaces.is_empty()
            && piece.triangles.as_flattened().iter().all(|&v| usize::from(v) < count)
            && piece.seams.iter().all(|seam| (seam[0] as usize) < count);
        if sound { Ok(piece) } else { Err(Torn) }
    }

    /// Takes over the seams of `finer`, of which it is a coarser form on the same grid.
    pub(crate) fn inherit_seams(&mut self, finer: &Self) {
        let mut others: HashMap<[u64; 3], Vec<u32>, FastHash> = HashMap::default();
        for &[vertex, other] in &finer.seams {
            let at = finer.position(&finer.vertices[vertex as usize]);
            let known = others.entry(at.to_array().map(f64::to_bits)).or_default();
            if !known.contains(&other) {
                known.push(other);
            }
        }
        for (index, vertex) in self.vertices.iter().enumerate() {
            let at = self.position(vertex).to_array().map(f64::to_bits);
            let sharers = others.get(&at).map_or(&[][..], Vec::as_slice);
            self.seams.extend(sharers.iter().map(|&other| [index as u32, other]));
        }
    }
}
