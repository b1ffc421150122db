//! The inside of a blob: vertices, then 16-bit indices, then zeros up to 4 bytes. What follows in a
//! face of a scan cube is [`super::projected`]'s.

use super::vertex::{Layout, MAX_BLOB_VERTICES, POSITION_BITS};
use super::{Blob, NONE, TexturedVertex, Vertex, Vertices, projected};
use std::collections::BTreeSet;

/// Why a blob's bytes cannot be drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum BlobDamage {
    /// Not as many bytes as the blob says.
    #[error("it is {found} bytes long instead of {expected}")]
    Length {
        /// Bytes there are.
        found: u64,
        /// Bytes there should be.
        expected: u64,
    },
    /// The bytes are not those that were written.
    #[error("its checksum does not match")]
    Checksum,
    /// An index names no vertex.
    #[error("index {index} names no vertex")]
    Index {
        /// Position in the index list.
        index: u32,
    },
    /// A vertex names no texture of the blob's list.
    #[error("vertex {vertex} names texture {texture}, which is not in its list")]
    Texture {
        /// The vertex.
        vertex: u32,
        /// What it names.
        texture: u32,
    },
    /// A texture coordinate or a cutoff is no number.
    #[error("vertex {vertex} has a texture coordinate or cutoff that is not finite")]
    NotFinite {
        /// The vertex.
        vertex: u32,
    },
    /// A vertex of a face lies outside its picture.
    #[error("vertex {vertex} lies outside its picture")]
    OutsidePicture {
        /// The vertex.
        vertex: u32,
    },
    /// A face's table names no stored tile, or one that it has named before.
    #[error("entry {entry} of its tile table is {tile}, which is no tile that is left")]
    Tile {
        /// Position in the table.
        entry: u32,
        /// What it says.
        tile: u32,
    },
    /// A stored tile is named nowhere.
    #[error("only {named} of its tiles are named in its tile table")]
    StrayTile {
        /// Entries that name one.
        named: u32,
    },
    /// Bit 63 of a position or the padding is not zero.
    #[error("bits that must be zero are not")]
    Padding,
}

/// Bytes that a blob's counts call for.
pub fn blob_bytes(blob: &Blob) -> u64 {
    let of_mesh = mesh_bytes(blob.vertex_layout(), blob.vertices, blob.triangles);
    of_mesh + projected::image_bytes(blob.vertex_layout(), blob.image)
}

/// Bytes of so many vertices and triangles.
pub(super) fn mesh_bytes(layout: Layout, vertices: u32, triangles: u32) -> u64 {
    let of_vertices = u64::from(vertices) * layout.vertex_bytes() as u64;
    let unpadded = of_vertices + u64::from(triangles) * 6;
    unpadded.next_multiple_of(4)
}

/// Lays a mesh out as a blob.
///
/// # Panics
/// As [`lay_out`].
pub(super) fn encode(vertices: Vertices<'_>, indices: &[u16]) -> Vec<u8> {
    lay_out(vertices.layout(), vertices.bytes(), indices)
}

/// Vertices as they lie in a file, indices and the zeros behind them.
///
/// # Panics
/// If there is no triangle, `indices` is not a list of triangles, an index names no vertex, or there
/// are more than [`MAX_BLOB_VERTICES`] vertices.
pub(super) fn lay_out(layout: Layout, vertices: &[u8], indices: &[u16]) -> Vec<u8> {
    assert!(
        !indices.is_empty() && indices.len().is_multiple_of(3),
        "a mesh is a list of triangles"
    );
    let count = vertices.len() / layout.vertex_bytes();
    assert!(count <= MAX_BLOB_VERTICES, "{count} vertices");
    assert!(indices.iter().all(|&i| usize::from(i) < count), "an index names no vertex");
    let triangles = u32::try_from(indices.len() / 3).expect("fewer than 2^32 triangles");
    let total = mesh_bytes(layout, count as u32, triangles) as usize;
    let mut bytes = Vec::with_capacity(total);
    bytes.extend_from_slice(vertices);
    bytes.extend_from_slice(bytemuck::cast_slice(indices));
    bytes.resize(total, 0);
    bytes
}

/// The vertices of a mesh whose bytes have been checked, without what textures need.
///
/// # Panics
/// If the blob is a face of a scan cube, which no part names ([`super::check()`]).
pub fn vertices_of<'a>(blob: &Blob, bytes: &'a [u8]) -> impl Iterator<Item = Vertex> + use<'a> {
    assert!(!blob.is_projected(), "a face has vertices of another kind");
    let of_vertices = &bytes[..blob.vertex_bytes()];
    let plain = |chunk: &[u8]| bytemuck::pod_read_unaligned(&chunk[..size_of::<Vertex>()]);
    of_vertices.chunks_exact(blob.vertex_layout().vertex_bytes()).map(plain)
}

/// The vertices of a textured blob whose bytes have been checked; none of another.
pub fn textured_vertices_of<'a>(
    blob: &Blob,
    bytes: &'a [u8],
) -> impl Iterator<Item = TexturedVertex> + use<'a> {
    let of_vertices = if blob.is_textured() { &bytes[..blob.vertex_bytes()] } else { &[] };
    of_vertices.chunks_exact(size_of::<TexturedVertex>()).map(bytemuck::pod_read_unaligned)
}

/// The textures that the vertices of a blob name, ascending; its bytes have been checked or just made.
pub(super) fn textures_in(blob: &Blob, bytes: &[u8]) -> Vec<u32> {
    let named = textured_vertices_of(blob, bytes).map(|vertex| vertex.texture);
    let all: BTreeSet<u32> = named.filter(|&texture| texture != NONE).collect();
    all.into_iter().collect()
}

/// Checks a blob's bytes before anybody draws them: length, checksum, indices, zero bits, that what it
/// names is among `textures`, its list ([`super::Skeleton::textures_of`]), and of a face places in its picture and tiles.
///
/// What passes cannot make a rasteriser read out of bounds. The blob's own record is known to be
/// good ([`super::check()`]).
pub fn check_blob(blob: &Blob, bytes: &[u8], textures: &[u32]) -> Result<(), BlobDamage> {
    let expected = blob_bytes(blob);
    if bytes.len() as u64 != expected || blob.bytes != expected {
        return Err(BlobDamage::Length { found: bytes.len() as u64, expected });
    }
    if crc32c::crc32c(bytes) != blob.crc {
        return Err(BlobDamage::Checksum);
    }
    let of_mesh = mesh_bytes(blob.vertex_layout(), blob.vertices, blob.triangles) as usize;
    let (vertices, rest) = bytes[..of_mesh].split_at(blob.vertex_bytes());
    let (indices, padding) = rest.split_at(blob.triangles as usize * 6);
    let outside = |pair: &[u8]| u32::from(u16::from_le_bytes([pair[0], pair[1]])) >= blob.vertices;
    if let Some(index) = indices.chunks_exact(2).position(outside) {
        return Err(BlobDamage::Index { index: index as u32 });
    }
    let spare_bits = u64::MAX << (3 * POSITION_BITS);
    let (positions, _) = vertices.as_chunks::<8>();
    let each = blob.vertex_layout().vertex_bytes() / 8;
    let spare_used = |&position: &[u8; 8]| u64::from_le_bytes(position) & spare_bits != 0;
    if padding.iter().any(|&b| b != 0) || positions.iter().step_by(each).any(spare_used) {
        return Err(BlobDamage::Padding);
    }
    if blob.is_projected() {
        return projected::check(&projected::Patch::of(blob, bytes));
    }
    for (at, vertex) in (0..).zip(textured_vertices_of(blob, bytes)) {
        let TexturedVertex { tex_coord: [u, v], texture, cutoff, .. } = vertex;
        if texture != NONE && textures.binary_search(&texture).is_err() {
            return Err(BlobDamage::Texture { vertex: at, texture });
        }
        if ![u, v, cutoff].iter().all(|c| c.is_finite()) {
            return Err(BlobDamage::NotFinite { vertex: at });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn mesh(vertices: Vertices<'_>) -> (Blob, Vec<u8>) {
        let bytes = encode(vertices, &[0, 1, 2]);
        let blob = Blob {
            vertices: 3,
            triangles: 1,
            bytes: bytes.len() as u64,
            crc: crc32c::crc32c(&bytes),
            layout: vertices.layout() as u32,
            ..Blob::zeroed()
        };
        (blob, bytes)
    }

    fn triangle() -> (Blob, Vec<u8>) {
        mesh(Vertices::Plain(&[Vertex::zeroed(); 3]))
    }

    fn textured(last: TexturedVertex, textures: &[u32]) -> Result<(), BlobDamage> {
        let first = TexturedVertex { texture: NONE, ..TexturedVertex::zeroed() };
        let (blob, bytes) = mesh(Vertices::Textured(&[first, first, last]));
        assert_eq!(bytes.len(), 3 * 32 + 6 + 2);
        assert_eq!(vertices_of(&blob, &bytes).count(), 3);
        assert_eq!(textured_vertices_of(&blob, &bytes).count(), 3);
        check_blob(&blob, &bytes, textures)
    }

    #[test]
    fn textured_vertices_name_textures_that_exist_at_finite_places() {
        let named = |texture| TexturedVertex { texture, ..TexturedVertex::zeroed() };
        assert_eq!(textured(named(NONE), &[]), Ok(()));
        assert_eq!(textured(named(1), &[1]), Ok(()));
        assert_eq!(
            textured(named(2), &[0, 1, 3]),
            Err(BlobDamage::Texture { vertex: 2, texture: 2 })
        );
        assert_eq!(textured(named(0), &[]), Err(BlobDamage::Texture { vertex: 2, texture: 0 }));
        for bad in [f32::NAN, f32::INFINITY] {
            for at in 0..3 {
                let mut vertex = named(NONE);
                let TexturedVertex { tex_coord: [u, v], cutoff, .. } = &mut vertex;
                *[u, v, cutoff][at] = bad;
                assert_eq!(textured(vertex, &[]), Err(BlobDamage::NotFinite { vertex: 2 }));
            }
        }
    }

    /// The blob after `bytes` were replaced by someone who also fixed the checksum.
    fn forged(change: impl FnOnce(&mut [u8])) -> Result<(), BlobDamage> {
        let (mut blob, mut bytes) = triangle();
        change(&mut bytes);
        blob.crc = crc32c::crc32c(&bytes);
        check_blob(&blob, &bytes, &[])
    }

    #[test]
    fn a_blob_is_padded_to_four_bytes() {
        let (blob, bytes) = triangle();
        assert_eq!(bytes.len(), 3 * 16 + 6 + 2);
        assert_eq!(check_blob(&blob, &bytes, &[]), Ok(()));
        assert_eq!(vertices_of(&blob, &bytes).count(), 3);
    }

    #[test]
    fn short_and_changed_bytes_are_found() {
        let (blob, mut bytes) = triangle();
        assert!(matches!(check_blob(&blob, &[], &[]), Err(BlobDamage::Length { found: 0, .. })));
        bytes[5] ^= 1;
        assert_eq!(check_blob(&blob, &bytes, &[]), Err(BlobDamage::Checksum));
    }

    #[test]
    fn forged_contents_are_found_even_with_a_right_checksum() {
        assert_eq!(forged(|_| ()), Ok(()));
        assert_eq!(forged(|b| b[52] = 3), Err(BlobDamage::Index { index: 2 }));
        assert_eq!(forged(|b| b[55] = 1), Err(BlobDamage::Padding));
        assert_eq!(forged(|b| b[7] = 0x80), Err(BlobDamage::Padding));
    }

    #[test]
    #[should_panic(expected = "names no vertex")]
    fn encoding_a_wild_index_is_our_mistake() {
        encode(Vertices::Plain(&[Vertex::zeroed(); 2]), &[0, 1, 2]);
    }
}
