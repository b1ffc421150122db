//! A small scene for the tests of this module: a root with a stand-in over two leaves, one of them
//! an instance with two levels, the other of two parts; a view cell with an intra and a delta cube, and
//! one without a far field.

use super::projected::{NewPatch, TILE_BYTES};
use super::vertex::POSITION_MAX;
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
        longest_edge: 1e3,
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

/// Streams the fixture's four meshes, one of them textured, and its three faces.
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
    let places = [[0, 0, 9], [512, 0, 9], [0, 512, POSITION_MAX], [512, 512, 0]];
    let large = NewPatch { at: [16, 0], side: 32, table: &[0, 2, 1, 0], ..face() };
    let vertices = places.map(Vertex::pack_position);
    let tiles = [[0x11; TILE_BYTES], [0x22; TILE_BYTES]];
    writer.add_patch(&NewPatch { vertices: &vertices, tiles: &tiles, ..large }).unwrap();
    let normals = Some(&[[0x44; TILE_BYTES]][..]);
    writer.add_patch(&NewPatch { indices: &[0, 1, 2, 0, 2, 1], normals, ..face() }).unwrap();
    writer.add_patch(&face()).unwrap();
}

/// A triangle over a picture of one tile.
pub(super) fn face() -> NewPatch<'static> {
    // Places (0, 0), (256, 0) and (0, 256) of disparities 1, 2 and 3.
    const VERTICES: [[u32; 2]; 3] = [[0, 1 << 10], [256, 2 << 10], [256 << 21, 3 << 10]];
    NewPatch {
        step: 0.125,
        at: [0, 32],
        side: 16,
        vertices: &VERTICES,
        indices: &[0, 1, 2],
        table: &[1],
        tiles: &[[0x33; TILE_BYTES]],
        normals: None,
    }
}

/// View cells of the fixture.
pub(super) fn view_cells() -> Vec<ViewCell> {
    let cell = ViewCell {
        min: [0.0; 3],
        max: [1.0; 3],
        first_cube: 0,
        cube_count: 2,
        method: Method::Itdm as u32,
        margin: 0.125,
        objective: 0.2,
    };
    let bare = ViewCell {
        min: [1.0, 0.0, 0.0],
        max: [2.0, 1.0, 1.0],
        first_cube: 2,
        cube_count: 0,
        method: Method::None as u32,
        ..cell
    };
    vec![cell, bare]
}

/// Scan cubes of the fixture.
pub(super) fn cubes() -> Vec<Cube> {
    let intra = Cube {
        eye: [0.5; 3],
        patches: [4, 5, 5, 5, 5, 6, 6],
        side: 48,
        parent: NONE,
        triangles: 1 + 2,
    };
    let patches = [6, 6, 7, 7, 7, 7, 7];
    vec![intra, Cube { eye: [0.0, 0.5, 1.0], patches, parent: 0, triangles: 1, ..intra }]
}

/// All that the writer is given in the end.
pub(super) fn tables() -> Tables {
    Tables {
        info: info(),
        hlods: hlods(),
        levels: levels(),
        parts: parts(),
        transforms: transforms(),
        view_cells: view_cells(),
        cubes: cubes(),
    }
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
    writer.finish(tables()).unwrap()
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
