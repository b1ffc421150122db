//! Extensions that change where geometry is and how it is stored.

use glam::DVec3;
use serde_json::{Value, json};

use crate::import::gltf::testing::{F32, Scene, U8};
use crate::source::Source;

/// Appends encoded bytes that decode to `count` elements; the number of the view.
fn compressed(scene: &mut Scene, bytes: &[u8], mode: &str, count: usize, stride: usize) -> usize {
    let view = scene.view(bytes);
    let mut meshopt = scene.json["bufferViews"][view].clone();
    meshopt["byteStride"] = json!(stride);
    meshopt["count"] = json!(count);
    meshopt["mode"] = json!(mode);
    scene.json["bufferViews"][view] = json!({
        "buffer": 1, "byteOffset": 0, "byteLength": count * stride,
        "extensions": {"EXT_meshopt_compression": meshopt},
    });
    view
}

/// Marks a compressed view as filtered.
fn filter(scene: &mut Scene, view: usize, name: &str) {
    scene.json["bufferViews"][view]["extensions"]["EXT_meshopt_compression"]["filter"] =
        json!(name);
}

/// Points an accessor with this member at a view.
fn accessor(scene: &mut Scene, view: usize, component: u32, element: &str, count: usize) -> usize {
    let accessor =
        json!({"bufferView": view, "componentType": component, "type": element, "count": count});
    scene.add("accessors", accessor)
}

/// Two triangles of a square, every stream compressed; the buffer of the views holds nothing.
pub(super) fn square(mode: &str) -> Scene {
    let mut scene = Scene::new();
    scene.add(
        "buffers",
        json!({"byteLength": 1000, "extensions": {"EXT_meshopt_compression": {"fallback": true}}}),
    );
    let positions: [[i16; 4]; 4] = [[0; 4], [9, 0, 0, 0], [9, 9, 0, 0], [0, 9, 0, 0]];
    let encoded = meshopt::encode_vertex_buffer(&positions).unwrap();
    let view = compressed(&mut scene, &encoded, "ATTRIBUTES", 4, 8);
    let positions = accessor(&mut scene, view, 5122, "VEC3", 4);
    let normals: Vec<[u8; 4]> = meshopt::encode_filter_oct(&[[0.0, 0.0, -1.0, 0.0]; 4], 8);
    let encoded = meshopt::encode_vertex_buffer(&normals).unwrap();
    let view = compressed(&mut scene, &encoded, "ATTRIBUTES", 4, 4);
    filter(&mut scene, view, "OCTAHEDRAL");
    let normals = accessor(&mut scene, view, 5120, "VEC3", 4);
    scene.json["accessors"][normals]["normalized"] = json!(true);
    let corners = [0u32, 1, 2, 0, 2, 3];
    let encoded = match mode {
        "TRIANGLES" => meshopt::encode_index_buffer(&corners, 4).unwrap(),
        _ => meshopt::encode_index_sequence(&corners, 4).unwrap(),
    };
    let view = compressed(&mut scene, &encoded, mode, 6, 2);
    let indices = accessor(&mut scene, view, 5123, "SCALAR", 6);
    let attributes = json!({"POSITION": positions, "NORMAL": normals});
    scene.add("meshes", json!({"primitives": [{"attributes": attributes, "indices": indices}]}));
    scene.add("nodes", json!({"mesh": 0}));
    scene.json["extensionsRequired"] = json!(["EXT_meshopt_compression", "KHR_mesh_quantization"]);
    scene
}

#[test]
fn compressed_streams_decode_whatever_their_mode() {
    for mode in ["TRIANGLES", "INDICES"] {
        let source = square(mode).import().unwrap();
        let mesh = &source.meshes[0];
        assert_eq!(mesh.indices.len(), 2);
        let mut points = mesh.positions.clone();
        points.sort_by(|a, b| a.partial_cmp(b).unwrap());
        assert_eq!(points, [[0.0; 3], [0.0, 9.0, 0.0], [9.0, 0.0, 0.0], [9.0, 9.0, 0.0]]);
        assert_eq!(mesh.normals, [[0.0, 0.0, -1.0]; 4]);
        assert!(source.notes.is_empty(), "{:?}", source.notes);
    }
}

#[test]
fn floats_come_through_the_exponential_filter() {
    let mut scene = square("INDICES");
    let points = [[0.0f32, 0.0, 0.0], [1.5, 0.0, 0.0], [1.5, 1e6, 0.0], [0.0, 1e6, 0.0]];
    let filtered = meshopt::encode_filter_exp(&points, 20, meshopt::EncodeExpMode::Separate);
    let encoded = meshopt::encode_vertex_buffer(&filtered).unwrap();
    let view = compressed(&mut scene, &encoded, "ATTRIBUTES", 4, 12);
    filter(&mut scene, view, "EXPONENTIAL");
    let positions = accessor(&mut scene, view, F32, "VEC3", 4);
    scene.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(positions);
    assert_eq!(scene.import().unwrap().meshes[0].positions, points);
}

#[test]
fn compressed_views_that_lie() {
    let edited = |view: usize, key: &str, value: Value| {
        let mut scene = square("TRIANGLES");
        scene.json["bufferViews"][view]["extensions"]["EXT_meshopt_compression"][key] = value;
        scene.error()
    };
    for (view, key, value, words) in [
        (0, "count", json!(u64::MAX), "buffer view 0: "),
        (0, "count", json!(1u64 << 30), "cannot hold 1073741824 elements"),
        (0, "count", json!(3), "its compressed bytes are broken"),
        (0, "byteStride", json!(6), "elements of 6 bytes"),
        (0, "byteStride", json!(1024), "elements of 1024 bytes"),
        (0, "byteLength", json!(10), "buffer view 0: its compressed bytes are broken"),
        (0, "byteLength", json!(1u64 << 40), "buffer view 0: its buffer view 0 takes"),
        (0, "buffer", json!(1), "which has no bytes"),
        (0, "mode", json!("TRIANGLES"), "buffer view 0: "),
        (0, "mode", json!("POINTS"), "unknown mode \"POINTS\""),
        (1, "filter", json!("ELSE"), "unknown filter \"ELSE\""),
        (1, "filter", json!("QUATERNION"), "elements of 4 bytes"),
        (2, "count", json!(5), "cannot hold 5 elements"),
        (2, "byteStride", json!(1), "elements of 1 bytes"),
    ] {
        let message = edited(view, key, value);
        assert!(message.contains(words), "{key}: {message}");
    }
    // A fallback without bytes is of no use by itself.
    let mut scene = square("TRIANGLES");
    scene.json["bufferViews"][0].as_object_mut().unwrap().remove("extensions");
    assert!(scene.error().contains("buffer 1, which has no bytes"), "{}", scene.error());
}

/// Where a triangle's first two corners stand in the world.
fn corners(source: &Source, object: usize) -> [DVec3; 2] {
    let object = &source.objects[object];
    [0, 1].map(|i| {
        let point = source.meshes[object.mesh].positions[i].map(f64::from);
        object.world_from_mesh.transform_point3(DVec3::from(point))
    })
}

#[test]
fn instances_are_objects_of_one_mesh() {
    let mut scene = Scene::triangle();
    let places = scene.floats("VEC3", &[0.0, 0.0, 1.0, 0.0, 0.0, 2.0]);
    let turns = scene.accessor(5120, "VEC4", 2, &[0, 0, 0, 127, 0, 0, 127, 0]);
    let sizes = scene.floats("VEC3", &[1.0, 1.0, 1.0, 3.0, 1.0, 1.0]);
    let attributes = json!({"TRANSLATION": places, "ROTATION": turns, "SCALE": sizes, "_ID": 99});
    scene.json["nodes"][0] = json!({
        "mesh": 0, "name": "tree", "translation": [10.0, 0.0, 0.0],
        "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}},
    });
    scene.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let source = scene.import().unwrap();
    let names: Vec<&str> = source.objects.iter().map(|object| object.name.as_str()).collect();
    assert_eq!((source.meshes.len(), names), (1, vec!["tree[0]", "tree[1]"]));
    let [a, b] = corners(&source, 0);
    assert_eq!((a, b), (DVec3::new(10.0, 0.0, 1.0), DVec3::new(11.0, 0.0, 1.0)));
    // Three times as wide, then half a turn about z.
    assert_eq!(corners(&source, 1)[1], DVec3::new(7.0, 0.0, 2.0));

    for (attribute, value, words) in [
        ("SCALE", json!(places + 40), "accessor"),
        ("SCALE", json!(turns), "cannot be used as Vector"),
        ("SCALE", json!(0), "instances have 2 of one attribute and 3 of another"),
    ] {
        let mut broken = scene_with(&scene, attribute, value);
        assert!(broken.error().contains(words), "{}", broken.error());
        broken.json["nodes"][0]["extensions"] = json!({});
        assert!(broken.import().is_ok());
    }
    let still = scene.accessor(U8, "VEC4", 2, &[0; 8]);
    let broken = scene_with(&scene, "ROTATION", json!(still));
    assert!(broken.error().contains("instance 0: its rotation has no length"));
}

/// The same scene with another accessor for one attribute of its instances.
fn scene_with(scene: &Scene, attribute: &str, value: Value) -> Scene {
    let mut other = Scene { json: scene.json.clone(), bin: scene.bin.clone() };
    other.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"][attribute] =
        value;
    other
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let mut scene = Scene::triangle();
    for i in 1..60 {
        let size = i as f32;
        let positions = scene.floats("VEC3", &[0.0, 0.0, 0.0, size, 0.0, 0.0, 0.0, size, 0.0]);
        scene.add(
            "materials",
            json!({"alphaMode": "MASK", "alphaCutoff": size, "doubleSided": i % 2 == 0}),
        );
        let primitive = json!({"attributes": {"POSITION": positions}, "material": i - 1});
        let mesh = scene.add("meshes", json!({"primitives": [primitive]}));
        scene.add(
            "nodes",
            json!({"mesh": mesh, "scale": [1.0, 1.0, if i % 7 == 0 { 0.0 } else { 1.0 }]}),
        );
    }
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| scene.import().unwrap())
    };
    let one = with(1);
    assert_eq!((one.objects.len(), one.meshes.len()), (60, 60));
    assert_eq!(one, with(2));
    assert_eq!(one, with(5));
}
