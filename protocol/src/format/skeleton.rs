//! The always-resident part of a scene: bounds, errors, children, blob ranges; no geometry.

use crate::id::{BlobId, HlodId};
use bytemuck::{Pod, Zeroable};

/// A node of the hierarchy (paper 004, section 2.1): 80 bytes.
///
/// Children are contiguous and come after their parent; hlod 0 is the root. A leaf holds a piece of
/// an object or one instance; level 0 of a leaf is the original geometry. An inner hlod's levels stand
/// for everything below it.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Hlod {
    /// Least corner of a box around every level of this hlod and of all below it, scene units.
    pub min: [f64; 3],
    /// Greatest corner.
    pub max: [f64; 3],
    /// Parent, or [`super::NONE`] for the root.
    pub parent: u32,
    /// First child; 0 for a leaf.
    pub first_child: u32,
    /// Number of children; 0 for a leaf.
    pub child_count: u32,
    /// First of its levels in [`Skeleton::levels`], finest first.
    pub first_level: u32,
    /// Number of its levels: at least 1 for a leaf; 0 for an inner hlod that has no stand-in of its own.
    pub level_count: u32,
    /// Source object of a leaf, or [`super::NONE`].
    pub object: u32,
    /// Triangles of the source below this hlod, instances counted each.
    pub source_triangles: u64,
}

/// One level of detail of one hlod: 24 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Level {
    /// Greatest deviation from the original surface, scene units. Never smaller than the error of a
    /// finer level of this hlod or of any level of a child.
    pub error: f64,
    /// Its mesh, index into [`Skeleton::blobs`].
    pub blob: u32,
    /// Its placement, index into [`Skeleton::transforms`], or [`super::NONE`] for the identity.
    pub transform: u32,
    /// Triangles of the mesh.
    pub triangles: u32,
    /// Zero.
    pub reserved: u32,
}

/// A mesh in the geometry section: 64 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Blob {
    /// Mesh-space position of grid point (0, 0, 0). Identity placement: scene units.
    pub origin: [f64; 3],
    /// Mesh-space size of a grid step, a power of two.
    pub step: f64,
    /// First byte, from the start of the geometry section; a multiple of 64.
    pub offset: u64,
    /// Bytes, see [`super::vertex`].
    pub bytes: u64,
    /// Vertices.
    pub vertices: u32,
    /// Triangles.
    pub triangles: u32,
    /// CRC32C of the bytes.
    pub crc: u32,
    /// Zero.
    pub reserved: u32,
}

/// An instance's placement: 96 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Transform {
    /// `world_from_mesh`, the three columns of the linear part.
    pub linear: [[f64; 3]; 3],
    /// Its translation, scene units.
    pub translation: [f64; 3],
}

impl Transform {
    /// No placement at all.
    pub const IDENTITY: Self =
        Self { linear: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0; 3] };

    /// `world = linear * mesh + translation`.
    pub fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| {
            self.linear[0][k] * p[0]
                + self.linear[1][k] * p[1]
                + self.linear[2][k] * p[2]
                + self.translation[k]
        })
    }
}

/// Facts about the whole scene: 64 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct SceneInfo {
    /// Direction of up.
    pub up: [f64; 3],
    /// Triangles of the source, instances counted each.
    pub source_triangles: u64,
    /// Triangles of the source, shared meshes counted once.
    pub unique_triangles: u64,
    /// Objects of the source.
    pub objects: u32,
    /// Zero.
    pub reserved: u32,
    /// Seed the bake was given.
    pub seed: u64,
    /// Zero.
    pub reserved2: u64,
}

/// The skeleton.
#[derive(Debug, Clone, PartialEq)]
pub struct Skeleton {
    /// Facts about the scene.
    pub info: SceneInfo,
    /// The tree, parents before children.
    pub hlods: Vec<Hlod>,
    /// Levels of all hlods.
    pub levels: Vec<Level>,
    /// Meshes.
    pub blobs: Vec<Blob>,
    /// Placements of instances.
    pub transforms: Vec<Transform>,
}

impl Skeleton {
    /// The hlod `id`.
    pub fn hlod(&self, id: HlodId) -> &Hlod {
        &self.hlods[id.index()]
    }

    /// The blob `id`.
    pub fn blob(&self, id: BlobId) -> &Blob {
        &self.blobs[id.index()]
    }

    /// Levels of `hlod`, finest first.
    pub fn levels_of(&self, hlod: &Hlod) -> &[Level] {
        &self.levels[hlod.first_level as usize..][..hlod.level_count as usize]
    }

    /// Children of `hlod`.
    pub fn children_of(&self, hlod: &Hlod) -> impl DoubleEndedIterator<Item = HlodId> + use<> {
        (hlod.first_child..hlod.first_child + hlod.child_count).map(HlodId)
    }

    /// Placement of a level.
    pub fn transform_of(&self, level: &Level) -> Transform {
        match level.transform {
            super::NONE => Transform::IDENTITY,
            index => self.transforms[index as usize],
        }
    }

    /// Length of the diagonal of the whole scene's box, scene units.
    pub fn diagonal(&self) -> f64 {
        let root = &self.hlods[0];
        (0..3).map(|k| (root.max[k] - root.min[k]).powi(2)).sum::<f64>().sqrt()
    }
}
