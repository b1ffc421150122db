//! Whole frames of random scenes, culled and not; what each rule is for.

use super::*;
use crate::backend::{Backend, Completion, Draws, NO_ITEM, Part, Pass, Picture, Shading, View};
use crate::draw_list::draw_list;
use crate::front::{FrontEntry, front};
use crate::random_scene::RandomScene;
use protocol::settings::Cull;
use rand::Rng;
use std::collections::BTreeSet;

fn run(backend: &mut impl Backend, pass: Pass) -> Completion {
    backend.submit(pass).unwrap();
    let mut completions = Vec::new();
    backend.poll(&mut completions).unwrap();
    completions.pop().unwrap()
}

fn picture(backend: &mut impl Backend, view: View, draws: Draws) -> Picture {
    match run(
        backend,
        Pass::Shade {
            view,
            shading: Shading::default(),
            draws,
            with_depth: true,
            part: Part::WHOLE,
        },
    ) {
        Completion::Picture { picture, .. } => picture,
        other => panic!("{other:?}"),
    }
}

#[derive(Debug, Default)]
struct Outcome {
    /// Hlods that own a pixel and were culled.
    lost: usize,
    /// Pixels of the culled picture that differ in colour or depth.
    differing_pixels: usize,
    tested: usize,
    culled: usize,
}

/// Culls one camera's front with some of it as occluders, and compares with everything drawn.
fn cull(scene: &mut RandomScene, size: PictureSize, rules: &Rules, sum: &mut Outcome) {
    let camera = scene.camera();
    let lod_px = [0.0, 2.0, 20.0][scene.rng.random_range(0..3)];
    let entries = front(&scene.skeleton, &camera, size, lod_px).entries;
    let share = [1.0, 0.5, 0.1, 0.0][scene.rng.random_range(0..4)];
    let occluders: Vec<FrontEntry> =
        entries.iter().filter(|_| scene.rng.random_bool(share)).copied().collect();
    let mut backend = scene.backend(size, rules);
    let view = View::new(&camera, size);
    let draws = |entries: &[FrontEntry]| draw_list(&scene.skeleton, entries, camera.eye);
    let occluders = draws(&occluders).solid;
    run(&mut backend, Pass::Occluders { view, draws: occluders, part: Part::WHOLE });

    let mut visible = Vec::new();
    let (mut asked, mut boxes) = (Vec::new(), Vec::new());
    for entry in &entries {
        match test_for(scene.skeleton.hlod(entry.hlod), &camera, size, rules) {
            Test::Visible => visible.push(*entry),
            Test::Query(query) => {
                asked.push(*entry);
                boxes.push(query);
            }
        }
    }
    sum.tested += asked.len();
    let Completion::Boxes { visible: answers, .. } =
        run(&mut backend, Pass::QueryBoxes { view, boxes, method: Cull::Queries })
    else {
        panic!("no answers");
    };
    sum.culled += answers.iter().filter(|&&answer| !answer).count();
    visible.extend(asked.iter().zip(&answers).filter(|(_, answer)| **answer).map(|(e, _)| *e));

    let all = draws(&entries);
    let Completion::Items { mut items, blended, .. } =
        run(&mut backend, Pass::Items { view, draws: all.clone(), part: Part::WHOLE })
    else {
        panic!("no items");
    };
    items.extend(blended);
    let owners: BTreeSet<u32> = items.into_iter().filter(|&item| item != NO_ITEM).collect();
    let kept: BTreeSet<u32> = visible.iter().map(|entry| entry.hlod.0).collect();
    sum.lost += owners.difference(&kept).count();
    let whole = picture(&mut backend, view, all);
    let culled = picture(&mut backend, view, draws(&visible));
    let same_color = whole.rgba.chunks(4).zip(culled.rgba.chunks(4)).map(|(a, b)| a == b);
    let same_depth = whole.depth.unwrap().into_iter().zip(culled.depth.unwrap());
    sum.differing_pixels +=
        same_color.zip(same_depth).filter(|&(color, (a, b))| !color || a != b).count();
}

fn cull_many(rules: &Rules) -> Outcome {
    let sizes = [(1, 1), (7, 333), (64, 48), (129, 31)];
    let mut sum = Outcome::default();
    for seed in 0..240 {
        let scale = [1.0 / 1024.0, 1.0, 64.0, 8192.0][seed as usize % 4];
        let mut scene = RandomScene::new(seed, 3, scale);
        let (width, height) = sizes[seed as usize / 4 % 4];
        cull(&mut scene, PictureSize { width, height }, rules, &mut sum);
    }
    sum
}

#[test]
fn no_visible_pixel_is_lost() {
    let sum = cull_many(&Rules::default());
    assert_eq!((sum.lost, sum.differing_pixels), (0, 0), "{sum:?}");
    assert!(sum.culled > 1000 && sum.tested > 2 * sum.culled, "{sum:?}");
}

#[test]
fn each_broken_rule_is_caught() {
    let right = Rules::default();
    let not_grown = cull_many(&Rules { grow: false, ..right });
    let not_near = cull_many(&Rules { near_rule: false, ..right });
    // A grown box is strictly nearer than what it holds, so that Greater shows only without growth.
    let greater = cull_many(&Rules { grow: false, depth_test_inclusive: false, ..right });
    for outcome in [&not_grown, &not_near, &greater] {
        assert!(outcome.lost > 0 && outcome.differing_pixels > 0, "{outcome:?}");
    }
    assert!(greater.lost > 2 * not_grown.lost, "{greater:?} {not_grown:?}");
}

#[test]
fn boxes_that_prove_nothing_are_visible() {
    let size = PictureSize { width: 64, height: 48 };
    let camera = Camera::look_at([0.0; 3], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], 60.0, 0.5).unwrap();
    let test = |min: [f64; 3], max: [f64; 3]| {
        let hlod = Hlod { min, max, ..bytemuck::Zeroable::zeroed() };
        test_for(&hlod, &camera, size, &Rules::default())
    };
    assert_eq!(test([-1.0; 3], [1.0; 3]), Test::Visible, "holds the eye");
    assert_eq!(test([1.0, 1.0, 0.4], [2.0, 2.0, 9.0]), Test::Visible, "crosses near");
    assert_eq!(test([0.0, 0.0, 0.5001], [1.0; 3]), Test::Visible, "almost crosses near");
    assert_eq!(test([0.0, 0.0, 1.0], [1e300; 3]), Test::Visible, "beyond f32");
    assert_eq!(test([0.0, 0.0, 1.0], [f64::INFINITY; 3]), Test::Visible);
    assert_eq!(test([0.0, 0.0, f64::NAN], [1.0; 3]), Test::Visible);
    assert_eq!(test([0.0, 0.0, 0.6], [0.1, 0.1, 1e6]), Test::Visible, "spoils its bound");
    let Test::Query(query) = test([-1.0, -1.0, 10.0], [1.0, 1.0, 11.0]) else {
        panic!("a plain box ahead");
    };
    let grown_px = f64::from(10.0 - query.min[2]) / (10.0 * pixel_at_unit_depth(&camera, size));
    assert!(grown_px > 1.0 / 64.0 && grown_px < 0.1, "{grown_px}");
}

#[test]
fn a_point_far_from_the_origin_is_grown_by_its_rounding() {
    let size = PictureSize { width: 16384, height: 16384 };
    let eye = [1e9, -1e9, 1e9];
    let target = [1e9, -1e9, 1e9 + 1.0];
    let camera = Camera::look_at(eye, target, [0.0, 1.0, 0.0], 1.0, 1e-6).unwrap();
    let min = [1e9, -1e9, 1e9 + 1e-4];
    let hlod = Hlod { min, max: min, ..bytemuck::Zeroable::zeroed() };
    let Test::Query(query) = test_for(&hlod, &camera, size, &Rules::default()) else {
        panic!("a point well ahead");
    };
    assert!(f64::from(query.max[0]) > 1e9 * f64::EPSILON);
}
