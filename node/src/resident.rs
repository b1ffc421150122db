//! Which geometry the backend holds: read from the store at first need.

use protocol::format::Texture;
use protocol::id::BlobId;
use protocol::telemetry::IoCounts;
use scene::backend::{Backend, BackendError, Draws, Upload};
use scene::store::{Store, StoreError};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use crate::role::RoleError;

/// Marks what the backend holds and counts what had to be read.
pub(crate) struct Residency {
    held: Vec<bool>,
    textures_held: bool,
    bytes: Arc<AtomicU64>,
    counts: IoCounts,
}

impl Residency {
    /// Nothing is held of a scene of `blobs` meshes; `bytes` follows what is.
    pub(crate) fn new(blobs: usize, bytes: Arc<AtomicU64>) -> Self {
        Self { held: vec![false; blobs], textures_held: false, bytes, counts: IoCounts::default() }
    }

    /// Uploads what `draws` need and the backend lacks. A mesh that several draws share counts once
    /// for each.
    pub(crate) fn ensure(
        &mut self,
        store: &Store,
        backend: &mut dyn Backend,
        draws: &Draws,
    ) -> Result<(), RoleError> {
        for draw in draws.solid.iter().chain(&draws.blending) {
            if self.held[draw.blob.index()] {
                self.counts.hits += 1;
            } else {
                self.load(store, backend, draw.blob)?;
            }
        }
        Ok(())
    }

    fn load(
        &mut self,
        store: &Store,
        backend: &mut dyn Backend,
        id: BlobId,
    ) -> Result<(), RoleError> {
        let began = Instant::now();
        let bytes = store.blob(id)?;
        let blob = store.skeleton().blob(id);
        if blob.is_textured() && !self.textures_held {
            self.load_textures(store, backend)?;
        }
        done(backend.upload(id, blob, bytes)?)?;
        self.held[id.index()] = true;
        self.bytes.fetch_add(blob.bytes, Ordering::Relaxed);
        self.counts.misses += 1;
        self.counts.bytes_read += blob.bytes;
        self.counts.stall_ns += began.elapsed().as_nanos() as u64;
        Ok(())
    }

    /// Uploads all textures: backends take them at once, before the first mesh that shows one.
    fn load_textures(&mut self, store: &Store, backend: &mut dyn Backend) -> Result<(), RoleError> {
        let records = &store.skeleton().textures;
        let with_bytes = |(index, record): (u32, &Texture)| Ok((*record, store.texture(index)?));
        let textures: Vec<_> =
            (0..).zip(records).map(with_bytes).collect::<Result<_, StoreError>>()?;
        done(backend.upload_textures(&textures)?)?;
        self.textures_held = true;
        let bytes: u64 = records.iter().map(|record| record.bytes).sum();
        self.bytes.fetch_add(bytes, Ordering::Relaxed);
        self.counts.bytes_read += bytes;
        Ok(())
    }

    /// What was counted since the last call.
    pub(crate) fn take_counts(&mut self) -> IoCounts {
        std::mem::take(&mut self.counts)
    }
}

/// Nothing is evicted to make room.
fn done(upload: Upload) -> Result<(), BackendError> {
    match upload {
        Upload::Done => Ok(()),
        Upload::Full => Err(BackendError::Device("the scene exceeds its budget".to_owned())),
    }
}
