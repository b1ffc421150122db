//! Files that lie: each is refused by an error that names the object, and none panics.

use std::path::Path;

use proptest::prelude::*;
use serde_json::{Value, json};

use super::extensions::square;
use crate::import::gltf::testing::import_bytes;
use crate::import::gltf::testing::{Scene, U8, U32, png};
use crate::import::testing::TEXTURE_SIDE;
use crate::import::{ImportError, ImportErrorKind, import_all as import};

/// The error of the triangle scene after one edit of its JSON.
fn edited(pointer: &str, value: Value) -> String {
    let mut scene = Scene::triangle();
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    let parent = scene.json.pointer_mut(parent).unwrap();
    match key.parse::<usize>() {
        Ok(place) if parent.is_array() => parent[place] = value,
        _ => parent[key] = value,
    }
    scene.error()
}

#[test]
fn a_missing_file_an_unreadable_one_and_an_empty_one() {
    let folder = tempfile::tempdir().unwrap();
    let error = import(&folder.path().join("none.glb")).unwrap_err();
    assert!(error.is_missing_input() && error.to_string().contains("none.glb"), "{error}");
    assert_eq!(import(folder.path()).unwrap_err().kind(), ImportErrorKind::Io);
    let empty = folder.path().join("empty.glb");
    std::fs::write(&empty, b"").unwrap();
    assert_eq!(import(&empty).unwrap_err().kind(), ImportErrorKind::BadData);
}

#[test]
fn a_scene_without_triangles() {
    for scene in [Scene::new(), {
        let mut scene = Scene::triangle();
        scene.json["nodes"] = json!([]);
        scene
    }] {
        assert!(matches!(scene.import(), Err(ImportError::Empty { .. })));
    }
    let mut flat = Scene::triangle();
    flat.bin[12..36].fill(0);
    assert!(flat.error().contains("1 degenerate triangles"));
}

#[test]
fn counts_and_ranges_beyond_the_bytes() {
    let huge = json!(u64::MAX);
    for (pointer, value, words) in [
        ("/accessors/0/count", json!(4), "primitive 0, POSITION, accessor 0"),
        ("/accessors/0/count", huge.clone(), "claims 18446744073709551615 elements"),
        ("/accessors/1/count", json!(1u64 << 62), "indices, accessor 1"),
        ("/accessors/0/byteOffset", huge.clone(), "accessor 0"),
        ("/accessors/0/bufferView", json!(9), "buffer view 9 of 2"),
        ("/bufferViews/0/byteLength", json!(1000), "takes 1000 bytes"),
        ("/bufferViews/0/byteOffset", huge.clone(), "buffer view 0"),
        ("/bufferViews/0/byteStride", json!(8), "overlap"),
        ("/bufferViews/0/byteStride", huge, "claims 3 elements"),
        ("/bufferViews/0/buffer", json!(3), "buffer 3 of 1"),
        ("/buffers/0/byteLength", json!(1u64 << 40), "buffer 0: it claims 1099511627776 bytes"),
        ("/buffers/0/uri", json!("none.bin"), "none.bin"),
        ("/buffers/0/uri", json!("../a.bin"), "\"../a.bin\""),
        ("/buffers/0/uri", json!("data:;base64,!"), "not base64"),
        ("/buffers/1", json!({"byteLength": 1}), "buffer 1"),
    ] {
        let message = if pointer == "/buffers/1" {
            let mut scene = Scene::triangle();
            scene.add("buffers", value);
            scene.error()
        } else {
            edited(pointer, value)
        };
        assert!(message.contains(words), "{pointer}: {message}");
    }
}

#[test]
fn references_and_types_that_do_not_fit() {
    for (pointer, value, words) in [
        ("/meshes/0/primitives/0/attributes/POSITION", json!(7), "accessor 7 of 2"),
        ("/meshes/0/primitives/0/attributes/POSITION", json!(1), "cannot be used as Position"),
        ("/meshes/0/primitives/0/attributes/NORMAL", json!(1), "cannot be used as Normal"),
        ("/meshes/0/primitives/0/indices", json!(0), "cannot be used as Indices"),
        ("/meshes/0/primitives/0/material", json!(5), "material 5 of 0"),
        ("/meshes/0/primitives/0/mode", json!(7), "mode 7"),
        ("/nodes/0/mesh", json!(1), "mesh 1 of 1"),
        ("/nodes/0/children", json!([4]), "child 4"),
        ("/scene", json!(2), "default scene"),
        ("/scenes", json!([{"nodes": [3]}]), "scene 0: its root 3"),
        ("/accessors/0/componentType", json!(1), "component type 1"),
        ("/accessors/0/type", json!("VEC9"), "VEC9"),
        (
            "/accessors/0",
            json!({"componentType": 5126, "type": "VEC3", "count": 3}),
            "no data of its own",
        ),
        ("/nodes/0/mesh", json!(-1), "malformed"),
    ] {
        let message = edited(pointer, value);
        assert!(message.contains(words), "{pointer}: {message}");
    }
}

#[test]
fn an_index_out_of_range_is_named() {
    let mut scene = Scene::triangle();
    scene.bin[38] = 3;
    let message = scene.error();
    assert!(
        message.contains("mesh 0, primitive 0: its index 3, at place 1, is beyond its 3 positions"),
        "{message}"
    );
}

#[test]
fn positions_and_transforms_must_be_finite() {
    for bad in [f32::NAN, f32::INFINITY] {
        let mut scene = Scene::triangle();
        scene.bin[16..20].copy_from_slice(&bad.to_le_bytes());
        assert!(scene.error().contains("its position 1 is"), "{}", scene.error());
    }
    for (node, words) in [
        (
            json!([{"scale": [1e300, 1.0, 1.0], "children": [1]}, {"mesh": 0, "scale": [1e300, 1.0, 1.0]}]),
            "not finite",
        ),
        (json!([{"mesh": 0, "rotation": [0.0, 0.0, 0.0, 0.0]}]), "no length"),
        (json!([{"mesh": 0, "matrix": [1,0,0,1, 0,1,0,0, 0,0,1,0, 0,0,0,1]}]), "bottom row"),
    ] {
        assert!(edited("/nodes", node).contains(words), "{words}");
    }
}

#[test]
fn projections_are_refused() {
    let cosine = 0.999_8;
    for bottom in [[0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.001, 1.0], [0.0, 0.0, 0.0, cosine]] {
        let [a, b, c, d] = bottom;
        let node = json!([{"mesh": 0, "matrix": [1,0,0,a, 0,1,0,b, 0,0,1,c, 0,0,0,d]}]);
        assert!(edited("/nodes", node).contains("it is a projection"), "{bottom:?}");
    }
}

#[test]
fn what_stands_or_reaches_too_far_is_refused_by_name() {
    for size in [1.1e18, 1e30, 1e100, 1e160, 1e300] {
        for node in [
            json!({"name": "hall", "mesh": 0, "scale": [size, size, size]}),
            json!({"name": "hall", "mesh": 0, "scale": [1.0, 1.0, -size]}),
            json!({"name": "hall", "mesh": 0, "translation": [0.0, -size, 0.0]}),
        ] {
            let message = edited("/nodes", json!([node, {"mesh": 0}]));
            assert!(message.contains("object \"hall\": it reaches 1"), "{message}");
        }
    }
    let mut scene = Scene::triangle();
    scene.json["nodes"][0] =
        json!({"mesh": 0, "scale": [5e17, 5e17, 5e17], "translation": [4e17, 0.0, 0.0]});
    assert!(scene.import().is_ok());
}

#[test]
fn a_list_used_again_and_again_is_refused_before_it_is_read() {
    let many = |by_nodes: bool, times: usize| {
        let mut scene = Scene::triangle();
        let corners = scene.accessor(U8, "SCALAR", 60_000, &[0, 1, 2].repeat(20_000));
        let primitive = json!({"attributes": {"POSITION": 0}, "indices": corners});
        // Else one mesh would stand for all.
        let named = |place: usize| json!({"primitives": [primitive, {"attributes": {"POSITION": 0, "NORMAL": 0}, "mode": 4, "material": place}]});
        match by_nodes {
            false => {
                scene.json["meshes"] =
                    json!([{"name": "bomb", "primitives": vec![primitive.clone(); times]}])
            }
            true => {
                scene.json["materials"] = json!(vec![json!({}); times]);
                scene.json["meshes"] = (0..times).map(named).collect();
                scene.json["nodes"] = (0..times).map(|mesh| json!({"mesh": mesh})).collect();
            }
        }
        scene
    };
    let message = many(false, 900).error();
    assert!(
        message.contains("mesh 0 \"bomb\": with it the scene names 18000000 triangles"),
        "{message}"
    );
    assert!(many(true, 900).error().contains("the same lists again and again"));
    let mut flat = many(false, 1);
    flat.json["nodes"] = json!(vec![json!({"mesh": 0, "scale": [1.0, 1.0, 0.0]}); 900]);
    assert!(flat.error().contains("18000000 triangles"), "{}", flat.error());
    flat.json["nodes"] = json!(vec![json!({"mesh": 0}); 900]);
    assert_eq!(flat.import().unwrap().objects.len(), 900);
    assert_eq!(many(false, 3).import().unwrap().triangles(), 60_000);
}

#[test]
fn instances_out_of_nothing_are_refused_before_they_are_made() {
    // Zeros but for one element cost no bytes.
    let mut scene = Scene::triangle();
    let (places, values) = (scene.view(&[0; 4]), scene.view(&[0; 12]));
    scene.view(&[0; 100_000]);
    let all = json!({"componentType": 5126, "type": "VEC3", "count": 100_000, "sparse": {
        "count": 1, "indices": {"bufferView": places, "componentType": U32},
        "values": {"bufferView": values}}});
    let all = scene.add("accessors", all);
    let instances = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": all}}});
    let node = json!({"name": "wood", "mesh": 0, "extensions": instances});
    scene.json["nodes"] = json!(vec![node.clone(); 10]);
    assert_eq!(scene.import().unwrap().objects.len(), 1_000_000);
    scene.json["nodes"] = json!(vec![node; 11]);
    let message = scene.error();
    assert!(message.contains("node 10 \"wood\": with its 100000 instances"), "{message}");
}

#[test]
fn node_graphs_that_are_no_trees() {
    for nodes in [
        json!([{"mesh": 0, "children": [0]}]),
        json!([{"mesh": 0, "children": [1, 1]}, {}]),
        json!([{"mesh": 0, "children": [2]}, {"children": [2]}, {}]),
        json!([{"mesh": 0, "children": [1]}, {"children": [0]}]),
    ] {
        let mut scene = Scene::triangle();
        scene.json["nodes"] = nodes;
        scene.json["scenes"] = json!([{"nodes": [0]}]);
        assert!(scene.error().contains("forest of trees"), "{}", scene.error());
    }
    let message = edited("/scenes", json!([{"nodes": [0, 0]}]));
    assert!(message.contains("reached twice"), "{message}");
}

#[test]
fn a_deep_chain_of_nodes_does_not_exhaust_the_stack() {
    let mut scene = Scene::triangle();
    const DEPTH: usize = 100_000;
    let mut nodes: Vec<Value> = (1..DEPTH).map(|child| json!({"children": [child]})).collect();
    nodes.push(json!({"mesh": 0}));
    scene.json["nodes"] = Value::Array(nodes);
    assert_eq!(scene.import().unwrap().objects.len(), 1);
}

#[test]
fn sparse_elements_that_lie() {
    for (places, count, claimed, words) in [
        (vec![2, 1], 2, 3, "do not rise"),
        (vec![1, 1], 2, 3, "do not rise"),
        (vec![1, 3], 2, 3, "index 3 is beyond"),
        (vec![1, 2], 3, 3, "claims 3 sparse indices"),
        (vec![1, 2], usize::MAX, 3, "sparse indices"),
        (vec![1, 2], 2, usize::MAX, "no buffer view"),
    ] {
        let mut scene = Scene::triangle();
        let (places, values) = (scene.view(&places), scene.view(&[0; 24]));
        scene.json["accessors"][0] = json!({"componentType": 5126, "type": "VEC3", "count": claimed, "sparse": {
            "count": count, "indices": {"bufferView": places, "componentType": U8}, "values": {"bufferView": values},
        }});
        assert!(scene.error().contains(words), "{}", scene.error());
    }
}

#[test]
fn textures_whose_references_break_or_leave_the_folder() {
    for (texture, image, words) in [
        (json!(3), json!({}), "material 0 \"paint\": it refers to texture 3 of 1"),
        (json!(0), json!({"bufferView": 8}), "image 0"),
        (json!(0), json!({}), "neither a URI nor a buffer view"),
        (json!(0), json!({"uri": "/etc/passwd"}), "\"/etc/passwd\""),
    ] {
        let mut scene = Scene::triangle();
        scene.add("images", image);
        scene.add("textures", json!({"source": 0}));
        scene.add("materials", json!({"name": "paint", "pbrMetallicRoughness": {"baseColorTexture": {"index": texture}}}));
        scene.json["meshes"][0]["primitives"][0]["material"] = json!(0);
        assert!(scene.error().contains(words), "{}", scene.error());
    }
}

/// A scene with something of everything that is read.
fn rich() -> Scene {
    let mut scene = Scene::triangle();
    let normals = scene.floats("VEC3", &[0.0, 0.0, 1.0].repeat(3));
    let colors = scene.accessor(U8, "VEC4", 3, &[200; 12]);
    let picture = scene.view(&png(2, 1, &[[0, 0, 0, 255], [255, 255, 255, 255]]));
    let (places, values) = (scene.view(&[1]), scene.view(&[0, 0, 0, 64, 0, 0, 0, 0, 0, 0, 0, 0]));
    scene.json["accessors"][0]["sparse"] = json!({"count": 1, "indices": {"bufferView": places, "componentType": U8}, "values": {"bufferView": values}});
    scene.add("images", json!({"bufferView": picture}));
    scene.json["samplers"] = json!([{"wrapS": 33071}]);
    scene.add("textures", json!({"source": 0, "sampler": 0}));
    let transform = json!({"offset": [1, 2], "rotation": 3, "scale": [4, 5], "texCoord": 1});
    let texture = json!({"index": 0, "extensions": {"KHR_texture_transform": transform}});
    scene.add(
        "materials",
        json!({"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorTexture": texture}}),
    );
    let places = scene.floats("VEC3", &[1.0, 2.0, 3.0]);
    let coords = scene.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let attributes =
        json!({"POSITION": 0, "NORMAL": normals, "COLOR_0": colors, "TEXCOORD_1": coords});
    scene.json["meshes"][0]["primitives"] = json!([
        {"attributes": attributes, "indices": 1, "material": 0},
        {"attributes": {"POSITION": 0}, "mode": 5},
    ]);
    let instances = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}});
    scene.json["nodes"] = json!([{"children": [1, 2], "scale": [1.0, -2.0, 1.0]}, {"mesh": 0, "extensions": instances}, {"mesh": 0, "scale": [1.0, 1.0, 0.0]}]);
    scene.json["scenes"] = json!([{"nodes": [0]}]);
    scene
}

/// What every import promises, whatever the file was.
fn check(bytes: &[u8]) -> Result<(), TestCaseError> {
    match import_bytes(Path::new("scene.glb"), bytes) {
        Ok(source) => crate::import::testing::check(&source, TEXTURE_SIDE),
        Err(_) => Ok(()),
    }
}

#[test]
fn the_rich_scene_itself_is_good() {
    let source = rich().import().unwrap();
    assert_eq!(source.triangles(), 4);
    check(&rich().bytes()).unwrap();
}

#[test]
fn every_truncation_is_refused() {
    let whole = rich().bytes();
    for end in 0..whole.len() {
        assert!(import_bytes(Path::new("scene.glb"), &whole[..end]).is_err(), "cut at {end}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_mutation_of_the_bytes_panics(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        compressed: bool,
    ) {
        let scene = if compressed { square("TRIANGLES") } else { rich() };
        let mut bytes = scene.bytes();
        for (place, value) in edits {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        check(&bytes)?;
    }

    /// Replaces whole numbers of the JSON, which random bytes seldom leave well formed.
    #[test]
    fn no_mutation_of_the_numbers_panics(
        edits in prop::collection::vec((any::<prop::sample::Index>(), prop_oneof![
            (0u64..12).prop_map(|n| n.to_string()),
            any::<u64>().prop_map(|n| n.to_string()),
            any::<f64>().prop_filter("JSON has no others", |x| x.is_finite()).prop_map(|x| format!("{x:e}")),
            Just("[]".to_owned()), Just("null".to_owned()), Just("{}".to_owned()),
        ]), 1..4),
        compressed: bool,
    ) {
        let scene = if compressed { square("INDICES") } else { rich() };
        let mut json = scene.json.clone();
        json["buffers"][0]["byteLength"] = scene.bin.len().into();
        let mut text = json.to_string();
        for (place, value) in edits {
            let numbers: Vec<(usize, usize)> = numbers(&text);
            prop_assume!(!numbers.is_empty());
            let (start, end) = numbers[place.index(numbers.len())];
            text.replace_range(start..end, &value);
        }
        check(&crate::import::gltf::testing::glb(&text, &scene.bin))?;
    }
}

/// Where the runs of digits stand in `text`.
fn numbers(text: &str) -> Vec<(usize, usize)> {
    let digit = |place: usize| text.as_bytes().get(place).is_some_and(u8::is_ascii_digit);
    (0..text.len())
        .filter(|&place| digit(place) && !(place > 0 && digit(place - 1)))
        .map(|start| (start, (start..).find(|&end| !digit(end)).unwrap()))
        .collect()
}
