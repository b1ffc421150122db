//! The one colour a material lends to a surface: its base colour factor times the mean of its base
//! colour texture.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;

use image::{ImageReader, Limits};
use rayon::prelude::*;

use super::buffers::Resources;
use super::document::{Material, TextureRef, label};
use super::error::ImportError;

/// The widest and highest texture that is decoded, in pixels.
const MAX_TEXTURE_SIDE: u32 = 16_384;
/// The most memory one texture may take while it is decoded, in bytes.
const MAX_DECODE_BYTES: u64 = 512 << 20;

/// What a material lends to every vertex it covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Surface {
    /// Linear RGBA in 0..=1.
    pub(super) color: [f64; 4],
    /// Alpha means nothing here (glTF 2.0, section 3.9.4): `color` has 1, and that of vertices is
    /// to be ignored.
    pub(super) opaque: bool,
}

/// A surface without a material (section 3.9.6).
pub(super) const PLAIN: Surface = Surface { color: [1.0; 4], opaque: true };

/// What one material asks for, once its references are checked.
struct Request {
    material: usize,
    factor: [f64; 4],
    image: Option<usize>,
    opaque: bool,
}

/// The surfaces of the materials in `used`, which must be numbers of the document's materials.
///
/// A texture that cannot be read or decoded leaves the factor alone and a line in `notes`; a URI
/// that leaves the scene's folder is an error.
pub(super) fn surfaces(
    resources: &Resources<'_>,
    used: &BTreeSet<usize>,
    notes: &mut Vec<String>,
) -> Result<BTreeMap<usize, Surface>, ImportError> {
    let requests: Vec<Request> = used
        .iter()
        .map(|&material| request(resources, material, notes))
        .collect::<Result<_, _>>()?;
    // A texture's mean depends on whether alpha weighs its texels, so it may be wanted both ways.
    let wanted: BTreeSet<(usize, bool)> =
        requests.iter().filter_map(|request| Some((request.image?, request.opaque))).collect();
    let means = means(resources, wanted, notes)?;
    let surface = |request: &Request| {
        let mean = request
            .image
            .and_then(|image| means.get(&(image, request.opaque)))
            .unwrap_or(&[1.0; 4]);
        let mut color: [f64; 4] =
            std::array::from_fn(|lane| request.factor[lane].clamp(0.0, 1.0) * mean[lane]);
        if request.opaque {
            color[3] = 1.0;
        }
        (request.material, Surface { color, opaque: request.opaque })
    };
    Ok(requests.iter().map(surface).collect())
}

fn request(
    resources: &Resources<'_>,
    number: usize,
    notes: &mut Vec<String>,
) -> Result<Request, ImportError> {
    let document = resources.document;
    let material = &document.materials[number];
    let at = label("material", number, material.name.as_ref());
    let (factor, texture) = base_color(material);
    let mut image = None;
    if let Some(TextureRef { index }) = texture {
        let texture = document.textures.get(index).ok_or_else(|| {
            resources
                .broken(&at, format!("it refers to texture {index} of {}", document.textures.len()))
        })?;
        image = texture.source;
        match image {
            Some(source) if source >= document.images.len() => {
                let what = format!(
                    "its texture {index} refers to image {source} of {}",
                    document.images.len()
                );
                return Err(resources.broken(&at, what));
            }
            Some(_) => {}
            None => notes.push(format!(
                "{at}: texture {index} has no PNG or JPEG image, its factor alone is used"
            )),
        }
    }
    let opaque = matches!(material.alpha_mode.as_deref(), None | Some("OPAQUE"));
    Ok(Request { material: number, factor: factor.unwrap_or([1.0; 4]), image, opaque })
}

/// Factor and texture of the base colour; the diffuse ones of the older specular-glossiness
/// workflow take their place where a material has that extension.
fn base_color(material: &Material) -> (Option<[f64; 4]>, Option<TextureRef>) {
    let pbr = &material.pbr_metallic_roughness;
    match &material.extensions.specular_glossiness {
        Some(diffuse) => (diffuse.diffuse_factor, diffuse.diffuse_texture),
        None => (pbr.base_color_factor, pbr.base_color_texture),
    }
}

/// Means of the `wanted` images, keyed as they are wanted; an image that cannot be had is left out.
fn means(
    resources: &Resources<'_>,
    wanted: BTreeSet<(usize, bool)>,
    notes: &mut Vec<String>,
) -> Result<BTreeMap<(usize, bool), [f64; 4]>, ImportError> {
    let wanted: Vec<(usize, bool)> = wanted.into_iter().collect();
    let decoded: Vec<Result<Result<[f64; 4], String>, ImportError>> = wanted
        .par_iter()
        .map(|&(image, opaque)| match resources.image(image) {
            Ok((bytes, at)) => Ok(mean(&bytes, opaque).map_err(|why| {
                format!("{at} cannot be decoded ({why}), its factor alone is used")
            })),
            Err(ImportError::MissingResource { at, uri, .. }) => {
                Ok(Err(format!("{at}: {uri:?} is missing, its factor alone is used")))
            }
            Err(error) => Err(error),
        })
        .collect();
    let mut means = BTreeMap::new();
    for (key, result) in wanted.into_iter().zip(decoded) {
        match result? {
            Ok(mean) => drop(means.insert(key, mean)),
            Err(note) => notes.push(note),
        }
    }
    Ok(means)
}

/// Mean of a PNG or JPEG in linear light, RGBA in 0..=1.
///
/// Where alpha has a meaning (`opaque` is false) a texel's colour counts by its alpha: what cannot
/// be seen does not tint the surface.
fn mean(bytes: &[u8], opaque: bool) -> Result<[f64; 4], String> {
    let mut reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|error| error.to_string())?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_TEXTURE_SIDE);
    limits.max_image_height = Some(MAX_TEXTURE_SIDE);
    limits.max_alloc = Some(MAX_DECODE_BYTES);
    reader.limits(limits);
    let pixels = reader.decode().map_err(|error| error.to_string())?.into_rgba8();

    // Sums of weights by stored value: exact, and the transfer function runs 256 times a channel.
    let mut histogram = [[0u64; 256]; 3];
    let mut alpha = 0u64;
    let texels = pixels.pixels().len() as u64;
    let unweighted = opaque || pixels.pixels().all(|texel| texel.0[3] == 0);
    for texel in pixels.pixels() {
        let [r, g, b, a] = texel.0;
        let weight = if unweighted { 255 } else { u64::from(a) };
        alpha += u64::from(a);
        for (channel, value) in histogram.iter_mut().zip([r, g, b]) {
            channel[usize::from(value)] += weight;
        }
    }
    let channel_mean = |channel: &[u64; 256]| {
        let sum: f64 = channel
            .iter()
            .enumerate()
            .map(|(value, &weight)| weight as f64 * linear_from_srgb(value as f64 / 255.0))
            .sum();
        sum / channel.iter().sum::<u64>() as f64
    };
    let [r, g, b] = histogram.each_ref().map(channel_mean);
    Ok([r, g, b, alpha as f64 / (255 * texels) as f64])
}

/// IEC 61966-2-1.
fn linear_from_srgb(value: f64) -> f64 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::testing::png;

    fn close(a: [f64; 4], b: [f64; 4]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9)
    }

    #[test]
    fn bytes_that_are_no_picture_are_a_reason_not_a_panic() {
        assert!(mean(b"", true).is_err());
        assert!(mean(b"\x89PNG\r\n\x1a\n", true).is_err());
        let whole = png(2, 1, &[[0, 0, 0, 255], [255, 255, 255, 255]]);
        for end in 0..whole.len() - 12 {
            assert!(mean(&whole[..end], true).is_err(), "cut at {end}");
        }
    }

    #[test]
    fn a_picture_too_large_to_decode_is_refused_before_it_is_allocated() {
        let mut huge = png(1, 1, &[[0; 4]]);
        // Width and height of the header chunk; its checksum is then wrong as well, so this holds
        // only together with the time it takes: none.
        huge[16..24].copy_from_slice(&[0x7F, 0xFF, 0xFF, 0xFF, 0x7F, 0xFF, 0xFF, 0xFF]);
        assert!(mean(&huge, true).is_err());
    }

    #[test]
    fn the_mean_is_taken_in_linear_light() {
        let checker = png(2, 1, &[[0, 0, 0, 255], [255, 255, 255, 255]]);
        assert!(close(mean(&checker, true).unwrap(), [0.5, 0.5, 0.5, 1.0]));
    }

    #[test]
    fn unseen_texels_count_only_where_alpha_means_nothing() {
        let leaf = png(2, 1, &[[255, 0, 0, 255], [0, 0, 255, 0]]);
        assert!(close(mean(&leaf, true).unwrap(), [0.5, 0.0, 0.5, 0.5]));
        assert!(close(mean(&leaf, false).unwrap(), [1.0, 0.0, 0.0, 0.5]));
        let unseen = png(1, 1, &[[255, 0, 0, 0]]);
        assert!(close(mean(&unseen, false).unwrap(), [1.0, 0.0, 0.0, 0.0]));
    }
}
