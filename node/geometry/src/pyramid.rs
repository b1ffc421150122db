//! The part of a box that a pyramid of view holds.

use crate::bounds::Aabb;
use crate::frustum::Basis;
use glam::DVec3;

/// Four half spaces that meet in an apex and hold all that lies before it within two angles. It has no
/// near plane and no far end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pyramid {
    apex: DVec3,
    /// Inward normals of the four sides, of any length: inside is `normal . p >= normal . apex`.
    normals: [DVec3; 4],
}

/// Most corners of a rectangle that four planes have cut.
const MOST_CORNERS: usize = 8;

impl Pyramid {
    /// The pyramid that looks along `basis.forward` from the origin, `tan_half` being the tangents of
    /// half its horizontal and vertical angle, with every side moved outwards by `margin` at least:
    /// its apex lies so far behind the origin.
    pub fn new(basis: Basis, tan_half: [f64; 2], margin: f64) -> Self {
        let Basis { right, up, forward } = basis;
        let [tx, ty] = tan_half;

        // The normal `forward t + right` is sqrt(1 + t^2) long: a side moves outwards by t / sqrt(1 + t^2) of
        // what the apex moves back.
        let back = |t: f64| margin * (1.0 + t * t).sqrt() / t;

        Self {
            apex: forward * -back(tx).max(back(ty)),
            normals: [
                forward * tx + right,
                forward * tx - right,
                forward * ty + up,
                forward * ty - up,
            ],
        }
    }

    /// The box around all that `b` and the pyramid have in common; empty where that is nothing. `None`
    /// where `b` holds the apex.
    ///
    /// All corners of what they have in common, but for the apex, lie on faces of the box. So these
    /// are cut by the four planes (Sutherland and Hodgman 1974). Rounding moves a corner by some
    /// `2^-50` of the coordinates, or along an edge that lies as near as that to one of the planes.
    pub fn bounds_within(&self, b: &Aabb) -> Option<Aabb> {
        if b.contains(&Aabb::of([self.apex])) {
            return None;
        }

        // Most boxes lie wholly inside.
        let least = |n: DVec3| (n * b.min).min(n * b.max).element_sum();
        if self.planes().all(|(normal, offset)| least(normal) >= offset) {
            return Some(*b);
        }

        let sides = [b.min, b.max];
        let faces = (0..3).flat_map(|axis| sides.map(|side| face(sides, axis, side[axis])));
        Some(faces.flat_map(|face| self.cut(face).into_iter()).fold(Aabb::EMPTY, Aabb::with))
    }

    /// Inward normals and offsets: inside is `normal . p >= offset`.
    fn planes(&self) -> impl Iterator<Item = (DVec3, f64)> {
        self.normals.into_iter().map(|normal| (normal, normal.dot(self.apex)))
    }

    /// What the four planes leave of a face.
    fn cut(&self, face: [DVec3; 4]) -> Polygon {
        let mut polygon = Polygon::default();
        face.into_iter().for_each(|corner| polygon.push(corner));

        for (normal, offset) in self.planes() {
            let mut kept = Polygon::default();
            let corners = &polygon.corners[..polygon.count];

            for (i, &here) in corners.iter().enumerate() {
                let next = corners[(i + 1) % corners.len()];
                let (at_here, at_next) = (normal.dot(here) - offset, normal.dot(next) - offset);
                if at_here >= 0.0 {
                    kept.push(here);
                }
                if (at_here >= 0.0) != (at_next >= 0.0) {
                    kept.push(here + (next - here) * (at_here / (at_here - at_next)));
                }
            }
            polygon = kept;
        }
        polygon
    }
}

/// Corners in turn of the face of a box, `sides` its least and greatest corner, at `place` on `axis`.
fn face(sides: [DVec3; 2], axis: usize, place: f64) -> [DVec3; 4] {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(at_u, at_v)| {
        let mut corner = DVec3::splat(place);
        corner[u] = sides[at_u][u];
        corner[v] = sides[at_v][v];
        corner
    })
}

/// A convex polygon without an allocation.
#[derive(Debug, Clone, Copy, Default)]
struct Polygon {
    corners: [DVec3; MOST_CORNERS],
    count: usize,
}

impl Polygon {
    fn push(&mut self, corner: DVec3) {
        self.corners[self.count] = corner;
        self.count += 1;
    }

    fn into_iter(self) -> impl Iterator<Item = DVec3> {
        self.corners.into_iter().take(self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3Swizzles as _;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    /// Looks along +z; half angles of 45 degrees across and 26.6 down.
    fn ahead(margin: f64) -> Pyramid {
        let basis = Basis { right: DVec3::X, up: DVec3::Y, forward: DVec3::Z };
        Pyramid::new(basis, [1.0, 0.5], margin)
    }

    fn holds(pyramid: &Pyramid, p: DVec3) -> bool {
        pyramid.normals.iter().all(|normal| normal.dot(p - pyramid.apex) >= 0.0)
    }

    #[test]
    fn degenerate_boxes_have_an_answer() {
        let at = |p: DVec3| Aabb { min: p, max: p };
        let pyramid = ahead(0.0);
        assert_eq!(pyramid.bounds_within(&at(DVec3::ZERO)), None);
        assert_eq!(pyramid.bounds_within(&at(DVec3::Z)), Some(at(DVec3::Z)));
        assert!(pyramid.bounds_within(&at(DVec3::NEG_Z)).unwrap().is_empty());
        assert!(pyramid.bounds_within(&at(DVec3::new(9.0, 0.0, 1.0))).unwrap().is_empty());
        // A needle that crosses, and one that runs along a side.
        let needle = |a: DVec3, b: DVec3| Aabb { min: a.min(b), max: a.max(b) };
        let across = needle(DVec3::new(-9.0, 0.0, 4.0), DVec3::new(9.0, 0.0, 4.0));
        let seen = pyramid.bounds_within(&across).unwrap();
        assert_eq!((seen.min.x, seen.max.x, seen.extent().yz()), (-4.0, 4.0, glam::DVec2::ZERO));
    }

    #[test]
    fn a_slab_that_runs_past_the_eye_is_cut_before_it() {
        // A floor two units below, from far behind to far ahead.
        let slab = Aabb { min: DVec3::new(-30.0, -3.0, -50.0), max: DVec3::new(30.0, -2.0, 50.0) };
        let seen = ahead(0.0).bounds_within(&slab).unwrap();
        // The picture's lower edge meets its top at depth 4.
        assert!((seen.min.z - 4.0).abs() < 1e-12 && seen.max.z == 50.0, "{seen:?}");
        assert_eq!((seen.min.y, seen.max.y), (-3.0, -2.0));
        assert_eq!((seen.min.x, seen.max.x), (-30.0, 30.0));
    }

    #[test]
    fn the_margin_is_kept_on_every_side() {
        let (pyramid, wide) = (ahead(0.0), ahead(0.125));
        let mut rng = StdRng::seed_from_u64(5);
        for _ in 0..20_000 {
            let p = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-4.0..4.0)));
            let shift = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let near = p + shift.normalize_or_zero() * 0.1249;
            assert!(!holds(&pyramid, p) || holds(&wide, near), "{p}");
        }
    }

    #[test]
    fn every_common_point_lies_within_and_the_bounds_are_tight() {
        let mut rng = StdRng::seed_from_u64(11);
        let (mut common, mut cut) = (0, 0);
        for _ in 0..3000 {
            let pyramid = ahead(rng.random_range(0.0..0.3));
            let mut point =
                || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-5.0..5.0)));
            let (a, b) = (point(), point());
            let b = Aabb { min: a.min(b), max: a.max(b) };
            let Some(within) = pyramid.bounds_within(&b) else { continue };
            assert!(within.is_empty() || b.contains(&within));
            cut += usize::from(!within.is_empty() && within != b);
            let mut reached = Aabb::EMPTY;
            for _ in 0..100 {
                let share = DVec3::new(rng.random(), rng.random(), rng.random());
                let p = b.min + b.extent() * share;
                if holds(&pyramid, p) {
                    common += 1;
                    reached = reached.with(p);
                    assert!(
                        within.grown(1e-12).contains(&Aabb { min: p, max: p }),
                        "{p} {within:?}"
                    );
                }
            }
            // Every side of the bounds is reached by something that both hold.
            if !within.is_empty() {
                for axis in 0..3 {
                    for place in [within.min[axis], within.max[axis]] {
                        let mut plane = b;
                        (plane.min[axis], plane.max[axis]) = (place, place);
                        let touched = pyramid.bounds_within(&Aabb {
                            min: plane.min - DVec3::AXES[axis] * 1e-9,
                            max: plane.max + DVec3::AXES[axis] * 1e-9,
                        });
                        assert!(touched.is_none_or(|t| !t.is_empty()), "{axis} {within:?}");
                    }
                }
            }
        }
        assert!(common > 20_000 && cut > 700, "{common} {cut}");
    }
}
