//! A small scene for the tests of this module: a root with a stand-in over two leaves, one of them
//! an instance with two levels, the other of two parts.

use super::*;
use bytemuck::Zeroable;
use std::path::Path;

/// Hlods of the fixture.
pub(super) fn hlods() -> Vec<Hlod> {
    let leaf = Hlod {
        min: [0.0; 3],
        max: [1.0; 3],
        parent: 0,
        first_level: 1,
        level_count: 1,
        source_triangles: 2,
        ..Hlod::zeroed()
    };
    let root = Hlod {
        max: [5.0, 1.0, 1.0],
        parent: NONE,
        first_child: 1,
        child_count: 2,
        first_level: 0,
        object: NONE,
        source_triangles: 4,
        ..leaf
    };
    let instance = Hlod {
        min: [4.0, 0.0, 0.0],
        max: [5.0, 1.0, 1.0],
        first_level: 2,
        level_count: 2,
        object: 1,
        source_triangles: 2,
        ..leaf
    };
    vec![root, leaf, instance]
}

/// Levels of the fixture.
pub(super) fn levels() -> Vec<Level> {
    let level = |error, first_part, part_count, triangles| Level {
        error,
        first_part,
        part_count,
        triangles,
        reserved: 0,
    };
    vec![level(0.5, 0, 1, 1), level(0.0, 1, 2, 2), level(0.0, 3, 1, 2), level(0.25, 4, 1, 1)]
}

/// Parts of the fixture.
pub(super) fn parts() -> Vec<Part> {
    let part = |blob, transform| Part { blob, transform };
    vec![part(2, NONE), part(0, NONE), part(3, NONE), part(1, 0), part(0, 0)]
}

/// Placements of the fixture.
pub(super) fn transforms() -> Vec<Transform> {
    vec![Transform { translation: [4.0, 0.0, 0.0], ..Transform::IDENTITY }]
}

/// Facts of the fixture.
pub(super) fn info() -> SceneInfo {
    SceneInfo {
        up: [0.0, 1.0, 0.0],
        source_triangles: 4,
        unique_triangles: 4,
        objects: 2,
        seed: 7,
        ..SceneInfo::zeroed()
    }
}

/// Vertices on the grid of a blob.
pub(super) fn grid(points: &[[u32; 3]]) -> Vec<Vertex> {
    let vertex =
        |&p| Vertex { position: Vertex::pack_position(p), normal: 0x7fff, color: 0xff80_4020 };
    points.iter().map(vertex).collect()
}

/// Streams the fixture's four blobs; one is textured.
pub(super) fn add_blobs(writer: &mut SceneWriter) {
    let corner = grid(&[[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]]);
    let mut add = |step, vertices, indices: &[u16], classes| {
        writer.add_blob([0.0; 3], step, vertices, indices, classes).unwrap();
    };
    let opaque = |n| Class::OpaqueDouble.all(n);
    add(0.25, Vertices::Plain(&corner[..3]), &[0, 1, 2], opaque(1));
    add(0.25, Vertices::Plain(&corner), &[0, 1, 2, 0, 2, 3], [1, 0, 0, 0, 0, 1]);
    let wide = grid(&[[0, 0, 0], [5, 0, 0], [0, 1, 1]]);
    add(1.0, Vertices::Plain(&wide), &[2, 1, 0], opaque(1));
    add(0.25, Vertices::Textured(&leaf()), &[0, 1, 2], Class::MaskDouble.all(1));
}

/// The vertices of the textured blob.
pub(super) fn leaf() -> Vec<TexturedVertex> {
    let coordinates = [[0.0, 0.0], [1.0, 0.0], [0.0, 2.5]];
    let corners = grid(&[[0, 0, 0], [4, 0, 0], [0, 4, 0]]).into_iter().zip(coordinates);
    let textured =
        |(plain, tex_coord)| TexturedVertex { plain, tex_coord, texture: 0, cutoff: 0.5 };
    corners.map(textured).collect()
}

/// Pixels of the fixture's texture of 2 * 2.
pub(super) const PIXELS: [u8; 16] = [255, 0, 0, 255, 0, 255, 0, 255, 0, 0, 255, 255, 9, 9, 9, 0];

/// Adds the fixture's texture.
pub(super) fn add_texture(writer: &mut SceneWriter) {
    writer.add_texture(2, [Wrap::Repeat, Wrap::Mirror], &PIXELS).unwrap();
}

/// Writes the fixture.
pub(super) fn write(path: &Path) -> Finished {
    let mut writer = SceneWriter::create(path).unwrap();
    add_blobs(&mut writer);
    add_texture(&mut writer);
    writer.finish(info(), hlods(), levels(), parts(), transforms()).unwrap()
}

/// The bytes of the fixture.
pub(super) fn bytes() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    write(&path);
    std::fs::read(path).unwrap()
}

/// The fixture's skeleton.
pub(super) fn skeleton() -> Skeleton {
    parse(&bytes()).unwrap().skeleton
}
