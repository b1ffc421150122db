//! What materials and their textures become.

use serde_json::{Value, json};

use crate::import::gltf::testing::{F32, Scene, U8, png};
use crate::import::testing::TEXTURE_SIDE;
use crate::import::{ImportLimits, import_all};
use crate::source::{Alpha, Section, Source, Surface, Wrap};

const BLACK: [u8; 4] = [0, 0, 0, 255];
const WHITE: [u8; 4] = [255; 4];
/// Four corners, three of them white.
const CORNER: [[u8; 4]; 4] = [BLACK, WHITE, WHITE, WHITE];

/// A triangle with coordinates, whose material has a texture.
fn textured(image: Value) -> Scene {
    let mut scene = Scene::triangle();
    let coords = scene.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 2.0]);
    scene.add("images", image);
    scene.add("textures", json!({"source": 0}));
    scene.add("materials", json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
    scene.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    scene.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(coords);
    scene
}

/// The same with the picture in the file.
fn pictured(width: u32, height: u32, texels: &[[u8; 4]]) -> Scene {
    let mut scene = textured(json!({"name": "wall"}));
    let view = scene.view(&png(width, height, texels));
    scene.json["images"][0]["bufferView"] = json!(view);
    scene
}

/// The surface of the only section.
fn surface(source: &Source) -> Surface {
    let [section] = source.meshes[0].sections[..] else {
        panic!("{:?}", source.meshes[0].sections)
    };
    source.surfaces[usize::from(section.surface)]
}

#[test]
fn pictures_from_views_data_uris_and_files_arrive() {
    let source = pictured(2, 2, &CORNER).import().unwrap();
    let [texture] = &source.textures[..] else { panic!("{:?}", source.textures) };
    assert_eq!((texture.name.as_str(), texture.side), ("wall", 2));
    assert_eq!(texture.rgba, CORNER.concat());
    assert_eq!(texture.wrap, [Wrap::Repeat; 2]);
    assert_eq!(surface(&source).texture, Some(0));
    assert_eq!(source.meshes[0].tex_coords, [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]]);
    assert_eq!(source.meshes[0].colors, [[255; 4]; 3]);

    let picture = png(2, 2, &CORNER);
    let escaped: String = picture.iter().map(|byte| format!("%{byte:02X}")).collect();
    let scene = textured(json!({"uri": format!("data:image/png,{escaped}")}));
    assert_eq!(scene.import().unwrap().textures[0].rgba, CORNER.concat());

    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("wall.png"), &picture).unwrap();
    let file = folder.path().join("scene.glb");
    std::fs::write(&file, textured(json!({"uri": "wall.png"})).bytes()).unwrap();
    assert_eq!(import_all(&file).unwrap().textures[0].rgba, CORNER.concat());
}

#[test]
fn a_picture_larger_than_the_limit_is_reduced_to_it() {
    let texels: Vec<[u8; 4]> =
        (0..32 * 32).map(|i| if i % 2 == 0 { BLACK } else { WHITE }).collect();
    let source = pictured(32, 32, &texels).import().unwrap();
    let texture = &source.textures[0];
    assert_eq!((texture.side, texture.rgba.len()), (TEXTURE_SIDE, 4 * 64));
    assert!(texture.rgba.as_chunks::<4>().0.iter().all(|t| t[0].abs_diff(188) < 12 && t[3] == 255));
}

#[test]
fn a_picture_of_one_colour_is_folded_into_the_vertices() {
    for (width, height) in [(1, 1), (3, 2)] {
        let texels = vec![[255, 0, 188, 255]; width * height];
        let source = pictured(width as u32, height as u32, &texels).import().unwrap();
        assert!(source.textures.is_empty() && source.meshes[0].tex_coords.is_empty());
        assert_eq!(source.meshes[0].colors[0], [255, 0, 128, 255]);
        assert_eq!(surface(&source).texture, None);
    }
}

#[test]
fn a_texture_that_cannot_be_had_leaves_the_factor_and_a_note() {
    for (image, word) in
        [(json!({"uri": "none.png"}), "missing"), (json!({"uri": "data:,nothing"}), "decoded")]
    {
        let source = textured(image).import().unwrap();
        assert_eq!(source.meshes[0].colors[0], [255; 4]);
        assert!(source.textures.is_empty() && source.meshes[0].tex_coords.is_empty());
        assert!(
            source.notes[0].contains(word) && source.notes[0].contains("image 0"),
            "{:?}",
            source.notes
        );
    }
}

#[test]
fn without_coordinates_a_texture_counts_by_its_mean() {
    let mut scene = pictured(2, 2, &[BLACK, WHITE, WHITE, BLACK]);
    let primitive = &mut scene.json["meshes"][0]["primitives"][0];
    primitive["attributes"].as_object_mut().unwrap().remove("TEXCOORD_0");
    let source = scene.import().unwrap();
    assert_eq!(source.meshes[0].colors[0], [128, 128, 128, 255]);
    assert_eq!((surface(&source).texture, source.meshes[0].tex_coords.len()), (None, 0));
    assert!(source.notes[0].contains("without texture coordinates"), "{:?}", source.notes);
}

#[test]
fn textures_are_shared_by_image_wrap_and_use_of_alpha() {
    let mut scene = pictured(2, 2, &[[9, 9, 9, 0], WHITE, WHITE, WHITE]);
    scene.json["samplers"] = json!([{}, {"wrapS": 33071, "wrapT": 33648}]);
    scene.add("textures", json!({"source": 0, "sampler": 0}));
    scene.add("textures", json!({"source": 0, "sampler": 1}));
    let material = |texture: usize, mode: &str| json!({"alphaMode": mode, "pbrMetallicRoughness": {"baseColorTexture": {"index": texture}}});
    for (texture, mode) in [(1, "OPAQUE"), (2, "OPAQUE"), (0, "BLEND"), (1, "MASK")] {
        let number = scene.add("materials", material(texture, mode));
        let mut primitive = scene.json["meshes"][0]["primitives"][0].clone();
        primitive["material"] = json!(number);
        scene.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(primitive);
    }
    let source = scene.import().unwrap();
    let wraps: Vec<[Wrap; 2]> = source.textures.iter().map(|texture| texture.wrap).collect();
    let mixed = [Wrap::Clamp, Wrap::Mirror];
    assert_eq!(wraps, [[Wrap::Repeat; 2], mixed, [Wrap::Repeat; 2]]);
    assert_eq!(source.textures[0].rgba[..4], [9, 9, 9, 255]);
    assert_eq!(source.textures[2].rgba[..4], [9, 9, 9, 0]);
    // Materials 0 and 1 make one surface, whose triangles stand together.
    let of = |alpha, texture| Surface { alpha, texture: Some(texture), double_sided: false };
    let expected = [
        Surface::PLAIN,
        of(Alpha::Opaque, 0),
        of(Alpha::Opaque, 1),
        of(Alpha::Blend, 2),
        of(Alpha::Mask(0.5), 2),
    ];
    assert_eq!(source.surfaces, expected);
    let ends: Vec<Section> =
        (1..5).map(|surface| Section { end: surface as u32 + 1, surface }).collect();
    assert_eq!(source.meshes[0].sections, ends);
    assert_eq!(source.meshes[0].indices[..2], [[0, 1, 2], [3, 4, 5]]);
}

#[test]
fn an_opaque_picture_is_one_texture_however_materials_treat_its_alpha() {
    let mut scene = pictured(2, 2, &CORNER);
    let number = scene.add(
        "materials",
        json!({"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}),
    );
    let mut primitive = scene.json["meshes"][0]["primitives"][0].clone();
    primitive["material"] = json!(number);
    scene.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(primitive);
    let source = scene.import().unwrap();
    assert_eq!((source.textures.len(), source.meshes[0].sections.len()), (1, 1));
    assert_eq!(surface(&source).alpha, Alpha::Opaque);
}

#[test]
fn coordinates_come_from_the_set_the_texture_names_through_its_transform() {
    let mut scene = pictured(2, 2, &CORNER);
    let second = scene.accessor(U8, "VEC2", 3, &[0, 0, 255, 0, 0, 51]);
    scene.json["accessors"][second]["normalized"] = json!(true);
    scene.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_3"] = json!(second);
    let texture = "/materials/0/pbrMetallicRoughness/baseColorTexture";
    *scene.json.pointer_mut(texture).unwrap() = json!({"index": 0, "texCoord": 3});
    let coords = |scene: &Scene| scene.import().unwrap().meshes[0].tex_coords.clone();
    assert_eq!(coords(&scene), [[0.0, 0.0], [1.0, 0.0], [0.0, 0.2]]);
    let transform = json!({"offset": [0.5, 0.25], "scale": [2.0, 10.0], "texCoord": 0});
    scene.json.pointer_mut(texture).unwrap()["extensions"] =
        json!({"KHR_texture_transform": transform});
    assert_eq!(coords(&scene), [[0.5, 0.25], [2.5, 0.25], [0.5, 20.25]]);
}

#[test]
fn alpha_modes_and_sides_reach_the_surface() {
    let half = json!({"baseColorFactor": [1.0, 1.0, 1.0, 0.5]});
    for (material, alpha, double_sided, stored) in [
        (json!({}), Alpha::Opaque, false, 255),
        (json!({"doubleSided": true, "pbrMetallicRoughness": half}), Alpha::Opaque, true, 255),
        (json!({"alphaMode": "BLEND"}), Alpha::Opaque, false, 255),
        (json!({"alphaMode": "BLEND", "pbrMetallicRoughness": half}), Alpha::Blend, false, 128),
        (json!({"alphaMode": "MASK", "pbrMetallicRoughness": half}), Alpha::Mask(0.5), false, 128),
        (
            json!({"alphaMode": "MASK", "alphaCutoff": 0.25, "pbrMetallicRoughness": half}),
            Alpha::Mask(0.25),
            false,
            128,
        ),
    ] {
        let mut scene = Scene::triangle();
        scene.add("materials", material.clone());
        scene.json["meshes"][0]["primitives"][0]["material"] = json!(0);
        let source = scene.import().unwrap();
        let found = surface(&source);
        assert_eq!((found.alpha, found.double_sided), (alpha, double_sided), "{material}");
        assert_eq!(source.meshes[0].colors[0][3], stored, "{material}");
    }
}

#[test]
fn vertex_alpha_makes_a_blended_surface_blend() {
    for (alpha, expected) in [(1.0f32, Alpha::Opaque), (0.5, Alpha::Blend)] {
        let mut scene = Scene::triangle();
        let lanes = [1.0f32, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, alpha, 1.0, 1.0, 1.0, 1.0];
        let bytes: Vec<u8> = lanes.iter().flat_map(|lane| lane.to_le_bytes()).collect();
        let colors = scene.accessor(F32, "VEC4", 3, &bytes);
        scene.add("materials", json!({"alphaMode": "BLEND"}));
        let primitive = &mut scene.json["meshes"][0]["primitives"][0];
        primitive["attributes"]["COLOR_0"] = json!(colors);
        primitive["material"] = json!(0);
        assert_eq!(surface(&scene.import().unwrap()).alpha, expected);
    }
}

#[test]
fn a_broken_data_uri_is_a_picture_that_cannot_be_had() {
    for uri in ["data:image/png;base64,@@@@", "data:image/png;base64,AAAAA", "data:image/png"] {
        let source = textured(json!({"uri": uri})).import().unwrap();
        assert!(source.textures.is_empty());
        let [note] = &source.notes[..] else { panic!("{:?}", source.notes) };
        assert!(note.starts_with("image 0: its data URI "), "{note}");
    }
}

#[test]
fn images_that_stand_in_one_place_are_one_texture() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("deep")).unwrap();
    let picture = png(2, 2, &CORNER);
    std::fs::write(folder.path().join("deep/wall.png"), &picture).unwrap();
    let escaped: String = picture.iter().map(|byte| format!("%{byte:02X}")).collect();
    let data = format!("data:image/png,{escaped}");
    let mut scene = pictured(2, 2, &CORNER);
    let view = scene.json["images"][0]["bufferView"].clone();
    let again = scene.json["bufferViews"][view.as_u64().unwrap() as usize].clone();
    let again = scene.add("bufferViews", again);
    for (image, expected) in [
        (json!({"bufferView": view}), 1),
        (json!({"bufferView": again}), 1),
        (json!({"uri": data}), 2),
        (json!({"uri": data}), 2),
        (json!({"uri": "deep/wall.png"}), 3),
        (json!({"uri": "./deep\\wall%2Epng"}), 3),
        (json!({"uri": "none.png"}), 3),
        (json!({"uri": "none.png"}), 3),
    ] {
        let image = scene.add("images", image);
        shows_again(&mut scene, image);
        let file = folder.path().join("scene.glb");
        std::fs::write(&file, scene.bytes()).unwrap();
        let source = import_all(&file).unwrap();
        assert_eq!(source.textures.len(), expected);
    }
}

/// The first primitive once more, with this image on it.
fn shows_again(scene: &mut Scene, image: usize) {
    let texture = scene.add("textures", json!({"source": image}));
    let material = json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": texture}}});
    let number = scene.add("materials", material);
    let mut primitive = scene.json["meshes"][0]["primitives"][0].clone();
    primitive["material"] = json!(number);
    scene.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(primitive);
}

#[test]
fn a_webp_stands_before_what_it_falls_back_to() {
    let texels: Vec<u8> = CORNER.concat().iter().map(|lane| 255 - lane / 2).collect();
    let mut webp = std::io::Cursor::new(Vec::new());
    let picture = image::RgbaImage::from_raw(2, 2, texels.clone()).unwrap();
    picture.write_to(&mut webp, image::ImageFormat::WebP).unwrap();
    for (texture, rgba) in [
        (json!({"source": 0}), CORNER.concat()),
        (json!({"source": 0, "extensions": {"EXT_texture_webp": {"source": 1.0}}}), texels.clone()),
        (json!({"extensions": {"EXT_texture_webp": {"source": 1}}}), texels),
    ] {
        let mut scene = pictured(2, 2, &CORNER);
        let view = scene.view(webp.get_ref());
        scene.add("images", json!({"bufferView": view, "mimeType": "image/webp"}));
        scene.json["textures"][0] = texture;
        scene.json["extensionsRequired"] = json!(["EXT_texture_webp"]);
        let source = scene.import().unwrap();
        let opaque = |texel: &[u8; 4]| [texel[0], texel[1], texel[2], 255];
        let rgba: Vec<[u8; 4]> = rgba.as_chunks::<4>().0.iter().map(opaque).collect();
        assert_eq!(source.textures[0].rgba, rgba.concat());
    }
    let mut scene = pictured(2, 2, &CORNER);
    scene.json["textures"][0] = json!({"extensions": {"EXT_texture_webp": {"source": 5}}});
    assert!(scene.error().contains("refers to image 5 of 1"), "{}", scene.error());
}

#[test]
fn a_ktx2_picture_is_named_as_such() {
    let mut scene = pictured(2, 2, &CORNER);
    scene.json["textures"][0] = json!({"extensions": {"KHR_texture_basisu": {"source": 0}}});
    let notes = scene.import().unwrap().notes;
    assert!(notes[0].contains("KTX2") && notes[0].contains("cli ktxdecompress"), "{notes:?}");
    let ktx2 = textured(json!({"uri": "data:image/ktx2,%ABKTX 20%BB%0D%0A%1A%0A"}));
    let notes = ktx2.import().unwrap().notes;
    assert!(notes[0].contains("it is KTX2"), "{notes:?}");
}

#[test]
fn pictures_come_out_the_same_with_little_memory() {
    let mut scene = pictured(2, 2, &CORNER);
    for blue in 0..9 {
        let view = scene.view(&png(2, 2, &[WHITE, WHITE, BLACK, [9, 9, blue, 255]]));
        let image = scene.add("images", json!({"bufferView": view}));
        shows_again(&mut scene, image);
    }
    let with = |memory| scene.import_within(ImportLimits { memory, ..ImportLimits::default() });
    let much = with(1 << 30).unwrap();
    assert_eq!(much.textures.len(), 10);
    // A picture is 16 bytes, and one at a time is decoded; less holds none.
    assert_eq!(with(16).unwrap(), much);
    let error = with(15).unwrap_err().to_string();
    assert!(error.contains("to decode it") && error.contains("raise --memory"), "{error}");
}
