//! A town of one scene: turned copies of all that a GLB shows, on a grid of streets.
//!
//! Meshes, materials and the binary chunk are kept as they are; only nodes are copied.

mod survey;

use super::glb::{GlbError, write_container};
use super::random::Random;
use geometry::bounds::Aabb;
use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use survey::{Scene, View, chunks};

/// Width of a street, as a share of the longer side of the copied scene.
const STREET: f64 = 0.2;
/// Most nodes of a town: about what fits the 4 GiB of a GLB.
const MAX_NODES: u64 = 10_000_000;

/// Why a town was not made.
#[derive(Debug, thiserror::Error)]
pub enum TownError {
    /// The file to copy is missing or cannot be read.
    #[error("{path}: cannot read: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// It is no GLB whose scene can be copied.
    #[error("{path}: {what}; give a GLB of glTF 2.0 that shows triangles")]
    BadData {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// The town cannot be written.
    #[error(transparent)]
    Write(#[from] GlbError),
}

impl TownError {
    /// The exit code of the program.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Read { source, .. } if source.kind() == std::io::ErrorKind::NotFound => 66,
            Self::Read { .. } | Self::Write(_) => 74,
            Self::BadData { .. } => 65,
        }
    }
}

/// What a town consists of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Town {
    /// Copies, the original included.
    pub copies: u64,
    /// Nodes that show a mesh.
    pub objects: u64,
    /// Triangles, instances counted each.
    pub triangles: u64,
}

/// Writes a town of copies of the scene in the GLB `from`, with at least `triangles` triangles.
///
/// Each copy is a subtree below a node of its own, which turns it by quarters around the vertical and
/// sets it on its plot of a square grid. The same arguments give the same bytes. The town is written
/// as [`super::write_glb`] writes.
///
/// # Errors
/// [`TownError`]. Refused are files that refer to other files, since the town may lie elsewhere.
pub fn write_town(from: &Path, triangles: u64, seed: u64, to: &Path) -> Result<Town, TownError> {
    let read = |source| TownError::Read { path: from.to_owned(), source };
    let bad = |what| TownError::BadData { path: from.to_owned(), what };
    let mut bytes = Vec::new();
    protocol::file::open(from).and_then(|mut f| f.read_to_end(&mut bytes)).map_err(read)?;
    let (json, binary) = chunks(&bytes).map_err(bad)?;
    let mut document: Map<String, Value> = serde_json::from_slice(json)
        .map_err(|error| bad(format!("its JSON is malformed: {error}")))?;
    let model = View::deserialize(&Value::Object(document.clone()))
        .map_err(|error| bad(format!("its JSON is not shaped like glTF: {error}")))?;
    let scene = model.survey().map_err(bad)?;
    let copies = triangles.div_ceil(scene.triangles).max(1);
    let nodes = copies
        .saturating_mul(scene.order.len() as u64 + 1)
        .saturating_add(model.nodes.len() as u64);
    if nodes > MAX_NODES {
        let what = format!("{copies} copies would have {nodes} nodes and {MAX_NODES} is the limit");
        return Err(bad(what));
    }
    let Some(Value::Array(nodes)) = document.remove("nodes") else {
        return Err(bad("it has no nodes".to_owned()));
    };
    let first_root = nodes.len() as u64 + (copies - 1) * scene.order.len() as u64;
    document.insert("scene".to_owned(), json!(0));
    // Whatever else lies in the file, a node below a copy is no root any more.
    let roots: Vec<u64> = (first_root..first_root + copies).collect();
    document.insert("scenes".to_owned(), json!([{ "name": "town", "nodes": roots }]));

    let json = write_json(&document, &nodes, &scene, copies, seed)
        .map_err(|source| GlbError::Io { path: to.to_owned(), source })?;
    write_container(to, json, binary.map(|b| b.len() as u64), |out| {
        out.write_all(binary.unwrap_or_default())
    })?;
    Ok(Town {
        copies,
        objects: copies * scene.objects,
        triangles: copies.saturating_mul(scene.triangles),
    })
}

/// The document with the nodes of all copies. Copies are written as they are made: as JSON values, a
/// town would take many times its size.
fn write_json(
    document: &Map<String, Value>,
    nodes: &[Value],
    scene: &Scene,
    copies: u64,
    seed: u64,
) -> std::io::Result<Vec<u8>> {
    let mut out = b"{\"nodes\":[".to_vec();
    let mut separator: &[u8] = b"";
    let mut put = |out: &mut Vec<u8>, node: &Value| {
        out.extend_from_slice(std::mem::replace(&mut separator, b","));
        serde_json::to_writer(out, node)
    };
    for node in nodes {
        put(&mut out, node)?;
    }
    let mut place = vec![0; nodes.len()];
    scene.order.iter().enumerate().for_each(|(rank, &node)| place[node] = rank as u64);
    let copied = |copy: u64, node: usize| match copy {
        0 => node as u64,
        _ => nodes.len() as u64 + (copy - 1) * scene.order.len() as u64 + place[node],
    };
    for copy in 1..copies {
        for &number in &scene.order {
            let mut node = nodes[number].clone();
            if let Value::Object(node) = &mut node {
                // Joints would have to be copied, too, and nothing moves here.
                node.remove("skin");
                if !scene.children[number].is_empty() {
                    let children = scene.children[number].iter().map(|&child| copied(copy, child));
                    node.insert("children".to_owned(), children.collect());
                }
            }
            put(&mut out, &node)?;
        }
    }
    let columns = (1..).find(|&n| n * n >= copies).unwrap_or(1);
    for copy in 0..copies {
        let turns = if copy == 0 { 0 } else { Random::stream(seed, copy).below(4) };
        let children: Vec<u64> = scene.roots.iter().map(|&root| copied(copy, root)).collect();
        let matrix = plot(&scene.bounds, copy % columns, copy / columns, turns);
        let name = format!("copy-{copy}");
        put(&mut out, &json!({ "name": name, "matrix": matrix, "children": children }))?;
    }
    out.push(b']');
    for (key, value) in document {
        out.push(b',');
        serde_json::to_writer(&mut out, key)?;
        out.push(b':');
        serde_json::to_writer(&mut out, value)?;
    }
    out.push(b'}');
    Ok(out)
}

/// Column-major placement of a copy: turned around the scene's middle, which then lies over the
/// middle of the plot. The scene's first plot is where the scene lies.
fn plot(bounds: &Aabb, column: u64, row: u64, turns: u32) -> [f64; 16] {
    let extent = bounds.extent();
    let pitch = (1.0 + STREET) * extent.x.max(extent.z);
    // Exact, unlike sines of right angles.
    let [cos, sin] = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]][turns as usize % 4];
    let turned = DMat3::from_cols(DVec3::new(cos, 0.0, -sin), DVec3::Y, DVec3::new(sin, 0.0, cos));
    let center = bounds.center();
    let to = center + DVec3::new(column as f64, 0.0, row as f64) * pitch - turned * center;
    let [x, y, z] = turned.to_cols_array_2d();
    let column = |c: [f64; 3], w: f64| [c[0], c[1], c[2], w];
    let columns = [column(x, 0.0), column(y, 0.0), column(z, 0.0), column(to.to_array(), 1.0)];
    let flat = columns.concat();
    std::array::from_fn(|i| flat[i])
}

#[cfg(test)]
mod tests;
