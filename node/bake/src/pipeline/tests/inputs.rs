//! Several sources become one scene.

use super::*;
use crate::synth::{self, Kind};
use protocol::format::mesh::textured_vertices_of;
use std::io::Cursor;

/// A GLB of a quad with a picture that begins with one colour, `x` to the right.
fn quad(x: f32, color: [u8; 4]) -> Vec<u8> {
    let mut picture = Cursor::new(Vec::new());
    // One colour alone would need no picture.
    let dark = image::Rgba([0, 0, 0, 255]);
    let shade = |x, y| if x == 0 && y == 0 { image::Rgba(color) } else { dark };
    let pixels = image::RgbaImage::from_fn(4, 4, shade);
    pixels.write_to(&mut picture, image::ImageFormat::Png).unwrap();
    let picture = picture.into_inner();
    let positions = [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 1.0, 0.0], [x + 1.0, 1.0, 0.0]];
    let mut binary: Vec<u8> = bytemuck::cast_slice(&positions).to_vec();
    binary.extend_from_slice(bytemuck::cast_slice(&[
        [0.0f32, 0.0],
        [1.0, 0.0],
        [0.0, 1.0],
        [1.0, 1.0],
    ]));
    binary.extend_from_slice(bytemuck::cast_slice(&[0u16, 1, 2, 1, 3, 2]));
    binary.extend_from_slice(&picture);
    let length = binary.len();
    binary.resize(length.next_multiple_of(4), 0);
    let json = serde_json::json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [
            {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
             "min": [x, 0, 0], "max": [x + 1.0, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 32},
            {"buffer": 0, "byteOffset": 80, "byteLength": 12},
            {"buffer": 0, "byteOffset": 92, "byteLength": picture.len()}],
        "buffers": [{"byteLength": length}],
    });
    let mut json = json.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend((28 + json.len() as u32 + binary.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &binary)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    out
}

const RED: [u8; 4] = [250, 10, 20, 255];
const BLUE: [u8; 4] = [10, 20, 250, 255];

/// A folder with two textured files and two without.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    write("red.glb", &quad(0.0, RED));
    write("blue.glb", &quad(5.0, BLUE));
    write("wedge.obj", b"v 10 0 0\nv 11 0 0\nv 10 1 0\nf 1 2 3\n");
    let pipes = synth::generate(Kind::Pipes, Some(5_000), 1);
    synth::write_glb(&pipes, &folder.path().join("pipes.glb")).unwrap();
    folder
}

/// Bakes files of the folder; the store, and by place along x the colour of every textured vertex.
fn textured(folder: &Path, inputs: &[&str]) -> (Store, Vec<(f64, [u8; 4])>) {
    let inputs: Vec<PathBuf> = inputs.iter().map(|name| folder.join(name)).collect();
    let path = folder.join("scene.occ");
    bake(&inputs, &path, &Options::default(), &Silent).unwrap();
    let store = Store::open(&path).unwrap();
    sound(&store);
    let mut seen = Vec::new();
    for (id, blob) in store.skeleton().blobs.iter().enumerate() {
        let bytes = store.load_blob(BlobId(id as u32)).unwrap();
        for vertex in textured_vertices_of(blob, &bytes).filter(|v| v.texture != format::NONE) {
            let pixels = store.load_texture(vertex.texture).unwrap();
            let x = blob.origin[0] + blob.step * f64::from(vertex.plain.grid()[0]);
            seen.push((x, [pixels[0], pixels[1], pixels[2], pixels[3]]));
        }
    }
    (store, seen)
}

#[test]
fn two_textured_files_keep_their_own_pictures() {
    let folder = folder();
    for inputs in [["red.glb", "blue.glb"], ["blue.glb", "red.glb"]] {
        let (store, seen) = textured(folder.path(), &inputs);
        assert_eq!(store.skeleton().textures.len(), 2);
        assert_eq!(store.skeleton().info.source_triangles, 4);
        assert!(seen.len() >= 8, "{seen:?}");
        for (x, color) in seen {
            assert_eq!(color, if x < 3.0 { RED } else { BLUE }, "{x}");
        }
    }
}

#[test]
fn a_textured_file_beside_others_keeps_its_picture() {
    let folder = folder();
    for inputs in [["wedge.obj", "blue.glb"], ["blue.glb", "wedge.obj"]] {
        let (store, seen) = textured(folder.path(), &inputs);
        assert_eq!(store.skeleton().textures.len(), 1);
        assert_eq!(store.skeleton().info.source_triangles, 3);
        assert_eq!(store.skeleton().info.objects, 2);
        assert!(seen.len() >= 4 && seen.iter().all(|&(x, color)| x < 7.0 && color == BLUE));
    }
    let (store, seen) = textured(folder.path(), &["red.glb", "pipes.glb", "wedge.obj", "blue.glb"]);
    assert_eq!(store.skeleton().textures.len(), 2);
    assert!(seen.iter().any(|seen| seen.1 == RED) && seen.iter().any(|seen| seen.1 == BLUE));
}

#[test]
fn generated_scenes_pass_the_deep_check() {
    let folder = tempfile::tempdir().unwrap();
    let (glb, occ) = (folder.path().join("a.glb"), folder.path().join("a.occ"));
    for (kind, triangles) in [(Kind::Plant, 40_000), (Kind::Pipes, 20_000)] {
        synth::write_glb(&synth::generate(kind, Some(triangles), 1), &glb).unwrap();
        bake(std::slice::from_ref(&glb), &occ, &Options::default(), &Silent).unwrap();
        let found = sound(&Store::open(&occ).unwrap());
        assert!(found.levels > 20, "{kind:?} {}", found.levels);
    }
}

#[test]
fn one_bad_file_among_good_ones_is_named_and_leaves_nothing() {
    let folder = folder();
    std::fs::write(folder.path().join("bad.obj"), "v 0 0 0\nf 1 2 3\n").unwrap();
    let before = names(folder.path());
    let inputs = ["red.glb", "bad.obj"].map(|name| folder.path().join(name));
    let output = folder.path().join("scene.occ");
    let error = bake(&inputs, &output, &Options::default(), &Silent).unwrap_err();
    assert_eq!(error.exit_code(), 65);
    assert!(error.to_string().contains("bad.obj"), "{error}");
    assert_eq!(names(folder.path()), before);
}
