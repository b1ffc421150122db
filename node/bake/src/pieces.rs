//! What the leaves will be: objects, or pieces of large ones, baked to the world or shared.

use crate::options::Options;
use crate::pack;
use crate::source::{Source, SourceMesh};
use geometry::bounds::Aabb;
use geometry::mesh::{Mesh, MeshVertex, largest_stretch};
use geometry::partition::{Limits, TriangleBox, partition};
use glam::{DAffine3, DVec3, Vec3};
use protocol::format::{NONE, Transform};
use rayon::prelude::*;

/// Steps that an object's diagonal is divided into at least, however large the scene is.
const STEPS_PER_OBJECT: f64 = (1u32 << 16) as f64;
/// Steps that the scene's diagonal is divided into, unless an object demands finer or coarser ones.
const STEPS_PER_SCENE: f64 = (1u32 << 23) as f64;

/// A part of a mesh that becomes one blob and its coarser levels.
#[derive(Debug)]
pub(crate) struct Piece {
    /// Index into [`Source::meshes`].
    mesh: usize,
    /// World placement of a mesh that only one object shows; a shared mesh stays in its own space.
    world_from_mesh: Option<DAffine3>,
    /// Triangles of the mesh.
    triangles: Vec<u32>,
    /// Grid step, the same for all pieces of a mesh.
    pub(crate) step: f64,
    /// Box, in the space the piece lies in.
    bounds: Aabb,
}

impl Piece {
    /// Whether several objects show it.
    pub(crate) fn is_shared(&self) -> bool {
        self.world_from_mesh.is_none()
    }

    /// Triangles of the source in it.
    pub(crate) fn triangles(&self) -> u64 {
        self.triangles.len() as u64
    }

    /// Its mesh on its grid.
    pub(crate) fn gather(&self, source: &Source) -> Mesh {
        let mesh = &source.meshes[self.mesh];
        let corners = self.triangles.iter().map(|&t| mesh.indices[t as usize]);
        let mut used: Vec<u32> = corners.clone().flatten().collect();
        used.sort_unstable();
        used.dedup();
        let vertex = |&index: &u32| {
            let i = index as usize;
            let position = Vec3::from_array(mesh.positions[i]).as_dvec3();
            MeshVertex::plain(position, Vec3::from_array(mesh.normals[i]), mesh.colors[i])
        };
        let local = |index: u32| used.partition_point(|&other| other < index) as u32;
        let gathered = Mesh {
            vertices: used.iter().map(vertex).collect(),
            triangles: corners.map(|t| t.map(local)).collect(),
        };
        let mut placed = match &self.world_from_mesh {
            Some(world_from_mesh) => gathered.placed(world_from_mesh),
            None => gathered,
        };
        pack::snap(&mut placed, self.step);
        placed
    }

    /// Whether a triangle has three different corners on the grid.
    fn survives(&self, source: &Source) -> bool {
        let mesh = &source.meshes[self.mesh];
        self.triangles.iter().any(|&t| {
            let [a, b, c] = corners(mesh, t, self.world_from_mesh.as_ref())
                .map(|corner| pack::snapped(corner, self.step));
            a != b && b != c && c != a
        })
    }
}

/// A leaf of the tree to come.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Leaf {
    /// Source object.
    pub(crate) object: u32,
    /// Index into [`Plan::pieces`].
    pub(crate) piece: u32,
    /// Index into [`Plan::transforms`], or [`NONE`].
    pub(crate) transform: u32,
    /// World box, near enough to build a tree over.
    pub(crate) bounds: Aabb,
}

/// All leaves of a scene.
#[derive(Debug, Default)]
pub(crate) struct Plan {
    pub(crate) pieces: Vec<Piece>,
    /// In the order of objects, then of pieces.
    pub(crate) leaves: Vec<Leaf>,
    /// Placements of objects whose meshes are shared.
    pub(crate) transforms: Vec<Transform>,
    /// What was left out.
    pub(crate) notes: Vec<String>,
}

/// Divides every mesh into pieces and lists the leaves. `done` hears of each mesh.
pub(crate) fn plan(source: &Source, options: &Options, done: impl Fn() + Sync) -> Plan {
    let mut users: Vec<Vec<usize>> = vec![Vec::new(); source.meshes.len()];
    for (index, object) in source.objects.iter().enumerate() {
        users[object.mesh].push(index);
    }
    let scene_diagonal = scene_diagonal(source);
    let pieces_of: Vec<Vec<Piece>> = users
        .par_iter()
        .enumerate()
        .map(|(mesh, users)| {
            let pieces = pieces(source, mesh, users, scene_diagonal, options);
            done();
            pieces
        })
        .collect();

    let mut plan = Plan::default();
    let mut first_piece = Vec::with_capacity(pieces_of.len() + 1);
    for (mesh, pieces) in pieces_of.into_iter().enumerate() {
        if pieces.is_empty() && !users[mesh].is_empty() {
            let name = &source.meshes[mesh].name;
            plan.notes
                .push(format!("mesh \"{name}\" is left out: it has no triangle with an area"));
        }
        first_piece.push(plan.pieces.len());
        plan.pieces.extend(pieces);
    }
    first_piece.push(plan.pieces.len());
    for (index, object) in source.objects.iter().enumerate() {
        let range = first_piece[object.mesh]..first_piece[object.mesh + 1];
        let shared = plan.pieces[range.clone()].first().is_some_and(Piece::is_shared);
        let transform = if shared {
            plan.transforms.push(transform(&object.world_from_mesh));
            plan.transforms.len() as u32 - 1
        } else {
            NONE
        };
        plan.leaves.extend(range.map(|piece| {
            let inner = plan.pieces[piece].bounds;
            let bounds = if shared { placed_box(inner, &object.world_from_mesh) } else { inner };
            Leaf { object: index as u32, piece: piece as u32, transform, bounds }
        }));
    }
    plan
}

/// Pieces of one mesh, in its own space or, with one user, in the world.
fn pieces(
    source: &Source,
    mesh_index: usize,
    users: &[usize],
    scene_diagonal: f64,
    options: &Options,
) -> Vec<Piece> {
    let mesh = &source.meshes[mesh_index];
    let placement = |user: &usize| source.objects[*user].world_from_mesh;
    let world_from_mesh = match users {
        [] => return Vec::new(),
        [only] => Some(placement(only)),
        _ => None,
    };
    // World sizes in units of the piece's own space.
    let stretch = match world_from_mesh {
        Some(_) => 1.0,
        None => users.iter().map(|u| largest_stretch(&placement(u).matrix3)).fold(0.0, f64::max),
    };
    let place = world_from_mesh.as_ref();
    let points = (0..mesh.indices.len() as u32).flat_map(|t| corners(mesh, t, place));
    let bounds = Aabb::of(points);
    if bounds.is_empty() {
        return Vec::new();
    }
    let center = bounds.center();
    let boxes: Vec<TriangleBox> = (0..mesh.indices.len() as u32)
        .map(|t| TriangleBox::of(corners(mesh, t, place).map(|corner| (corner - center).as_vec3())))
        .collect();
    let limits = Limits {
        triangles: options.piece_triangles,
        // Infinite for a mesh that all its users flatten to a point: then nothing sprawls.
        extent: (scene_diagonal * options.piece_extent / stretch) as f32,
        least_triangles: options.piece_least_triangles,
    };
    let mut pieces: Vec<Piece> = partition(&boxes, &limits)
        .into_iter()
        .map(|triangles| {
            let bounds = Aabb::of(triangles.iter().flat_map(|&t| corners(mesh, t, place)));
            Piece { mesh: mesh_index, world_from_mesh, triangles, step: 0.0, bounds }
        })
        .collect();
    let step = common_step(&pieces, &bounds, scene_diagonal / stretch);
    for piece in &mut pieces {
        piece.step = step;
        // Decoded vertices lie up to half a step outside.
        piece.bounds = piece.bounds.grown(step);
    }
    pieces.retain(|piece| piece.survives(source));
    pieces
}

/// One step for all pieces of a mesh: as fine as scene and object call for, as coarse as the largest
/// piece needs.
fn common_step(pieces: &[Piece], bounds: &Aabb, scene_diagonal: f64) -> f64 {
    let farthest = bounds.min.abs().max(bounds.max.abs()).max_element();
    let largest = pieces.iter().map(|p| p.bounds.extent().max_element()).fold(0.0, f64::max);
    let wanted = bounds.diagonal() / STEPS_PER_OBJECT;
    let wanted = if scene_diagonal.is_finite() {
        wanted.min(scene_diagonal / STEPS_PER_SCENE)
    } else {
        wanted
    };
    pack::power_of_two_at_least(wanted).max(pack::finest_step(largest, farthest))
}

fn corners(mesh: &SourceMesh, triangle: u32, placement: Option<&DAffine3>) -> [DVec3; 3] {
    mesh.indices[triangle as usize].map(|index| {
        let p = Vec3::from_array(mesh.positions[index as usize]).as_dvec3();
        placement.map_or(p, |target_from_mesh| target_from_mesh.transform_point3(p))
    })
}

fn transform(world_from_mesh: &DAffine3) -> Transform {
    Transform {
        linear: world_from_mesh.matrix3.to_cols_array_2d(),
        translation: world_from_mesh.translation.to_array(),
    }
}

/// The box around a placed box.
fn placed_box(inner: Aabb, target_from_box: &DAffine3) -> Aabb {
    Aabb::of((0..8).map(|corner| {
        let pick = |k: usize| if corner >> k & 1 == 1 { inner.max[k] } else { inner.min[k] };
        target_from_box.transform_point3(DVec3::new(pick(0), pick(1), pick(2)))
    }))
}

/// Diagonal of a box around all objects.
fn scene_diagonal(source: &Source) -> f64 {
    let inner: Vec<Aabb> = source
        .meshes
        .par_iter()
        .map(|mesh| Aabb::of(mesh.positions.iter().map(|p| Vec3::from_array(*p).as_dvec3())))
        .collect();
    let objects = source.objects.iter().filter(|object| !inner[object.mesh].is_empty());
    let boxes = objects.map(|object| placed_box(inner[object.mesh], &object.world_from_mesh));
    boxes.fold(Aabb::EMPTY, Aabb::union).diagonal()
}
