//! glTF 2.0, as `.gltf` or `.glb`, to a [`Source`].
//!
//! The JSON is read as plain data and every claim in it is checked where it is used, against the
//! bytes that are there: a broken file is an [`ImportError`] that names the object, never a panic
//! and never an allocation of a claimed size. Nothing animates here: cameras, skins, animations
//! and morph targets leave their base pose and a line in [`Source::notes`].

mod accessor;
mod buffers;
mod container;
mod document;
mod error;
mod material;
mod mesh;
mod nodes;
mod press;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod triangles;
mod uri;

use std::collections::BTreeSet;
use std::path::Path;

use glam::DMat3;
use rayon::prelude::*;

pub use error::{ImportError, ImportErrorKind};

use self::buffers::Resources;
use self::document::{Document, label};
use self::mesh::Tally;
use self::nodes::Placement;
use crate::source::{Source, SourceMesh, SourceObject, Surface};

/// The up direction of every glTF scene (glTF 2.0, section 3.4).
const UP: [f64; 3] = [0.0, 1.0, 0.0];

/// Reads the scene file at `path`, and the buffers and textures it refers to.
///
/// A glTF mesh becomes one [`SourceMesh`] however many nodes show it; a node that shows it becomes
/// a [`SourceObject`]. External files are read from the scene's own folder only. The result does
/// not depend on how many threads there are.
///
/// # Errors
///
/// See [`ImportError`]; [`ImportError::kind`] sorts them for an exit code.
pub fn import(path: &Path) -> Result<Source, ImportError> {
    let bytes = std::fs::read(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => ImportError::NotFound { file: path.into() },
        _ => ImportError::Read { file: path.into(), source },
    })?;
    import_bytes(path, &bytes)
}

fn import_bytes(file: &Path, bytes: &[u8]) -> Result<Source, ImportError> {
    let parts = container::split(file, bytes)?;
    let document = container::parse(file, &bytes[parts.json])?;
    let resources = Resources::load(file, &document, parts.bin.map(|bin| &bytes[bin]))?;
    let placements = nodes::placements(&resources)?;

    let mut notes = describe_ignored(&document);
    let shown: BTreeSet<usize> = placements.iter().map(|placement| placement.mesh).collect();
    let surfaces = material::surfaces(&resources, &materials_of(&resources, &shown)?, &mut notes)?;
    let shown: Vec<usize> = shown.into_iter().collect();
    let meshes: Vec<Result<(SourceMesh, Tally), ImportError>> = shown
        .par_iter()
        .map(|&number| {
            let surface = |material: Option<usize>| {
                material.map_or(material::PLAIN, |number| surfaces[&number])
            };
            mesh::read(&resources, number, &document.meshes[number], surface)
        })
        .collect();
    // In the file's order, so that of several faults always the same one is reported.
    let meshes = meshes.into_iter().collect::<Result<Vec<_>, _>>()?;
    assemble(&resources, &shown, meshes, placements, notes)
}

/// The materials that the `shown` meshes use, every reference checked.
fn materials_of(
    resources: &Resources<'_>,
    shown: &BTreeSet<usize>,
) -> Result<BTreeSet<usize>, ImportError> {
    let document = resources.document;
    let mut used = BTreeSet::new();
    for &number in shown {
        let mesh = &document.meshes[number];
        for material in mesh.primitives.iter().filter_map(|primitive| primitive.material) {
            if material >= document.materials.len() {
                let what =
                    format!("it refers to material {material} of {}", document.materials.len());
                return Err(resources.broken(&label("mesh", number, mesh.name.as_ref()), what));
            }
            used.insert(material);
        }
    }
    Ok(used)
}

/// Joins meshes and placements, leaving out what holds no triangle at all.
fn assemble(
    resources: &Resources<'_>,
    shown: &[usize],
    read: Vec<(SourceMesh, Tally)>,
    placements: Vec<Placement>,
    mut notes: Vec<String>,
) -> Result<Source, ImportError> {
    let mut tally = Tally::default();
    let mut meshes = Vec::with_capacity(read.len());
    let mut place_of = vec![None; resources.document.meshes.len()];
    for (&number, (mesh, own)) in shown.iter().zip(read) {
        tally.add(&own);
        if mesh.triangles() > 0 {
            place_of[number] = Some(meshes.len());
            meshes.push(mesh);
        }
    }
    let nodes = placements.len();
    let mut objects = Vec::with_capacity(nodes);
    for Placement { name, mesh, mut world_from_mesh } in placements {
        let Some(mut mesh) = place_of[mesh] else { continue };
        if press::is_flat(&world_from_mesh) {
            let pressed =
                press::press(&meshes[mesh], world_from_mesh.matrix3).ok_or_else(|| {
                    resources.invalid(
                        format!("object {name:?}"),
                        "its transform is too large".into(),
                        "scale it down",
                    )
                })?;
            world_from_mesh.matrix3 = DMat3::IDENTITY;
            mesh = meshes.len();
            meshes.push(pressed);
        }
        objects.push(SourceObject { name, mesh, world_from_mesh });
    }
    describe_tally(&tally, nodes - objects.len(), &mut notes);
    drop_unused(&mut meshes, &mut objects);
    if meshes.iter().all(|mesh| mesh.indices.is_empty()) {
        return Err(ImportError::Empty { file: resources.file.into(), notes });
    }
    Ok(Source {
        meshes,
        objects,
        surfaces: vec![Surface::PLAIN],
        textures: Vec::new(),
        up: UP,
        notes,
    })
}

/// Removes meshes that no object shows: those that only pressed objects showed.
fn drop_unused(meshes: &mut Vec<SourceMesh>, objects: &mut [SourceObject]) {
    let mut used = vec![false; meshes.len()];
    objects.iter().for_each(|object| used[object.mesh] = true);
    // Where each mesh goes: as many places up as meshes in use stand before it.
    let place: Vec<usize> = used
        .iter()
        .scan(0, |before, &used| {
            let place = *before;
            *before += usize::from(used);
            Some(place)
        })
        .collect();
    let mut used = used.into_iter();
    meshes.retain(|_| used.next().is_some_and(|used| used));
    objects.iter_mut().for_each(|object| object.mesh = place[object.mesh]);
}

fn describe_ignored(document: &Document) -> Vec<String> {
    let mut notes = Vec::new();
    let counted = [
        (document.cameras.len(), "cameras ignored"),
        (document.skins.len(), "skins ignored, the base pose is used"),
        (document.animations.len(), "animations ignored, the base pose is used"),
    ];
    notes.extend(
        counted
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{count} {what}")),
    );
    for extension in &document.extensions_used {
        if extension == "KHR_texture_transform" {
            notes.push("texture transforms ignored: a texture counts by its mean".into());
        } else if !container::is_supported(extension) {
            notes.push(format!("optional extension {extension} ignored"));
        }
    }
    let blended = document
        .materials
        .iter()
        .filter(|material| material.alpha_mode.as_deref() == Some("BLEND"))
        .count();
    if blended > 0 {
        notes.push(format!("{blended} blended materials, drawn as opaque"));
    }
    notes
}

fn describe_tally(tally: &Tally, objects_without_triangles: usize, notes: &mut Vec<String>) {
    let counted = [
        (tally.points_and_lines, "point and line primitives skipped"),
        (tally.without_positions, "primitives without positions skipped"),
        (tally.morphed, "primitives with morph targets, the base shape is used"),
        (tally.leftover_corners, "corners left over at the end of triangle lists"),
        (tally.degenerate, "degenerate triangles left out, instances not counted"),
        (tally.mended_normals, "normals without a direction replaced by those of faces"),
        (objects_without_triangles as u64, "objects without triangles skipped"),
    ];
    notes.extend(
        counted
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{count} {what}")),
    );
}
