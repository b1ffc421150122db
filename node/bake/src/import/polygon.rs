//! Polygons to triangles.

use glam::{DVec2, DVec3};

/// Corners of the largest polygon with a dent that is cut ear by ear: the time grows with the square.
/// Larger ones are fanned from their first corner.
const MOST_CUT: usize = 1024;

/// Divides a polygon into `corners.len() - 2` triangles that wind as it does, as places among its
/// corners. Fewer than three corners make none.
///
/// A convex polygon is fanned from its first corner; one with dents is cut ear by ear in the plane
/// that its area vector is normal to (Meisters 1975, *Polygons have ears*).
pub(super) fn triangulate(corners: &[DVec3]) -> Vec<[usize; 3]> {
    let count = corners.len();
    if count < 3 {
        return Vec::new();
    }
    let fan = || (1..count - 1).map(|i| [0, i, i + 1]).collect();
    if count == 3 || count > MOST_CUT {
        return fan();
    }
    let flat = project(corners);
    let turn = |a: usize, b: usize, c: usize| (flat[b] - flat[a]).perp_dot(flat[c] - flat[a]);
    let turns = |i: usize| turn(i, (i + 1) % count, (i + 2) % count);
    // Without dents, yet with every corner beside the first: else it winds round more than once.
    let convex = (0..count).all(|i| turns(i) >= 0.0);
    if convex && (1..count - 1).all(|i| turn(0, i, i + 1) >= 0.0) {
        return fan();
    }
    cut_ears(count, turn)
}

fn cut_ears(count: usize, turn: impl Fn(usize, usize, usize) -> f64) -> Vec<[usize; 3]> {
    let mut left: Vec<usize> = (0..count).collect();
    let mut triangles = Vec::with_capacity(count - 2);
    while left.len() > 3 {
        let around = |i: usize| {
            let n = left.len();
            [left[(i + n - 1) % n], left[i], left[(i + 1) % n]]
        };
        let is_ear = |&i: &usize| {
            let [a, b, c] = around(i);
            let inside = |&p: &usize| {
                p != a
                    && p != b
                    && p != c
                    && turn(a, b, p) >= 0.0
                    && turn(b, c, p) >= 0.0
                    && turn(c, a, p) >= 0.0
            };
            turn(a, b, c) > 0.0 && !left.iter().any(inside)
        };
        // A polygon that crosses itself may have no ear: then any corner does.
        let ear = (0..left.len()).find(is_ear).unwrap_or(1);
        triangles.push(around(ear));
        left.remove(ear);
    }
    triangles.push([left[0], left[1], left[2]]);
    triangles
}

/// The corners in a plane in which the polygon's area is positive, or largest.
fn project(corners: &[DVec3]) -> Vec<DVec2> {
    let first = corners[0];
    let area: DVec3 = corners.windows(2).map(|pair| (pair[0] - first).cross(pair[1] - first)).sum();
    let size = area.abs();
    let flat = |p: &DVec3| {
        let p = *p - first;
        // The axis that the area vector is longest along is left out.
        let (u, v, along) = if size.x >= size.y && size.x >= size.z {
            (p.y, p.z, area.x)
        } else if size.y >= size.z {
            (p.z, p.x, area.y)
        } else {
            (p.x, p.y, area.z)
        };
        if along < 0.0 { DVec2::new(v, u) } else { DVec2::new(u, v) }
    };
    corners.iter().map(flat).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(corners: &[DVec3], triangles: &[[usize; 3]]) -> (DVec3, f64) {
        triangles.iter().fold((DVec3::ZERO, 0.0), |(sum, size), t| {
            let [a, b, c] = t.map(|i| corners[i]);
            let part = 0.5 * (b - a).cross(c - a);
            (sum + part, size + part.length())
        })
    }

    #[test]
    fn degenerate_polygons_make_as_many_triangles_as_they_claim() {
        for count in 0..3 {
            assert!(triangulate(&vec![DVec3::ZERO; count]).is_empty());
        }
        assert_eq!(triangulate(&[DVec3::ZERO; 6]).len(), 4);
        assert_eq!(triangulate(&[DVec3::NAN; 6]).len(), 4);
        let line: Vec<DVec3> = (0..5).map(|i| DVec3::X * f64::from(i)).collect();
        assert_eq!(triangulate(&line).len(), 3);
    }

    #[test]
    fn convex_polygons_are_fanned() {
        let square = [DVec3::ZERO, DVec3::X, DVec3::ONE.with_z(0.0), DVec3::Y];
        assert_eq!(triangulate(&square), [[0, 1, 2], [0, 2, 3]]);
        let wide: Vec<DVec3> = (0..5000)
            .map(|i| f64::from(i) * std::f64::consts::TAU / 5000.0)
            .map(|a| DVec3::new(a.cos(), a.sin(), 0.0))
            .collect();
        assert_eq!(triangulate(&wide).len(), 4998);
    }

    #[test]
    fn dents_stay_dents_in_every_direction() {
        // An L, whose fan from its first corner leaves the shape.
        let l = [[2.0, 2.0], [1.0, 2.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0], [2.0, 0.0]];
        let planes: [fn([f64; 2]) -> DVec3; 6] = [
            |[u, v]| DVec3::new(u, v, 5.0),
            |[u, v]| DVec3::new(v, u, 5.0),
            |[u, v]| DVec3::new(5.0, u, v),
            |[u, v]| DVec3::new(5.0, v, u),
            |[u, v]| DVec3::new(u, 5.0, v),
            |[u, v]| DVec3::new(v, 5.0, u),
        ];
        for place in planes {
            let corners = l.map(place);
            let triangles = triangulate(&corners);
            let (vector, size) = area(&corners, &triangles);
            assert_eq!(triangles.len(), 4);
            assert!((size - 3.0).abs() < 1e-12 && (vector.length() - 3.0).abs() < 1e-12, "{size}");
            let whole: Vec<[usize; 3]> = (1..5).map(|i| [0, i, i + 1]).collect();
            assert!((area(&corners, &whole).0 - vector).length() < 1e-12, "the winding stays");
        }
    }

    #[test]
    fn a_polygon_that_crosses_itself_ends() {
        let star: Vec<DVec3> = (0..5)
            .map(|i| f64::from(i) * 2.0 * std::f64::consts::TAU / 5.0)
            .map(|a| DVec3::new(a.cos(), a.sin(), 0.0))
            .collect();
        assert_eq!(triangulate(&star).len(), 3);
    }
}
