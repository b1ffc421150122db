//! Base colour pictures: decoded, reduced to a square power of two in linear light, or to one colour.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::io::Cursor;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits, RgbaImage};
use rayon::prelude::*;

/// The widest and highest picture that is decoded, in pixels.
const MAX_SIDE: u32 = 16_384;
/// The most memory one picture may take while it is decoded, in bytes.
const MAX_DECODE_BYTES: u64 = 512 << 20;

/// What a picture comes to.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Picture {
    /// All texels are the same: linear RGBA in 0..=1.
    Plain([f64; 4]),
    /// A square.
    Square(Square),
}

/// A picture as a texture holds it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Square {
    /// Pixels along each side: a power of two.
    pub(super) side: u32,
    /// sRGB-encoded RGBA, top row first.
    pub(super) rgba: Vec<u8>,
    /// Whether alpha is 255 everywhere.
    pub(super) is_opaque: bool,
    /// The mean of all texels: linear RGBA in 0..=1, weighted by alpha where that means something.
    pub(super) mean: [f64; 4],
}

/// Decodes a picture of any format that is read; what is wrong with it otherwise.
pub(super) fn decode(bytes: &[u8]) -> Result<DynamicImage, String> {
    let mut reader = reader(bytes)?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_DECODE_BYTES);
    reader.limits(limits);
    let pixels = reader.decode().map_err(|error| error.to_string())?;
    let has_none = pixels.width() == 0 || pixels.height() == 0;
    if has_none { Err("it has no pixels".to_owned()) } else { Ok(pixels) }
}

/// Bytes of memory that decoding takes, as far as the picture's header tells.
pub(super) fn decode_bytes(bytes: &[u8]) -> u64 {
    // Some decoders hold the whole picture in a form of their own, too.
    texel_bytes(bytes).unwrap_or(0).saturating_mul(2)
}

/// Why a picture is too large for so much memory, if it is; what to do stands in [`FIX_TOO_LARGE`].
pub(super) fn too_large(bytes: &[u8], memory: u64) -> Option<String> {
    const MIB: u64 = 1 << 20;
    let needed = texel_bytes(bytes).filter(|&needed| needed > memory)?.div_ceil(MIB);
    Some(format!("it takes {needed} MiB to decode it, and the memory is {} MiB", memory / MIB))
}

/// What to do about a picture that is too large.
pub(super) const FIX_TOO_LARGE: &str = "raise --memory, or reduce the picture";

/// Bytes of the texels as they are decoded; `None` of what is not decoded at all.
fn texel_bytes(bytes: &[u8]) -> Option<u64> {
    let decoder = reader(bytes).ok()?.into_decoder().ok()?;
    let (width, height) = decoder.dimensions();
    let bytes = decoder.total_bytes();
    (width.max(height) <= MAX_SIDE && bytes <= MAX_DECODE_BYTES).then_some(bytes)
}

fn reader(bytes: &[u8]) -> Result<ImageReader<Cursor<&[u8]>>, String> {
    if let Some((_, name)) = UNREAD.iter().find(|(start, _)| bytes.starts_with(start)) {
        return Err(format!("it is {name}, which is not read: convert it to PNG"));
    }
    let mut reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|error| error.to_string())?;
    if reader.format().is_none() && is_tga(bytes) {
        reader.set_format(ImageFormat::Tga);
    }
    Ok(reader)
}

/// Formats that are known and not read, by their first bytes.
const UNREAD: [(&[u8], &str); 6] = [
    (b"\xABKTX 20\xBB", "KTX2"),
    (b"\xABKTX 11\xBB", "KTX"),
    (b"sB\x13\0", "Basis Universal"),
    (b"DDS ", "DDS"),
    (b"\0\0\0\x1cftypavif", "AVIF"),
    (b"\0\0\0 ftypavif", "AVIF"),
];

/// Whether bytes begin like a TGA, which has no mark of its own: by the fields whose values are few.
fn is_tga(bytes: &[u8]) -> bool {
    let Some(&[_, palette, kind, _, _, _, _, _, _, _, _, _, w0, w1, h0, h1, depth, _]) =
        bytes.first_chunk()
    else {
        return false;
    };
    let has_palette = matches!(kind, 1 | 9);
    let is_kind = has_palette || matches!(kind, 2 | 3 | 10 | 11);
    let has_pixels = [w0, w1] != [0, 0] && [h0, h1] != [0, 0];
    is_kind
        && (palette == 1 || palette == 0 && !has_palette)
        && matches!(depth, 8 | 15 | 16 | 24 | 32)
        && has_pixels
}

/// A picture that is read row by row, so that it need not be there as RGBA as a whole.
pub(super) trait Texels: Sync {
    /// Width and height.
    fn size(&self) -> [u32; 2];
    /// A row, sRGB-encoded RGBA.
    fn row(&self, row: u32) -> Cow<'_, [[u8; 4]]>;
}

impl Texels for RgbaImage {
    fn size(&self) -> [u32; 2] {
        [self.width(), self.height()]
    }

    fn row(&self, row: u32) -> Cow<'_, [[u8; 4]]> {
        let width = self.width() as usize;
        Cow::Borrowed(&self.as_raw().as_chunks::<4>().0[row as usize * width..][..width])
    }
}

impl Texels for DynamicImage {
    fn size(&self) -> [u32; 2] {
        [self.width(), self.height()]
    }

    fn row(&self, row: u32) -> Cow<'_, [[u8; 4]]> {
        let width = self.width();
        Cow::Owned(match self {
            Self::ImageRgba8(pixels) => return pixels.row(row),
            Self::ImageRgb8(pixels) => {
                let texels = pixels.as_raw().as_chunks::<3>().0;
                let row = &texels[row as usize * width as usize..][..width as usize];
                row.iter().map(|&[r, g, b]| [r, g, b, 255]).collect()
            }
            other => {
                let row = other.crop_imm(0, row, width, 1).into_rgba8();
                row.pixels().map(|texel| texel.0).collect()
            }
        })
    }
}

/// Reduces a picture to one colour, or to a square whose side is at most `largest`, a power of two.
///
/// Where alpha has a meaning (`uses_alpha`) a texel's colour counts by its alpha, so that what cannot
/// be seen does not tint what can; elsewhere alpha becomes 255.
pub(super) fn reduce(pixels: &impl Texels, uses_alpha: bool, largest: u32) -> Picture {
    let visible = |texel: &[u8; 4]| match uses_alpha {
        true => *texel,
        false => [texel[0], texel[1], texel[2], 255],
    };
    let [width, height] = pixels.size();
    let first = visible(&pixels.row(0)[0]);
    if (0..height).all(|row| pixels.row(row).iter().all(|texel| visible(texel) == first)) {
        return Picture::Plain(linear(first));
    }
    let side = side(width, height).min(largest);
    let (rgba, mean) = resample(pixels, uses_alpha, side);
    let is_opaque = rgba.as_chunks::<4>().0.iter().all(|texel| texel[3] == 255);
    Picture::Square(Square { side, rgba, is_opaque, mean })
}

/// The power of two nearest to the side of a square of the same area.
fn side(width: u32, height: u32) -> u32 {
    let area = u64::from(width) * u64::from(height);
    let mut side = 1u64;
    // The next power is nearer from 1.5 times this one on.
    while 9 * side * side <= 4 * area {
        side *= 2;
    }
    side as u32
}

/// The alpha that one without any counts by: too little to tint what is seen, enough to keep the colour
/// of what is not, which a renderer's filter mixes into its neighbours.
const UNSEEN: f32 = 1.0 / 65_536.0;
/// A picture whose mean alpha is no more than this has none anywhere.
pub(super) const UNSEEN_MEAN: f64 = 1.01 * UNSEEN as f64;

/// Texels that make one of the result along one axis: the first, and the weight of each.
type Taps = Vec<(usize, Vec<f32>)>;

/// A tent as wide as a texel of the coarser of both grids, cut off at the picture's edge.
fn taps(from: u32, to: u32) -> Taps {
    let scale = f64::from(from) / f64::from(to);
    let reach = scale.max(1.0);
    let tap = |place: u32| {
        let center = (f64::from(place) + 0.5) * scale - 0.5;
        let first = (center - reach).ceil().max(0.0);
        let last = (center + reach).floor().min(f64::from(from - 1));
        let weight = |texel: u32| 1.0 - (f64::from(texel) - center).abs() / reach;
        let weights: Vec<f64> = (first as u32..=last as u32).map(weight).collect();
        let sum: f64 = weights.iter().sum();
        (first as usize, weights.iter().map(|weight| (weight / sum) as f32).collect())
    };
    (0..to).map(tap).collect()
}

/// The picture at another size, and the mean of all its texels.
fn resample(pixels: &impl Texels, uses_alpha: bool, side: u32) -> (Vec<u8>, [f64; 4]) {
    let [width, height] = pixels.size();
    let light: Vec<f32> = (0..=255u8).map(|value| linear_from_srgb(value) as f32).collect();
    // Colours times alpha, beside alpha: sums of these are what is seen of many texels together.
    let premultiplied = |texel: &[u8; 4]| -> [f32; 4] {
        let alpha = if uses_alpha { (f32::from(texel[3]) / 255.0).max(UNSEEN) } else { 1.0 };
        let [r, g, b] = [0, 1, 2].map(|lane| light[usize::from(texel[lane])] * alpha);
        [r, g, b, alpha]
    };
    let columns = taps(width, side);
    let rows = taps(height, side);
    let encode = Encoder::new();
    let mut out = Vec::with_capacity(4 * side as usize * side as usize);
    let mut total = [0f64; 4];
    // Source rows at the width of the result; only those that the present row needs are held.
    let mut held: VecDeque<Vec<[f32; 4]>> = VecDeque::new();
    let mut first_held = 0;
    for (first, weights) in &rows {
        while first_held < *first {
            if held.pop_front().is_none() {
                break;
            }
            first_held += 1;
        }
        first_held = *first;
        // A large picture is reduced alone, so its rows are shared out.
        let missing = first_held + held.len()..first_held + weights.len();
        let reduced = missing.into_par_iter().map(|row| {
            let row: Vec<[f32; 4]> = pixels.row(row as u32).iter().map(premultiplied).collect();
            columns.iter().map(|(at, w)| mixed(row[*at..].iter(), w)).collect()
        });
        held.extend(reduced.collect::<Vec<Vec<[f32; 4]>>>());
        for column in 0..side as usize {
            let texel = mixed(held.iter().map(|row| &row[column]), weights);
            total.iter_mut().zip(texel).for_each(|(sum, lane)| *sum += f64::from(lane));
            let alpha = texel[3];
            out.extend([0, 1, 2].map(|lane| encode.srgb(texel[lane] / alpha)));
            out.push((alpha * 255.0).round() as u8);
        }
    }
    let count = f64::from(side) * f64::from(side);
    let [r, g, b, alpha] = total.map(|sum| sum / count);
    (out, [r / alpha, g / alpha, b / alpha, alpha.min(1.0)])
}

fn mixed<'a>(texels: impl Iterator<Item = &'a [f32; 4]>, weights: &[f32]) -> [f32; 4] {
    texels.zip(weights).fold([0.0; 4], |mut sum, (texel, weight)| {
        sum.iter_mut().zip(texel).for_each(|(sum, lane)| *sum += lane * weight);
        sum
    })
}

/// From linear light to 8 bits, the same on every machine: by comparison with what lies between two
/// stored values.
struct Encoder([f32; 255]);

impl Encoder {
    fn new() -> Self {
        Self(std::array::from_fn(|value| linear_of((value as f64 + 0.5) / 255.0) as f32))
    }

    fn srgb(&self, light: f32) -> u8 {
        self.0.partition_point(|&border| border <= light) as u8
    }
}

/// Linear RGBA in 0..=1 of one sRGB-encoded texel.
fn linear([r, g, b, alpha]: [u8; 4]) -> [f64; 4] {
    let [r, g, b] = [r, g, b].map(linear_from_srgb);
    [r, g, b, f64::from(alpha) / 255.0]
}

/// Linear light of a stored value.
pub(super) fn linear_from_srgb(value: u8) -> f64 {
    linear_of(f64::from(value) / 255.0)
}

/// IEC 61966-2-1.
pub(super) fn linear_of(value: f64) -> f64 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png(pixels: &RgbaImage) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        pixels.write_to(&mut out, ImageFormat::Png).unwrap();
        out.into_inner()
    }

    fn image(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> RgbaImage {
        RgbaImage::from_fn(width, height, |x, y| image::Rgba(texel(x, y)))
    }

    fn square(picture: Picture) -> Square {
        match picture {
            Picture::Square(square) => square,
            Picture::Plain(color) => panic!("plain {color:?}"),
        }
    }

    fn checker(x: u32, y: u32) -> [u8; 4] {
        let value = 255 * ((x + y) % 2) as u8;
        [value, value, value, 255]
    }

    #[test]
    fn bytes_that_are_no_picture_are_a_reason_not_a_panic() {
        assert!(decode(b"").is_err());
        assert!(decode(b"\x89PNG\r\n\x1a\n").is_err());
        let whole = png(&image(2, 1, checker));
        for end in 0..whole.len() - 12 {
            assert!(decode(&whole[..end]).is_err(), "cut at {end}");
        }
    }

    #[test]
    fn every_format_is_known_by_its_bytes_and_keeps_its_texels() {
        let texel = |x, y| [(x * 60) as u8, (y * 80) as u8, 7, 255];
        let pixels = image(4, 3, texel);
        for format in [
            ImageFormat::Png,
            ImageFormat::Bmp,
            ImageFormat::Tga,
            ImageFormat::Tiff,
            ImageFormat::WebP,
        ] {
            let mut out = Cursor::new(Vec::new());
            pixels.write_to(&mut out, format).unwrap();
            let bytes = out.into_inner();
            let found = decode(&bytes).unwrap();
            assert_eq!(found.size(), [4, 3], "{format:?}");
            for (row, expected) in (0..3).map(|row| (found.row(row), pixels.row(row))) {
                assert_eq!(row, expected, "{format:?}");
            }
            assert_eq!(decode_bytes(&bytes), 2 * 4 * 12, "{format:?}");
            for end in 0..bytes.len() / 2 {
                assert!(decode(&bytes[..end]).is_err(), "{format:?} cut at {end}");
            }
        }
        let large = png(&image(1024, 1, checker));
        assert_eq!(too_large(&large, 4096), None);
        assert!(too_large(&large, 4095).unwrap().contains("takes 1 MiB"));
        let error = decode(b"\xABKTX 20\xBB\r\n\x1A\n").unwrap_err();
        assert!(error.contains("it is KTX2"), "{error}");
    }

    #[test]
    fn rows_are_those_of_the_whole_picture_whatever_its_texels() {
        let whole = image(5, 4, |x, y| [(x * 50) as u8, (y * 60) as u8, 9, (40 * (x + y)) as u8]);
        let whole = DynamicImage::from(whole);
        for pixels in [
            DynamicImage::from(whole.to_luma16()),
            DynamicImage::from(whole.to_luma_alpha8()),
            DynamicImage::from(whole.to_rgb8()),
            DynamicImage::from(whole.to_rgba16()),
            whole,
        ] {
            let rgba = pixels.to_rgba8();
            assert!((0..4).all(|row| pixels.row(row) == rgba.row(row)), "{:?}", pixels.color());
            assert_eq!(reduce(&pixels, true, 4), reduce(&rgba, true, 4));
        }
    }

    #[test]
    fn a_picture_too_large_to_decode_is_refused_before_it_is_allocated() {
        let mut huge = png(&image(1, 1, checker));
        // Width and height of the header chunk; its checksum is then wrong as well, so this holds
        // only together with the time it takes: none.
        huge[16..24].copy_from_slice(&[0x7F, 0xFF, 0xFF, 0xFF, 0x7F, 0xFF, 0xFF, 0xFF]);
        assert!(decode(&huge).is_err());
    }

    #[test]
    fn one_colour_is_no_texture_whatever_its_size() {
        let red = |alpha| move |_, _| [255, 0, 0, alpha];
        assert_eq!(reduce(&image(1, 1, red(255)), true, 64), Picture::Plain([1.0, 0.0, 0.0, 1.0]));
        assert_eq!(reduce(&image(5, 3, red(51)), true, 64), Picture::Plain([1.0, 0.0, 0.0, 0.2]));
        assert_eq!(reduce(&image(5, 3, red(51)), false, 64), Picture::Plain([1.0, 0.0, 0.0, 1.0]));
        // Equal colours under an alpha that means nothing.
        let faded = image(4, 4, |x, _| [9, 9, 9, x as u8]);
        assert!(matches!(reduce(&faded, false, 64), Picture::Plain(_)));
        assert!(matches!(reduce(&faded, true, 64), Picture::Square(_)));
    }

    #[test]
    fn sides_are_the_nearest_powers_of_two() {
        for (width, height, expected) in [
            (1, 1, 1),
            (1, 3, 2),
            (2, 2, 2),
            (3, 3, 4),
            (5, 5, 4),
            (6, 6, 8),
            (1024, 512, 512),
            (1024, 600, 1024),
            (16_384, 16_384, 16_384),
            (16_384, 1, 128),
        ] {
            assert_eq!(side(width, height), expected, "{width} x {height}");
        }
    }

    #[test]
    fn a_picture_of_the_right_size_is_kept_byte_for_byte() {
        let pixels = image(16, 16, |x, y| [(x * 16) as u8, (y * 16) as u8, 7, 255]);
        let kept = square(reduce(&pixels, true, 16));
        assert_eq!((kept.side, kept.is_opaque), (16, true));
        assert_eq!(&kept.rgba, pixels.as_raw());
    }

    #[test]
    fn light_is_averaged_not_stored_values() {
        // Half the light is 188 in sRGB, not 128.
        let half = square(reduce(
            &image(64, 64, |x, y| if x == 0 && y == 0 { [0; 4] } else { checker(x, y) }),
            false,
            8,
        ));
        assert!(
            half.rgba.as_chunks::<4>().0[36..]
                .iter()
                .all(|t| t[0].abs_diff(188) <= 1 && t[3] == 255)
        );
        assert!((half.mean[0] - 0.5).abs() < 1e-3, "{:?}", half.mean);
    }

    #[test]
    fn unseen_texels_tint_only_where_alpha_means_nothing() {
        let leaf =
            image(64, 64, |x, y| if (x + y) % 2 == 0 { [255, 0, 0, 255] } else { [0, 0, 255, 0] });
        let seen = square(reduce(&leaf, true, 4));
        assert!(
            seen.rgba
                .as_chunks::<4>()
                .0
                .iter()
                .all(|t| t[0] == 255 && t[2] == 0 && t[3].abs_diff(128) <= 1)
        );
        assert!(!seen.is_opaque && (seen.mean[3] - 0.5).abs() < 1e-3 && seen.mean[0] > 0.999);
        let mixed = square(reduce(&leaf, false, 4));
        assert!(
            mixed
                .rgba
                .as_chunks::<4>()
                .0
                .iter()
                .all(|t| t[0].abs_diff(188) <= 1 && t[2].abs_diff(188) <= 1 && t[3] == 255)
        );
    }

    #[test]
    fn orientation_survives_in_both_directions() {
        let ramp = image(3, 40, |x, y| [(x * 100) as u8, (y * 6) as u8, 0, 255]);
        let made = square(reduce(&ramp, false, 1024));
        assert_eq!(made.side, 8);
        let at = |x: usize, y: usize| made.rgba.as_chunks::<4>().0[y * 8 + x];
        assert!(at(0, 0)[0] < 20 && at(7, 0)[0] > 180, "{:?} {:?}", at(0, 0), at(7, 0));
        assert!(at(0, 0)[1] < 40 && at(0, 7)[1] > 200);
    }

    #[test]
    fn every_stored_value_survives_decoding_and_encoding() {
        let encode = Encoder::new();
        assert!((0..=255u8).all(|value| encode.srgb(linear_from_srgb(value) as f32) == value));
    }
}
