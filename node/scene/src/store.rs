//! A scene file at run time: the skeleton decoded, the rest read piece by piece.
//!
//! Opening reads header and skeleton. A blob or a texture is copied out and checked every time it is
//! asked for: the file may change between two times.

mod error;
mod guard;

use guard::Guarded;
use protocol::format::mesh::check_blob;
use protocol::format::{ALIGNMENT, Digest, SceneFile, Skeleton, digest, read_skeleton_of};
use protocol::id::BlobId;
use protocol::message::FailureKind;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use error::{Content, StoreError};
pub use protocol::format::ReadError as OpenError;

/// An opened scene file. Threads may share it and read from it at once.
///
/// A file that is replaced by a rename, as the writer does it, stays what it was when it was opened.
/// One that is changed in place yields errors from then on, for what has changed; never a signal.
#[derive(Debug)]
pub struct Store {
    path: PathBuf,
    file: Guarded,
    skeleton: Arc<Skeleton>,
    geometry: Range<u64>,
    pixels: Range<u64>,
    digest: Digest,
}

impl Store {
    /// Opens a scene file and reads its skeleton.
    pub fn open(path: &Path) -> Result<Self, OpenError> {
        let to_io = |e| OpenError::io(path, e);
        let file: File = protocol::file::open(path).map_err(to_io)?;
        let scene = read_skeleton_of(&file, path)?;
        let SceneFile { skeleton, geometry, pixels, digest, file_bytes } = scene;
        let file = Guarded::new(file, file_bytes).map_err(to_io)?;
        let (path, skeleton) = (path.to_path_buf(), Arc::new(skeleton));
        Ok(Self { path, file, skeleton, geometry, pixels, digest })
    }

    /// The skeleton.
    pub fn skeleton(&self) -> &Arc<Skeleton> {
        &self.skeleton
    }

    /// The digest the file claims; [`crate::verify::verify`] holds it against the bytes.
    pub fn digest(&self) -> Digest {
        self.digest
    }

    /// The file, as it was named.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes of the file when it was opened.
    pub fn bytes(&self) -> u64 {
        self.file.bytes()
    }

    /// Reads a blob: vertices, then indices ([`protocol::format::vertex`]). No index of what comes
    /// out is without a vertex, no vertex names a texture that does not exist.
    ///
    /// # Errors
    /// See [`StoreError`]; `out` then holds anything.
    ///
    /// # Panics
    /// If `out` is not as long as the blob.
    pub fn read_blob(&self, id: BlobId, out: &mut [u8]) -> Result<(), StoreError> {
        let path = || self.path.clone();
        let Some(blob) = self.skeleton.blobs.get(id.index()) else {
            return Err(StoreError::Unknown { path: path(), blob: id });
        };
        self.read(Content::Blob(id), out)?;
        check_blob(blob, out, self.skeleton.textures_of(id)).map_err(|source| {
            let damaged = StoreError::Damaged { path: path(), blob: id, source };
            self.gone(Content::Blob(id)).unwrap_or(damaged)
        })
    }

    /// [`Store::read_blob`] into a buffer of its own.
    pub fn load_blob(&self, id: BlobId) -> Result<Vec<u8>, StoreError> {
        let blob = self.skeleton.blobs.get(id.index());
        let mut bytes = vec![0; blob.map_or(0, |blob| blob.bytes as usize)];
        self.read_blob(id, &mut bytes)?;
        Ok(bytes)
    }

    /// Reads a texture's mips ([`protocol::format::texture`]).
    ///
    /// # Errors
    /// See [`StoreError`]; `out` then holds anything.
    ///
    /// # Panics
    /// If the scene has no such texture, or `out` is not as long as it.
    pub fn read_texture(&self, index: u32, out: &mut [u8]) -> Result<(), StoreError> {
        let content = Content::Texture(index);
        self.read(content, out)?;
        if self.skeleton.textures[index as usize].is_made_of(out) {
            return Ok(());
        }
        let damaged = StoreError::DamagedTexture { path: self.path.clone(), texture: index };
        Err(self.gone(content).unwrap_or(damaged))
    }

    /// [`Store::read_texture`] into a buffer of its own.
    pub fn load_texture(&self, index: u32) -> Result<Vec<u8>, StoreError> {
        let mut bytes = vec![0; self.skeleton.textures[index as usize].bytes as usize];
        self.read_texture(index, &mut bytes)?;
        Ok(bytes)
    }

    /// What lies between a blob or a texture and what comes next; unchecked.
    pub(crate) fn padding_behind(&self, content: Content) -> Result<Vec<u8>, StoreError> {
        let start = self.range(content).end;
        let mut bytes = vec![0; (start.next_multiple_of(ALIGNMENT) - start) as usize];
        self.file.copy(start, &mut bytes).map_err(|e| self.unread(content, e))?;
        Ok(bytes)
    }

    /// The digest of the bytes as they are: reads the whole file.
    pub(crate) fn real_digest(&self) -> Result<Digest, StoreError> {
        digest(self.file.reader()).map_err(|e| self.unread(Content::Whole, e))
    }

    /// Fills `out` with all of `content`; unchecked.
    fn read(&self, content: Content, out: &mut [u8]) -> Result<(), StoreError> {
        let range = self.range(content);
        assert_eq!(out.len() as u64, range.end - range.start, "room for {content}");
        self.file.copy(range.start, out).map_err(|e| self.unread(content, e))
    }

    /// Where it lies, bytes from the start of the file.
    fn range(&self, content: Content) -> Range<u64> {
        let (start, bytes) = match content {
            Content::Blob(id) => {
                let blob = self.skeleton.blob(id);
                (self.geometry.start + blob.offset, blob.bytes)
            }
            Content::Texture(index) => {
                let texture = &self.skeleton.textures[index as usize];
                (self.pixels.start + texture.offset, texture.bytes)
            }
            Content::Whole => (0, self.bytes()),
        };
        start..start + bytes
    }

    /// The better reason for bytes that are wrong: the file ends among them, and what is read of the
    /// rest of a page is zeros.
    fn gone(&self, content: Content) -> Option<StoreError> {
        let gone = self.file.ends_before(self.range(content).end);
        gone.then(|| StoreError::Gone { path: self.path.clone(), content })
    }

    fn unread(&self, content: Content, error: io::Error) -> StoreError {
        let path = self.path.clone();
        match error.kind() {
            io::ErrorKind::UnexpectedEof => StoreError::Gone { path, content },
            _ => StoreError::Io { path, content, reason: error.to_string() },
        }
    }
}

/// The class of a failed opening, which decides the exit code.
pub fn failure_kind(error: &OpenError) -> FailureKind {
    match error {
        OpenError::Missing { .. } => FailureKind::NoInput,
        OpenError::Io { .. } => FailureKind::Io,
        OpenError::Bad { .. } => FailureKind::BadData,
    }
}

#[cfg(test)]
mod tests;
