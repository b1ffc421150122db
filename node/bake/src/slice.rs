//! Meshes divided into pieces, top down (paper 004, section 2.2, the first partition).

use crate::options::Options;
use crate::pack;
use crate::pieces::PieceMesh;
use crate::seams;
use crate::source::SourceMesh;
use geometry::bounds::Aabb;
use geometry::hash::FastHash;
use geometry::mesh::{Mesh, MeshVertex, largest_stretch};
use geometry::partition::{Item, Limits, Piece, Splitter, Tally};
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

/// Steps that an object's diagonal is divided into at least, however large the scene is.
const STEPS_PER_OBJECT: f64 = (1u32 << 16) as f64;
/// Steps that the scene's diagonal is divided into, unless an object demands finer or coarser ones.
const STEPS_PER_SCENE: f64 = (1u32 << 23) as f64;
/// How far a box of single precision may be off at either end, as a share of the mesh's longest side.
const ROUNDING: f64 = 1.0 / (1 << 23) as f64;

/// How meshes are to be divided.
pub(crate) struct Slicer<'a> {
    pub(crate) options: &'a Options,
    /// Length of the whole scene's diagonal.
    pub(crate) scene_diagonal: f64,
}

impl<'a> Slicer<'a> {
    /// How a mesh that stands at `placements`, one at least, is to be divided: in the world if there is
    /// one, else in the mesh's own space.
    pub(crate) fn frame(&self, placements: &'a [DAffine3]) -> Frame<'a> {
        let place = match placements {
            [only] => Some(only),
            _ => None,
        };
        // World sizes in units of the piece's own space.
        let stretch = match place {
            Some(_) => 1.0,
            None => placements.iter().map(|p| largest_stretch(&p.matrix3)).fold(0.0, f64::max),
        };
        // Infinite for a mesh that all its users flatten to a point: then nothing sprawls.
        let scene_diagonal = self.scene_diagonal / stretch;
        let limits = Limits {
            triangles: self.options.piece_triangles,
            extent: (scene_diagonal * self.options.piece_extent) as f32,
            least_triangles: self.options.piece_least_triangles,
        };
        Frame { place, limits, scene_diagonal }
    }

    /// Pieces of a mesh. Those without an area on the grid are left out.
    pub(crate) fn pieces(&self, mesh: &SourceMesh, placements: &'a [DAffine3]) -> Vec<PieceMesh> {
        if placements.is_empty() || mesh.indices.is_empty() {
            return Vec::new();
        }
        let frame = self.frame(placements);
        let bounds = frame.bounds(mesh);
        let mut items = frame.items(mesh, bounds.center(), 0);
        let whole = Tally::of(&items);
        let parts = Splitter::new(frame.limits, &whole).divide(&mut items, &whole);
        drop(items);
        let largest = parts.iter().map(|part| f64::from(part.longest)).fold(0.0, f64::max);
        let step = frame.step(&bounds, largest);
        let gatherer = Gatherer::new(mesh, &frame);
        let piece = |local: &mut Local, part: Piece| {
            frame.piece(gatherer.gather(part.triangles.iter().copied(), local), step)
        };
        let pieces = parts.into_par_iter().map_init(HashMap::default, piece);
        let mut pieces: Vec<PieceMesh> = pieces.flatten_iter().collect();
        seams::find(&mut pieces);
        pieces
    }
}

/// Where the pieces of a mesh lie, and how large they may be.
pub(crate) struct Frame<'a> {
    /// None for the mesh's own space.
    place: Option<&'a DAffine3>,
    pub(crate) limits: Limits,
    /// In the space of the pieces.
    scene_diagonal: f64,
}

impl Frame<'_> {
    fn point(&self, p: [f32; 3]) -> DVec3 {
        let p = Vec3::from_array(p).as_dvec3();
        self.place.map_or(p, |target_from_mesh| target_from_mesh.transform_point3(p))
    }

    /// The box around a mesh's vertices.
    pub(crate) fn bounds(&self, mesh: &SourceMesh) -> Aabb {
        let some = |points: &[[f32; 3]]| Aabb::of(points.iter().map(|&p| self.point(p)));
        mesh.positions.par_chunks(1 << 14).map(some).reduce(|| Aabb::EMPTY, Aabb::union)
    }

    /// Boxes of a mesh's triangles, numbered from `first` on.
    pub(crate) fn items(&self, mesh: &SourceMesh, center: DVec3, first: u32) -> Vec<Item> {
        let corner = |index: u32| (self.point(mesh.positions[index as usize]) - center).as_vec3();
        let triangles = mesh.indices.par_iter().enumerate();
        triangles.map(|(i, triangle)| Item::of(first + i as u32, triangle.map(corner))).collect()
    }

    /// One step for all pieces of a mesh in these bounds: as fine as scene and object call for, as
    /// coarse as the largest piece needs, whose box of single precision is `largest` long.
    pub(crate) fn step(&self, bounds: &Aabb, largest: f64) -> f64 {
        let longest = bounds.extent().max_element();
        // Coordinates beyond single precision make it infinite or no number.
        let largest = (largest + 2.0 * ROUNDING * longest).min(longest);
        let farthest = bounds.min.abs().max(bounds.max.abs()).max_element();
        let wanted = bounds.diagonal() / STEPS_PER_OBJECT;
        let wanted = match self.scene_diagonal.is_finite() {
            true => wanted.min(self.scene_diagonal / STEPS_PER_SCENE),
            false => wanted,
        };
        pack::power_of_two_at_least(wanted).max(pack::finest_step(largest, farthest))
    }

    /// The piece that a gathered mesh makes; none without an area on the grid.
    pub(crate) fn piece(&self, mut mesh: Mesh, step: f64) -> Option<PieceMesh> {
        if let Some(world_from_mesh) = self.place {
            mesh.turn(&world_from_mesh.matrix3);
        }
        pack::snap(&mut mesh, step);
        PieceMesh::of(&mesh, step)
    }
}

/// Numbers of a mesh's vertices within a piece; empty between two of them.
pub(crate) type Local = HashMap<u32, u32, FastHash>;

/// Picks the triangles of pieces out of a mesh.
pub(crate) struct Gatherer<'a> {
    mesh: &'a SourceMesh,
    frame: &'a Frame<'a>,
    /// One a vertex, or a single one for all.
    surfaces: Vec<u16>,
}

impl<'a> Gatherer<'a> {
    pub(crate) fn new(mesh: &'a SourceMesh, frame: &'a Frame<'a>) -> Self {
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
        Self { mesh, frame, surfaces }
    }

    /// A mesh of some triangles, placed but not turned yet, and on no grid.
    pub(crate) fn gather(&self, triangles: impl Iterator<Item = u32>, local: &mut Local) -> Mesh {
        local.clear();
        let mut gathered = Mesh::default();
        for triangle in triangles {
            let corners = self.mesh.indices[triangle as usize].map(|index| {
                *local.entry(index).or_insert_with(|| {
                    gathered.vertices.push(self.vertex(index as usize));
                    gathered.vertices.len() as u32 - 1
                })
            });
            gathered.triangles.push(corners);
        }
        gathered
    }

    fn vertex(&self, i: usize) -> MeshVertex {
        let mesh = self.mesh;
        MeshVertex {
            tex_coord: mesh.tex_coords.get(i).copied().unwrap_or_default(),
            surface: self.surfaces[i.min(self.surfaces.len() - 1)],
            ..MeshVertex::plain(
                self.frame.point(mesh.positions[i]),
                Vec3::from_array(mesh.normals[i]),
                mesh.colors[i],
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pieces::ALL_PIECES;
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
