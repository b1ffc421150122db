//! The tree bottom up: levels for every leaf, and for every inner hlod stand-ins for all below it.
//!
//! Only an hlod, its children's finest meshes and the packed bytes of its subtree are in memory.

use crate::levels::{CoarseMesh, ERROR_GROWTH, Goal, levels};
use crate::options::Options;
use crate::pack::{Packed, finest_step, pack, snap};
use crate::pieces::{Leaf, Piece, Plan};
use crate::source::Source;
use geometry::bounds::Aabb;
use geometry::hierarchy::Tree;
use geometry::mesh::{Mesh, largest_stretch};
use glam::DVec3;
use protocol::format::NONE;
use protocol::id::BlobId;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Where a level's mesh is.
#[derive(Debug)]
pub(crate) enum Geometry {
    /// To be written.
    Packed(Packed),
    /// In the file already, as part of a shared mesh.
    Written(BlobId),
}

/// A level that is not numbered yet.
#[derive(Debug)]
pub(crate) struct PendingLevel {
    pub(crate) error: f64,
    pub(crate) geometry: Geometry,
    pub(crate) triangles: u32,
    pub(crate) transform: u32,
}

/// An hlod ready to be written.
#[derive(Debug)]
pub(crate) struct Built {
    /// Its id.
    pub(crate) node: u32,
    pub(crate) levels: Vec<PendingLevel>,
    pub(crate) bounds: Aabb,
    pub(crate) source_triangles: u64,
    pub(crate) object: u32,
}

/// An hlod and what its parent must know of it.
#[derive(Debug)]
pub(crate) struct Top {
    pub(crate) built: Built,
    /// What the parent is made from: the finest level, in the world.
    finest: Mesh,
    /// Its error.
    finest_error: f64,
    /// Distance it was welded within.
    epsilon: f64,
}

impl Top {
    /// The greatest error here or below.
    fn worst(&self) -> f64 {
        self.built.levels.last().map_or(self.finest_error, |level| level.error)
    }
}

/// A subtree: its root, which its parent may still trim, and everything below in tree order.
#[derive(Debug)]
pub(crate) struct Subtree {
    pub(crate) top: Top,
    pub(crate) below: Vec<Built>,
}

/// Packed levels of one piece, finest first.
pub(crate) type PieceLevels = Vec<(f64, Packed)>;

/// A level of a shared piece that is in the file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WrittenLevel {
    /// Deviation in mesh units.
    pub(crate) error: f64,
    pub(crate) blob: BlobId,
    pub(crate) triangles: u32,
}

/// Why packing a coarser level cannot fail: triangles without an area were left out of it.
const HAS_AREA: &str = "a coarser level has triangles with an area";

fn pending(error: f64, packed: Packed) -> PendingLevel {
    let triangles = packed.triangles();
    PendingLevel { error, triangles, geometry: Geometry::Packed(packed), transform: NONE }
}

/// Levels of one piece, its mesh on the grid being `mesh`.
pub(crate) fn piece_levels(piece: &Piece, mesh: &Mesh, options: &Options) -> PieceLevels {
    // Rounding to the nearest grid point moves at most sqrt(3)/2 of a step.
    let error = piece.step;
    let finest =
        pack(mesh, piece.step).expect("pieces without a surviving triangle are not planned");
    let half = mesh.triangles.len() / 2;
    let goal = Goal { first_target: half, most: usize::MAX, epsilon: 0.0 };
    let coarser = levels(mesh, error, goal, options);
    let packed = coarser.into_iter().map(|c| (c.error, pack(&c.mesh, piece.step).expect(HAS_AREA)));
    std::iter::once((error, finest)).chain(packed).collect()
}

/// Everything a subtree is built from.
pub(crate) struct Builder<'a> {
    pub(crate) source: &'a Source,
    pub(crate) plan: &'a Plan,
    pub(crate) tree: &'a Tree,
    /// By piece; empty for one that is not shared.
    pub(crate) shared: &'a [Vec<WrittenLevel>],
    pub(crate) options: &'a Options,
    /// Nanoseconds all threads spent on leaves and on inner hlods: for the summary alone.
    pub(crate) leaf_ns: AtomicU64,
    pub(crate) inner_ns: AtomicU64,
}

impl Builder<'_> {
    /// Builds everything from `node` down.
    pub(crate) fn subtree(&self, node: u32) -> Subtree {
        if let Some(item) = self.tree.nodes[node as usize].item {
            let start = Instant::now();
            let top = self.leaf(node, &self.plan.leaves[item as usize]);
            self.leaf_ns.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
            return Subtree { top, below: Vec::new() };
        }
        let children: Vec<Subtree> =
            self.tree.children(node).into_par_iter().map(|child| self.subtree(child)).collect();
        let mut below = Vec::new();
        let mut tops = Vec::with_capacity(children.len());
        for child in children {
            below.extend(child.below);
            tops.push(child.top);
        }
        let top = self.inner(node, &mut tops);
        below.extend(tops.into_iter().map(|child| child.built));
        Subtree { top, below }
    }

    fn leaf(&self, node: u32, leaf: &Leaf) -> Top {
        let piece = &self.plan.pieces[leaf.piece as usize];
        let mesh = piece.gather(self.source);
        let built = |levels, bounds| Built {
            node,
            levels,
            bounds,
            source_triangles: piece.triangles(),
            object: leaf.object,
        };
        if leaf.transform == NONE {
            let levels: Vec<PendingLevel> = piece_levels(piece, &mesh, self.options)
                .into_iter()
                .map(|(error, packed)| pending(error, packed))
                .collect();
            let bounds = bounds_of(&levels);
            return Top {
                finest_error: levels[0].error,
                built: built(levels, bounds),
                finest: mesh,
                epsilon: 0.0,
            };
        }
        let world_from_mesh = self.source.objects[leaf.object as usize].world_from_mesh;
        let stretch = largest_stretch(&world_from_mesh.matrix3);
        let levels: Vec<PendingLevel> = self.shared[leaf.piece as usize]
            .iter()
            .map(|level| PendingLevel {
                error: level.error * stretch,
                triangles: level.triangles,
                geometry: Geometry::Written(level.blob),
                transform: leaf.transform,
            })
            .collect();
        // Coarser levels have no vertices that the finest has not. A reader places them by this sum.
        let transform = self.plan.transforms[leaf.transform as usize];
        let placed = mesh.vertices.iter().map(|v| transform.apply(v.position.to_array()).into());
        let bounds = Aabb::of(placed);
        let finest = mesh.placed(&world_from_mesh);
        Top { finest_error: levels[0].error, built: built(levels, bounds), finest, epsilon: 0.0 }
    }

    /// An inner hlod over `children`, which lose those levels that it makes needless.
    pub(crate) fn inner(&self, node: u32, children: &mut [Top]) -> Top {
        let start = Instant::now();
        let mut merged = Mesh::default();
        let mut bounds = Aabb::EMPTY;
        for child in children.iter_mut() {
            merged.append(&std::mem::take(&mut child.finest));
            bounds = bounds.union(child.built.bounds);
        }
        let mut error = children.iter().map(|child| child.finest_error).fold(0.0, f64::max);
        let extent = merged.bounds();
        let farthest = extent.min.abs().max(extent.max.abs()).max_element();
        let step = finest_step(extent.extent().max_element(), farthest);
        error += snap(&mut merged, step);
        let goal = Goal {
            first_target: self.options.hlod_triangles.min(merged.triangles.len() / 2),
            // Nothing above the root takes over from it, so its chain goes on to the end.
            most: if node == 0 { usize::MAX } else { self.options.hlod_levels },
            epsilon: children.iter().map(|child| child.epsilon).fold(0.0, f64::max),
        };
        let mut coarse = levels(&merged, error, goal, self.options);
        raise(&mut coarse, children);
        let levels: Vec<PendingLevel> = coarse
            .iter()
            .map(|level| pending(level.error, pack(&level.mesh, step).expect(HAS_AREA)))
            .collect();
        let built = Built {
            node,
            bounds: bounds.union(bounds_of(&levels)),
            source_triangles: children.iter().map(|child| child.built.source_triangles).sum(),
            object: NONE,
            levels,
        };
        let top = if built.levels.is_empty() {
            let worst = children.iter().map(Top::worst).fold(error, f64::max);
            Top { built, finest: merged, finest_error: worst, epsilon: goal.epsilon }
        } else {
            let finest = coarse.swap_remove(0);
            Top { built, finest: finest.mesh, finest_error: finest.error, epsilon: finest.epsilon }
        };
        self.inner_ns.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
        top
    }
}

/// Makes errors monotone between an hlod and its children. A child's level that errs as much as this
/// hlod's finest is dropped: one mesh for all children serves better. A child without levels
/// cannot be trimmed, so there this hlod's errors are raised over those below it.
fn raise(coarse: &mut [CoarseMesh], children: &mut [Top]) {
    let Some(finest) = coarse.first() else { return };
    let bare = children.iter().filter(|child| child.built.levels.is_empty());
    let floor =
        bare.map(Top::worst).fold(finest.error, |floor, worst| floor.max(worst * ERROR_GROWTH));
    let mut least = floor;
    for level in coarse.iter_mut() {
        level.error = level.error.max(least);
        least = level.error * ERROR_GROWTH;
    }
    for child in children {
        child.built.levels.retain(|level| level.error < floor);
    }
}

/// The box around the decoded vertices of levels without a placement.
fn bounds_of(levels: &[PendingLevel]) -> Aabb {
    let packed = levels.iter().filter_map(|level| match &level.geometry {
        Geometry::Packed(packed) => Some(packed),
        Geometry::Written(_) => None,
    });
    Aabb::of(packed.flat_map(Packed::positions).map(DVec3::from_array))
}
