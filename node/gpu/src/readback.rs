//! Buffers on their way back from the device.

use crate::device::Device;
use crate::targets::{Target, extent};
use protocol::settings::PictureSize;
use scene::backend::BackendError;
use std::sync::{Arc, OnceLock};

/// Set by the device once something is done: whether it went well.
#[derive(Debug, Clone, Default)]
pub(crate) struct Signal(Arc<OnceLock<bool>>);

impl Signal {
    /// Tells the other holders; later calls change nothing.
    pub(crate) fn set(&self, well: bool) {
        self.0.get_or_init(|| well);
    }

    /// What was told, if anything yet.
    pub(crate) fn get(&self) -> Option<bool> {
        self.0.get().copied()
    }
}

/// A buffer the host can read once [`Readback::signal`] is set.
pub(crate) struct Readback {
    buffer: wgpu::Buffer,
    signal: Signal,
}

/// Bytes of a texture's row in a buffer: copies want multiples of 256. All formats here have 4 bytes a
/// pixel.
fn row_bytes(size: PictureSize) -> u32 {
    (size.width * 4).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
}

impl Readback {
    /// A buffer of `bytes` bytes.
    pub(crate) fn new(device: &Device, bytes: u64) -> Self {
        let buffer = device.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size: bytes,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        Self { buffer, signal: Signal::default() }
    }

    /// A buffer for a whole target, and the copy into it.
    pub(crate) fn of_target(
        device: &Device,
        encoder: &mut wgpu::CommandEncoder,
        target: &Target,
        size: PictureSize,
    ) -> Self {
        let bytes_per_row = row_bytes(size);
        let readback = Self::new(device, u64::from(bytes_per_row) * u64::from(size.height));
        encoder.copy_texture_to_buffer(
            target.texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &readback.buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(bytes_per_row),
                    rows_per_image: None,
                },
            },
            extent(size),
        );
        readback
    }

    /// What the copy goes into.
    pub(crate) fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Set when the bytes are there. Valid after [`Readback::start`].
    pub(crate) fn signal(&self) -> &Signal {
        &self.signal
    }

    /// Asks for the bytes, after the copy was submitted.
    pub(crate) fn start(&mut self) {
        self.signal = Signal::default();
        let signal = self.signal.clone();
        self.buffer.map_async(wgpu::MapMode::Read, .., move |result| signal.set(result.is_ok()));
    }

    /// The first `bytes` bytes, after the signal; the buffer is ready for another copy then.
    pub(crate) fn read<T>(
        &self,
        bytes: u64,
        take: impl FnOnce(&[u8]) -> T,
    ) -> Result<T, BackendError> {
        let view = self
            .buffer
            .get_mapped_range(..bytes)
            .map_err(|e| BackendError::Device(e.to_string()))?;
        let taken = take(&view);
        drop(view);
        self.buffer.unmap();
        Ok(taken)
    }

    /// The pixels of a target, row padding removed.
    pub(crate) fn read_target(&self, size: PictureSize) -> Result<Vec<u8>, BackendError> {
        let (padded, row) = (row_bytes(size) as usize, size.width as usize * 4);
        self.read(self.buffer.size(), |bytes| {
            bytes.chunks_exact(padded).flat_map(|line| &line[..row]).copied().collect()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_padded_to_256_bytes() {
        let row = |width| row_bytes(PictureSize { width, height: 1 });
        assert_eq!([1, 63, 64, 65, 512].map(row), [256, 256, 256, 512, 2048]);
    }

    #[test]
    fn a_signal_keeps_its_first_value() {
        let signal = Signal::default();
        assert_eq!(signal.get(), None);
        signal.clone().set(false);
        signal.set(true);
        assert_eq!(signal.get(), Some(false));
    }
}
