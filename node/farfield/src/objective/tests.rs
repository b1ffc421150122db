use super::*;
use crate::analytic::Scene;
use std::f64::consts::PI;

/// With walls that are joined down to 3.6 degrees.
const TESTS: Tests = Tests { least_disparity: 0.0, alpha: 0.0625, slack_pixels: 2.0 };

fn group(scene: &Scene, eyes: &[[f64; 3]], side: u32) -> Group {
    let mut group = Group::new(TESTS);
    eyes.iter().for_each(|&eye| group.push(scene.sample(DVec3::from_array(eye), side)));
    group
}

fn at(group: &Group, eye: [f64; 3]) -> f64 {
    let measure = group.objective(DVec3::from_array(eye), 64);
    assert!((0.0..=4.0 * PI + 1e-9).contains(&measure.steradians));
    assert_eq!(measure.pixels == 0, measure.steradians == 0.0);
    measure.steradians
}

#[test]
fn where_nothing_is_nothing_is_missing() {
    assert_eq!(at(&group(&Scene::default(), &[], 16), [0.0; 3]), 0.0);
    let sky = group(&Scene::default(), &[[0.0; 3], [1.0, 2.0, 3.0], [0.0; 3]], 16);
    assert_eq!(at(&sky, [0.0; 3]), 0.0);
    assert_eq!(at(&sky, [50.0, -2.0, 1e6]), 0.0);
}

/// The paper's figure 3, cases a to d.
#[test]
fn the_void_beside_a_gap_grows_with_the_way_aside() {
    let scene = Scene::gap();
    let one = group(&scene, &[[0.0; 3]], 128);
    let seen: Vec<f64> = [0.0, 0.5, 1.0, 2.0, 3.0].map(|x| at(&one, [x, 0.0, 0.0])).into();
    println!("from one sample, aside by 0, 0.5, 1, 2, 3: {seen:.3?}");
    assert_eq!(seen[0], 0.0);
    assert!(seen[1] > seen[0] + 0.1 && seen[2] > seen[1] + 0.1, "{seen:?}");
    // Past the critical line all of the gap is void, from the near side of the one wall's end to the rear side of the
    // other's: a lune, but for its far ends.
    let strip = |x: f64| 2.0 * (((0.5 - x) / 2.0).atan() - ((-0.5 - x) / 2.1).atan());
    assert!((seen[4] / strip(3.0) - 1.0).abs() < 0.1, "{} {}", seen[4], strip(3.0));
    // From the other side alike; a sample at the place itself leaves nothing.
    let (left, right) = (at(&one, [-1.0, 0.0, 0.0]), seen[2]);
    assert!((left - right).abs() < 0.1 * right, "{left} {right}");
    let two = group(&scene, &[[0.0; 3], [2.0, 0.0, 0.0]], 128);
    let lowered = [0.0, 1.0, 2.0, 3.0].map(|x| at(&two, [x, 0.0, 0.0]));
    println!("with a second at 2, at 0, 1, 2, 3: {lowered:.3?}");
    assert!(lowered[2] < 0.1 * seen[3] && lowered[1] < 0.7 * seen[2], "{lowered:?}");
    assert!(lowered[3] < 0.75 * seen[4], "{lowered:?}");
}

#[test]
fn more_samples_never_show_more_void() {
    let scene = Scene::of(&[
        [-3.0, 2.0, -1.0, -2.0, 3.0, 2.0],
        [0.5, 2.5, -2.0, 1.0, 3.0, 1.0],
        [2.0, -3.0, -2.0, 3.0, -2.0, 3.0],
        [-9.0, 8.0, -9.0, 9.0, 8.5, 9.0],
    ]);
    let eyes = [[0.0; 3], [1.0, 0.3, 0.0], [-1.0, 0.7, 0.2], [0.4, -1.0, 0.1], [1.5, 1.0, -0.3]];
    for eye in [[0.7, 0.6, 0.1], [-1.0, -1.0, 0.0], [1.4, -1.0, 0.5]] {
        let mut members = Group::new(TESTS);
        let mut last = f64::INFINITY;
        for next in eyes {
            members.push(scene.sample(DVec3::from_array(next), 64));
            let seen = at(&members, eye);
            // What the third test takes back, a pixel along a silhouette: less than a hundredth.
            assert!(seen <= last + 0.02, "{eye:?}: {seen} after {last}");
            last = seen;
        }
    }
}

#[test]
fn a_silhouette_against_the_sky_has_a_skin_and_sky_seen_through_it_is_valid() {
    let pillar = Scene::of(&[[-0.5, 3.0, -5.0, 0.5, 4.0, 5.0]]);
    let one = group(&pillar, &[[0.0; 3]], 128);
    let aside = at(&one, [6.0, 3.5, 0.0]);
    assert!(aside > 0.2, "behind the pillar nothing was seen: {aside}");
    let two = group(&pillar, &[[0.0; 3], [6.0, 3.5, 0.0]], 128);
    assert!(at(&two, [6.0, 3.5, 0.0]) < 0.25 * aside);
    assert_eq!(at(&one, [0.0; 3]), 0.0);
}

#[test]
fn where_a_sample_was_taken_nothing_is_void() {
    let cluttered = Scene {
        boxes: (0..40)
            .map(|k| {
                let at = DVec3::new((k % 7).into(), (k % 5).into(), (k % 3).into()) * 1.3;
                [at + 1.0, at + 1.0 + DVec3::new(0.03, 0.1, 0.7)]
            })
            .collect(),
        ground: Some(-1.5),
    };
    let eyes = [[0.0; 3], [0.4, 3.0, 0.5], [4.9, 2.2, 0.9]];
    for scene in [cluttered, Scene::gap()] {
        let mut members = Group::new(TESTS);
        for eye in eyes {
            members.push(scene.sample(DVec3::from_array(eye), 20));
            let taken: Vec<DVec3> = members.samples().map(|sample| sample.eye).collect();
            assert!(taken.iter().all(|&eye| members.objective(eye, 64).pixels == 0));
        }
        assert!(members.objective(DVec3::new(2.0, 1.0, 0.2), 64).pixels > 0);
    }
}

#[test]
fn on_walls_twice_and_at_every_scale() {
    for scale in [1e-3, 1.0, 1e6] {
        let room = Scene::of(&[[-4.0, -3.0, -2.0, 4.0, 3.0, 2.0].map(|at: f64| at * scale)]);
        let eyes = [[0.0; 3], [0.0; 3], [4.0, 0.0, 0.0], [4.0, 3.0, 2.0], [-4.0, 1.0, 0.5]];
        let members = group(&room, &eyes.map(|eye| eye.map(|at: f64| at * scale)), 32);
        for eye in [[0.0; 3], [1.0, 1.0, 1.0], [4.0, 0.0, 0.0], [4.0, 3.0, 2.0]] {
            let seen = at(&members, eye.map(|at: f64| at * scale));
            // From a corner, three walls edge-on: a few pixels of 64 x 64.
            assert!(seen < 0.15, "{scale} {eye:?}: {seen}");
        }
    }
    // A thousandth before the eye, and a million away.
    let mixed = Scene::of(&[
        [1e-3, -1e-4, -1e-4, 2e-3, 1e-4, 1e-4],
        [1e6, -1e7, -1e7, 1.1e6, 1e7, 1e7],
        [-2.0, -9.0, -9.0, -1.0, 9.0, 9.0],
    ]);
    let members = group(&mixed, &[[0.0; 3], [0.0, 1e-3, 0.0], [0.0, 1.0, 5e-4]], 48);
    for eye in [[0.0; 3], [0.0, 5e-4, 0.0], [1e-3, 0.0, 0.0], [0.5, 0.5, 0.5], [1e6, 0.0, 0.0]] {
        assert!(at(&members, eye).is_finite());
    }
}

#[test]
fn any_number_of_threads_measures_the_same() {
    let measure = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let members = group(&Scene::gap(), &[[0.0; 3], [0.3, 0.1, 0.2]], 40);
            members.objective(DVec3::new(1.1, 0.2, 0.3), 50)
        })
    };
    let one = measure(1);
    assert!(one.pixels > 0);
    assert_eq!(one, measure(2));
    assert_eq!(one, measure(5));
}

/// The paper's steps, one after another, over all triangles and pixels.
fn step_by_step(group: &Group, eye: DVec3, side: u32) -> Measure {
    let pixels = (side * side) as usize;
    let all: [Wanted; 6] = std::array::from_fn(|_| Wanted::new(side, |_| true));
    let mut valid: [Vec<f64>; 6] = std::array::from_fn(|_| vec![0.0; pixels]);
    let project =
        |member: &Member| Projection::new(member.sample.eye, &member.surfaces.corners, eye, side);
    for member in &group.members {
        let surfaces = &member.surfaces.valid;
        project(member).draw(surfaces, &all, side, &mut valid, |seen, pixel, disparity| {
            seen[pixel] = seen[pixel].max(disparity);
        });
    }
    let mut void = [(); 6].map(|()| vec![!group.members.is_empty(); pixels]);
    for member in &group.members {
        let before = 1.0 + 2.0 / f64::from(member.sample.side);
        let mut skin: [_; 6] = valid.each_ref().map(|valid| (valid, vec![false; pixels]));
        let skins = &member.surfaces.skins;
        project(member).draw(skins, &all, side, &mut skin, |(valid, skin), pixel, disparity| {
            skin[pixel] |= disparity > valid[pixel] * before;
        });
        for (void, (_, skin)) in void.iter_mut().zip(&skin) {
            void.iter_mut().zip(skin).for_each(|(void, skin)| *void &= skin);
        }
    }
    let mut sum = Measure { steradians: 0.0, pixels: 0 };
    for pixel in void.iter().flat_map(|void| (0..pixels).filter(|&pixel| void[pixel])) {
        sum.steradians += solid_angle(side, pixel as u32 % side, pixel as u32 / side);
        sum.pixels += 1;
    }
    sum
}

#[test]
fn looking_only_where_it_matters_changes_no_bit() {
    let mut scene = Scene::gap();
    scene.boxes.extend(
        Scene::of(&[[-3.0, -3.0, -1.0, -2.0, -2.0, 2.0], [1.0, -2.0, -9.0, 1.2, -1.0, 9.0]]).boxes,
    );
    let outdoors = Scene { boxes: scene.boxes.split_off(1), ground: Some(-1.5) };
    let eyes = [[0.0; 3], [0.3, 0.1, 0.2], [-1.0, 1.0, 0.0], [0.0; 3], [0.9, -0.4, -0.3]];
    let mut seen = 0;
    for scene in [scene, outdoors] {
        for count in 0..=eyes.len() {
            let members = group(&scene, &eyes[..count], 24);
            for at in [[0.0; 3], [1.1, 0.2, 0.3], [-1.5, -0.5, 0.9], [0.0, -8.0, 3.0]] {
                for side in [1, 17, 40] {
                    let at = DVec3::from_array(at);
                    let measure = members.objective(at, side);
                    assert_eq!(measure, step_by_step(&members, at, side), "{count} {at} {side}");
                    seen += measure.pixels;
                }
            }
        }
    }
    assert!(seen > 10_000, "{seen}");
}
