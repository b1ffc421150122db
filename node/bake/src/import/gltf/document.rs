//! The part of the glTF 2.0 JSON that a static scene needs, as plain data.
//!
//! Nothing here is checked beyond its JSON type: every index and every count is a claim, and is
//! tested where it is used. Unknown members are ignored, as the format asks.

use std::collections::BTreeMap;
use std::hash::Hash;

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::lenient::{OfWhole, Whole, name, version, whole};

/// What must be understood before the rest of the file may be.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Header {
    pub(super) asset: Asset,
    #[serde(default)]
    pub(super) extensions_required: Vec<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Asset {
    #[serde(default, deserialize_with = "version")]
    pub(super) version: Option<String>,
    #[serde(default, deserialize_with = "version")]
    pub(super) min_version: Option<String>,
}

/// A document of glTF 1.0: its lists are tables by name.
#[derive(Deserialize)]
pub(super) struct FirstVersion {
    nodes: Option<Table>,
    meshes: Option<Table>,
    scenes: Option<Table>,
    accessors: Option<Table>,
    buffers: Option<Table>,
}

type Table = BTreeMap<String, IgnoredAny>;

impl FirstVersion {
    /// Whether it has such tables at all.
    pub(super) fn has_tables(&self) -> bool {
        let Self { nodes, meshes, scenes, accessors, buffers } = self;
        [nodes, meshes, scenes, accessors, buffers].into_iter().any(Option::is_some)
    }
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Document {
    pub(super) extensions_used: Vec<String>,
    #[serde(deserialize_with = "whole")]
    pub(super) scene: Option<usize>,
    pub(super) scenes: Vec<Scene>,
    pub(super) nodes: Vec<Node>,
    pub(super) meshes: Vec<Mesh>,
    pub(super) materials: Vec<Material>,
    pub(super) textures: Vec<Texture>,
    pub(super) images: Vec<Image>,
    pub(super) samplers: Vec<Sampler>,
    pub(super) accessors: Vec<AccessorDef>,
    pub(super) buffer_views: Vec<BufferView>,
    pub(super) buffers: Vec<Buffer>,
    pub(super) cameras: Vec<IgnoredAny>,
    pub(super) skins: Vec<IgnoredAny>,
    pub(super) animations: Vec<IgnoredAny>,
    pub(super) extensions: DocumentExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct DocumentExtensions {
    #[serde(rename = "KHR_lights_punctual")]
    pub(super) lights: Lights,
    #[serde(rename = "KHR_materials_variants")]
    pub(super) variants: Variants,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Lights {
    pub(super) lights: Vec<IgnoredAny>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Variants {
    pub(super) variants: Vec<IgnoredAny>,
}

#[derive(Deserialize)]
pub(super) struct Scene {
    #[serde(default, deserialize_with = "name")]
    pub(super) name: Option<String>,
    #[serde(default, deserialize_with = "whole")]
    pub(super) nodes: Vec<usize>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    #[serde(deserialize_with = "name")]
    pub(super) name: Option<String>,
    #[serde(deserialize_with = "whole")]
    pub(super) mesh: Option<usize>,
    #[serde(deserialize_with = "whole")]
    pub(super) children: Vec<usize>,
    /// Column by column. Apart, as whatever few of many things have.
    pub(super) matrix: Option<Box<[f64; 16]>>,
    pub(super) translation: Option<[f64; 3]>,
    /// Quaternion x, y, z, w.
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
    pub(super) extensions: NodeExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(super) instancing: Option<Box<Instancing>>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Instancing {
    #[serde(deserialize_with = "whole")]
    pub(super) attributes: BTreeMap<String, usize>,
}

#[derive(Deserialize)]
pub(super) struct Mesh {
    #[serde(default, deserialize_with = "name")]
    pub(super) name: Option<String>,
    #[serde(default)]
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
pub(super) struct Primitive {
    pub(super) attributes: Attributes,
    #[serde(default, deserialize_with = "whole")]
    pub(super) indices: Option<usize>,
    #[serde(default, deserialize_with = "whole")]
    pub(super) material: Option<usize>,
    #[serde(default, deserialize_with = "whole")]
    pub(super) mode: Option<u64>,
    #[serde(default)]
    pub(super) targets: Vec<IgnoredAny>,
}

/// Accessors of the attributes that are read; those of other names are ignored. No table of names: a
/// scene may have hundreds of thousands of primitives.
#[derive(Default, Deserialize, PartialEq, Eq, Hash)]
#[serde(try_from = "BTreeMap<String, Whole>")]
pub(super) struct Attributes {
    pub(super) position: Option<usize>,
    pub(super) normal: Option<usize>,
    pub(super) color: Option<usize>,
    /// By number of the set.
    tex_coords: Vec<(usize, usize)>,
}

impl Attributes {
    /// Texture coordinates of a set.
    pub(super) fn tex_coord(&self, set: usize) -> Option<usize> {
        self.tex_coords.iter().find(|coords| coords.0 == set).map(|coords| coords.1)
    }
}

impl Primitive {
    /// All that decides what it looks like: primitives whose keys are equal look alike.
    pub(super) fn key(&self) -> impl Eq + Hash + use<'_> {
        let Self { attributes, indices, material, mode, targets } = self;
        (attributes, indices, material, mode, targets.is_empty())
    }
}

impl TryFrom<BTreeMap<String, Whole>> for Attributes {
    type Error = &'static str;

    fn try_from(named: BTreeMap<String, Whole>) -> Result<Self, Self::Error> {
        let named = BTreeMap::<String, usize>::of(named).ok_or("a number has too many bits")?;
        let set = |name: &str| {
            let digits = name.strip_prefix("TEXCOORD_")?;
            digits.parse().ok().filter(|set: &usize| set.to_string() == digits)
        };
        Ok(Self {
            position: named.get("POSITION").copied(),
            normal: named.get("NORMAL").copied(),
            color: named.get("COLOR_0").copied(),
            tex_coords: named.iter().filter_map(|(name, &a)| Some((set(name)?, a))).collect(),
        })
    }
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Material {
    #[serde(deserialize_with = "name")]
    pub(super) name: Option<String>,
    pub(super) pbr_metallic_roughness: MetallicRoughness,
    pub(super) alpha_mode: Option<String>,
    pub(super) alpha_cutoff: Option<f32>,
    pub(super) double_sided: bool,
    pub(super) extensions: MaterialExtensions,
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct MetallicRoughness {
    pub(super) base_color_factor: Option<[f64; 4]>,
    pub(super) base_color_texture: Option<TextureRef>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct MaterialExtensions {
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    pub(super) specular_glossiness: Option<SpecularGlossiness>,
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct SpecularGlossiness {
    pub(super) diffuse_factor: Option<[f64; 4]>,
    pub(super) diffuse_texture: Option<TextureRef>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TextureRef {
    #[serde(deserialize_with = "whole")]
    pub(super) index: usize,
    #[serde(default, deserialize_with = "whole")]
    pub(super) tex_coord: usize,
    #[serde(default)]
    pub(super) extensions: TextureRefExtensions,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(default)]
pub(super) struct TextureRefExtensions {
    #[serde(rename = "KHR_texture_transform")]
    pub(super) transform: Option<TextureTransform>,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct TextureTransform {
    pub(super) offset: Option<[f64; 2]>,
    /// Radians.
    pub(super) rotation: f64,
    pub(super) scale: Option<[f64; 2]>,
    #[serde(deserialize_with = "whole")]
    pub(super) tex_coord: Option<usize>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Texture {
    #[serde(deserialize_with = "whole")]
    pub(super) source: Option<usize>,
    #[serde(deserialize_with = "whole")]
    pub(super) sampler: Option<usize>,
    pub(super) extensions: TextureExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct TextureExtensions {
    #[serde(rename = "EXT_texture_webp")]
    pub(super) webp: TextureSource,
    #[serde(rename = "KHR_texture_basisu")]
    pub(super) basisu: TextureSource,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct TextureSource {
    #[serde(deserialize_with = "whole")]
    pub(super) source: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Sampler {
    #[serde(default, deserialize_with = "whole")]
    pub(super) wrap_s: Option<u32>,
    #[serde(default, deserialize_with = "whole")]
    pub(super) wrap_t: Option<u32>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Image {
    #[serde(default, deserialize_with = "name")]
    pub(super) name: Option<String>,
    pub(super) uri: Option<String>,
    #[serde(default, deserialize_with = "whole")]
    pub(super) buffer_view: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct AccessorDef {
    #[serde(default, deserialize_with = "name")]
    pub(super) name: Option<String>,
    #[serde(default, deserialize_with = "whole")]
    pub(super) buffer_view: Option<usize>,
    #[serde(default, deserialize_with = "whole")]
    pub(super) byte_offset: usize,
    #[serde(deserialize_with = "whole")]
    pub(super) component_type: u64,
    #[serde(rename = "type")]
    pub(super) element_type: ElementType,
    #[serde(deserialize_with = "whole")]
    pub(super) count: usize,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) sparse: Option<Box<SparseDef>>,
}

/// What an accessor's elements are.
#[derive(Deserialize)]
#[serde(from = "String")]
pub(super) enum ElementType {
    /// So many lanes, 1 to 4.
    Lanes(usize),
    /// What no attribute is made of.
    Other(Box<str>),
}

/// Names by number of lanes, from 1 on.
const LANES: [&str; 4] = ["SCALAR", "VEC2", "VEC3", "VEC4"];

impl From<String> for ElementType {
    fn from(name: String) -> Self {
        match LANES.iter().position(|&known| known == name) {
            Some(place) => Self::Lanes(place + 1),
            None => Self::Other(name.into()),
        }
    }
}

impl ElementType {
    /// As files spell it.
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Lanes(lanes) => LANES[lanes - 1],
            Self::Other(name) => name,
        }
    }
}

#[derive(Deserialize)]
pub(super) struct SparseDef {
    #[serde(deserialize_with = "whole")]
    pub(super) count: usize,
    pub(super) indices: SparseIndices,
    pub(super) values: SparseValues,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    #[serde(deserialize_with = "whole")]
    pub(super) buffer_view: usize,
    #[serde(default, deserialize_with = "whole")]
    pub(super) byte_offset: usize,
    #[serde(deserialize_with = "whole")]
    pub(super) component_type: u64,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    #[serde(deserialize_with = "whole")]
    pub(super) buffer_view: usize,
    #[serde(default, deserialize_with = "whole")]
    pub(super) byte_offset: usize,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    #[serde(deserialize_with = "whole")]
    pub(super) buffer: usize,
    #[serde(default, deserialize_with = "whole")]
    pub(super) byte_offset: usize,
    #[serde(deserialize_with = "whole")]
    pub(super) byte_length: usize,
    #[serde(default, deserialize_with = "whole")]
    pub(super) byte_stride: Option<usize>,
    #[serde(default)]
    pub(super) extensions: ViewExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct ViewExtensions {
    #[serde(rename = "EXT_meshopt_compression")]
    ext_meshopt: Option<Box<Compression>>,
    #[serde(rename = "KHR_meshopt_compression")]
    khr_meshopt: Option<Box<Compression>>,
}

impl ViewExtensions {
    /// How the view is compressed, if it is.
    pub(super) fn compression(&self) -> Option<&Compression> {
        self.khr_meshopt.as_deref().or(self.ext_meshopt.as_deref())
    }
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Compression {
    #[serde(deserialize_with = "whole")]
    pub(super) buffer: usize,
    #[serde(default, deserialize_with = "whole")]
    pub(super) byte_offset: usize,
    #[serde(deserialize_with = "whole")]
    pub(super) byte_length: usize,
    #[serde(deserialize_with = "whole")]
    pub(super) byte_stride: usize,
    #[serde(deserialize_with = "whole")]
    pub(super) count: usize,
    pub(super) mode: String,
    pub(super) filter: Option<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer {
    pub(super) uri: Option<String>,
    #[serde(deserialize_with = "whole")]
    pub(super) byte_length: usize,
    #[serde(default)]
    pub(super) extensions: BufferExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct BufferExtensions {
    #[serde(rename = "EXT_meshopt_compression")]
    ext_meshopt: Option<Fallback>,
    #[serde(rename = "KHR_meshopt_compression")]
    khr_meshopt: Option<Fallback>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Fallback {
    fallback: bool,
}

impl BufferExtensions {
    /// Whether the buffer is for programs that cannot decode its views, and may have no bytes.
    pub(super) fn is_fallback(&self) -> bool {
        [&self.ext_meshopt, &self.khr_meshopt].into_iter().flatten().any(|meshopt| meshopt.fallback)
    }
}

/// `kind number "name"`, as messages call an object of the file.
pub(super) fn label(kind: &str, number: usize, name: Option<&String>) -> String {
    match name {
        Some(name) => format!("{kind} {number} {name:?}"),
        None => format!("{kind} {number}"),
    }
}
