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
/// The scene is the one that is `asked` for by name or number, else the default one, else the first,
/// else all nodes without a parent. A node with two parents, or among its own descendants, is refused.
pub(super) fn placements(
    resources: &Resources<'_>,
    asked: &str,
    notes: &mut Vec<String>,
) -> Result<Vec<Placement>, ImportError> {
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
    let scene = scene(resources, asked)?;
    let mut stack: Vec<(usize, DAffine3)> = roots(resources, scene, &parents)?
        .into_iter()
        .rev()
        .map(|root| (root, DAffine3::IDENTITY))
        .collect();
    let mut seen = vec![false; nodes.len()];
    let mut placements = Vec::new();
    let most = FREE_INSTANCES.max(resources.total_bytes());
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
            let left = most.saturating_sub(placements.len() as u64);
            let instances = instances(resources, &name(number), instancing, left)?;
            for (place, node_from_mesh) in instances.into_iter().enumerate() {
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
    let scenes = &resources.document.scenes;
    if let Some(number) = scene.filter(|_| scenes.len() > 1) {
        let taken = label("scene", number, scenes[number].name.as_ref());
        let others = scenes.len() - 1;
        notes.push(format!("{others} other scenes left out, {taken} is read (see --scene)"));
    }
    let unseen = nodes.iter().zip(seen).filter(|(node, seen)| node.mesh.is_some() && !seen).count();
    if unseen > 0 {
        notes.push(format!("{unseen} nodes with meshes are not in the scene that is read"));
    }
    Ok(placements)
}

/// The number of the scene to read, if the file has any.
fn scene(resources: &Resources<'_>, asked: &str) -> Result<Option<usize>, ImportError> {
    let document = resources.document;
    let scenes = &document.scenes;
    if asked.is_empty() {
        return match document.scene {
            Some(number) if number >= scenes.len() => {
                let what = format!("it is number {number} of {}", scenes.len());
                Err(resources.broken("default scene", what))
            }
            Some(number) => Ok(Some(number)),
            None => Ok((!scenes.is_empty()).then_some(0)),
        };
    }
    let named = scenes.iter().position(|scene| scene.name.as_deref() == Some(asked));
    let numbered = || asked.parse().ok().filter(|&number: &usize| number < scenes.len());
    named.or_else(numbered).map(Some).ok_or_else(|| {
        const MOST_NAMED: usize = 20;
        let all = scenes.iter().enumerate().take(MOST_NAMED);
        let all: Vec<String> =
            all.map(|(number, scene)| label("scene", number, scene.name.as_ref())).collect();
        let what =
            format!("none of {} is named or numbered {asked:?}: {}", scenes.len(), all.join(", "));
        resources.invalid("scenes".into(), what, "give another to --scene, or leave it out")
    })
}

fn roots(
    resources: &Resources<'_>,
    scene: Option<usize>,
    parents: &[Option<usize>],
) -> Result<Vec<usize>, ImportError> {
    let Some(number) = scene else {
        return Ok((0..parents.len()).filter(|&node| parents[node].is_none()).collect());
    };
    let scene = &resources.document.scenes[number];
    for &root in &scene.nodes {
        if root >= parents.len() {
            let what = format!("its root {root} is not among the {} nodes", parents.len());
            return Err(resources.broken(&format!("scene {number}"), what));
        }
    }
    Ok(scene.nodes.clone())
}

/// So many instances are read, or one for each byte of the buffers: a dozen nodes may show theirs by the
/// same list.
const FREE_INSTANCES: u64 = 1 << 20;

/// Where a node shows its mesh, relative to itself (EXT_mesh_gpu_instancing): `most` times at most.
fn instances(
    resources: &Resources<'_>,
    at: &str,
    instancing: &Instancing,
    most: u64,
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
    if count as u64 > most {
        let bytes = resources.total_bytes();
        let what = format!("with its {count} instances the scene names too many in {bytes} bytes");
        return Err(resources.invalid(at.into(), what, "divide the scene"));
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

/// How far the bottom row of a matrix may be from 0 0 0 1 by rounding, relative to the largest number
/// that turns and scales. No projection comes near it.
const ROUNDING: f64 = 1e-5;

/// A node's own transform: its matrix, or translation after rotation after scale.
fn local_transform(node: &Node) -> Result<DAffine3, String> {
    if let Some(m) = &node.matrix {
        // Column by column, so the bottom row is every fourth number.
        let far = m.iter().enumerate().filter(|(place, _)| place % 4 < 3 && *place < 12);
        let far = far.fold(1.0, |far: f64, (_, lane)| far.max(lane.abs()));
        let is_zero = |lane: f64| lane.abs() <= ROUNDING * far;
        let is_rounded = [m[3], m[7], m[11]].into_iter().all(is_zero);
        if !(is_rounded && (m[15] - 1.0).abs() <= ROUNDING) {
            return Err("the bottom row of its matrix is not 0 0 0 1: it is a projection".into());
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
