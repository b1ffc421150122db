use super::*;
use crate::synth::{Kind, generate, write_glb};
use glam::DMat4;

/// A GLB of one JSON chunk and `binary`.
fn glb(json: &str, binary: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    let total = 12 + 8 + json.len() + if binary.is_empty() { 0 } else { 8 + binary.len() };
    bytes.extend([2, total as u32, json.len() as u32].map(u32::to_le_bytes).concat());
    bytes.extend(b"JSON");
    bytes.extend(json);
    if !binary.is_empty() {
        bytes.extend((binary.len() as u32).to_le_bytes());
        bytes.extend(b"BIN\0");
        bytes.extend(binary);
    }
    bytes
}

/// One triangle from (0, 0, 0) to (1, 2, 3), shown by nodes as given.
fn scene(nodes: &str) -> Vec<u8> {
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},{nodes},
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"type":"VEC3","count":3,
            "min":[0,0,0],"max":[1,2,3]}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}}],"buffers":[{{"byteLength":36}}]}}"#
    );
    let corners = [0.0f32, 0.0, 0.0, 1.0, 0.0, 3.0, 1.0, 2.0, 0.0];
    glb(&json, &corners.map(f32::to_le_bytes).concat())
}

fn town(bytes: &[u8], triangles: u64, seed: u64) -> Result<(Town, Vec<u8>), TownError> {
    let folder = tempfile::tempdir().unwrap();
    let (from, to) = (folder.path().join("from.glb"), folder.path().join("town.glb"));
    std::fs::write(&from, bytes).unwrap();
    let town = write_town(&from, triangles, seed, &to)?;
    Ok((town, std::fs::read(to).unwrap()))
}

/// World box and triangles of each copy, read back by another implementation.
fn copies(bytes: &[u8]) -> Vec<(Aabb, u64)> {
    let gltf = gltf::Gltf::from_slice(bytes).unwrap();
    let roots: Vec<gltf::Node<'_>> = gltf.default_scene().unwrap().nodes().collect();
    let matrix = |node: &gltf::Node<'_>| {
        DMat4::from_cols_array_2d(&node.transform().matrix().map(|c| c.map(f64::from)))
    };
    let copy = |root: &gltf::Node<'_>| {
        let (mut bounds, mut triangles) = (Aabb::EMPTY, 0);
        let mut open = vec![(root.clone(), DMat4::IDENTITY)];
        while let Some((node, above)) = open.pop() {
            let world = above * matrix(&node);
            for primitive in node.mesh().iter().flat_map(|mesh| mesh.primitives()) {
                let reader = primitive.reader(|_| gltf.blob.as_deref());
                let points: Vec<DVec3> = reader
                    .read_positions()
                    .unwrap()
                    .map(|p| world.transform_point3(DVec3::from(p.map(f64::from))))
                    .collect();
                let corners = reader.read_indices().map_or(points.len(), |i| i.into_u32().count());
                bounds = points.into_iter().fold(bounds, Aabb::with);
                triangles += corners as u64 / 3;
            }
            open.extend(node.children().map(|child| (child, world)));
        }
        (bounds, triangles)
    };
    roots.iter().map(copy).collect()
}

#[test]
fn what_cannot_be_copied_is_refused() {
    let good = scene(r#""nodes":[{"mesh":0}]"#);
    let cut = good[..good.len() - 1].to_vec();
    let mut long_chunk = good.clone();
    long_chunk[12] = 0xff;
    long_chunk[14] = 0xff;
    for (bytes, expected) in [
        (Vec::new(), "no GLB"),
        (b"glTF".to_vec(), "cut short"),
        (b"{}".to_vec(), "no GLB"),
        (cut, "its header says"),
        (long_chunk, "ends beyond"),
        (glb("{", b""), "malformed"),
        (glb(r#"{"nodes":7}"#, b""), "not shaped"),
        (glb("{}", b""), "no triangles"),
        (scene(r#""nodes":[]"#), "no triangles"),
        (scene(r#""nodes":[{}]"#), "no triangles"),
        (scene(r#""nodes":[{"mesh":1}]"#), "mesh 1 of 1"),
        (scene(r#""nodes":[{"mesh":0,"children":[9]}]"#), "node 9"),
        (scene(r#""nodes":[{"mesh":0,"children":[0]}],"scenes":[{"nodes":[0]}]"#), "twice"),
        (scene(r#""nodes":[{"mesh":0}],"scenes":[{"nodes":[0,0]}]"#), "twice"),
        (scene(r#""nodes":[{"mesh":0}],"scene":4"#), "number 4 of 0"),
        (scene(r#""nodes":[{"mesh":0,"scale":[0,1,0]}]"#), "plot"),
        (scene(r#""nodes":[{"mesh":0,"scale":[1e308,1e308,1e308]}]"#), "plot"),
        (scene(r#""nodes":[{"mesh":0}],"images":[{"uri":"../a.png"}]"#), "another file"),
    ] {
        let error = town(&bytes, 1, 1).unwrap_err();
        assert!(error.to_string().contains(expected), "{error} for {expected}");
        assert_eq!(error.exit_code(), 65);
    }
    let missing = write_town(Path::new("no-such.glb"), 1, 1, Path::new("no.glb")).unwrap_err();
    assert_eq!(missing.exit_code(), 66);
    assert_eq!(town(&good, u64::MAX, 1).unwrap_err().exit_code(), 65);
}

#[test]
fn one_copy_is_the_scene_where_it_was() {
    let (one, bytes) = town(&scene(r#""nodes":[{"mesh":0}]"#), 0, 1).unwrap();
    assert_eq!(one, Town { copies: 1, objects: 1, triangles: 1 });
    let bounds = Aabb { min: DVec3::ZERO, max: DVec3::new(1.0, 2.0, 3.0) };
    assert_eq!(copies(&bytes), [(bounds, 1)]);
}

#[test]
fn copies_of_a_graph_are_turned_each_on_its_plot() {
    // A root that scales, below it two nodes, one of them turned; a node outside the scene.
    let nodes = r#""nodes":[{"mesh":0},{"scale":[2,2,2],"children":[2,3]},
        {"mesh":0,"translation":[5,0,0]},{"children":[4],"rotation":[0,1,0,0]},{"mesh":0}],
        "scenes":[{"nodes":[0]},{"nodes":[1]}],"scene":1"#;
    let (made, bytes) = town(&scene(nodes), 39, 1).unwrap();
    assert_eq!(made, Town { copies: 20, objects: 40, triangles: 40 });
    let copies = copies(&bytes);
    assert_eq!(copies.len(), 20);
    let size = copies[0].0.extent();
    assert!((size - DVec3::new(14.0, 4.0, 12.0)).length() < 1e-5, "{size}");
    let mut turned = 0;
    for (i, (a, triangles)) in copies.iter().enumerate() {
        assert_eq!(*triangles, 2);
        let e = a.extent();
        turned += usize::from((e - DVec3::new(size.z, size.y, size.x)).length() < 1e-4);
        assert!((e - size).length() < 1e-4 || (e.x - size.z).abs() < 1e-4, "{e}");
        assert_eq!((a.min.y, a.max.y), (copies[0].0.min.y, copies[0].0.max.y));
        for (b, _) in &copies[i + 1..] {
            // The street is a fifth of 14 metres.
            let gap = (a.min - b.max).max(b.min - a.max);
            assert!(gap.x > 2.7 || gap.z > 2.7, "{a:?} {b:?}");
        }
    }
    assert!((3..=17).contains(&turned), "{turned} of 20 are turned by an odd quarter");
}

#[test]
fn a_town_keeps_the_meshes_and_depends_on_the_seed_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pipes.glb");
    let model = generate(Kind::Pipes, Some(20_000), 3);
    write_glb(&model, &path).unwrap();
    let source = std::fs::read(path).unwrap();
    let wanted = 9 * model.triangles() / 2;
    let (made, bytes) = town(&source, wanted, 1).unwrap();
    assert_eq!((made.copies, made.objects), (5, 500));
    assert_eq!(made.triangles, 5 * model.triangles());
    assert_eq!(copies(&bytes).iter().map(|copy| copy.1).sum::<u64>(), made.triangles);
    let [before, after] = [&source, &bytes].map(|bytes| gltf::Gltf::from_slice(bytes).unwrap());
    assert!(before.blob == after.blob);
    assert_eq!(before.meshes().len(), after.meshes().len());
    assert!(bytes == town(&source, wanted, 1).unwrap().1);
    assert!(bytes != town(&source, wanted, 2).unwrap().1);
}
