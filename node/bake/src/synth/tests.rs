use super::*;
use std::collections::HashSet;
use std::path::Path;

const SEED: u64 = 7;

fn bytes_of(model: &Model, folder: &Path) -> Vec<u8> {
    let path = folder.join("scene.glb");
    write_glb(model, &path).unwrap();
    std::fs::read(path).unwrap()
}

/// Every face must wind the way its vertices' normals point, and no face may vanish.
fn assert_sound(mesh: &Mesh) {
    assert_eq!(mesh.positions.len(), mesh.normals.len());
    let at = |i: u32| glam::Vec3::from(mesh.positions[i as usize]).as_dvec3();
    let normal = |i: u32| glam::Vec3::from(mesh.normals[i as usize]).as_dvec3();
    assert!(mesh.positions.iter().flatten().all(|c| c.is_finite()), "{}", mesh.name);
    for n in &mesh.normals {
        assert!((glam::Vec3::from(*n).length() - 1.0).abs() < 1e-4, "{} {n:?}", mesh.name);
    }
    let mut turned = 0;
    for t in mesh.indices.chunks(3) {
        let face = (at(t[1]) - at(t[0])).cross(at(t[2]) - at(t[0]));
        let mean = normal(t[0]) + normal(t[1]) + normal(t[2]);
        turned += usize::from(face.dot(mean) < 0.0);
    }
    // Coarse rings on strongly curved statues may bend a normal over.
    assert!(turned * 20 <= mesh.indices.len() / 3, "{}: {turned} turned faces", mesh.name);
}

#[test]
fn every_kind_is_a_valid_glb_of_the_size_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    for (kind, wanted, objects) in [
        (Kind::Plant, 300_000, plant::OBJECTS),
        (Kind::Pipes, 200_000, 100),
        (Kind::Park, 200_000, park::STATUES as usize),
        (Kind::City, 200_000, 1 + 64 + 64 * 8),
    ] {
        let model = generate(kind, Some(wanted), SEED);
        let off = (model.triangles() as f64 / wanted as f64 - 1.0).abs();
        assert!(off < 0.02, "{kind:?}: {} triangles", model.triangles());
        assert_eq!(model.nodes.len(), objects, "{kind:?}");
        model.meshes.iter().for_each(assert_sound);

        let bytes = bytes_of(&model, folder.path());
        let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(&bytes).unwrap();
        assert_eq!(document.nodes().len(), objects);
        let mut triangles = 0;
        for node in document.nodes() {
            let primitive = node.mesh().unwrap().primitives().next().unwrap();
            let reader = primitive.reader(|_| blob.as_deref());
            let positions = reader.read_positions().unwrap().count();
            let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
            assert!(indices.iter().all(|&i| (i as usize) < positions));
            triangles += indices.len() as u64 / 3;
        }
        assert_eq!(triangles, model.triangles());
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_seed_others() {
    let folder = tempfile::tempdir().unwrap();
    for kind in [Kind::Plant, Kind::Pipes, Kind::Park, Kind::City] {
        let make = |seed| bytes_of(&generate(kind, Some(150_000), seed), folder.path());
        let first = make(1);
        assert!(first == make(1), "{kind:?}");
        assert!(first != make(2), "{kind:?}");
    }
}

#[test]
fn half_of_the_plant_is_one_pipe_network_that_spans_it() {
    let model = generate(Kind::Plant, Some(1_000_000), SEED);
    let pipes = model.meshes.iter().find(|m| m.name == "pipe-network").unwrap();
    let share = pipes.indices.len() as f64 / 3.0 / model.triangles() as f64;
    assert!((0.48..0.52).contains(&share), "{share}");
    for (axis, size) in [(0, 70.0), (1, 26.0), (2, 40.0)] {
        let along = pipes.positions.iter().map(|p| f64::from(p[axis]));
        let (low, high) = along.fold((f64::MAX, f64::MIN), |(l, h), c| (l.min(c), h.max(c)));
        assert!(high - low > size, "axis {axis}: {low}..{high}");
    }
}

#[test]
fn a_request_changes_the_detail_and_not_the_layout() {
    let (coarse, fine) =
        (generate(Kind::Plant, Some(300_000), 3), generate(Kind::Plant, Some(900_000), 3));
    let names = |m: &Model| m.nodes.iter().map(|n| n.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&coarse), names(&fine));
    // Nothing at all still gives every object.
    let least = generate(Kind::Plant, Some(0), 3);
    assert_eq!(least.nodes.len(), plant::OBJECTS);
    assert!(least.triangles() < 250_000, "{}", least.triangles());
}

#[test]
fn counts_hold_over_the_whole_range() {
    let plan = plant::plan(SEED);
    for wanted in [300_000.0, 12.7e6, 20e6] {
        let mut sum = 0;
        for (g, group) in plan.groups.iter().enumerate() {
            let seed = SEED ^ (g as u64 + 1) << 56;
            let detail = fit_detail(&group.objects, seed, wanted * group.share);
            sum += count(&group.objects, seed, detail);
        }
        assert!((sum as f64 / wanted - 1.0).abs() < 0.02, "{sum} for {wanted}");
    }
}

#[test]
fn modules_are_turned_mirrored_stretched_and_shared() {
    let model = generate(Kind::Pipes, Some(100_000), SEED);
    let determinant = |m: &[f64; 16]| {
        let c = |k: usize| glam::DVec3::new(m[4 * k], m[4 * k + 1], m[4 * k + 2]);
        c(0).dot(c(1).cross(c(2)))
    };
    let placed: Vec<f64> =
        model.nodes.iter().filter_map(|n| n.matrix.as_ref().map(determinant)).collect();
    assert_eq!(placed.len(), 100);
    assert!(placed.iter().any(|d| *d < 0.0) && placed.iter().any(|d| *d > 0.0));
    assert!(placed.iter().any(|d| (d.abs() - 1.0).abs() > 0.1));
    let used: HashSet<usize> = model.nodes.iter().map(|n| n.mesh).collect();
    assert_eq!(used.len(), model.meshes.len(), "every mesh is placed");
    assert!(model.meshes.len() < 40, "{} meshes for 100 objects", model.meshes.len());
}

#[test]
fn statues_are_distinct_and_their_plots_make_the_ground() {
    let model = generate(Kind::Park, Some(60_000), SEED);
    let distinct: HashSet<Vec<[u32; 3]>> = model
        .meshes
        .iter()
        .map(|m| m.positions.iter().map(|p| p.map(f32::to_bits)).collect())
        .collect();
    assert_eq!(distinct.len(), park::STATUES as usize);
    let plots: f64 = model
        .meshes
        .iter()
        .map(|m| {
            f64::from(
                (m.positions[2][0] - m.positions[0][0]) * (m.positions[2][2] - m.positions[0][2]),
            )
        })
        .sum();
    assert!((plots / (2400.0 * 2000.0) - 1.0).abs() < 1e-3, "{plots}");
}

#[test]
fn a_file_that_cannot_be_written_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let model = generate(Kind::City, Some(10_000), SEED);
    let blocked = folder.path().join("dir.glb");
    std::fs::create_dir(&blocked).unwrap();
    assert!(matches!(write_glb(&model, &blocked), Err(GlbError::Io { .. })));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    assert!(write_glb(&model, &folder.path().join("missing/x.glb")).is_err());
}

#[test]
fn a_sprawl_has_exactly_the_buildings_asked_for_each_its_own_mesh() {
    let folder = tempfile::tempdir().unwrap();
    for (buildings, extent) in [(1, 1.0), (2, 1e6), (37, 500.0), (1000, 600.0)] {
        let model = sprawl(buildings, extent, SEED);
        assert_eq!(model.nodes.len(), buildings as usize);
        assert_eq!(model.triangles(), 12 * u64::from(buildings));
        model.meshes.iter().for_each(assert_sound);
        let bytes = bytes_of(&model, folder.path());
        let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(&bytes).unwrap();
        let mut boxes = Vec::new();
        for (node, mesh) in document.nodes().zip(&model.meshes) {
            let primitive = node.mesh().unwrap().primitives().next().unwrap();
            let reader = primitive.reader(|_| blob.as_deref());
            assert!(reader.read_positions().unwrap().eq(mesh.positions.iter().copied()));
            assert!(reader.read_normals().unwrap().eq(mesh.normals.iter().copied()));
            assert!(reader.read_indices().unwrap().into_u32().eq(mesh.indices.iter().copied()));
            let points = mesh.positions.iter().map(|p| glam::Vec3::from(*p).as_dvec3());
            boxes.push(geometry::bounds::Aabb::of(points));
        }
        let used: HashSet<usize> = document.nodes().map(|n| n.mesh().unwrap().index()).collect();
        assert_eq!(used.len(), buildings as usize);
        for (i, a) in boxes.iter().enumerate() {
            assert!(a.min.min_element() >= 0.0 && a.max.x.max(a.max.z) <= extent);
            let apart = |b: &geometry::bounds::Aabb| {
                a.max.x < b.min.x || b.max.x < a.min.x || a.max.z < b.min.z || b.max.z < a.min.z
            };
            assert!(boxes[i + 1..].iter().all(apart), "building {i} of {buildings}");
        }
        assert!(bytes == bytes_of(&sprawl(buildings, extent, SEED), folder.path()));
    }
    let model = sprawl(500, 600.0, SEED);
    let top = |m: &Mesh| m.positions.iter().fold(0.0f32, |top, p| top.max(p[1])).to_bits();
    let heights: HashSet<u32> = model.meshes.iter().map(top).collect();
    assert!(heights.len() > 400, "{} heights", heights.len());
}

#[test]
fn what_meshes_have_in_common_is_written_once() {
    let folder = tempfile::tempdir().unwrap();
    let [one, many] = [1, 1001].map(|n| bytes_of(&sprawl(n, 600.0, SEED), folder.path()));
    // 24 positions of a box are 288 bytes; its entries in the document take the rest.
    assert!((many.len() - one.len()) / 1000 < 288 + 400, "{} bytes", many.len());
    // Equal positions are no reason: other normals, other indices and long ones stay apart.
    let mut model = sprawl(3, 10.0, SEED);
    model.meshes[1].normals[0] = [0.0, 0.0, 1.0];
    model.meshes[2].indices.reverse();
    let copies = model.meshes[0].positions.repeat(70_000 / 24);
    model.meshes[0].normals = model.meshes[0].normals.repeat(70_000 / 24);
    model.meshes[0].positions = copies;
    let bytes = bytes_of(&model, folder.path());
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(&bytes).unwrap();
    for (read, mesh) in document.meshes().zip(&model.meshes) {
        let primitive = read.primitives().next().unwrap();
        let reader = primitive.reader(|_| blob.as_deref());
        assert!(reader.read_positions().unwrap().eq(mesh.positions.iter().copied()));
        assert!(reader.read_normals().unwrap().eq(mesh.normals.iter().copied()));
        assert!(reader.read_indices().unwrap().into_u32().eq(mesh.indices.iter().copied()));
    }
}
