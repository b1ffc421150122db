//! Geometry that no modeller should make and every exporter does, through bake, verify and deep check.

use super::whole::solid;
use super::*;

/// Numbers that look random and are the same everywhere.
fn noise(n: u32) -> f32 {
    let mixed = n.wrapping_mul(0x9e37_79b9).rotate_left(13).wrapping_mul(0x85eb_ca6b);
    (mixed ^ mixed >> 15) as f32 / u32::MAX as f32
}

fn placed(mesh: SourceMesh, world_from_mesh: DAffine3) -> Source {
    source(vec![mesh], vec![object(0, world_from_mesh)])
}

/// Small pieces, so that little geometry makes a deep tree.
fn deep_tree() -> Options {
    Options {
        piece_triangles: 100,
        piece_least_triangles: 8,
        hlod_triangles: 200,
        ..Options::default()
    }
}

#[test]
fn triangles_without_area_are_left_out() {
    let mut mesh = terrain(20);
    let collinear: Vec<[u32; 3]> =
        (0..20).map(|i| [i, i + 1, i]).chain((0..18).map(|i| [21 * i, 21 * i, 5])).collect();
    // Three corners in the same place, and thinner than any grid.
    let first = mesh.positions.len() as u32;
    mesh.positions.extend([
        [3.0, 9.0, 3.0],
        [3.0, 9.0, 3.0],
        [3.0, 9.0, 3.0],
        [9.0, 9.0 + 1e-30, 9.0],
    ]);
    mesh.normals.extend([[0.0, 1.0, 0.0]; 4]);
    mesh.colors.extend([[255; 4]; 4]);
    mesh.indices.extend(collinear);
    mesh.indices.extend([[first, first + 1, first + 2], [first, first + 1, first + 3]]);
    let sheet = baked(&once(vec![mesh]), &deep_tree());
    assert_eq!(sheet.original_triangles(), 800);
}

#[test]
fn duplicate_triangles_bake() {
    let mut mesh = terrain(20);
    let again: Vec<[u32; 3]> =
        mesh.indices.iter().flat_map(|&[a, b, c]| [[b, c, a], [a, c, b]]).collect();
    mesh.indices.extend(again);
    let sheet = baked(&once(vec![mesh]), &deep_tree());
    assert_eq!(sheet.summary.source_triangles, 2400);
    assert!(sheet.deep.levels > 4);
}

#[test]
fn fans_around_one_edge_bake() {
    // Ten books of 40 pages: an edge of each has 40 triangles.
    let mut mesh = mesh_of(Vec::new(), Vec::new());
    for book in 0..10u32 {
        let first = 42 * book;
        let x = 5.0 * book as f32;
        mesh.positions.extend([[x, 0.0, 0.0], [x, 0.0, 3.0]]);
        for page in 0..40u32 {
            let (s, c) = (0.05 * page as f32).sin_cos();
            mesh.positions.push([x + c, s, 1.0 + noise(page)]);
            mesh.indices.push([first, first + 1, first + 2 + page]);
        }
    }
    mesh.normals = vec![[0.0, 0.0, 1.0]; mesh.positions.len()];
    mesh.colors = vec![[255; 4]; mesh.positions.len()];
    assert_eq!(baked(&once(vec![mesh]), &deep_tree()).original_triangles(), 400);
}

#[test]
fn sheets_that_meet_in_t_junctions_bake() {
    // Two halves of a sheet, one three times as fine as the other along their common side.
    let fine = terrain(30);
    let mut coarse = terrain(10);
    coarse.positions.iter_mut().for_each(|p| *p = [p[0] * 3.0 - 30.0, 0.0, p[2] * 3.0]);
    let mut both = fine.clone();
    let first = both.positions.len() as u32;
    both.positions.extend(&coarse.positions);
    both.normals.extend(&coarse.normals);
    both.colors.extend(&coarse.colors);
    both.indices.extend(coarse.indices.iter().map(|t| t.map(|i| i + first)));
    for scene in [once(vec![both]), once(vec![fine, coarse])] {
        assert_eq!(baked(&scene, &deep_tree()).original_triangles(), 2000);
    }
}

/// `count` objects of a triangle each.
fn confetti(count: u32) -> Source {
    let piece = |i: u32| {
        let corner = |k: u32| {
            std::array::from_fn(|axis| {
                100.0 * noise(3 * i + axis as u32) + noise(9 * i + 3 * k + axis as u32 + 7)
            })
        };
        mesh_of((0..3).map(corner).collect(), vec![[0, 1, 2]])
    };
    once((0..count).map(piece).collect())
}

#[test]
fn a_hundred_thousand_objects_of_one_triangle_bake() {
    let scene = baked(&confetti(100_000), &Options::default());
    assert_eq!(scene.original_triangles(), 100_000);
    assert!(scene.leaves().count() < 10_000, "{}", scene.leaves().count());
}

#[test]
fn far_away_small_and_large_things_bake() {
    let at = |scale: f64, offset: f64| {
        let mut place = DAffine3::from_scale(DVec3::splat(scale));
        place.translation = DVec3::new(offset, -offset, offset);
        place
    };
    for place in [at(1.0, 1e7), at(1e-6, 0.0), at(1e6, 0.0), at(1e6, 1e7), at(1e-3, 1e3)] {
        let sheet = baked(&placed(terrain(30), place), &deep_tree());
        assert!(sheet.original_triangles() >= 1700, "{place:?}");
        assert!(sheet.deep.levels > 8, "{place:?}");
    }
    // Where the numbers of the source end, what is left of a small thing still bakes.
    let fragile = placed(terrain(10), at(1e-6, 1e7));
    assert!(baked(&fragile, &deep_tree()).original_triangles() > 0);
    // All of them in one scene.
    let places = [at(1.0, 1e7), at(1e-6, 0.0), at(1e6, 0.0)];
    let meshes: Vec<SourceMesh> = (0..3).map(|_| terrain(20)).collect();
    let objects = places.iter().enumerate().map(|(mesh, place)| object(mesh, *place)).collect();
    baked(&source(meshes, objects), &deep_tree());
    // And as instances of one mesh.
    let objects = places.iter().map(|place| object(0, *place)).collect();
    baked(&source(vec![terrain(20)], objects), &deep_tree());
}

#[test]
fn a_hundred_thousand_copies_of_a_point_are_no_geometry_but_do_no_harm() {
    let heap = || {
        let corners = (0..33_333).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        mesh_of(vec![[3.0, 4.0, 5.0]; 100_000], corners)
    };
    let beside = baked(&once(vec![heap(), terrain(5)]), &Options::default());
    assert_eq!(beside.original_triangles(), 50);
    assert_eq!(beside.summary.notes.len(), 1);
    // One triangle that has an area among them.
    let mut mesh = heap();
    mesh.positions[0] = [4.0, 4.0, 5.0];
    mesh.positions[1] = [3.0, 6.0, 5.0];
    assert_eq!(baked(&once(vec![mesh]), &Options::default()).original_triangles(), 1);
}

#[test]
fn flat_things_bake_in_every_plane() {
    for axis in 0..3 {
        let mut mesh = terrain(25);
        mesh.positions.iter_mut().for_each(|p| {
            p[1] = 7.0;
            p.swap(1, axis);
        });
        let flat = baked(&once(vec![mesh]), &deep_tree());
        assert_eq!(flat.original_triangles(), 1250);
        let root = flat.skeleton().levels_of(flat.skeleton().hlod(HlodId(0)));
        assert!(root.last().unwrap().triangles < 300, "{root:?}");
    }
}

#[test]
fn things_inside_each_other_and_in_the_same_place_bake() {
    let shell = |scale: f32| {
        let mut cube = solid();
        cube.positions.iter_mut().for_each(|p| *p = p.map(|c| (c - 0.5) * scale));
        cube
    };
    let nested = once((1..200).map(|i| shell(i as f32)).collect());
    assert_eq!(baked(&nested, &deep_tree()).original_triangles(), 199 * 12);
    let same = once(vec![triangle(1.0); 300]);
    assert_eq!(baked(&same, &Options::default()).summary.source_triangles, 300);
    let instances = source(vec![solid()], vec![object(0, DAffine3::IDENTITY); 300]);
    assert_eq!(baked(&instances, &Options::default()).original_triangles(), 300 * 12);
}

#[test]
fn an_empty_mesh_beside_a_full_one_is_a_note() {
    let mixed = once(vec![mesh_of(Vec::new(), Vec::new()), triangle(1.0)]);
    let mixed = baked(&mixed, &Options::default());
    assert_eq!(mixed.summary.notes.len(), 1, "{:?}", mixed.summary.notes);
    assert_eq!(mixed.leaves().next().unwrap().1.object, 1);
}
