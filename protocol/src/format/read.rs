//! Reading a scene file without trusting it.
//!
//! Opening reads the header and the skeleton, which lie at the two ends of the file; geometry and pixels
//! between them are left alone, and each blob and texture is checked on first use. [`digest`] reads everything.

use super::layout::{ENDIAN_MARK, FORMAT_VERSION, HEADER_BYTES, Header, MAGIC};
use super::mesh::{BlobDamage, check_blob};
use super::{Digest, NONE, SceneInfo, Section, Skeleton, Violation};
use crate::id::BlobId;
use bytemuck::{Pod, Zeroable};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// An opened scene file: all of it but geometry and pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneFile {
    /// The skeleton; [`super::check()`] has passed.
    pub skeleton: Skeleton,
    /// Where the geometry section lies, bytes from the start of the file.
    pub geometry: Range<u64>,
    /// Where the pixel section lies, bytes from the start of the file.
    pub pixels: Range<u64>,
    /// The digest the file claims; [`digest`] computes the real one.
    pub digest: Digest,
    /// Bytes of the file.
    pub file_bytes: u64,
}

impl SceneFile {
    /// Where a blob lies, bytes from the start of the file.
    pub fn blob_range(&self, id: BlobId) -> Range<u64> {
        let blob = self.skeleton.blob(id);
        let start = self.geometry.start + blob.offset;
        start..start + blob.bytes
    }

    /// Where a texture lies, bytes from the start of the file.
    ///
    /// # Panics
    /// If the scene has no such texture.
    pub fn texture_range(&self, index: u32) -> Range<u64> {
        let texture = self.skeleton.textures[index as usize];
        let start = self.pixels.start + texture.offset;
        start..start + texture.bytes
    }
}

/// Why bytes are not a scene file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FormatError {
    /// No bytes at all.
    #[error("the file is empty; bake the scene again")]
    Empty,
    /// Something else.
    #[error("this is not a scene file; make one with `occluster bake`")]
    Foreign,
    /// Line endings or high bits were changed on the way.
    #[error("the file was changed by a text-mode transfer; copy it again as binary")]
    TextMode,
    /// Another version of the layout.
    #[error(
        "the file has format version {found}, this program reads {FORMAT_VERSION}; bake the scene again"
    )]
    Version {
        /// The file's version.
        found: u32,
    },
    /// Written in the other byte order.
    #[error("the file has the byte order of another machine; bake the scene again")]
    Endianness,
    /// The file ends too early, or goes on too long.
    #[error("the file is {found} bytes long but should be {expected}; copy or bake it again")]
    Length {
        /// Bytes there are.
        found: u64,
        /// Bytes the header calls for.
        expected: u64,
    },
    /// The header is not what was written.
    #[error("the header is damaged; copy or bake the file again")]
    Header,
    /// The section table contradicts itself.
    #[error("the table entry of section {section} is wrong; bake the scene again")]
    Table {
        /// The section.
        section: Section,
    },
    /// A section is not what was written.
    #[error("section {section} is damaged; copy or bake the file again")]
    Damaged {
        /// The section.
        section: Section,
    },
    /// The skeleton breaks a promise.
    #[error("the scene breaks a rule at {0}; bake the scene again")]
    Invalid(#[from] Violation),
}

/// Why a scene file could not be opened. Names the file, what is wrong and what to do.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// No such file (exit code 66).
    #[error("{}: there is no such file; check the path or make it with `occluster bake`", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
    },
    /// The system refused (exit code 74).
    #[error("{}: cannot read it: {source}; check its permissions and the disk", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// Not a scene file, or a damaged one (exit code 65).
    #[error("{}: {source}", path.display())]
    Bad {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: FormatError,
    },
}

impl ReadError {
    /// Sorts a failed system call on `path`.
    pub fn io(path: &Path, source: io::Error) -> Self {
        let path = path.to_path_buf();
        match source.kind() {
            io::ErrorKind::NotFound => Self::Missing { path },
            _ => Self::Io { path, source },
        }
    }

    /// Wraps bad contents of `path`.
    pub fn bad(path: &Path, source: FormatError) -> Self {
        Self::Bad { path: path.to_path_buf(), source }
    }
}

/// Why a blob could not be read.
#[derive(Debug, thiserror::Error)]
pub enum BlobReadError {
    /// The system refused.
    #[error("cannot read blob {blob}: {source}")]
    Io {
        /// The blob.
        blob: BlobId,
        /// The system's reason.
        source: io::Error,
    },
    /// The bytes are wrong.
    #[error("blob {blob} is damaged: {source}; copy or bake the file again")]
    Damaged {
        /// The blob.
        blob: BlobId,
        /// What is wrong.
        source: BlobDamage,
    },
}

/// Opens a whole scene file in memory, without touching the geometry.
///
/// Never panics and allocates no more than `bytes` is long, whatever it holds.
pub fn parse(bytes: &[u8]) -> Result<SceneFile, FormatError> {
    let header = parse_header(bytes, bytes.len() as u64)?;
    // The table has been held against the real length, so this lies inside.
    parse_skeleton(&header, &bytes[header.skeleton_offset() as usize..])
}

/// Opens a scene file, reading its header and skeleton alone.
pub fn read_skeleton(path: &Path) -> Result<SceneFile, ReadError> {
    let file = crate::file::open(path).map_err(|e| ReadError::io(path, e))?;
    read_skeleton_of(&file, path)
}

/// [`read_skeleton`] of an opened file; `path` is for errors alone. Moves the file's cursor.
///
/// Allocates no more than header and skeleton take, and nothing before the header's lengths agree
/// with the file's own.
pub fn read_skeleton_of(file: &File, path: &Path) -> Result<SceneFile, ReadError> {
    let to_io = |e| ReadError::io(path, e);
    let mut file = file;
    let file_bytes = file.metadata().map_err(to_io)?.len();
    let mut start = Vec::with_capacity(HEADER_BYTES);
    file.seek(SeekFrom::Start(0)).map_err(to_io)?;
    file.take(HEADER_BYTES as u64).read_to_end(&mut start).map_err(to_io)?;
    let to_bad = |e| ReadError::bad(path, e);
    let header = parse_header(&start, file_bytes).map_err(to_bad)?;

    file.seek(SeekFrom::Start(header.skeleton_offset())).map_err(to_io)?;
    let expected = file_bytes - header.skeleton_offset();
    let mut skeleton = Vec::new();
    // A file may be all holes and longer than the memory: that is an error and no abort.
    let room = usize::try_from(expected).map_err(|_| io::ErrorKind::OutOfMemory.into());
    room.and_then(|n| skeleton.try_reserve_exact(n).map_err(io::Error::from)).map_err(to_io)?;
    // The file may shrink meanwhile: what is missing is an error, not a wait.
    file.take(expected).read_to_end(&mut skeleton).map_err(to_io)?;
    if skeleton.len() as u64 != expected {
        let found = header.skeleton_offset() + skeleton.len() as u64;
        return Err(to_bad(FormatError::Length { found, expected: file_bytes }));
    }
    parse_skeleton(&header, &skeleton).map_err(to_bad)
}

/// Reads and checks one blob. Moves the file's cursor: one thread a handle.
///
/// # Panics
/// If the scene has no such blob.
pub fn read_blob(file: &File, scene: &SceneFile, blob: BlobId) -> Result<Vec<u8>, BlobReadError> {
    let range = scene.blob_range(blob);
    let mut file = file;
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(range.start))
        .and_then(|_| file.take(range.end - range.start).read_to_end(&mut bytes))
        .map_err(|source| BlobReadError::Io { blob, source })?;
    check_blob(scene.skeleton.blob(blob), &bytes, scene.skeleton.textures_of(blob))
        .map_err(|source| BlobReadError::Damaged { blob, source })?;
    Ok(bytes)
}

/// The real digest of a whole file, read from its first byte to its last: BLAKE3 of everything after
/// the header, then of the header with digest and checksum zero.
///
/// # Errors
/// The reader's own, and [`io::ErrorKind::UnexpectedEof`] where it yields less than a header.
pub fn digest(mut file: impl Read) -> io::Result<Digest> {
    let mut header = Header::zeroed();
    file.read_exact(bytemuck::bytes_of_mut(&mut header))?;
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(file)?;
    Ok(header.digest(hasher))
}

/// Checks the header against the file's real length.
fn parse_header(start: &[u8], file_bytes: u64) -> Result<Header, FormatError> {
    if start.is_empty() {
        return Err(FormatError::Empty);
    }
    let seen = start.len().min(MAGIC.len());
    if start[..seen] != MAGIC[..seen] {
        let ours = start.len() >= 4 && (start[..4] == MAGIC[..4] || start[..4] == *b"\x09OCC");
        return Err(if ours { FormatError::TextMode } else { FormatError::Foreign });
    }
    // Order and version come before length and checksum: another version may differ in both.
    if let Some(&[version, endian_mark]) = start.get(8..16).map(|b| b.as_chunks::<4>().0) {
        let [version, endian_mark] = [version, endian_mark].map(u32::from_le_bytes);
        if endian_mark == ENDIAN_MARK.swap_bytes() {
            return Err(FormatError::Endianness);
        }
        if endian_mark == ENDIAN_MARK && version != FORMAT_VERSION {
            return Err(FormatError::Version { found: version });
        }
    }
    let Some(bytes) = start.get(..HEADER_BYTES) else {
        return Err(FormatError::Length { found: file_bytes, expected: HEADER_BYTES as u64 });
    };
    let header: Header = bytemuck::pod_read_unaligned(bytes);
    if header.crc != header.expected_crc() {
        return Err(FormatError::Header);
    }
    check_table(&header)?;
    if header.file_bytes != file_bytes {
        return Err(FormatError::Length { found: file_bytes, expected: header.file_bytes });
    }
    Ok(header)
}

/// Holds the table against the one that follows from the sections' lengths.
fn check_table(header: &Header) -> Result<(), FormatError> {
    for section in Section::ALL {
        let entry = header.section(section);
        let wrong_crc = section.is_bulk() && entry.crc != 0;
        let records = entry.bytes / section.record_bytes();
        let too_many = !section.is_bulk() && records >= u64::from(NONE);
        let odd = !entry.bytes.is_multiple_of(section.record_bytes());
        if wrong_crc || too_many || odd || section == Section::Info && records != 1 {
            return Err(FormatError::Table { section });
        }
    }
    let canonical = Header::new(header.sections.map(|s| s.bytes), header.sections.map(|s| s.crc))
        .ok_or(FormatError::Table { section: Section::Geometry })?;
    for section in Section::ALL {
        if header.section(section) != canonical.section(section) {
            return Err(FormatError::Table { section });
        }
    }
    let canonical = Header { crc: header.crc, digest: header.digest, ..canonical };
    if *header == canonical { Ok(()) } else { Err(FormatError::Header) }
}

/// Decodes and checks everything after geometry and pixels. `bytes` reaches to the file's end.
fn parse_skeleton(header: &Header, bytes: &[u8]) -> Result<SceneFile, FormatError> {
    let skeleton = Skeleton {
        info: section_records::<SceneInfo>(header, bytes, Section::Info)?[0],
        hlods: section_records(header, bytes, Section::Hlods)?,
        levels: section_records(header, bytes, Section::Levels)?,
        parts: section_records(header, bytes, Section::Parts)?,
        blobs: section_records(header, bytes, Section::Blobs)?,
        transforms: section_records(header, bytes, Section::Transforms)?,
        textures: section_records(header, bytes, Section::Textures)?,
        view_cells: section_records(header, bytes, Section::ViewCells)?,
        cubes: section_records(header, bytes, Section::Cubes)?,
        texture_lists: section_records(header, bytes, Section::TextureLists)?,
    };
    super::check(&skeleton)?;
    let of_blobs = skeleton.blobs.last().map_or(0, |b| b.offset + b.bytes);
    let of_textures = skeleton.textures.last().map_or(0, |t| t.offset + t.bytes);
    for (section, used) in [(Section::Geometry, of_blobs), (Section::Pixels, of_textures)] {
        if header.section(section).bytes != used.next_multiple_of(super::ALIGNMENT) {
            return Err(FormatError::Table { section });
        }
    }
    let range = |section| {
        let entry = header.section(section);
        entry.offset..entry.offset + entry.bytes
    };
    Ok(SceneFile {
        skeleton,
        geometry: range(Section::Geometry),
        pixels: range(Section::Pixels),
        digest: header.digest,
        file_bytes: header.file_bytes,
    })
}

/// The records of one section, its checksum and the zeros behind it checked.
fn section_records<T: Pod>(
    header: &Header,
    bytes: &[u8],
    section: Section,
) -> Result<Vec<T>, FormatError> {
    let entry = header.section(section);
    let start = (entry.offset - header.skeleton_offset()) as usize;
    let (content, rest) = bytes[start..].split_at(entry.bytes as usize);
    let padding =
        &rest[..content.len().next_multiple_of(super::ALIGNMENT as usize) - content.len()];
    if crc32c::crc32c(content) != entry.crc || padding.iter().any(|&b| b != 0) {
        return Err(FormatError::Damaged { section });
    }
    let mut records = vec![T::zeroed(); content.len() / size_of::<T>()];
    bytemuck::cast_slice_mut(&mut records).copy_from_slice(content);
    Ok(records)
}

#[cfg(test)]
mod tests;
