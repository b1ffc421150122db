//! The three roles together on one backend: nothing visible is lost, and breaking a rule is seen.

use super::audit::measure;
use super::*;
use crate::fixture::{Piece, street, write};
use protocol::settings::{BackendChoice, Cull, PictureSize, Schedule, Residency};
use protocol::telemetry::CullCounts;
use protocol::visible::VisibleSet;
use scene::backend::cpu::CpuBackend;
use std::path::Path;
use std::sync::atomic::AtomicU64;

const SIZE: PictureSize = PictureSize { width: 97, height: 61 };

fn settings(cull: Cull) -> RunSettings {
    RunSettings {
        scene_path: String::new(),
        scene_digest: [0; 32],
        size: SIZE,
        lod_px: 1.0,
        cull,
        schedule: Schedule::Switch,
        backend: BackendChoice::Cpu,
        frames: 0,
        audit_every: 0,
        items_every: 0,
        memory: None,
        residency: Residency::Exact,
        prefetch: true,
        pictures_dir: None,
    }
}

/// One frame of a walk.
struct Seen {
    culled: CullCounts,
    drawn: u32,
    with_pixels: u32,
    differing: u64,
    hash: u64,
}

/// Plays `cameras` through OR, HC and RVG.
fn play(pieces: &[Piece], cameras: &[Camera], cull: Cull, rules: Rules) -> Vec<Seen> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    write(&path, pieces, false);
    play_file(&path, cameras, cull, rules)
}

/// Plays `cameras` through a scene file.
fn play_file(path: &Path, cameras: &[Camera], cull: Cull, rules: Rules) -> Vec<Seen> {
    let store = Store::open(path).unwrap();
    let settings = settings(cull);
    let backend = Box::new(CpuBackend::with_rules(SIZE, &rules));
    let residency = Residency::new(store.skeleton().blobs.len(), Arc::new(AtomicU64::default()));
    let mut stage = Stage { rules, ..Stage::new(&store, backend, residency, &settings) };
    let mut visible = VisibleSet::whole_scene();
    let frame = |camera: &Camera| {
        occlusion_representation::run(&mut stage, camera, &visible).unwrap();
        let mut ids = Vec::new();
        let mut through = None;
        let culled = hardware_cull::run(&mut stage, camera, |part| {
            assert!(through < Some(part.through), "parts come in id order");
            assert!(part.visible.iter().all(|&id| Some(id) > through && id <= part.through));
            through = Some(part.through);
            ids.extend(part.visible);
        });
        visible = VisibleSet::from_sorted(ids);
        let drawn = render_visible_geometry::run(&mut stage, camera, &visible, true).unwrap();
        let measured = measure(&mut stage, camera, &drawn, true, true).unwrap();
        Seen {
            culled: culled.unwrap(),
            drawn: drawn.counts.hlods,
            with_pixels: measured.hlods_with_pixels.unwrap(),
            differing: measured.audit.unwrap().differing_pixels,
            hash: picture_hash(&drawn.picture.rgba),
        }
    };
    cameras.iter().map(frame).collect()
}

fn look(eye: [f64; 3], target: [f64; 3]) -> Camera {
    Camera::look_at(eye, target, [0.0, 0.0, 1.0], 60.0, 0.05).unwrap()
}

/// Along the street, a jump behind the wall, into a box of the lattice, and away from everything.
fn walk() -> Vec<Camera> {
    let mut cameras: Vec<Camera> = (0..12)
        .map(|i| f64::from(i) * 1.7)
        .map(|x| look([x, -3.0, 2.0], [x + 2.0, 6.0, 2.5]))
        .collect();
    cameras.push(look([10.0, 20.0, 3.0], [11.0, 5.0, 0.0]));
    cameras.push(look([1.0, 6.5, 0.5], [20.0, 9.0, 1.0]));
    cameras.push(look([0.0, 0.0, 0.0], [-1.0, -5.0, 0.0]));
    cameras.push(cameras[3]);
    cameras
}

#[test]
fn a_walk_loses_no_pixel_and_culls() {
    let seen = play(&street(), &walk(), Cull::Queries, Rules::default());
    assert!(seen.iter().all(|frame| frame.differing == 0));
    assert!(seen.iter().all(|frame| frame.drawn == frame.culled.visible));
    assert!(seen.iter().all(|frame| frame.drawn >= frame.with_pixels));
    // The whole front stands before the first frame, so the wall hides the lattice from the start.
    assert!(seen[0].culled.visible * 2 < seen[0].culled.in_frustum, "{:?}", seen[0].culled);
    assert!(seen[5].culled.visible * 2 < seen[5].culled.in_frustum, "{:?}", seen[5].culled);
    assert_eq!(seen[14].culled.in_frustum, 0);
    assert!(seen[0].with_pixels > 0);
}

#[test]
fn culling_off_draws_all_and_gives_the_same_pictures() {
    let off = play(&street(), &walk(), Cull::Off, Rules::default());
    let on = play(&street(), &walk(), Cull::Queries, Rules::default());
    for (off, on) in off.iter().zip(&on) {
        assert_eq!(off.culled.queries, 0);
        assert_eq!(off.drawn, off.culled.in_frustum);
        assert_eq!(off.hash, on.hash);
    }
}

#[test]
fn the_audit_sees_the_near_rule_broken() {
    // A pillar whose bounds hold the eye, in front of a wall that hides the far side of the bounds.
    let bounds = [[-5.0, -5.0, -5.0], [5.0, 20.0, 5.0]];
    let pillar = Piece { solid: [[-0.5, 4.0, -2.0], [0.5, 5.0, 2.0]], bounds };
    let wall = Piece::tight([-50.0, 8.0, -50.0], [50.0, 9.0, 50.0]);
    let cameras = [look([0.0; 3], [0.0, 1.0, 0.0]); 3];
    let lost = |rules| {
        let seen = play(&[pillar, wall], &cameras, Cull::Queries, rules);
        seen.iter().map(|frame| frame.differing).sum::<u64>()
    };
    assert_eq!(lost(Rules::default()), 0);
    assert!(lost(Rules { near_rule: false, ..Rules::default() }) > 0);
}

#[test]
fn the_audit_sees_boxes_that_fail_against_their_own_faces() {
    let broken = Rules { grow: false, depth_test_inclusive: false, ..Rules::default() };
    let seen = play(&street(), &walk(), Cull::Queries, broken);
    assert!(seen.iter().any(|frame| frame.differing > 0));
}

#[test]
fn the_audit_sees_greater_for_greater_equal() {
    // Seen head on, a wall and its box have the same depth to the bit: no box need grow here.
    let wall = Piece::tight([-8.0, 8.0, -8.0], [8.0, 16.0, 8.0]);
    let lost = |depth_test_inclusive| {
        let rules = Rules { grow: false, depth_test_inclusive, ..Rules::default() };
        let seen = play(&[wall], &[look([0.0; 3], [0.0, 1.0, 0.0]); 2], Cull::Queries, rules);
        seen.iter().map(|frame| frame.differing).sum::<u64>()
    };
    assert_eq!(lost(true), 0);
    assert!(lost(false) > 0);
}

#[test]
fn holes_and_glass_lose_no_pixel_either() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    write(&path, &street(), true);
    let on = play_file(&path, &walk(), Cull::Queries, Rules::default());
    let off = play_file(&path, &walk(), Cull::Off, Rules::default());
    let plain = play(&street(), &walk(), Cull::Off, Rules::default());
    for ((on, off), plain) in on.iter().zip(&off).zip(&plain) {
        assert_eq!((on.differing, on.hash), (0, off.hash));
        assert!(on.drawn >= on.with_pixels);
        assert_eq!(off.hash == plain.hash, off.drawn == 0);
    }
    assert!(on.iter().zip(&off).any(|(on, off)| on.drawn < off.drawn));
}

#[test]
fn textures_are_read_once_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    write(&path, &street(), true);
    let store = Store::open(&path).unwrap();
    let settings = settings(Cull::Off);
    let bytes = Arc::new(AtomicU64::default());
    let backend = Box::new(CpuBackend::new(SIZE));
    let mut stage = Stage::new(&store, backend, Residency::new(1, Arc::clone(&bytes)), &settings);
    for _ in 0..2 {
        let front = stage.front(&walk()[0]);
        stage.draws(&walk()[0], &front.entries).unwrap();
        let all = store.skeleton().blobs[0].bytes + store.skeleton().textures[0].bytes;
        assert_eq!(bytes.load(std::sync::atomic::Ordering::Relaxed), all);
    }
    assert_eq!(stage.take_io().misses, 1);
}

#[test]
fn geometry_is_read_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    write(&path, &street(), false);
    let store = Store::open(&path).unwrap();
    let settings = settings(Cull::Off);
    let bytes = Arc::new(AtomicU64::default());
    let backend = Box::new(CpuBackend::new(SIZE));
    let mut stage = Stage::new(&store, backend, Residency::new(1, Arc::clone(&bytes)), &settings);
    let camera = walk()[0];
    assert_eq!(stage.take_io(), IoCounts::default());
    let front = stage.front(&camera);
    stage.draws(&camera, &front.entries).unwrap();
    let io = stage.take_io();
    let mesh = store.skeleton().blobs[0].bytes;
    assert_eq!((io.misses, io.bytes_read), (1, mesh));
    assert_eq!(io.hits, front.entries.len() as u64 - 1);
    assert_eq!(bytes.load(std::sync::atomic::Ordering::Relaxed), mesh);
    stage.draws(&camera, &front.entries).unwrap();
    assert_eq!(stage.take_io().misses, 0);
}
