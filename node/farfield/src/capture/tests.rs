//! Samples of turned cubes, through the CPU backend.

use super::*;
use crate::depth_mesh::simplify::FaceMesh;
use crate::normals::FaceNormals;
use crate::patches::Window;
use crate::picture::stored_picture;
use protocol::format::projected::{Patch, SUBPIXELS, TILE};
use protocol::format::texture::srgb_to_linear;
use protocol::format::{
    Class, Hlod, Level, NONE, Part as PlacedMesh, SceneInfo, SceneWriter, Tables, Transform,
    Vertex, Vertices,
};
use protocol::sun::Sun;
use scene::backend::cpu::CpuBackend;
use scene::backend::{light, normal};
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
            longest_edge: 1e3,
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

fn psnr(a: &[[u8; 3]], b: &[[u8; 3]], seen: impl Fn(usize) -> bool) -> f64 {
    let pairs = a.iter().zip(b).enumerate().filter(|(at, _)| seen(*at));
    let off = pairs.flat_map(|(_, (a, b))| (0..3).map(|k| f64::from(a[k].abs_diff(b[k])).powi(2)));
    let (sum, count) = off.fold((0.0, 0.0), |(sum, count), off| (sum + off, count + 1.0));
    10.0 * (255.0 * 255.0 * count / sum).log10()
}

/// The picture of a whole face as it is stored, and with its normals lit by a sun.
fn stored(picture: &FacePicture, axes: &FaceAxes, sun: [f32; 3]) -> [Vec<[u8; 3]>; 2] {
    let normals = FaceNormals::of(picture, SIDE, axes);
    let full = SIDE * SUBPIXELS;
    let mesh = FaceMesh {
        vertices: vec![[0, 0, 1], [full, 0, 1], [0, full, 1], [full, full, 1]],
        triangles: vec![[0, 1, 2], [1, 3, 2]],
        step: 1.0,
        error_px: 0.0,
    };
    let window = Window { at: [0; 2], across: SIDE / TILE };
    let stored = stored_picture(picture, normals.as_ref(), SIDE, &mesh, &mesh.triangles, window);
    let table: Vec<u8> = stored.table.iter().flat_map(|entry| entry.to_le_bytes()).collect();
    let (vertices, indices) = (&[][..], &[][..]);
    let (table, tiles, normals) = (&table[..], &stored.tiles[..], stored.normals.as_deref());
    let patch = Patch { side: SIDE, vertices, indices, table, tiles, normals };
    let axes = [axes.right, axes.up, axes.forward.map(|c| -c)].map(DVec3::from_array);
    let relit = |x: u32, y: u32| {
        let n = patch.normal(x, y).map_or(DVec3::ZERO, |n| DVec3::from_array(n.map(f64::from)));
        let n = (axes[0] * n.x + axes[1] * n.y + axes[2] * n.z).normalize_or_zero().as_vec3();
        let light = |sun| light::intensity(n.to_array(), sun);
        let factor = light(sun) / light(light::baked_sun());
        patch.pixel(x, y).map(|code| srgb_from_linear(srgb_to_linear(code) * factor))
    };
    let pixels = || (0..SIDE * SIDE).map(|at| (at % SIDE, at / SIDE));
    [
        pixels().map(|(x, y)| patch.pixel(x, y)).collect(),
        pixels().map(|(x, y)| relit(x, y)).collect(),
    ]
}

fn srgb_from_linear(linear: f32) -> u8 {
    let s =
        if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (s * 255.0).round() as u8
}

#[test]
fn what_is_lit_again_is_what_another_sun_would_have_shown() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cubes.occ");
    write(&path);
    let store = Store::open(&path).unwrap();
    let sample = sample(&store, u64::MAX, true).unwrap();
    let size = PictureSize { width: SIDE, height: SIDE };
    let mut studio = Studio::new(&store, Box::new(CpuBackend::new(size)), SIDE, 0.01).unwrap();
    let near = NearField::new(store.skeleton(), [-0.1; 3], [0.1; 3]);
    for sun in [[0.0, 0.0, 1.0], [-0.8, 0.5, 0.2], [-0.35, 0.85, -0.4]] {
        let sun = Sun::try_from(sun).unwrap().unit();
        let mut sums = [0.0; 3];
        for (face, axes) in FACES.iter().enumerate() {
            let camera = studio.camera(sample.eye, axes);
            let front = front_of(store.skeleton(), &camera, size, LOD_PX, &Field::Far(&near));
            let draws = draw_list(store.skeleton(), &front.entries, camera.eye);
            let view = View::new(&camera, size);
            let direct = studio.picture(view, Shading::Lit { sun }, &draws).unwrap();
            let picture = &sample.faces[face];
            let direct = FacePicture { color: rgb(&direct.rgba), ..picture.clone() };
            let [stale, relit] = stored(picture, axes, sun);
            let [baked, _] = stored(&direct, axes, sun);
            let of =
                |found: &[[u8; 3]]| psnr(found, &direct.color, |at| picture.disparity[at] > 0.0);
            let [stale, relit, baked] = [stale, relit, baked].map(|found| of(&found));
            eprintln!(
                "face {face}: {stale:.1} dB stale, {relit:.1} relit, {baked:.1} baked under that sun"
            );
            // What was dark shows the colours' error when it is bright.
            assert!(relit > 33.0, "face {face}");
            sums = std::array::from_fn(|k| sums[k] + [stale, relit, baked][k] / 6.0);
        }
        let [stale, relit, baked] = sums;
        assert!(relit > baked - 4.0 && stale < relit - 15.0, "{stale} {relit} {baked}");
    }
}
