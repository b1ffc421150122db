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
        ("v 1 0 0", "v 1 nan 0", "line 4"),
        ("vn 0 0 2", "vn 0 0", "line 10"),
        ("f 1 3 2", "f 1 3 9", "line 19: \"f 1 3 9\": it refers to vertex 9 of the 4 before it"),
        ("f 1 3 2", "f 1 3 0", "vertex 0"),
        ("f 1 3 2", "f 1 3 -5", "vertex -5"),
        ("f 1 3 2", "f 1 3 9223372036854775808", "is no number"),
        ("f 1 3 2", "f 1 3 -9223372036854775808", "refers to vertex"),
        ("f 1 3 2", "f 1/4 3 2", "texture coordinate 4 of the 3"),
        ("f 1 3 2", "f 1//2 3 2", "normal 2 of the 1"),
        ("f 1 3 2", "f 1/1/1/1 3 2", "no corner"),
        ("f 1 3 2", "f x 3 2", "\"x\" is no number"),
        ("# a yard", "\0\0", "line 1"),
    ] {
        let message = error(&SCENE.replacen(from, to, 1));
        assert!(message.contains(words), "{to}: {message}");
    }
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
