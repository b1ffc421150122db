//! Samples of turned cubes, through the CPU backend.

use super::*;
use protocol::format::{
    Class, Hlod, Level, NONE, Part as PlacedMesh, SceneInfo, SceneWriter, Tables, Transform,
    Vertex, Vertices,
};
use scene::backend::cpu::CpuBackend;
use scene::backend::normal;
use std::path::Path;

const SIDE: u32 = 64;
/// Cubes all around the origin, of two meshes in turn, and the first in it.
const CUBES: u32 = 7;

/// Unit cube number `n`, turned and out of the way of the others.
fn place(n: u32) -> Transform {
    let axis = DVec3::new(0.3 + f64::from(n), 1.0, 0.7 * f64::from(n)).normalize();
    let turned = glam::DMat3::from_axis_angle(axis, f64::from(n));
    let forward = n
        .checked_sub(1)
        .map_or(DVec3::ZERO, |face| DVec3::from_array(FACES[face as usize].forward));
    let translation = 2.5 * forward - turned * DVec3::splat(0.5);
    Transform { linear: turned.to_cols_array_2d(), translation: translation.to_array() }
}

/// A unit cube whose corners have the normals of their faces.
fn cube(writer: &mut SceneWriter, color: u32) -> u32 {
    let (mut vertices, mut indices) = (Vec::new(), Vec::new());
    for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
        let mut normal = [0.0; 3];
        normal[axis] = if side == 1 { 1.0 } else { -1.0 };
        let first = vertices.len() as u16;
        indices.extend([0, 1, 2, 1, 3, 2].map(|corner| first + corner));
        for (u, v) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let mut grid = [0; 3];
            (grid[axis], grid[(axis + 1) % 3], grid[(axis + 2) % 3]) = (side, u, v);
            let (position, normal) = (Vertex::pack_position(grid), Vertex::pack_normal(normal));
            vertices.push(Vertex { position, normal, color });
        }
    }
    let classes = Class::OpaqueDouble.all(12);
    writer.add_blob([0.0; 3], 1.0, Vertices::Plain(&vertices), &indices, classes).unwrap().0
}

fn write(path: &Path) {
    let mut writer = SceneWriter::create(path).unwrap();
    let blobs = [cube(&mut writer, 0xff20_80c0), cube(&mut writer, !0)];
    let mut tables = Tables {
        info: SceneInfo { up: [0.0, 0.0, 1.0], objects: CUBES, ..SceneInfo::default() },
        hlods: vec![Hlod {
            min: [-4.0; 3],
            max: [4.0; 3],
            parent: NONE,
            first_child: 1,
            child_count: CUBES,
            first_level: 0,
            level_count: 0,
            object: NONE,
            source_triangles: u64::from(12 * CUBES),
        }],
        ..Tables::default()
    };
    for n in 0..CUBES {
        let transform = place(n);
        let corners = (0..8u32).map(|bits| {
            DVec3::from_array(transform.apply([bits & 1, bits >> 1 & 1, bits >> 2].map(f64::from)))
        });
        tables.hlods.push(Hlod {
            min: corners.clone().fold(DVec3::MAX, DVec3::min).to_array(),
            max: corners.fold(DVec3::MIN, DVec3::max).to_array(),
            parent: 0,
            first_child: 0,
            child_count: 0,
            first_level: n,
            level_count: 1,
            object: n,
            source_triangles: 12,
        });
        tables.transforms.push(transform);
        tables.parts.push(PlacedMesh { blob: blobs[n as usize % 2], transform: n });
        tables.levels.push(Level {
            error: 0.0,
            first_part: n,
            part_count: 1,
            triangles: 12,
            reserved: 0,
        });
    }
    (tables.info.source_triangles, tables.info.unique_triangles) = (u64::from(12 * CUBES), 24);
    writer.finish(tables).unwrap();
}

/// What the origin sees of all cubes but the one around it.
fn sample(store: &Store, budget: u64, with_normals: bool) -> Result<Sample, CaptureError> {
    let size = PictureSize { width: SIDE, height: SIDE };
    let backend = Box::new(CpuBackend::new(size).with_budget(budget));
    let studio = Studio::new(store, backend, SIDE, 0.01)?;
    let mut studio = if with_normals { studio.with_normals() } else { studio };
    studio.sample(DVec3::ZERO, &NearField::new(store.skeleton(), [-0.1; 3], [0.1; 3]))
}

#[test]
fn normals_are_those_of_the_surfaces_seen_and_come_only_if_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cubes.occ");
    write(&path);
    let store = Store::open(&path).unwrap();
    let plain = sample(&store, u64::MAX, false).unwrap();
    let full = sample(&store, u64::MAX, true).unwrap();
    // Room for one mesh at a time changes nothing.
    let bytes = store.skeleton().blobs[0].bytes;
    assert_eq!(sample(&store, bytes, true).unwrap(), full);
    assert!(matches!(sample(&store, bytes - 1, true), Err(CaptureError::NoRoom(_))));
    for (face, (plain, picture)) in plain.faces.iter().zip(&full.faces).enumerate() {
        assert!(plain.normal.is_empty());
        assert!((&plain.disparity, &plain.color) == (&picture.disparity, &picture.color));
        // The six directions that the cube before this face has.
        let sides = DVec3::AXES.map(|axis| {
            let [x, y, z] = place(face as u32 + 1).linear.map(DVec3::from_array);
            glam::DMat3::from_cols(x, y, z) * axis
        });
        let mut covered = 0;
        for (at, (code, disparity)) in (0..).zip(picture.normal.iter().zip(&picture.disparity)) {
            let ray = full.ray(face, f64::from(at % SIDE) + 0.5, f64::from(at / SIDE) + 0.5);
            if *disparity == 0.0 {
                assert_eq!(*code, normal::encode([0.0; 3]));
                continue;
            }
            covered += 1;
            // The side whose plane holds the point.
            let center = 2.5 * DVec3::from_array(FACES[face].forward);
            let from_center = ray / f64::from(*disparity) - center;
            let reach = |side: &DVec3| from_center.dot(*side);
            let by_reach = |a: &DVec3, b: &DVec3| reach(a).abs().total_cmp(&reach(b).abs());
            let side = sides.into_iter().max_by(by_reach).unwrap();
            let expected = side * reach(&side).signum();
            assert!(expected.dot(ray) < 0.0, "a side that faces the viewpoint");
            let expected = normal::encode(expected.as_vec3().to_array());
            let off = (0..3).map(|k| code[k].abs_diff(expected[k])).max();
            // Where sides meet either may be the one.
            let mut reaches = sides.map(|side| reach(&side).abs());
            reaches.sort_by(f64::total_cmp);
            assert!(off <= Some(1) || reaches[2] - reaches[1] < 1e-3, "{code:?} {expected:?}");
        }
        assert!(covered > 200, "face {face}: {covered}");
    }
}
