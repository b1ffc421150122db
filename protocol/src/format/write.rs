//! Writing a scene file: geometry streamed out as it comes, skeleton and header last.
//!
//! Everything goes to a temporary name in the same folder and is published by a rename, so a reader
//! sees the old file or the new one, whole, and a map of the old one stays valid.

use super::layout::{HEADER_BYTES, Header};
use super::mesh;
use super::{ALIGNMENT, Blob, Digest, Hlod, Level, NONE, SceneInfo, Section, Skeleton, Transform};
use super::{Vertex, Violation, check};
use crate::id::BlobId;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Why a scene file could not be written. The temporary file is gone.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The temporary file could not be made.
    #[error("{}: cannot create it: {source}; check that its folder exists and may be written", path.display())]
    Create {
        /// The scene file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The disk is full, or failed.
    #[error("{}: cannot write it: {source}; check the space and state of the disk", path.display())]
    Write {
        /// The scene file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The finished file could not be renamed.
    #[error("{}: cannot replace it with the finished file: {source}", path.display())]
    Publish {
        /// The scene file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// More blobs than 32 bits count.
    #[error("{}: the scene has too many meshes; raise the triangles a mesh", path.display())]
    TooMany {
        /// The scene file.
        path: PathBuf,
    },
    /// The caller's skeleton breaks a rule: a bug of the bake.
    #[error("{}: not written, the scene breaks a rule at {source}", path.display())]
    Invalid {
        /// The scene file.
        path: PathBuf,
        /// The rule.
        source: Violation,
    },
}

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Finished {
    /// Digest of the file.
    pub digest: Digest,
    /// Bytes of the file.
    pub bytes: u64,
}

/// Writes one scene file. Dropped before [`SceneWriter::finish`] it leaves nothing behind.
#[derive(Debug)]
pub struct SceneWriter {
    path: PathBuf,
    temporary: Temporary,
    file: BufWriter<File>,
    /// Has seen every byte after the header so far.
    hasher: blake3::Hasher,
    /// Bytes of geometry so far, a multiple of [`ALIGNMENT`].
    geometry_bytes: u64,
    blobs: Vec<Blob>,
}

impl SceneWriter {
    /// Starts the file that will become `path`.
    pub fn create(path: &Path) -> Result<Self, WriteError> {
        let to_create = |source| WriteError::Create { path: path.to_path_buf(), source };
        if path.is_dir() {
            return Err(to_create(io::ErrorKind::IsADirectory.into()));
        }
        let (temporary, file) = Temporary::create(path).map_err(to_create)?;
        let mut writer = Self {
            path: path.to_path_buf(),
            temporary,
            file: BufWriter::with_capacity(1 << 20, file),
            hasher: blake3::Hasher::new(),
            geometry_bytes: 0,
            blobs: Vec::new(),
        };
        // The header's place; zeros are no magic, so what a crash leaves is not mistaken for a scene.
        writer.file.write_all(&[0; HEADER_BYTES]).map_err(|e| writer.write_error(e))?;
        Ok(writer)
    }

    /// Removes what this process has begun to write for `path`: for an exit that drops no writer.
    pub fn abandon(path: &Path) {
        let Some(begins) = Temporary::begins(path) else { return };
        for entry in std::fs::read_dir(folder_of(path)).into_iter().flatten().flatten() {
            if entry.file_name().as_encoded_bytes().starts_with(begins.as_encoded_bytes()) {
                // Nobody is left to tell if this fails; the name says what the file is.
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }

    /// Appends a mesh: `origin` and `step` place its grid in mesh space.
    ///
    /// # Panics
    /// If `step` is no power of two, `origin` not finite, or the mesh breaks the rules of
    /// [`super::vertex`] (no triangle, an index without a vertex, too many vertices).
    pub fn add_blob(
        &mut self,
        origin: [f64; 3],
        step: f64,
        vertices: &[Vertex],
        indices: &[u16],
    ) -> Result<BlobId, WriteError> {
        assert!(check::is_power_of_two(step), "step {step} is no power of two");
        assert!(origin.iter().all(|c| c.is_finite()), "origin {origin:?}");
        if self.blobs.len() as u64 >= u64::from(NONE) - 1 {
            return Err(WriteError::TooMany { path: self.path.clone() });
        }
        let bytes = mesh::encode(vertices, indices);
        let id = BlobId(self.blobs.len() as u32);
        self.blobs.push(Blob {
            origin,
            step,
            offset: self.geometry_bytes,
            bytes: bytes.len() as u64,
            vertices: vertices.len() as u32,
            triangles: (indices.len() / 3) as u32,
            crc: crc32c::crc32c(&bytes),
            reserved: 0,
        });
        self.geometry_bytes += self.append(&bytes)?;
        Ok(id)
    }

    /// A blob added before.
    pub fn blob(&self, id: BlobId) -> &Blob {
        &self.blobs[id.index()]
    }

    /// Writes skeleton and header, syncs, and gives the file its name.
    ///
    /// The same calls in the same order give the same bytes.
    pub fn finish(
        mut self,
        info: SceneInfo,
        hlods: Vec<Hlod>,
        levels: Vec<Level>,
        transforms: Vec<Transform>,
    ) -> Result<Finished, WriteError> {
        let blobs = std::mem::take(&mut self.blobs);
        let skeleton = Skeleton { info, hlods, levels, blobs, transforms };
        if let Err(source) = check(&skeleton) {
            return Err(WriteError::Invalid { path: self.path.clone(), source });
        }
        let contents = contents(&skeleton);
        for content in contents {
            self.append(content)?;
        }
        let [i, h, l, b, t] = contents.map(|c| c.len() as u64);
        let crcs = contents.map(crc32c::crc32c);
        let mut header = Header::new(
            [self.geometry_bytes, i, h, l, b, t],
            [0, crcs[0], crcs[1], crcs[2], crcs[3], crcs[4]],
        )
        .expect("what was written has a length");
        header.digest = header.digest(self.hasher.clone());
        header.crc = header.expected_crc();
        self.publish(&header)?;
        Ok(Finished { digest: header.digest, bytes: header.file_bytes })
    }

    /// Writes bytes and the zeros behind them; returns how many in all.
    fn append(&mut self, bytes: &[u8]) -> Result<u64, WriteError> {
        let zeros = [0; ALIGNMENT as usize];
        let padded = (bytes.len() as u64).next_multiple_of(ALIGNMENT);
        for part in [bytes, &zeros[..padded as usize - bytes.len()]] {
            self.hasher.update(part);
            self.file.write_all(part).map_err(|e| self.write_error(e))?;
        }
        Ok(padded)
    }

    /// Completes the temporary file on the disk, then renames it.
    fn publish(&mut self, header: &Header) -> Result<(), WriteError> {
        let complete = |file: &mut BufWriter<File>| {
            file.seek(SeekFrom::Start(0))?;
            file.write_all(bytemuck::bytes_of(header))?;
            file.flush()?;
            file.get_ref().sync_all()
        };
        complete(&mut self.file).map_err(|e| self.write_error(e))?;
        self.temporary
            .publish(&self.path)
            .map_err(|source| WriteError::Publish { path: self.path.clone(), source })
    }

    fn write_error(&self, source: io::Error) -> WriteError {
        WriteError::Write { path: self.path.clone(), source }
    }
}

/// The skeleton's sections in file order.
fn contents(skeleton: &Skeleton) -> [&[u8]; Section::ALL.len() - 1] {
    [
        bytemuck::bytes_of(&skeleton.info),
        bytemuck::cast_slice(&skeleton.hlods),
        bytemuck::cast_slice(&skeleton.levels),
        bytemuck::cast_slice(&skeleton.blobs),
        bytemuck::cast_slice(&skeleton.transforms),
    ]
}

/// The folder `path` lies in.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// A file that is removed unless it is published.
#[derive(Debug)]
struct Temporary {
    /// `None` once published.
    path: Option<PathBuf>,
}

impl Temporary {
    /// Makes a file beside `target` that no other writer has, of this process or another.
    fn create(target: &Path) -> io::Result<(Self, File)> {
        static COUNTER: AtomicU64 = AtomicU64::new(0);
        let begins = Self::begins(target).ok_or(io::ErrorKind::InvalidInput)?;
        loop {
            let mut temporary = begins.clone();
            let count = COUNTER.fetch_add(1, Ordering::Relaxed);
            temporary.push(format!("{count}.tmp"));
            let path = folder_of(target).join(temporary);
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => return Ok((Self { path: Some(path) }, file)),
                // Left over from a process that had the same id: take the next name.
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
                Err(e) => return Err(e),
            }
        }
    }

    /// How the names of this process's files for `target` begin; none where that names no file.
    fn begins(target: &Path) -> Option<std::ffi::OsString> {
        let mut begins = std::ffi::OsString::from(".");
        begins.push(target.file_name()?);
        begins.push(format!(".{}.", std::process::id()));
        Some(begins)
    }

    /// Renames the file to `target`, for good once the folder is on the disk too.
    fn publish(&mut self, target: &Path) -> io::Result<()> {
        if let Some(path) = &self.path {
            std::fs::rename(path, target)?;
            self.path = None;
        }
        // Other systems cannot sync a folder, and need not.
        #[cfg(unix)]
        File::open(folder_of(target))?.sync_all()?;
        Ok(())
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if let Some(path) = &self.path {
            // Nobody is left to tell if this fails; the name says what the file is.
            let _ = std::fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests;
