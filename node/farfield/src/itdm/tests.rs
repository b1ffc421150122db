//! What is drawn of a wall with a gap before a rear wall, from a few places.

use super::*;
use crate::analytic::Scene;
use crate::cube::BakedFace;
use crate::tdm;
use glam::DVec3;
use protocol::format::projected::SUBPIXELS;

const SIDE: u32 = 48;
const TOLERANCE_PX: f64 = 0.5;
const VIEWPOINTS: Viewpoints =
    Viewpoints { min: DVec3::new(-2.0, -1.0, -0.5), max: DVec3::new(2.0, 1.0, 0.5) };

/// Samples of the gap from the corners of a rectangle and its middle.
fn samples() -> Vec<Sample> {
    let eyes = [(-1.9, -0.9), (1.9, -0.9), (-1.9, 0.9), (1.9, 0.9), (0.1, 0.0)];
    let scene = Scene::gap();
    eyes.iter().map(|&(x, y)| scene.sample(DVec3::new(x, y, 0.1), SIDE)).collect()
}

/// The surfaces of the gap.
fn walls() -> Vec<[DVec3; 2]> {
    let mut walls = Vec::new();
    for [low, high] in Scene::gap().boxes {
        for k in 0..3 {
            let flat = |at: f64| {
                let mut wall = [low, high];
                wall.iter_mut().for_each(|corner| corner[k] = at);
                wall
            };
            walls.extend([flat(low[k]), flat(high[k])]);
        }
    }
    walls
}

/// Distance from the nearest wall.
fn away(walls: &[[DVec3; 2]], point: DVec3) -> f64 {
    let distances = walls.iter().map(|&[low, high]| point.distance(point.clamp(low, high)));
    distances.fold(f64::INFINITY, f64::min)
}

/// Distance by which something of a cube may lie beside what it shows, at a disparity: two pixels across
/// (what a pixel shows stands for all of it, and the mesh may move by a half), and the mesh's tolerance in
/// depth.
fn reach(cube: &BakedCube, disparity: f64) -> f64 {
    let pixel = 2.0 / f64::from(SIDE);
    let depth_error = TOLERANCE_PX * pixel / VIEWPOINTS.reach(cube.eye);
    // A ray is at most this much longer than its view depth.
    3f64.sqrt() / disparity * (2.0 * pixel + depth_error / disparity)
}

/// Column, row in pixels and disparity of a triangle's corners.
fn corners(face: &BakedFace, triangle: [u32; 3]) -> [DVec3; 3] {
    triangle.map(|v| {
        let [u, v, disparity] = face.mesh.vertices[v as usize].map(f64::from);
        DVec3::new(u / f64::from(SUBPIXELS), v / f64::from(SUBPIXELS), disparity * face.mesh.step)
    })
}

/// Triangles of a cube, and how many of them leave the walls anywhere.
fn triangles_and_skins(sample: &Sample, cube: &BakedCube) -> (usize, usize) {
    let walls = walls();
    let (mut all, mut skins) = (0, 0);
    for (face, baked) in cube.faces.iter().enumerate() {
        let Some(baked) = baked else { continue };
        for &triangle in &baked.mesh.triangles {
            let [a, b, c] = corners(baked, triangle);
            let leaves = |at: DVec3| {
                let point = cube.eye + sample.ray(face, at.x, at.y) / at.z;
                away(&walls, point) > reach(cube, at.z)
            };
            const PARTS: u32 = 6;
            let inside = (0..=PARTS).flat_map(|i| (0..=PARTS - i).map(move |j| (i, j)));
            let shares = inside.map(|(i, j)| [i, j].map(|n| f64::from(n) / f64::from(PARTS)));
            all += 1;
            skins += usize::from(shares.map(|[s, t]| a + (b - a) * s + (c - a) * t).any(leaves));
        }
    }
    (all, skins)
}

/// Whether a cube shows a surface at `point`, or beside it by less than a pixel: a point there is redundant.
fn shows(sample: &Sample, cube: &BakedCube, point: DVec3) -> bool {
    let Some((face, place, depth)) = sample.project(point - cube.eye) else { return false };
    let Some(baked) = &cube.faces[face] else { return false };
    let shows_at = |u: f64, v: f64| {
        let beyond = |p: DVec3, q: DVec3| (q.x - p.x) * (v - p.y) - (q.y - p.y) * (u - p.x);
        baked.mesh.triangles.iter().any(|&triangle| {
            let [a, b, c] = corners(baked, triangle);
            let weights = [beyond(b, c), beyond(c, a), beyond(a, b)];
            let area: f64 = weights.iter().sum();
            // What is a hundredth of a pixel beside a triangle, the next one has.
            if area == 0.0 || weights.iter().any(|weight| weight / area < -1e-2) {
                return false;
            }
            let disparity = (weights[0] * a.z + weights[1] * b.z + weights[2] * c.z) / area;
            let shown = cube.eye + sample.ray(face, u, v) / disparity;
            shown.distance(point) <= reach(cube, disparity.min(1.0 / depth))
        })
    };
    let beside = [-0.9, 0.0, 0.9];
    beside.into_iter().any(|du| beside.into_iter().any(|dv| shows_at(place[0] + du, place[1] + dv)))
}

#[test]
fn no_skin_is_ever_drawn_and_a_height_field_has_them() {
    let samples = samples();
    let of = |eye: DVec3| samples.iter().find(|sample| sample.eye == eye).unwrap();
    for keeps_all in [false, true] {
        let encoded = encode(&samples, &VIEWPOINTS, TOLERANCE_PX, keeps_all, |_| true);
        assert_eq!(encoded.cubes.len(), samples.len());
        for cube in &encoded.cubes {
            let (all, skins) = triangles_and_skins(of(cube.eye), cube);
            assert!(all as u64 == cube.triangles() && all > 50, "{all} at {}", cube.eye);
            assert_eq!(skins, 0, "of {all} at {}", cube.eye);
        }
    }
    let sample = &samples[4];
    let whole = tdm::encode(sample, &VIEWPOINTS, TOLERANCE_PX);
    let (all, skins) = triangles_and_skins(sample, &whole);
    assert!(skins > 30, "{skins} of {all}");
}

#[test]
fn deltas_are_smaller_and_all_that_was_seen_is_still_there() {
    let samples = samples();
    let of = |eye: DVec3| samples.iter().find(|sample| sample.eye == eye).unwrap();
    let encoded = encode(&samples, &VIEWPOINTS, TOLERANCE_PX, false, |_| true);
    let whole = encode(&samples, &VIEWPOINTS, TOLERANCE_PX, true, |_| true);
    let places = |of: &Encoded| {
        of.cubes.iter().map(|cube| (cube.eye.to_array(), cube.parent)).collect::<Vec<_>>()
    };
    assert_eq!(places(&encoded), places(&whole));
    let two = encode(&samples, &VIEWPOINTS, TOLERANCE_PX, false, |cubes| cubes.len() < 2);
    assert_eq!(two.cubes, encoded.cubes[..2]);
    assert_eq!((encoded.points, whole.redundant), (whole.points, 0));
    assert!(encoded.redundant * 2 > encoded.points, "{} redundant", encoded.redundant);
    assert_eq!(encoded.cubes[0], whole.cubes[0], "the intra cube");
    for (at, (delta, all)) in encoded.cubes.iter().zip(&whole.cubes).enumerate().skip(1) {
        let parent = delta.parent.unwrap();
        assert!(parent < at);
        assert!(delta.triangles() < all.triangles(), "{at}: {}", delta.triangles());
    }
    let (mut by_itself, mut by_ancestors) = (0, 0);
    for (at, cube) in encoded.cubes.iter().enumerate() {
        let sample = of(cube.eye);
        for face in 0..6 {
            for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
                let Some(point) = sample.point(face, x, y).filter(|_| (x + 3 * y) % 5 == 0) else {
                    continue;
                };
                let path = std::iter::successors(Some(at), |&at| encoded.cubes[at].parent);
                let shown_by = path.map(|at| &encoded.cubes[at]);
                match shown_by.map(|cube| shows(of(cube.eye), cube, point)).position(|shows| shows)
                {
                    Some(0) => by_itself += 1,
                    Some(_) => by_ancestors += 1,
                    None => panic!("cube {at} and those it depends on lack {point}"),
                }
            }
        }
    }
    assert!(by_itself > 3_000 && by_ancestors > 3_000, "{by_itself} {by_ancestors}");
}
