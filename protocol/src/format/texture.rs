//! A texture: its record in the file, how it repeats, and the making of its mips.
//!
//! A texture is a square of sRGB-encoded RGBA pixels with straight alpha, followed by all its mips:
//! side * side, side/2 * side/2, ..., 1 * 1.

use bytemuck::{Pod, Zeroable};

/// Most pixels along a side.
pub const MAX_SIDE: u32 = 4096;

/// A texture in the pixel section: 32 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Texture {
    /// First byte, from the start of the pixel section; a multiple of 64.
    pub offset: u64,
    /// Bytes of all its mips.
    pub bytes: u64,
    /// Pixels along a side of the largest: a power of two, 1..=4096.
    pub side: u32,
    /// [`Wrap::pack`] of its two directions.
    pub wrap: u32,
    /// CRC32C of the bytes.
    pub crc: u32,
    /// Zero.
    pub reserved: u32,
}

impl Texture {
    /// Whether these are the bytes that were written.
    pub fn is_made_of(&self, bytes: &[u8]) -> bool {
        bytes.len() as u64 == self.bytes && crc32c::crc32c(bytes) == self.crc
    }
}

/// What lies beyond the edge of a texture, in one direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum Wrap {
    /// The texture again.
    Repeat = 0,
    /// Its edge pixels.
    Clamp = 1,
    /// The texture again, every second time mirrored.
    Mirror = 2,
}

impl Wrap {
    const ALL: [Self; 3] = [Self::Repeat, Self::Clamp, Self::Mirror];

    /// Horizontal in bits 0..2, vertical in bits 2..4.
    pub fn pack([horizontal, vertical]: [Self; 2]) -> u32 {
        horizontal as u32 | (vertical as u32) << 2
    }

    /// The two directions; `None` where either does not exist or another bit is set.
    pub fn unpack(packed: u32) -> Option<[Self; 2]> {
        let of = |bits: u32| Self::ALL.get(bits as usize).copied();
        Some([of(packed & 3)?, of(packed >> 2)?])
    }
}

/// Whether textures may have this side.
pub fn is_side(side: u32) -> bool {
    side.is_power_of_two() && side <= MAX_SIDE
}

/// Bytes of all mips of a texture with this side.
pub fn mip_bytes(side: u32) -> u64 {
    let mut bytes = 0;
    let mut side = u64::from(side);
    while side > 0 {
        bytes += 4 * side * side;
        side /= 2;
    }
    bytes
}

/// Linear value of an sRGB code (IEC 61966-2-1).
pub fn srgb_to_linear(code: u8) -> f32 {
    decode(f64::from(code) / 255.0) as f32
}

fn decode(s: f64) -> f64 {
    if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
}

/// A pixel while mips are made: linear colour and straight alpha.
type Linear = [f32; 4];

/// The two directions of the encoding, as tables.
struct Codes {
    linear: Vec<f32>,
    /// `thresholds[k]`: the least linear value that is encoded as more than `k`.
    thresholds: Vec<f32>,
}

impl Codes {
    fn new() -> Self {
        let half = |k: u8| decode((f64::from(k) + 0.5) / 255.0) as f32;
        Self {
            linear: (0..=u8::MAX).map(srgb_to_linear).collect(),
            thresholds: (0..u8::MAX).map(half).collect(),
        }
    }

    fn decode(&self, [r, g, b, a]: [u8; 4]) -> Linear {
        let [r, g, b] = [r, g, b].map(|code| self.linear[usize::from(code)]);
        [r, g, b, f32::from(a) / 255.0]
    }

    fn encode(&self, [r, g, b, a]: Linear) -> [u8; 4] {
        let code = |linear: f32| self.thresholds.partition_point(|&t| t <= linear) as u8;
        [code(r), code(g), code(b), (a * 255.0).round() as u8]
    }
}

/// The mean of four pixels, colours weighted by their alpha, so that what cannot be seen does not
/// bleed into what can.
fn mean(four: [Linear; 4]) -> Linear {
    let alpha: f32 = four.iter().map(|p| p[3]).sum();
    let weight = |p: &Linear| if alpha > 0.0 { p[3] / alpha } else { 0.25 };
    let color = |k: usize| four.iter().map(|p| p[k] * weight(p)).sum();
    [color(0), color(1), color(2), alpha * 0.25]
}

/// All mips of a texture, the largest first: `rgba` itself, then each the box-filtered half of the one
/// before, in linear light.
///
/// # Panics
/// If `side` is no side of a texture, or `rgba` not `4 * side * side` bytes long.
pub fn mips(side: u32, rgba: &[u8]) -> Vec<u8> {
    assert!(is_side(side), "side {side}");
    assert_eq!(rgba.len() as u64, 4 * u64::from(side) * u64::from(side), "side {side}");
    let codes = Codes::new();
    let mut all = Vec::with_capacity(mip_bytes(side) as usize);
    all.extend_from_slice(rgba);
    let mut side = side as usize;
    let (pixels, _) = rgba.as_chunks::<4>();
    let mut halved = half(side, |at| codes.decode(pixels[at]));
    while side > 1 {
        side /= 2;
        all.extend(halved.iter().flat_map(|&pixel| codes.encode(pixel)));
        halved = half(side, |at| halved[at]);
    }
    all
}

/// The next smaller mip of a square of pixels; nothing of one pixel.
fn half(side: usize, pixel: impl Fn(usize) -> Linear) -> Vec<Linear> {
    let places = (0..side / 2).flat_map(|y| (0..side / 2).map(move |x| 2 * (y * side + x)));
    places.map(|at| mean([at, at + 1, at + side, at + side + 1].map(&pixel))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_pixel_is_its_own_mip() {
        assert_eq!(mips(1, &[1, 2, 3, 4]), [1, 2, 3, 4]);
        assert_eq!(mip_bytes(1), 4);
    }

    #[test]
    fn sides_and_sizes() {
        assert!([1, 2, 64, 4096].into_iter().all(is_side));
        assert!(![0, 3, 8192, u32::MAX].into_iter().any(is_side));
        assert_eq!(mip_bytes(4), 4 * (16 + 4 + 1));
        assert_eq!(mips(8, &[9; 256]).len() as u64, mip_bytes(8));
    }

    #[test]
    fn wraps_round_trip_and_others_are_refused() {
        for h in Wrap::ALL {
            for v in Wrap::ALL {
                assert_eq!(Wrap::unpack(Wrap::pack([h, v])), Some([h, v]));
            }
        }
        for wrong in [3, 12, 16, u32::MAX] {
            assert_eq!(Wrap::unpack(wrong), None);
        }
    }

    #[test]
    fn black_and_white_meet_at_half_the_light() {
        let pixels = [[0, 0, 0, 255], [255, 255, 255, 255], [255, 255, 255, 255], [0, 0, 0, 255]];
        // Half of the light is code 188, not 128.
        assert_eq!(mips(2, pixels.as_flattened())[16..], [188, 188, 188, 255]);
    }

    #[test]
    fn hidden_colours_do_not_bleed() {
        let pixels = [[200, 0, 0, 255], [0, 255, 0, 0], [0, 255, 0, 0], [0, 255, 0, 0]];
        assert_eq!(mips(2, pixels.as_flattened())[16..], [200, 0, 0, 64]);
        assert_eq!(mips(2, [[7, 8, 9, 0]; 4].as_flattened())[16..], [7, 8, 9, 0]);
    }

    #[test]
    fn rows_and_columns_keep_their_places() {
        let grey = |i: usize| [[10, 60], [120, 250]][i / 8][i % 4 / 2];
        let rgba: Vec<u8> = (0..16).flat_map(|i| [grey(i), grey(i), grey(i), 255]).collect();
        let all = mips(4, &rgba);
        let greys: Vec<u8> = all[64..80].chunks(4).map(|p| p[0]).collect();
        assert_eq!(greys, [10, 60, 120, 250]);
    }
}
