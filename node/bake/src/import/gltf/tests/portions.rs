//! Large primitives, which are read a portion at a time.

use serde_json::json;

use crate::import::gltf::testing::{F32, Scene, U32};
use crate::source::PART_TRIANGLES;

/// A strip of `count` quads: every second triangle is one of `count`, then those in between.
fn long(count: u32) -> (Scene, Vec<[[f32; 3]; 3]>) {
    let at = |i: u32| [(i / 2) as f32, (i % 2) as f32, (i as f32 * 0.01).sin()];
    let mut scene = Scene::new();
    let points: Vec<f32> = (0..2 * count + 2).flat_map(at).collect();
    // Two strides: the normals stand beside the positions.
    let both: Vec<u8> = points
        .chunks(3)
        .flat_map(|p| [p[0], p[1], p[2], 0.0, 0.6, 0.8])
        .flat_map(f32::to_le_bytes)
        .collect();
    let view = scene.view(&both);
    scene.json["bufferViews"][view]["byteStride"] = json!(24);
    let vertices = 2 * count + 2;
    let accessor = |offset: u32| {
        json!({"bufferView": view, "byteOffset": offset, "componentType": F32, "type": "VEC3",
            "count": vertices})
    };
    let positions = scene.add("accessors", accessor(0));
    let normals = scene.add("accessors", accessor(12));
    let triangles: Vec<[u32; 3]> = (0..count)
        .map(|i| [2 * i, 2 * i + 2, 2 * i + 1])
        .chain((0..count).map(|i| [2 * i + 1, 2 * i + 2, 2 * i + 3]))
        .collect();
    let mut bytes: Vec<u8> =
        triangles.iter().flatten().flat_map(|index| index.to_le_bytes()).collect();
    // Two corners too many.
    bytes.extend([0; 8]);
    let indices = scene.accessor(U32, "SCALAR", 3 * triangles.len() + 2, &bytes);
    scene.add(
        "meshes",
        json!({"primitives": [{"attributes": {"POSITION": positions, "NORMAL": normals},
            "indices": indices, "targets": [{}]}]}),
    );
    scene.add("nodes", json!({"mesh": 0}));
    (scene, triangles.into_iter().map(|t| t.map(at)).collect())
}

#[test]
fn a_large_primitive_arrives_whole_and_in_order() {
    let (scene, expected) = long(PART_TRIANGLES as u32 + 100);
    let source = scene.import().unwrap();
    assert_eq!((source.meshes.len(), source.objects.len()), (1, 1));
    let mesh = &source.meshes[0];
    let corner = |index: u32| mesh.positions[index as usize];
    let found: Vec<[[f32; 3]; 3]> = mesh.indices.iter().map(|t| t.map(corner)).collect();
    assert!(found == expected);
    assert!(mesh.normals.iter().all(|normal| *normal == [0.0, 0.6, 0.8]));
    assert_eq!(mesh.sections.last().unwrap().end as usize, expected.len());
    // What is true of the primitive is said once.
    let says = source.notes.join("; ");
    assert!(
        says.contains("2 corners left over") && says.contains("1 primitives with morph"),
        "{says}"
    );
}

#[test]
fn a_large_primitive_without_indices_arrives_whole() {
    let (mut scene, _) = long(2 * PART_TRIANGLES as u32);
    scene.json["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("indices");
    let mesh = &scene.import().unwrap().meshes[0];
    assert_eq!(mesh.triangles() as usize, (4 * PART_TRIANGLES).div_ceil(3));
    for (i, triangle) in mesh.indices.iter().enumerate() {
        for (k, &index) in triangle.iter().enumerate() {
            let vertex = 3 * i + k;
            let [x, y, _] = mesh.positions[index as usize];
            assert_eq!([x, y], [(vertex / 2) as f32, (vertex % 2) as f32]);
        }
    }
}

#[test]
fn objects_pressed_flat_show_all_of_a_large_primitive() {
    let (mut scene, expected) = long(PART_TRIANGLES as u32);
    scene.json["nodes"][0]["scale"] = json!([1.0, 1.0, 0.0]);
    let source = scene.import().unwrap();
    assert_eq!((source.meshes.len(), source.triangles() as usize), (1, expected.len()));
    assert!(source.meshes[0].positions.iter().all(|p| p[2] == 0.0));
}

#[test]
fn a_wrong_index_far_behind_is_named_by_its_place() {
    let (mut scene, _) = long(PART_TRIANGLES as u32);
    let at = scene.bin.len() - 8 - 4;
    scene.bin[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    let says = scene.error();
    assert!(says.contains("its index 4294967295, at place 393215"), "{says}");
}

/// A triangle of vertices that stand far apart in a list of `count`, beside normals, with a sparse one.
fn wide(count: u32) -> Scene {
    let mut scene = Scene::new();
    let points = (0..count).flat_map(|i| [i as f32, (i % 7) as f32, 0.0, 0.0, 0.6, 0.8]);
    let both: Vec<u8> = points.flat_map(f32::to_le_bytes).collect();
    let view = scene.view(&both);
    scene.json["bufferViews"][view]["byteStride"] = json!(24);
    let accessor = |offset: u32| {
        json!({"bufferView": view, "byteOffset": offset, "componentType": F32, "type": "VEC3",
            "count": count})
    };
    let mut positions = accessor(0);
    let places = scene.view(&(count - 2).to_le_bytes());
    let values: Vec<u8> = [5.0f32, 6.0, 7.0].into_iter().flat_map(f32::to_le_bytes).collect();
    let values = scene.view(&values);
    positions["sparse"] = json!({"count": 1, "indices": {"bufferView": places, "componentType": U32},
        "values": {"bufferView": values}});
    let positions = scene.add("accessors", positions);
    let normals = scene.add("accessors", accessor(12));
    let corners = [count - 2, 3, count / 2, 3, 4, count - 2];
    let corners: Vec<u8> = corners.into_iter().flat_map(u32::to_le_bytes).collect();
    let indices = scene.accessor(U32, "SCALAR", 6, &corners);
    let attributes = json!({"POSITION": positions, "NORMAL": normals});
    scene.add("meshes", json!({"primitives": [{"attributes": attributes, "indices": indices}]}));
    scene.add("nodes", json!({"mesh": 0}));
    scene
}

#[test]
fn vertices_far_apart_in_a_list_are_picked_from_it() {
    // In a short list they are read with what lies between them.
    for count in [60, 100_000] {
        let source = wide(count).import().unwrap();
        let mesh = &source.meshes[0];
        let at = |i: u32| [i as f32, (i % 7) as f32, 0.0];
        let mended = [5.0, 6.0, 7.0];
        assert_eq!(mesh.positions, [mended, at(3), at(count / 2), at(4)], "{count}");
        assert_eq!(mesh.normals, [[0.0, 0.6, 0.8]; 4]);
        assert_eq!(mesh.indices, [[0, 1, 2], [1, 3, 0]]);
    }
    let mut broken = wide(100_000);
    let third = 24 * 50_000;
    broken.bin[third..third + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(broken.error().contains("its position 50000 is [NaN"), "{}", broken.error());
}
