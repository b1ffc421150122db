//! A small scene file for tests: a root with a stand-in over a plain leaf and an instance, and a view cell
//! with a scan cube of one face.

use crate::store::Store;
use bytemuck::Zeroable;
use protocol::format::projected::{NewPatch, TILE_BYTES};
use protocol::format::{Class, Finished, Hlod, Level, NONE, Part, SceneInfo, SceneWriter, Tables};
use protocol::format::{Cube, Method, Transform, Vertex, Vertices, ViewCell, Wrap};
use protocol::id::BlobId;
use std::path::Path;
use tempfile::TempDir;

/// Writes the scene: unit cubes at 0 and, turned a quarter about z, at `[4, 5]`.
pub(crate) fn write(path: &Path) -> Finished {
    write_with(path, 1, |_| ())
}

/// Writes the scene with another seed.
pub(crate) fn write_other(path: &Path) -> Finished {
    write_with(path, 2, |_| ())
}

/// Writes the scene after a change of its hlods.
pub(crate) fn write_with(path: &Path, seed: u64, change: impl FnOnce(&mut [Hlod])) -> Finished {
    write_changed(path, seed, change, |_| ())
}

/// Writes the scene after a change of its levels.
pub(crate) fn write_with_levels(path: &Path, change: impl FnOnce(&mut [Level])) -> Finished {
    write_changed(path, 1, |_| (), change)
}

fn write_changed(
    path: &Path,
    seed: u64,
    change_hlods: impl FnOnce(&mut [Hlod]),
    change_levels: impl FnOnce(&mut [Level]),
) -> Finished {
    let mut writer = SceneWriter::create(path).unwrap();
    let grid = |points: &[[u32; 3]]| -> Vec<Vertex> {
        let vertex = |&p| Vertex { position: Vertex::pack_position(p), normal: 0, color: !0 };
        points.iter().map(vertex).collect()
    };
    let corner = grid(&[[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]]);
    let indices = [0, 1, 2, 0, 2, 3];
    let mut add = |step, vertices: &[Vertex], indices: &[u16]| {
        let classes = Class::OpaqueDouble.all(indices.len() as u32 / 3);
        writer.add_blob([0.0; 3], step, Vertices::Plain(vertices), indices, classes).unwrap().0
    };
    let fine = add(0.25, &corner, &indices);
    let wide = grid(&[[0, 0, 0], [5, 0, 0], [0, 1, 1]]);
    let coarse = add(1.0, &wide, &[2, 1, 0]);

    let face = NewPatch {
        step: 0.5,
        at: [0; 2],
        side: 16,
        vertices: &[[0, 1 << 12], [256, 1 << 12], [0, 0]],
        indices: &[0, 1, 2],
        table: &[1],
        tiles: &[[0x5a; TILE_BYTES]],
        normals: None,
    };
    let BlobId(face) = writer.add_patch(&face).unwrap();
    let cube = Cube {
        eye: [2.0; 3],
        patches: [face, face + 1, face + 1, face + 1, face + 1, face + 1, face + 1],
        side: 16,
        parent: NONE,
        triangles: 1,
    };
    let cell = ViewCell {
        min: [1.0; 3],
        max: [3.0; 3],
        first_cube: 0,
        cube_count: 1,
        method: Method::Itdm as u32,
        margin: 0.0,
        objective: 0.0,
    };
    // Nothing shows it; what is read and checked of a file holds for it all the same.
    writer.add_texture(1, [Wrap::Repeat; 2], &[1, 2, 3, 4]).unwrap();

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
    let instance =
        Hlod { min: [4.0, 0.0, 0.0], max: [5.0, 1.0, 1.0], first_level: 2, object: 1, ..leaf };
    let level = |error, first_part, triangles| Level {
        error,
        first_part,
        part_count: 1,
        triangles,
        longest_edge: 8.0,
    };
    let mut levels = vec![level(0.5, 0, 1), level(0.0, 1, 2), level(0.0, 2, 2)];
    let part = |blob, transform| Part { blob, transform };
    let parts = vec![part(coarse, NONE), part(fine, NONE), part(fine, 0)];
    let quarter = Transform {
        linear: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [5.0, 0.0, 0.0],
    };
    let info = SceneInfo {
        up: [0.0, 0.0, 1.0],
        source_triangles: 4,
        unique_triangles: 2,
        objects: 2,
        seed,
        ..SceneInfo::zeroed()
    };
    let mut hlods = vec![root, leaf, instance];
    change_hlods(&mut hlods);
    change_levels(&mut levels);
    let transforms = vec![quarter];
    let (view_cells, cubes) = (vec![cell], vec![cube]);
    let tables = Tables { info, hlods, levels, parts, transforms, view_cells, cubes };
    writer.finish(tables).unwrap()
}

/// The scene, opened; it lives as long as the folder.
pub(crate) fn store() -> (TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    write(&path);
    let store = Store::open(&path).unwrap();
    (folder, store)
}

/// Writes a scene of one leaf that shows `blobs` meshes of a MiB each, no two the same.
pub(crate) fn write_large(path: &Path, blobs: u32) {
    let mut writer = SceneWriter::create(path).unwrap();
    let mut parts = Vec::new();
    for mesh in 0..blobs {
        let vertex =
            |i| Vertex { position: Vertex::pack_position([i, mesh, 9]), normal: i, color: !0 };
        let vertices: Vec<Vertex> = (0..1 << 16).map(vertex).collect();
        let (all, classes) = (Vertices::Plain(&vertices), Class::OpaqueDouble.all(1));
        let BlobId(blob) = writer.add_blob([0.0; 3], 1.0, all, &[0, 1, 2], classes).unwrap();
        parts.push(Part { blob, transform: NONE });
    }
    writer.add_texture(1, [Wrap::Repeat; 2], &[1, 2, 3, 4]).unwrap();
    let leaf = Hlod {
        max: [65_536.0; 3],
        parent: NONE,
        level_count: 1,
        source_triangles: u64::from(blobs),
        ..Hlod::zeroed()
    };
    let level =
        Level { error: 0.0, first_part: 0, part_count: blobs, triangles: blobs, longest_edge: 2e5 };
    let info = SceneInfo {
        up: [0.0, 0.0, 1.0],
        source_triangles: u64::from(blobs),
        objects: 1,
        ..SceneInfo::zeroed()
    };
    let (hlods, levels) = (vec![leaf], vec![level]);
    writer.finish(Tables { info, hlods, levels, parts, ..Tables::default() }).unwrap();
}
