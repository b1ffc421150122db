//! A mesh as uploaded: bytes checked once, so that drawing need not.

use super::patch::Patch;
use crate::backend::BackendError;
use protocol::format::{Blob, Class, TexturedVertex, Vertex, projected};
use protocol::id::BlobId;
use std::ops::Range;

/// What a vertex adds to a plain one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Texturing {
    pub(super) tex_coord: [f32; 2],
    pub(super) texture: u32,
    pub(super) cutoff: f32,
}

fn damaged(id: BlobId, what: &str) -> BackendError {
    BackendError::Device(format!("mesh {id} is damaged: {what}"))
}

/// Bytes that a blob will take.
///
/// Errors: `Device` where it is shorter.
pub(super) fn bytes_of(id: BlobId, blob: &Blob, bytes: &[u8]) -> Result<u64, BackendError> {
    let triangle_bytes = size_of::<[u16; 3]>() as u64;
    let drawn = blob.vertex_bytes() as u64 + u64::from(blob.triangles) * triangle_bytes;
    let (length, held) = match (blob.is_projected(), projected::is_side(blob.image[0])) {
        (false, _) => (drawn, drawn),
        (true, true) => {
            let picture = projected::image_bytes(blob.vertex_layout(), blob.image);
            (drawn.next_multiple_of(4) + picture, drawn + picture)
        }
        (true, false) => return Err(damaged(id, "no picture has such a side")),
    };
    let too_short = || damaged(id, "it is shorter than its counts say");
    (length <= bytes.len() as u64).then_some(held).ok_or_else(too_short)
}

/// Vertices and triangles of a blob.
pub(super) struct Mesh {
    /// At most [`protocol::format::vertex::MAX_BLOB_VERTICES`]; none of a projected one.
    pub(super) vertices: Box<[Vertex]>,
    /// As many as vertices; none of a plain mesh.
    pub(super) texturing: Box<[Texturing]>,
    /// Of a projected one.
    pub(super) patch: Option<Patch>,
    /// Each below the number of vertices.
    pub(super) triangles: Box<[[u16; 3]]>,
    /// Where the triangles of each class lie.
    classes: [Range<usize>; Class::COUNT],
}

impl Mesh {
    /// Reads a blob ([`protocol::format::vertex`], [`projected`]); its bytes may come from anywhere.
    pub(super) fn read(id: BlobId, blob: &Blob, bytes: &[u8]) -> Result<Self, BackendError> {
        bytes_of(id, blob, bytes)?;
        let (vertex_bytes, rest) = bytes.split_at(blob.vertex_bytes());
        let index_bytes = &rest[..blob.triangles as usize * size_of::<[u16; 3]>()];
        let count = blob.vertices as usize;
        let mut patch = None;
        // `bytes` may lie at any address, so values are copied out one by one.
        let (mut vertices, mut texturing) = (Vec::new(), Vec::new());
        if blob.is_textured() {
            vertices.reserve_exact(count);
            texturing.reserve_exact(count);
            let (chunks, _) = vertex_bytes.as_chunks::<{ size_of::<TexturedVertex>() }>();
            for chunk in chunks {
                let vertex: TexturedVertex = bytemuck::pod_read_unaligned(chunk);
                let TexturedVertex { plain, tex_coord, texture, cutoff } = vertex;
                vertices.push(plain);
                texturing.push(Texturing { tex_coord, texture, cutoff });
            }
        } else if blob.is_projected() {
            if blob.classes != Class::OpaqueDouble.all(blob.triangles) {
                return Err(damaged(id, "a patch of a scan cube is opaque from both sides"));
            }
            let read = Patch::read(&projected::Patch::of(blob, bytes));
            patch = Some(read.ok_or_else(|| damaged(id, "its picture names a tile it lacks"))?);
        } else {
            let (chunks, _) = vertex_bytes.as_chunks::<{ size_of::<Vertex>() }>();
            vertices.extend(chunks.iter().map(|c| bytemuck::pod_read_unaligned::<Vertex>(c)));
        }
        let (index_chunks, _) = index_bytes.as_chunks::<{ size_of::<[u16; 3]>() }>();
        let triangles: Box<[[u16; 3]]> = index_chunks
            .iter()
            .map(|&[a, b, c, d, e, f]| [[a, b], [c, d], [e, f]].map(u16::from_le_bytes))
            .collect();
        if triangles.as_flattened().iter().any(|&index| usize::from(index) >= count) {
            return Err(damaged(id, "a triangle names a vertex it does not have"));
        }
        let sum: u64 = blob.classes.iter().map(|&count| u64::from(count)).sum();
        if sum != u64::from(blob.triangles) {
            return Err(damaged(id, "its classes do not add up to its triangles"));
        }
        let classes = Class::ALL.map(|class| {
            let range = blob.triangles_of(class);
            range.start as usize..range.end as usize
        });
        Ok(Self {
            vertices: vertices.into(),
            texturing: texturing.into(),
            patch,
            triangles,
            classes,
        })
    }

    /// Bytes of its arrays.
    pub(super) fn held_bytes(&self) -> u64 {
        let Self { vertices, texturing, patch, triangles, classes: _ } = self;
        let bytes = size_of_val(&**vertices) + size_of_val(&**texturing);
        (bytes + patch.as_ref().map_or(0, Patch::held_bytes) + size_of_val(&**triangles)) as u64
    }

    /// How many vertices it has.
    pub(super) fn count(&self) -> usize {
        self.patch.as_ref().map_or(self.vertices.len(), |patch| patch.positions.len())
    }

    /// The grid position of a vertex.
    pub(super) fn grid(&self, vertex: usize) -> [f64; 3] {
        let vertex = match &self.patch {
            None => self.vertices[vertex],
            Some(patch) => Vertex { position: patch.positions[vertex], normal: 0, color: 0 },
        };
        vertex.grid().map(f64::from)
    }

    /// Its triangles of one class.
    pub(super) fn triangles_of(&self, class: Class) -> Range<usize> {
        self.classes[class as usize].clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ID: BlobId = BlobId(3);

    fn blob(vertices: u32, triangles: u32) -> Blob {
        let classes = Class::OpaqueDouble.all(triangles);
        Blob { vertices, triangles, classes, ..Blob::default() }
    }

    #[test]
    fn nothing_is_a_mesh() {
        let mesh = Mesh::read(ID, &blob(0, 0), &[]).unwrap();
        assert!(mesh.vertices.is_empty() && mesh.triangles.is_empty());
    }

    #[test]
    fn lying_counts_and_indices_are_errors() {
        let mut bytes = vec![0u8; 3 * 16 + 6];
        bytes[48..].copy_from_slice(bytemuck::cast_slice(&[0u16, 1, 2]));
        assert_eq!(Mesh::read(ID, &blob(3, 1), &bytes).unwrap().triangles[..], [[0, 1, 2]]);
        for (vertices, triangles) in [(4, 1), (3, 2), (u32::MAX, 1), (3, u32::MAX), (0, 1)] {
            let read = Mesh::read(ID, &blob(vertices, triangles), &bytes);
            assert!(read.is_err(), "{vertices} {triangles}");
        }
        let textured = Blob { layout: 1, ..blob(3, 1) };
        assert!(Mesh::read(ID, &textured, &bytes).is_err());
        let classes = [u32::MAX; 6];
        assert!(Mesh::read(ID, &Blob { classes, ..blob(3, 1) }, &bytes).is_err());
        bytes[52] = 3;
        assert!(Mesh::read(ID, &blob(3, 1), &bytes).is_err());
    }

    #[test]
    fn triangles_are_found_by_class() {
        let mut bytes = vec![0u8; 3 * 32];
        bytes[16..20].copy_from_slice(&2.5f32.to_le_bytes());
        bytes[24..28].copy_from_slice(&7u32.to_le_bytes());
        bytes.extend_from_slice(bytemuck::cast_slice(&[0u16; 9]));
        let made = Blob { layout: 1, classes: [1, 0, 0, 1, 1, 0], ..blob(3, 3) };
        let mesh = Mesh::read(ID, &made, &bytes).unwrap();
        assert_eq!(mesh.triangles_of(Class::MaskDouble), 1..2);
        assert!(mesh.triangles_of(Class::BlendDouble).is_empty());
        assert_eq!(mesh.held_bytes(), bytes_of(ID, &made, &bytes).unwrap());
        assert_eq!((mesh.texturing[0].tex_coord, mesh.texturing[0].texture), ([2.5, 0.0], 7));
    }
}
