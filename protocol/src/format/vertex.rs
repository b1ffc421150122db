//! A vertex as it lies in a geometry page and in GPU memory: 16 bytes, 32 where it is textured.
//!
//! A blob is `vertices` of these, then `3 * triangles` 16-bit indices, the end padded with zeros to 4
//! bytes. Positions are 21-bit unsigned integers in units of the blob's power-of-two `step`, from its
//! `origin`, so that decoding in f32 is exact; pieces of one object with the same step share one grid
//! and therefore close without cracks.

use bytemuck::{Pod, Zeroable};

/// Bits of a position coordinate.
pub const POSITION_BITS: u32 = 21;
/// Largest value of a position coordinate.
pub const POSITION_MAX: u32 = (1 << POSITION_BITS) - 1;
/// Most vertices of one blob: indices are 16 bits wide.
pub const MAX_BLOB_VERTICES: usize = 1 << 16;

/// One vertex.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Pod, Zeroable)]
#[repr(C)]
pub struct Vertex {
    /// x in bits 0..21, y in bits 21..42, z in bits 42..63 of `position[0] | position[1] << 32`.
    pub position: [u32; 2],
    /// Octahedral unit normal in mesh space: two signed 16-bit fractions of 32767, x in the low half.
    pub normal: u32,
    /// Linear base colour, RGBA, 8 bits each, red in the low byte.
    pub color: u32,
}

impl Vertex {
    /// Packs a grid position.
    pub fn pack_position(grid: [u32; 3]) -> [u32; 2] {
        debug_assert!(grid.iter().all(|&c| c <= POSITION_MAX));
        let bits = u64::from(grid[0])
            | u64::from(grid[1]) << POSITION_BITS
            | u64::from(grid[2]) << (2 * POSITION_BITS);
        [bits as u32, (bits >> 32) as u32]
    }

    /// The grid position.
    pub fn grid(&self) -> [u32; 3] {
        let bits = u64::from(self.position[0]) | u64::from(self.position[1]) << 32;
        let mask = u64::from(POSITION_MAX);
        [
            (bits & mask) as u32,
            (bits >> POSITION_BITS & mask) as u32,
            (bits >> (2 * POSITION_BITS) & mask) as u32,
        ]
    }

    /// Packs a unit normal (Meyer et al. 2010, octahedron mapping).
    pub fn pack_normal(n: [f32; 3]) -> u32 {
        let [x, y] = octahedral(n);
        let quantise = |v: f32| (v.clamp(-1.0, 1.0) * 32767.0).round() as i16 as u16;
        u32::from(quantise(x)) | u32::from(quantise(y)) << 16
    }

    /// The normal, not normalised (its length lies in [1/sqrt 3, 1]).
    pub fn unpack_normal(packed: u32) -> [f32; 3] {
        let fraction = |bits: u32| f32::from(bits as u16 as i16) / 32767.0;
        from_octahedral([fraction(packed), fraction(packed >> 16)])
    }
}

/// A direction as a place in a square of -1 to 1 (Meyer et al. 2010): straight up z lies in the middle, straight
/// down in all corners.
pub fn octahedral(n: [f32; 3]) -> [f32; 2] {
    let sum = n[0].abs() + n[1].abs() + n[2].abs();
    let (x, y) = if sum > 0.0 { (n[0] / sum, n[1] / sum) } else { (0.0, 0.0) };
    let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
    if n[2] < 0.0 { [(1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)] } else { [x, y] }
}

/// The direction of such a place, not normalised.
pub fn from_octahedral([x, y]: [f32; 2]) -> [f32; 3] {
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let toward = |v: f32| if v >= 0.0 { v - fold } else { v + fold };
    [toward(x), toward(y), z]
}

/// A vertex of a mesh with textures or a mask: 32 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TexturedVertex {
    /// Place, normal and a colour that multiplies the texture's.
    pub plain: Vertex,
    /// Texture coordinates, not wrapped: the whole texture spans 0 to 1, from the first pixel of the
    /// first row.
    pub tex_coord: [f32; 2],
    /// Index into the texture table, or [`super::NONE`]; a triangle takes it from its first corner.
    pub texture: u32,
    /// Least alpha at which a masked triangle is there, taken from its first corner; 0 in other classes.
    pub cutoff: f32,
}

/// What the vertices of a blob are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum Layout {
    /// [`Vertex`].
    Plain = 0,
    /// [`TexturedVertex`].
    Textured = 1,
    /// [`super::projected`]: 8 bytes, a place in the picture of a scan cube's face and its disparity.
    Projected = 2,
    /// The same, and normals lie beside the picture's colours.
    ProjectedNormals = 3,
}

impl Layout {
    /// The layout of a number in a file.
    pub fn of(number: u32) -> Option<Self> {
        [Self::Plain, Self::Textured, Self::Projected, Self::ProjectedNormals]
            .into_iter()
            .find(|&layout| layout as u32 == number)
    }

    /// Bytes of one vertex.
    pub fn vertex_bytes(self) -> usize {
        match self {
            Self::Plain => size_of::<Vertex>(),
            Self::Textured => size_of::<TexturedVertex>(),
            Self::Projected | Self::ProjectedNormals => super::projected::VERTEX_BYTES,
        }
    }

    /// Whether it is that of a patch of a scan cube's face.
    pub fn is_projected(self) -> bool {
        matches!(self, Self::Projected | Self::ProjectedNormals)
    }
}

/// Vertices of a mesh that is to be written.
#[derive(Debug, Clone, Copy)]
pub enum Vertices<'a> {
    /// Without textures.
    Plain(&'a [Vertex]),
    /// With textures or masks.
    Textured(&'a [TexturedVertex]),
}

impl Vertices<'_> {
    /// What they are.
    pub fn layout(&self) -> Layout {
        match self {
            Self::Plain(_) => Layout::Plain,
            Self::Textured(_) => Layout::Textured,
        }
    }

    /// How many.
    pub fn count(&self) -> usize {
        match self {
            Self::Plain(vertices) => vertices.len(),
            Self::Textured(vertices) => vertices.len(),
        }
    }

    /// As they lie in a file.
    pub(super) fn bytes(&self) -> &[u8] {
        match self {
            Self::Plain(vertices) => bytemuck::cast_slice(vertices),
            Self::Textured(vertices) => bytemuck::cast_slice(vertices),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_round_trip() {
        for grid in [
            [0, 0, 0],
            [POSITION_MAX, 0, POSITION_MAX],
            [1, 2_000_000, 1 << 20],
            [5, POSITION_MAX, 7],
        ] {
            let position = Vertex::pack_position(grid);
            assert_eq!(Vertex { position, normal: 0, color: 0 }.grid(), grid);
        }
    }

    #[test]
    fn normals_round_trip_within_a_tenth_of_a_milliradian() {
        for i in 0..1000u32 {
            let a = i as f32 * 0.7;
            let z = (i as f32 / 999.0) * 2.0 - 1.0;
            let r = (1.0 - z * z).sqrt();
            let n = [r * a.cos(), r * a.sin(), z];
            let u = Vertex::unpack_normal(Vertex::pack_normal(n));
            let length = (u[0] * u[0] + u[1] * u[1] + u[2] * u[2]).sqrt();
            let difference = (0..3).map(|k| (u[k] / length - n[k]).powi(2)).sum::<f32>().sqrt();
            assert!(difference < 1e-4, "{n:?} {u:?}");
        }
    }
}
