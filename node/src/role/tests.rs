//! The three roles together on one backend: nothing visible is lost, and breaking a rule is seen.

use super::audit::measure;
use super::*;
use crate::fixture::{Piece, street, write};
use crate::open::open_on;
use protocol::format::{Method, ViewCell};
use protocol::settings::{BackendChoice, Cull, PictureSize, Residency, Schedule};
use protocol::sun::Sun;
use protocol::telemetry::CullCounts;
use protocol::visible::VisibleSet;
use scene::backend::cpu::CpuBackend;
use scene::view_cells::WHOLE;
use std::path::Path;
use std::sync::atomic::AtomicU64;

const SIZE: PictureSize = PictureSize { width: 97, height: 61 };

fn settings(path: &Path, cull: Cull) -> RunSettings {
    RunSettings {
        scene_path: path.to_str().unwrap().to_owned(),
        scene_digest: [0; 32],
        size: SIZE,
        lod_px: 1.0,
        sun: Sun::default(),
        cull,
        schedule: Schedule::Switch,
        backend: BackendChoice::Cpu,
        frames: 0,
        audit_every: 0,
        items_every: 0,
        memory: None,
        residency: Residency::Exact,
        prefetch: true,
        far: protocol::settings::Far::Off,
        far_cubes: 8,
        far_triangles: None,
        pictures_dir: None,
    }
}

/// A stage on the CPU backend.
fn stage<'a>(settings: &'a RunSettings, rules: Rules, peak: &Arc<AtomicU64>) -> Stage<'a> {
    let backend = |budget| {
        Ok(Box::new(CpuBackend::with_rules(SIZE, &rules).with_budget(budget)) as Box<dyn Backend>)
    };
    open_on(settings, peak, backend).unwrap().stage
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
    let settings = settings(path, cull);
    play_on(Stage { rules, ..stage(&settings, rules, &Arc::default()) }, cameras)
}

/// Plays `cameras` on a stage.
fn play_on(mut stage: Stage<'_>, cameras: &[Camera]) -> Vec<Seen> {
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
        let measured = measure(&mut stage, camera, &drawn, true, true).unwrap().unwrap();
        Seen {
            culled: culled.unwrap(),
            drawn: drawn.counts.hlods,
            with_pixels: measured.hlods_with_pixels.unwrap(),
            differing: measured.audit.unwrap().differing_pixels,
            hash: picture_hash(&drawn.into_rgba()),
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
fn where_cells_meet_only_what_both_draw_as_geometry_hides() {
    // A wall half of which is in the near fields of both cells, half in that of the right one alone. Behind both halves
    // the bounds of a box that reaches into the left one; the box itself is behind the right half.
    let both = Piece::tight([-6.0, 8.0, -3.0], [1.0, 9.0, 3.0]);
    let right = Piece::tight([1.0, 8.0, -3.0], [3.0, 9.0, 3.0]);
    let bounds = [[-1.0, 12.0, -1.0], [3.0, 14.0, 1.0]];
    let hidden = Piece { solid: [[2.0, 13.0, -1.0], [3.0, 14.0, 1.0]], bounds };
    let cell = |min, max| ViewCell {
        min,
        max,
        first_cube: 0,
        cube_count: 0,
        method: Method::Itdm as u32,
        margin: 0.0625,
        objective: 0.0,
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    write(&path, &[both, right, hidden], false);
    let play = |cull, x: f64| {
        let settings = settings(&path, cull);
        let stage = stage(&settings, Rules::default(), &Arc::default());
        let mut skeleton = Skeleton::clone(&stage.skeleton);
        let cells = [([-8.0, 0.0, -4.0], [0.0, 12.0, 4.0]), ([0.0, 0.0, -4.0], [8.0, 10.0, 4.0])];
        skeleton.view_cells = cells.map(|(min, max)| cell(min, max)).to_vec();
        let cells = Arc::new(Cells::new(&skeleton, Method::Itdm as u32));
        let far = Distance { cells, field: None };
        play_on(Stage { far, ..stage }, &[look([x, 1.0, 0.0], [x + 2.4, 13.0, 0.0]); 3])
    };
    // Left of the margin, in it, and right of it, where the box is no more than a part of the cubes.
    for (x, drawn) in [(-1.0, 2), (0.05, 3), (1.0, 2)] {
        let (on, off) = (play(Cull::Queries, x), play(Cull::Off, x));
        for (on, off) in on.iter().zip(&off) {
            assert_eq!((on.differing, on.hash), (0, off.hash), "{x}");
            assert_eq!((off.drawn, on.drawn), (drawn, drawn), "{x}");
            assert!(on.with_pixels <= on.drawn);
        }
    }
}

/// Draws all that is in the frustum.
fn draw_all(stage: &mut Stage<'_>, camera: &Camera) -> IoCounts {
    stage.begin_drawing().unwrap();
    let front = stage.front(camera);
    let pass = |view, draws, part| Pass::Shade {
        view,
        shading: Shading::default(),
        draws,
        with_depth: false,
        part,
    };
    let whole = Composition { cell: None, weight: WHOLE };
    stage.draw(&whole, camera, &front.entries, Promise::Exact, pass).unwrap();
    stage.take_io()
}

#[test]
fn textures_and_geometry_are_read_once_and_counted() {
    for textured in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.occ");
        write(&path, &street(), textured);
        let settings = settings(&path, Cull::Off);
        let peak = Arc::default();
        let mut stage = stage(&settings, Rules::default(), &peak);
        let mesh = stage.skeleton.blobs[0].bytes;
        let textures: u64 = stage.skeleton.textures.iter().map(|texture| texture.bytes).sum();
        assert_eq!(textures > 0, textured);
        let first = draw_all(&mut stage, &walk()[0]);
        assert_eq!((first.hits + first.misses, first.bytes_read), (1, mesh));
        let peak = peak.load(std::sync::atomic::Ordering::Relaxed);
        assert!(peak >= 2 * mesh + textures, "{peak}: with the backend, and on its way");
        let second = draw_all(&mut stage, &walk()[0]);
        assert_eq!((second.hits, second.misses, second.bytes_read), (1, 0, 0));
        assert_eq!((second.events, second.stall_ns), (0, 0));
    }
}
