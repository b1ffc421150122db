//! What far fields are in the skeleton: regions of viewpoints and the scan cubes seen from them (paper 000).

use bytemuck::{Pod, Zeroable};

/// A region of viewpoints that has a far field (paper 000, section 3.1.1): 72 bytes.
///
/// No two overlap but for their faces, edges and corners.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ViewCell {
    /// Least corner of its box, scene units.
    pub min: [f64; 3],
    /// Greatest corner, greater in every axis.
    pub max: [f64; 3],
    /// First of its cubes in [`super::Skeleton::cubes`]: where those of the cell before end.
    pub first_cube: u32,
    /// Number of its cubes, 0 where its method is [`Method::None`] and only there.
    pub cube_count: u32,
    /// [`Method`] as a number.
    pub method: u32,
    /// Share of its sides, less than a half, by which its near field reaches beyond them: so far its far field
    /// is right, and the pictures of neighbours may be mixed.
    pub margin: f32,
    /// Solid angle of what no sample saw, from where most of it is seen (max `F` of paper 000, section
    /// 3.3.5), steradians.
    pub objective: f64,
}

/// What stands for what lies outside a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Method {
    /// Nothing: its far field is cheaper as geometry.
    None = 0,
    /// Textured depth meshes: every cube is whole.
    Tdm = 1,
    /// Incremental ones: a cube after the first may hold only what its ancestors do not.
    Itdm = 2,
}

impl Method {
    /// The method of a number in a file.
    pub fn of(number: u32) -> Option<Self> {
        [Self::None, Self::Tdm, Self::Itdm].into_iter().find(|&method| method as u32 == number)
    }
}

/// A scan cube: what is seen from one viewpoint, or what its ancestors lack of it (paper 000, section
/// 4.1): 64 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Cube {
    /// The sample's viewpoint, inside its cell's box, scene units.
    pub eye: [f64; 3],
    /// Where the patches of each face start among the blobs, faces in the order of
    /// [`super::projected::FACES`], and where those of the last end. A face of which nothing is left to show has
    /// none.
    pub patches: [u32; 7],
    /// Pixels along a side of a face.
    pub side: u32,
    /// The cube of the same cell that it depends on, an index into [`super::Skeleton::cubes`] smaller than
    /// its own; [`super::NONE`] for an intra cube.
    pub parent: u32,
    /// Triangles of all its patches.
    pub triangles: u32,
}

impl Cube {
    /// Blobs of all its patches.
    pub fn blobs(&self) -> std::ops::Range<u32> {
        self.patches[0]..self.patches[6]
    }

    /// Blobs of the patches of a face.
    pub fn patches_of(&self, face: usize) -> std::ops::Range<u32> {
        self.patches[face]..self.patches[face + 1]
    }
}
