//! What any bake keeps to.

use super::*;
use glam::DQuat;

#[test]
fn an_empty_scene_is_refused_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    let point = mesh_of(vec![[1e7; 3]; 3], vec![[0, 1, 2]]);
    let nothing = mesh_of(Vec::new(), Vec::new());
    let flattened = source(vec![triangle(1.0)], vec![object(0, DAffine3::from_scale(DVec3::ZERO))]);
    for empty in [
        Source::default(),
        once(vec![nothing.clone()]),
        source(vec![point], vec![object(0, DAffine3::IDENTITY); 2]),
        flattened,
    ] {
        let error = bake_source(&empty, &path, &Options::default()).unwrap_err();
        assert_eq!(error.exit_code(), 65);
        assert!(error.to_string().contains("void.glb"), "{error}");
        assert!(empty.meshes.is_empty() || error.to_string().contains("made up"), "{error}");
    }
    let missing = bake(&[folder.path().join("no.glb")], &path, &Options::default(), &Silent);
    assert_eq!(missing.unwrap_err().exit_code(), 66);
    assert!(names(folder.path()).is_empty());
}

#[test]
fn no_folder_is_made_for_the_output_and_none_is_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let scene = once(vec![triangle(1.0)]);
    for output in ["no/such/scene.occ", "."] {
        let error = bake_source(&scene, &folder.path().join(output), &Options::default());
        assert_eq!(error.unwrap_err().exit_code(), 74, "{output}");
    }
    assert!(names(folder.path()).is_empty());
}

#[test]
fn one_triangle_is_a_leaf_at_the_root_at_any_scale_and_distance() {
    for (size, offset) in [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1.0, 1e7), (1e-3, -1e7)] {
        let place = DAffine3::from_translation(DVec3::splat(offset));
        let one = baked(&source(vec![triangle(size)], vec![object(0, place)]), &Options::default());
        let skeleton = one.skeleton();
        assert_eq!((skeleton.hlods.len(), skeleton.levels.len()), (1, 1));
        let level = &skeleton.levels[0];
        let size = f64::from(size);
        let wanted = [DVec3::ZERO, DVec3::X * size, DVec3::Y * size].map(|p| p + offset);
        for (decoded, wanted) in one.triangles(level)[0].into_iter().zip(wanted) {
            assert!(decoded.distance(wanted) <= level.error, "{decoded} {wanted}");
        }
        assert!(level.error <= size * 1e-4, "{size} {offset} {}", level.error);
    }
}

#[test]
fn a_large_object_is_split_into_pieces_that_close() {
    let place = DAffine3::from_rotation_translation(DQuat::from_rotation_z(0.3), DVec3::splat(1e7));
    let pipe = source(vec![tube(500, 24, 200.0)], vec![object(0, place)]);
    let pipe = baked(&pipe, &Options::default());
    assert!(pipe.leaves().count() >= 12);
    // On one grid, every inner edge of the tube still has a partner with exactly its ends.
    let mut ends: Vec<[[u64; 3]; 2]> = Vec::new();
    for (_, leaf) in pipe.leaves() {
        for t in pipe.triangles(&pipe.skeleton().levels_of(leaf)[0]) {
            let bits = t.map(|p| p.to_array().map(f64::to_bits));
            for k in 0..3 {
                let mut edge = [bits[k], bits[(k + 1) % 3]];
                edge.sort_unstable();
                ends.push(edge);
            }
        }
    }
    assert_eq!(ends.len(), 3 * 24_000);
    ends.sort_unstable();
    let single = ends.chunk_by(|a, b| a == b).filter(|same| same.len() != 2).count();
    assert_eq!(single, 2 * 24);
}

#[test]
fn every_level_of_a_tube_keeps_to_its_error() {
    let tube = baked(&once(vec![tube(100, 24, 40.0)]), &Options::default());
    let skeleton = tube.skeleton();
    let mut coarsest = u32::MAX;
    for level in &skeleton.levels {
        coarsest = coarsest.min(level.triangles);
        for triangle in tube.triangles(level) {
            let [a, b, c] = triangle;
            for p in [a, b, c, (a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5, (a + b + c) / 3.0] {
                // Distance to the 24-sided prism is at most that to the circle plus its sagitta.
                let sagitta = 1.0 - (std::f64::consts::PI / 24.0).cos();
                let deviation = ((p.y * p.y + p.z * p.z).sqrt() - 1.0).abs() - sagitta;
                assert!(deviation <= level.error, "{deviation} {}", level.error);
            }
        }
    }
    assert!(coarsest <= 64, "{coarsest}");
}

#[test]
fn instances_share_their_meshes_and_scale_their_errors() {
    let place = |i: usize| {
        let scale = DVec3::new(1.0, if i == 3 { -2.0 } else { 1.0 }, 1.0);
        DAffine3::from_scale_rotation_translation(
            scale,
            DQuat::from_rotation_y(i as f64),
            DVec3::X * 100.0 * i as f64,
        )
    };
    let park = source(vec![tube(40, 12, 5.0)], (0..8).map(|i| object(0, place(i))).collect());
    let park = baked(&park, &Options::default());
    let skeleton = park.skeleton();
    assert_eq!(park.leaves().count(), 8);
    assert_eq!(skeleton.transforms.len(), 8);
    let of = |object: u32| {
        let leaf = park.leaves().find(|(_, leaf)| leaf.object == object).unwrap().1;
        skeleton.levels_of(leaf)
    };
    let blobs = |object| -> Vec<u32> {
        of(object).iter().map(|level| skeleton.parts_of(level)[0].blob).collect()
    };
    let (first, own) = (blobs(0), blobs(0)[0]);
    for object in 1..8 {
        // A parent may make some of the coarser ones needless here and not there.
        assert!(blobs(object).iter().all(|blob| first.contains(blob) || *blob > own));
        assert_eq!(blobs(object)[0], own);
    }
    let ratio = of(3)[0].error / of(0)[0].error;
    assert!((ratio - 2.0).abs() < 1e-6, "{ratio}");
    assert_eq!(park.summary.source_triangles, 8 * 960);
    assert_eq!(park.summary.unique_triangles, 960);
    // The file holds the finest form once, whoever shows it.
    let of_leaves: std::collections::BTreeSet<u32> = (0..8).flat_map(blobs).collect();
    let triangles: u32 = of_leaves.iter().map(|&id| skeleton.blobs[id as usize].triangles).sum();
    assert!((960..2 * 960).contains(&triangles), "{triangles}");
}

#[test]
fn the_root_is_coarse_and_every_width_works() {
    let mut meshes = vec![tube(100, 16, 60.0)];
    for i in 0..100u32 {
        let mut cube = solid();
        let corner = [(i % 10) as f32 * 3.0, (i / 10) as f32 * 3.0, (i % 7) as f32];
        cube.positions.iter_mut().for_each(|p| (0..3).for_each(|k| p[k] += corner[k]));
        cube.colors.fill([80 * (i % 3) as u8, 40, 200, 255]);
        meshes.push(cube);
    }
    let yard = once(meshes);
    for branching in [2, 4, 8] {
        let options = Options { branching, piece_triangles: 300, ..Options::default() };
        let yard = baked(&yard, &options);
        assert_eq!(yard.original_triangles(), 3200 + 1200);
        let levels = yard.skeleton().levels_of(yard.skeleton().hlod(HlodId(0)));
        assert!(!levels.is_empty() && levels[0].triangles <= 4096);
        assert!(levels.last().unwrap().triangles <= 1024, "{levels:?}");
        assert_eq!(yard.summary.depths[0].hlods, 1);
        assert_eq!(yard.summary.objects.leaves, yard.leaves().count() as u64);
        assert!(yard.summary.to_string().contains("written triangles"));
        assert_eq!(yard.summary.file_bytes, std::fs::metadata(yard.path()).unwrap().len());
    }
}

/// A cube of 12 triangles.
pub(super) fn solid() -> SourceMesh {
    let corner = |k: u32| [(k & 1) as f32, (k >> 1 & 1) as f32, (k >> 2 & 1) as f32];
    let faces =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let indices = faces.iter().flat_map(|f| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]]).collect();
    mesh_of((0..8).map(corner).collect(), indices)
}

/// Bakes the real scenes, holds every stored error against samples and prints what came of them:
/// `--ignored --nocapture`.
#[test]
#[ignore = "takes minutes in a debug build; a measurement more than a test"]
fn real_scenes() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes");
    let Ok(entries) = std::fs::read_dir(&folder) else {
        println!("skipped: {} is absent", folder.display());
        return;
    };
    let mut scenes: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    scenes.retain(|path| path.extension().is_some_and(|extension| extension == "glb"));
    scenes.sort();
    let output = tempfile::tempdir().unwrap();
    for scene in scenes {
        let path = output.path().join("scene.occ");
        let summary =
            bake(std::slice::from_ref(&scene), &path, &Options::default(), &Silent).unwrap();
        println!("{}\n{summary}", scene.display());
        summary.depths.iter().enumerate().for_each(|(depth, row)| println!("{depth:>3} {row:?}"));
        let store = Store::open(&path).unwrap();
        verify(&store).unwrap();
        let deep = deep(&store, &Effort::default()).unwrap();
        println!("{} levels, stored error / sampled distance: {:?}", deep.levels, deep.slack);
        let skeleton = store.skeleton();
        let root = skeleton.levels_of(skeleton.hlod(HlodId(0))).to_vec();
        println!("diagonal {:.3} root {root:?}", skeleton.diagonal());
        assert!(root[0].triangles <= 4096);
    }
}
