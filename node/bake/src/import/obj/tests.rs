use super::*;
use crate::import::import_all;
use crate::import::testing::{TEXTURE_SIDE, check, collect};
use crate::source::{Alpha, Source, Surface, Wrap};
use proptest::prelude::*;

const SCENE: &str = "# a yard\nmtllib yard.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\n\
    vn 0 0 2\no floor\nusemtl stone\nf 1/1/1 2/2/1 3/3/1 4/1/1\nusemtl glass\nf -4//1 -3//-1 \\\n -2//1\n\
    g hut\ns off\nf 1 3 2\nl 1 2\n";
const LIBRARY: &str = "newmtl stone\nKd 1 0.5 0\nmap_Kd -clamp on wall.png\n\nnewmtl glass\nKd 0 0 1\nd 0.5\nmap_d x.png\n";

fn parse(bytes: &[u8]) -> Result<Source, ImportError> {
    collect("yard.obj", |out| read(Path::new("yard.obj"), bytes, out))
}

fn error(text: &str) -> String {
    let message = parse(text.as_bytes()).unwrap_err().to_string();
    assert!(message.starts_with("yard.obj: "), "{message}");
    message
}

fn world(source: &Source, object: usize, vertex: usize) -> DVec3 {
    let object = &source.objects[object];
    let point = source.meshes[object.mesh].positions[vertex];
    object.world_from_mesh.transform_point3(DVec3::from(point.map(f64::from)))
}

#[test]
fn nothing_shows_nothing() {
    for text in ["", "# nothing\n", "v 0 0 0\n", "v 0 0 0\nf 1 1 1\n", "v 0 0 0\nf 1\nf\n"] {
        assert!(error(text).contains("no triangles"));
    }
}

#[test]
fn objects_groups_and_materials() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("yard.obj");
    std::fs::write(&file, SCENE).unwrap();
    std::fs::write(folder.path().join("yard.mtl"), LIBRARY).unwrap();
    let picture =
        image::RgbaImage::from_fn(2, 2, |x, y| image::Rgba([255 * (x & y) as u8, 0, 0, 255]));
    picture.save(folder.path().join("wall.png")).unwrap();
    let source = import_all(&file).unwrap();
    let names: Vec<&str> = source.objects.iter().map(|object| object.name.as_str()).collect();
    assert_eq!((names, source.up), (vec!["floor", "hut"], [0.0, 1.0, 0.0]));
    let [floor, hut] = &source.meshes[..] else { panic!("{}", source.meshes.len()) };
    assert_eq!((floor.indices.len(), hut.indices.len(), floor.sections.len()), (3, 1, 2));
    let surface = |section: usize| source.surfaces[usize::from(floor.sections[section].surface)];
    assert_eq!(surface(0), Surface { texture: Some(0), ..Surface::PLAIN });
    assert_eq!(surface(1), Surface { alpha: Alpha::Blend, ..Surface::PLAIN });
    assert_eq!((source.textures[0].side, source.textures[0].wrap), (2, [Wrap::Clamp; 2]));
    // Rows of the picture count from the top, coordinates of the file from the bottom.
    assert_eq!(floor.tex_coords[..3], [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]);
    assert_eq!(floor.colors[0], [255, 55, 0, 255]);
    assert_eq!(floor.colors[4], [0, 0, 255, 128]);
    assert_eq!(floor.normals[0], [0.0, 0.0, 1.0]);
    // Flat, and of the material of the object before.
    assert_eq!(hut.normals, [[0.0, 0.0, -1.0]; 3]);
    assert_eq!(hut.colors[0], [0, 0, 255, 128]);
    let notes = source.notes.join("; ");
    assert!(notes.contains("map_d") && notes.contains("1 point and line"), "{notes}");
}

#[test]
fn a_library_or_a_picture_that_is_missing_is_a_note() {
    let source = parse(SCENE.as_bytes()).unwrap();
    assert_eq!(source.meshes[0].colors[0], [255; 4]);
    assert_eq!(source.surfaces, [Surface::PLAIN]);
    let notes = source.notes.join("; ");
    assert!(notes.contains("\"yard.mtl\" is missing") && notes.contains("\"glass\""), "{notes}");

    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("yard.obj");
    std::fs::write(&file, SCENE).unwrap();
    for map in ["C:\\pictures\\wall.png", "/pictures/wall.png", "../wall.png", "wall.png"] {
        std::fs::write(folder.path().join("yard.mtl"), LIBRARY.replace("wall.png", map)).unwrap();
        let source = import_all(&file).unwrap();
        assert!(source.notes.join("; ").contains("missing in the scene's folder, its colour"));
        assert_eq!(source.meshes[0].colors[0], [255, 55, 0, 255]);
    }
    // A path of another machine, and the file beside the scene.
    image::RgbaImage::from_pixel(1, 1, image::Rgba([255, 255, 0, 255]))
        .save(folder.path().join("wall.png"))
        .unwrap();
    let library = LIBRARY.replace("wall.png", "C:\\pictures\\wall.png");
    std::fs::write(folder.path().join("yard.mtl"), library).unwrap();
    let source = import_all(&file).unwrap();
    assert!(source.textures.is_empty() && source.meshes[0].tex_coords.is_empty());
    assert_eq!(source.meshes[0].colors[0], [255, 55, 0, 255]);
}

#[test]
fn colours_of_vertices_are_srgb() {
    let text = "v 0 0 0 1 0.5 0\nv 1 0 0 1 1 0.5 0\nv 0 1 0\nf 1 2 3\n";
    let colors = parse(text.as_bytes()).unwrap().meshes[0].colors.clone();
    assert_eq!(colors, [[255, 55, 0, 255], [255, 55, 0, 255], [255; 4]]);
}

#[test]
fn faults_name_the_line() {
    for (from, to, words) in [
        ("v 1 0 0", "v 1 0", "line 4: \"v 1 0\": 2 numbers"),
        ("v 1 0 0", "v 1 nan 0", "stands nowhere (line 4)"),
        ("v 1 0 0", "v 1 x 0", "line 4: \"v 1 x 0\": \"x\" is no number"),
        ("f 1 3 2", "f 1 3 9", "line 19: \"f 1 3 9\": it refers to vertex 9 of the 4 before it"),
        ("f 1 3 2", "f 1 3 0", "vertex 0"),
        ("f 1 3 2", "f 1 3 -5", "vertex -5"),
        ("f 1 3 2", "f 1 3 9223372036854775808", "is no number"),
        ("f 1 3 2", "f 1 3 -9223372036854775808", "refers to vertex"),
        ("f 1 3 2", "f 1/x 3 2", "no number of a texture coordinate"),
        ("f 1 3 2", "f 1/1/1/1 3 2", "no corner"),
        ("f 1 3 2", "f x 3 2", "\"x\" is no number"),
        ("# a yard", "\0\0", "line 1"),
    ] {
        let message = error(&SCENE.replacen(from, to, 1));
        assert!(message.contains(words), "{to}: {message}");
    }
}

#[test]
fn what_only_serves_looks_may_be_missing_or_no_number() {
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv nan 0 0\n";
    for (rest, word) in [
        ("vn 0 0\nf 1//1 2//1 3//1\n", "3 normals without a direction"),
        ("vn nan nan nan\nf 1//1 2//1 3//1\n", "3 normals without a direction"),
        ("vn\nf 1//1 2//1 3//1\n", "3 normals"),
        ("f 1//1 2//1 3//9\n", "3 references to normals"),
        ("vt 0 0\nf 1/1 2/2 3/-2\n", "2 references to normals or texture coordinates"),
    ] {
        let source = parse(format!("{square}{rest}").as_bytes()).unwrap();
        assert_eq!(source.meshes[0].normals, [[0.0, 0.0, 1.0]; 3], "{rest}");
        assert!(source.notes.join("; ").contains(word), "{rest}: {:?}", source.notes);
    }
    let source = parse(b"v 0 0 0 1 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    assert_eq!(source.meshes[0].colors, [[255; 4]; 3]);
}

#[test]
fn lines_are_written_in_many_ways() {
    let expected = parse(SCENE.as_bytes()).unwrap();
    let marked = format!("\u{feff}{SCENE}");
    let commented =
        SCENE.replace("v 1 0 0\n", "v 1 0 0 # right\n").replace("s off", "# one \\\ns off");
    for text in [marked, SCENE.replace('\n', "\r"), SCENE.replace('\n', "\r\n"), commented] {
        assert_eq!(parse(text.as_bytes()).unwrap(), expected, "{text:?}");
    }
    let wide: Vec<u8> = SCENE.encode_utf16().flat_map(u16::to_be_bytes).collect();
    assert!(parse(&wide).unwrap_err().to_string().contains("UTF-16"));
}

#[test]
fn transparency_and_dissolve_and_keywords_in_any_case() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("yard.obj");
    let alpha = |library: &str| {
        std::fs::write(&file, "mtllib yard.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
            .unwrap();
        std::fs::write(folder.path().join("yard.mtl"), format!("NewMtl a\n{library}\n")).unwrap();
        let source = import_all(&file).unwrap();
        (source.meshes[0].colors[0][3], source.notes.len())
    };
    assert_eq!(alpha("D 0.2"), (51, 0));
    assert_eq!(alpha("tr 0.8"), (51, 0));
    // The word that is plain goes first, in whatever order.
    assert_eq!(alpha("Tr 1\nd 1"), (255, 0));
    assert_eq!(alpha("d 1\nTr 1"), (255, 0));
    assert_eq!(alpha("d 0.2\nTr 0.2"), (51, 0));
    // What is no number is said; nothing that is seen is, too.
    assert_eq!(alpha("d nan"), (255, 1));
    assert_eq!(alpha("d 0"), (0, 1));
}

#[test]
fn libraries_are_read_once_and_their_pictures_lie_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("yard.obj");
    std::fs::create_dir(folder.path().join("lib")).unwrap();
    let named = "mtllib lib/yard.mtl\n".repeat(20_000);
    std::fs::write(&file, format!("{named}v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n"))
        .unwrap();
    std::fs::write(folder.path().join("lib/yard.mtl"), "newmtl a\nMAP_KD t.png\n").unwrap();
    image::RgbaImage::from_pixel(1, 1, image::Rgba([255, 0, 0, 255]))
        .save(folder.path().join("lib/t.png"))
        .unwrap();
    let source = import_all(&file).unwrap();
    assert_eq!((source.meshes[0].colors[0], source.notes.len()), ([255, 0, 0, 255], 0));
    assert_eq!(references(&file).unwrap().len(), 2);
}

#[test]
fn a_polygon_that_crosses_itself_is_said() {
    let text = "v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 4\n";
    let notes = parse(text.as_bytes()).unwrap().notes;
    assert!(notes[0].starts_with("1 polygons that cross"), "{notes:?}");
}

#[test]
fn coordinates_far_from_the_origin_and_sizes_far_from_one() {
    let text = "v 10000000.25 5 0\nv 10000001.25 5 0\nv 10000000.25 6 0\nf 1 2 3\n\
        o small\nv 0 0 0\nv 1e-6 0 0\nv 0 1e-6 0\nf -3 -2 -1\no large\nv 0 0 0\nv 1e6 0 0\nv 0 1e6 0\nf -3 -2 -1\n";
    let source = parse(text.as_bytes()).unwrap();
    assert_eq!(source.objects.len(), 3);
    assert_eq!(world(&source, 0, 1), DVec3::new(10_000_001.25, 5.0, 0.0));
    assert_eq!(source.meshes[1].positions[1], [1e-6, 0.0, 0.0]);
    assert!(error("v 1e300 0 0\nv 0 1e300 0\nv 0 0 0\nf 1 2 3\n").contains("its position"));
}

#[test]
fn dented_polygons_keep_their_area() {
    let text = "v 2 2 0\nv 1 2 0\nv 1 1 0\nv 0 1 0\nv 0 0 0\nv 2 0 0\nf 1 2 3 4 5 6\n";
    let mesh = &parse(text.as_bytes()).unwrap().meshes[0];
    assert_eq!((mesh.indices.len(), mesh.normals.len()), (4, 6));
    assert_eq!(mesh.normals, [[0.0, 0.0, 1.0]; 6]);
}

#[test]
fn a_hundred_thousand_copies_of_one_point() {
    let mut text = "v 3 3 3\n".repeat(100_000) + "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    (1..=1000).for_each(|i| text += &format!("f {i} {} {}\n", 50_000 + i, 99_000 + i));
    let source = parse((text + "f -3 -2 -1\n").as_bytes()).unwrap();
    assert_eq!((source.meshes[0].indices.len(), source.meshes[0].dropped_degenerate), (1, 1000));
}

#[test]
fn no_truncation_panics() {
    for end in 0..SCENE.len() {
        if let Ok(source) = parse(&SCENE.as_bytes()[..end]) {
            check(&source, TEXTURE_SIDE).unwrap();
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("yard.obj");
    std::fs::write(&file, SCENE).unwrap();
    for end in 0..LIBRARY.len() {
        std::fs::write(folder.path().join("yard.mtl"), &LIBRARY[..end]).unwrap();
        if let Err(error) = import_all(&file) {
            assert!(error.to_string().contains("yard.mtl: line"), "{error}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_mutation_panics(edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
        let mut bytes = SCENE.as_bytes().to_vec();
        for (place, value) in edits {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        if let Ok(source) = parse(&bytes) {
            check(&source, TEXTURE_SIDE)?;
        }
    }
}
