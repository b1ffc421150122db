//! The inside of a projected blob: a patch of a face of a scan cube, mesh and picture in one (paper 000,
//! section 4).
//!
//! A face is a square picture of `side` pixels taken from the sample's viewpoint `c`, 90 degrees wide. With
//! the face's axes `right`, `down`, `forward` (unit, in scene axes) a point at view depth `z` that is seen
//! at pixel coordinates `(u, v)`, from the picture's top left corner, is
//!
//! ```text
//! p = c + z * (forward + right * (2 u / side - 1) + down * (2 v / side - 1)),    disparity = 1 / z
//! ```
//!
//! A **patch** is some of a face's triangles with the square window of the picture that they lie in, so that what
//! lies outside a camera's frustum can be left out, in memory too. A vertex holds `u` and `v` from the window's top
//! left corner (the first two coordinates of the blob's `origin`, pixels) in 1/16 pixels and the disparity in units
//! of the blob's `step`, as the three coordinates of a grid position. Since `(u, v, disparity)` is a projective image of space, what is flat stays
//! flat, and `(p - eye) * disparity` is linear in the three:
//!
//! ```text
//! (p - eye) * disparity = forward + right * (2 u / side - 1) + down * (2 v / side - 1) + (c - eye) * disparity
//! ```
//!
//! so a vertex is transformed without a division, a disparity of 0 is infinitely far, and `u, v`
//! interpolated with the homogeneous clip position are where the sample saw the point: projective
//! texturing without a second set of coordinates.
//!
//! Bytes: vertices, 16-bit indices, zeros up to 4 bytes, then the window's picture: for a window of `side` pixels a
//! table of `(side / 16)^2` 32-bit
//! numbers, row by row, 0 for a tile that no triangle shows, else 1 + its place among the stored tiles; then
//! the tiles, 16x16 pixels each, as 16 BC1 blocks of 4x4 pixels row by row. A pixel is an sRGB-encoded
//! colour as it was shaded when the sample was taken.
//!
//! Under [`Layout::ProjectedNormals`] as many tiles follow in the same order, of normals: what the light was that a
//! colour has, and what another would be, follows from them. A block has two ends, each an octahedral direction
//! ([`from_octahedral`]) of two codes `c`, `(c - 128) / 127` apiece, and the selectors of BC1 between their codes. The
//! axes are the face's `right`, `up` and `-forward`: the middle of the octahedron looks at the viewpoint, and what is
//! seen lies around it, away from the seams.

use super::mesh::{self, BlobDamage};
use super::vertex::{Layout, POSITION_BITS, POSITION_MAX, from_octahedral};
use super::{Blob, Class};

/// Bytes of a vertex: [`super::Vertex::pack_position`].
pub const VERTEX_BYTES: usize = 8;
/// Grid units of a pixel.
pub const SUBPIXELS: u32 = 16;
/// Pixels along a side of a tile.
pub const TILE: u32 = 16;
/// Bytes of a tile of colours, and of one of normals.
pub const TILE_BYTES: usize = 128;
/// Largest side of a face: its grid coordinates fit a position.
pub const MAX_SIDE: u32 = 4096;

/// Axes of the six faces of a cube, in scene axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceAxes {
    /// Where the face looks.
    pub forward: [f64; 3],
    /// Right in its picture: `forward x up`.
    pub right: [f64; 3],
    /// Up in its picture.
    pub up: [f64; 3],
}

/// The faces of a cube: +x, -x, +y, -y, +z, -z.
pub const FACES: [FaceAxes; 6] = [
    FaceAxes { forward: [1.0, 0.0, 0.0], right: [0.0, -1.0, 0.0], up: [0.0, 0.0, 1.0] },
    FaceAxes { forward: [-1.0, 0.0, 0.0], right: [0.0, 1.0, 0.0], up: [0.0, 0.0, 1.0] },
    FaceAxes { forward: [0.0, 1.0, 0.0], right: [1.0, 0.0, 0.0], up: [0.0, 0.0, 1.0] },
    FaceAxes { forward: [0.0, -1.0, 0.0], right: [-1.0, 0.0, 0.0], up: [0.0, 0.0, 1.0] },
    FaceAxes { forward: [0.0, 0.0, 1.0], right: [0.0, -1.0, 0.0], up: [-1.0, 0.0, 0.0] },
    FaceAxes { forward: [0.0, 0.0, -1.0], right: [0.0, -1.0, 0.0], up: [1.0, 0.0, 0.0] },
];

/// Whether a face or a window may have this many pixels a side: whole tiles.
pub fn is_side(side: u32) -> bool {
    side.is_multiple_of(TILE) && (TILE..=MAX_SIDE).contains(&side)
}

/// Bytes of the picture of a window of `side` pixels with so many stored tiles; none under layouts without.
pub fn image_bytes(layout: Layout, [side, tiles]: [u32; 2]) -> u64 {
    let kinds = match layout {
        Layout::Plain | Layout::Textured => return 0,
        Layout::Projected => 1,
        Layout::ProjectedNormals => 2,
    };
    let across = u64::from(side / TILE);
    across * across * 4 + kinds * u64::from(tiles) * TILE_BYTES as u64
}

/// Tiles that a picture of this side has at most.
pub fn most_tiles(side: u32) -> u32 {
    (side / TILE).pow(2)
}

/// A patch that is to be written.
#[derive(Debug, Clone, Copy)]
pub struct NewPatch<'a> {
    /// Disparity of a grid unit, a power of two, 1 / scene units.
    pub step: f64,
    /// Left and upper side of its window in the face, pixels; whole tiles.
    pub at: [u32; 2],
    /// Pixels along a side of the window.
    pub side: u32,
    /// [`super::Vertex::pack_position`] of u and v in the window, and disparity.
    pub vertices: &'a [[u32; 2]],
    /// Three a triangle.
    pub indices: &'a [u16],
    /// An entry for each tile of the window: 0, or 1 + its place in `tiles`.
    pub table: &'a [u32],
    /// The tiles that are stored, each named once in `table`.
    pub tiles: &'a [[u8; TILE_BYTES]],
    /// As many of normals, if it has any.
    pub normals: Option<&'a [[u8; TILE_BYTES]]>,
}

impl NewPatch<'_> {
    /// Its bytes, and its record but for where they lie, how long they are and their checksum.
    ///
    /// # Panics
    /// If there is no such side, `table`, `tiles` or `normals` are not as their docs say, a vertex lies outside the
    /// picture, or the mesh is none ([`mesh::lay_out`]).
    pub fn encode(&self) -> (Blob, Vec<u8>) {
        let &Self { step, at: [left, top], side, vertices, indices, table, tiles, normals } = self;
        assert!(is_side(side), "a picture of {side} pixels a side");
        assert_eq!(table.len(), most_tiles(side) as usize, "entries of the tile table");
        let layout = match normals {
            None => Layout::Projected,
            Some(normals) => {
                assert_eq!(normals.len(), tiles.len(), "tiles of normals");
                Layout::ProjectedNormals
            }
        };
        let mut bytes = mesh::lay_out(layout, bytemuck::cast_slice(vertices), indices);
        bytes.extend_from_slice(bytemuck::cast_slice(table));
        bytes.extend_from_slice(tiles.as_flattened());
        bytes.extend_from_slice(normals.unwrap_or_default().as_flattened());
        let triangles = (indices.len() / 3) as u32;
        let blob = Blob {
            origin: [f64::from(left), f64::from(top), 0.0],
            step,
            vertices: vertices.len() as u32,
            triangles,
            layout: layout as u32,
            classes: Class::OpaqueDouble.all(triangles),
            image: [side, tiles.len() as u32],
            ..Blob::default()
        };
        check(&Patch::of(&blob, &bytes)).unwrap_or_else(|damage| panic!("no patch: {damage}"));
        (blob, bytes)
    }
}

/// Whether places lie in the picture and the table names each stored tile once.
pub(super) fn check(face: &Patch<'_>) -> Result<(), BlobDamage> {
    let most = u64::from(face.side * SUBPIXELS);
    let (vertices, _) = face.vertices.as_chunks::<VERTEX_BYTES>();
    for (vertex, &position) in (0..).zip(vertices) {
        let bits = u64::from_le_bytes(position);
        let [u, v] = [bits, bits >> POSITION_BITS].map(|bits| bits & u64::from(POSITION_MAX));
        if u > most || v > most {
            return Err(BlobDamage::OutsidePicture { vertex });
        }
    }
    let mut left = vec![true; face.tiles.len() / TILE_BYTES];
    let mut named = 0;
    let (table, _) = face.table.as_chunks::<4>();
    for (entry, &number) in (0..).zip(table) {
        let tile = u32::from_le_bytes(number);
        let Some(place) = tile.checked_sub(1) else { continue };
        if !left.get_mut(place as usize).is_some_and(std::mem::take) {
            return Err(BlobDamage::Tile { entry, tile });
        }
        named += 1;
    }
    if named as usize == left.len() { Ok(()) } else { Err(BlobDamage::StrayTile { named }) }
}

/// The parts of a projected blob whose bytes have been checked.
#[derive(Debug, Clone, Copy)]
pub struct Patch<'a> {
    /// Pixels a side.
    pub side: u32,
    /// Grid positions, 8 bytes each.
    pub vertices: &'a [u8],
    /// Indices, 2 bytes each.
    pub indices: &'a [u8],
    /// Tile table, 4 bytes an entry.
    pub table: &'a [u8],
    /// Stored tiles.
    pub tiles: &'a [u8],
    /// As many bytes of normals, if it has any.
    pub normals: Option<&'a [u8]>,
}

impl<'a> Patch<'a> {
    /// Cuts a blob's bytes.
    pub fn of(blob: &Blob, bytes: &'a [u8]) -> Self {
        let (vertices, rest) = bytes.split_at(blob.vertices as usize * VERTEX_BYTES);
        let of_indices = blob.triangles as usize * 6;
        let indices = &rest[..of_indices];
        let rest = &rest[of_indices.next_multiple_of(4)..];
        let [side, tiles] = blob.image;
        let across = (side / TILE) as usize;
        let (table, rest) = rest.split_at(across * across * 4);
        let of_tiles = tiles as usize * TILE_BYTES;
        let (tiles, rest) = rest.split_at(of_tiles);
        let normals = blob.has_normals().then(|| &rest[..of_tiles]);
        Self { side, vertices, indices, table, tiles, normals }
    }

    /// The colour of a pixel, sRGB-encoded; black where no tile is stored.
    pub fn pixel(&self, x: u32, y: u32) -> [u8; 3] {
        let Some(at) = self.block(x, y) else { return [0; 3] };
        bc1_pixel(std::array::from_fn(|k| self.tiles[at + k]), x % 4, y % 4)
    }

    /// The normal of a pixel, in the face's axes and not normalised, where one is stored.
    pub fn normal(&self, x: u32, y: u32) -> Option<[f32; 3]> {
        let (normals, at) = (self.normals?, self.block(x, y)?);
        Some(normal_pixel(std::array::from_fn(|k| normals[at + k]), x % 4, y % 4))
    }

    /// Where the block of a pixel lies among those stored, bytes.
    fn block(&self, x: u32, y: u32) -> Option<usize> {
        let (across, tile) = (self.side / TILE, [x / TILE, y / TILE]);
        let at = (tile[1] * across + tile[0]) as usize * 4;
        let entry = u32::from_le_bytes(std::array::from_fn(|k| self.table[at + k]));
        let (x, y) = (x % TILE, y % TILE);
        Some(entry.checked_sub(1)? as usize * TILE_BYTES + ((y / 4 * 4 + x / 4) * 8) as usize)
    }
}

/// A pixel of a BC1 block in four-colour mode, whatever the order of its end points: a face has no holes
/// in its picture. Channels are widened by repeating their high bits; the two colours between lie at
/// a third and two thirds, rounded down.
pub fn bc1_pixel(block: [u8; 8], x: u32, y: u32) -> [u8; 3] {
    let [a, b] = bc1_ends(block);
    mixed(a, b, selector(block, x, y))
}

/// The end points of a BC1 block.
pub fn bc1_ends(block: [u8; 8]) -> [[u32; 3]; 2] {
    [0, 2].map(|at| {
        let bits = u32::from(u16::from_le_bytes([block[at], block[at + 1]]));
        let (r, g, b) = (bits >> 11, bits >> 5 & 63, bits & 31);
        [r << 3 | r >> 2, g << 2 | g >> 4, b << 3 | b >> 2]
    })
}

/// A pixel of a block of normals, in the face's axes and not normalised.
pub fn normal_pixel(block: [u8; 8], x: u32, y: u32) -> [f32; 3] {
    let [a, b] = [0, 2].map(|at| [block[at], block[at + 1]].map(u32::from));
    from_normal_code(mixed(a, b, selector(block, x, y)))
}

/// The direction of a pair of codes of a block of normals, not normalised.
pub fn from_normal_code(code: [u8; 2]) -> [f32; 3] {
    from_octahedral(code.map(|code| (f32::from(code) - 128.0) / 127.0))
}

/// The selector of a pixel of a block.
pub fn selector(block: [u8; 8], x: u32, y: u32) -> u32 {
    let selectors = u32::from_le_bytes(std::array::from_fn(|k| block[4 + k]));
    selectors >> (2 * (4 * y + x)) & 3
}

/// The code between two ends that a selector names: the first, the second, or at a third and two thirds, rounded
/// down.
pub fn mixed<const N: usize>(a: [u32; N], b: [u32; N], selector: u32) -> [u8; N] {
    let (of_a, of_b) = match selector {
        0 => (3, 0),
        1 => (0, 3),
        2 => (2, 1),
        _ => (1, 2),
    };
    std::array::from_fn(|k| ((of_a * a[k] + of_b * b[k]) / 3) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::fixture::face;
    use crate::format::mesh::check_blob;

    #[test]
    fn faces_are_right_handed_and_look_everywhere() {
        let mut seen = [0.0; 3];
        for FaceAxes { forward: f, right, up: u } in FACES {
            let cross =
                [f[1] * u[2] - f[2] * u[1], f[2] * u[0] - f[0] * u[2], f[0] * u[1] - f[1] * u[0]];
            assert_eq!(cross, right);
            (0..3).for_each(|k| seen[k] += f[k].abs());
        }
        assert_eq!(seen, [2.0; 3]);
    }

    #[test]
    fn the_largest_face_fits_a_grid_position() {
        const { assert!(MAX_SIDE * SUBPIXELS < 1 << POSITION_BITS) };
        assert!(is_side(16) && is_side(512) && is_side(4096));
        assert!(is_side(48) && !is_side(0) && !is_side(8) && !is_side(40) && !is_side(8192));
    }

    #[test]
    fn a_block_has_its_ends_and_two_colours_between() {
        // Red 31 and blue 31; one row of each selector.
        let block = [0x00, 0xf8, 0x1f, 0x00, 0b1110_0100, 0, 0x55, 0xff];
        assert_eq!(bc1_pixel(block, 0, 0), [255, 0, 0]);
        assert_eq!(bc1_pixel(block, 1, 0), [0, 0, 255]);
        assert_eq!(bc1_pixel(block, 2, 0), [170, 0, 85]);
        assert_eq!(bc1_pixel(block, 3, 0), [85, 0, 170]);
        assert_eq!(bc1_pixel(block, 3, 2), [0, 0, 255]);
        assert_eq!(bc1_pixel(block, 0, 3), [85, 0, 170]);
    }

    #[test]
    fn a_pixel_is_found_through_the_table() {
        let mut table = vec![0u8; 4 * 4];
        table[4 * 3] = 2;
        let mut tiles = vec![0u8; 2 * TILE_BYTES];
        // Second stored tile, block (1, 2): all of its first end, white.
        let block = TILE_BYTES + (2 * 4 + 1) * 8;
        tiles[block..block + 2].copy_from_slice(&[0xff, 0xff]);
        // Likewise its first end is the axis to the right, the others' are beyond straight left.
        let mut normals = vec![0u8; 2 * TILE_BYTES];
        normals[block..block + 2].copy_from_slice(&[255, 128]);
        let face = Patch {
            side: 32,
            vertices: &[],
            indices: &[],
            table: &table,
            tiles: &tiles,
            normals: Some(&normals),
        };
        assert_eq!(face.pixel(16 + 4, 16 + 8), [255; 3]);
        assert_eq!(face.pixel(16 + 8, 16 + 8), [0; 3]);
        assert_eq!(face.pixel(4, 8), [0; 3]);
        assert_eq!(face.normal(16 + 4, 16 + 8), Some([1.0, 0.0, 0.0]));
        assert!(face.normal(16 + 8, 16 + 8).is_some_and(|n| n[2] < -0.9), "behind the face");
        assert_eq!(face.normal(4, 8), None);
        assert_eq!(Patch { normals: None, ..face }.normal(16 + 4, 16 + 8), None);
        let all = (table.len() + tiles.len()) as u64;
        assert_eq!(image_bytes(Layout::Projected, [32, 2]), all);
        assert_eq!(image_bytes(Layout::ProjectedNormals, [32, 2]), all + normals.len() as u64);
    }

    #[test]
    fn normals_lie_between_the_ends_of_their_block() {
        // Straight at the viewpoint and straight up; one row of each selector.
        let block = [128, 128, 128, 255, 0b1110_0100, 0, 0x55, 0xff];
        assert_eq!(normal_pixel(block, 0, 0), [0.0, 0.0, 1.0]);
        assert_eq!(normal_pixel(block, 1, 0), [0.0, 1.0, 0.0]);
        for (x, third) in [(2, 42.0 / 127.0), (3, 84.0 / 127.0)] {
            assert_eq!(normal_pixel(block, x, 0), [0.0, third, 1.0 - third]);
        }
        assert_eq!(normal_pixel(block, 3, 2), normal_pixel(block, 1, 0));
        assert_eq!(normal_pixel(block, 0, 3), normal_pixel(block, 3, 0));
        // Whatever stands there is a direction.
        for (a, b) in (0..=255).flat_map(|a| (0..=255).map(move |b| (a, b))) {
            let [x, y, z] = from_normal_code([a, b]);
            assert!(x * x + y * y + z * z > 0.3, "{a} {b}");
        }
    }

    /// The face after `change` by someone who also fixed the checksum.
    fn forged(face: &NewPatch<'_>, change: impl FnOnce(&mut [u8])) -> Result<(), BlobDamage> {
        let (mut blob, mut bytes) = face.encode();
        change(&mut bytes);
        (blob.bytes, blob.crc) = (bytes.len() as u64, crc32c::crc32c(&bytes));
        check_blob(&blob, &bytes, &[])
    }

    #[test]
    fn bytes_lie_as_documented() {
        let (blob, bytes) = face().encode();
        assert_eq!(bytes.len(), 3 * 8 + 6 + 2 + 4 + 128);
        let Patch { vertices, indices, table, tiles, .. } = Patch::of(&blob, &bytes);
        assert_eq!([vertices.len(), indices.len(), table.len(), tiles.len()], [24, 6, 4, 128]);
        assert_eq!(forged(&face(), |_| ()), Ok(()));
        let short = check_blob(&Blob { image: [16, 2], ..blob }, &bytes, &[]);
        assert!(matches!(short, Err(BlobDamage::Length { expected: 292, .. })), "{short:?}");
    }

    #[test]
    fn normals_follow_the_colours() {
        let normals = [[0x44; TILE_BYTES]];
        let face = NewPatch { normals: Some(&normals), ..face() };
        let (blob, bytes) = face.encode();
        assert_eq!(bytes.len(), 3 * 8 + 6 + 2 + 4 + 2 * 128);
        let patch = Patch::of(&blob, &bytes);
        assert_eq!((patch.tiles, patch.normals), (&[0x33; 128][..], Some(&[0x44; 128][..])));
        assert_eq!(forged(&face, |_| ()), Ok(()));
        assert_eq!(forged(&face, |b| b[32] = 2), Err(BlobDamage::Tile { entry: 0, tile: 2 }));
        let layout = Layout::Projected as u32;
        let bare = check_blob(&Blob { layout, ..blob }, &bytes, &[]);
        assert_eq!(bare, Err(BlobDamage::Length { found: 292, expected: 164 }));
        let cut = check_blob(&blob, &bytes[..164], &[]);
        assert_eq!(cut, Err(BlobDamage::Length { found: 164, expected: 292 }));
    }

    #[test]
    #[should_panic(expected = "tiles of normals")]
    fn fewer_normals_than_colours_are_our_mistake() {
        NewPatch { normals: Some(&[]), ..face() }.encode();
    }

    #[test]
    fn forged_faces_are_found_even_with_a_right_checksum() {
        let forged = |change: fn(&mut [u8])| forged(&face(), change);
        assert_eq!(forged(|b| b[24] = 3), Err(BlobDamage::Index { index: 0 }));
        assert_eq!(forged(|b| b[30] = 1), Err(BlobDamage::Padding));
        assert_eq!(forged(|b| b[15] |= 0x80), Err(BlobDamage::Padding));
        // u of the second vertex is 256, the picture's border, and so is v of the third.
        assert_eq!(forged(|b| b[8] = 1), Err(BlobDamage::OutsidePicture { vertex: 1 }));
        assert_eq!(forged(|b| b[18] |= 0x20), Err(BlobDamage::OutsidePicture { vertex: 2 }));
        assert_eq!(forged(|b| b[7] = 0x7f), Ok(()));
        assert_eq!(forged(|b| b[32] = 2), Err(BlobDamage::Tile { entry: 0, tile: 2 }));
        assert_eq!(forged(|b| b[35] = 0xff), Err(BlobDamage::Tile { entry: 0, tile: 0xff00_0001 }));
        assert_eq!(forged(|b| b[32] = 0), Err(BlobDamage::StrayTile { named: 0 }));
    }

    #[test]
    fn every_stored_tile_is_named_once() {
        let tiles = [[0; TILE_BYTES]; 2];
        let large = NewPatch { side: 32, table: &[0, 2, 1, 0], tiles: &tiles, ..face() };
        assert_eq!(forged(&large, |_| ()), Ok(()));
        let twice = BlobDamage::Tile { entry: 3, tile: 2 };
        assert_eq!(forged(&large, |b| b[32 + 12] = 2), Err(twice));
        assert_eq!(forged(&large, |b| b[32 + 8] = 0), Err(BlobDamage::StrayTile { named: 1 }));
        let bare = NewPatch { table: &[0; 4], tiles: &[], ..large };
        assert_eq!(forged(&bare, |_| ()), Ok(()));
    }

    #[test]
    #[should_panic(expected = "vertex 1 lies outside its picture")]
    fn a_vertex_outside_its_picture_is_our_mistake() {
        NewPatch { vertices: &[[0; 2], [257, 0], [0; 2]], ..face() }.encode();
    }
}
