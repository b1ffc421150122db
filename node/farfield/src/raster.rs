//! Which pixels of a cube face a triangle covers, and how near it is there.
//!
//! Corners are homogeneous and relative to the viewpoint, `(p * w, w)` with `w >= 0`; `w = 0` is endlessly
//! far. A ray `r` of unit view depth through a pixel's centre meets the triangle where `r` is a combination of
//! the corners' first three coordinates with weights of one sign (Olano and Greer, Triangle Scan
//! Conversion using 2D Homogeneous Coordinates, 1997), and its disparity there is the same combination of their `w`.
//! So nothing is clipped, nothing behind the eye is divided by, and there is no near plane. The
//! weight against a side depends on that side's two ends alone: triangles that share it leave no pixel between
//! them, and both cover one on it. Both faces of a triangle count.

use crate::sample::{FACES, FaceAxes};
use crate::wanted::Wanted;
use glam::{DVec3, DVec4};
use std::ops::Range;

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

/// Right, down and forward: which coordinate of space each is, and its sign.
const ON_FACE: [[(usize, f64); 3]; 6] = {
    let mut all = [[(0, 1.0); 3]; 6];
    let mut face = 0;
    while face < 6 {
        let FaceAxes { forward, right, up } = FACES[face];
        let down = [-up[0], -up[1], -up[2]];
        all[face] = [coordinate(right), coordinate(down), coordinate(forward)];
        face += 1;
    }
    all
};

/// Of an axis of space, or its opposite.
const fn coordinate(axis: [f64; 3]) -> (usize, f64) {
    let mut place = 0;
    while axis[place] == 0.0 {
        place += 1;
    }
    (place, axis[place])
}

/// Right, down and forward.
fn on_face(face: usize, at: DVec3) -> DVec3 {
    let at = at.to_array();
    DVec3::from_array(ON_FACE[face].map(|(place, sign)| at[place] * sign))
}

/// A rectangle of pixels of a face.
pub(crate) struct Covered {
    pub(crate) columns: Range<u32>,
    pub(crate) rows: Range<u32>,
}

/// Where a point lies in a face whose pyramid holds it.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    pub(crate) face: usize,
    /// Column and row of the first pixel whose centre lies not before the point, and of the last that lies not behind.
    first: [i32; 2],
    last: [i32; 2],
}

/// The place of a point, in faces of `side * side` pixels; none of the viewpoint itself.
pub(crate) fn place(point: DVec4, side: u32) -> Option<Place> {
    let size = point.truncate().abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let face = 2 * axis + usize::from(point[axis] < 0.0);
    let at = on_face(face, point.truncate());
    let pixels = [0, 1].map(|axis| pixels(side, at, axis));
    (at.z > 0.0).then_some(Place {
        face,
        first: pixels.map(|(first, _)| first as i32),
        last: pixels.map(|(_, last)| last as i32),
    })
}

/// The first pixel along an axis of a face whose centre lies not before a point, and the last that lies not
/// behind; to within rounding both, if one is at the point.
fn pixels(side: u32, at: DVec3, axis: usize) -> (f64, f64) {
    let place = 0.5 * f64::from(side) * (at[axis] / at.z + 1.0) - 0.5;
    ((place - 1e-9).ceil(), (place + 1e-9).floor())
}

impl Covered {
    /// The pixels with their centre between three points of a face.
    pub(crate) fn between(places: [&Place; 3], side: u32) -> Self {
        let along = |axis: usize| {
            let [a, b, c] = places.map(|place| (place.first[axis], place.last[axis]));
            let (first, last) = (a.0.min(b.0).min(c.0), a.1.max(b.1).max(c.1));
            first.max(0) as u32..(last + 1).clamp(0, side as i32) as u32
        };
        Self { columns: along(0), rows: along(1) }
    }
}

/// Pixels of a face with their centre between a triangle's corners; all, if a corner is not before the eye.
pub(crate) fn span(face: usize, side: u32, corners: [DVec4; 3]) -> Covered {
    let corners = corners.map(|corner| on_face(face, corner.truncate()));
    let along = |axis: usize| {
        if corners.iter().any(|at| at.z <= 0.0) {
            return 0..side;
        }
        let [a, b, c] = corners.map(|at| pixels(side, at, axis));
        let (first, last) = (a.0.min(b.0).min(c.0), a.1.max(b.1).max(c.1));
        first.max(0.0) as u32..(last + 1.0).clamp(0.0, f64::from(side)) as u32
    };
    Covered { columns: along(0), rows: along(1) }
}

/// Calls `visit` with the index and the disparity of each of `side * side` pixels that is wanted, lies in a
/// rectangle, and has its centre in the triangle. One seen edge-on covers none.
pub(crate) fn fill(
    face: usize,
    side: u32,
    corners: [DVec4; 3],
    within: &Covered,
    wanted: &Wanted,
    mut visit: impl FnMut(usize, f64),
) {
    let [a, b, c] = corners.map(|corner| on_face(face, corner.truncate()));
    let sides = [b.cross(c), c.cross(a), a.cross(b)];
    let volume = a.dot(sides[0]);
    // Less than this is rounding: the solid angle of a triangle that no pixel could show.
    if volume.abs() <= 1e-14 * a.length() * b.length() * c.length() {
        return;
    }
    let w = DVec3::new(corners[0].w, corners[1].w, corners[2].w);
    let half = 0.5 * f64::from(side);
    let ray = |k: u32| (f64::from(k) + 0.5) / half - 1.0;
    // Far more than rounding.
    let slack = sides.map(|side| 1e-12 * side.abs().element_sum());
    for y in within.rows.clone() {
        let columns = between(&within.columns, |x| {
            let ray = DVec3::new(ray(x), ray(y), 1.0);
            std::array::from_fn(|k| sides[k].dot(ray) * volume.signum() + slack[k])
        });
        if !wanted.any(&columns, &(y..y + 1)) {
            continue;
        }
        for x in columns.filter(|&x| wanted.has(x, y)) {
            let ray = DVec3::new(ray(x), ray(y), 1.0);
            let weights = DVec3::from_array(sides.map(|side| side.dot(ray) * volume.signum()));
            if weights.min_element() >= 0.0 {
                visit((y * side + x) as usize, weights.dot(w) / volume.abs());
            }
        }
    }
}

/// The part of a row in which none of three linear functions is less than 0, a pixel too wide on either side. What
/// is 0 but for rounding must have been raised above it.
fn between(columns: &Range<u32>, weights: impl Fn(u32) -> [f64; 3]) -> Range<u32> {
    /// So many pixels are looked at sooner than their ends are worked out.
    const FEW: usize = 3;
    if columns.len() <= FEW {
        return columns.clone();
    }
    let last = columns.end - 1;
    let along = f64::from(last - columns.start);
    let (mut from, mut to) = (0.0, along);
    for (start, end) in weights(columns.start).into_iter().zip(weights(last)) {
        let zero = start / (start - end) * along;
        match (start < 0.0, end < 0.0) {
            (true, true) => return 0..0,
            (true, false) => from = zero.max(from),
            (false, true) => to = zero.min(to),
            (false, false) => {}
        }
    }
    let first = columns.start + (from - 1.0).max(0.0) as u32;
    first..(columns.start + (to + 2.0).max(0.0) as u32).clamp(first, columns.end)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    fn covered(side: u32, corners: [DVec4; 3]) -> Vec<(usize, usize, f64)> {
        let mut found = Vec::new();
        for face in 0..6 {
            let (within, all) = (span(face, side, corners), Wanted::new(side, |_| true));
            fill(face, side, corners, &within, &all, |at, disparity| {
                found.push((face, at, disparity));
            });
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
