//! The always-resident part of a scene: bounds, errors, children, blob ranges; no geometry.

use super::class::Class;
use super::far_field::{Cube, ViewCell};
use super::texture::Texture;
use super::vertex::Layout;
use crate::id::{BlobId, HlodId};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

/// A node of the hierarchy (paper 004, section 2.1): 80 bytes.
///
/// Children are contiguous and come after their parent; hlod 0 is the root. A leaf holds pieces of
/// objects and instances; level 0 of a leaf is the original geometry. An inner hlod's levels stand
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
    /// First of its parts in [`Skeleton::parts`]: where those of the level before end.
    pub first_part: u32,
    /// Number of its parts, at least 1.
    pub part_count: u32,
    /// Triangles of all parts.
    pub triangles: u32,
    /// No edge of its triangles is longer, scene units.
    pub longest_edge: f32,
}

/// A placed mesh of one level: 8 bytes. A leaf may hold several objects, each a part or more.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Part {
    /// Its mesh, index into [`Skeleton::blobs`].
    pub blob: u32,
    /// Its placement, index into [`Skeleton::transforms`], or [`super::NONE`] for the identity.
    pub transform: u32,
}

/// A mesh or a face of a scan cube in the geometry section: 96 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Blob {
    /// Mesh-space position of grid point (0, 0, 0). Identity placement: scene units. Zero for a face.
    pub origin: [f64; 3],
    /// Mesh-space size of a grid step, a power of two. For a face the disparity of a grid unit.
    pub step: f64,
    /// First byte, from the start of the geometry section; a multiple of 64.
    pub offset: u64,
    /// Bytes, see [`super::vertex`] and [`super::projected`].
    pub bytes: u64,
    /// Vertices.
    pub vertices: u32,
    /// Triangles.
    pub triangles: u32,
    /// CRC32C of the bytes.
    pub crc: u32,
    /// Its vertices' [`Layout`] as a number.
    pub layout: u32,
    /// Triangles by [`Class`], in which order they lie. Masked ones have textured vertices; those of a
    /// face are opaque and double-sided.
    pub classes: [u32; Class::COUNT],
    /// Side in pixels and number of stored tiles of a face's picture; of a textured mesh where its list
    /// in [`Skeleton::texture_lists`] begins and how long it is; zero for others.
    pub image: [u32; 2],
}

impl Blob {
    /// Whether its vertices are textured.
    pub fn is_textured(&self) -> bool {
        self.layout == Layout::Textured as u32
    }

    /// What its vertices are.
    pub fn vertex_layout(&self) -> Layout {
        Layout::of(self.layout).unwrap_or(Layout::Plain)
    }

    /// Whether it is a face of a scan cube.
    pub fn is_projected(&self) -> bool {
        self.vertex_layout().is_projected()
    }

    /// Whether normals lie beside the colours of its picture.
    pub fn has_normals(&self) -> bool {
        self.vertex_layout() == Layout::ProjectedNormals
    }

    /// Whether any of its triangles is of `class`.
    pub fn has(&self, class: Class) -> bool {
        self.classes[class as usize] > 0
    }

    /// The triangles of `class`. The rules have passed: classes add up to the triangles.
    pub fn triangles_of(&self, class: Class) -> Range<u32> {
        let first = self.classes[..class as usize].iter().sum();
        first..first + self.classes[class as usize]
    }

    /// Bytes of all its vertices; the indices follow.
    pub fn vertex_bytes(&self) -> usize {
        self.vertices as usize * self.vertex_layout().vertex_bytes()
    }
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

/// How good a hierarchy is, as the bake measured it: 64 bytes, all zero where it did not.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Criteria {
    /// Leaves.
    pub leaves: u64,
    /// Depth of the deepest leaf.
    pub depth_max: u32,
    /// Zero.
    pub reserved: u32,
    /// Mean depth of the leaves.
    pub depth_mean: f64,
    /// Depth of the leaves of a balanced tree with as many of them.
    pub ideal_depth: f64,
    /// Overlap of siblings.
    pub overlap: f64,
    /// How local leaves are in space.
    pub localisation: f64,
    /// Size of a leaf that a tenth of them do not exceed.
    pub size_p10: u32,
    /// Its median.
    pub size_p50: u32,
    /// The size that nine tenths do not exceed.
    pub size_p90: u32,
    /// Zero.
    pub reserved2: u32,
}

/// Facts about the whole scene: 224 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
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
    /// Digest of the inputs and settings the bake was given; zero if unknown.
    pub key: [u8; 32],
    /// The hierarchy as it was built.
    pub tree: Criteria,
    /// One built without the bake's care for objects and space, for comparison.
    pub plain: Criteria,
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
    /// Parts of all levels, level after level.
    pub parts: Vec<Part>,
    /// Meshes and faces of scan cubes.
    pub blobs: Vec<Blob>,
    /// Placements of instances.
    pub transforms: Vec<Transform>,
    /// Textures.
    pub textures: Vec<Texture>,
    /// Regions of viewpoints with far fields.
    pub view_cells: Vec<ViewCell>,
    /// Scan cubes of all of them, cell after cell.
    pub cubes: Vec<Cube>,
    /// The textures of each textured blob, ascending, blob after blob.
    pub texture_lists: Vec<u32>,
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

    /// The textures that vertices of a blob may name, ascending: what must be there when it is drawn.
    pub fn textures_of(&self, id: BlobId) -> &[u32] {
        let blob = self.blob(id);
        match blob.is_textured() {
            true => &self.texture_lists[blob.image[0] as usize..][..blob.image[1] as usize],
            false => &[],
        }
    }

    /// Bytes of all its tables: what stays in memory whatever is drawn (Manocha, section 5.4).
    pub fn resident_bytes(&self) -> u64 {
        let Self { info, hlods, levels, parts, blobs, transforms, .. } = self;
        let Self { textures, view_cells, cubes, texture_lists, .. } = self;
        let tree = size_of_val(info) + size_of_val(&hlods[..]) + size_of_val(&levels[..]);
        let meshes =
            size_of_val(&parts[..]) + size_of_val(&blobs[..]) + size_of_val(&transforms[..]);
        let pictures = size_of_val(&textures[..]) + size_of_val(&texture_lists[..]);
        let far = size_of_val(&view_cells[..]) + size_of_val(&cubes[..]);
        (tree + meshes + pictures + far) as u64
    }

    /// Levels of `hlod`, finest first.
    pub fn levels_of(&self, hlod: &Hlod) -> &[Level] {
        &self.levels[hlod.first_level as usize..][..hlod.level_count as usize]
    }

    /// No triangle of any level of `hlod` has a longer edge, scene units.
    pub fn longest_edge(&self, hlod: &Hlod) -> f64 {
        let edges = self.levels_of(hlod).iter().map(|level| f64::from(level.longest_edge));
        edges.fold(0.0, f64::max)
    }

    /// Children of `hlod`.
    pub fn children_of(&self, hlod: &Hlod) -> impl DoubleEndedIterator<Item = HlodId> + use<> {
        (hlod.first_child..hlod.first_child + hlod.child_count).map(HlodId)
    }

    /// Parts of `level`.
    pub fn parts_of(&self, level: &Level) -> &[Part] {
        &self.parts[level.first_part as usize..][..level.part_count as usize]
    }

    /// The meshes of the level of this index, in the order of its parts.
    pub fn blobs_of(&self, level: u32) -> impl Iterator<Item = BlobId> {
        self.parts_of(&self.levels[level as usize]).iter().map(|part| BlobId(part.blob))
    }

    /// The parent of `hlod` and so on up to the root.
    pub fn ancestors(&self, hlod: HlodId) -> impl Iterator<Item = HlodId> {
        let parent =
            |id: &HlodId| Some(self.hlod(*id).parent).filter(|&id| id != super::NONE).map(HlodId);
        std::iter::successors(parent(&hlod), parent)
    }

    /// Placement of a part.
    pub fn transform_of(&self, part: &Part) -> Transform {
        match part.transform {
            super::NONE => Transform::IDENTITY,
            index => self.transforms[index as usize],
        }
    }

    /// Scan cubes of `cell`.
    pub fn cubes_of(&self, cell: &ViewCell) -> &[Cube] {
        &self.cubes[cell.first_cube as usize..][..cell.cube_count as usize]
    }

    /// Length of the diagonal of the whole scene's box, scene units.
    pub fn diagonal(&self) -> f64 {
        let root = &self.hlods[0];
        (0..3).map(|k| (root.max[k] - root.min[k]).powi(2)).sum::<f64>().sqrt()
    }
}
