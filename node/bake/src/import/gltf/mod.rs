//! glTF 2.0, as `.gltf` or `.glb`.
//!
//! The JSON is read as plain data and every claim in it is checked where it is used. Of the binary
//! data only what a batch of meshes needs is in memory. Nothing animates here: cameras, skins,
//! animations and morph targets leave their base pose and a note.

mod accessor;
mod buffers;
mod compressed;
mod container;
mod document;
mod lenient;
mod material;
mod mesh;
mod nodes;
mod press;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod triangles;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use glam::DMat3;
use rayon::prelude::*;

use self::buffers::Resources;
use self::document::{Document, Primitive, label};
use self::material::Material;
use self::mesh::{Portion, Tally};
use self::nodes::Placement;
use super::builder::Draft;
use super::emit::{ALL_UNSEEN, Emitter};
use super::error::ImportError;
use super::store::Store;
use crate::source::{Imported, SourceMesh, SourceObject};

/// The up direction of every glTF scene (glTF 2.0, section 3.4).
const UP: [f64; 3] = [0.0, 1.0, 0.0];
/// Bytes that meshes being read may need at once: this part of the memory there is, and no more than
/// keeps all threads busy.
const BATCHES: u64 = 4;
const MOST_BATCH_BYTES: u64 = 64 << 20;
/// Triangles that any file may name, and those it may name more for each of its bytes. An index takes a
/// byte at least, so a list would have to be used some fifty times.
const FREE_TRIANGLES: u64 = 1 << 24;
const TRIANGLES_A_BYTE: u64 = 16;

/// Reads the scene file at `path`, and the buffers and textures it refers to.
///
/// A glTF mesh becomes one mesh however many nodes show it; a node that shows it becomes an object,
/// or one for each instance.
pub(super) fn import(path: &Path, out: Emitter<'_>) -> Result<Imported, ImportError> {
    let store = Store::open(path).map_err(|source| ImportError::unreadable(path, source))?;
    import_store(path, store, out)
}

fn import_store(file: &Path, store: Store, mut out: Emitter<'_>) -> Result<Imported, ImportError> {
    let mut notes = Vec::new();
    let parts = container::split(file, &store, &mut notes)?;
    let length = usize::try_from(parts.json.end - parts.json.start).unwrap_or(usize::MAX);
    let json = store
        .read(parts.json.start, length)
        .map_err(|source| ImportError::unreadable(file, source))?;
    let document = container::parse(file, &json, &mut notes)?;
    drop(json);
    let resources = Resources::load(file, &document, store, parts.bin)?;
    let mut placements = nodes::placements(&resources, &out.limits.scene, &mut notes)?;
    let first = first_alike(&document);
    placements.iter_mut().for_each(|placement| placement.mesh = first[placement.mesh]);
    hold_total(&resources, &placements, length as u64)?;

    describe_ignored(&document, &mut notes);
    let used = materials_of(&resources, placements.iter().map(|placement| placement.mesh))?;
    let materials = material::materials(&resources, &used, &mut out, &mut notes)?;
    let mut reader = Reader {
        resources: &resources,
        materials: &materials,
        seen: vec![false; document.meshes.len()],
        tally: Tally::default(),
        out,
    };
    let objects = reader.objects(placements, &mut notes)?;
    let Reader { out, .. } = reader;
    out.finish(objects, UP, notes)
}

/// By mesh: the first that looks the same, which stands for it.
fn first_alike(document: &Document) -> Vec<usize> {
    let mut known = HashMap::new();
    let mut first = Vec::with_capacity(document.meshes.len());
    for (number, mesh) in document.meshes.iter().enumerate() {
        let key: Vec<_> = mesh.primitives.iter().map(Primitive::key).collect();
        first.push(*known.entry(key).or_insert(number));
    }
    first
}

/// Refuses a file that names many more triangles than its bytes can account for: by using the same
/// lists again and again, a small one makes any amount of work.
fn hold_total(
    resources: &Resources<'_>,
    placements: &[Placement],
    json_bytes: u64,
) -> Result<(), ImportError> {
    // A mesh is read once for all that show it, and once for each that presses it flat.
    let mut shown = BTreeMap::new();
    for placement in placements {
        let times = shown.entry(placement.mesh).or_insert([0u64; 2]);
        times[usize::from(press::is_flat(&placement.world_from_mesh))] += 1;
    }
    let claimed = shown.into_iter().map(|(mesh, [upright, flat])| {
        let times = upright.min(1) + flat;
        (mesh, mesh::triangles(resources, mesh).saturating_mul(times))
    });
    let claimed: Vec<(usize, u64)> = claimed.collect();
    let total = claimed.iter().fold(0u64, |sum, (_, triangles)| sum.saturating_add(*triangles));
    let bytes = resources.total_bytes().saturating_add(json_bytes);
    if total <= FREE_TRIANGLES.max(bytes.saturating_mul(TRIANGLES_A_BYTE)) {
        return Ok(());
    }
    let most = claimed.iter().max_by_key(|(_, triangles)| triangles).map_or(0, |(mesh, _)| *mesh);
    let name = resources.document.meshes[most].name.as_ref();
    let what = format!(
        "with it the scene names {total} triangles in {bytes} bytes, the same lists again and again"
    );
    let fix = "let nodes share a mesh instead, or divide the scene";
    Err(resources.invalid(label("mesh", most, name), what, fix))
}

/// The materials that the `shown` meshes use, every reference checked.
fn materials_of(
    resources: &Resources<'_>,
    shown: impl Iterator<Item = usize>,
) -> Result<BTreeSet<usize>, ImportError> {
    let document = resources.document;
    let mut used = BTreeSet::new();
    for number in shown.collect::<BTreeSet<usize>>() {
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

/// Reads meshes, a batch at a time, and hands them out.
struct Reader<'a, 's> {
    resources: &'a Resources<'a>,
    materials: &'a BTreeMap<usize, Material>,
    /// By mesh: whether it is in `tally`.
    seen: Vec<bool>,
    tally: Tally,
    out: Emitter<'s>,
}

impl Reader<'_, '_> {
    /// Hands out every mesh that is shown; the objects that show them.
    fn objects(
        &mut self,
        placements: Vec<Placement>,
        notes: &mut Vec<String>,
    ) -> Result<Vec<SourceObject>, ImportError> {
        let is_flat = |placement: &&Placement| press::is_flat(&placement.world_from_mesh);
        let shown: BTreeSet<usize> = placements
            .iter()
            .filter(|placement| !is_flat(placement))
            .map(|placement| placement.mesh)
            .collect();
        let mut place_of = vec![None; self.seen.len()];
        let shown: Vec<usize> = shown.into_iter().collect();
        self.read(
            &shown,
            |number| number,
            |_, draft| Ok(draft),
            |number, place| {
                place_of[number] = place;
            },
        )?;
        let flat: Vec<(usize, &Placement)> =
            placements.iter().enumerate().filter(|(_, placement)| is_flat(placement)).collect();
        let mut place_of_flat = BTreeMap::new();
        let file = self.resources;
        self.read(
            &flat,
            |(_, placement)| placement.mesh,
            |(_, placement), draft| {
                press::press(&draft, placement.world_from_mesh.matrix3).ok_or_else(|| {
                    file.invalid(
                        format!("object {:?}", placement.name),
                        "its transform is too large".into(),
                        "scale it down",
                    )
                })
            },
            |(number, _), place| {
                place_of_flat.insert(number, place);
            },
        )?;

        let nodes = placements.len();
        let mut objects = Vec::with_capacity(nodes);
        for (number, placement) in placements.into_iter().enumerate() {
            let Placement { name, mesh, mut world_from_mesh } = placement;
            let place = match place_of_flat.get(&number) {
                Some(&place) => {
                    world_from_mesh.matrix3 = DMat3::IDENTITY;
                    place
                }
                None => place_of[mesh],
            };
            let Some(mesh) = place else { continue };
            objects.push(SourceObject { name, mesh, world_from_mesh });
        }
        describe_tally(&self.tally, nodes - objects.len(), notes);
        Ok(objects)
    }

    /// Reads and hands out a mesh for each of `items`, in their order: `mesh_of` gives its number in
    /// the document, `change` what becomes of it, and `done` hears its number in the sink, or `None`
    /// if it holds no triangle at all.
    fn read<T: Copy + Sync>(
        &mut self,
        items: &[T],
        mesh_of: impl Fn(T) -> usize,
        change: impl Fn(T, Draft) -> Result<Draft, ImportError> + Sync,
        mut done: impl FnMut(T, Option<usize>),
    ) -> Result<(), ImportError> {
        let (resources, materials) = (self.resources, self.materials);
        let at_once = (self.out.limits.memory / BATCHES).min(MOST_BATCH_BYTES);
        let portions = |&item: &T| {
            let portions = mesh::portions(resources, mesh_of(item)).into_iter();
            portions.map(move |portion| (item, portion))
        };
        let mut waiting = items.iter().flat_map(portions).peekable();
        // Of the mesh whose portions are coming in: its place in the sink, and whether it counts.
        let (mut place, mut counts) = (None, true);
        while waiting.peek().is_some() {
            let mut batch: Vec<(T, Portion)> = Vec::new();
            let mut bytes = 0u64;
            while let Some((_, portion)) = waiting.peek() {
                bytes = bytes.saturating_add(portion.bytes());
                if bytes > at_once && !batch.is_empty() {
                    break;
                }
                batch.extend(waiting.next());
            }
            let drafts: Vec<Result<(Draft, Tally), ImportError>> = batch
                .par_iter()
                .map(|(item, portion)| {
                    let material = |material: Option<usize>| {
                        material.map_or(&material::DEFAULT, |number| &materials[&number])
                    };
                    let (draft, tally) = mesh::read(resources, portion, material)?;
                    Ok((change(*item, draft)?, tally))
                })
                .collect();
            // In order, so that of several faults always the same one is reported.
            for ((item, portion), draft) in batch.into_iter().zip(drafts) {
                let (draft, tally) = draft?;
                if portion.is_first {
                    counts = !std::mem::replace(&mut self.seen[portion.mesh], true);
                    place = None;
                }
                if counts {
                    self.tally.add(&tally);
                }
                match place {
                    _ if SourceMesh::triangles(&draft.mesh) == 0 => {}
                    None => place = Some(self.out.mesh(draft)?),
                    Some(_) => self.out.more(draft)?,
                }
                if portion.is_last {
                    done(item, place);
                }
            }
        }
        Ok(())
    }
}

fn describe_ignored(document: &Document, notes: &mut Vec<String>) {
    let counted = [
        (document.cameras.len(), "cameras ignored"),
        (document.skins.len(), "skins ignored, the base pose is used"),
        (document.animations.len(), "animations ignored, the base pose is used"),
        (document.extensions.lights.lights.len(), "lights ignored"),
        (
            document.extensions.variants.variants.len(),
            "variants of materials ignored, each primitive's own material is used",
        ),
    ];
    notes.extend(
        counted
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{count} {what}")),
    );
    for extension in &document.extensions_used {
        if !container::is_supported(extension) {
            notes.push(format!("optional extension {extension} ignored"));
        }
    }
}

fn describe_tally(tally: &Tally, objects_without_triangles: usize, notes: &mut Vec<String>) {
    if tally.unseen > 0 && tally.seen == 0 {
        notes.push(ALL_UNSEEN.into());
    }
    let counted = [
        (tally.points_and_lines, "point and line primitives skipped"),
        (tally.without_positions, "primitives without positions skipped"),
        (tally.morphed, "primitives with morph targets, the base shape is used"),
        (tally.leftover_corners, "corners left over at the end of triangle lists"),
        (tally.degenerate, "degenerate triangles left out, instances not counted"),
        (tally.mended_normals, "normals without a direction replaced by those of faces"),
        (tally.mended_tex_coords, "texture coordinates that are no numbers replaced by zero"),
        (
            tally.without_tex_coords,
            "textured primitives without texture coordinates, in one colour",
        ),
        (objects_without_triangles as u64, "objects without triangles skipped"),
    ];
    notes.extend(
        counted
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{count} {what}")),
    );
}
