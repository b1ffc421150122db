//! Whole frames of random scenes, culled and not; what each rule is for.

use super::*;
use crate::backend::{Backend, Completion, Draws, NO_ITEM, Part, Pass, Picture, Shading, View};
use crate::draw_list::draw_list;
use crate::front::{FrontEntry, front};
use crate::random_scene::RandomScene;
use protocol::settings::Cull;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
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
    /// Visible without a test, the eye being neither in the box nor by it.
    unproven: usize,
    /// Not in the picture at all.
    outside: usize,
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
    run(&mut backend, Pass::Occluders { view, draws: occluders, adds: false, part: Part::WHOLE });

    let mut visible = Vec::new();
    let (mut asked, mut boxes) = (Vec::new(), Vec::new());
    let tests = BoxTests::new(&camera, size, backend.precision(), *rules);
    for entry in &entries {
        let hlod = scene.skeleton.hlod(entry.hlod);
        match tests.test(hlod, scene.skeleton.longest_edge(hlod)) {
            BoxTest::AtEye => visible.push(*entry),
            BoxTest::Unproven => {
                visible.push(*entry);
                sum.unproven += 1;
            }
            BoxTest::Outside => sum.outside += 1,
            BoxTest::Query(query) => {
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
    assert!(sum.unproven * 20 < sum.tested && sum.outside > 50, "{sum:?}");
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

/// Looks along +z, 60 degrees, the near plane at a half.
fn ahead(precision: Precision) -> BoxTests {
    let size = PictureSize { width: 64, height: 48 };
    let camera = Camera::look_at([0.0; 3], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], 60.0, 0.5).unwrap();
    BoxTests::new(&camera, size, precision, Rules::default())
}

fn hlod(min: [f64; 3], max: [f64; 3]) -> Hlod {
    Hlod { min, max, ..bytemuck::Zeroable::zeroed() }
}

/// Mesa's software driver, and hardware in a picture of 64x48.
const SOFTWARE: Precision = Precision::f32(2.0);
const HARDWARE: Precision = Precision::f32(1365.0);

#[test]
fn boxes_that_prove_nothing_are_visible() {
    let tests = ahead(SOFTWARE);
    let test = |min, max| tests.test(&hlod(min, max), 1.0);
    assert_eq!(test([-1.0; 3], [1.0; 3]), BoxTest::AtEye, "holds the eye");
    assert_eq!(test([-1.0, -1.0, 0.2], [1.0, 1.0, 0.4]), BoxTest::AtEye, "before the near plane");
    assert_eq!(test([0.0, 0.0, 0.5001], [1.0; 3]), BoxTest::AtEye, "almost at the near plane");
    assert_eq!(test([0.0, 0.0, 1.0], [1e300; 3]), BoxTest::Unproven, "beyond f32");
    assert_eq!(test([0.0, 0.0, 1.0], [f64::INFINITY; 3]), BoxTest::Unproven);
    assert_eq!(test([0.0, 0.0, f64::NAN], [1.0; 3]), BoxTest::Unproven);
    assert_eq!(test([0.0, 0.0, 3.0], [0.1, 0.1, 1e6]), BoxTest::Unproven, "spoils its bound");

    let BoxTest::Query(query) = test([-1.0, -1.0, 10.0], [1.0, 1.0, 11.0]) else {
        panic!("a plain box ahead");
    };
    let grown_px = f64::from(10.0 - query.min[2]) / (10.0 * tests.pixel);
    assert!(grown_px > 1.0 / 64.0 && grown_px < 0.1, "{grown_px}");
}

#[test]
fn what_runs_past_the_eye_is_asked_where_the_picture_shows_it() {
    // A wall to the right, a floor and a bar, all from far behind the eye to far ahead.
    let long = [
        hlod([3.0, -2.0, -50.0], [3.5, 5.0, 50.0]),
        hlod([-30.0, -4.0, -50.0], [30.0, -3.0, 50.0]),
        hlod([2.5, -2.6, -50.0], [2.6, -2.5, 50.0]),
    ];
    for precision in [SOFTWARE, Precision::f64(1000.0)] {
        for hlod in &long {
            let BoxTest::Query(query) = ahead(precision).test(hlod, 100.0) else {
                panic!("{hlod:?}");
            };
            assert!(query.min[2] > 1.0 && query.max[2] >= 50.0, "{query:?}");
        }
    }
    // Where a driver may rasterise a triangle from the near plane on, its depth says little far away.
    assert_eq!(ahead(HARDWARE).test(&long[0], 100.0), BoxTest::Unproven);
    assert!(matches!(ahead(HARDWARE).test(&long[0], 0.1), BoxTest::Query(_)));
}

#[test]
fn what_the_picture_cannot_show_is_not_tested() {
    let tests = ahead(SOFTWARE);
    let behind_a_corner = hlod([5.0, 4.0, 5.0], [9.0, 9.0, 6.0]);
    assert_eq!(tests.test(&behind_a_corner, 1.0), BoxTest::Outside);
    assert_eq!(tests.test(&hlod([-1.0, -1.0, -9.0], [1.0, 1.0, -8.0]), 1.0), BoxTest::Outside);
}

#[test]
fn a_point_far_from_the_origin_is_grown_by_its_rounding() {
    let size = PictureSize { width: 16384, height: 16384 };
    let eye = [1e9, -1e9, 1e9];
    let target = [1e9, -1e9, 1e9 + 1.0];
    let camera = Camera::look_at(eye, target, [0.0, 1.0, 0.0], 1.0, 1e-6).unwrap();
    let min = [1e9, -1e9, 1e9 + 1e-4];
    let tests = BoxTests::new(&camera, size, SOFTWARE, Rules::default());
    let BoxTest::Query(query) = tests.test(&hlod(min, min), 0.0) else {
        panic!("a point well ahead");
    };
    assert!(f64::from(query.max[0]) > 1e9 * f64::EPSILON);
}

/// A point of the picture of [`ahead`], between two depths.
fn shown(tests: &BoxTests, rng: &mut impl Rng, depths: std::ops::Range<f64>) -> DVec3 {
    let [tx, ty] = tests.tan_half;
    let w = rng.random_range(depths);
    // Looking along +z with y up, the picture's right is -x.
    DVec3::new(rng.random_range(-tx..tx) * w, rng.random_range(-ty..ty) * w, w)
}

fn direction(rng: &mut impl Rng) -> DVec3 {
    let mut side = || rng.random_range(-1.0..1.0);
    DVec3::new(side(), side(), side()).normalize_or(DVec3::X)
}

#[test]
fn what_rounding_moves_into_the_picture_is_asked_for() {
    let mut rng = StdRng::seed_from_u64(21);
    let tests = ahead(SOFTWARE);
    let moved = 0.01;
    let mut lost = [0; 2];
    for _ in 0..100_000 {
        // A point that the picture does not show, and one that it shows, to which rounding moves it.
        let there = shown(&tests, &mut rng, 1.0..20.0);
        let point = there + direction(&mut rng) * moved * 0.999;
        for (lost, margin) in lost.iter_mut().zip([moved, 0.0]) {
            let pyramid = Pyramid::new(tests.basis, tests.tan_half, margin);
            let part = pyramid.bounds_within(&Aabb::of([point])).unwrap();
            *lost += usize::from(part.is_empty());
        }
    }
    assert!(lost[0] == 0 && lost[1] > 50, "{lost:?}");
}

/// Least depth of what a driver rasterises of a triangle: before the near plane, within the guard band.
fn least_rasterised(tests: &BoxTests, triangle: [DVec3; 3], guard_band: f64) -> Option<f64> {
    let [tx, ty] = tests.tan_half.map(|t| t * guard_band);
    let planes = [
        (DVec3::new(1.0, 0.0, tx), 0.0),
        (DVec3::new(-1.0, 0.0, tx), 0.0),
        (DVec3::new(0.0, 1.0, ty), 0.0),
        (DVec3::new(0.0, -1.0, ty), 0.0),
        (DVec3::Z, tests.near),
    ];
    let mut polygon = triangle.to_vec();
    for (normal, offset) in planes {
        let inside = |p: DVec3| normal.dot(p) - offset;
        let mut kept = Vec::new();
        for (i, &here) in polygon.iter().enumerate() {
            let next = polygon[(i + 1) % polygon.len()];
            let (a, b) = (inside(here), inside(next));
            if a >= 0.0 {
                kept.push(here);
            }
            if (a >= 0.0) != (b >= 0.0) {
                kept.push(here + (next - here) * (a / (a - b)));
            }
        }
        polygon = kept;
    }
    polygon.into_iter().map(|p| p.z).reduce(f64::min)
}

#[test]
fn no_triangle_that_is_shown_begins_nearer_than_its_least_depth() {
    let mut rng = StdRng::seed_from_u64(22);
    let tests = ahead(SOFTWARE);
    // With the derivation's bounds, without the guard band's corner, and without the longest edge.
    let (mut nearer, mut reached) = ([0; 3], 0);
    for _ in 0..200_000 {
        let point = shown(&tests, &mut rng, 0.6..8.0);
        let length = 10f64.powf(rng.random_range(-1.0..1.5));
        let mut end = || direction(&mut rng) * length * 0.5;
        // A triangle around the point none of whose sides is longer.
        let (a, b) = (end(), end());
        let triangle = [point + a, point + b, point - (a + b) * 0.5];
        let longest = triangle[0]
            .distance(triangle[1])
            .max(triangle[1].distance(triangle[2]))
            .max(triangle[2].distance(triangle[0]));
        let whole = Aabb::of(triangle);
        let part = Pyramid::new(tests.basis, tests.tan_half, 1e-9).bounds_within(&whole);
        let Some(part) = part.filter(|_| whole.distance(DVec3::ZERO) > 0.0) else { continue };
        let Some(least) = least_rasterised(&tests, triangle, 2.0) else { continue };

        let by_edge = |longest: f64| part.distance(DVec3::ZERO) / tests.corner_ray - longest;
        let by_picture = whole.distance(DVec3::ZERO) / tests.corner_ray;
        let bounds = [
            tests.least_depth(&whole).max(by_edge(longest)),
            tests.least_depth(&whole).max(by_picture),
            tests.least_depth(&whole).max(by_edge(0.0)),
        ];
        for (nearer, bound) in nearer.iter_mut().zip(bounds) {
            *nearer += usize::from(least < bound * (1.0 - 1e-9));
        }

        // And it reaches over no more pixels than its edges let it.
        if by_edge(longest) > tests.near {
            let seen = Aabb::of(triangle.map(|p| p / p.z));
            let reach = seen.extent().element_sum() / tests.pixel;
            assert!(reach <= tests.edge_px(longest, by_edge(longest)), "{triangle:?}");
            reached += 1;
        }
    }
    assert!(nearer[0] == 0 && nearer[1] > 100 && nearer[2] > 100, "{nearer:?}");
    assert!(reached > 10_000, "{reached}");
}

#[test]
fn the_box_lies_in_front_of_a_depth_that_errs_as_much_as_it_may() {
    let mut rng = StdRng::seed_from_u64(23);
    let tests = ahead(SOFTWARE);
    let (mut behind, mut asked) = ([0; 2], 0);
    while asked < 50_000 {
        let corner = shown(&tests, &mut rng, 2.0..30.0);
        let size = 10f64.powf(rng.random_range(-1.5..1.3));
        let whole = Aabb::of([corner, corner + direction(&mut rng) * size]);
        let part = Pyramid::new(tests.basis, tests.tan_half, 1e-6).bounds_within(&whole);
        let Some(part) = part.filter(|part| !part.is_empty()) else { continue };
        let Some(displaced) = tests.displacement(&whole, &part, 0.0, size) else { continue };
        asked += 1;

        // A point of the part, and the errors of geometry and box there, in depth.
        let share = DVec3::new(rng.random(), rng.random(), rng.random());
        let q = part.min + part.extent() * share;
        let by_edge = part.distance(DVec3::ZERO) / tests.corner_ray - size;
        let reach = match part == whole {
            true => tests.picture_px,
            false => tests.edge_px(size, by_edge).min(tests.guarded_px()),
        };
        let at = |b: &Aabb, reach: f64| {
            let (w0, w1) = (tests.least_depth(b), tests.depths(b).1);
            tests.depth_error(w0, w1, reach)
        };
        for (behind, displaced) in behind.iter_mut().zip([displaced, Displacement::NONE]) {
            let grown = displaced.of(&part);
            let error = at(&whole, reach) + at(&grown, tests.box_px(&grown));
            // Where the ray to the point enters the box.
            let entry = (0..3).map(|k| {
                let side = if q[k] > 0.0 { grown.min[k] } else { grown.max[k] };
                if q[k] == 0.0 { 0.0 } else { side / q[k] }
            });
            let entered = entry.fold(0.0, f64::max) * q.z;
            *behind += usize::from(1.0 / entered < 1.0 / q.z + error);
        }
    }
    assert!(behind[0] == 0 && behind[1] > 50, "{behind:?}");
}
