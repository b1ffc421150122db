//! Structs that both Rust and WGSL know, and their layout as tables.

use bytemuck::{Pod, Zeroable};

/// How a field reads its bytes, in WGSL's words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// `u32`.
    Uint32,
    /// `vec2<u32>`.
    Uint32x2,
    /// `f32`.
    Float32,
    /// `vec2<f32>`.
    Float32x2,
    /// `vec3<f32>`.
    Float32x3,
    /// `mat4x4<f32>`, four columns.
    Matrix4,
}

impl Kind {
    /// Size in bytes.
    pub const fn size(self) -> usize {
        match self {
            Self::Uint32 | Self::Float32 => 4,
            Self::Uint32x2 | Self::Float32x2 => 8,
            Self::Float32x3 => 12,
            Self::Matrix4 => 64,
        }
    }
}

/// One field of a mirror.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Its name, the same in WGSL.
    pub name: &'static str,
    /// Bytes from the start of the struct.
    pub offset: usize,
    /// What it holds.
    pub kind: Kind,
}

macro_rules! fields {
    ($owner:ident { $($name:ident: $kind:ident),+ $(,)? }) => {
        &[$(Field {
            name: stringify!($name),
            offset: std::mem::offset_of!($owner, $name),
            kind: Kind::$kind,
        }),+]
    };
}

/// Uniform of every pass.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Frame {
    /// Four columns.
    pub clip_from_eye: [[f32; 4]; 4],
    /// Unit vector towards the sun, scene axes.
    pub sun: [f32; 3],
    /// Light from everywhere.
    pub ambient: f32,
    /// Unit vector towards the sun that pictures of scan cubes show, scene axes.
    pub baked_sun: [f32; 3],
    /// Light of the sun on a surface that faces it.
    pub diffuse: f32,
}

impl Frame {
    /// Layout.
    pub const FIELDS: &[Field] = fields!(Frame {
        clip_from_eye: Matrix4,
        sun: Float32x3,
        ambient: Float32,
        baked_sun: Float32x3,
        diffuse: Float32,
    });
}

/// A mesh vertex in a buffer stepped by vertex: the layout of `protocol::format::vertex`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Vertex {
    /// Three 21-bit grid coordinates.
    pub position: [u32; 2],
    /// Octahedral normal, two signed 16-bit fractions.
    pub normal: u32,
    /// Linear RGBA, 8 bits each.
    pub color: u32,
}

impl Vertex {
    /// Location of the first field; the others follow.
    pub const FIRST_LOCATION: u32 = 0;
    /// Layout.
    pub const FIELDS: &[Field] =
        fields!(Vertex { position: Uint32x2, normal: Uint32, color: Uint32 });
}

/// What follows a [`Vertex`] in the buffer of a textured mesh.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Texturing {
    /// Not wrapped.
    pub tex_coord: [f32; 2],
    /// Index into the [`TextureRecord`]s, or `u32::MAX`.
    pub texture_index: u32,
    /// Least alpha of what is there.
    pub cutoff: f32,
}

impl Texturing {
    /// Location of the first field; the others follow.
    pub const FIRST_LOCATION: u32 = 12;
    /// Layout.
    pub const FIELDS: &[Field] =
        fields!(Texturing { tex_coord: Float32x2, texture_index: Uint32, cutoff: Float32 });
}

/// A texture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct TextureRecord {
    /// Index of its largest mip's place; the others follow. A place is a column and a row on a page, 10
    /// bits each, then the page.
    pub first_place: u32,
    /// Pixels along a side of the largest mip.
    pub side: u32,
    /// 0 repeat, 1 clamp, 2 mirror.
    pub wrap_across: u32,
    /// The same for the other direction.
    pub wrap_down: u32,
}

impl TextureRecord {
    /// Layout.
    pub const FIELDS: &[Field] = fields!(TextureRecord {
        first_place: Uint32,
        side: Uint32,
        wrap_across: Uint32,
        wrap_down: Uint32,
    });
}

/// One draw of a mesh in a buffer stepped by instance.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Instance {
    /// Eye-relative displacement of one grid step along x.
    pub column_x: [f32; 3],
    /// The same along y.
    pub column_y: [f32; 3],
    /// The same along z.
    pub column_z: [f32; 3],
    /// Grid origin relative to the eye.
    pub offset: [f32; 3],
    /// What the item buffer stores.
    pub item: u32,
    /// Disparity of one grid step along z of a projected blob, 0 of others like the three that follow.
    pub disparity_step: f32,
    /// First word of its picture in the buffer.
    pub picture: u32,
    /// Pixels along a side of its picture.
    pub side: u32,
    /// First word of its normals in the buffer, 0 where it has none.
    pub normals: u32,
}

impl Instance {
    /// Location of the first field; the others follow.
    pub const FIRST_LOCATION: u32 = 3;
    /// Layout.
    pub const FIELDS: &[Field] = fields!(Instance {
        column_x: Float32x3,
        column_y: Float32x3,
        column_z: Float32x3,
        offset: Float32x3,
        item: Uint32,
        disparity_step: Float32,
        picture: Uint32,
        side: Uint32,
        normals: Uint32,
    });
}

/// One eye-relative box in a buffer stepped by instance.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct BoxInstance {
    /// Least corner.
    pub least: [f32; 3],
    /// Greatest corner.
    pub greatest: [f32; 3],
}

impl BoxInstance {
    /// Location of the first field; the others follow.
    pub const FIRST_LOCATION: u32 = 0;
    /// Layout.
    pub const FIELDS: &[Field] = fields!(BoxInstance { least: Float32x3, greatest: Float32x3 });
}
