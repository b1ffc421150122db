//! What a material lends to the triangles it covers: base colour, texture, alpha, sides (glTF 2.0,
//! sections 3.9.2, 3.9.4 and 3.9.5).

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use super::buffers::{Origin, Resources};
use super::document::{Material as Definition, TextureRef, TextureTransform, label};
use crate::import::builder::Paint;
use crate::import::emit::Emitter;
use crate::import::error::ImportError;
use crate::import::picture::{self, Picture, Square};
use crate::source::{Alpha, Surface, Texture, Wrap};

/// A surface without a material (section 3.9.6).
pub(super) const DEFAULT: Material = Material {
    paint: Paint { surface: Surface { double_sided: false, ..Surface::PLAIN }, ..Paint::PLAIN },
    mapping: None,
};

/// What a material lends.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Material {
    /// Colour and surface.
    pub(super) paint: Paint,
    /// How its texture lies, if it has one.
    pub(super) mapping: Option<Mapping>,
}

/// How a texture lies on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Mapping {
    /// `n` of the attribute `TEXCOORD_n`.
    pub(super) set: usize,
    /// Rows of the map from coordinates, extended by 1, to where the picture is looked up.
    pub(super) rows: [[f64; 3]; 2],
    /// Mean of the picture in linear light: for surfaces without coordinates.
    pub(super) mean: [f64; 4],
}

impl Mapping {
    /// Where the picture is looked up for a vertex with these coordinates.
    pub(super) fn apply(&self, [u, v]: [f32; 2]) -> [f32; 2] {
        let (u, v) = (f64::from(u), f64::from(v));
        self.rows.map(|[a, b, c]| (a * u + b * v + c) as f32)
    }
}

/// A picture as materials want it: image, whether its alpha means something, how it goes on.
type Wanted = (usize, bool, [Wrap; 2]);

/// What one material asks for, once its references are checked.
struct Request {
    number: usize,
    factor: [f64; 4],
    alpha: Alpha,
    double_sided: bool,
    wanted: Option<Wanted>,
    reference: Option<TextureRef>,
}

/// The materials in `used`, which must be numbers of the document's materials; their textures go to
/// `out`.
///
/// A texture that cannot be read or decoded leaves the factor alone and a line in `notes`; a URI
/// that leaves the scene's folder is an error.
pub(super) fn materials(
    resources: &Resources<'_>,
    used: &BTreeSet<usize>,
    out: &mut Emitter<'_>,
    notes: &mut Vec<String>,
) -> Result<BTreeMap<usize, Material>, ImportError> {
    let mut requests: Vec<Request> =
        used.iter().map(|&number| request(resources, number, notes)).collect::<Result<_, _>>()?;
    share(resources, &mut requests);
    let wanted = requests.iter().filter_map(|request| request.wanted).collect();
    let pictures = pictures(resources, wanted, out, notes)?;
    Ok(requests.iter().map(|request| (request.number, material(request, &pictures))).collect())
}

/// Lets requests for images that stand in the same place ask for the first of them.
fn share(resources: &Resources<'_>, requests: &mut [Request]) {
    let images: BTreeSet<usize> =
        requests.iter().filter_map(|request| Some(request.wanted?.0)).collect();
    let mut by_origin: BTreeMap<Origin<'_>, usize> = BTreeMap::new();
    let mut first: BTreeMap<usize, usize> = BTreeMap::new();
    for image in images {
        let same = resources.origin(image).map(|origin| *by_origin.entry(origin).or_insert(image));
        first.insert(image, same.unwrap_or(image));
    }
    for (image, ..) in requests.iter_mut().filter_map(|request| request.wanted.as_mut()) {
        *image = first[image];
    }
}

fn material(request: &Request, pictures: &BTreeMap<Wanted, Had>) -> Material {
    let had = request.wanted.and_then(|wanted| pictures.get(&wanted));
    let mut color = request.factor.map(|lane| lane.clamp(0.0, 1.0));
    let (mut texture, mut texture_is_opaque, mut mapping) = (None, true, None);
    match had {
        None => {}
        Some(Had::Plain(plain)) => {
            color.iter_mut().zip(plain).for_each(|(lane, plain)| *lane *= plain);
        }
        Some(&Had::Texture { number, is_opaque, mean }) => {
            (texture, texture_is_opaque) = (Some(number), is_opaque);
            mapping = request.reference.map(|reference| mapping_of(&reference, mean));
        }
    }
    if request.alpha == Alpha::Opaque {
        color[3] = 1.0;
    }
    let surface = Surface { alpha: request.alpha, double_sided: request.double_sided, texture };
    Material { paint: Paint { color, surface, texture_is_opaque }, mapping }
}

/// Translation after rotation after scale (KHR_texture_transform); the rotation is counter-clockwise
/// as seen on the picture, whose second coordinate points down.
fn mapping_of(reference: &TextureRef, mean: [f64; 4]) -> Mapping {
    let transform = reference.extensions.transform.unwrap_or_default();
    let TextureTransform { offset, rotation, scale, tex_coord } = transform;
    let ([x, y], [width, height]) = (offset.unwrap_or_default(), scale.unwrap_or([1.0; 2]));
    let (sin, cos) = rotation.sin_cos();
    Mapping {
        set: tex_coord.unwrap_or(reference.tex_coord),
        rows: [[cos * width, sin * height, x], [-sin * width, cos * height, y]],
        mean,
    }
}

fn request(
    resources: &Resources<'_>,
    number: usize,
    notes: &mut Vec<String>,
) -> Result<Request, ImportError> {
    let material = &resources.document.materials[number];
    let at = label("material", number, material.name.as_ref());
    let alpha = match material.alpha_mode.as_deref() {
        Some("MASK") => Alpha::Mask(cutoff(material)),
        Some("BLEND") => Alpha::Blend,
        _ => Alpha::Opaque,
    };
    let (factor, reference) = base_color(material);
    let mut wanted = None;
    if let Some(TextureRef { index, .. }) = reference {
        let (image, wrap) = texture(resources, &at, index)?;
        let basisu = &resources.document.textures[index].extensions.basisu;
        match (image, basisu.source) {
            (Some(image), _) => wanted = Some((image, alpha != Alpha::Opaque, wrap)),
            (None, Some(_)) => notes.push(format!(
                "{at}: texture {index} has a KTX2 image alone, which is not read (npx \
                 @gltf-transform/cli ktxdecompress IN.glb OUT.glb converts it), its factor alone \
                 is used"
            )),
            (None, None) => notes.push(format!(
                "{at}: texture {index} has no image of a format that is read, its factor alone is used"
            )),
        }
    }
    Ok(Request {
        number,
        factor: factor.unwrap_or([1.0; 4]),
        alpha,
        double_sided: material.double_sided,
        wanted,
        reference,
    })
}

/// A number, whatever the file says.
fn cutoff(material: &Definition) -> f32 {
    material.alpha_cutoff.filter(|cutoff| cutoff.is_finite()).unwrap_or(0.5)
}

/// Factor and texture of the base colour; the diffuse ones of the older specular-glossiness
/// workflow take their place where a material has that extension.
fn base_color(material: &Definition) -> (Option<[f64; 4]>, Option<TextureRef>) {
    let pbr = &material.pbr_metallic_roughness;
    match &material.extensions.specular_glossiness {
        Some(diffuse) => (diffuse.diffuse_factor, diffuse.diffuse_texture),
        None => (pbr.base_color_factor, pbr.base_color_texture),
    }
}

/// Image and wrap modes of a texture; `at` names who asks.
fn texture(
    resources: &Resources<'_>,
    at: &str,
    index: usize,
) -> Result<(Option<usize>, [Wrap; 2]), ImportError> {
    let document = resources.document;
    let beyond = |what: String| resources.broken(at, what);
    let texture = document.textures.get(index).ok_or_else(|| {
        beyond(format!("it refers to texture {index} of {}", document.textures.len()))
    })?;
    // The plain source is for programs that cannot read WebP.
    let source = texture.extensions.webp.source.or(texture.source);
    if let Some(image) = source.filter(|&image| image >= document.images.len()) {
        let images = document.images.len();
        return Err(beyond(format!("its texture {index} refers to image {image} of {images}")));
    }
    let wrap = match texture.sampler {
        None => [Wrap::Repeat; 2],
        Some(number) => {
            let sampler = document.samplers.get(number).ok_or_else(|| {
                let samplers = document.samplers.len();
                beyond(format!("its texture {index} refers to sampler {number} of {samplers}"))
            })?;
            [sampler.wrap_s, sampler.wrap_t].map(|mode| match mode {
                Some(33071) => Wrap::Clamp,
                Some(33648) => Wrap::Mirror,
                _ => Wrap::Repeat,
            })
        }
    };
    Ok((source, wrap))
}

/// A picture that was to be had.
enum Had {
    /// It has one colour, in linear light.
    Plain([f64; 4]),
    /// It is a texture.
    Texture { number: u32, is_opaque: bool, mean: [f64; 4] },
}

/// Hands out the `wanted` pictures; one that cannot be had is left out.
fn pictures(
    resources: &Resources<'_>,
    wanted: BTreeSet<Wanted>,
    out: &mut Emitter<'_>,
    notes: &mut Vec<String>,
) -> Result<BTreeMap<Wanted, Had>, ImportError> {
    let mut by_image: BTreeMap<usize, BTreeSet<bool>> = BTreeMap::new();
    for &(image, uses_alpha, _) in &wanted {
        by_image.entry(image).or_default().insert(uses_alpha);
    }
    let largest = out.limits.texture_side;
    let memory = out.limits.memory;
    let mut all = BTreeMap::new();
    let encoded = |(image, uses)| encoded(resources, image, uses, memory);
    let mut waiting = by_image.into_iter().map(encoded).peekable();
    while waiting.peek().is_some() {
        // As many at once as there are threads and as the memory holds, but one at least.
        let (mut few, mut bytes) = (Vec::new(), 0u64);
        while let Some(next) = waiting.peek().filter(|_| few.len() < rayon::current_num_threads()) {
            bytes = bytes.saturating_add(next.as_ref().map_or(0, Encoded::decode_bytes));
            if bytes > memory && !few.is_empty() {
                break;
            }
            few.extend(waiting.next());
        }
        let reduced: Vec<_> = few
            .into_par_iter()
            .map(|encoded| encoded.map(|encoded| encoded.reduced(resources, largest)))
            .collect();
        for reduced in reduced {
            let Reduced { image, name, pictures } = match reduced? {
                Ok(reduced) => reduced,
                Err(note) => {
                    notes.push(note);
                    continue;
                }
            };
            let beside = (image, false, [Wrap::Repeat; 2])..=(image, true, [Wrap::Mirror; 2]);
            // Textures of this import that show the same texels in the same way.
            let mut made: BTreeMap<(bool, [Wrap; 2]), u32> = BTreeMap::new();
            for &key in wanted.range(beside) {
                let (_, uses_alpha, wrap) = key;
                let had = match &pictures[&uses_alpha] {
                    Picture::Plain(color) => Had::Plain(*color),
                    Picture::Square(Square { side, rgba, is_opaque, mean }) => {
                        // Alpha that is 1 everywhere has no use.
                        let shared = (uses_alpha && !is_opaque, wrap);
                        let number = match made.get(&shared) {
                            Some(&number) => number,
                            None => {
                                let (name, rgba) = (name.clone(), rgba.clone());
                                out.texture(Texture { name, side: *side, rgba, wrap })?
                            }
                        };
                        made.insert(shared, number);
                        Had::Texture { number, is_opaque: *is_opaque, mean: *mean }
                    }
                };
                all.insert(key, had);
            }
        }
    }
    Ok(all)
}

/// One image that is to be decoded, for these uses of its alpha.
struct Encoded {
    image: usize,
    uses: BTreeSet<bool>,
    /// What messages call it.
    at: String,
    /// Why it cannot be had, if it cannot: the scene can do without.
    bytes: Result<Vec<u8>, String>,
}

/// One image, reduced for each use of its alpha.
struct Reduced {
    image: usize,
    name: String,
    pictures: BTreeMap<bool, Picture>,
}

fn encoded(
    resources: &Resources<'_>,
    image: usize,
    uses: BTreeSet<bool>,
    memory: u64,
) -> Result<Encoded, ImportError> {
    let at = resources.image_label(image);
    let bytes = match resources.image(image) {
        Ok(bytes) => Ok(bytes),
        Err(ImportError::MissingResource { uri, .. }) => Err(format!("{uri:?} is missing")),
        Err(ImportError::DataUri { what, .. }) => Err(format!("its data URI {what}")),
        Err(error) => return Err(error),
    };
    if let Some(what) = bytes.as_ref().ok().and_then(|bytes| picture::too_large(bytes, memory)) {
        return Err(resources.invalid(at, what, picture::FIX_TOO_LARGE));
    }
    Ok(Encoded { image, uses, at, bytes })
}

impl Encoded {
    /// Bytes of memory that it takes to decode it.
    fn decode_bytes(&self) -> u64 {
        self.bytes.as_ref().map_or(0, |bytes| bytes.len() as u64 + picture::decode_bytes(bytes))
    }

    /// The error is a note.
    fn reduced(self, resources: &Resources<'_>, largest: u32) -> Result<Reduced, String> {
        let Self { image, uses, at, bytes } = self;
        let bytes = bytes.map_err(|why| format!("{at}: {why}, its factor alone is used"))?;
        let pixels = picture::decode(&bytes)
            .map_err(|why| format!("{at} cannot be decoded ({why}), its factor alone is used"))?;
        drop(bytes);
        let made = |uses_alpha| (uses_alpha, picture::reduce(&pixels, uses_alpha, largest));
        let name = resources.document.images[image].name.clone();
        let name = name.unwrap_or_else(|| format!("image {image}"));
        Ok(Reduced { image, name, pictures: uses.into_iter().map(made).collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reference(transform: Option<TextureTransform>) -> TextureRef {
        let extensions = super::super::document::TextureRefExtensions { transform };
        TextureRef { index: 0, tex_coord: 1, extensions }
    }

    #[test]
    fn without_a_transform_coordinates_stay() {
        let mapping = mapping_of(&reference(None), [1.0; 4]);
        assert_eq!((mapping.set, mapping.apply([0.25, -3.0])), (1, [0.25, -3.0]));
    }

    #[test]
    fn a_transform_scales_then_turns_then_moves_and_may_name_another_set() {
        let transform = TextureTransform {
            offset: Some([10.0, 20.0]),
            rotation: std::f64::consts::FRAC_PI_2,
            scale: Some([2.0, 3.0]),
            tex_coord: Some(4),
        };
        let mapping = mapping_of(&reference(Some(transform)), [1.0; 4]);
        assert_eq!(mapping.set, 4);
        // The matrix of the extension's text, for the column (u, v, 1).
        assert_eq!(mapping.apply([1.0, 0.0]), [10.0, 18.0]);
        assert_eq!(mapping.apply([0.0, 1.0]), [13.0, 20.0]);
    }
}
