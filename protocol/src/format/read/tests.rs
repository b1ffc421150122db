use super::*;
use crate::format::fixture;
use proptest::prelude::*;

/// Replaces the header's checksum by the right one: what a liar would do.
fn sealed(mut bytes: Vec<u8>, change: impl FnOnce(&mut Header)) -> Vec<u8> {
    let mut header: Header = bytemuck::pod_read_unaligned(&bytes[..HEADER_BYTES]);
    change(&mut header);
    header.crc = header.expected_crc();
    bytes[..HEADER_BYTES].copy_from_slice(bytemuck::bytes_of(&header));
    bytes
}

/// A change of the header that only its fields can give away.
fn lie(change: impl FnOnce(&mut Header)) -> FormatError {
    parse(&sealed(fixture::bytes(), change)).expect_err("a lying header passed")
}

/// Opens and then reads everything, as `verify` would.
fn whole(bytes: &[u8]) -> bool {
    let Ok(scene) = parse(bytes) else { return false };
    let blobs = &scene.skeleton.blobs;
    let sound = |i: usize| {
        let range = scene.blob_range(BlobId(i as u32));
        let own = &bytes[range.start as usize..range.end as usize];
        check_blob(&blobs[i], own, scene.skeleton.textures_of(BlobId(i as u32))).is_ok()
    };
    (0..blobs.len()).all(sound) && digest(bytes).unwrap() == scene.digest
}

#[test]
fn empty_and_foreign_files() {
    assert_eq!(parse(b""), Err(FormatError::Empty));
    assert_eq!(parse(b"glTF\x02\0\0\0"), Err(FormatError::Foreign));
    assert_eq!(parse(&[0; 4096]), Err(FormatError::Foreign));
    let short = digest(&[0; HEADER_BYTES - 1][..]).unwrap_err();
    assert_eq!(short.kind(), io::ErrorKind::UnexpectedEof);
}

#[test]
fn text_mode_transfers_are_named() {
    let bytes = fixture::bytes();
    let unix: Vec<u8> = [&bytes[..4], &bytes[5..]].concat();
    assert_eq!(parse(&unix), Err(FormatError::TextMode));
    let seven_bit: Vec<u8> = bytes.iter().map(|b| b & 0x7f).collect();
    assert_eq!(parse(&seven_bit), Err(FormatError::TextMode));
}

#[test]
fn every_truncation_and_every_extension_is_found() {
    let bytes = fixture::bytes();
    for length in 0..bytes.len() {
        assert!(parse(&bytes[..length]).is_err(), "cut to {length}");
    }
    let longer = [&bytes[..], &[0; 64]].concat();
    assert!(matches!(parse(&longer), Err(FormatError::Length { .. })));
}

#[test]
fn every_flipped_bit_is_found() {
    let mut bytes = fixture::bytes();
    assert!(whole(&bytes));
    for bit in 0..bytes.len() * 8 {
        bytes[bit / 8] ^= 1 << (bit % 8);
        assert!(!whole(&bytes), "bit {} of byte {}", bit % 8, bit / 8);
        bytes[bit / 8] ^= 1 << (bit % 8);
    }
}

#[test]
fn opening_leaves_geometry_and_pixels_alone() {
    let mut bytes = fixture::bytes();
    let scene = parse(&bytes).unwrap();
    assert_eq!((scene.geometry.start, scene.geometry.end), (448, scene.pixels.start));
    assert_eq!(scene.texture_range(0), scene.pixels.start..scene.pixels.start + 20);
    bytes[scene.geometry.start as usize..scene.pixels.end as usize].fill(0xaa);
    assert_eq!(parse(&bytes).unwrap(), scene);
}

#[test]
fn other_versions_and_byte_orders_are_named() {
    assert_eq!(lie(|h| h.version = 1), FormatError::Version { found: 1 });
    // Another version may have a shorter header.
    let mut short = fixture::bytes();
    short[8] = 1;
    assert_eq!(parse(&short[..256]), Err(FormatError::Version { found: 1 }));
    assert_eq!(lie(|h| h.endian_mark = ENDIAN_MARK.swap_bytes()), FormatError::Endianness);
    assert_eq!(lie(|h| h.endian_mark = 7), FormatError::Header);
    assert_eq!(lie(|h| h.section_count = 5), FormatError::Header);
}

#[test]
fn lying_lengths_are_refused() {
    for section in Section::ALL {
        let row = section as usize - 1;
        for bytes in [1, 1 << 20, 1 << 40, u64::MAX - 63, u64::MAX] {
            lie(|h| h.sections[row].bytes = bytes);
        }
        assert_eq!(lie(|h| h.sections[row].offset += 64), FormatError::Table { section });
        assert_eq!(lie(|h| h.sections[row].reserved = 1), FormatError::Table { section });
        lie(|h| h.sections[row].bytes += section.record_bytes());
    }
    lie(|h| h.file_bytes = u64::MAX);
    lie(|h| h.sections[2].bytes = 0);
    lie(|h| h.sections[2].bytes = 448);
}

#[test]
fn consistent_lies_about_lengths_meet_the_files_end() {
    // Table, offsets and header checksum all agree; only the file is not that long.
    let forged = |row: usize, records: u64| {
        lie(|h| {
            let mut bytes = h.sections.map(|s| s.bytes);
            bytes[row] += records * Section::ALL[row].record_bytes();
            let digest = h.digest;
            *h = Header::new(bytes, h.sections.map(|s| s.crc)).unwrap();
            h.digest = digest;
        })
    };
    for row in [0, 1, 3, 4, 5, 6, 7, 8, 9, 10, 11] {
        for records in [16, 1000, 1 << 31] {
            let error = forged(row, records);
            assert!(matches!(error, FormatError::Length { .. }), "{error}");
        }
    }
}

#[test]
fn a_false_section_checksum_names_the_section() {
    for section in Section::ALL.into_iter().skip(2) {
        let error = lie(|h| h.sections[section as usize - 1].crc ^= 1);
        assert_eq!(error, FormatError::Damaged { section });
    }
}

#[test]
fn nonzero_padding_behind_a_section_is_refused() {
    let mut bytes = fixture::bytes();
    *bytes.last_mut().unwrap() = 1;
    assert_eq!(parse(&bytes), Err(FormatError::Damaged { section: Section::TextureLists }));
}

#[test]
fn files_are_opened_by_what_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    assert!(matches!(read_skeleton(&path), Err(ReadError::Missing { .. })));
    assert!(matches!(read_skeleton(folder.path()), Err(ReadError::Io { .. })));
    let bytes = fixture::bytes();
    for length in [0, 7, HEADER_BYTES - 1, HEADER_BYTES, 900, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        let error = read_skeleton(&path).unwrap_err();
        assert!(matches!(error, ReadError::Bad { .. }), "{length}: {error}");
        assert!(error.to_string().contains("scene.occ"), "{error}");
    }
}

#[test]
fn a_damaged_blob_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    let mut bytes = fixture::bytes();
    let scene = parse(&bytes).unwrap();
    bytes[scene.blob_range(BlobId(1)).start as usize] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let file = File::open(&path).unwrap();
    assert!(read_blob(&file, &scene, BlobId(0)).is_ok());
    let error = read_blob(&file, &scene, BlobId(1)).unwrap_err();
    assert!(error.to_string().contains("blob 1"), "{error}");
}

proptest! {
    #[test]
    fn random_bytes_are_refused_without_a_panic(bytes in prop::collection::vec(any::<u8>(), 0..2048)) {
        prop_assert!(parse(&bytes).is_err());
        let disguised = [&MAGIC[..], &bytes].concat();
        prop_assert!(parse(&disguised).is_err());
    }

    #[test]
    fn a_mutated_and_resealed_header_is_refused(
        at in 16..HEADER_BYTES, value in any::<[u8; 8]>(), length in 1usize..=8,
    ) {
        let mut bytes = fixture_bytes();
        let end = (at + length).min(HEADER_BYTES);
        bytes[at..end].copy_from_slice(&value[..end - at]);
        let bytes = sealed(bytes, |_| ());
        prop_assert!(bytes == fixture_bytes() || !whole(&bytes));
    }

    #[test]
    fn a_mutated_and_resealed_skeleton_never_panics(
        at in any::<prop::sample::Index>(), value in any::<[u8; 4]>(),
    ) {
        let mut bytes = fixture_bytes();
        let start = parse(&bytes).unwrap().pixels.end as usize;
        let at = start + at.index((bytes.len() - start) / 4) * 4;
        bytes[at..at + 4].copy_from_slice(&value);
        let copy = bytes.clone();
        let bytes = sealed(bytes, |h| {
            for s in &mut h.sections[2..] {
                s.crc = crc32c::crc32c(&copy[s.offset as usize..][..s.bytes as usize]);
            }
        });
        // Not every number has a rule, but what passes can be walked.
        if let Ok(scene) = parse(&bytes) {
            let summary = crate::format::summary(&scene.skeleton);
            prop_assert!(summary.depth <= crate::format::check::MAX_DEPTH);
            let cells = &scene.skeleton.view_cells;
            let cubes: usize = cells.iter().map(|c| scene.skeleton.cubes_of(c).len()).sum();
            prop_assert_eq!(cubes as u64, summary.far_fields.cubes);
        }
    }
}

/// The fixture, written once for the many cases.
fn fixture_bytes() -> Vec<u8> {
    static BYTES: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    BYTES.get_or_init(fixture::bytes).clone()
}
