//! What a GLB shows: its chunks, its scene's nodes, their box and triangles.

use geometry::bounds::Aabb;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use serde::Deserialize;

/// The JSON and the binary chunk (glTF 2.0, section 4.4).
pub(super) fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    let word = |at: usize| {
        let four = bytes.get(at..).and_then(|rest| rest.first_chunk::<4>());
        four.map(|four| u32::from_le_bytes(*four)).ok_or_else(|| "it is cut short".to_owned())
    };
    if !bytes.starts_with(b"glTF") {
        return Err("it is no GLB".to_owned());
    }
    let (version, length) = (word(4)?, word(8)?);
    if version != 2 || length as usize != bytes.len() {
        return Err(format!(
            "its header says version {version} and {length} bytes, and the file has {}",
            bytes.len()
        ));
    }
    let mut found: Vec<(u32, &[u8])> = Vec::new();
    let mut at = 12;
    while at < bytes.len() {
        let (size, kind) = (word(at)? as usize, word(at + 4)?);
        let body = bytes.get(at + 8..).and_then(|rest| rest.get(..size));
        found.push((kind, body.ok_or_else(|| "a chunk ends beyond the file".to_owned())?));
        at += 8 + size;
    }
    match found[..] {
        [(JSON, json), (BIN, binary), ..] => Ok((json, Some(binary))),
        [(JSON, json), ..] => Ok((json, None)),
        _ => Err("its first chunk is not JSON".to_owned()),
    }
}

const JSON: u32 = u32::from_le_bytes(*b"JSON");
const BIN: u32 = u32::from_le_bytes(*b"BIN\0");

/// The scene that is copied.
pub(super) struct Scene {
    pub(super) roots: Vec<usize>,
    /// Its nodes, parents first.
    pub(super) order: Vec<usize>,
    /// Of every node of the file.
    pub(super) children: Vec<Vec<usize>>,
    /// World box of what it shows.
    pub(super) bounds: Aabb,
    /// Nodes that show a mesh.
    pub(super) objects: u64,
    /// Instances counted each; at least 1.
    pub(super) triangles: u64,
}

/// The part of the document that has to be understood. Every index is a claim, tested where it is used.
#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct View {
    scene: Option<usize>,
    scenes: Vec<SceneEntry>,
    pub(super) nodes: Vec<NodeEntry>,
    meshes: Vec<MeshEntry>,
    accessors: Vec<Accessor>,
    buffers: Vec<Outside>,
    images: Vec<Outside>,
}

#[derive(Deserialize)]
struct SceneEntry {
    #[serde(default)]
    nodes: Vec<usize>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct NodeEntry {
    mesh: Option<usize>,
    children: Vec<usize>,
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

impl NodeEntry {
    fn parent_from_node(&self) -> DAffine3 {
        if let Some(m) = self.matrix {
            let column = |c: usize| DVec3::new(m[4 * c], m[4 * c + 1], m[4 * c + 2]);
            let linear = DMat3::from_cols(column(0), column(1), column(2));
            return DAffine3::from_mat3_translation(linear, column(3));
        }
        DAffine3::from_scale_rotation_translation(
            DVec3::from(self.scale.unwrap_or([1.0; 3])),
            DQuat::from_array(self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0])),
            DVec3::from(self.translation.unwrap_or_default()),
        )
    }
}

#[derive(Deserialize)]
struct MeshEntry {
    primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
struct Primitive {
    attributes: Attributes,
    indices: Option<usize>,
    mode: Option<u32>,
}

#[derive(Deserialize)]
struct Attributes {
    #[serde(rename = "POSITION")]
    position: Option<usize>,
}

#[derive(Deserialize)]
struct Accessor {
    count: u64,
    min: Option<Vec<f64>>,
    max: Option<Vec<f64>>,
}

#[derive(Deserialize)]
struct Outside {
    uri: Option<String>,
}

impl View {
    /// Walks the scene: the default one, else the first, else all nodes without a parent.
    pub(super) fn survey(&self) -> Result<Scene, String> {
        let other = self.buffers.iter().chain(&self.images).filter_map(|entry| entry.uri.as_ref());
        if let Some(uri) = other.clone().find(|uri| !uri.starts_with("data:")) {
            return Err(format!("it refers to another file, {uri:?}"));
        }
        let meshes = (0..self.meshes.len())
            .map(|mesh| self.mesh(mesh))
            .collect::<Result<Vec<_>, String>>()?;
        let mut scene = Scene {
            roots: self.roots()?,
            order: Vec::new(),
            children: self.nodes.iter().map(|node| node.children.clone()).collect(),
            bounds: Aabb::EMPTY,
            objects: 0,
            triangles: 0,
        };
        let mut seen = vec![false; self.nodes.len()];
        let start = scene.roots.iter().rev().map(|&root| (root, DAffine3::IDENTITY));
        let mut open: Vec<(usize, DAffine3)> = start.collect();
        while let Some((number, world_from_parent)) = open.pop() {
            let Some(node) = self.nodes.get(number) else {
                return Err(format!("node {number} is named and there are {}", self.nodes.len()));
            };
            if std::mem::replace(&mut seen[number], true) {
                return Err(format!("node {number} is reached twice"));
            }
            scene.order.push(number);
            let world_from_node = world_from_parent * node.parent_from_node();
            open.extend(node.children.iter().rev().map(|&child| (child, world_from_node)));
            let Some(mesh) = node.mesh else { continue };
            let Some((bounds, triangles)) = meshes.get(mesh) else {
                return Err(format!("node {number} shows mesh {mesh} of {}", meshes.len()));
            };
            scene.objects += 1;
            scene.triangles = scene.triangles.saturating_add(*triangles);
            if !bounds.is_empty() {
                scene.bounds = scene.bounds.union(placed(bounds, &world_from_node));
            }
        }
        if scene.triangles == 0 || scene.bounds.is_empty() {
            return Err("its scene shows no triangles".to_owned());
        }
        let extent = scene.bounds.extent();
        if !extent.is_finite() || extent.x.max(extent.z) <= 0.0 {
            return Err(format!("its scene cannot be set on a plot: it has the size {extent}"));
        }
        Ok(scene)
    }

    fn roots(&self) -> Result<Vec<usize>, String> {
        match (self.scene, self.scenes.first()) {
            (Some(number), _) => match self.scenes.get(number) {
                Some(scene) => Ok(scene.nodes.clone()),
                None => Err(format!("its scene is number {number} of {}", self.scenes.len())),
            },
            (None, Some(first)) => Ok(first.nodes.clone()),
            (None, None) => {
                let mut root = vec![true; self.nodes.len()];
                for &child in self.nodes.iter().flat_map(|node| &node.children) {
                    // What is out of range is found by the walk.
                    root.get_mut(child).into_iter().for_each(|root| *root = false);
                }
                Ok((0..self.nodes.len()).filter(|&node| root[node]).collect())
            }
        }
    }

    /// Box and triangles of a mesh.
    fn mesh(&self, number: usize) -> Result<(Aabb, u64), String> {
        let accessor = |index: usize| {
            let claim = self.accessors.get(index);
            claim.ok_or_else(|| {
                format!("mesh {number} uses accessor {index} of {}", self.accessors.len())
            })
        };
        let (mut bounds, mut triangles) = (Aabb::EMPTY, 0u64);
        for primitive in &self.meshes[number].primitives {
            let Some(position) = primitive.attributes.position else { continue };
            let positions = accessor(position)?;
            let (Some([x, y, z]), Some([u, v, w])) =
                (positions.min.as_deref(), positions.max.as_deref())
            else {
                return Err(format!("accessor {position} holds positions without min and max"));
            };
            bounds = bounds.with(DVec3::new(*x, *y, *z)).with(DVec3::new(*u, *v, *w));
            let count = match primitive.indices {
                Some(indices) => accessor(indices)?.count,
                None => positions.count,
            };
            triangles = triangles.saturating_add(match primitive.mode.unwrap_or(TRIANGLES) {
                TRIANGLES => count / 3,
                STRIP | FAN => count.saturating_sub(2),
                _ => 0,
            });
        }
        Ok((bounds, triangles))
    }
}

const TRIANGLES: u32 = 4;
const STRIP: u32 = 5;
const FAN: u32 = 6;

/// The box around a placed box.
fn placed(inner: &Aabb, target_from_box: &DAffine3) -> Aabb {
    Aabb::of((0..8).map(|corner| {
        let pick = |k: usize| if corner >> k & 1 == 1 { inner.max[k] } else { inner.min[k] };
        target_from_box.transform_point3(DVec3::new(pick(0), pick(1), pick(2)))
    }))
}
