//! Which pixels of a cube face a triangle covers, and how near it is there.
//!
//! Corners are homogeneous and relative to the viewpoint, `(p * w, w)` with `w >= 0`; `w = 0` is endlessly
//! far. A ray `r` of unit view depth through a pixel's centre meets the triangle where `r` is a combination of
//! the corners' first three coordinates with weights of one sign (Olano and Greer, Triangle Scan
//! Conversion using 2D Homogeneous Coordinates, 1997), and its disparity there is the same combination of their `w`.
//! So nothing is clipped, nothing behind the eye is divided by, and there is no near plane. The
//! weight against a side depends on that side's two ends alone: triangles that share it leave no pixel between
//! them, and both cover one on it. Both faces of a triangle count.

use crate::sample::FACES;
use glam::{DVec3, DVec4};

/// Bit `4 * face + k`: the point lies beyond the `k`-th side of the face's pyramid. Three corners with
/// a bit in common are not seen in that face.
pub(crate) fn outside(point: DVec4) -> u32 {
    let mut bits = 0;
    for face in 0..6 {
        let at = on_face(face, point.truncate());
        let beyond = [at.x > at.z, at.x < -at.z, at.y > at.z, at.y < -at.z];
        bits |= (0..4).fold(0, |bits, k| bits | u32::from(beyond[k]) << k) << (4 * face);
    }
    bits
}

/// Right, down and forward.
fn on_face(face: usize, at: DVec3) -> DVec3 {
    let along = |axis: [f64; 3]| DVec3::from_array(axis).dot(at);
    DVec3::new(along(FACES[face].right), -along(FACES[face].up), along(FACES[face].forward))
}

/// Calls `visit` with the index and the disparity of each of `side * side` pixels whose centre the triangle
/// covers. One seen edge-on covers none.
pub(crate) fn cover(
    face: usize,
    side: u32,
    corners: [DVec4; 3],
    mut visit: impl FnMut(usize, f64),
) {
    let [a, b, c] = corners.map(|corner| on_face(face, corner.truncate()));
    let half = 0.5 * f64::from(side);
    // Pixels with their centre between the corners; all, if a corner is not before the eye.
    let span = |axis: usize| {
        if a.z <= 0.0 || b.z <= 0.0 || c.z <= 0.0 {
            return 0..side;
        }
        let [p, q, r] = [a, b, c].map(|at| half * (at[axis] / at.z + 1.0) - 0.5);
        let (low, high) = (p.min(q).min(r) - 1e-9, p.max(q).max(r) + 1e-9);
        low.ceil().max(0.0) as u32..(high.floor() + 1.0).clamp(0.0, f64::from(side)) as u32
    };
    let (columns, rows) = (span(0), span(1));
    if columns.is_empty() || rows.is_empty() {
        return;
    }
    let sides = [b.cross(c), c.cross(a), a.cross(b)];
    let volume = a.dot(sides[0]);
    // Less than this is rounding: the solid angle of a triangle that no pixel could show.
    if volume.abs() <= 1e-14 * a.length() * b.length() * c.length() {
        return;
    }
    let w = DVec3::new(corners[0].w, corners[1].w, corners[2].w);
    let ray = |k: u32| (f64::from(k) + 0.5) / half - 1.0;
    for y in rows {
        for x in columns.clone() {
            let ray = DVec3::new(ray(x), ray(y), 1.0);
            let weights = DVec3::from_array(sides.map(|side| side.dot(ray) * volume.signum()));
            if weights.min_element() >= 0.0 {
                visit((y * side + x) as usize, weights.dot(w) / volume.abs());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    fn covered(side: u32, corners: [DVec4; 3]) -> Vec<(usize, usize, f64)> {
        let mut found = Vec::new();
        for face in 0..6 {
            cover(face, side, corners, |at, disparity| found.push((face, at, disparity)));
        }
        found
    }

    #[test]
    fn a_tetrahedron_around_the_eye_covers_every_pixel() {
        let mut random = StdRng::seed_from_u64(3);
        for k in 0..50 {
            let scale = 10f64.powi(k % 10 - 3);
            let far = k % 3 == 0;
            let mut corner = || {
                let at = DVec3::from_array(std::array::from_fn(|_| random.random_range(0.1..1.0)));
                if far { at.extend(0.0) } else { (at * scale).extend(1.0) }
            };
            let flip = |p: DVec4, x: f64, y: f64, z: f64| p * DVec4::new(x, y, z, 1.0);
            let p = [
                flip(corner(), 1.0, 1.0, 1.0),
                flip(corner(), -1.0, -1.0, 1.0),
                flip(corner(), -1.0, 1.0, -1.0),
                flip(corner(), 1.0, -1.0, -1.0),
            ];
            let mut count = vec![0; 6 * 81];
            for [a, b, c] in [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]] {
                for (face, at, disparity) in covered(9, [p[a], p[b], p[c]]) {
                    count[face * 81 + at] += 1;
                    assert!(if far { disparity == 0.0 } else { disparity > 0.0 }, "{disparity}");
                }
            }
            // Four corners of alternate octants hold the middle, unless they are very unequal.
            let holds = count.iter().all(|&count| count == 1);
            let outside = count.iter().all(|&count| count != 1);
            assert!(holds || outside, "{k} {count:?}");
        }
    }

    #[test]
    fn what_is_partly_behind_is_seen_where_it_is() {
        // The plane y = 2, as one triangle that reaches far behind the eye of face +x.
        let corners = [[-90.0, 2.0, -90.0], [90.0, 2.0, -90.0], [0.0, 2.0, 200.0]];
        let found = covered(8, corners.map(|at| DVec3::from_array(at).extend(1.0)));
        let ahead = found.iter().filter(|(face, ..)| *face == 2);
        assert_eq!(ahead.clone().count(), 64);
        assert!(ahead.into_iter().all(|(.., disparity)| (disparity - 0.5).abs() < 1e-12));
        assert!(found.iter().all(|(face, ..)| *face != 3));
        let of_x = found.iter().filter(|(face, ..)| *face == 0).count();
        assert_eq!(of_x, 32, "half of face +x looks towards +y");
    }

    #[test]
    fn corners_past_one_side_are_left_out() {
        for (at, face) in [([3.0, 0.1, 0.2], 0), ([-1.0, 0.0, 0.9], 1), ([0.0, -1e-9, 0.0], 3)] {
            let bits = outside(DVec3::from_array(at).extend(1.0));
            let free: Vec<usize> = (0..6).filter(|face| bits >> (4 * face) & 15 == 0).collect();
            assert_eq!(free, [face]);
        }
    }

    #[test]
    fn degenerate_triangles_cover_nothing() {
        let p = |x: f64, y: f64, z: f64| DVec4::new(x, y, z, 1.0);
        for corners in [
            [p(1.0, 2.0, 3.0); 3],
            [p(0.0, 0.0, 0.0), p(1.0, 0.0, 0.1), p(0.0, 1.0, 0.2)],
            [p(1.0, 0.0, 0.0), p(2.0, 0.0, 0.0), p(-1.0, 0.0, 0.0)],
            [p(1.0, 0.0, 0.0), p(1.0, 1.0, 0.0), p(-7.0, -3.0, 0.0)],
        ] {
            assert_eq!(covered(5, corners), []);
        }
    }
}
