//! The three roles together on one backend: nothing visible is lost, and breaking a rule is seen.

use super::audit::measure;
use super::*;
use crate::fixture::{Piece, street, write};
use crate::open::open_on;
use protocol::format::{Method, ViewCell};
use protocol::settings::{AuditAgainst, BackendChoice, Cull, PictureSize, Residency, Schedule};
use protocol::sun::Sun;
use protocol::telemetry::CullCounts;
use protocol::visible::VisibleSet;
use scene::backend::cpu::CpuBackend;
use scene::view_cells::WHOLE;
use std::path::Path;
use std::sync::atomic::AtomicU64;

mod audits;

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
        audit_against: AuditAgainst::Front,
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
    let mut visible = VisibleSet::default();
    let frame = |camera: &Camera| {
        occlusion_representation::run(&mut stage, camera, &visible).unwrap();
        let culled = hardware_cull::run(&mut stage, camera).unwrap();
        visible = VisibleSet::from_sorted(culled.visible);
        let drawn = render_visible_geometry::run(&mut stage, camera, &visible, true).unwrap();
        let measured = measure(&mut stage, camera, &drawn, true, true).unwrap().unwrap();
        Seen {
            culled: culled.counts,
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
    // Before the first frame nothing stands; the second look finds the wall, which hides the lattice from the start.
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
    let bounds = [[-9.0, -5.0, -9.0], [9.0, 20.0, 9.0]];
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

/// A wall, and a pillar behind it whose bounds the wall does not hide.
fn behind_a_wall(bounds: [[f64; 3]; 2]) -> [Piece; 2] {
    let wall = Piece::tight([-5.0, 8.0, -5.0], [5.0, 9.0, 3.0]);
    [wall, Piece { solid: [[-0.5, 12.0, -1.0], [0.5, 13.0, 1.0]], bounds }]
}

#[test]
fn what_no_box_can_tell_of_is_tested_by_its_triangles() {
    // The bounds hold the eye.
    let pieces = behind_a_wall([[-1.0, -1.0, -1.0], [1.0, 13.0, 1.0]]);
    let seen =
        play(&pieces, &[look([0.0; 3], [0.0, 1.0, 0.0]); 2], Cull::Queries, Rules::default());
    for frame in &seen {
        assert_eq!((frame.culled.visible, frame.culled.at_eye, frame.differing), (1, 0, 0));
        assert!(frame.culled.mesh_queries > 0);
    }
    // From where the wall does not hide it, it is seen.
    let beside = [look([0.0, 10.0, 0.0], [0.0, 20.0, 0.0]); 2];
    let seen = play(&pieces, &beside, Cull::Queries, Rules::default());
    assert!(seen.iter().all(|frame| frame.culled.visible == 1 && frame.with_pixels == 1));
}

#[test]
fn what_a_box_shows_in_vain_is_found_in_its_turn_and_stays_found() {
    // The bounds are higher than the wall; many small things beside it, so that the pillar costs little of all.
    let mut pieces = behind_a_wall([[-0.5, 12.0, -1.0], [0.5, 13.0, 9.0]]).to_vec();
    pieces.extend((0..9).map(|i| {
        let x = f64::from(i) - 4.5;
        Piece::tight([x, 6.0, -1.0], [x + 0.3, 6.3, -0.7])
    }));
    let frames = [look([0.0; 3], [0.0, 1.0, 0.0]); 20];
    let seen = play(&pieces, &frames, Cull::Queries, Rules::default());
    let visible: Vec<u32> = seen.iter().map(|frame| frame.culled.visible).collect();
    assert_eq!(visible[0], 11, "its box is seen above the wall");
    assert!(visible[9..].iter().all(|&count| count == 10), "{visible:?}");
    assert!(seen.iter().all(|frame| frame.differing == 0 && frame.with_pixels == 10));
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

/// Draws all that is in the frustum; what that loaded, and the picture's hash.
fn draw_all(stage: &mut Stage<'_>, camera: &Camera) -> (IoCounts, u64) {
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
    let promise = stage.settings.residency;
    let (completion, ..) = stage.draw(&whole, camera, &front.entries, promise, pass).unwrap();
    let Completion::Picture { picture, .. } = completion else { panic!("no picture") };
    (stage.take_io(), picture_hash(&picture.rgba))
}

/// Least memory with which a scene can be drawn.
fn least_memory(settings: &RunSettings) -> u64 {
    let store = scene::store::Store::open(Path::new(&settings.scene_path)).unwrap();
    let fits = |memory: u64| {
        let skeleton = store.skeleton();
        crate::check_memory(Some(memory), skeleton, settings.residency, settings.far).is_ok()
    };
    let (mut too_small, mut enough) = (0, 1 << 30);
    while enough - too_small > 1 {
        let middle = (too_small + enough) / 2;
        *if fits(middle) { &mut enough } else { &mut too_small } = middle;
    }
    enough
}

/// The backends that can be had here.
fn choices() -> Vec<BackendChoice> {
    let gpu = crate::choose_backend(BackendChoice::Gpu, SIZE, u64::MAX).is_ok();
    assert!(gpu || std::env::var("GPU_TESTS").as_deref() != Ok("require"), "no GPU backend");
    if gpu { vec![BackendChoice::Cpu, BackendChoice::Gpu] } else { vec![BackendChoice::Cpu] }
}

#[test]
fn textures_come_and_go_like_meshes_and_the_pictures_stay_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    crate::fixture::write_with_textures(&path, &street(), 40);
    for choice in choices() {
        let draw = |memory: Option<u64>, prefetch: bool| {
            let base = settings(&path, Cull::Off);
            let settings = RunSettings { memory, prefetch, backend: choice, ..base };
            let peak = Arc::default();
            let mut stage = crate::open::open(&settings, &peak).unwrap().stage;
            let mut sum = IoCounts::default();
            let mut hashes = Vec::new();
            for camera in walk().iter().chain(walk().iter().rev()) {
                let (io, hash) = draw_all(&mut stage, camera);
                sum.bytes_read += io.bytes_read;
                sum.evicted += io.evicted;
                hashes.push(hash);
            }
            let most = peak.load(std::sync::atomic::Ordering::Relaxed);
            assert!(memory.is_none_or(|cap| most <= cap), "{choice:?}: {most} of {memory:?}");
            (hashes, sum)
        };
        let (whole, all) = draw(None, true);
        assert_eq!(all.evicted, 0);
        let skeleton = Arc::clone(scene::store::Store::open(&path).unwrap().skeleton());
        let textures: u64 = skeleton.textures.iter().map(|texture| texture.bytes).sum();
        let meshes: u64 = skeleton.blobs.iter().map(|blob| blob.bytes).sum();
        assert!(all.bytes_read <= textures + meshes, "nothing is read twice");
        let least = least_memory(&settings(&path, Cull::Off));
        for cap in [least, least + textures / 8, least + textures / 2] {
            for prefetch in [false, true] {
                let (hashes, io) = draw(Some(cap), prefetch);
                assert_eq!(hashes, whole, "{choice:?} with {cap} bytes");
                assert!(io.evicted > 0 && io.bytes_read > all.bytes_read, "{cap}: a weak test");
            }
        }
    }
}

#[test]
fn with_a_deadline_a_mesh_without_its_textures_is_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    crate::fixture::write_with_textures(&path, &street(), 40);
    let base = settings(&path, Cull::Off);
    let settings = RunSettings { prefetch: false, ..base };
    let mut stage = stage(&settings, Rules::default(), &Arc::default());
    draw_all(&mut stage, &walk()[0]);
    let front = stage.front(&walk()[0]);
    let level = front.entries[0].level;
    let is_there =
        |stage: &Stage<'_>, what| stage.loader.offers_level(level, Promise::Deadline, what);
    assert!(is_there(&stage, Needs::Look));
    let blob = stage.skeleton.blobs_of(level).next().unwrap();
    let texture = scene::asset::Asset::Texture(stage.skeleton.textures_of(blob)[0]);
    stage.loader.give_up(stage.backend.as_mut(), texture);
    assert!(!is_there(&stage, Needs::Look) && is_there(&stage, Needs::Shape));
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
        let (first, _) = draw_all(&mut stage, &walk()[0]);
        let assets = 1 + u64::from(textured);
        assert_eq!((first.hits, first.misses, first.bytes_read), (0, assets, mesh + textures));
        assert!(first.waits > 0 && first.stall_ns > 0);
        let peak = peak.load(std::sync::atomic::Ordering::Relaxed);
        assert!(
            peak >= stage.skeleton.resident_bytes() + 2 * mesh + textures,
            "{peak}: always, with the backend, and on its way"
        );
        let (second, _) = draw_all(&mut stage, &walk()[0]);
        assert_eq!((second.hits, second.misses, second.bytes_read), (assets, 0, 0));
        assert_eq!((second.events, second.waits), (0, 0));
    }
}
