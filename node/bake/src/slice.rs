//! Meshes divided into pieces, top down (paper 004, section 2.2, the first partition).

use crate::bulk::Bulk;
use crate::grid::{self, Shared};
use crate::options::Options;
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

/// A piece longer than this share of the scene holds no triangle that is small beside it: the grid that
/// all pieces have in common is too fine for it.
const OWN_GRID: f64 = 0.25;
/// How far a box of single precision may be off at either end, as a share of how far that is from the
/// middle.
const ROUNDING: f64 = 1.0 / (1 << 23) as f64;

/// How meshes are to be divided.
pub(crate) struct Slicer<'a> {
    pub(crate) options: &'a Options,
    /// Length of the scene's diagonal, strays left out.
    pub(crate) scene_diagonal: f64,
}

impl<'a> Slicer<'a> {
    /// How a mesh that stands at `placements`, one at least, is to be divided: in the world if there is
    /// one, else in the mesh's own space. `bulk` is where most of it lies, in its own space.
    pub(crate) fn frame(&self, placements: &'a [DAffine3], bulk: Bulk) -> Frame<'a> {
        let place = match placements {
            [only] => Some(only),
            _ => None,
        };
        let bulk = match place {
            Some(place) => Bulk {
                middle: place.transform_point3(bulk.middle),
                reach: bulk.reach * largest_stretch(&place.matrix3),
            },
            None => bulk,
        };
        // Infinite for a mesh that all its users flatten to a point: then nothing sprawls.
        let scene_diagonal = self.scene_diagonal / stretch(placements);
        let limits = Limits {
            triangles: self.options.piece_triangles,
            extent: (scene_diagonal * self.options.piece_extent) as f32,
            least_triangles: self.options.piece_least_triangles,
            in_proportion: (scene_diagonal * OWN_GRID) as f32,
        };
        Frame { place, limits, scene_diagonal, bulk }
    }

    /// Pieces of a mesh. Those without an area on the grid are left out.
    pub(crate) fn pieces(
        &self,
        mesh: &SourceMesh,
        placements: &'a [DAffine3],
        bulk: Bulk,
    ) -> Vec<PieceMesh> {
        if placements.is_empty() || mesh.indices.is_empty() {
            return Vec::new();
        }
        let frame = self.frame(placements, bulk);
        let bounds = frame.bounds(mesh);
        let mut items = frame.items(mesh, 0);
        let whole = Tally::of(&items);
        let parts = Splitter::new(frame.limits, &whole).divide(&mut items, &whole);
        drop(items);
        let steps: Vec<f64> = parts.iter().map(|part| frame.step(&bounds, part.bounds)).collect();
        let gatherer = Gatherer::new(mesh, &frame);
        let gather = |part: &Piece, local: &mut Local| {
            gatherer.gather(part.triangles.iter().copied(), local)
        };

        // Those on a coarser grid than others say where what they share with them lies.
        let mut shared = Shared::new(&steps);
        for (part, &step) in parts.iter().zip(&steps) {
            if shared.is_coarse(step) {
                shared.note(&gather(part, &mut HashMap::default()), step);
            }
        }
        let piece = |local: &mut Local, (part, step): (Piece, f64)| {
            frame.piece(gather(&part, local), step, &shared)
        };
        let pieces = parts.into_par_iter().zip(steps).map_init(HashMap::default, piece);
        let mut pieces: Vec<PieceMesh> = pieces.flatten_iter().collect();
        seams::find(&mut pieces);
        pieces
    }
}

/// World sizes in units of the space that pieces of a mesh with these placements lie in.
pub(crate) fn stretch(placements: &[DAffine3]) -> f64 {
    match placements {
        [_] => 1.0,
        _ => placements.iter().map(|p| largest_stretch(&p.matrix3)).fold(0.0, f64::max),
    }
}

/// Where the pieces of a mesh lie, and how large they may be.
pub(crate) struct Frame<'a> {
    /// None for the mesh's own space.
    place: Option<&'a DAffine3>,
    pub(crate) limits: Limits,
    /// In the space of the pieces, strays left out.
    scene_diagonal: f64,
    /// Where most of the mesh lies, in the space of the pieces.
    bulk: Bulk,
}

impl Frame<'_> {
    fn point(&self, p: DVec3) -> DVec3 {
        self.place.map_or(p, |target_from_mesh| target_from_mesh.transform_point3(p))
    }

    /// The box around a mesh's vertices.
    pub(crate) fn bounds(&self, mesh: &SourceMesh) -> Aabb {
        let at = |vertex: usize| Aabb::of([self.point(mesh.position(vertex))]);
        let vertices = (0..mesh.positions.len()).into_par_iter().with_min_len(1 << 14);
        vertices.map(at).reduce(|| Aabb::EMPTY, Aabb::union)
    }

    /// Boxes of a mesh's triangles, numbered from `first` on, relative to where most of it lies: there single
    /// precision is finest.
    pub(crate) fn items(&self, mesh: &SourceMesh, first: u32) -> Vec<Item> {
        let corner =
            |index: u32| (self.point(mesh.position(index as usize)) - self.bulk.middle).as_vec3();
        let triangles = mesh.indices.par_iter().enumerate();
        triangles.map(|(i, triangle)| Item::of(first + i as u32, triangle.map(corner))).collect()
    }

    /// The step of a piece whose triangles have this box, of a mesh in these bounds: the one that suits the
    /// mesh, or as coarse as the piece itself needs.
    pub(crate) fn step(&self, bounds: &Aabb, piece: [Vec3; 2]) -> f64 {
        let common = grid::common_step(bounds.diagonal().min(self.bulk.reach), self.scene_diagonal);
        let [low, high] = piece.map(Vec3::as_dvec3);
        let rounding = 2.0 * ROUNDING * low.abs().max(high.abs());
        // Coordinates beyond single precision make it infinite or no number.
        let longest = bounds.extent().max_element();
        let extent = (high - low + rounding).max_element().min(longest);
        let whole = bounds.min.abs().max(bounds.max.abs());
        let [low, high] = [low - rounding, high + rounding].map(|end| end + self.bulk.middle);
        let farthest = low.abs().max(high.abs()).min(whole).max_element();
        grid::step(common, extent, farthest)
    }

    /// The piece that a gathered mesh makes; none without an area on the grid.
    pub(crate) fn piece(&self, mut mesh: Mesh, step: f64, shared: &Shared) -> Option<PieceMesh> {
        if let Some(world_from_mesh) = self.place {
            mesh.turn(&world_from_mesh.matrix3);
        }
        let error = shared.snap(&mut mesh, step);
        PieceMesh::of(&mesh, step, error)
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
                self.frame.point(mesh.position(i)),
                Vec3::from_array(mesh.normals[i]),
                mesh.colors[i],
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bulk;
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

    fn bulk_of(mesh: &SourceMesh) -> Bulk {
        let samples = bulk::samples(mesh).into_iter().map(|sample| (sample, 1.0));
        Bulk::of(bulk::placed(samples, &DAffine3::IDENTITY, 1.0))
    }

    fn slice(mesh: &SourceMesh, placements: &[DAffine3], piece_triangles: usize) -> Vec<PieceMesh> {
        let options = Options { piece_triangles, ..Options::default() };
        let slicer = Slicer { options: &options, scene_diagonal: 1000.0 };
        slicer.pieces(mesh, placements, bulk_of(mesh))
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
        let mut coarser = PieceMesh::of(&mesh, pieces[0].step, 0.0).unwrap();
        coarser.inherit_seams(&pieces[0]);
        assert!(!coarser.seams.is_empty() && coarser.seams.len() < pieces[0].seams.len());
        for &[vertex, other] in &coarser.seams {
            let at = coarser.position(&coarser.vertices[vertex as usize]);
            assert!(pieces[0].seams.iter().any(|&[v, o]| {
                o == other && pieces[0].position(&pieces[0].vertices[v as usize]) == at
            }));
        }
    }

    /// A sheet as large as that of `sheet(side)` with a triangle on its border that reaches far away.
    fn with_a_long_one(side: u32) -> SourceMesh {
        let mut mesh = sheet(side);
        let far = mesh.positions.len() as u32;
        mesh.positions.push([3.3, -5e6, 0.0]);
        mesh.normals.push([0.0, 0.0, 1.0]);
        mesh.colors.push([200; 4]);
        mesh.indices.insert(7, [side / 4, far, 3 * side / 4]);
        mesh.sections[0].end += 1;
        let off = |p: &mut [f32; 3]| *p = [p[0] + 0.37, p[1] - 0.21, p[2]];
        mesh.positions.iter_mut().for_each(off);
        mesh
    }

    #[test]
    fn a_long_triangle_costs_only_its_own_corners() {
        let mesh = with_a_long_one(20);
        for placements in [vec![DAffine3::IDENTITY], vec![DAffine3::IDENTITY; 2]] {
            let pieces = slice(&mesh, &placements, 1000);
            let coarsest = pieces.iter().map(|piece| piece.step).fold(0.0, f64::max);
            assert_eq!(coarsest, 4.0);
            let fine: Vec<_> = pieces.iter().filter(|piece| piece.step < 1e-3).collect();
            assert_eq!(fine.iter().map(|piece| piece.triangles.len()).sum::<usize>(), 800);

            // All corners but the two that it shares are where they were, to a thousandth.
            let original = |at: DVec3| {
                mesh.positions.iter().any(|p| Vec3::from_array(*p).as_dvec3().distance(at) < 1e-3)
            };
            let vertices = fine.iter().flat_map(|piece| piece.mesh(|_| 0).vertices);
            let (kept, moved): (Vec<_>, Vec<_>) =
                vertices.map(|vertex| vertex.position).partition(|at| original(*at));
            assert!(kept.len() >= 439 && !moved.is_empty(), "{} {moved:?}", kept.len());
        }
    }

    #[test]
    fn seams_close_between_pieces_on_different_grids() {
        let pieces = slice(&with_a_long_one(20), &[DAffine3::IDENTITY], 50);
        let long = pieces.iter().position(|piece| piece.step == 4.0).unwrap();
        let shared: Vec<DVec3> = pieces[long]
            .seams
            .iter()
            .map(|seam| pieces[long].position(&pieces[long].vertices[seam[0] as usize]))
            .collect();
        assert!(!shared.is_empty());
        for at in shared {
            let has = |piece: &PieceMesh| piece.vertices.iter().any(|v| piece.position(v) == at);
            let others = pieces.iter().filter(|piece| piece.step < 1.0 && has(piece));
            assert!(others.clone().count() > 0, "{at}");
            // Who moved a corner that far says so.
            assert!(others.clone().all(|piece| piece.error >= 4.0));
        }
        let is_fine = |piece: &&PieceMesh| piece.error < 1e-3;
        assert!(pieces.iter().filter(is_fine).count() > pieces.len() / 2);
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
