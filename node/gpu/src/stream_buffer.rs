//! A vertex buffer that is written anew for every pass and grows when it must.

use crate::device::Device;

/// Smallest buffer in bytes.
const LEAST_BYTES: u64 = 4096;

/// Instance data of one pass at a time.
#[derive(Default)]
pub(crate) struct StreamBuffer(Option<wgpu::Buffer>);

impl StreamBuffer {
    /// Holds `bytes` from now on. Passes submitted earlier still see what they were given: the queue
    /// keeps writes and submissions in order.
    ///
    /// `bytes` must not be empty, and a multiple of 4 long.
    pub(crate) fn write(&mut self, device: &Device, bytes: &[u8]) -> &wgpu::Buffer {
        let needed = bytes.len() as u64;
        debug_assert!(needed > 0 && needed.is_multiple_of(4));
        let buffer = match self.0.take().filter(|buffer| buffer.size() >= needed) {
            Some(buffer) => buffer,
            None => device.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("instances"),
                size: needed.next_power_of_two().max(LEAST_BYTES),
                usage: wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
        };
        device.queue.write_buffer(&buffer, 0, bytes);
        self.0.insert(buffer)
    }
}
