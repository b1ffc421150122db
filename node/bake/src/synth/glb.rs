//! GLB writer: glTF 2.0 binary container, section 4 of the specification.

use super::{Mesh, Model};
use serde_json::{Value, json};
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
/// no half of a file is ever seen under `path`.
///
/// # Errors
/// [`GlbError::TooLarge`] from 4 GiB on, before anything is written; [`GlbError::Io`] otherwise.
pub fn write_glb(model: &Model, path: &Path) -> Result<(), GlbError> {
    let mut json = serde_json::to_vec(&document(model)).map_err(|e| io(path, e.into()))?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let binary: u64 = model.meshes.iter().map(mesh_bytes).sum();
    let total = 12 + 8 + json.len() as u64 + 8 + binary;
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
        out.write_all(&(binary as u32).to_le_bytes())?;
        out.write_all(b"BIN\0")?;
        for mesh in &model.meshes {
            write_mesh(mesh, &mut out)?;
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

fn index_bytes(mesh: &Mesh) -> u64 {
    mesh.indices.len() as u64 * if short_indices(mesh) { 2 } else { 4 }
}

fn mesh_bytes(mesh: &Mesh) -> u64 {
    24 * mesh.positions.len() as u64 + index_bytes(mesh).next_multiple_of(4)
}

fn write_mesh(mesh: &Mesh, out: &mut impl Write) -> std::io::Result<()> {
    for vector in mesh.positions.iter().chain(&mesh.normals) {
        for c in vector {
            out.write_all(&c.to_le_bytes())?;
        }
    }
    if short_indices(mesh) {
        for &i in &mesh.indices {
            out.write_all(&(i as u16).to_le_bytes())?;
        }
        if mesh.indices.len() % 2 == 1 {
            out.write_all(&[0; 2])?;
        }
    } else {
        for &i in &mesh.indices {
            out.write_all(&i.to_le_bytes())?;
        }
    }
    Ok(())
}

fn document(model: &Model) -> Value {
    let (mut views, mut accessors, mut meshes) = (Vec::new(), Vec::new(), Vec::new());
    let mut offset = 0;
    for mesh in &model.meshes {
        let first = accessors.len();
        let vectors = 12 * mesh.positions.len() as u64;
        let width = if short_indices(mesh) { UNSIGNED_SHORT } else { UNSIGNED_INT };
        for (at, bytes, target) in [
            (offset, vectors, ARRAY_BUFFER),
            (offset + vectors, vectors, ARRAY_BUFFER),
            (offset + 2 * vectors, index_bytes(mesh), ELEMENT_ARRAY_BUFFER),
        ] {
            views.push(json!({
                "buffer": 0, "byteOffset": at, "byteLength": bytes, "target": target
            }));
        }
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for p in &mesh.positions {
            for k in 0..3 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        accessors.push(json!({
            "bufferView": first, "componentType": FLOAT, "type": "VEC3",
            "count": mesh.positions.len(), "min": low.map(f64::from), "max": high.map(f64::from)
        }));
        accessors.push(json!({
            "bufferView": first + 1, "componentType": FLOAT, "type": "VEC3",
            "count": mesh.normals.len()
        }));
        accessors.push(json!({
            "bufferView": first + 2, "componentType": width, "type": "SCALAR",
            "count": mesh.indices.len()
        }));
        meshes.push(json!({
            "name": mesh.name,
            "primitives": [{
                "attributes": { "POSITION": first, "NORMAL": first + 1 },
                "indices": first + 2, "material": mesh.material
            }]
        }));
        offset += mesh_bytes(mesh);
    }
    let nodes: Vec<Value> = model
        .nodes
        .iter()
        .map(|node| match node.matrix {
            None => json!({ "name": node.name, "mesh": node.mesh }),
            Some(m) => json!({ "name": node.name, "mesh": node.mesh, "matrix": m }),
        })
        .collect();
    let materials: Vec<Value> = model
        .materials
        .iter()
        .map(|m| {
            json!({
                "name": m.name,
                "pbrMetallicRoughness": {
                    "baseColorFactor": m.base_color.map(f64::from),
                    "metallicFactor": 0.0, "roughnessFactor": 0.8
                }
            })
        })
        .collect();
    json!({
        "asset": { "version": "2.0", "generator": "occluster synth" },
        "scene": 0,
        "scenes": [{ "nodes": (0..model.nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes, "meshes": meshes, "materials": materials,
        "accessors": accessors, "bufferViews": views,
        "buffers": [{ "byteLength": offset }]
    })
}
