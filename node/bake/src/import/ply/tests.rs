use super::*;
use crate::import::testing::{TEXTURE_SIDE, check, collect};
use crate::source::{Alpha, Source, Surface};
use glam::DVec3;
use proptest::prelude::*;

/// A square with colours, normals and something unknown of every kind; then an element nobody knows.
const TEXT: &str = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\n\
    property float y\nproperty double z\nproperty float quality\nproperty uchar red\nproperty uchar green\n\
    property uchar blue\nproperty list uchar int rings\nelement face 1\nproperty uchar flags\n\
    property list uchar int vertex_indices\nelement edge 1\nproperty int vertex1\nend_header\n\
    0 0 0 9 255 0 188 0\n1 0 0 9 255 0 188 1 7\n1 1 0 9 255 0 188 2 7 7\n0 1 0 9 255 0 188 0\n3 4 0 1 2 3\n5\n";

fn parse(bytes: &[u8]) -> Result<Source, ImportError> {
    collect("scan.ply", |out| read(Path::new("scan.ply"), || Ok(bytes), out))
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
        ("1 1 0 9", "1 nan 0 9", "face 0: it refers to vertex 2, which stands at [1, NaN, 0]"),
        ("1 1 0 9", "1 1e999 0 9", "vertex 2, which stands at [1, inf, 0]"),
        ("1 1 0 9", "1 x 0 9", "vertex 2: \"x\" is no number"),
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

/// A text of these elements and lines: vertices have `lanes` floats.
fn text(lanes: &str, faces: &str, lines: &[&str]) -> String {
    let (vertices, rest) = (4, lines.len() - 4);
    let lanes: String = lanes.split(' ').map(|lane| format!("property float {lane}\n")).collect();
    format!(
        "ply\nformat ascii 1.0\ncomment TextureFile wall.png\nelement vertex {vertices}\n{lanes}element {} {rest}\n{}end_header\n{}\n",
        faces.split_once('\n').unwrap().0,
        faces.split_once('\n').unwrap().1,
        lines.join("\n")
    )
}

const SQUARE: [&str; 4] = ["0 0 0", "1 0 0", "1 1 0", "0 1 0"];
const FACE: &str = "face\nproperty list uchar int vertex_indices\n";

#[test]
fn what_is_left_of_a_line_is_not_read_and_said() {
    let whole =
        parse(text("x y z", FACE, &[&SQUARE[..], &["3 0 1 2", "3 0 2 3"]].concat()).as_bytes());
    let whole = whole.unwrap();
    let longer =
        [&["0 0 0 9 9", "1 0 0", "1 1 0", "0 1 0"][..], &["3 0 1 2 255 0 0", "3 0 2 3 7"]].concat();
    let source = parse(text("x y z", FACE, &longer).as_bytes()).unwrap();
    assert_eq!(source.meshes, whole.meshes);
    let note = source.notes.iter().find(|note| note.contains("longer")).unwrap();
    assert!(note.starts_with("3 lines"), "{note}");
    // In fewer lines than elements numbers follow each other.
    let joined = ["0 0 0 1 0 0", "1 1", "0 0 1 0 3 0 1", "2 3 0", "2 3"];
    let header = text("x y z", FACE, &[&SQUARE[..], &["", ""]].concat());
    let header = &header[..header.find("end_header\n").unwrap() + 11];
    let source = parse(format!("{header}{}", joined.join("\n")).as_bytes()).unwrap();
    assert_eq!(source.meshes, whole.meshes);
    assert!(!source.notes.iter().any(|note| note.contains("longer")));
}

#[test]
fn what_only_serves_looks_and_is_no_number_is_mended() {
    let lines = [
        "0 0 0 nan nan nan 1 0 0",
        "1 0 0 0 0 1 nan 0 0",
        "1 1 0 0 0 1 1 0 0",
        "nan 1 0 0 0 1 1 0 0",
        "3 0 1 2",
    ];
    let source = parse(text("x y z nx ny nz red green blue", FACE, &lines).as_bytes()).unwrap();
    let mesh = &source.meshes[0];
    assert_eq!(mesh.normals, [[0.0, 0.0, 1.0]; 3]);
    assert_eq!(mesh.colors, [[255, 0, 0, 255], [255; 4], [255, 0, 0, 255]]);
    assert!(source.notes.iter().any(|note| note.starts_with("1 normals")), "{:?}", source.notes);
}

#[test]
fn vertices_that_no_face_has_move_nothing() {
    let place = |unused: &str| {
        let lines = ["1e6 0 0", "1000001 0 0", "1000001 1 0", unused, "3 0 1 2"];
        parse(text("x y z", FACE, &lines).as_bytes()).unwrap().objects[0].world_from_mesh
    };
    assert_eq!(place("1e6 1 0").translation, DVec3::new(1_000_000.5, 0.5, 0.0));
    assert_eq!(place("-9e9 0 0"), place("1e6 1 0"));
    assert_eq!(place("nan inf 0"), place("1e6 1 0"));
}

#[test]
fn a_comment_may_be_broken() {
    for broken in ["comment made\nby hand: 3\n\nof mine\n", "made by hand\n"] {
        let text = TEXT.replace("comment made by hand\n", broken);
        assert_eq!(parse(text.as_bytes()).unwrap(), parse(TEXT.as_bytes()).unwrap());
    }
}

#[test]
fn strips_are_triangles_that_wind_alike() {
    let strips = "tristrips\nproperty list int int vertex_indices\n";
    let lines = [&SQUARE[..], &["8 0 1 3 2 -1 0 1 2"]].concat();
    let mesh = &parse(text("x y z", strips, &lines).as_bytes()).unwrap().meshes[0];
    assert_eq!(mesh.indices.len(), 3);
    assert!(mesh.normals.iter().all(|normal| *normal == [0.0, 0.0, 1.0]), "{:?}", mesh.normals);
}

#[test]
fn faces_have_colours_of_their_own() {
    let faces = format!("{FACE}property uchar red\nproperty uchar green\nproperty uchar blue\n");
    let lines = [&SQUARE[..], &["3 0 1 2 255 0 0", "3 0 2 3 0 0 255"]].concat();
    let mesh = &parse(text("x y z", &faces, &lines).as_bytes()).unwrap().meshes[0];
    let colors = mesh.indices.iter().map(|t| t.map(|corner| mesh.colors[corner as usize]));
    let colors: Vec<_> = colors.collect();
    assert_eq!(colors, [[[255, 0, 0, 255]; 3], [[0, 0, 255, 255]; 3]]);
}

#[test]
fn textures_lie_as_vertices_or_faces_say() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scan.ply");
    let at = |text: String| {
        std::fs::write(&file, text).unwrap();
        crate::import::import_all(&file).unwrap()
    };
    let by_vertex = || {
        let lines = ["0 0 0 0 0", "1 0 0 1 0", "1 1 0 1 1", "0 1 0 0 1", "4 0 1 2 3"];
        text("x y z s t", FACE, &lines)
    };
    let missing = at(by_vertex());
    assert!(missing.notes.iter().any(|note| note.contains("\"wall.png\" is missing")));
    let picture = image::RgbaImage::from_fn(2, 2, |x, _| image::Rgba([255 * x as u8, 0, 0, 255]));
    picture.save(folder.path().join("wall.png")).unwrap();
    assert_eq!(
        references(&file).unwrap(),
        [folder.path().join("wall.png").canonicalize().unwrap()]
    );

    let source = at(by_vertex());
    let mesh = &source.meshes[0];
    assert_eq!(source.surfaces[usize::from(mesh.sections[0].surface)].texture, Some(0));
    // Rows of the picture count from the top.
    assert_eq!(mesh.tex_coords, [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]);

    let faces = format!("{FACE}property list uchar float texcoord\nproperty int texnumber\n");
    let lines =
        [&SQUARE[..], &["3 0 1 2 6 0.5 0 1 0 1 0.25 0", "3 0 2 3 6 0 0 1 1 0 1 0"]].concat();
    let source = at(text("x y z", &faces, &lines));
    let mesh = &source.meshes[0];
    let first = mesh.indices[0].map(|corner| mesh.tex_coords[corner as usize]);
    assert_eq!(first, [[0.5, 1.0], [1.0, 1.0], [1.0, 0.75]]);
    let none = at(text("x y z", FACE, &[&SQUARE[..], &["3 0 1 2"]].concat()));
    assert!(none.notes[0].contains("no texture coordinates"), "{:?}", none.notes);
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
