//! From the node graph to placed meshes (glTF 2.0, section 3.5).

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::accessor::{Accessor, Elements, Role};
use super::buffers::Resources;
use super::document::{Instancing, Node, label};
use crate::import::error::ImportError;

/// A mesh shown by a node or one of its instances, with its transform accumulated from the root.
pub(super) struct Placement {
    /// The node's name, or "node" and its number; with the instance's place in brackets.
    pub(super) name: String,
    /// Which mesh of the document.
    pub(super) mesh: usize,
    pub(super) world_from_mesh: DAffine3,
}

/// Every mesh the scene shows, in depth-first order.
///
/// The scene is the default one, else the first, else all nodes without a parent. A node with two
/// parents, or among its own descendants, is refused.
pub(super) fn placements(resources: &Resources<'_>) -> Result<Vec<Placement>, ImportError> {
    let nodes = &resources.document.nodes;
    let name = |number: usize| label("node", number, nodes[number].name.as_ref());
    let no_tree = |number: usize, what: String| {
        resources.invalid(name(number), what, "make the node graph a forest of trees")
    };
    let mut parents = vec![None; nodes.len()];
    for (parent, node) in nodes.iter().enumerate() {
        for &child in &node.children {
            let Some(slot) = parents.get_mut(child) else {
                return Err(no_tree(
                    parent,
                    format!("its child {child} is not among the {} nodes", nodes.len()),
                ));
            };
            if let Some(other) = slot.replace(parent) {
                return Err(no_tree(
                    child,
                    format!("it is a child of node {other} and again of node {parent}"),
                ));
            }
        }
    }

    // Last in, first out: pushed in reverse, nodes come off in the file's order. A stack of our
    // own, because the depth of the tree is the file's to choose.
    let mut stack: Vec<(usize, DAffine3)> = roots(resources, &parents)?
        .into_iter()
        .rev()
        .map(|root| (root, DAffine3::IDENTITY))
        .collect();
    let mut seen = vec![false; nodes.len()];
    let mut placements = Vec::new();
    while let Some((number, world_from_parent)) = stack.pop() {
        if std::mem::replace(&mut seen[number], true) {
            return Err(no_tree(
                number,
                "it is reached twice: a cycle, or a root listed twice".into(),
            ));
        }
        let node = &nodes[number];
        let parent_from_node =
            local_transform(node).map_err(|what| resources.broken(&name(number), what))?;
        let world_from_node = world_from_parent * parent_from_node;
        if !world_from_node.is_finite() {
            return Err(resources.broken(&name(number), "its transform is not finite".into()));
        }
        stack.extend(node.children.iter().rev().map(|&child| (child, world_from_node)));
        if let Some(mesh) = node.mesh {
            let meshes = resources.document.meshes.len();
            if mesh >= meshes {
                return Err(
                    resources.broken(&name(number), format!("it shows mesh {mesh} of {meshes}"))
                );
            }
            let own = node.name.clone().unwrap_or_else(|| format!("node {number}"));
            let Some(instancing) = &node.extensions.instancing else {
                placements.push(Placement { name: own, mesh, world_from_mesh: world_from_node });
                continue;
            };
            for (place, node_from_mesh) in
                instances(resources, &name(number), instancing)?.into_iter().enumerate()
            {
                let world_from_mesh = world_from_node * node_from_mesh;
                if !world_from_mesh.is_finite() {
                    let what = format!("the transform of its instance {place} is not finite");
                    return Err(resources.broken(&name(number), what));
                }
                placements.push(Placement {
                    name: format!("{own}[{place}]"),
                    mesh,
                    world_from_mesh,
                });
            }
        }
    }
    Ok(placements)
}

fn roots(resources: &Resources<'_>, parents: &[Option<usize>]) -> Result<Vec<usize>, ImportError> {
    let document = resources.document;
    let scene = match document.scene {
        Some(number) => Some((
            number,
            document.scenes.get(number).ok_or_else(|| {
                resources.broken(
                    "default scene",
                    format!("it is number {number} of {}", document.scenes.len()),
                )
            })?,
        )),
        None => document.scenes.first().map(|scene| (0, scene)),
    };
    let Some((number, scene)) = scene else {
        return Ok((0..parents.len()).filter(|&node| parents[node].is_none()).collect());
    };
    for &root in &scene.nodes {
        if root >= parents.len() {
            let what = format!("its root {root} is not among the {} nodes", parents.len());
            return Err(resources.broken(&format!("scene {number}"), what));
        }
    }
    Ok(scene.nodes.clone())
}

/// Where a node shows its mesh, relative to itself (EXT_mesh_gpu_instancing).
fn instances(
    resources: &Resources<'_>,
    at: &str,
    instancing: &Instancing,
) -> Result<Vec<DAffine3>, ImportError> {
    let load = |attribute: &str, role| {
        let Some(&accessor) = instancing.attributes.get(attribute) else { return Ok(None) };
        let user = format!("{at}, instances, {attribute}");
        Accessor::open(resources, &user, accessor, role)?.load_all(resources).map(Some)
    };
    let translations = load("TRANSLATION", Role::Vector)?;
    let rotations = load("ROTATION", Role::Rotation)?;
    let scales = load("SCALE", Role::Vector)?;
    let mut counts = [&translations, &rotations, &scales].into_iter().flatten().map(Elements::len);
    let Some(count) = counts.next() else {
        // Attributes of other meanings alone say how many there are, but all stand in one place.
        return Ok(vec![DAffine3::IDENTITY]);
    };
    if let Some(other) = counts.find(|&other| other != count) {
        let what = format!("its instances have {count} of one attribute and {other} of another");
        return Err(resources.broken(at, what));
    }
    let vector = |all: &Option<Elements>, i: usize, default: f64| {
        all.as_ref()
            .map_or(DVec3::splat(default), |all| DVec3::from(all.vector::<3>(i).map(f64::from)))
    };
    (0..count)
        .map(|i| {
            let rotation = rotations
                .as_ref()
                .map_or([0.0, 0.0, 0.0, 1.0], |all| all.vector::<4>(i).map(f64::from));
            let rotation = unit_rotation(rotation)
                .map_err(|what| resources.broken(at, format!("instance {i}: {what}")))?;
            let (scale, translation) = (vector(&scales, i, 1.0), vector(&translations, i, 0.0));
            Ok(DAffine3::from_scale_rotation_translation(scale, rotation, translation))
        })
        .collect()
}

/// Files store rounded quaternions; one that cannot be brought to unit length is no rotation.
fn unit_rotation(stored: [f64; 4]) -> Result<DQuat, &'static str> {
    let rotation = DQuat::from_array(stored);
    let length = rotation.length();
    if !(length.is_finite() && length > 0.0) {
        return Err("its rotation has no length");
    }
    Ok(rotation / length)
}

/// A node's own transform: its matrix, or translation after rotation after scale.
fn local_transform(node: &Node) -> Result<DAffine3, String> {
    if let Some(m) = &node.matrix {
        // Column by column, so the bottom row is every fourth number.
        if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
            return Err("the bottom row of its matrix is not 0 0 0 1".into());
        }
        let column = |c: usize| DVec3::new(m[4 * c], m[4 * c + 1], m[4 * c + 2]);
        return Ok(DAffine3::from_mat3_translation(
            DMat3::from_cols(column(0), column(1), column(2)),
            column(3),
        ));
    }
    let scale = DVec3::from(node.scale.unwrap_or([1.0; 3]));
    let translation = DVec3::from(node.translation.unwrap_or_default());
    let rotation = unit_rotation(node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]))?;
    Ok(DAffine3::from_scale_rotation_translation(scale, rotation, translation))
}
