//! What the tests of all importers share.

use std::path::Path;

use proptest::prelude::*;

use super::emit::Emitter;
use super::{Collect, ImportError, ImportLimits};
use crate::source::{Imported, Source};

/// The side of the largest texture in tests.
pub(super) const TEXTURE_SIDE: u32 = 8;

/// Everything an importer hands out for a file of this name.
pub(super) fn collect(
    file: &str,
    import: impl FnOnce(Emitter<'_>) -> Result<Imported, ImportError>,
) -> Result<Source, ImportError> {
    collect_within(file, ImportLimits::default(), import)
}

/// The same within other limits, but for the side of textures.
pub(super) fn collect_within(
    file: &str,
    limits: ImportLimits,
    import: impl FnOnce(Emitter<'_>) -> Result<Imported, ImportError>,
) -> Result<Source, ImportError> {
    let mut whole = Source::default();
    let limits = ImportLimits { texture_side: TEXTURE_SIDE, ..limits };
    let mut sink = Collect(&mut whole);
    let imported = import(Emitter::new(Path::new(file), limits, &mut sink))?;
    whole.complete(imported);
    Ok(whole)
}

/// What every import promises, whatever the file was; `largest` is the limit of textures.
pub(super) fn check(source: &Source, largest: u32) -> Result<(), TestCaseError> {
    for mesh in &source.meshes {
        let vertices = mesh.positions.len();
        prop_assert!(mesh.normals.len() == vertices && mesh.colors.len() == vertices);
        prop_assert!(mesh.tex_coords.is_empty() || mesh.tex_coords.len() == vertices);
        prop_assert!(mesh.indices.iter().flatten().all(|&index| (index as usize) < vertices));
        prop_assert!(
            mesh.positions.iter().chain(&mesh.normals).flatten().all(|lane| lane.is_finite())
        );
        prop_assert!(mesh.tex_coords.iter().flatten().all(|lane| lane.is_finite()));
        prop_assert!(
            mesh.normals
                .iter()
                .all(|n| (n.iter().map(|lane| lane * lane).sum::<f32>() - 1.0).abs() < 1e-5)
        );
        let mut surface_of = vec![None; vertices];
        let mut start = 0;
        for section in &mesh.sections {
            let surface = source.surfaces[usize::from(section.surface)];
            let textured = surface.texture.is_some();
            prop_assert!(!textured || mesh.tex_coords.len() == vertices);
            prop_assert!(section.end as usize > start);
            for &index in mesh.indices[start..section.end as usize].as_flattened() {
                let known = surface_of[index as usize].replace(section.surface);
                prop_assert!(known.is_none_or(|known| known == section.surface));
            }
            start = section.end as usize;
        }
        prop_assert_eq!(start, mesh.indices.len());
    }
    for surface in &source.surfaces {
        prop_assert!(surface.texture.is_none_or(|t| (t as usize) < source.textures.len()));
    }
    for texture in &source.textures {
        prop_assert!(texture.side.is_power_of_two() && texture.side <= largest);
        prop_assert_eq!(texture.rgba.len(), 4 * texture.side as usize * texture.side as usize);
    }
    prop_assert!(source.objects.iter().all(|object| object.mesh < source.meshes.len()));
    prop_assert!(source.objects.iter().all(|object| object.world_from_mesh.is_finite()));
    prop_assert!(source.meshes.iter().any(|mesh| !mesh.indices.is_empty()));
    Ok(())
}
