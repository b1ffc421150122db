//! One test a feature of the format.

use glam::DVec3;
use serde_json::json;

use crate::import::gltf::testing::{F32, Scene, U8, U16, U32, glb, import_bytes};
use crate::import::{ImportLimits, import_all as import};
use crate::source::{Alpha, Section, Source, Surface};

fn world(source: &Source, object: usize) -> Vec<DVec3> {
    let object = &source.objects[object];
    let points = &source.meshes[object.mesh].positions;
    points
        .iter()
        .map(|p| object.world_from_mesh.transform_point3(DVec3::from(p.map(f64::from))))
        .collect()
}

/// Four corners of a unit square in the plane z = 0, round its rim.
const SQUARE: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];

#[test]
fn a_plain_triangle() {
    let source = Scene::triangle().import().unwrap();
    assert_eq!(source.up, [0.0, 1.0, 0.0]);
    assert_eq!(
        (source.meshes[0].name.as_str(), source.objects[0].name.as_str()),
        ("mesh 0", "node 0")
    );
    assert_eq!(source.meshes[0].indices, [[0, 1, 2]]);
    assert_eq!(source.meshes[0].normals, [[0.0, 0.0, 1.0]; 3]);
    assert_eq!(source.meshes[0].colors, [[255; 4]; 3]);
    assert!(source.notes.is_empty(), "{:?}", source.notes);
    let single = Surface { double_sided: false, ..Surface::PLAIN };
    assert_eq!(source.surfaces, [Surface::PLAIN, single]);
    assert_eq!(source.meshes[0].sections, [Section { end: 1, surface: 1 }]);
}

#[test]
fn indices_of_every_width_and_none() {
    for (component, bytes) in [
        (U8, vec![0, 1, 2]),
        (U16, vec![0, 0, 1, 0, 2, 0]),
        (U32, vec![0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]),
    ] {
        let mut scene = Scene::triangle();
        let indices = scene.accessor(component, "SCALAR", 3, &bytes);
        scene.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
        assert_eq!(scene.import().unwrap(), Scene::triangle().import().unwrap());
    }
    let mut scene = Scene::triangle();
    scene.json["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("indices");
    assert_eq!(scene.import().unwrap(), Scene::triangle().import().unwrap());
}

#[test]
fn the_least_normalised_integer_is_minus_one_like_the_one_above_it() {
    let bytes = [-128i8, 0, 0, 127, 0, 0, -127, 127, 0].map(|lane| lane as u8);
    let words = [i16::MIN, 0, 0, i16::MAX, 0, 0, -i16::MAX, i16::MAX, 0];
    for (component, bytes) in
        [(5120, bytes.to_vec()), (5122, words.iter().flat_map(|w| w.to_le_bytes()).collect())]
    {
        let mut scene = Scene::triangle();
        let positions = scene.accessor(component, "VEC3", 3, &bytes);
        scene.json["accessors"][positions]["normalized"] = json!(true);
        scene.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(positions);
        let found = &scene.import().unwrap().meshes[0].positions;
        assert_eq!(found[..], [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 1.0, 0.0]]);
    }
}

#[test]
fn strips_and_fans_keep_their_winding_and_drop_degenerate_joins() {
    let mut scene = Scene::new();
    let positions = scene.floats("VEC3", &SQUARE);
    let strip = scene.accessor(U8, "SCALAR", 6, &[0, 1, 3, 2, 2, 2]);
    let fan = scene.accessor(U8, "SCALAR", 4, &[0, 1, 2, 3]);
    for (mode, indices) in [(5, strip), (6, fan)] {
        let primitive =
            json!({"attributes": {"POSITION": positions}, "indices": indices, "mode": mode});
        let mesh = scene.add("meshes", json!({"primitives": [primitive]}));
        scene.add("nodes", json!({"mesh": mesh}));
    }
    let source = scene.import().unwrap();
    for (mesh, dropped) in source.meshes.iter().zip([2, 0]) {
        assert_eq!((mesh.indices.len(), mesh.dropped_degenerate), (2, dropped));
        // Flat faces of one plane share their corners.
        assert_eq!(mesh.normals, [[0.0, 0.0, 1.0]; 4]);
    }
    assert_eq!(source.triangles(), 6);
    assert!(source.notes[0].starts_with("2 degenerate"), "{:?}", source.notes);
}

#[test]
fn flat_shading_splits_a_vertex_between_planes() {
    let mut scene = Scene::new();
    let points = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let positions = scene.floats("VEC3", &points);
    let indices = scene.accessor(U8, "SCALAR", 6, &[0, 1, 2, 0, 2, 3]);
    scene.add(
        "meshes",
        json!({"primitives": [{"attributes": {"POSITION": positions}, "indices": indices}]}),
    );
    scene.add("nodes", json!({"mesh": 0}));
    let mesh = &scene.import().unwrap().meshes[0];
    assert_eq!(mesh.normals, [[[0.0, 0.0, 1.0]; 3], [[1.0, 0.0, 0.0]; 3]].concat());
    assert_eq!(mesh.indices, [[0, 1, 2], [3, 4, 5]]);
}

#[test]
fn normals_of_the_file_are_kept_and_those_without_direction_mended() {
    let mut scene = Scene::triangle();
    let normals = scene.floats("VEC3", &[3.0, 0.0, 4.0, 0.0, 0.0, 0.0, f32::NAN, 0.0, 1.0]);
    scene.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(normals);
    let source = scene.import().unwrap();
    assert_eq!(source.meshes[0].normals, [[0.6, 0.0, 0.8], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]);
    assert!(source.notes[0].starts_with("2 normals"));
}

#[test]
fn transforms_accumulate_and_meshes_stay_shared() {
    let mut scene = Scene::triangle();
    scene.json["nodes"] = json!([
        {"name": "root", "translation": [10.0, 0.0, 0.0], "scale": [2.0, 2.0, 2.0], "children": [2, 1]},
        {"name": "matrix", "mesh": 0, "matrix": [0,1,0,0, -1,0,0,0, 0,0,1,0, 5,0,0,1]},
        {"name": "turned", "mesh": 0, "rotation": [0.0, 0.0, 1.0, 1.0]},
    ]);
    let source = scene.import().unwrap();
    assert_eq!(source.meshes.len(), 1);
    // Depth first, children in the file's order.
    assert_eq!(
        source.objects.iter().map(|object| object.name.as_str()).collect::<Vec<_>>(),
        ["turned", "matrix"]
    );
    let near = |a: Vec<DVec3>, b: [[f64; 3]; 3]| {
        a.iter().zip(b).all(|(a, b)| (*a - DVec3::from(b)).length() < 1e-7)
    };
    assert!(near(world(&source, 0), [[10.0, 0.0, 0.0], [10.0, 2.0, 0.0], [8.0, 0.0, 0.0]]));
    assert!(near(world(&source, 1), [[20.0, 0.0, 0.0], [20.0, 2.0, 0.0], [18.0, 0.0, 0.0]]));
    assert_eq!((source.triangles(), source.unique_triangles()), (2, 1));
}

#[test]
fn a_mirror_keeps_its_sign() {
    let mut scene = Scene::triangle();
    scene.json["nodes"] = json!([{"mesh": 0, "scale": [-1.0, 1.0, 1.0]}, {"mesh": 0}]);
    let source = scene.import().unwrap();
    assert_eq!(
        source.objects.iter().map(|object| object.is_mirrored()).collect::<Vec<_>>(),
        [true, false]
    );
    assert_eq!(source.meshes.len(), 1);
}

#[test]
fn an_object_pressed_flat_gets_a_mesh_with_normals_of_its_own() {
    let mut scene = Scene::triangle();
    scene.json["nodes"] = json!([
        {"mesh": 0, "scale": [2.0, 2.0, 0.0], "translation": [0.0, 0.0, 7.0]},
        {"mesh": 0, "scale": [0.0, 1.0, 1.0]},
        {"mesh": 0},
    ]);
    let source = scene.import().unwrap();
    assert_eq!((source.objects.len(), source.triangles()), (3, 3));
    assert!(
        source.objects.iter().all(|object| object.world_from_mesh.matrix3.determinant() != 0.0)
    );
    assert_eq!(world(&source, 0)[1], DVec3::new(2.0, 0.0, 7.0));
    let mesh_of = |object: usize| &source.meshes[source.objects[object].mesh];
    assert_eq!(mesh_of(0).normals, [[0.0, 0.0, 1.0]; 3]);
    assert_eq!((mesh_of(1).indices.len(), mesh_of(1).dropped_degenerate), (0, 1));
}

#[test]
fn a_mesh_that_only_pressed_objects_show_leaves_no_trace() {
    let mut scene = Scene::triangle();
    scene.json["nodes"] = json!([{"mesh": 0, "scale": [1.0, 3.0, 0.0]}]);
    let source = scene.import().unwrap();
    assert_eq!((source.meshes.len(), source.objects[0].mesh), (1, 0));
    assert_eq!(source.meshes[0].positions[2], [0.0, 3.0, 0.0]);
}

#[test]
fn the_default_scene_is_shown_else_the_first_else_every_root() {
    let mut scene = Scene::triangle();
    scene.json["nodes"] = json!([{"mesh": 0, "name": "a"}, {"mesh": 0, "name": "b", "children": [2]}, {"mesh": 0, "name": "c"}]);
    let shown = |scene: &Scene| -> String {
        scene.import().unwrap().objects.iter().map(|object| object.name.clone()).collect()
    };
    assert_eq!(shown(&scene), "abc");
    scene.json["scenes"] = json!([{"nodes": [1]}, {"nodes": [0]}]);
    assert_eq!(shown(&scene), "bc");
    scene.json["scene"] = json!(1);
    assert_eq!(shown(&scene), "a");
}

#[test]
fn sparse_elements_replace_those_of_a_base_or_of_zero() {
    let mut scene = Scene::triangle();
    let places = scene.view(&[1, 2]);
    let moved: Vec<u8> =
        [4.0f32, 0.0, 0.0, 0.0, 4.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let values = scene.view(&moved);
    let sparse = json!({"count": 2, "indices": {"bufferView": places, "componentType": U8}, "values": {"bufferView": values}});
    scene.json["accessors"][0]["sparse"] = sparse;
    let expected = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]];
    assert_eq!(scene.import().unwrap().meshes[0].positions, expected);
    scene.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    assert_eq!(scene.import().unwrap().meshes[0].positions, expected);
}

#[test]
fn strides_offsets_and_quantised_components() {
    let mut scene = Scene::triangle();
    // One byte of lead-in, then three signed bytes and one of padding each.
    let bytes = [9, 0, 0, 0, 9, 127, 0, 0, 9, 0, 0x81, 0, 9];
    let positions = scene.accessor(5120, "VEC3", 3, &bytes);
    scene.json["accessors"][positions]["byteOffset"] = json!(1);
    scene.json["bufferViews"][positions]["byteStride"] = json!(4);
    scene.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(positions);
    scene.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    assert_eq!(
        scene.import().unwrap().meshes[0].positions,
        [[0.0; 3], [127.0, 0.0, 0.0], [0.0, -127.0, 0.0]]
    );
    scene.json["accessors"][positions]["normalized"] = json!(true);
    assert_eq!(
        scene.import().unwrap().meshes[0].positions,
        [[0.0; 3], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    );
}

#[test]
fn vertex_colours_of_every_kind_times_the_factor() {
    let floats: Vec<u8> =
        [1.0f32, 0.5, 0.0].repeat(3).iter().flat_map(|v| v.to_le_bytes()).collect();
    let shorts: Vec<u8> =
        [65535u16, 32768, 0, 65535].repeat(3).iter().flat_map(|v| v.to_le_bytes()).collect();
    let bytes = [255, 128, 0, 255].repeat(3);
    for (component, element, data) in
        [(F32, "VEC3", floats), (U16, "VEC4", shorts), (U8, "VEC4", bytes)]
    {
        let mut scene = Scene::triangle();
        let colors = scene.accessor(component, element, 3, &data);
        let primitive = &mut scene.json["meshes"][0]["primitives"][0];
        primitive["attributes"]["COLOR_0"] = json!(colors);
        primitive["material"] = json!(0);
        scene.add("materials", json!({
            "alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 1.0, 1.0, 0.5]},
        }));
        assert_eq!(
            scene.import().unwrap().meshes[0].colors,
            [[128, 128, 0, 128]; 3],
            "{component} {element}"
        );
    }
}

#[test]
fn gltf_with_buffers_in_files_and_in_data_uris() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scene.gltf");
    let mut scene = Scene::triangle();
    std::fs::write(folder.path().join("part one.bin"), &scene.bin).unwrap();
    scene.json["buffers"][0] = json!({"byteLength": scene.bin.len(), "uri": "part%20one.bin"});
    std::fs::write(&file, scene.json.to_string()).unwrap();
    assert_eq!(import(&file).unwrap(), Scene::triangle().import().unwrap());

    let escaped: String = scene.bin.iter().map(|byte| format!("%{byte:02X}")).collect();
    scene.json["buffers"][0]["uri"] = json!(format!("data:application/octet-stream,{escaped}"));
    std::fs::write(&file, scene.json.to_string()).unwrap();
    assert_eq!(import(&file).unwrap(), Scene::triangle().import().unwrap());
}

#[test]
fn primitives_merge_and_what_is_no_surface_is_noted() {
    let mut scene = Scene::triangle();
    let primitives = scene.json["meshes"][0]["primitives"].as_array_mut().unwrap();
    let mut second = primitives[0].clone();
    second["targets"] = json!([{"POSITION": 0}]);
    primitives.push(second);
    primitives.push(json!({"attributes": {"POSITION": 0}, "mode": 1}));
    primitives.push(json!({"attributes": {}}));
    scene.add("meshes", json!({"primitives": [{"attributes": {"POSITION": 0}, "mode": 0}]}));
    scene.add("nodes", json!({"mesh": 1}));
    for list in ["cameras", "skins", "animations"] {
        scene.json[list] = json!([{}]);
    }
    scene.json["extensionsUsed"] = json!(["EXT_else"]);
    let source = scene.import().unwrap();
    assert_eq!(source.meshes[0].indices, [[0, 1, 2], [3, 4, 5]]);
    assert_eq!(source.objects.len(), 1);
    let notes = source.notes.join("; ");
    for word in [
        "cameras",
        "skins",
        "animations",
        "2 point and line",
        "without positions",
        "morph",
        "EXT_else",
        "1 objects",
    ] {
        assert!(notes.contains(word), "{word}: {notes}");
    }
}

#[test]
fn only_the_vertices_in_use_are_kept() {
    let mut scene = Scene::new();
    let positions = scene.floats("VEC3", &[SQUARE.as_slice(), &[f32::NAN; 3]].concat());
    let normals = scene.floats("VEC3", &[0.0, 0.0, 1.0].repeat(5));
    let indices = scene.accessor(U8, "SCALAR", 3, &[1, 2, 3]);
    let attributes = json!({"POSITION": positions, "NORMAL": normals});
    scene.add("meshes", json!({"primitives": [{"attributes": attributes, "indices": indices}]}));
    scene.add("nodes", json!({"mesh": 0}));
    assert_eq!(
        scene.import().unwrap().meshes[0].positions,
        [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
    );
}

#[test]
fn chunks_of_unknown_kind_are_passed_over() {
    let mut bytes = Scene::triangle().bytes();
    bytes.extend([4, 0, 0, 0, b'X', b'T', b'R', b'A', 1, 2, 3, 4]);
    let length = bytes.len() as u32;
    bytes[8..12].copy_from_slice(&length.to_le_bytes());
    let file = std::path::Path::new("scene.glb");
    assert_eq!(import_bytes(file, &bytes).unwrap(), Scene::triangle().import().unwrap());
    assert!(import_bytes(file, &glb("[]", &[])).is_err());
}

#[test]
fn of_several_scenes_one_is_read_and_the_others_are_noted() {
    let mut scene = Scene::triangle();
    scene.json["nodes"] =
        json!([{"name": "a", "mesh": 0}, {"name": "b", "mesh": 0}, {"name": "c", "mesh": 0}]);
    scene.json["scenes"] =
        json!([{"nodes": [0]}, {"name": "1", "nodes": [1, 2]}, {"name": "main", "nodes": [2]}]);
    let read = |asked: &str| {
        scene.import_within(ImportLimits { scene: asked.into(), ..ImportLimits::default() })
    };
    let names = |asked: &str| -> Vec<String> {
        let source = read(asked).unwrap();
        assert!(source.notes[0].starts_with("2 other scenes left out"), "{:?}", source.notes);
        source.objects.into_iter().map(|object| object.name).collect()
    };
    assert_eq!(names(""), ["a"]);
    assert_eq!(names("main"), ["c"]);
    assert_eq!((names("0"), names("2")), (vec!["a".into()], vec!["c".into()]));
    // A name comes before a number.
    assert_eq!(names("1"), ["b", "c"]);
    assert_eq!(
        read("2").unwrap().notes[1],
        "2 nodes with meshes are not in the scene that is read"
    );
    for asked in ["else", "3", "-1"] {
        let message = read(asked).unwrap_err().to_string();
        assert!(message.contains(asked) && message.contains("scene 2 \"main\""), "{message}");
    }
    scene.json["scene"] = json!(1);
    assert_eq!(scene.import().unwrap().objects.len(), 2);
    // Without any scene all that hangs on a root is read.
    scene.json["scenes"] = json!([]);
    scene.json.as_object_mut().unwrap().remove("scene");
    scene.json["nodes"] = json!([{"mesh": 0}, {"mesh": 0, "children": [2]}, {"children": [1]}]);
    assert_eq!(
        scene.import().unwrap().notes,
        ["1 nodes with meshes are not in the scene that is read"]
    );
}

#[test]
fn lights_and_variants_are_noted() {
    let mut scene = Scene::triangle();
    scene.json["extensions"] = json!({
        "KHR_lights_punctual": {"lights": [{}, {}]}, "KHR_materials_variants": {"variants": [{}]},
    });
    let notes = scene.import().unwrap().notes;
    assert!(notes[0] == "2 lights ignored" && notes[1].starts_with("1 variants"), "{notes:?}");
}

#[test]
fn whole_numbers_may_have_a_point_everywhere() {
    let mut scene = Scene::triangle();
    let places = scene.floats("VEC3", &[1.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    scene.json["scene"] = json!(0);
    scene.json["scenes"] = json!([{"nodes": [0]}]);
    let instances = json!({"attributes": {"TRANSLATION": places}});
    scene.json["nodes"] = json!([{"children": [1]}, {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": instances}}]);
    scene.json["materials"] = json!([{}]);
    scene.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    scene.json["meshes"][0]["primitives"][0]["mode"] = json!(4);
    scene.json["buffers"][0]["byteLength"] = json!(scene.bin.len());
    fn pointed(value: &mut serde_json::Value) {
        match value {
            serde_json::Value::Number(number) => {
                *value = json!(number.as_f64().unwrap());
                assert!(value.to_string().contains('.'));
            }
            serde_json::Value::Array(all) => all.iter_mut().for_each(pointed),
            serde_json::Value::Object(all) => all.values_mut().for_each(pointed),
            _ => {}
        }
    }
    let plain = scene.import().unwrap();
    pointed(&mut scene.json);
    assert_eq!(scene.import().unwrap(), plain);
}

#[test]
fn a_matrix_may_be_rounded_in_its_bottom_row() {
    for (size, bottom) in [
        (1.0, [0.0, 0.0, 0.0, 0.999_999_9]),
        (1.0, [1e-9, -1e-7, 0.0, 1.0]),
        (1000.0, [0.0, 1e-4, 0.0, 1.000_001]),
    ] {
        let mut scene = Scene::triangle();
        let [a, b, c, d] = bottom;
        scene.json["nodes"][0]["matrix"] =
            json!([size, 0, 0, a, 0, size, 0, b, 0, 0, size, c, 5, 0, 0, d]);
        let source = scene.import().unwrap();
        assert_eq!(world(&source, 0)[1], DVec3::new(5.0 + size, 0.0, 0.0));
    }
}

#[test]
fn meshes_of_the_same_primitives_are_one() {
    let mut scene = Scene::triangle();
    let mesh = |material: usize, mode: u64| json!({"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": material, "mode": mode}]});
    scene.json["materials"] = json!([{}, {"doubleSided": true}]);
    scene.json["meshes"] = json!([mesh(0, 4), mesh(1, 4), mesh(0, 4), mesh(0, 5)]);
    scene.json["nodes"] = json!([{"mesh": 0}, {"mesh": 1}, {"mesh": 2}, {"mesh": 3}]);
    let source = scene.import().unwrap();
    let meshes: Vec<usize> = source.objects.iter().map(|object| object.mesh).collect();
    assert_eq!((source.meshes.len(), meshes), (3, vec![0, 1, 0, 2]));
}

#[test]
fn what_alpha_hides_altogether_is_noted() {
    let faded = |factor: f64, mode: &str, vertex: u8| {
        let mut scene = Scene::triangle();
        let colors = scene.accessor(U8, "VEC4", 3, &[9, 9, 9, vertex].repeat(3));
        let factor = json!({"baseColorFactor": [1.0, 1.0, 1.0, factor]});
        scene.add("materials", json!({"alphaMode": mode, "pbrMetallicRoughness": factor}));
        scene.json["meshes"][0]["primitives"][0]["material"] = json!(0);
        scene.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(colors);
        scene
    };
    for (factor, mode, vertex, is_hidden) in [
        (0.0, "BLEND", 255, true),
        (1.0, "BLEND", 0, true),
        (0.4, "MASK", 255, true),
        (0.9, "MASK", 100, true),
        (0.0, "OPAQUE", 0, false),
        (0.1, "BLEND", 255, false),
        (0.6, "MASK", 255, false),
    ] {
        let mut scene = faded(factor, mode, vertex);
        let notes = scene.import().unwrap().notes;
        let found =
            notes.iter().any(|note| note.starts_with("all of it is transparent: alpha is 0"));
        assert_eq!(found, is_hidden, "{factor} {mode} {vertex}: {notes:?}");
        // Something else is to be seen.
        let second = json!({"attributes": {"POSITION": 0}});
        scene.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(second);
        assert!(scene.import().unwrap().notes.is_empty());
    }
    assert_eq!(faded(0.6, "MASK", 255).import().unwrap().surfaces[1].alpha, Alpha::Mask(0.5));
}
