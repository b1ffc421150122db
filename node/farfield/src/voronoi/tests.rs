use super::*;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng, rngs::StdRng};

const MIN: DVec2 = DVec2::new(-1.0, 2.0);
const MAX: DVec2 = DVec2::new(3.0, 4.0);

fn corners() -> [DVec2; 4] {
    [MIN, MAX, DVec2::new(MIN.x, MAX.y), DVec2::new(MAX.x, MIN.y)]
}

fn same(left: &[DVec2], right: &[DVec2]) {
    assert_eq!(left.len(), right.len(), "{left:?} {right:?}");
    let near = |at: &DVec2| right.iter().any(|other| at.distance(*other) < 1e-6);
    assert!(left.iter().all(near), "{left:?} {right:?}");
}

/// In a flat box every candidate lies on the plane, and the box's way of finding them shares nothing with the
/// rectangle's.
fn by_planes(sites: &[DVec2]) -> Vec<DVec2> {
    let sites: Vec<DVec3> = sites.iter().map(|site| site.extend(0.0)).collect();
    in_box(MIN.extend(0.0), MAX.extend(0.0), &sites).into_iter().map(DVec3::truncate).collect()
}

#[test]
fn the_four_corners_leave_the_middle_and_the_sides() {
    let found = in_rectangle(MIN, MAX, &corners());
    let want = [[-1.0, 3.0], [1.0, 2.0], [1.0, 3.0], [1.0, 4.0], [3.0, 3.0]].map(DVec2::from_array);
    same(&found, &want);
    assert!(found.is_sorted_by(|a, b| (a.x, a.y) < (b.x, b.y)));
}

#[test]
fn agrees_with_all_triples_of_planes() {
    let mut random = StdRng::seed_from_u64(11);
    for count in 0..14 {
        for outside in [0.0, 0.5] {
            let mut site = || {
                let at = DVec2::new(random.random(), random.random());
                MIN - outside + (MAX - MIN + 2.0 * outside) * at
            };
            let mut sites: Vec<DVec2> = (0..count).map(|_| site()).collect();
            let found = in_rectangle(MIN, MAX, &sites);
            same(&found, &by_planes(&sites));
            sites.shuffle(&mut random);
            assert_eq!(found, in_rectangle(MIN, MAX, &sites));
        }
    }
}

#[test]
fn degenerate_sites() {
    let p = DVec2::new;
    same(&in_rectangle(MIN, MAX, &[]), &corners());
    same(&in_rectangle(MIN, MAX, &[MIN, MIN]), &corners()[1..]);
    let line: Vec<DVec2> = (0..5).map(|k| p(f64::from(k) - 1.0, 3.0)).collect();
    let slanted: Vec<DVec2> = (0..6).map(|k| MIN + (MAX - MIN) * 0.2 * f64::from(k)).collect();
    let circle: Vec<DVec2> =
        (0..8).map(|k| p(1.0, 3.0) + DVec2::from_angle(f64::from(k) * 0.7) * 0.9).collect();
    let border = [p(-1.0, 2.5), p(1.0, 2.0), p(3.0, 3.0), p(1.5, 4.0)];
    let almost: Vec<DVec2> =
        (0..5).map(|k| p(f64::from(k) - 1.0, 3.0 + 1e-9 * f64::from(k * k))).collect();
    for sites in [&line[..2], &line, &slanted, &circle, &border, &almost, &corners()] {
        let found = in_rectangle(MIN, MAX, sites);
        same(&found, &by_planes(sites));
        assert!(!found.is_empty());
        let twice = [sites, sites, &[p(f64::NAN, 0.0), p(0.0, f64::INFINITY)]].concat();
        assert_eq!(found, in_rectangle(MIN, MAX, &twice));
    }
    assert_eq!(in_rectangle(MIN, MAX, &line).len(), 8);
    // A region that is a point, or a line.
    assert_eq!(in_rectangle(MIN, MIN, &[MIN]), []);
    assert_eq!(in_rectangle(MIN, MIN, &[]), [MIN]);
    same(&in_rectangle(MIN, p(3.0, 2.0), &[MIN, p(3.0, 2.0)]), &[p(1.0, 2.0)]);
}

#[test]
fn scale_and_place_do_not_matter() {
    let sites = [DVec2::new(0.0, 2.5), DVec2::new(1.0, 3.5), DVec2::new(2.5, 2.2)];
    let found = in_rectangle(MIN, MAX, &sites);
    for scale in [1e-6, 1e7] {
        let moved = in_rectangle(MIN * scale, MAX * scale, &sites.map(|site| site * scale));
        same(&found, &moved.iter().map(|at| at / scale).collect::<Vec<_>>());
    }
}

#[test]
fn in_a_box_from_its_corners() {
    let (min, max) = (DVec3::new(0.0, 0.0, 0.0), DVec3::new(2.0, 4.0, 6.0));
    let corners: Vec<DVec3> = (0..8)
        .map(|k| {
            min + (max - min) * DVec3::new((k & 1).into(), (k >> 1 & 1).into(), (k >> 2).into())
        })
        .collect();
    let found = in_box(min, max, &corners);
    // The middle of the box, of its six faces, and of its twelve edges.
    assert_eq!(found.len(), 19, "{found:?}");
    for at in &found {
        let part = (at - min) / (max - min);
        assert!(part.to_array().iter().all(|k| (2.0 * k - (2.0 * k).round()).abs() < 1e-9));
        assert!((part - 0.5).abs().min_element() < 1e-9);
    }
    assert_eq!(in_box(min, max, &[]).len(), 8);
    assert_eq!(in_box(min, max, &[min; 3]).len(), 7);
}

#[test]
fn in_a_box_candidates_are_as_far_as_their_surroundings() {
    let mut random = StdRng::seed_from_u64(5);
    let (min, max) = (DVec3::ZERO, DVec3::ONE);
    for count in [2, 3, 5, 9] {
        let sites: Vec<DVec3> = (0..count)
            .map(|_| DVec3::from_array(std::array::from_fn(|_| random.random())))
            .collect();
        let found = in_box(min, max, &sites);
        let clearance =
            |at: DVec3| sites.iter().map(|site| at.distance(*site)).min_by(f64::total_cmp).unwrap();
        for &at in &found {
            let near =
                sites.iter().filter(|site| at.distance(**site) < clearance(at) + 1e-6).count();
            let on = (0..3).filter(|&k| at[k] < 1e-9 || at[k] > 1.0 - 1e-9).count();
            assert!(near >= 2 && near + on >= 4, "{at} {near} {on}");
        }
        // The emptiest place of the box is a candidate or a corner.
        let best = found.iter().copied().map(clearance).fold(0.0, f64::max);
        let corner = (0..8)
            .map(|k| clearance(DVec3::new((k & 1).into(), (k >> 1 & 1).into(), (k >> 2).into())));
        let best = corner.fold(best, f64::max);
        for k in 0..20 * 20 * 20 {
            let at = DVec3::new((k % 20).into(), (k / 20 % 20).into(), (k / 400).into()) / 19.0;
            assert!(clearance(at) <= best + 1e-9);
        }
    }
}
