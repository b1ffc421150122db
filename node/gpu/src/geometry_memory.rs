//! Meshes in device memory: a few large buffers, each holding many blobs.
//!
//! A blob stays as it came, vertices, then indices, then the picture if it is projected, in one range of one
//! buffer that is bound as vertex and as index buffer, and for pictures as words that fragments read. Ranges
//! are multiples of the longest vertex, so that all parts have whole offsets.
//!
//! A buffer that holds no blob any more is kept for those to come, and released where another needs its
//! room: work that was submitted may still use it, so releasing means to wait.

use crate::device::Device;
use crate::pipelines::entry;
use crate::ranges::Ranges;
use crate::staging::Staging;
use protocol::format::mesh::blob_bytes;
use protocol::format::vertex::Layout;
use protocol::format::{Blob, Class, projected};
use protocol::id::BlobId;
use scene::backend::{BackendError, Upload};
use std::collections::BTreeMap;
use std::ops::Range;

/// Bytes of the first buffer; each further one is as large as all before it together.
const FIRST_CHUNK_BYTES: u64 = 4 << 20;
/// Largest buffer, unless one blob needs more: the first pass that uses it waits until the system has given
/// and cleared all of it, so it is no larger than what a drawing may take in besides what it lacks.
const LARGEST_CHUNK_BYTES: u64 = 16 << 20;
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
    /// What its vertices are.
    pub(crate) layout: Layout,
    /// Of a projected one; all 0 in others.
    pub(crate) picture: Picture,
}

/// Where the picture of a projected blob lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Picture {
    /// Its first word in the buffer.
    pub(crate) start: u32,
    /// Pixels along a side.
    pub(crate) side: u32,
    /// First word of its normals, 0 where it has none.
    pub(crate) normals: u32,
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
    /// The whole of it as words, once it has held a projected blob.
    words: Option<wgpu::BindGroup>,
}

#[derive(Clone, Copy)]
struct Resident {
    place: Place,
    offset: u64,
    length: u64,
}

/// All resident blobs.
pub(crate) struct GeometryMemory {
    words_layout: wgpu::BindGroupLayout,
    /// A slot is empty after its buffer was released.
    chunks: Vec<Option<Chunk>>,
    blobs: BTreeMap<BlobId, Resident>,
}

impl GeometryMemory {
    /// No blob yet.
    pub(crate) fn new(device: &Device) -> Self {
        let words = entry(
            0,
            wgpu::ShaderStages::FRAGMENT,
            wgpu::BufferBindingType::Storage { read_only: true },
        );
        let descriptor =
            wgpu::BindGroupLayoutDescriptor { label: Some("words"), entries: &[words] };
        let words_layout = device.device.create_bind_group_layout(&descriptor);
        Self { words_layout, chunks: Vec::new(), blobs: BTreeMap::new() }
    }

    /// Layout of group 1 of pipelines that read pictures.
    pub(crate) fn words_layout(&self) -> &wgpu::BindGroupLayout {
        &self.words_layout
    }

    /// Group 1 of pipelines that read the pictures in a buffer of [`Place::chunk`].
    pub(crate) fn words(&self, chunk: usize) -> &wgpu::BindGroup {
        let chunk = self.chunks[chunk].as_ref().expect("a resident blob has a buffer");
        chunk.words.as_ref().expect("a buffer with a projected blob is bound as words")
    }

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
        let Blob { vertices, triangles, classes, image: [side, tiles], .. } = *blob;
        let layout = blob.vertex_layout();
        let vertex_bytes = layout.vertex_bytes() as u64;
        let index_start = u64::from(vertices) * vertex_bytes;
        let picture_start = (index_start + u64::from(triangles) * 6).next_multiple_of(4);
        let is_sound = match layout {
            Layout::Plain | Layout::Textured => true,
            Layout::Projected | Layout::ProjectedNormals => {
                projected::is_side(side) && classes == Class::OpaqueDouble.all(triangles)
            }
        };
        let needed = blob_bytes(blob);
        let sum: u64 = classes.iter().map(|&count| u64::from(count)).sum();
        if bytes.len() as u64 != needed
            || triangles > u32::MAX / 3
            || Layout::of(blob.layout).is_none()
            || sum != u64::from(triangles)
            || !is_sound
        {
            return Err(device.unsupported(format!(
                "blob {id}: {} bytes for {vertices} vertices and {triangles} triangles of classes \
                 {classes:?} and a picture of side {side} with {tiles} tiles",
                bytes.len()
            )));
        }
        if bytes.is_empty() {
            self.evict(id);
            let picture = Picture::default();
            let place =
                Place { chunk: 0, base_vertex: 0, first_index: 0, classes, layout, picture };
            self.blobs.insert(id, Resident { place, offset: 0, length: 0 });
            return Ok(Upload::Done);
        }
        let length = needed.next_multiple_of(GRAIN);
        let Some((chunk, offset)) = self.take(device, length, room, layout)? else {
            return Ok(Upload::Full);
        };
        self.evict(id);
        if layout.is_projected() {
            self.bind_words(device, chunk);
        }
        staging.write(device, self.buffer(chunk), offset, bytes)?;
        let word = |at: u64| ((offset + at) / 4) as u32;
        // The last of what it holds.
        let normals = || needed - u64::from(tiles) * projected::TILE_BYTES as u64;
        let picture = match layout.is_projected() {
            true => Picture {
                start: word(picture_start),
                side,
                normals: if blob.has_normals() { word(normals()) } else { 0 },
            },
            false => Picture::default(),
        };
        // Buffers hold 4 GiB at most, so all numbers fit.
        let place = Place {
            chunk,
            base_vertex: (offset / vertex_bytes) as i32,
            first_index: ((offset + index_start) / 2) as u32,
            classes,
            layout,
            picture,
        };
        self.blobs.insert(id, Resident { place, offset, length });
        Ok(Upload::Done)
    }

    fn bind_words(&mut self, device: &Device, chunk: usize) {
        let Chunk { buffer, words, .. } =
            self.chunks[chunk].as_mut().expect("a blob was given a place in it");
        words.get_or_insert_with(|| {
            device.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("words"),
                layout: &self.words_layout,
                entries: &[wgpu::BindGroupEntry {
                    binding: 0,
                    resource: buffer.as_entire_binding(),
                }],
            })
        });
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
    /// A projected blob's buffer is small enough to be bound as words.
    fn take(
        &mut self,
        device: &Device,
        length: u64,
        room: u64,
        layout: Layout,
    ) -> Result<Option<(usize, u64)>, BackendError> {
        let bound = match layout {
            Layout::Plain | Layout::Textured => u64::MAX,
            Layout::Projected | Layout::ProjectedNormals => {
                device.limits.max_storage_buffer_binding_size
            }
        };
        // 16-bit index offsets are counted in 32 bits.
        let limit = device.limits.max_buffer_size.min(1 << 32).min(bound) / GRAIN * GRAIN;
        for (i, chunk) in self.chunks.iter_mut().enumerate() {
            let chunk = chunk.as_mut().filter(|chunk| chunk.buffer.size() <= limit);
            if let Some(offset) = chunk.and_then(|chunk| chunk.ranges.take(length)) {
                return Ok(Some((i, offset)));
            }
        }
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
        let buffer = geometry_buffer(device, size);
        let chunk = Chunk { buffer, ranges: Ranges::new(size), words: None };
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
            | wgpu::BufferUsages::STORAGE
            | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
