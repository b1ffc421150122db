//! Meshes in device memory: a few large buffers, each holding many blobs.
//!
//! A blob stays as it came, vertices and then indices, in one range of one buffer that is bound as
//! vertex and as index buffer. Ranges are multiples of the longest vertex, so that both parts have whole offsets.
//!
//! A buffer that holds no blob any more is kept for those to come, and released where another needs its
//! room: work that was submitted may still use it, so releasing means to wait.

use crate::device::Device;
use crate::ranges::Ranges;
use crate::staging::Staging;
use protocol::format::vertex::Layout;
use protocol::format::{Blob, Class};
use protocol::id::BlobId;
use scene::backend::{BackendError, Upload};
use std::collections::BTreeMap;
use std::ops::Range;

/// Bytes of the first buffer; each further one is as large as all before it together.
const FIRST_CHUNK_BYTES: u64 = 4 << 20;
/// Largest buffer, unless one blob needs more.
const LARGEST_CHUNK_BYTES: u64 = 64 << 20;
/// All there may be is divided into at least so many buffers, unless one blob needs more.
const LEAST_CHUNKS: u64 = 8;
/// Bytes of a textured vertex, and of two plain ones.
const GRAIN: u64 = 32;
const _: () = assert!(size_of::<protocol::format::TexturedVertex>() as u64 == GRAIN);

/// Where a blob lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Place {
    /// Index for [`GeometryMemory::buffer`].
    pub(crate) chunk: usize,
    /// First vertex in the buffer.
    pub(crate) base_vertex: i32,
    /// First 16-bit index in the buffer.
    pub(crate) first_index: u32,
    /// Triangles by class, in which order they lie.
    pub(crate) classes: [u32; Class::COUNT],
    /// Its vertices are textured.
    pub(crate) textured: bool,
}

impl Place {
    /// The indices of a class in the buffer.
    pub(crate) fn indices_of(&self, class: Class) -> Range<u32> {
        let triangles = |classes: &[u32]| classes.iter().sum::<u32>();
        let start = self.first_index + 3 * triangles(&self.classes[..class as usize]);
        start..start + 3 * self.classes[class as usize]
    }
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
    /// A slot is empty after its buffer was released.
    chunks: Vec<Option<Chunk>>,
    blobs: BTreeMap<BlobId, Resident>,
}

impl GeometryMemory {
    /// Copies a blob to the device, in place of an earlier one of that id. `Full`, and nothing changed,
    /// where all buffers together would exceed `room` bytes.
    ///
    /// Errors: `Unsupported` where the bytes are not such a blob or exceed the largest buffer, `Device`.
    pub(crate) fn upload(
        &mut self,
        device: &Device,
        staging: &mut Staging,
        room: u64,
        (id, blob, bytes): (BlobId, &Blob, &[u8]),
    ) -> Result<Upload, BackendError> {
        let Blob { vertices, triangles, classes, .. } = *blob;
        let vertex_bytes = blob.vertex_layout().vertex_bytes() as u64;
        let index_start = u64::from(vertices) * vertex_bytes;
        let needed = (index_start + u64::from(triangles) * 6).next_multiple_of(4);
        let sum: u64 = classes.iter().map(|&count| u64::from(count)).sum();
        if bytes.len() as u64 != needed
            || triangles > u32::MAX / 3
            || Layout::of(blob.layout).is_none()
            || sum != u64::from(triangles)
        {
            return Err(device.unsupported(format!(
                "blob {id}: {} bytes for {vertices} vertices and {triangles} triangles of classes \
                 {classes:?}",
                bytes.len()
            )));
        }
        let textured = blob.is_textured();
        if bytes.is_empty() {
            self.evict(id);
            let place = Place { chunk: 0, base_vertex: 0, first_index: 0, classes, textured };
            self.blobs.insert(id, Resident { place, offset: 0, length: 0 });
            return Ok(Upload::Done);
        }
        let length = needed.next_multiple_of(GRAIN);
        let Some((chunk, offset)) = self.take(device, length, room)? else {
            return Ok(Upload::Full);
        };
        self.evict(id);
        staging.write(device, self.buffer(chunk), offset, bytes)?;
        // Buffers hold 4 GiB at most, so both numbers fit.
        let place = Place {
            chunk,
            base_vertex: (offset / vertex_bytes) as i32,
            first_index: ((offset + index_start) / 2) as u32,
            classes,
            textured,
        };
        self.blobs.insert(id, Resident { place, offset, length });
        Ok(Upload::Done)
    }

    /// Frees a blob's range; nothing happens if it is not there. What is written there from now on comes
    /// after the work that was submitted.
    pub(crate) fn evict(&mut self, blob: BlobId) {
        let Some(Resident { place, offset, length }) = self.blobs.remove(&blob) else { return };
        if length == 0 {
            return;
        }
        let chunk = self.chunks[place.chunk].as_mut().expect("a resident blob has a buffer");
        chunk.ranges.give_back(offset, length);
    }

    /// Where a blob lies, if it is resident.
    pub(crate) fn place(&self, blob: BlobId) -> Option<Place> {
        self.blobs.get(&blob).map(|resident| resident.place)
    }

    /// The buffer of [`Place::chunk`].
    pub(crate) fn buffer(&self, chunk: usize) -> &wgpu::Buffer {
        &self.chunks[chunk].as_ref().expect("a resident blob has a buffer").buffer
    }

    /// Bytes of all buffers.
    pub(crate) fn held_bytes(&self) -> u64 {
        self.chunks.iter().flatten().map(|chunk| chunk.buffer.size()).sum()
    }

    /// Bytes of those that hold a blob.
    pub(crate) fn used_bytes(&self) -> u64 {
        let used = self.chunks.iter().flatten().filter(|chunk| !chunk.ranges.is_unused());
        used.map(|chunk| chunk.buffer.size()).sum()
    }

    /// Releases the buffers that hold no blob, and waits for the work that uses them.
    pub(crate) fn release_unused(&mut self, device: &Device) -> Result<(), BackendError> {
        for slot in &mut self.chunks {
            slot.take_if(|chunk| chunk.ranges.is_unused());
        }
        // Writes that were not submitted use them, too.
        device.queue.submit([]);
        device.wait_for(None)
    }

    /// A free range and its buffer, a new one if need be. None, and nothing changed, where it does not fit.
    fn take(
        &mut self,
        device: &Device,
        length: u64,
        room: u64,
    ) -> Result<Option<(usize, u64)>, BackendError> {
        for (i, chunk) in self.chunks.iter_mut().enumerate() {
            if let Some(offset) = chunk.as_mut().and_then(|chunk| chunk.ranges.take(length)) {
                return Ok(Some((i, offset)));
            }
        }
        // 16-bit index offsets are counted in 32 bits.
        let limit = device.limits.max_buffer_size.min(1 << 32) / GRAIN * GRAIN;
        if length > limit {
            return Err(
                device.unsupported(format!("a mesh of {length} bytes; a buffer holds {limit}"))
            );
        }
        let left = |held| room.saturating_sub(held);
        if left(self.used_bytes()) < length {
            return Ok(None);
        }
        if left(self.held_bytes()) < length {
            self.release_unused(device)?;
        }
        let held = self.held_bytes();
        let wished = held.clamp(FIRST_CHUNK_BYTES, LARGEST_CHUNK_BYTES).min(room / LEAST_CHUNKS);
        let size = wished.max(length).min(left(held)).min(limit) / GRAIN * GRAIN;
        let chunk = Chunk { buffer: geometry_buffer(device, size), ranges: Ranges::new(size) };
        let slot = self.chunks.iter().position(Option::is_none).unwrap_or_else(|| {
            self.chunks.push(None);
            self.chunks.len() - 1
        });
        let offset = self.chunks[slot].insert(chunk).ranges.take(length);
        Ok(Some((slot, offset.expect("a new buffer holds the blob it was made for"))))
    }
}

fn geometry_buffer(device: &Device, size: u64) -> wgpu::Buffer {
    device.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("geometry"),
        size,
        usage: wgpu::BufferUsages::VERTEX
            | wgpu::BufferUsages::INDEX
            | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
