//! The inside of a blob: vertices, then 16-bit indices, then zeros up to 4 bytes.

use super::vertex::{MAX_BLOB_VERTICES, POSITION_BITS};
use super::{Blob, Vertex};

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
    /// Bit 63 of a position or the padding is not zero.
    #[error("bits that must be zero are not")]
    Padding,
}

/// Bytes of a blob with so many vertices and triangles.
pub fn mesh_bytes(vertices: u32, triangles: u32) -> u64 {
    let unpadded = u64::from(vertices) * size_of::<Vertex>() as u64 + u64::from(triangles) * 6;
    unpadded.next_multiple_of(4)
}

/// Lays a mesh out as a blob.
///
/// # Panics
/// If there is no triangle, `indices` is not a list of triangles, an index names no vertex, or there
/// are more than [`MAX_BLOB_VERTICES`] vertices.
pub(super) fn encode(vertices: &[Vertex], indices: &[u16]) -> Vec<u8> {
    assert!(
        !indices.is_empty() && indices.len().is_multiple_of(3),
        "a mesh is a list of triangles"
    );
    assert!(vertices.len() <= MAX_BLOB_VERTICES, "{} vertices", vertices.len());
    assert!(indices.iter().all(|&i| usize::from(i) < vertices.len()), "an index names no vertex");
    let triangles = u32::try_from(indices.len() / 3).expect("fewer than 2^32 triangles");
    let total = mesh_bytes(vertices.len() as u32, triangles) as usize;
    let mut bytes = Vec::with_capacity(total);
    bytes.extend_from_slice(bytemuck::cast_slice(vertices));
    bytes.extend_from_slice(bytemuck::cast_slice(indices));
    bytes.resize(total, 0);
    bytes
}

/// The vertices of a blob whose bytes have been checked.
pub fn vertices_of<'a>(blob: &Blob, bytes: &'a [u8]) -> impl Iterator<Item = Vertex> + use<'a> {
    let size = size_of::<Vertex>();
    bytes[..blob.vertices as usize * size].chunks_exact(size).map(bytemuck::pod_read_unaligned)
}

/// Checks a blob's bytes before anybody draws them: length, checksum, indices, zero bits.
///
/// What passes cannot make a rasteriser read out of bounds.
pub fn check_blob(blob: &Blob, bytes: &[u8]) -> Result<(), BlobDamage> {
    let expected = mesh_bytes(blob.vertices, blob.triangles);
    if bytes.len() as u64 != expected || blob.bytes != expected {
        return Err(BlobDamage::Length { found: bytes.len() as u64, expected });
    }
    if crc32c::crc32c(bytes) != blob.crc {
        return Err(BlobDamage::Checksum);
    }
    let (_, rest) = bytes.split_at(blob.vertices as usize * size_of::<Vertex>());
    let (indices, padding) = rest.split_at(blob.triangles as usize * 6);
    let outside = |pair: &[u8]| u32::from(u16::from_le_bytes([pair[0], pair[1]])) >= blob.vertices;
    if let Some(index) = indices.chunks_exact(2).position(outside) {
        return Err(BlobDamage::Index { index: index as u32 });
    }
    let spare_bits = u64::MAX << (3 * POSITION_BITS);
    let spare_used = |v: Vertex| u64::from(v.position[1]) << 32 & spare_bits != 0;
    if padding.iter().any(|&b| b != 0) || vertices_of(blob, bytes).any(spare_used) {
        return Err(BlobDamage::Padding);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn triangle() -> (Blob, Vec<u8>) {
        let bytes = encode(&[Vertex::zeroed(); 3], &[0, 1, 2]);
        let crc = crc32c::crc32c(&bytes);
        let length = bytes.len() as u64;
        (Blob { vertices: 3, triangles: 1, bytes: length, crc, ..Blob::zeroed() }, bytes)
    }

    /// The blob after `bytes` were replaced by someone who also fixed the checksum.
    fn forged(change: impl FnOnce(&mut [u8])) -> Result<(), BlobDamage> {
        let (mut blob, mut bytes) = triangle();
        change(&mut bytes);
        blob.crc = crc32c::crc32c(&bytes);
        check_blob(&blob, &bytes)
    }

    #[test]
    fn a_blob_is_padded_to_four_bytes() {
        let (blob, bytes) = triangle();
        assert_eq!(bytes.len(), 3 * 16 + 6 + 2);
        assert_eq!(check_blob(&blob, &bytes), Ok(()));
        assert_eq!(vertices_of(&blob, &bytes).count(), 3);
    }

    #[test]
    fn short_and_changed_bytes_are_found() {
        let (blob, mut bytes) = triangle();
        assert!(matches!(check_blob(&blob, &[]), Err(BlobDamage::Length { found: 0, .. })));
        bytes[5] ^= 1;
        assert_eq!(check_blob(&blob, &bytes), Err(BlobDamage::Checksum));
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
        encode(&[Vertex::zeroed(); 2], &[0, 1, 2]);
    }
}
