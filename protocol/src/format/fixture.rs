//! A small scene for the tests of this module: a root with a stand-in over two leaves, one of them
//! an instance with two levels.

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
        source_triangles: 1,
        ..Hlod::zeroed()
    };
    let root = Hlod {
        max: [5.0, 1.0, 1.0],
        parent: NONE,
        first_child: 1,
        child_count: 2,
        first_level: 0,
        object: NONE,
        source_triangles: 3,
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
    let level = |error, blob, transform, triangles| Level {
        error,
        blob,
        transform,
        triangles,
        reserved: 0,
    };
    vec![level(0.5, 2, NONE, 1), level(0.0, 0, NONE, 1), level(0.0, 1, 0, 2), level(0.25, 0, 0, 1)]
}

/// Placements of the fixture.
pub(super) fn transforms() -> Vec<Transform> {
    vec![Transform { translation: [4.0, 0.0, 0.0], ..Transform::IDENTITY }]
}

/// Facts of the fixture.
pub(super) fn info() -> SceneInfo {
    SceneInfo {
        up: [0.0, 1.0, 0.0],
        source_triangles: 3,
        unique_triangles: 3,
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

/// Streams the fixture's three blobs.
pub(super) fn add_blobs(writer: &mut SceneWriter) {
    let corner = grid(&[[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]]);
    writer.add_blob([0.0; 3], 0.25, &corner[..3], &[0, 1, 2]).unwrap();
    writer.add_blob([0.0; 3], 0.25, &corner, &[0, 1, 2, 0, 2, 3]).unwrap();
    let wide = grid(&[[0, 0, 0], [5, 0, 0], [0, 1, 1]]);
    writer.add_blob([0.0; 3], 1.0, &wide, &[2, 1, 0]).unwrap();
}

/// Writes the fixture.
pub(super) fn write(path: &Path) -> Finished {
    let mut writer = SceneWriter::create(path).unwrap();
    add_blobs(&mut writer);
    writer.finish(info(), hlods(), levels(), transforms()).unwrap()
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
