//! The real scenes, where they are at hand.

use std::collections::BTreeSet;
use std::path::Path;

use crate::import::{ImportLimits, import_all as import};
use crate::source::{Section, Source, Wrap};

/// File, triangles with instances, unique triangles if the list of scenes gives them, objects.
const SCENES: [(&str, u64, Option<u64>, usize); 5] = [
    ("indoor_schependomlaan", 463_338, Some(193_324), 6_045),
    ("indoor_aws_small_house", 148_404, Some(114_794), 87),
    ("city_wageningen", 456_179, None, 10_292),
    ("cad_ldraw_town_hall", 1_307_423, Some(309_223), 2_804),
    ("outdoor_genesis_plaza_street", 171_574, Some(55_430), 627),
];

#[test]
fn the_real_scenes_import_with_their_published_counts() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes");
    for (name, triangles, unique, objects) in SCENES {
        let file = folder.join(name).with_extension("glb");
        if !file.exists() {
            eprintln!("skipped: {} is not at hand", file.display());
            continue;
        }
        let source = import(&file).unwrap();
        println!("{name}: {} meshes, {:?}", source.meshes.len(), source.notes);
        assert_eq!((source.triangles(), source.objects.len()), (triangles, objects), "{name}");
        assert_eq!(source.unique_triangles(), unique.unwrap_or(triangles), "{name}");
        crate::import::testing::check(&source, ImportLimits::default().texture_side).unwrap();
        let used: BTreeSet<u32> = source.surfaces.iter().filter_map(|s| s.texture).collect();
        assert!(used.into_iter().eq(0..source.textures.len() as u32), "{name}");
        if name == "indoor_aws_small_house" {
            a_furnished_house_is_textured(&source);
        }
    }
}

/// Its 83 pictures are photographs and patterns; hardly one is a plain colour.
fn a_furnished_house_is_textured(source: &Source) {
    let textures = source.textures.len();
    assert!((60..=83).contains(&textures), "{textures}");
    assert!(source.textures.iter().all(|texture| texture.wrap == [Wrap::Repeat; 2]));
    let of = |section: &Section| source.surfaces[usize::from(section.surface)].texture;
    let mapped = source.meshes.iter().filter(|mesh| {
        mesh.sections.iter().any(|section| of(section).is_some()) && !mesh.tex_coords.is_empty()
    });
    assert!(mapped.count() > 50);
}
