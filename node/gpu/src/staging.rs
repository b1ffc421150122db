//! Bytes on their way to the device: how many may wait in host memory.

use crate::device::Device;
use scene::backend::BackendError;

/// Most bytes that wait.
const MOST_BYTES: u64 = 32 << 20;
/// A smaller budget than eight times this asks for submissions that cost more than they carry.
const LEAST_BYTES: u64 = 64 << 10;

/// Counts what was written since the last submission, which frees the memory behind writes once done.
///
/// At most an eighth of the budget waits, but 32 MiB in a large and 64 KiB in a small one. It comes on top
/// of the budget.
pub(crate) struct Staging {
    /// Written between two submissions, more or less. Two such batches wait, and each may be twice as
    /// large, its last piece having come when it was almost full.
    batch: u64,
    staged: u64,
    /// The batch before.
    submitted: Option<wgpu::SubmissionIndex>,
}

impl Staging {
    /// Nothing waits.
    pub(crate) fn new(budget: u64) -> Self {
        let bytes = (budget / 8).clamp(LEAST_BYTES, MOST_BYTES);
        // Whole pieces of a write begin at multiples of 4.
        Self { batch: (bytes / 4).next_multiple_of(4), staged: 0, submitted: None }
    }

    /// Writes to a buffer; the numbers are multiples of 4. Work submitted earlier still sees what was
    /// there: the queue keeps writes and submissions in order.
    pub(crate) fn write(
        &mut self,
        device: &Device,
        buffer: &wgpu::Buffer,
        offset: u64,
        bytes: &[u8],
    ) -> Result<(), BackendError> {
        let offsets = (offset..).step_by(self.batch as usize);
        for (piece, offset) in bytes.chunks(self.batch as usize).zip(offsets) {
            device.queue.write_buffer(buffer, offset, piece);
            self.wrote(device, piece.len() as u64)?;
        }
        Ok(())
    }

    /// Counts what was written otherwise.
    pub(crate) fn wrote(&mut self, device: &Device, bytes: u64) -> Result<(), BackendError> {
        self.staged += bytes;
        if self.staged < self.batch {
            return Ok(());
        }
        self.staged = 0;
        match self.submitted.replace(device.queue.submit([])) {
            Some(before) => device.wait_for(Some(before)),
            None => Ok(()),
        }
    }
}
