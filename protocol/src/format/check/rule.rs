//! The rules of a skeleton by name, and where one is broken.

use super::{FARTHEST, MAX_DEPTH};
#[cfg(doc)]
use crate::format::Skeleton;
use crate::format::texture::MAX_SIDE;
use crate::id::{BlobId, HlodId};

/// Where a rule is broken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// The scene's facts.
    Info,
    /// A hlod.
    Hlod(HlodId),
    /// A level, index into [`Skeleton::levels`].
    Level(u32),
    /// A part, index into [`Skeleton::parts`].
    Part(u32),
    /// A blob.
    Blob(BlobId),
    /// A placement, index into [`Skeleton::transforms`].
    Transform(u32),
    /// A texture, index into [`Skeleton::textures`].
    Texture(u32),
    /// A view cell, index into [`Skeleton::view_cells`].
    ViewCell(u32),
    /// A scan cube, index into [`Skeleton::cubes`].
    Cube(u32),
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Info => f.write_str("the scene's facts"),
            Self::Hlod(id) => write!(f, "hlod {id}"),
            Self::Level(index) => write!(f, "level {index}"),
            Self::Part(index) => write!(f, "part {index}"),
            Self::Blob(id) => write!(f, "blob {id}"),
            Self::Transform(index) => write!(f, "transform {index}"),
            Self::Texture(index) => write!(f, "texture {index}"),
            Self::ViewCell(index) => write!(f, "view cell {index}"),
            Self::Cube(index) => write!(f, "cube {index}"),
        }
    }
}

/// The rule that is broken.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Rule {
    /// There is a root.
    #[error("there are no hlods")]
    NoHlods,
    /// Spare fields are zero.
    #[error("a reserved field is not zero")]
    Reserved,
    /// A length.
    #[error("its longest edge of {edge} is no length")]
    LongestEdge {
        /// What the level says.
        edge: f32,
    },
    /// No NaN, no infinity.
    #[error("a number is not finite")]
    NotFinite,
    /// Nothing lies farther away than [`FARTHEST`].
    #[error("a coordinate or scale is larger than {FARTHEST:e}")]
    TooFar,
    /// Up is a direction.
    #[error("the up direction has no length")]
    NoUp,
    /// Parents come before children and list them.
    #[error("parent {parent} does not come before it or does not list it")]
    Parent {
        /// What the hlod names.
        parent: u32,
    },
    /// Children come after their parent, in range.
    #[error("its children {first}..+{count} do not follow it in the table")]
    Children {
        /// First child.
        first: u32,
        /// How many.
        count: u32,
    },
    /// Not deeper than [`MAX_DEPTH`].
    #[error("it lies deeper than {MAX_DEPTH} hlods")]
    Depth,
    /// Boxes hold something.
    #[error("the least corner of its box exceeds the greatest")]
    EmptyBox,
    /// Boxes hold their children's.
    #[error("its box leaves that of its parent")]
    OutsideParent,
    /// Levels in range.
    #[error("its levels {first}..+{count} are not in the table")]
    LevelRange {
        /// First level.
        first: u32,
        /// How many.
        count: u32,
    },
    /// Every level belongs to exactly one hlod.
    #[error("it belongs to {owners} hlods")]
    Owners {
        /// How many.
        owners: u32,
    },
    /// Parts of consecutive levels lie one after another, at least one a level.
    #[error(
        "its parts {first}..+{count} do not follow those of the level before, which end at {expected}"
    )]
    PartRange {
        /// First part.
        first: u32,
        /// How many.
        count: u32,
        /// Where the first should be.
        expected: u32,
    },
    /// Every part belongs to a level.
    #[error("it belongs to no level")]
    StrayPart,
    /// Leaves can be drawn.
    #[error("it is a leaf without a level")]
    BareLeaf,
    /// Objects in range.
    #[error("object {object} is none of the source's")]
    Object {
        /// What the hlod names.
        object: u32,
    },
    /// Source triangles add up.
    #[error("it counts {said} source triangles, its parts {sum}")]
    SourceTriangles {
        /// The count.
        said: u64,
        /// The sum.
        sum: u64,
    },
    /// Errors are distances.
    #[error("its error {error} is no distance")]
    Error {
        /// The error.
        error: f64,
    },
    /// Errors grow towards coarser levels and towards the root.
    #[error("its error {error} is smaller than {finer} of what it stands for")]
    NotMonotone {
        /// The error.
        error: f64,
        /// The greater error of something finer.
        finer: f64,
    },
    /// Blobs in range.
    #[error("blob {blob} is not in the table")]
    NoBlob {
        /// What the part names.
        blob: u32,
    },
    /// Placements in range.
    #[error("transform {transform} is not in the table")]
    NoTransform {
        /// What the part names.
        transform: u32,
    },
    /// What is drawn under a hlod's placement has vertices in its space.
    #[error("blob {blob} is a patch of a scan cube")]
    PatchAsPart {
        /// What the part names.
        blob: u32,
    },
    /// Levels and cubes know their blobs.
    #[error("it counts {said} triangles, its blobs {found}")]
    Triangles {
        /// The count.
        said: u32,
        /// The sum over the blobs of its parts or of its patches.
        found: u64,
    },
    /// Grid steps are powers of two.
    #[error("its step {step} is no power of two")]
    Step {
        /// The step.
        step: f64,
    },
    /// Meshes have triangles, and 16 bits reach every vertex.
    #[error("{vertices} vertices and {triangles} triangles are no mesh of {bytes} bytes")]
    MeshSize {
        /// Vertices.
        vertices: u32,
        /// Triangles.
        triangles: u32,
        /// Bytes.
        bytes: u64,
    },
    /// Vertices are plain, textured or projected, the last with normals beside colours or without.
    #[error("its vertex layout {layout} does not exist")]
    Layout {
        /// The layout.
        layout: u32,
    },
    /// Every triangle of a blob has a class.
    #[error("its classes count {sum} triangles instead of {triangles}")]
    Classes {
        /// Sum over the classes.
        sum: u64,
        /// Triangles of the blob.
        triangles: u32,
    },
    /// The cutoff of a mask lies in textured vertices.
    #[error("it has masked triangles without textured vertices")]
    PlainMask,
    /// Patches of scan cubes, and they alone, have a picture, of no more tiles than it is large.
    #[error("it cannot have a picture of {side} pixels a side and {tiles} tiles")]
    Picture {
        /// Pixels.
        side: u32,
        /// Stored tiles.
        tiles: u32,
    },
    /// Patches are opaque and seen from both sides.
    #[error("it is a patch whose triangles are not all opaque and double-sided")]
    PatchClass,
    /// A patch's window begins where a tile of its face does.
    #[error("it is a patch whose origin is no place of a tile in a picture")]
    PatchOrigin,
    /// Windows lie in their face.
    #[error("it is a patch whose window reaches beyond its face of {side} pixels a side")]
    Window {
        /// Pixels of the face.
        side: u32,
    },
    /// Every patch belongs to exactly one cube, and to one of its faces.
    #[error("it is a patch of {owners} cubes")]
    PatchOwners {
        /// How many.
        owners: u32,
    },
    /// Cells have an inside.
    #[error("the least corner of its box is not less than the greatest in every axis")]
    FlatCell,
    /// A near field reaches less than half a cell beyond it.
    #[error("its margin {margin} is no share of its sides below a half")]
    Margin {
        /// The margin.
        margin: f32,
    },
    /// Cells do not overlap.
    #[error("it overlaps view cell {other}")]
    Overlap {
        /// One that comes before it.
        other: u32,
    },
    /// Ways to make a far field.
    #[error("its method {method} does not exist")]
    Method {
        /// The method.
        method: u32,
    },
    /// Cubes of consecutive cells lie one after another.
    #[error(
        "its cubes {first}..+{count} do not follow those of the cell before, which end at {expected}"
    )]
    CubeRange {
        /// First cube.
        first: u32,
        /// How many.
        count: u32,
        /// Where the first should be.
        expected: u32,
    },
    /// A cell has cubes if it has a method.
    #[error("{count} cubes are not what its method makes")]
    CubeCount {
        /// How many.
        count: u32,
    },
    /// Every cube belongs to a cell.
    #[error("it belongs to no view cell")]
    StrayCube,
    /// Viewpoints of samples lie in their cell.
    #[error("its viewpoint lies outside its cell")]
    OutsideCell,
    /// The cube a delta cube depends on comes before it in the same cell; others depend on none.
    #[error("parent {parent} is no cube it can depend on")]
    CubeParent {
        /// What the cube names.
        parent: u32,
    },
    /// Faces have whole tiles.
    #[error("its faces cannot have {side} pixels a side")]
    Face {
        /// Pixels.
        side: u32,
    },
    /// Patches of a face end where those of the next start.
    #[error("the patches of its faces do not follow one another")]
    Patches,
    /// Patches in range.
    #[error("blob {blob} is no patch of a scan cube")]
    NoPatch {
        /// What the cube names.
        blob: u32,
    },
    /// Sides of textures are powers of two.
    #[error("its side {side} is no power of two from 1 to {MAX_SIDE}")]
    Side {
        /// Pixels.
        side: u32,
    },
    /// Ways to repeat a texture.
    #[error("its wrap modes {wrap:#x} do not exist")]
    Wrap {
        /// The two modes.
        wrap: u32,
    },
    /// A texture has all its mips.
    #[error("it is {bytes} bytes long instead of {expected}")]
    TextureSize {
        /// Bytes.
        bytes: u64,
        /// What its side calls for.
        expected: u64,
    },
    /// Lists of textures of consecutive textured blobs lie one after another.
    #[error(
        "its textures {first}..+{count} do not follow those of the blob before, which end at {expected}"
    )]
    TextureRange {
        /// First of its list.
        first: u32,
        /// How many.
        count: u32,
        /// Where the first should be.
        expected: u32,
    },
    /// A list of textures ascends and names textures there are.
    #[error("its list of textures does not ascend or names one that does not exist")]
    TextureList,
    /// Every list of textures belongs to a blob.
    #[error("texture lists are left over")]
    StrayTextures,
    /// Measures are counts and lengths.
    #[error("a measured quality is negative")]
    Negative,
    /// Blobs and textures lie one after the other, each at the next multiple of 64.
    #[error("it starts at {offset} instead of {expected}")]
    Offset {
        /// Where it starts.
        offset: u64,
        /// Where it should.
        expected: u64,
    },
}

/// A broken rule and where.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{place}: {rule}")]
pub struct Violation {
    /// Where.
    pub place: Place,
    /// What.
    pub rule: Rule,
}
