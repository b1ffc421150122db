//! Writing a scene file: geometry streamed out as it comes, then pixels, skeleton and header.
//!
//! Everything goes to a temporary name in the same folder and is published by a rename, so a reader
//! sees the old file or the new one, whole, and a map of the old one stays valid.

use super::layout::{HEADER_BYTES, Header};
use super::mesh;
use super::projected::NewPatch;
use super::texture::{self, Texture, Wrap};
use super::{ALIGNMENT, Blob, Digest, Hlod, Level, NONE, Part, SceneInfo, Section, Skeleton};
use super::{Class, Cube, Transform, Vertices, ViewCell, Violation, check};
use crate::id::BlobId;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Why a scene file could not be written. A temporary file is gone, a working file kept.
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
    /// The working file is not what the state says.
    #[error("{}: cannot be gone on with: {reason}; remove it and begin again", path.display())]
    Resume {
        /// The working file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
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

/// The tables of a skeleton that the writer does not fill itself.
#[derive(Debug, Clone, Default)]
pub struct Tables {
    /// See [`Skeleton::info`].
    pub info: SceneInfo,
    /// See [`Skeleton::hlods`].
    pub hlods: Vec<Hlod>,
    /// See [`Skeleton::levels`].
    pub levels: Vec<Level>,
    /// See [`Skeleton::parts`].
    pub parts: Vec<Part>,
    /// See [`Skeleton::transforms`].
    pub transforms: Vec<Transform>,
    /// See [`Skeleton::view_cells`].
    pub view_cells: Vec<ViewCell>,
    /// See [`Skeleton::cubes`].
    pub cubes: Vec<Cube>,
}

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Finished {
    /// Digest of the file.
    pub digest: Digest,
    /// Bytes of the file.
    pub bytes: u64,
}

/// How far a writer has come: what [`SceneWriter::resume`] needs beside the working file.
#[derive(Debug, Clone, PartialEq)]
pub struct WriterState {
    /// The blobs so far.
    pub blobs: Vec<Blob>,
    /// Bytes of geometry so far, a multiple of [`ALIGNMENT`].
    pub geometry_bytes: u64,
}

/// Writes one scene file. Dropped before [`SceneWriter::finish`] it leaves nothing behind, but for a
/// working file that the caller named.
#[derive(Debug)]
pub struct SceneWriter {
    path: PathBuf,
    temporary: Temporary,
    file: BufWriter<File>,
    /// Has seen every byte after the header so far.
    hasher: blake3::Hasher,
    so_far: WriterState,
    /// Bytes of pixels so far, a multiple of [`ALIGNMENT`].
    pixel_bytes: u64,
    textures: Vec<Texture>,
    /// See [`Skeleton::texture_lists`].
    texture_lists: Vec<u32>,
}

impl SceneWriter {
    /// Starts the file that will become `path`.
    pub fn create(path: &Path) -> Result<Self, WriteError> {
        let to_create = |source| WriteError::Create { path: path.to_path_buf(), source };
        if path.is_dir() {
            return Err(to_create(io::ErrorKind::IsADirectory.into()));
        }
        let (temporary, file) = Temporary::create(path).map_err(to_create)?;
        Self::start(path, temporary, file)
    }

    /// Starts the file that will become `path` under the name `working` in the same file system,
    /// in place of what has that name. It stays there until [`SceneWriter::finish`] renames it.
    pub fn create_at(working: &Path, path: &Path) -> Result<Self, WriteError> {
        let to_create = |source| WriteError::Create { path: working.to_path_buf(), source };
        let file = File::create(working).map_err(to_create)?;
        Self::start(path, Temporary::named(working), file)
    }

    fn start(path: &Path, temporary: Temporary, file: File) -> Result<Self, WriteError> {
        let so_far = WriterState { blobs: Vec::new(), geometry_bytes: 0 };
        let mut writer = Self::over(path, temporary, file, so_far);
        // The header's place; zeros are no magic, so what a crash leaves is not mistaken for a scene.
        writer.file.write_all(&[0; HEADER_BYTES]).map_err(|e| writer.write_error(e))?;
        Ok(writer)
    }

    fn over(path: &Path, temporary: Temporary, file: File, so_far: WriterState) -> Self {
        Self {
            path: path.to_path_buf(),
            temporary,
            file: BufWriter::with_capacity(1 << 20, file),
            hasher: blake3::Hasher::new(),
            so_far,
            pixel_bytes: 0,
            textures: Vec::new(),
            texture_lists: Vec::new(),
        }
    }

    /// Hands all geometry so far to the system and says how far that is: a killed process goes on from
    /// there, a machine that lost its power may not.
    ///
    /// # Panics
    /// Once there is a texture: pixels lie behind all geometry.
    pub fn checkpoint(&mut self) -> Result<WriterState, WriteError> {
        assert!(self.textures.is_empty(), "textures are written in one go");
        self.file.flush().map_err(|e| self.write_error(e))?;
        Ok(self.so_far.clone())
    }

    /// Goes on from a checkpoint of a writer made by [`SceneWriter::create_at`]: cuts the working file
    /// to it and reads it back. Of `state` and the file nothing is believed that can be checked.
    pub fn resume(working: &Path, path: &Path, state: WriterState) -> Result<Self, WriteError> {
        let to_create = |source| WriteError::Create { path: working.to_path_buf(), source };
        let file = OpenOptions::new().read(true).write(true).open(working).map_err(to_create)?;
        let bad = |reason: String| WriteError::Resume { path: working.to_path_buf(), reason };
        check::check_blobs(&state.blobs).map_err(|violation| bad(violation.to_string()))?;
        let end = state.blobs.last().map_or(0, |b| b.offset + b.bytes);
        if state.geometry_bytes != end.next_multiple_of(ALIGNMENT) {
            return Err(bad("its blobs do not make its length".to_owned()));
        }
        let total = HEADER_BYTES as u64 + state.geometry_bytes;
        let cut = || -> io::Result<bool> {
            let long_enough = file.metadata()?.len() >= total;
            if long_enough {
                file.set_len(total)?;
                (&file).seek(SeekFrom::Start(HEADER_BYTES as u64))?;
            }
            Ok(long_enough)
        };
        if !cut().map_err(|e| bad(e.to_string()))? {
            return Err(bad("it is shorter than it was".to_owned()));
        }
        let mut writer = Self::over(path, Temporary::named(working), file, state);
        let mut content = Vec::new();
        for (id, blob) in writer.so_far.blobs.iter().enumerate() {
            content.resize(blob.bytes.next_multiple_of(ALIGNMENT) as usize, 0);
            writer.file.get_ref().read_exact(&mut content).map_err(|e| bad(e.to_string()))?;
            let (own, padding) = content.split_at(blob.bytes as usize);
            if crc32c::crc32c(own) != blob.crc || padding.iter().any(|&byte| byte != 0) {
                return Err(bad(format!("blob {id} is damaged")));
            }
            let list = mesh::textures_in(blob, own);
            if blob.is_textured() && blob.image != list_at(&writer.texture_lists, &list) {
                return Err(bad(format!("blob {id} has other textures than it says")));
            }
            writer.texture_lists.extend(list);
            writer.hasher.update(&content);
        }
        Ok(writer)
    }

    /// Appends a mesh: `origin` and `step` place its grid in mesh space. Its triangles are sorted by
    /// [`Class`] and counted in `classes`.
    ///
    /// # Panics
    /// If `step` is no power of two, `origin` not finite, `classes` do not add up to the triangles or
    /// count masked ones of plain vertices, the mesh breaks the rules of [`super::vertex`] (no
    /// triangle, an index without a vertex, too many vertices), or there is a texture already.
    pub fn add_blob(
        &mut self,
        origin: [f64; 3],
        step: f64,
        vertices: Vertices<'_>,
        indices: &[u16],
        classes: [u32; Class::COUNT],
    ) -> Result<BlobId, WriteError> {
        assert!(check::is_power_of_two(step), "step {step} is no power of two");
        assert!(origin.iter().all(|c| c.is_finite()), "origin {origin:?}");
        let bytes = mesh::encode(vertices, indices);
        let blob = Blob {
            origin,
            step,
            vertices: vertices.count() as u32,
            triangles: (indices.len() / 3) as u32,
            layout: vertices.layout() as u32,
            classes,
            ..Blob::default()
        };
        let sum: u64 = classes.iter().map(|&n| u64::from(n)).sum();
        assert_eq!(sum, u64::from(blob.triangles), "classes {classes:?}");
        let masked = Class::ALL.iter().any(|class| class.is_mask() && blob.has(*class));
        assert!(blob.is_textured() || !masked, "plain vertices hold no cutoff");
        self.push(blob, &bytes)
    }

    /// Appends a face of a scan cube, which one cube of those that [`SceneWriter::finish`] is given must
    /// name.
    ///
    /// # Panics
    /// If its step is no power of two, it is not as the docs of [`NewPatch`] say, a vertex lies outside its
    /// picture, its mesh breaks the rules of [`SceneWriter::add_blob`], or there is a texture already.
    pub fn add_patch(&mut self, face: &NewPatch<'_>) -> Result<BlobId, WriteError> {
        assert!(check::is_power_of_two(face.step), "step {} is no power of two", face.step);
        let (blob, bytes) = face.encode();
        self.push(blob, &bytes)
    }

    /// Appends a blob of another file as it is: its record there, and its bytes, which have been checked.
    ///
    /// # Panics
    /// If there is a texture already.
    pub fn copy_blob(&mut self, blob: &Blob, bytes: &[u8]) -> Result<BlobId, WriteError> {
        self.push(*blob, bytes)
    }

    /// Appends a texture of another file likewise.
    pub fn copy_texture(&mut self, texture: &Texture, bytes: &[u8]) -> Result<u32, WriteError> {
        let index = self.textures.len() as u32;
        self.textures.push(Texture { offset: self.pixel_bytes, ..*texture });
        self.pixel_bytes += self.append(bytes)?;
        Ok(index)
    }

    /// Appends a blob whose place and checksum are still open.
    fn push(&mut self, blob: Blob, bytes: &[u8]) -> Result<BlobId, WriteError> {
        assert!(self.textures.is_empty(), "pixels lie behind all geometry");
        if self.so_far.blobs.len() as u64 >= u64::from(NONE) - 1 {
            return Err(WriteError::TooMany { path: self.path.clone() });
        }
        let id = BlobId(self.so_far.blobs.len() as u32);
        let list = mesh::textures_in(&blob, bytes);
        let image = match blob.is_textured() {
            true => list_at(&self.texture_lists, &list),
            false => blob.image,
        };
        self.texture_lists.extend(list);
        self.so_far.blobs.push(Blob {
            image,
            offset: self.so_far.geometry_bytes,
            bytes: bytes.len() as u64,
            crc: crc32c::crc32c(bytes),
            ..blob
        });
        self.so_far.geometry_bytes += self.append(bytes)?;
        Ok(id)
    }

    /// Appends a texture of sRGB-encoded RGBA rows and its mips, after the last blob; returns its index.
    ///
    /// # Panics
    /// As [`texture::mips`].
    pub fn add_texture(
        &mut self,
        side: u32,
        wrap: [Wrap; 2],
        rgba: &[u8],
    ) -> Result<u32, WriteError> {
        let bytes = texture::mips(side, rgba);
        let index = self.textures.len() as u32;
        self.textures.push(Texture {
            offset: self.pixel_bytes,
            bytes: bytes.len() as u64,
            side,
            wrap: Wrap::pack(wrap),
            crc: crc32c::crc32c(&bytes),
            reserved: 0,
        });
        self.pixel_bytes += self.append(&bytes)?;
        Ok(index)
    }

    /// Blobs added before: the number of the next.
    pub fn blob_count(&self) -> u32 {
        self.so_far.blobs.len() as u32
    }

    /// A blob added before.
    pub fn blob(&self, id: BlobId) -> &Blob {
        &self.so_far.blobs[id.index()]
    }

    /// Writes skeleton and header, syncs, and gives the file its name.
    ///
    /// The same calls in the same order give the same bytes, resumed or not.
    pub fn finish(mut self, tables: Tables) -> Result<Finished, WriteError> {
        let skeleton = Skeleton {
            info: tables.info,
            hlods: tables.hlods,
            levels: tables.levels,
            parts: tables.parts,
            blobs: std::mem::take(&mut self.so_far.blobs),
            transforms: tables.transforms,
            textures: std::mem::take(&mut self.textures),
            view_cells: tables.view_cells,
            cubes: tables.cubes,
            texture_lists: std::mem::take(&mut self.texture_lists),
        };
        let sound = check(&skeleton).and_then(|()| check::check_disjoint(&skeleton.view_cells));
        if let Err(source) = sound {
            return Err(WriteError::Invalid { path: self.path.clone(), source });
        }
        let mut bytes = [0; Section::ALL.len()];
        let mut crcs = [0; Section::ALL.len()];
        (bytes[0], bytes[1]) = (self.so_far.geometry_bytes, self.pixel_bytes);
        for (row, content) in (2..).zip(contents(&skeleton)) {
            self.append(content)?;
            (bytes[row], crcs[row]) = (content.len() as u64, crc32c::crc32c(content));
        }
        let mut header = Header::new(bytes, crcs).expect("what was written has a length");
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
fn contents(skeleton: &Skeleton) -> [&[u8]; Section::ALL.len() - 2] {
    [
        bytemuck::bytes_of(&skeleton.info),
        bytemuck::cast_slice(&skeleton.hlods),
        bytemuck::cast_slice(&skeleton.levels),
        bytemuck::cast_slice(&skeleton.parts),
        bytemuck::cast_slice(&skeleton.blobs),
        bytemuck::cast_slice(&skeleton.transforms),
        bytemuck::cast_slice(&skeleton.textures),
        bytemuck::cast_slice(&skeleton.view_cells),
        bytemuck::cast_slice(&skeleton.cubes),
        bytemuck::cast_slice(&skeleton.texture_lists),
    ]
}

/// Where a list will lie behind those before it, as [`Blob::image`] says it.
fn list_at(before: &[u32], list: &[u32]) -> [u32; 2] {
    [before.len() as u32, list.len() as u32]
}

/// The folder `path` lies in.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// A file that is removed unless it is published or was named by the caller.
#[derive(Debug)]
struct Temporary {
    /// `None` once published.
    path: Option<PathBuf>,
    kept: bool,
}

impl Temporary {
    /// The caller's own file.
    fn named(working: &Path) -> Self {
        Self { path: Some(working.to_path_buf()), kept: true }
    }

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
                Ok(file) => return Ok((Self { path: Some(path), kept: false }, file)),
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
        if let (Some(path), false) = (&self.path, self.kept) {
            // Nobody is left to tell if this fails; the name says what the file is.
            let _ = std::fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests;
