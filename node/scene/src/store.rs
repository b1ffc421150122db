//! A scene file in memory: the skeleton decoded, the geometry mapped.
//!
//! Opening touches the pages of header and skeleton. A blob's pages are touched, and its contents
//! checked, when it is first asked for.

use memmap2::Mmap;
use protocol::format::mesh::{BlobDamage, check_blob};
use protocol::format::{Digest, FormatError, SceneFile, Skeleton, parse};
use protocol::id::BlobId;
use protocol::message::FailureKind;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

pub use protocol::format::ReadError as OpenError;

/// Why a blob cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// Its bytes are wrong (exit code 65).
    #[error("{}: blob {blob} is damaged: {source}; copy or bake the file again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The blob.
        blob: BlobId,
        /// What is wrong.
        source: BlobDamage,
    },
    /// The bytes of a texture are wrong (exit code 65).
    #[error("{}: texture {texture} is damaged; copy or bake the file again", path.display())]
    DamagedTexture {
        /// The file.
        path: PathBuf,
        /// The texture, index into [`Skeleton::textures`].
        texture: u32,
    },
    /// No such blob (exit code 70: the skeleton was checked, so the asker made it up).
    #[error("{}: there is no blob {blob}", path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
        /// The blob.
        blob: BlobId,
    },
}

/// An opened scene file. Shared by threads; blobs may be asked for from all of them.
#[derive(Debug)]
pub struct Store {
    path: PathBuf,
    map: Mmap,
    skeleton: Arc<Skeleton>,
    geometry: Range<u64>,
    pixels: Range<u64>,
    digest: Digest,
    /// A bit a blob: its contents have been checked.
    checked: Vec<AtomicU64>,
}

impl Store {
    /// Maps and opens a scene file.
    ///
    /// The file must not be changed in place while it is open: truncating it kills the process
    /// (SIGBUS). Replace it by a rename, as the writer does; the map then keeps the old contents.
    pub fn open(path: &Path) -> Result<Self, OpenError> {
        let to_io = |e| OpenError::io(path, e);
        let file = File::open(path).map_err(to_io)?;
        // Mapping nothing is an error of its own on some systems.
        if file.metadata().map_err(to_io)?.len() == 0 {
            return Err(OpenError::bad(path, FormatError::Empty));
        }
        let map = map(&file).map_err(to_io)?;
        // The parser holds the header's lengths against the map's before it looks further.
        let scene = parse(&map).map_err(|e| OpenError::bad(path, e))?;
        let SceneFile { skeleton, geometry, pixels, digest, file_bytes: _ } = scene;
        let words = skeleton.blobs.len().div_ceil(64);
        Ok(Self {
            path: path.to_path_buf(),
            map,
            skeleton: Arc::new(skeleton),
            geometry,
            pixels,
            digest,
            checked: std::iter::repeat_with(AtomicU64::default).take(words).collect(),
        })
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

    /// All bytes of the file.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.map
    }

    /// The geometry section.
    pub(crate) fn geometry(&self) -> &[u8] {
        &self.map[self.geometry.start as usize..self.geometry.end as usize]
    }

    /// The pixel section.
    pub(crate) fn pixels(&self) -> &[u8] {
        &self.map[self.pixels.start as usize..self.pixels.end as usize]
    }

    /// A texture's mips, 64-byte aligned ([`protocol::format::texture`]), checked at every call: there
    /// is one for each backend.
    ///
    /// # Panics
    /// If the scene has no such texture.
    pub fn texture(&self, index: u32) -> Result<&[u8], StoreError> {
        let texture = &self.skeleton.textures[index as usize];
        let bytes = &self.pixels()[texture.offset as usize..][..texture.bytes as usize];
        if texture.is_made_of(bytes) {
            Ok(bytes)
        } else {
            Err(StoreError::DamagedTexture { path: self.path.clone(), texture: index })
        }
    }

    /// A blob's bytes, 64-byte aligned: vertices, then indices ([`protocol::format::vertex`]).
    ///
    /// The first call for a blob reads all of it and checks it; what it returns has the right
    /// length, and no index without a vertex.
    pub fn blob(&self, id: BlobId) -> Result<&[u8], StoreError> {
        let Some(blob) = self.skeleton.blobs.get(id.index()) else {
            return Err(StoreError::Unknown { path: self.path.clone(), blob: id });
        };
        let bytes = &self.geometry()[blob.offset as usize..][..blob.bytes as usize];
        let (word, bit) = (&self.checked[id.index() / 64], 1 << (id.index() % 64));
        // Two threads may both check a blob; the bit guards no other memory, so relaxed will do.
        if word.load(Ordering::Relaxed) & bit == 0 {
            let textures = self.skeleton.textures.len() as u32;
            check_blob(blob, bytes, textures).map_err(|source| StoreError::Damaged {
                path: self.path.clone(),
                blob: id,
                source,
            })?;
            word.fetch_or(bit, Ordering::Relaxed);
        }
        Ok(bytes)
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

/// Maps a whole file for reading.
#[allow(unsafe_code, reason = "a memory map is the purpose of this module")]
fn map(file: &File) -> std::io::Result<Mmap> {
    // SAFETY: The map is private to this store and read-only. It is sound as long as nobody changes
    // the file in place; scene files are published by rename alone and never written to again, which
    // `Store::open` states as its contract.
    unsafe { Mmap::map(file) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture;

    #[test]
    fn openings_fail_by_kind_and_name_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.occ");
        let kind = |path: &Path| {
            let error = Store::open(path).unwrap_err();
            assert!(error.to_string().contains(&path.display().to_string()), "{error}");
            failure_kind(&error)
        };
        assert_eq!(kind(&path), FailureKind::NoInput);
        assert_eq!(kind(folder.path()), FailureKind::Io);
        for contents in [&b""[..], b"solid teapot", &[0; 300]] {
            std::fs::write(&path, contents).unwrap();
            assert_eq!(kind(&path), FailureKind::BadData);
        }
        fixture::write(&path);
        let bytes = std::fs::read(&path).unwrap();
        for length in 1..bytes.len() {
            std::fs::write(&path, &bytes[..length]).unwrap();
            assert_eq!(kind(&path), FailureKind::BadData, "cut to {length}");
        }
    }

    #[test]
    fn blobs_are_aligned_and_checked_when_first_used() {
        let (folder, store) = fixture::store();
        for i in 0..store.skeleton().blobs.len() as u32 {
            let bytes = store.blob(BlobId(i)).unwrap();
            assert_eq!(bytes.as_ptr() as usize % 64, 0);
        }
        let unknown = store.blob(BlobId(99));
        assert!(matches!(unknown, Err(StoreError::Unknown { .. })));

        let mut bytes = store.bytes().to_vec();
        let second = (store.geometry.start + store.skeleton().blobs[1].offset) as usize;
        bytes[second] ^= 1;
        let other = folder.path().join("other.occ");
        std::fs::write(&other, bytes).unwrap();
        let damaged = Store::open(&other).unwrap();
        assert!(damaged.blob(BlobId(0)).is_ok());
        for _ in 0..2 {
            let error = damaged.blob(BlobId(1)).unwrap_err();
            assert!(error.to_string().contains("other.occ: blob 1"), "{error}");
        }
    }

    #[test]
    fn a_file_replaced_by_rename_leaves_the_old_map_valid() {
        let (folder, store) = fixture::store();
        let before = store.bytes().to_vec();
        let finished = fixture::write_other(store.path());
        assert_ne!(finished.digest, store.digest());
        assert_eq!(store.bytes(), before);
        assert!(store.blob(BlobId(0)).is_ok());
        assert_eq!(Store::open(store.path()).unwrap().digest(), finished.digest);
        drop(folder);
        assert!(store.blob(BlobId(1)).is_ok());
    }

    #[test]
    fn threads_may_ask_for_the_same_blob() {
        let (_folder, store) = fixture::store();
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| store.blob(BlobId(1)).unwrap().len());
            }
        });
    }
}
