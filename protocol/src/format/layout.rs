//! Header and section table as they lie in the file.
//!
//! The layout is canonical: the lengths of the twelve sections determine every offset, so a reader
//! compares the table with the one it would have written and has nothing left to distrust.

use super::{Blob, Cube, Digest, Hlod, Level, Part, SceneInfo, Texture, Transform, ViewCell};
use bytemuck::{Pod, Zeroable};

// Records are cast in place, so the machine must agree with the file.
const _: () = assert!(cfg!(target_endian = "little"), "scene files are little-endian");

/// Version of the layout; a file of another version is refused.
pub const FORMAT_VERSION: u32 = 6;
/// Every section and every blob starts at a multiple of this many bytes.
pub const ALIGNMENT: u64 = 64;

/// First bytes of the file. The high bit exposes a seven-bit transfer, CR LF and LF a change of line
/// endings, and the control-Z stops a terminal (after PNG, ISO/IEC 15948, section 5.2).
pub(super) const MAGIC: [u8; 8] = *b"\x89OCC\r\n\x1a\n";
/// Reads as 0x04030201 in a file of the other byte order.
pub(super) const ENDIAN_MARK: u32 = 0x0102_0304;
/// Bytes of [`Header`].
pub(super) const HEADER_BYTES: usize = size_of::<Header>();

/// A part of the file, in file order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Section {
    /// Blobs, each with its own checksum.
    Geometry = 1,
    /// Pixels of textures, each with its own checksum.
    Pixels,
    /// One [`SceneInfo`].
    Info,
    /// [`Hlod`]s.
    Hlods,
    /// [`Level`]s.
    Levels,
    /// [`Part`]s.
    Parts,
    /// [`Blob`]s.
    Blobs,
    /// [`Transform`]s.
    Transforms,
    /// [`Texture`]s.
    Textures,
    /// [`ViewCell`]s.
    ViewCells,
    /// [`Cube`]s.
    Cubes,
    /// Numbers of textures: the lists of the textured blobs, one after another.
    TextureLists,
}

impl Section {
    /// All sections in file order.
    pub const ALL: [Self; 12] = [
        Self::Geometry,
        Self::Pixels,
        Self::Info,
        Self::Hlods,
        Self::Levels,
        Self::Parts,
        Self::Blobs,
        Self::Transforms,
        Self::Textures,
        Self::ViewCells,
        Self::Cubes,
        Self::TextureLists,
    ];

    /// It holds data that is checked piece by piece when it is first used, not a table.
    pub(super) fn is_bulk(self) -> bool {
        matches!(self, Self::Geometry | Self::Pixels)
    }

    /// Bytes of one record; the section's length is a multiple of it.
    pub fn record_bytes(self) -> u64 {
        let bytes = match self {
            Self::Geometry | Self::Pixels => return ALIGNMENT,
            Self::Info => size_of::<SceneInfo>(),
            Self::Hlods => size_of::<Hlod>(),
            Self::Levels => size_of::<Level>(),
            Self::Parts => size_of::<Part>(),
            Self::Blobs => size_of::<Blob>(),
            Self::Transforms => size_of::<Transform>(),
            Self::Textures => size_of::<Texture>(),
            Self::ViewCells => size_of::<ViewCell>(),
            Self::Cubes => size_of::<Cube>(),
            Self::TextureLists => size_of::<u32>(),
        };
        bytes as u64
    }
}

impl std::fmt::Display for Section {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Geometry => "geometry",
            Self::Pixels => "pixels",
            Self::Info => "info",
            Self::Hlods => "hlods",
            Self::Levels => "levels",
            Self::Parts => "parts",
            Self::Blobs => "blobs",
            Self::Transforms => "transforms",
            Self::Textures => "textures",
            Self::ViewCells => "view cells",
            Self::Cubes => "cubes",
            Self::TextureLists => "texture lists",
        })
    }
}

/// A row of the section table: 32 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct SectionEntry {
    /// [`Section`] as a number.
    pub(super) kind: u32,
    /// CRC32C of the section without padding; 0 for geometry and pixels.
    pub(super) crc: u32,
    /// First byte in the file.
    pub(super) offset: u64,
    /// Bytes without padding.
    pub(super) bytes: u64,
    /// Bytes of one record.
    pub(super) record_bytes: u32,
    /// Zero.
    pub(super) reserved: u32,
}

/// The first 448 bytes of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Header {
    pub(super) magic: [u8; 8],
    pub(super) version: u32,
    pub(super) endian_mark: u32,
    pub(super) file_bytes: u64,
    pub(super) section_count: u32,
    /// CRC32C of the header with this field zero.
    pub(super) crc: u32,
    pub(super) digest: Digest,
    pub(super) sections: [SectionEntry; Section::ALL.len()],
}

impl Header {
    /// The header of a file whose sections have these lengths and checksums, digest and header
    /// checksum still zero. `None` if the file would be longer than 2^64 bytes.
    pub(super) fn new(
        bytes: [u64; Section::ALL.len()],
        crcs: [u32; Section::ALL.len()],
    ) -> Option<Self> {
        let mut header = Self {
            magic: MAGIC,
            version: FORMAT_VERSION,
            endian_mark: ENDIAN_MARK,
            section_count: Section::ALL.len() as u32,
            ..Self::zeroed()
        };
        let mut offset = HEADER_BYTES as u64;
        for (i, section) in Section::ALL.into_iter().enumerate() {
            header.sections[i] = SectionEntry {
                kind: section as u32,
                crc: crcs[i],
                offset,
                bytes: bytes[i],
                record_bytes: section.record_bytes() as u32,
                reserved: 0,
            };
            offset = offset.checked_add(bytes[i])?.checked_next_multiple_of(ALIGNMENT)?;
        }
        header.file_bytes = offset;
        Some(header)
    }

    /// The row of `section`.
    pub(super) fn section(&self, section: Section) -> &SectionEntry {
        &self.sections[section as usize - 1]
    }

    /// First byte after geometry and pixels: where the skeleton begins.
    pub(super) fn skeleton_offset(&self) -> u64 {
        self.section(Section::Info).offset
    }

    /// What [`Header::crc`] must be.
    pub(super) fn expected_crc(&self) -> u32 {
        crc32c::crc32c(bytemuck::bytes_of(&Self { crc: 0, ..*self }))
    }

    /// Finishes the digest: `rest` has been fed every byte after the header.
    pub(super) fn digest(&self, mut rest: blake3::Hasher) -> Digest {
        let bare = Self { crc: 0, digest: [0; 32], ..*self };
        rest.update(bytemuck::bytes_of(&bare)).finalize().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_is_448_bytes_and_records_have_their_documented_size() {
        assert_eq!(HEADER_BYTES, 448);
        let bytes = Section::ALL.map(Section::record_bytes);
        assert_eq!(bytes, [64, 64, 224, 80, 24, 8, 96, 96, 32, 72, 64, 4]);
    }

    #[test]
    fn offsets_follow_from_lengths() {
        let header = Header::new([0, 64, 224, 80, 24, 8, 0, 0, 32, 72, 56, 4], [0; 12]).unwrap();
        let offsets = [448, 448, 512, 768, 896, 960, 1024, 1024, 1024, 1088, 1216, 1280];
        assert_eq!(header.sections.map(|s| s.offset), offsets);
        assert_eq!((header.skeleton_offset(), header.file_bytes), (512, 1344));
    }

    #[test]
    fn lengths_that_overflow_have_no_header() {
        assert_eq!(Header::new([u64::MAX, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0], [0; 12]), None);
        let twice = [1 << 63, 0, 64, 1 << 63, 0, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(Header::new(twice, [0; 12]), None);
    }
}
