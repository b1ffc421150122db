use super::*;
use crate::mesh::tests::{mesh_of, sphere};
use glam::DAffine3;
use rand::{Rng, SeedableRng, rngs::StdRng};

const TIGHT: Goal = Goal { enough: 0.0, slack: 0.05, budget: 100_000 };

fn bound(from: &Mesh, to: &Mesh) -> Bound {
    directed(from, &Surface::new(to), &TIGHT)
}

/// The nearest point by way of all triangles and another formula: the foot in the plane if it
/// lies within all sides, or the nearest of the edges.
fn brute(p: DVec3, to: &Mesh) -> f64 {
    let of = |t: &[u32; 3]| {
        let corners @ [a, b, c] = to.corners(*t);
        let normal = (b - a).cross(c - a);
        let side = |k: usize| {
            let (from, along) = (corners[k], corners[(k + 1) % 3] - corners[k]);
            let t = (p - from).dot(along) / along.length_squared();
            let t = if t.is_finite() { t.clamp(0.0, 1.0) } else { 0.0 };
            let within = normal.cross(along).dot(p - from) >= 0.0;
            (p.distance(from + along * t), within)
        };
        let sides = [0, 1, 2].map(side);
        let edges = sides.iter().fold(f64::INFINITY, |least, (d, _)| least.min(*d));
        let over = sides.iter().all(|(_, within)| *within) && normal != DVec3::ZERO;
        if over { (p - a).dot(normal.normalize()).abs() } else { edges }
    };
    to.triangles.iter().map(of).fold(f64::INFINITY, f64::min)
}

/// Loose triangles within a cube of half edge 1, some flat, some needles.
fn heap(rng: &mut StdRng, count: u32) -> Mesh {
    let mut points = Vec::new();
    for _ in 0..count {
        let mut point = |r: f64| -> [f64; 3] { std::array::from_fn(|_| rng.random_range(-r..r)) };
        let (center, reach) = (point(1.0), [0.5, 0.1, 0.02][points.len() % 3]);
        let mut corners = [point(reach), point(reach), point(reach)];
        for (corner, k) in corners.iter_mut().flat_map(|c| c.iter_mut().zip(0..)) {
            *corner += center[k];
        }
        match rng.random_range(0..8) {
            0 => corners[2] = corners[0],
            1 => corners[2][2] = corners[1][2],
            _ => {}
        }
        points.extend(corners);
    }
    let triangles: Vec<[u32; 3]> = (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    mesh_of(&points, &triangles)
}

fn moved(mesh: &Mesh, scale: f64, by: f64) -> Mesh {
    let place =
        DAffine3 { translation: DVec3::splat(by), ..DAffine3::from_scale(DVec3::splat(scale)) };
    mesh.clone().placed(&place)
}

fn far(from: &Mesh, to: &Surface, limit: f64) -> Vec<u32> {
    let (_, strays) = directed_but(from, to, &[], &TIGHT, limit);
    strays.iter().map(|stray| stray.triangle).collect()
}

#[test]
fn of_nothing_all_is_within_and_nothing_is_near_nothing() {
    let (none, some) = (Mesh::default(), sphere(4, 4));
    assert_eq!(bound(&none, &some), Bound { upper: 0.0, lower: 0.0 });
    assert_eq!(bound(&none, &none), Bound { upper: 0.0, lower: 0.0 });
    assert_eq!(bound(&some, &none).upper, f64::INFINITY);
    assert_eq!(far(&some, &Surface::new(&none), 9.0).len(), some.triangles.len());
    assert!(Surface::new(&none).distance(DVec3::ONE, 0.0, &mut 7).is_infinite());
    assert_eq!(sampled(&none, &Surface::new(&some), 3), 0.0);
}

#[test]
fn points_and_needles_have_distances() {
    let point = mesh_of(&[[3.0, 4.0, 0.0]; 3], &[[0, 1, 2]]);
    assert_eq!(Surface::new(&point).distance(DVec3::ZERO, 0.0, &mut 0), 5.0);
    let needle = mesh_of(&[[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], &[[0, 1, 2]]);
    let distance = |p| Surface::new(&needle).distance(p, 0.0, &mut 0);
    assert_eq!(distance(DVec3::new(1.5, 2.0, 0.0)), 2.0);
    assert_eq!(distance(DVec3::new(-3.0, 4.0, 0.0)), 5.0);
    for (from, to, true_bound) in [(&point, &needle, 17f64.sqrt()), (&needle, &point, 5.0)] {
        let found = bound(from, to);
        assert!(found.lower <= true_bound && true_bound <= found.upper, "{found:?}");
        assert!(found.upper <= true_bound * 1.05 + 1e-12, "{found:?}");
    }
    let same = bound(&point, &point);
    assert!(same.upper < 1e-14 && same.lower == 0.0, "{same:?}");
}

#[test]
fn the_tree_finds_what_a_search_of_all_triangles_finds() {
    let mut rng = StdRng::seed_from_u64(5);
    for (scale, by) in [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1.0, 1e7)] {
        let mesh = moved(&heap(&mut rng, 200), scale, by);
        let surface = Surface::new(&mesh);
        let mut hint = 0;
        for _ in 0..300 {
            let p = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-20f64..20.0)));
            let p = p.powf(3.0) * (scale / 400.0) + by;
            let nearest = brute(p, &mesh);
            let found = surface.distance(p, 0.0, &mut hint);
            let close = 1e-9 * scale + 1e-15 * by;
            assert!((found - nearest).abs() <= close, "{found} {nearest} {scale}");
            let early = surface.distance(p, nearest + 0.3 * scale, &mut hint);
            assert!(early >= nearest - close && early <= nearest + 0.3 * scale);
        }
    }
}

#[test]
fn bounds_hold_and_are_tight_on_loose_triangles_at_all_scales() {
    let mut rng = StdRng::seed_from_u64(6);
    for (scale, by) in [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1.0, 1e7), (1e-3, 1e7)] {
        for _ in 0..20 {
            let from = moved(&heap(&mut rng, 12), scale, by);
            let to = moved(&heap(&mut rng, 40), scale, by);
            let surface = Surface::new(&to);
            let found = directed(&from, &surface, &TIGHT);
            let seen = sampled(&from, &surface, 40);
            let close = 1e-12 * scale + 1e-15 * by;
            assert!(found.upper >= seen - close, "{found:?} {seen}");
            assert!(found.upper <= found.lower * 1.05 + close, "{found:?} {seen}");
            // Between samples, 1/40 of an edge apart, no more can be hidden than their distance.
            assert!(found.lower <= seen + 0.05 * scale, "{found:?} {seen}");
        }
    }
}

#[test]
fn without_a_budget_the_bound_still_holds() {
    let (fine, coarse) = (sphere(40, 60), sphere(9, 14));
    let (to_fine, to_coarse) = (Surface::new(&fine), Surface::new(&coarse));
    for (from, to) in [(&fine, &to_coarse), (&coarse, &to_fine)] {
        let seen = sampled(from, to, 30);
        let mut before = f64::INFINITY;
        for budget in [0, 10, 1000, 100_000] {
            let found = directed(from, to, &Goal { budget, ..TIGHT });
            assert!(found.lower <= found.upper && seen <= found.upper, "{found:?} {seen}");
            before = before.min(found.upper);
        }
        assert!(before <= seen * 1.06, "{before} {seen}");
    }
}

#[test]
fn what_is_enough_is_not_bounded_any_tighter_but_still_bounded() {
    let (fine, coarse) = (sphere(40, 60), Surface::new(&sphere(9, 14)));
    let seen = sampled(&fine, &coarse, 8);
    let found = directed(&fine, &coarse, &Goal { enough: 0.3, slack: 0.0, budget: 0 });
    assert!(found.upper >= seen && found.upper <= 0.3 + 1e-12, "{found:?} {seen}");
    assert!(found.lower <= seen + 1e-12, "{found:?} {seen}");
}

#[test]
fn a_missing_part_counts_with_its_distance() {
    let plate = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 7.0]];
    let whole = mesh_of(&plate, &[[0, 1, 2], [0, 1, 3]]);
    let part = mesh_of(&plate[..3], &[[0, 1, 2]]);
    let (out, back) = (bound(&whole, &part), bound(&part, &whole));
    assert!(out.upper >= 7.0 && out.lower <= 7.0 && out.upper - out.lower < 1e-10, "{out:?}");
    assert!(back.upper < 1e-11, "{back:?}");
    assert_eq!(far(&whole, &Surface::new(&part), 6.9), [1]);
    assert!(far(&whole, &Surface::new(&part), 7.1).is_empty());
}

#[test]
fn between_two_parts_the_middle_is_farthest() {
    let square = |x: f64| [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x + 1.0, 1.0, 0.0], [x, 1.0, 0.0]];
    let two = [[0, 1, 2], [0, 2, 3]];
    let bridge = mesh_of(&[[0.0; 3], [4.0, 0.0, 0.0], [4.0, 1.0, 0.0], [0.0, 1.0, 0.0]], &two);
    let ends = mesh_of(
        &[square(0.0), square(3.0)].concat(),
        &[[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
    );
    // No corner is off at all: only what lies between tells.
    let found = bound(&bridge, &ends);
    assert!(found.lower <= 1.0 && found.upper >= 1.0 && found.upper < 1.06, "{found:?}");
    assert!(found.lower > 0.94, "{found:?}");
    assert_eq!(far(&bridge, &Surface::new(&ends), 0.9), [0, 1]);
    assert!(far(&bridge, &Surface::new(&ends), 1.1).is_empty());
}

#[test]
fn what_is_not_told_to_be_far_is_bounded() {
    let mut rng = StdRng::seed_from_u64(7);
    let (from, to) = (heap(&mut rng, 60), Surface::new(&heap(&mut rng, 40)));
    for limit in [-1.0, 0.0, 0.05, 0.2, 0.5, 3.0] {
        let (rest, strays) = directed_but(&from, &to, &[], &TIGHT, limit);
        for stray in &strays {
            assert!(to.distance(stray.at, 0.0, &mut 0) > limit, "{limit} {stray:?}");
        }
        let found: Vec<u32> = strays.iter().map(|stray| stray.triangle).collect();
        for (t, id) in from.triangles.iter().zip(0..) {
            let alone = Mesh { triangles: vec![*t], ..from.clone() };
            let proven = directed(&alone, &to, &Goal { slack: 0.01, ..TIGHT });
            if proven.lower > limit {
                assert!(
                    found.contains(&id) || rest.upper >= proven.lower,
                    "{limit} {id} {proven:?}"
                );
            }
            if proven.upper * 1.2 < limit {
                assert!(!found.contains(&id), "{limit} {id} {proven:?}");
            }
        }
    }
}

#[test]
fn sheets_nearer_to_each_other_than_boxes_can_tell_are_told_apart() {
    let mut rng = StdRng::seed_from_u64(8);
    for scale in [1e-6, 1.0, 1e6] {
        let mut positions = Vec::new();
        for _ in 0..200 {
            // On both sides of the middle, where coordinates have digits to lose.
            let z: f64 = rng.random_range(0.7..0.7 + 1e-7)
                * if positions.len() % 2 == 0 { 1.0 } else { -1.0 };
            positions.extend(
                [[-1.0, -1.0, z], [3.0, -1.0, z], [-1.0, 3.0, z]].map(|p| p.map(|c| c * scale)),
            );
        }
        let triangles: Vec<[u32; 3]> = (0..200).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let mesh = mesh_of(&positions, &triangles);
        let surface = Surface::new(&mesh);
        for _ in 0..200 {
            let mut p = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-0.5..0.5)));
            p.z = 0.7 + rng.random_range(-2e-6..2e-6);
            let p = p * scale;
            let (found, nearest) = (surface.distance(p, 0.0, &mut 0), brute(p, &mesh));
            assert!((found - nearest).abs() <= 1e-13 * scale, "{found} {nearest} {scale}");
        }
    }
}

/// A bumpy ball, and what is left of it when some vertices have moved into others.
fn collapsed(rng: &mut StdRng, share: f64) -> (Mesh, Mesh) {
    let mut ball = sphere(12, 18);
    for vertex in &mut ball.vertices {
        vertex.position *= 1.0 + 0.05 * (vertex.position.x * 9.0).sin();
    }
    let mut into: Vec<u32> = (0..ball.vertices.len() as u32).collect();
    for triangle in &ball.triangles {
        if rng.random_bool(share) {
            into[triangle[0] as usize] = into[triangle[1] as usize];
        }
    }
    let mut coarse = ball.clone();
    coarse.triangles = ball.triangles.iter().map(|t| t.map(|v| into[v as usize])).collect();
    coarse.triangles.retain(|[a, b, c]| a != b && b != c && c != a);
    (ball, coarse)
}

#[test]
fn places_change_no_bound_be_they_right_or_wrong() {
    let mut rng = StdRng::seed_from_u64(9);
    for (scale, by) in [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1.0, 1e7)] {
        for share in [0.0, 0.05, 0.3] {
            let (fine, coarse) = collapsed(&mut rng, share);
            let (fine, coarse) = (moved(&fine, scale, by), moved(&coarse, scale, by));
            let count = fine.vertices.len() as u32;
            let right: Vec<u32> = (0..count).collect();
            let aside: Vec<u32> = (0..count).map(|v| (v + 1) % count).collect();
            let any: Vec<u32> = (0..count).map(|_| rng.random_range(0..2 * count)).collect();
            for (from, to) in [(&fine, &coarse), (&coarse, &fine)] {
                let plain = Surface::new(to);
                let seen = sampled(from, &plain, 12);
                for (own, others) in
                    [(&right, &right), (&aside, &right), (&right, &any), (&any, &any)]
                {
                    let surface = Surface::with_places(to, others);
                    for goal in [TIGHT, Goal { enough: 0.02 * scale, slack: 0.5, budget: 3000 }] {
                        let (found, _) = directed_but(from, &surface, own, &goal, f64::INFINITY);
                        let close = 1e-12 * scale + 1e-15 * by;
                        assert!(found.upper >= seen - close, "{found:?} {seen}");
                        let most = goal.enough.max(found.lower * (1.0 + goal.slack)) + close;
                        assert!(found.upper <= most * (1.0 + 1e-9), "{found:?} {seen} {goal:?}");
                        assert!(found.lower <= seen + 0.1 * scale, "{found:?} {seen}");
                    }
                }
            }
        }
    }
}

#[test]
fn an_unchanged_surface_is_nowhere_off() {
    let ball = moved(&sphere(12, 18), 1.0, 1e7);
    let places: Vec<u32> = (0..ball.vertices.len() as u32).collect();
    let surface = Surface::with_places(&ball, &places);
    let (found, _) = directed_but(&ball, &surface, &places, &TIGHT, f64::INFINITY);
    assert!(found.upper < 1e-11 && found.lower == 0.0, "{found:?}");
}

#[test]
fn slim_triangles_are_measured_exactly() {
    let mut rng = StdRng::seed_from_u64(8);
    for slim in [1e-2, 1e-4, 1e-6, 1e-9] {
        for _ in 0..200 {
            // In the plane of x and y, so that the truth is known: above the triangle it is the height.
            let length = 1e5;
            let top = [length * rng.random_range(0.0..1.0), length * slim, 0.0];
            let mut corners = [[0.0; 3], [length, 0.0, 0.0], top];
            corners.rotate_left(rng.random_range(0..3));
            let surface = Surface::new(&mesh_of(&corners, &[[0, 1, 2]]));
            let (v, w) = (rng.random_range(0.05..0.45), rng.random_range(0.05..0.45));
            let [a, b, c] = corners.map(DVec3::from_array);
            let above = [0.0, 1e-3, 10.0, 1e4][rng.random_range(0..4)];
            let p = a + (b - a) * v + (c - a) * w + DVec3::Z * above;
            let found = surface.exact_distance(p, 0.0, &mut 0);
            assert!((found - above).abs() < 1e-9, "{slim} {found} {above}");
            let beside = surface.exact_distance(DVec3::new(0.3 * length, -above, 0.0), 0.0, &mut 0);
            assert!((beside - above).abs() < 1e-9, "{slim} {beside} {above}");
        }
    }
    let heap = heap(&mut rng, 200);
    let surface = Surface::new(&heap);
    for _ in 0..300 {
        let p = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-2f64..2.0)));
        let found = surface.exact_distance(p, 0.0, &mut 0);
        assert!((found - brute(p, &heap)).abs() < 1e-12, "{found}");
    }
}
