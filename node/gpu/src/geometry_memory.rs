//! Meshes in device memory: a few large buffers, each holding many blobs.
//!
//! A blob stays as it came, vertices and then indices, in one range of one buffer that is bound as
//! vertex and as index buffer. Ranges are multiples of a vertex, so that both parts have whole offsets.

use crate::device::Device;
use crate::ranges::Ranges;
use protocol::id::BlobId;
use scene::backend::BackendError;
use shaders::mirror::Vertex;
use std::collections::BTreeMap;

/// Bytes of the first buffer; each further one is as large as all before it together.
const FIRST_CHUNK_BYTES: u64 = 4 << 20;
/// Largest buffer, unless one blob needs more.
const LARGEST_CHUNK_BYTES: u64 = 64 << 20;
/// Uploads between two submissions, which free the staging memory behind them.
const STAGING_BYTES: u64 = 32 << 20;
const VERTEX_BYTES: u64 = size_of::<Vertex>() as u64;

/// Where a blob lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Place {
    /// Index for [`GeometryMemory::buffer`].
    pub(crate) chunk: usize,
    /// First vertex in the buffer.
    pub(crate) base_vertex: i32,
    /// First 16-bit index in the buffer.
    pub(crate) first_index: u32,
    /// Number of indices.
    pub(crate) indices: u32,
}

struct Chunk {
    buffer: wgpu::Buffer,
    ranges: Ranges,
}

#[derive(Clone, Copy)]
struct Resident {
    place: Place,
    offset: u64,
    length: u64,
}

/// All resident blobs.
#[derive(Default)]
pub(crate) struct GeometryMemory {
    /// A slot is empty after its last blob was evicted.
    chunks: Vec<Option<Chunk>>,
    blobs: BTreeMap<BlobId, Resident>,
    staged: u64,
}

impl GeometryMemory {
    /// Copies a blob to the device, in place of an earlier one of that id.
    ///
    /// Errors: `Unsupported` where the bytes are not such a blob or exceed the largest buffer.
    pub(crate) fn upload(
        &mut self,
        device: &Device,
        blob: BlobId,
        vertices: u32,
        triangles: u32,
        bytes: &[u8],
    ) -> Result<(), BackendError> {
        let index_start = u64::from(vertices) * VERTEX_BYTES;
        let needed = (index_start + u64::from(triangles) * 6).next_multiple_of(4);
        if bytes.len() as u64 != needed || triangles > u32::MAX / 3 {
            return Err(device.unsupported(format!(
                "blob {blob}: {} bytes for {vertices} vertices and {triangles} triangles",
                bytes.len()
            )));
        }
        self.evict(blob);
        if bytes.is_empty() {
            let place = Place { chunk: 0, base_vertex: 0, first_index: 0, indices: 0 };
            self.blobs.insert(blob, Resident { place, offset: 0, length: 0 });
            return Ok(());
        }
        let length = needed.next_multiple_of(VERTEX_BYTES);
        let (chunk, offset) = self.take(device, length)?;
        device.queue.write_buffer(self.buffer(chunk), offset, bytes);
        self.staged += needed;
        if self.staged >= STAGING_BYTES {
            device.queue.submit([]);
            self.staged = 0;
        }
        // Buffers hold 4 GiB at most, so both numbers fit.
        let place = Place {
            chunk,
            base_vertex: (offset / VERTEX_BYTES) as i32,
            first_index: ((offset + index_start) / 2) as u32,
            indices: triangles * 3,
        };
        self.blobs.insert(blob, Resident { place, offset, length });
        Ok(())
    }

    /// Frees a blob's range; nothing happens if it is not there. A buffer that holds no blob any more
    /// is released, once the work that uses it is done.
    pub(crate) fn evict(&mut self, blob: BlobId) {
        let Some(Resident { place, offset, length }) = self.blobs.remove(&blob) else { return };
        if length == 0 {
            return;
        }
        let slot = &mut self.chunks[place.chunk];
        let chunk = slot.as_mut().expect("a resident blob has a buffer");
        chunk.ranges.give_back(offset, length);
        if chunk.ranges.is_unused() {
            *slot = None;
        }
    }

    /// Where a blob lies, if it is resident.
    pub(crate) fn place(&self, blob: BlobId) -> Option<Place> {
        self.blobs.get(&blob).map(|resident| resident.place)
    }

    /// The buffer of [`Place::chunk`].
    pub(crate) fn buffer(&self, chunk: usize) -> &wgpu::Buffer {
        &self.chunks[chunk].as_ref().expect("a resident blob has a buffer").buffer
    }

    fn take(&mut self, device: &Device, length: u64) -> Result<(usize, u64), BackendError> {
        for (i, chunk) in self.chunks.iter_mut().enumerate() {
            if let Some(offset) = chunk.as_mut().and_then(|chunk| chunk.ranges.take(length)) {
                return Ok((i, offset));
            }
        }
        // 16-bit index offsets are counted in 32 bits.
        let limit = device.limits.max_buffer_size.min(1 << 32) / VERTEX_BYTES * VERTEX_BYTES;
        if length > limit {
            return Err(
                device.unsupported(format!("a mesh of {length} bytes; a buffer holds {limit}"))
            );
        }
        let held: u64 = self.chunks.iter().flatten().map(|chunk| chunk.buffer.size()).sum();
        let size = held.clamp(FIRST_CHUNK_BYTES, LARGEST_CHUNK_BYTES).min(limit).max(length);
        let buffer = device.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("geometry"),
            size,
            usage: wgpu::BufferUsages::VERTEX
                | wgpu::BufferUsages::INDEX
                | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut ranges = Ranges::new(size);
        let offset = ranges.take(length).expect("a new buffer holds the blob it was made for");
        let chunk = Some(Chunk { buffer, ranges });
        match self.chunks.iter().position(Option::is_none) {
            Some(slot) => {
                self.chunks[slot] = chunk;
                Ok((slot, offset))
            }
            None => {
                self.chunks.push(chunk);
                Ok((self.chunks.len() - 1, offset))
            }
        }
    }
}
