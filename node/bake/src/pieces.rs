//! Pieces: what leaves are made of. Large meshes are divided top down (paper 004, section 2.2, the
//! first partition); each piece lies on a grid, and knows which of its vertices other pieces share.

use crate::bytes::{Decoder, Encoder, Torn};
use crate::options::Options;
use crate::pack;
use crate::source::SourceMesh;
use geometry::bounds::Aabb;
use geometry::hash::FastHash;
use geometry::mesh::{Mesh, MeshVertex, largest_stretch};
use geometry::partition::{Limits, TriangleBox, partition};
use glam::{DAffine3, DVec3, Vec3};
use protocol::format::Vertex;
use rayon::prelude::*;
use std::collections::HashMap;

/// Steps that an object's diagonal is divided into at least, however large the scene is.
const STEPS_PER_OBJECT: f64 = (1u32 << 16) as f64;
/// Steps that the scene's diagonal is divided into, unless an object demands finer or coarser ones.
const STEPS_PER_SCENE: f64 = (1u32 << 23) as f64;
/// More pieces than this round one vertex count as all of the mesh's.
const MOST_SHARERS: usize = 8;
/// Stands for all pieces of a mesh.
pub(crate) const ALL_PIECES: u32 = u32::MAX;

/// Part of a mesh on its grid, in the world or in the space of a shared mesh.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PieceMesh {
    /// Position of grid point (0, 0, 0).
    pub(crate) origin: DVec3,
    /// The same for all pieces of a mesh.
    pub(crate) step: f64,
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
    /// Packs a mesh whose vertices lie on the grid of `step`; `None` when no triangle has three
    /// different corners. Equal vertices become one, in order of first use.
    pub(crate) fn of(mesh: &Mesh, step: f64) -> Option<Self> {
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
        out.put(self.step);
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
        let piece = Self {
            origin: DVec3::from_array(from.take()?),
            step: from.take()?,
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

/// How a mesh is to be divided.
pub(crate) struct Slicer<'a> {
    pub(crate) options: &'a Options,
    /// Length of the whole scene's diagonal.
    pub(crate) scene_diagonal: f64,
}

impl Slicer<'_> {
    /// Pieces of a mesh that stands at `placements`: in the world if there is one, else in the mesh's
    /// own space. Those without an area on the grid are left out.
    pub(crate) fn pieces(&self, mesh: &SourceMesh, placements: &[DAffine3]) -> Vec<PieceMesh> {
        let place = match placements {
            [] => return Vec::new(),
            [only] => Some(only),
            _ => None,
        };
        // World sizes in units of the piece's own space.
        let stretch = match place {
            Some(_) => 1.0,
            None => placements.iter().map(|p| largest_stretch(&p.matrix3)).fold(0.0, f64::max),
        };
        let points: Vec<DVec3> = mesh
            .positions
            .par_iter()
            .map(|p| {
                let p = Vec3::from_array(*p).as_dvec3();
                place.map_or(p, |target_from_mesh| target_from_mesh.transform_point3(p))
            })
            .collect();
        let bounds = Aabb::of(mesh.indices.iter().flatten().map(|&i| points[i as usize]));
        if bounds.is_empty() {
            return Vec::new();
        }
        let center = bounds.center();
        let boxes: Vec<TriangleBox> = mesh
            .indices
            .par_iter()
            .map(|t| TriangleBox::of(t.map(|index| (points[index as usize] - center).as_vec3())))
            .collect();
        let limits = Limits {
            triangles: self.options.piece_triangles,
            // Infinite for a mesh that all its users flatten to a point: then nothing sprawls.
            extent: (self.scene_diagonal * self.options.piece_extent / stretch) as f32,
            least_triangles: self.options.piece_least_triangles,
        };
        let parts = partition(&boxes, &limits);
        drop(boxes);
        let step = self.common_step(mesh, &points, &parts, &bounds, self.scene_diagonal / stretch);
        let gatherer = Gatherer::new(mesh, &points, place, step);
        let mut pieces: Vec<PieceMesh> = parts
            .par_iter()
            .map_init(
                || vec![u32::MAX; mesh.positions.len()],
                |stamps, triangles| PieceMesh::of(&gatherer.gather(triangles, stamps), step),
            )
            .flatten_iter()
            .collect();
        find_seams(&mut pieces);
        pieces
    }

    /// One step for all pieces of a mesh: as fine as scene and object call for, as coarse as the
    /// largest piece needs.
    fn common_step(
        &self,
        mesh: &SourceMesh,
        points: &[DVec3],
        parts: &[Vec<u32>],
        bounds: &Aabb,
        scene_diagonal: f64,
    ) -> f64 {
        let farthest = bounds.min.abs().max(bounds.max.abs()).max_element();
        let extent_of = |triangles: &Vec<u32>| {
            let corners = triangles.iter().flat_map(|&t| mesh.indices[t as usize]);
            Aabb::of(corners.map(|index| points[index as usize])).extent().max_element()
        };
        let largest = parts.par_iter().map(extent_of).reduce(|| 0.0, f64::max);
        let wanted = bounds.diagonal() / STEPS_PER_OBJECT;
        let wanted = if scene_diagonal.is_finite() {
            wanted.min(scene_diagonal / STEPS_PER_SCENE)
        } else {
            wanted
        };
        pack::power_of_two_at_least(wanted).max(pack::finest_step(largest, farthest))
    }
}

/// Picks the triangles of pieces out of a mesh.
struct Gatherer<'a> {
    mesh: &'a SourceMesh,
    /// Positions in the space of the pieces.
    points: &'a [DVec3],
    place: Option<&'a DAffine3>,
    step: f64,
    /// One a vertex, or a single one for all.
    surfaces: Vec<u16>,
}

impl<'a> Gatherer<'a> {
    fn new(
        mesh: &'a SourceMesh,
        points: &'a [DVec3],
        place: Option<&'a DAffine3>,
        step: f64,
    ) -> Self {
        let surfaces = match &mesh.sections[..] {
            [] => vec![0],
            [only] => vec![only.surface],
            sections => {
                let mut surfaces = vec![0; mesh.positions.len()];
                let mut first = 0;
                for section in sections {
                    let corners = mesh.indices[first..section.end as usize].as_flattened();
                    corners.iter().for_each(|&v| surfaces[v as usize] = section.surface);
                    first = section.end as usize;
                }
                surfaces
            }
        };
        Self { mesh, points, place, step, surfaces }
    }

    /// A mesh on the grid. `stamps` is as long as the mesh's positions, all `u32::MAX` before and
    /// after.
    fn gather(&self, triangles: &[u32], stamps: &mut [u32]) -> Mesh {
        let mut used = Vec::new();
        let mut local = Vec::with_capacity(triangles.len());
        for &triangle in triangles {
            local.push(self.mesh.indices[triangle as usize].map(|index| {
                let stamp = &mut stamps[index as usize];
                if *stamp == u32::MAX {
                    *stamp = used.len() as u32;
                    used.push(index);
                }
                *stamp
            }));
        }
        used.iter().for_each(|&index| stamps[index as usize] = u32::MAX);
        let vertex = |&index: &u32| {
            let i = index as usize;
            MeshVertex {
                tex_coord: self.mesh.tex_coords.get(i).copied().unwrap_or_default(),
                surface: self.surfaces[i.min(self.surfaces.len() - 1)],
                ..MeshVertex::plain(
                    self.points[i],
                    Vec3::from_array(self.mesh.normals[i]),
                    self.mesh.colors[i],
                )
            }
        };
        let mut mesh = Mesh { vertices: used.iter().map(vertex).collect(), triangles: local };
        if let Some(world_from_mesh) = self.place {
            mesh.turn(&world_from_mesh.matrix3);
        }
        pack::snap(&mut mesh, self.step);
        mesh
    }
}

/// Notes for every vertex which other pieces have one in the same place.
fn find_seams(pieces: &mut [PieceMesh]) {
    if pieces.len() < 2 {
        return;
    }
    // Places by their hash: two that collide are only held in place without need.
    let mut places: Vec<(u64, u32, u32)> = pieces
        .par_iter()
        .enumerate()
        .flat_map_iter(|(number, piece)| {
            piece.vertices.iter().enumerate().map(move |(index, vertex)| {
                let bits = piece.position(vertex).to_array().map(|c| (c + 0.0).to_bits());
                let hash = bits.iter().fold(0u64, |hash, word| {
                    (hash.rotate_left(23) ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15)
                });
                (hash, number as u32, index as u32)
            })
        })
        .collect();
    places.par_sort_unstable();
    for group in places.chunk_by(|a, b| a.0 == b.0) {
        let mut sharers: Vec<u32> = group.iter().map(|place| place.1).collect();
        sharers.dedup();
        if sharers.len() < 2 {
            continue;
        }
        for &(_, piece, vertex) in group {
            let seams = &mut pieces[piece as usize].seams;
            if sharers.len() > MOST_SHARERS {
                seams.push([vertex, ALL_PIECES]);
            } else {
                let others = sharers.iter().filter(|&&other| other != piece);
                seams.extend(others.map(|&other| [vertex, other]));
            }
        }
    }
    pieces.par_iter_mut().for_each(|piece| piece.seams.sort_unstable());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Section;

    /// A flat sheet of `side * side` quads with shared vertices.
    fn sheet(side: u32) -> SourceMesh {
        let at = |i: u32| [(i % (side + 1)) as f32, (i / (side + 1)) as f32, 0.0];
        let count = (side + 1) * (side + 1);
        let quad = |i: u32| {
            let a = i % side + i / side * (side + 1);
            [[a, a + 1, a + side + 1], [a + 1, a + side + 2, a + side + 1]]
        };
        SourceMesh {
            positions: (0..count).map(at).collect(),
            normals: vec![[0.0, 0.0, 1.0]; count as usize],
            colors: vec![[200; 4]; count as usize],
            indices: (0..side * side).flat_map(quad).collect(),
            sections: vec![Section { end: 2 * side * side, surface: 3 }],
            ..SourceMesh::default()
        }
    }

    fn slice(mesh: &SourceMesh, placements: &[DAffine3], piece_triangles: usize) -> Vec<PieceMesh> {
        let options = Options { piece_triangles, ..Options::default() };
        Slicer { options: &options, scene_diagonal: 1000.0 }.pieces(mesh, placements)
    }

    #[test]
    fn nothing_shows_nothing() {
        assert!(slice(&SourceMesh::default(), &[DAffine3::IDENTITY], 10).is_empty());
        assert!(slice(&sheet(2), &[], 10).is_empty());
    }

    #[test]
    fn pieces_hold_every_triangle_and_come_back_from_bytes() {
        let pieces = slice(&sheet(20), &[DAffine3::IDENTITY], 100);
        assert!(pieces.len() >= 8);
        assert_eq!(pieces.iter().map(|piece| piece.triangles.len()).sum::<usize>(), 800);
        for piece in &pieces {
            assert!(piece.triangles.len() <= 100);
            let bytes = piece.encode();
            assert_eq!(PieceMesh::decode(&bytes).as_ref(), Ok(piece));
            assert!(
                (0..bytes.len()).step_by(7).all(|end| PieceMesh::decode(&bytes[..end]).is_err())
            );
            assert!(piece.mesh(|_| 0).vertices.iter().all(|vertex| vertex.surface == 3));
        }
    }

    #[test]
    fn seams_are_known_on_both_sides() {
        let pieces = slice(&sheet(20), &[DAffine3::IDENTITY], 100);
        for (number, piece) in pieces.iter().enumerate() {
            assert!(!piece.seams.is_empty());
            for &[vertex, other] in &piece.seams {
                let at = piece.position(&piece.vertices[vertex as usize]);
                let back = &pieces[other as usize];
                let found = back.seams.iter().any(|&[v, o]| {
                    o as usize == number && back.position(&back.vertices[v as usize]) == at
                });
                assert!(found, "{number} {at}");
            }
            let mesh = piece.mesh(|other| if other == ALL_PIECES { 0 } else { 5 });
            let held = mesh.vertices.iter().filter(|vertex| vertex.seam == 5).count();
            assert!(held > 8 && held < mesh.vertices.len(), "{held}");
        }
    }

    #[test]
    fn coarser_forms_inherit_seams_where_they_kept_the_vertex() {
        let pieces = slice(&sheet(8), &[DAffine3::IDENTITY], 40);
        let mut mesh = pieces[0].mesh(|_| 0);
        mesh.triangles.truncate(10);
        let mut coarser = PieceMesh::of(&mesh, pieces[0].step).unwrap();
        coarser.inherit_seams(&pieces[0]);
        assert!(!coarser.seams.is_empty() && coarser.seams.len() < pieces[0].seams.len());
        for &[vertex, other] in &coarser.seams {
            let at = coarser.position(&coarser.vertices[vertex as usize]);
            assert!(pieces[0].seams.iter().any(|&[v, o]| {
                o == other && pieces[0].position(&pieces[0].vertices[v as usize]) == at
            }));
        }
    }

    #[test]
    fn far_away_and_at_every_scale_pieces_keep_their_shape() {
        for (scale, offset) in [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e7)] {
            let mut placement = DAffine3::from_scale(DVec3::splat(scale));
            placement.translation = DVec3::splat(offset);
            let pieces = slice(&sheet(4), &[placement], 10);
            let triangles: usize = pieces.iter().map(|piece| piece.triangles.len()).sum();
            assert_eq!(triangles, 32, "{scale} {offset}");
        }
    }
}
