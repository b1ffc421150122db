use super::*;
use crate::import::testing::{TEXTURE_SIDE, check, collect};
use crate::source::Source;
use proptest::prelude::*;

/// A square with colours, normals and something unknown of every kind; then an element nobody knows.
const TEXT: &str = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\n\
    property float y\nproperty double z\nproperty float quality\nproperty uchar red\nproperty uchar green\n\
    property uchar blue\nproperty list uchar int rings\nelement face 1\nproperty uchar flags\n\
    property list uchar int vertex_indices\nelement edge 1\nproperty int vertex1\nend_header\n\
    0 0 0 9 255 0 188 0\n1 0 0 9 255 0 188 1 7\n1 1 0 9 255 0 188 2 7 7\n0 1 0 9 255 0 188 0\n3 4 0 1 2 3\n5\n";

fn parse(bytes: &[u8]) -> Result<Source, ImportError> {
    collect("scan.ply", |out| read(Path::new("scan.ply"), bytes, out))
}

fn error(bytes: &[u8]) -> String {
    let message = parse(bytes).unwrap_err().to_string();
    assert!(message.starts_with("scan.ply: "), "{message}");
    message
}

/// A triangle in the plane z = 0 with normals and float colours, in either byte order.
fn binary(little: bool) -> Vec<u8> {
    let order = if little { "little" } else { "big" };
    let mut out = format!("ply\r\nformat binary_{order}_endian 1.0\r\nelement vertex 3\r\n");
    for name in ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha"] {
        out += &format!("property float32 {name}\r\n");
    }
    out += "element face 1\r\nproperty list ushort uint vertex_index\r\nend_header\r\n";
    let mut out = out.into_bytes();
    let mut put = |bytes: &mut [u8]| {
        if !little {
            bytes.reverse();
        }
        out.extend_from_slice(bytes);
    };
    for corner in [[0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
        for lane in corner.into_iter().chain([0.0, 0.0, -2.0, 1.0, 0.5, 0.0, 0.5]) {
            put(&mut lane.to_le_bytes());
        }
    }
    put(&mut 3u16.to_le_bytes());
    (0..3u32).for_each(|index| put(&mut index.to_le_bytes()));
    out
}

#[test]
fn a_cloud_of_points_is_called_one() {
    for text in [
        "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n",
        &TEXT.replace("element face 1", "element face 0"),
        &TEXT.replace("vertex_indices", "something"),
    ] {
        assert!(error(text.as_bytes()).contains("point cloud"));
    }
}

#[test]
fn text_with_unknown_properties() {
    let source = parse(TEXT.as_bytes()).unwrap();
    let mesh = &source.meshes[0];
    assert_eq!((mesh.name.as_str(), source.up), ("scan", [0.0, 0.0, 1.0]));
    assert_eq!(mesh.indices, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(mesh.normals, [[0.0, 0.0, 1.0]; 4]);
    assert_eq!(mesh.colors, [[255, 0, 128, 255]; 4]);
    assert_eq!(source.surfaces[usize::from(mesh.sections[0].surface)], Surface::PLAIN);
    assert!(source.notes.is_empty(), "{:?}", source.notes);
}

#[test]
fn both_byte_orders_give_the_same_mesh() {
    let source = parse(&binary(true)).unwrap();
    assert_eq!(source, parse(&binary(false)).unwrap());
    let mesh = &source.meshes[0];
    assert_eq!(mesh.normals, [[0.0, 0.0, -1.0]; 3]);
    // 0.5 in sRGB is 0.214 in linear light; alpha is linear as it stands.
    assert_eq!(mesh.colors, [[255, 55, 0, 128]; 3]);
    assert_eq!(source.surfaces[usize::from(mesh.sections[0].surface)].alpha, Alpha::Blend);
}

#[test]
fn faults_name_the_element() {
    for (from, to, words) in [
        ("ply", "plx", "is not \"ply\""),
        ("format ascii 1.0", "format ascii 2.0", "not understood"),
        ("format ascii 1.0\n", "", "no line \"format\""),
        ("property double z", "property quad z", "unknown type"),
        ("property double z", "property double w", "vertices have no z"),
        ("element vertex 4", "property int a", "before any element"),
        ("element vertex 4", "element vertex 99999999999999999", "vertex 4: the file ends"),
        ("1 1 0 9", "1 nan 0 9", "vertex 2: \"nan\""),
        ("1 1 0 9", "1 1e999 0 9", "vertex 2: \"1e999\""),
        ("3 4 0 1 2 3", "3 4 0 1 2 4", "face 0: it refers to vertex 4 of the 4"),
        ("3 4 0 1 2 3", "3 4 0 1 2 -1", "face 0: it refers to vertex -1"),
        ("3 4 0 1 2 3", "3 255 0 1 2 3", "face 0: it refers to vertex 5 of the 4"),
        ("end_header", "end_heade", "not understood"),
    ] {
        let message = error(TEXT.replacen(from, to, 1).as_bytes());
        assert!(message.contains(words), "{to}: {message}");
    }
}

#[test]
fn coordinates_far_from_the_origin_keep_their_digits() {
    let text = TEXT
        .replace("property float x", "property double x")
        .replace("1 1 0 9", "10000001.25 1 0 9");
    let text = text.replace("1 0 0 9", "10000001 0 0 9").replace("0 0 0 9", "10000000 0 0 9");
    let source = parse(text.replace("\n0 1 0 9", "\n10000000 1 0 9").as_bytes()).unwrap();
    let place = source.objects[0].world_from_mesh;
    let corner = DVec3::from(source.meshes[0].positions[2].map(f64::from));
    assert_eq!(place.transform_point3(corner), DVec3::new(10_000_001.25, 1.0, 0.0));
}

#[test]
fn sizes_far_from_one_keep_their_triangles() {
    for size in ["1e-6", "1e6", "1e17"] {
        let text = TEXT.replace("\n1 0 0 9", &format!("\n{size} 0 0 9"));
        let source = parse(text.as_bytes()).unwrap();
        assert_eq!(source.meshes[0].indices.len(), 2, "{size}");
    }
}

#[test]
fn no_truncation_is_taken_for_a_whole() {
    for whole in [binary(true), binary(false), TEXT.trim_end().as_bytes().to_vec()] {
        for end in 0..whole.len() {
            assert!(parse(&whole[..end]).is_err(), "cut at {end}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_mutation_panics(edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6), which in 0..3) {
        let mut bytes = match which {
            0 => TEXT.as_bytes().to_vec(),
            1 => binary(true),
            _ => binary(false),
        };
        for (place, value) in edits {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        if let Ok(source) = parse(&bytes) {
            check(&source, TEXTURE_SIDE)?;
        }
    }
}
