//! A view frustum in f64, relative to the eye: five planes, no far plane.
//!
//! Tests are slightly conservative: a box that f64 rounding could move across a plane is kept.

use crate::bounds::Aabb;
use glam::DVec3;

/// Relative slack of the plane tests. Far above f64 rounding (the camera's vectors are f32, so their
/// own deviation from unit length, 1e-7, counts too) and far below a pixel.
const SLACK: f64 = 1e-6;

/// Where a box lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Containment {
    /// Wholly outside one plane.
    Outside,
    /// Undecided, or partly inside.
    Crossing,
    /// Wholly inside all planes.
    Inside,
}

/// The region a camera sees; all coordinates are relative to the eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frustum {
    /// Inward normals and offsets: inside is `normal . p >= offset`.
    planes: [(DVec3, f64); 5],
}

/// An orthonormal view basis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Basis {
    /// To the picture's right.
    pub right: DVec3,
    /// Up in the picture.
    pub up: DVec3,
    /// Direction of view.
    pub forward: DVec3,
}

impl Frustum {
    /// The frustum of a view basis, the tangents of half its angles, and the near plane's distance.
    pub fn new(basis: Basis, tan_half: [f64; 2], near: f64) -> Self {
        let Basis { right, up, forward } = basis;
        let [tx, ty] = tan_half;
        Self {
            planes: [
                (forward, near),
                (forward * tx + right, 0.0),
                (forward * tx - right, 0.0),
                (forward * ty + up, 0.0),
                (forward * ty - up, 0.0),
            ],
        }
    }

    /// Inward normals of the near plane and of the four sides, which meet in the eye.
    pub fn normals(&self) -> [DVec3; 5] {
        self.planes.map(|(normal, _)| normal)
    }

    /// Where `b`, relative to the eye, lies. An empty box is outside.
    pub fn contains(&self, b: &Aabb) -> Containment {
        if b.is_empty() {
            return Containment::Outside;
        }
        let mut answer = Containment::Inside;
        for &(normal, offset) in &self.planes {
            let (at_min, at_max) = (normal * b.min, normal * b.max);
            let least = at_min.min(at_max).element_sum();
            let greatest = at_min.max(at_max).element_sum();
            let slack = SLACK * (at_min.abs().max(at_max.abs()).element_sum() + offset.abs());
            if greatest < offset - slack {
                return Containment::Outside;
            }
            if least < offset + slack {
                answer = Containment::Crossing;
            }
        }
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3Swizzles as _;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    fn ahead() -> Frustum {
        let basis = Basis { right: DVec3::X, up: DVec3::Y, forward: DVec3::NEG_Z };
        Frustum::new(basis, [2.0, 1.0], 0.5)
    }

    fn cube(center: DVec3, half: f64) -> Aabb {
        Aabb { min: center - half, max: center + half }
    }

    #[test]
    fn degenerate_boxes_have_an_answer() {
        let f = ahead();
        assert_eq!(f.contains(&Aabb::EMPTY), Containment::Outside);
        assert_eq!(f.contains(&cube(DVec3::NEG_Z, 0.0)), Containment::Inside);
        assert_eq!(f.contains(&cube(DVec3::Z, 0.0)), Containment::Outside);
        assert_eq!(f.contains(&cube(DVec3::ZERO, f64::MAX / 8.0)), Containment::Crossing);
    }

    #[test]
    fn each_plane_cuts() {
        let f = ahead();
        for (center, expected) in [
            (DVec3::new(0.0, 0.0, -10.0), Containment::Inside),
            (DVec3::new(0.0, 0.0, -0.3), Containment::Outside),
            (DVec3::new(0.0, 0.0, -0.5), Containment::Crossing),
            (DVec3::new(22.0, 0.0, -10.0), Containment::Outside),
            (DVec3::new(-22.0, 0.0, -10.0), Containment::Outside),
            (DVec3::new(20.0, 0.0, -10.0), Containment::Crossing),
            (DVec3::new(0.0, 11.0, -10.0), Containment::Outside),
            (DVec3::new(0.0, -11.0, -10.0), Containment::Outside),
            (DVec3::new(0.0, -10.0, -10.0), Containment::Crossing),
        ] {
            assert_eq!(f.contains(&cube(center, 0.1)), expected, "{center}");
        }
    }

    #[test]
    fn never_loses_a_point_that_is_seen() {
        let f = ahead();
        let mut rng = StdRng::seed_from_u64(7);
        for _ in 0..20_000 {
            let depth = rng.random_range(0.5..100.0);
            let seen = DVec3::new(
                rng.random_range(-2.0..=2.0) * depth,
                rng.random_range(-1.0..=1.0) * depth,
                -depth,
            );
            let reach = DVec3::new(rng.random(), rng.random(), rng.random()) * 5.0;
            let b = Aabb { min: seen - reach, max: seen + reach.zxy() };
            assert_ne!(f.contains(&b), Containment::Outside, "{seen} {b:?}");
            if f.contains(&b) == Containment::Inside {
                let corner = DVec3::new(b.max.x, b.min.y, b.max.z);
                assert_ne!(f.contains(&cube(corner, 0.0)), Containment::Outside);
            }
        }
    }
}
