//! GLB writer: glTF 2.0 binary container, section 4 of the specification.

use super::{Material, Mesh, Model};
use serde::Serialize;
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Why a model was not written.
#[derive(Debug, thiserror::Error)]
pub enum GlbError {
    /// A GLB's length field has 32 bits.
    #[error("{path}: {bytes} bytes do not fit the 4 GiB of a GLB; ask for fewer triangles")]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// What it would hold.
        bytes: u64,
    },
    /// The file system refused.
    #[error("{path}: cannot write: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Its reason.
        source: std::io::Error,
    },
}

const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Writes `model` as `path`, under a temporary name beside it first, synced and then renamed, so that
/// no half of a file is ever seen under `path`. Normals and indices that several meshes have in common
/// are written once.
///
/// # Errors
/// [`GlbError::TooLarge`] from 4 GiB on, before anything is written; [`GlbError::Io`] otherwise.
pub fn write_glb(model: &Model, path: &Path) -> Result<(), GlbError> {
    let layout = Layout::of(model);
    let json = serde_json::to_vec(&document(model, &layout)).map_err(|e| io(path, e.into()))?;
    write_container(path, json, Some(layout.bytes()), |out| write_binary(model, &layout, out))
}

/// Writes a GLB of a JSON chunk and, if there is one, a binary chunk of `binary` bytes, a multiple of 4,
/// which `write` writes. Temporary name, durability and errors as for [`write_glb`].
pub(super) fn write_container(
    path: &Path,
    mut json: Vec<u8>,
    binary: Option<u64>,
    write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), GlbError> {
    json.resize(json.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + json.len() as u64 + binary.map_or(0, |bytes| 8 + bytes);
    let Ok(total_field) = u32::try_from(total) else {
        return Err(GlbError::TooLarge { path: path.to_owned(), bytes: total });
    };

    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let temporary = path.with_file_name(name);
    let written = (|| {
        let mut out = BufWriter::with_capacity(1 << 20, File::create(&temporary)?);
        out.write_all(b"glTF")?;
        for word in [2, total_field, json.len() as u32] {
            out.write_all(&word.to_le_bytes())?;
        }
        out.write_all(b"JSON")?;
        out.write_all(&json)?;
        if let Some(bytes) = binary {
            out.write_all(&(bytes as u32).to_le_bytes())?;
            out.write_all(b"BIN\0")?;
            write(&mut out)?;
        }
        out.into_inner().map_err(std::io::IntoInnerError::into_error)?.sync_all()?;
        std::fs::rename(&temporary, path)
    })();
    written.map_err(|source| {
        // The error that matters is the first one.
        let _ = std::fs::remove_file(&temporary);
        io(path, source)
    })
}

fn io(path: &Path, source: std::io::Error) -> GlbError {
    GlbError::Io { path: path.to_owned(), source }
}

/// 65535 restarts a primitive, so it is no index of 16 bits.
fn short_indices(mesh: &Mesh) -> bool {
    mesh.positions.len() <= usize::from(u16::MAX)
}

/// Which meshes write what, by their numbers. The buffer holds all positions, then the distinct
/// normals, then the distinct indices of 16 bits, padded, then those of 32 bits.
struct Layout {
    /// Of each mesh: the one whose normals, and the one whose indices, are its own.
    sources: Vec<[usize; 2]>,
    /// Bytes of the four parts.
    parts: [u64; 4],
}

impl Layout {
    fn of(model: &Model) -> Self {
        let mut normals: HashMap<Vec<[u32; 3]>, usize> = HashMap::new();
        let mut indices: HashMap<(bool, &[u32]), usize> = HashMap::new();
        let mut layout = Self { sources: Vec::with_capacity(model.meshes.len()), parts: [0; 4] };
        for (number, mesh) in model.meshes.iter().enumerate() {
            let bits = mesh.normals.iter().map(|normal| normal.map(f32::to_bits)).collect();
            let short = short_indices(mesh);
            let sources = [
                *normals.entry(bits).or_insert(number),
                *indices.entry((short, &mesh.indices)).or_insert(number),
            ];
            layout.parts[0] += 12 * mesh.positions.len() as u64;
            if sources[0] == number {
                layout.parts[1] += 12 * mesh.normals.len() as u64;
            }
            if sources[1] == number {
                let (part, width) = if short { (2, 2) } else { (3, 4) };
                layout.parts[part] += width * mesh.indices.len() as u64;
            }
            layout.sources.push(sources);
        }
        layout
    }

    /// Where the parts begin.
    fn starts(&self) -> [u64; 4] {
        let [positions, normals, short, _] = self.parts;
        let after = positions + normals;
        [0, positions, after, after + short.next_multiple_of(4)]
    }

    fn bytes(&self) -> u64 {
        self.starts()[3] + self.parts[3]
    }
}

fn write_binary(model: &Model, layout: &Layout, out: &mut impl Write) -> std::io::Result<()> {
    let own = |which: usize| {
        let sources = layout.sources.iter().enumerate();
        let own = sources.filter(move |(number, sources)| sources[which] == *number);
        own.map(|(number, _)| &model.meshes[number])
    };
    for mesh in &model.meshes {
        write_vectors(&mesh.positions, out)?;
    }
    for mesh in own(0) {
        write_vectors(&mesh.normals, out)?;
    }
    for mesh in own(1).filter(|mesh| short_indices(mesh)) {
        for &i in &mesh.indices {
            out.write_all(&(i as u16).to_le_bytes())?;
        }
    }
    out.write_all(&[0; 3][..(layout.parts[2].next_multiple_of(4) - layout.parts[2]) as usize])?;
    for mesh in own(1).filter(|mesh| !short_indices(mesh)) {
        for &i in &mesh.indices {
            out.write_all(&i.to_le_bytes())?;
        }
    }
    Ok(())
}

fn write_vectors(vectors: &[[f32; 3]], out: &mut impl Write) -> std::io::Result<()> {
    vectors.iter().flatten().try_for_each(|c| out.write_all(&c.to_le_bytes()))
}

// Plain data instead of JSON values: a city's document has a million of them.

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Document<'a> {
    asset: Asset,
    scene: usize,
    scenes: [Scene; 1],
    nodes: Vec<Node<'a>>,
    meshes: Vec<MeshEntry<'a>>,
    materials: Vec<MaterialEntry<'a>>,
    accessors: Vec<Accessor>,
    buffer_views: Vec<View>,
    buffers: [Buffer; 1],
}

#[derive(Serialize)]
struct Asset {
    version: &'static str,
    generator: &'static str,
}

#[derive(Serialize)]
struct Scene {
    nodes: Vec<usize>,
}

#[derive(Serialize)]
struct Node<'a> {
    name: &'a str,
    mesh: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    matrix: Option<[f64; 16]>,
}

#[derive(Serialize)]
struct MeshEntry<'a> {
    name: &'a str,
    primitives: [Primitive; 1],
}

#[derive(Serialize)]
struct Primitive {
    attributes: Attributes,
    indices: usize,
    material: usize,
}

#[derive(Serialize)]
#[serde(rename_all = "UPPERCASE")]
struct Attributes {
    position: usize,
    normal: usize,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct MaterialEntry<'a> {
    name: &'a str,
    pbr_metallic_roughness: Look,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Look {
    base_color_factor: [f64; 4],
    metallic_factor: f64,
    roughness_factor: f64,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Accessor {
    buffer_view: usize,
    byte_offset: u64,
    component_type: u32,
    #[serde(rename = "type")]
    kind: &'static str,
    count: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    min: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    max: Option<[f64; 3]>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct View {
    buffer: usize,
    byte_offset: u64,
    byte_length: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    byte_stride: Option<u32>,
    target: u32,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Buffer {
    byte_length: u64,
}

fn document<'a>(model: &'a Model, layout: &Layout) -> Document<'a> {
    let mut views = Vec::new();
    // A view must not be empty, so a part without bytes has none.
    let view_of = [0, 1, 2, 3].map(|part| {
        let vectors = part < 2;
        if layout.parts[part] > 0 {
            views.push(View {
                buffer: 0,
                byte_offset: layout.starts()[part],
                byte_length: layout.parts[part],
                byte_stride: vectors.then_some(12),
                target: if vectors { ARRAY_BUFFER } else { ELEMENT_ARRAY_BUFFER },
            });
        }
        views.len().saturating_sub(1)
    });
    let mut accessors = Vec::new();
    let mut ends = [0u64; 4];
    let mut accessor = |part: usize, count: usize, bounds: Option<[[f64; 3]; 2]>| {
        let (kind, component_type, bytes) = [
            ("VEC3", FLOAT, 12),
            ("VEC3", FLOAT, 12),
            ("SCALAR", UNSIGNED_SHORT, 2),
            ("SCALAR", UNSIGNED_INT, 4),
        ][part];
        accessors.push(Accessor {
            buffer_view: view_of[part],
            byte_offset: ends[part],
            component_type,
            kind,
            count,
            min: bounds.map(|[min, _]| min),
            max: bounds.map(|[_, max]| max),
        });
        ends[part] += bytes * count as u64;
        accessors.len() - 1
    };
    let mut meshes: Vec<MeshEntry<'a>> = Vec::with_capacity(model.meshes.len());
    for (number, (mesh, sources)) in model.meshes.iter().zip(&layout.sources).enumerate() {
        let position = accessor(0, mesh.positions.len(), Some(bounds(mesh)));
        let normal = match sources[0] {
            own if own == number => accessor(1, mesh.normals.len(), None),
            other => meshes[other].primitives[0].attributes.normal,
        };
        let indices = match sources[1] {
            own if own == number => {
                accessor(if short_indices(mesh) { 2 } else { 3 }, mesh.indices.len(), None)
            }
            other => meshes[other].primitives[0].indices,
        };
        let attributes = Attributes { position, normal };
        let primitives = [Primitive { attributes, indices, material: mesh.material }];
        meshes.push(MeshEntry { name: &mesh.name, primitives });
    }
    let nodes = model.nodes.iter();
    Document {
        asset: Asset { version: "2.0", generator: "occluster synth" },
        scene: 0,
        scenes: [Scene { nodes: (0..model.nodes.len()).collect() }],
        nodes: nodes.map(|n| Node { name: &n.name, mesh: n.mesh, matrix: n.matrix }).collect(),
        meshes,
        materials: model.materials.iter().map(material).collect(),
        accessors,
        buffer_views: views,
        buffers: [Buffer { byte_length: layout.bytes() }],
    }
}

fn bounds(mesh: &Mesh) -> [[f64; 3]; 2] {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in &mesh.positions {
        for k in 0..3 {
            low[k] = low[k].min(p[k]);
            high[k] = high[k].max(p[k]);
        }
    }
    [low, high].map(|corner| corner.map(f64::from))
}

fn material(material: &Material) -> MaterialEntry<'_> {
    let base_color_factor = material.base_color.map(f64::from);
    let look = Look { base_color_factor, metallic_factor: 0.0, roughness_factor: 0.8 };
    MaterialEntry { name: &material.name, pbr_metallic_roughness: look }
}
