use super::*;
use crate::format::{Cube, Level, Method, Part, ViewCell, fixture};

/// The rule that breaks once `change` is applied to a sound skeleton.
fn broken(change: impl FnOnce(&mut Skeleton)) -> Violation {
    let mut skeleton = fixture::skeleton();
    assert_eq!(check(&skeleton), Ok(()));
    change(&mut skeleton);
    check(&skeleton).expect_err("a broken skeleton passed")
}

fn hlod(id: u32) -> Place {
    Place::Hlod(HlodId(id))
}

fn blob(id: u32) -> Place {
    Place::Blob(BlobId(id))
}

#[test]
fn an_empty_tree_has_no_root() {
    assert_eq!(broken(|s| s.hlods.clear()).rule, Rule::NoHlods);
}

#[test]
fn links_must_form_a_tree() {
    assert_eq!(broken(|s| s.hlods[0].parent = 0).place, hlod(0));
    assert_eq!(broken(|s| s.hlods[1].parent = 2).rule, Rule::Parent { parent: 2 });
    assert_eq!(broken(|s| s.hlods[1].parent = NONE).place, hlod(1));
    assert_eq!(broken(|s| s.hlods[0].first_child = 0).rule, Rule::Children { first: 0, count: 2 });
    assert_eq!(broken(|s| s.hlods[0].child_count = u32::MAX).place, hlod(0));
    assert_eq!(broken(|s| s.hlods[0].child_count = 1).place, hlod(2));
    assert_eq!(broken(|s| s.hlods[1].first_child = 1).place, hlod(1));
    // Hlod 1 lists hlod 2, which names the root.
    let stolen = broken(|s| (s.hlods[1].first_child, s.hlods[1].child_count) = (2, 1));
    assert_eq!(stolen, Violation { place: hlod(1), rule: Rule::Children { first: 2, count: 1 } });
}

/// A chain of `n` hlods.
fn chain(n: u32) -> Skeleton {
    let mut skeleton = fixture::skeleton();
    let leaf = Hlod { source_triangles: 4, first_level: 0, level_count: 4, ..skeleton.hlods[0] };
    skeleton.levels.iter_mut().zip([0.0, 0.1, 0.2, 0.3]).for_each(|(l, error)| l.error = error);
    skeleton.hlods = (0..n)
        .map(|i| Hlod {
            parent: i.checked_sub(1).unwrap_or(NONE),
            first_child: if i + 1 < n { i + 1 } else { 0 },
            child_count: u32::from(i + 1 < n),
            level_count: if i + 1 < n { 0 } else { 4 },
            ..leaf
        })
        .collect();
    skeleton
}

#[test]
fn depth_is_limited() {
    assert_eq!(check(&chain(1)), Ok(()));
    assert_eq!(check(&chain(MAX_DEPTH)), Ok(()));
    assert_eq!(check(&chain(MAX_DEPTH + 1)).unwrap_err().rule, Rule::Depth);
}

#[test]
fn boxes_are_finite_ordered_and_nested() {
    assert_eq!(broken(|s| s.hlods[2].max[1] = f64::NAN).rule, Rule::NotFinite);
    assert_eq!(broken(|s| s.hlods[0].min[1] = f64::NEG_INFINITY).rule, Rule::NotFinite);
    assert_eq!(broken(|s| s.hlods[1].min[0] = 1.5).rule, Rule::EmptyBox);
    let outside = broken(|s| s.hlods[1].min[2] = -1e-9);
    assert_eq!(outside, Violation { place: hlod(1), rule: Rule::OutsideParent });
}

#[test]
fn counts_and_indices_of_hlods() {
    assert_eq!(broken(|s| s.hlods[1].first_level = 9).place, hlod(1));
    assert_eq!(broken(|s| s.hlods[1].level_count = u32::MAX).place, hlod(1));
    assert_eq!(broken(|s| s.hlods[1].level_count = 0).rule, Rule::BareLeaf);
    assert_eq!(broken(|s| s.hlods[1].level_count = 2).place, Place::Level(2));
    assert_eq!(broken(|s| s.hlods[0].level_count = 0).rule, Rule::Owners { owners: 0 });
    assert_eq!(broken(|s| s.hlods[2].object = 2).rule, Rule::Object { object: 2 });
    let sum = Rule::SourceTriangles { said: 4, sum: 5 };
    assert_eq!(broken(|s| s.hlods[1].source_triangles = 3).rule, sum);
    assert_eq!(broken(|s| s.info.source_triangles = 5).place, Place::Info);
    assert_eq!(broken(|s| s.hlods[1].source_triangles = u64::MAX).place, hlod(0));
}

#[test]
fn levels_name_what_exists() {
    let level = |change: fn(&mut Level)| broken(|s| change(&mut s.levels[3])).rule;
    assert_eq!(level(|l| l.triangles = 2), Rule::Triangles { said: 2, found: 1 });
    assert_eq!(level(|l| l.longest_edge = -1.0), Rule::LongestEdge { edge: -1.0 });
    assert!(matches!(level(|l| l.longest_edge = f32::NAN), Rule::LongestEdge { .. }));
    assert_eq!(level(|l| l.error = -0.1), Rule::Error { error: -0.1 });
    assert!(matches!(level(|l| l.error = f64::NAN), Rule::Error { .. }));
}

#[test]
fn parts_name_what_exists() {
    let part = |change: fn(&mut Part)| broken(|s| change(&mut s.parts[4]));
    assert_eq!(part(|p| p.blob = 7).rule, Rule::NoBlob { blob: 7 });
    assert_eq!(part(|p| p.blob = 4).rule, Rule::PatchAsPart { blob: 4 });
    assert_eq!(part(|p| p.blob = NONE).place, Place::Part(4));
    assert_eq!(part(|p| p.transform = 1).rule, Rule::NoTransform { transform: 1 });
    // Another mesh of other size.
    assert_eq!(part(|p| p.blob = 1).rule, Rule::Triangles { said: 1, found: 2 });
}

#[test]
fn parts_follow_each_other_level_after_level() {
    let range = |first, count, expected| Rule::PartRange { first, count, expected };
    assert_eq!(broken(|s| s.levels[1].first_part = 0).rule, range(0, 2, 1));
    assert_eq!(broken(|s| s.levels[1].first_part = u32::MAX).place, Place::Level(1));
    assert_eq!(broken(|s| s.levels[0].part_count = 0).rule, range(0, 0, 0));
    assert_eq!(broken(|s| s.levels[3].part_count = 2).rule, range(4, 2, 4));
    assert_eq!(broken(|s| s.levels[3].part_count = u32::MAX).rule, range(4, u32::MAX, 4));
    // Nobody's part.
    let stray = broken(|s| s.parts.push(s.parts[0]));
    assert_eq!(stray, Violation { place: Place::Part(5), rule: Rule::StrayPart });
    assert_eq!(broken(|s| s.parts.clear()).rule, range(0, 1, 0));
}

#[test]
fn triangles_have_classes_and_masks_textured_vertices() {
    let layout = broken(|s| s.blobs[0].layout = 4);
    assert_eq!(layout, Violation { place: blob(0), rule: Rule::Layout { layout: 4 } });
    // A textured mesh has more bytes.
    assert!(matches!(broken(|s| s.blobs[0].layout = 1).rule, Rule::MeshSize { .. }));
    let classes = Rule::Classes { sum: 3, triangles: 2 };
    assert_eq!(broken(|s| s.blobs[1].classes[3] = 1).rule, classes);
    let most = broken(|s| s.blobs[1].classes = [u32::MAX; 6]).rule;
    assert_eq!(most, Rule::Classes { sum: 6 * u64::from(u32::MAX), triangles: 2 });
    for class in [Class::MaskSingle, Class::MaskDouble] {
        let plain = broken(|s| s.blobs[1].classes = class.all(2));
        assert_eq!(plain, Violation { place: blob(1), rule: Rule::PlainMask });
    }
}

#[test]
fn texture_lists_follow_one_another_and_name_what_there_is() {
    assert_eq!(fixture::skeleton().textures_of(BlobId(3)), [0]);
    assert!(fixture::skeleton().textures_of(BlobId(0)).is_empty(), "it is not textured");
    for [first, count] in [[1, 0], [1, 1], [0, 2], [0, u32::MAX], [u32::MAX, 1]] {
        let found = broken(|s| s.blobs[3].image = [first, count]);
        let rule = Rule::TextureRange { first, count, expected: 0 };
        assert_eq!(found, Violation { place: blob(3), rule });
    }
    assert_eq!(broken(|s| s.texture_lists[0] = 1).rule, Rule::TextureList, "there is one texture");
    let twice = broken(|s| {
        s.texture_lists.push(0);
        s.blobs[3].image[1] = 2;
    });
    assert_eq!(twice, Violation { place: blob(3), rule: Rule::TextureList });
    assert_eq!(broken(|s| s.texture_lists.push(0)).rule, Rule::StrayTextures);
}

#[test]
fn textures_are_squares_with_all_their_mips_in_a_row() {
    let texture = |change: fn(&mut Texture)| broken(|s| change(&mut s.textures[0]));
    assert_eq!(texture(|t| t.side = 3).place, Place::Texture(0));
    assert_eq!(texture(|t| t.side = 0).rule, Rule::Side { side: 0 });
    assert_eq!(texture(|t| t.side = 8192).rule, Rule::Side { side: 8192 });
    assert_eq!(texture(|t| t.wrap = 3).rule, Rule::Wrap { wrap: 3 });
    assert_eq!(texture(|t| t.side = 4).rule, Rule::TextureSize { bytes: 20, expected: 84 });
    assert_eq!(texture(|t| t.offset = 64).rule, Rule::Offset { offset: 64, expected: 0 });
    assert_eq!(texture(|t| t.reserved = 1).rule, Rule::Reserved);
    let second = broken(|s| s.textures.push(s.textures[0]));
    let rule = Rule::Offset { offset: 0, expected: 64 };
    assert_eq!(second, Violation { place: Place::Texture(1), rule });
}

#[test]
fn measured_qualities_are_finite_and_not_negative() {
    let measures: [fn(&mut Criteria) -> &mut f64; 4] = [
        |c| &mut c.depth_mean,
        |c| &mut c.ideal_depth,
        |c| &mut c.overlap,
        |c| &mut c.localisation,
    ];
    for measure in measures {
        assert_eq!(broken(|s| *measure(&mut s.info.tree) = -0.5).rule, Rule::Negative);
        assert_eq!(broken(|s| *measure(&mut s.info.plain) = f64::NAN).rule, Rule::NotFinite);
    }
    assert_eq!(broken(|s| s.info.tree.reserved = 1).rule, Rule::Reserved);
    assert_eq!(broken(|s| s.info.plain.reserved2 = 1).rule, Rule::Reserved);
}

#[test]
fn errors_grow_towards_the_root() {
    let finer = broken(|s| s.levels[2].error = 0.3);
    let rule = Rule::NotMonotone { error: 0.25, finer: 0.3 };
    assert_eq!(finer, Violation { place: Place::Level(3), rule });
    assert_eq!(broken(|s| s.levels[0].error = 0.2).place, Place::Level(0));
}

#[test]
fn errors_grow_across_a_hlod_without_levels() {
    let mut skeleton = fixture::skeleton();
    // A new hlod without a stand-in between the root and its second child.
    skeleton.hlods[0].level_count = 1;
    let mut leaf = skeleton.hlods[2];
    leaf.parent = 2;
    skeleton.hlods.push(leaf);
    skeleton.hlods[2] = Hlod {
        first_child: 3,
        child_count: 1,
        level_count: 0,
        first_level: 0,
        ..skeleton.hlods[2]
    };
    assert_eq!(check(&skeleton), Ok(()));
    skeleton.levels[0].error = 0.1;
    assert_eq!(check(&skeleton).unwrap_err().place, Place::Level(0));
}

#[test]
fn blobs_are_meshes_in_a_row() {
    assert_eq!(broken(|s| s.blobs[1].offset += 64).place, blob(1));
    assert_eq!(broken(|s| s.blobs[2].offset = u64::MAX).place, blob(2));
    assert_eq!(broken(|s| s.blobs[0].bytes += 4).place, blob(0));
    assert_eq!(broken(|s| s.blobs[0].vertices = 0).place, blob(0));
    assert_eq!(broken(|s| s.blobs[0].origin[1] = f64::NAN).rule, Rule::NotFinite);
    let large = broken(|s| {
        s.blobs[2].vertices = MAX_BLOB_VERTICES as u32 + 1;
        s.blobs[2].bytes = blob_bytes(&s.blobs[2]);
    });
    assert!(matches!(large.rule, Rule::MeshSize { .. }));
    let empty = broken(|s| {
        s.blobs[2].triangles = 0;
        s.blobs[2].bytes = blob_bytes(&s.blobs[2]);
    });
    assert!(matches!(empty.rule, Rule::MeshSize { triangles: 0, .. }));
}

#[test]
fn steps_are_powers_of_two() {
    for step in [0.0, -0.25, 0.3, f64::NAN, f64::INFINITY, f64::MIN_POSITIVE / 2.0] {
        assert!(matches!(broken(|s| s.blobs[1].step = step).rule, Rule::Step { .. }), "{step}");
    }
    assert!(is_power_of_two(1.0) && is_power_of_two(2f64.powi(-40)) && is_power_of_two(1024.0));
}

#[test]
fn facts_and_placements() {
    assert_eq!(broken(|s| s.info.up = [0.0; 3]).rule, Rule::NoUp);
    assert_eq!(broken(|s| s.info.up[0] = f64::NAN).rule, Rule::NotFinite);
    assert_eq!(broken(|s| s.info.reserved2 = 1).rule, Rule::Reserved);
    let transform = broken(|s| s.transforms[0].linear[1][2] = f64::INFINITY);
    assert_eq!(transform, Violation { place: Place::Transform(0), rule: Rule::NotFinite });
    for far in [1e31, -1e301, f64::MAX] {
        assert_eq!(broken(|s| s.transforms[0].linear[1][1] = far).rule, Rule::TooFar);
        assert_eq!(broken(|s| s.transforms[0].translation[1] = far).rule, Rule::TooFar);
        assert_eq!(broken(|s| s.blobs[0].origin[1] = far).rule, Rule::TooFar);
        assert_eq!(broken(|s| s.hlods[0].max[1] = far.abs()).rule, Rule::TooFar);
    }
    assert_eq!(transform.to_string(), "transform 0: a number is not finite");
}

#[test]
fn patches_alone_have_pictures_and_begin_with_a_tile() {
    let picture = |id: usize, image: [u32; 2]| {
        let found = broken(|s| s.blobs[id].image = image);
        let rule = Rule::Picture { side: image[0], tiles: image[1] };
        assert_eq!(found, Violation { place: blob(id as u32), rule });
    };
    picture(0, [0, 1]);
    for side in [0, 8, 40, 8192, u32::MAX] {
        picture(4, [side, 0]);
    }
    picture(4, [32, 5]);
    assert_eq!(broken(|s| s.blobs[1].layout = 2).rule, Rule::Picture { side: 0, tiles: 0 });
    assert_eq!(broken(|s| s.blobs[1].layout = 3).rule, Rule::Picture { side: 0, tiles: 0 });
    assert!(matches!(broken(|s| s.blobs[4].image[1] = 3).rule, Rule::MeshSize { .. }));
    // With normals, and without.
    assert!(matches!(broken(|s| s.blobs[4].layout = 3).rule, Rule::MeshSize { .. }));
    assert!(matches!(broken(|s| s.blobs[5].layout = 2).rule, Rule::MeshSize { .. }));
    let single = broken(|s| s.blobs[5].classes = [1, 1, 0, 0, 0, 0]);
    assert_eq!(single, Violation { place: blob(5), rule: Rule::PatchClass });
    for origin in [[0.0, 0.0, 1.0], [8.0, 0.0, 0.0], [0.0, -16.0, 0.0]] {
        assert_eq!(broken(|s| s.blobs[4].origin = origin).rule, Rule::PatchOrigin);
    }
    assert_eq!(broken(|s| s.blobs[4].step = 0.3).rule, Rule::Step { step: 0.3 });
}

#[test]
fn every_patch_belongs_to_one_cube() {
    let owners = |id, owners| Violation { place: blob(id), rule: Rule::PatchOwners { owners } };
    let unnamed = broken(|s| {
        s.cubes[0].patches = [4, 5, 5, 5, 5, 5, 5];
        s.cubes[0].triangles = 1;
    });
    assert_eq!(unnamed, owners(5, 0));
    let shared = broken(|s| {
        s.cubes[1].patches[0] = 5;
        s.cubes[1].triangles = 3;
    });
    assert_eq!(shared, owners(5, 2));
    assert_eq!(broken(|s| s.cubes[0].patches[0] = 3).rule, Rule::NoPatch { blob: 3 });
    assert_eq!(broken(|s| s.cubes[1].patches[6] = 8).rule, Rule::NoPatch { blob: 7 });
    assert_eq!(broken(|s| s.cubes[0].patches[1] = 7).rule, Rule::Patches);
}

#[test]
fn windows_lie_in_their_face() {
    for side in [0, 40, 8192] {
        assert_eq!(broken(|s| s.cubes[0].side = side).rule, Rule::Face { side });
    }
    let beyond = broken(|s| s.cubes[0].side = 32);
    assert_eq!(beyond, Violation { place: blob(4), rule: Rule::Window { side: 32 } });
    let down = broken(|s| s.blobs[6].origin[1] = 48.0);
    assert_eq!(down, Violation { place: blob(6), rule: Rule::Window { side: 48 } });
}

#[test]
fn view_cells_have_an_inside_a_method_and_the_cubes_it_makes() {
    let cell = |change: fn(&mut ViewCell)| broken(|s| change(&mut s.view_cells[0])).rule;
    assert_eq!(cell(|c| c.max[1] = 0.0), Rule::FlatCell);
    assert_eq!(cell(|c| c.min[2] = f64::NAN), Rule::NotFinite);
    assert_eq!(cell(|c| c.objective = f64::INFINITY), Rule::NotFinite);
    assert_eq!(cell(|c| c.objective = -0.1), Rule::Negative);
    for margin in [-0.1, 0.5, f32::INFINITY] {
        assert_eq!(broken(|s| s.view_cells[0].margin = margin).rule, Rule::Margin { margin });
    }
    assert!(matches!(cell(|c| c.margin = f32::NAN), Rule::Margin { .. }));
    assert_eq!(cell(|c| c.method = 3), Rule::Method { method: 3 });
    assert_eq!(cell(|c| c.method = 0), Rule::CubeCount { count: 2 });
    let range = |first, count, expected| Rule::CubeRange { first, count, expected };
    assert_eq!(cell(|c| c.first_cube = 1), range(1, 2, 0));
    assert_eq!(cell(|c| c.cube_count = 3), range(0, 3, 0));
    assert_eq!(cell(|c| c.cube_count = u32::MAX), range(0, u32::MAX, 0));
    let second = broken(|s| s.view_cells[1].first_cube = 0);
    assert_eq!(second, Violation { place: Place::ViewCell(1), rule: range(0, 0, 2) });
    let empty = broken(|s| s.view_cells[1].method = Method::Tdm as u32);
    assert_eq!(empty, Violation { place: Place::ViewCell(1), rule: Rule::CubeCount { count: 0 } });
    let stray = broken(|s| s.cubes.push(s.cubes[1]));
    assert_eq!(stray, Violation { place: Place::Cube(2), rule: Rule::StrayCube });
    assert_eq!(broken(|s| s.view_cells.clear()).place, Place::Cube(0));
}

#[test]
fn cubes_lie_in_their_cell_and_depend_on_earlier_ones_of_it() {
    let cube = |change: fn(&mut Cube)| broken(|s| change(&mut s.cubes[1]));
    let outside = cube(|c| c.eye[0] = 1.5);
    assert_eq!(outside, Violation { place: Place::Cube(1), rule: Rule::OutsideCell });
    assert_eq!(cube(|c| c.eye[0] = f64::NAN).rule, Rule::NotFinite);
    assert_eq!(cube(|c| c.triangles = 2).rule, Rule::Triangles { said: 2, found: 1 });
    assert_eq!(cube(|c| c.parent = 1).rule, Rule::CubeParent { parent: 1 });
    assert_eq!(broken(|s| s.cubes[0].parent = 0).place, Place::Cube(0));
    // Whole cubes depend on none.
    let whole = broken(|s| s.view_cells[0].method = Method::Tdm as u32);
    assert_eq!(whole, Violation { place: Place::Cube(1), rule: Rule::CubeParent { parent: 0 } });
    // Each cube in a cell of its own: the second cannot depend on the first.
    let foreign = broken(|s| {
        s.view_cells[0].cube_count = 1;
        s.view_cells[1] = ViewCell { first_cube: 1, ..s.view_cells[0] };
    });
    assert_eq!(foreign, Violation { place: Place::Cube(1), rule: Rule::CubeParent { parent: 0 } });
}

#[test]
fn cells_that_touch_do_not_overlap() {
    let cells = fixture::view_cells();
    assert_eq!(check_disjoint(&[]), Ok(()));
    assert_eq!(check_disjoint(&cells), Ok(()));
    let moved = |by: [f64; 3]| {
        let c = cells[0];
        let shift = |corner: [f64; 3]| std::array::from_fn(|k| corner[k] + by[k]);
        ViewCell { min: shift(c.min), max: shift(c.max), ..c }
    };
    let beside = [[0.0, 1.0, 0.0], [0.5, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.25, -1.0, 0.5]];
    beside.iter().for_each(|&by| assert_eq!(check_disjoint(&[cells[0], moved(by)]), Ok(())));
    for by in [[0.5, 0.0, 0.0], [-0.5, 0.5, 0.9], [0.0; 3]] {
        let overlap = Violation { place: Place::ViewCell(2), rule: Rule::Overlap { other: 0 } };
        let far = moved([0.0, 5.0, 0.0]);
        assert_eq!(check_disjoint(&[cells[0], far, moved(by)]), Err(overlap));
        assert_eq!(check_disjoint(&[moved(by), far, cells[0]]), Err(overlap));
    }
}
