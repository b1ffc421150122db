//! How textures are stored, as far as backends agree on it: their largest mips left out, the rest side by
//! side on square pages, and so the room that they take.

use super::BackendError;
use protocol::format::{Texture, Wrap, texture};

/// Most pixels along a side of what a backend stores; larger mips are left out.
pub const LARGEST_STORED_SIDE: u32 = 1024;
/// Pages are as small as the largest texture lets them be, so that little of the last is left empty, but
/// not so many as this.
const MANY_PAGES: u64 = 256;
/// Bytes beside its pixels that a texture may take: its record, and a word for each of its mips.
const RECORD_BYTES: u64 = 16 + 4 * (LARGEST_STORED_SIDE.ilog2() as u64 + 1);

/// Side and wrap modes of a texture as a backend stores it.
///
/// Errors: `Device` for a record that no texture has.
pub fn stored_shape(record: &Texture) -> Result<(u32, [Wrap; 2]), BackendError> {
    match Wrap::unpack(record.wrap) {
        Some(wrap) if texture::is_side(record.side) => {
            Ok((record.side.min(LARGEST_STORED_SIDE), wrap))
        }
        _ => Err(damaged(record)),
    }
}

/// Side, wrap modes and mips of a texture as a backend stores it. The bytes may come from anywhere.
///
/// Errors: `Device` for bytes that are no texture.
pub fn stored_mips<'a>(
    record: &Texture,
    bytes: &'a [u8],
) -> Result<(u32, [Wrap; 2], &'a [u8]), BackendError> {
    let (side, wrap) = stored_shape(record)?;
    if bytes.len() as u64 != texture::mip_bytes(record.side) {
        return Err(damaged(record));
    }
    let left_out = bytes.len() - texture::mip_bytes(side) as usize;
    Ok((side, wrap, &bytes[left_out..]))
}

fn damaged(record: &Texture) -> BackendError {
    BackendError::Device(format!("a texture of side {} is damaged", record.side))
}

/// Bytes of the mips of a texture that are stored.
pub fn stored_bytes(record: &Texture) -> u64 {
    texture::mip_bytes(record.side.min(LARGEST_STORED_SIDE))
}

/// Pixels along a side of the pages for these textures, a power of two.
pub fn page_side(textures: &[Texture]) -> u32 {
    let pixels = textures.iter().map(|texture| stored_bytes(texture) / 4).sum::<u64>();
    let largest = textures.iter().map(|texture| texture.side.min(LARGEST_STORED_SIDE)).max();
    let mut side = largest.unwrap_or(1).max(1);
    while side < LARGEST_STORED_SIDE && pixels.div_ceil(u64::from(side).pow(2)) > MANY_PAGES {
        side *= 2;
    }
    side
}

/// Bytes of the lists that stand beside the pages for these textures.
pub fn list_bytes(textures: &[Texture]) -> u64 {
    textures.len() as u64 * RECORD_BYTES
}

/// Bytes of room in which so many bytes of `textures` fit at once, whichever they are and in whatever
/// order they come into empty room: whole pages, and the lists of them all. None at all needs none.
pub fn texture_room(textures: &[Texture], stored: u64) -> u64 {
    let page = u64::from(page_side(textures)).pow(2) * 4;
    stored.div_ceil(page) * page + if stored > 0 { list_bytes(textures) } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(side: u32) -> Texture {
        let bytes = texture::mip_bytes(side);
        Texture { offset: 0, bytes, side, wrap: 0, crc: 0, reserved: 0 }
    }

    #[test]
    fn textures_beyond_the_largest_side_lose_their_largest_mips() {
        let bytes = vec![7; texture::mip_bytes(2048) as usize];
        let (side, _, mips) = stored_mips(&record(2048), &bytes).unwrap();
        assert_eq!((side, mips.len() as u64), (1024, texture::mip_bytes(1024)));
        assert_eq!(stored_bytes(&record(2048)), texture::mip_bytes(1024));
        let one = stored_mips(&record(1), &[1, 2, 3, 4]).unwrap();
        assert_eq!(one, (1, [Wrap::Repeat; 2], &[1, 2, 3, 4][..]));
        for side in [0, 2, 3, u32::MAX] {
            let record = Texture { side, ..record(1) };
            assert!(stored_mips(&record, &[1, 2, 3, 4]).is_err(), "{side}");
        }
        assert!(stored_mips(&Texture { wrap: 3, ..record(1) }, &[1, 2, 3, 4]).is_err());
    }

    #[test]
    fn room_is_whole_pages_of_a_side_that_holds_the_largest() {
        assert_eq!((page_side(&[]), texture_room(&[], 0)), (1, 0));
        assert_eq!((page_side(&[record(64); 3]), page_side(&[record(1024); 999])), (64, 1024));
        assert_eq!(page_side(&[record(64); 257]), 128);
        let two = [record(64), record(16)];
        let page = 64 * 64 * 4;
        assert_eq!(texture_room(&two, 1), page + list_bytes(&two));
        assert_eq!(texture_room(&two, page + 1), 2 * page + list_bytes(&two));
    }
}
