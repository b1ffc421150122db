//! A mesh as uploaded: bytes checked once, so that drawing need not.

use crate::backend::BackendError;
use protocol::format::Vertex;
use protocol::id::BlobId;

/// Vertices and triangles of a blob.
pub(super) struct Mesh {
    /// At most [`protocol::format::vertex::MAX_BLOB_VERTICES`].
    pub(super) vertices: Box<[Vertex]>,
    /// Each below the number of vertices.
    pub(super) triangles: Box<[[u16; 3]]>,
}

impl Mesh {
    /// Reads a blob ([`protocol::format::vertex`]); its bytes may come from anywhere.
    pub(super) fn read(
        blob: BlobId,
        vertices: u32,
        triangles: u32,
        bytes: &[u8],
    ) -> Result<Self, BackendError> {
        let damaged = |what: &str| BackendError::Device(format!("mesh {blob} is damaged: {what}"));
        let vertex_bytes = vertices as usize * size_of::<Vertex>();
        let index_bytes = triangles as usize * size_of::<[u16; 3]>();
        let too_short = || damaged("it is shorter than its counts say");
        let (vertex_bytes, rest) = bytes.split_at_checked(vertex_bytes).ok_or_else(too_short)?;
        let index_bytes = rest.get(..index_bytes).ok_or_else(too_short)?;
        // `bytes` may lie at any address, so values are copied out one by one.
        let (vertex_chunks, _) = vertex_bytes.as_chunks::<{ size_of::<Vertex>() }>();
        let vertices: Box<[Vertex]> =
            vertex_chunks.iter().map(|chunk| bytemuck::pod_read_unaligned(chunk)).collect();
        let (index_chunks, _) = index_bytes.as_chunks::<{ size_of::<[u16; 3]>() }>();
        let triangles: Box<[[u16; 3]]> = index_chunks
            .iter()
            .map(|&[a, b, c, d, e, f]| [[a, b], [c, d], [e, f]].map(u16::from_le_bytes))
            .collect();
        if triangles.as_flattened().iter().any(|&index| usize::from(index) >= vertices.len()) {
            return Err(damaged("a triangle names a vertex it does not have"));
        }
        Ok(Self { vertices, triangles })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLOB: BlobId = BlobId(3);

    #[test]
    fn nothing_is_a_mesh() {
        let mesh = Mesh::read(BLOB, 0, 0, &[]).unwrap();
        assert!(mesh.vertices.is_empty() && mesh.triangles.is_empty());
    }

    #[test]
    fn lying_counts_and_indices_are_errors() {
        let mut bytes = vec![0u8; 3 * 16 + 6];
        bytes[48..].copy_from_slice(bytemuck::cast_slice(&[0u16, 1, 2]));
        assert_eq!(Mesh::read(BLOB, 3, 1, &bytes).unwrap().triangles[..], [[0, 1, 2]]);
        for (vertices, triangles) in [(4, 1), (3, 2), (u32::MAX, 1), (3, u32::MAX), (0, 1)] {
            let read = Mesh::read(BLOB, vertices, triangles, &bytes);
            assert!(read.is_err(), "{vertices} {triangles}");
        }
        bytes[52] = 3;
        assert!(Mesh::read(BLOB, 3, 1, &bytes).is_err());
    }
}
