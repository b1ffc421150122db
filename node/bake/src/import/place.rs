//! Where a mesh stands whose file writes world positions in more digits than `f32` holds.

use glam::{DAffine3, DVec3};

use crate::source::SourceObject;

/// The origin that a mesh of these finite points is stored relative to, so that `f32` leaves little of them
/// to be kept beside it: the middle of its box, or zero where the box is not small beside its distance from there.
pub(super) fn origin(points: impl Iterator<Item = DVec3>) -> DVec3 {
    let nothing = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (low, high) = points.fold(nothing, |(low, high), p| (low.min(p), high.max(p)));
    let far = low.abs().max(high.abs()).max_element();
    let size = (high - low).max_element();
    // Also false where there are no points, or numbers too large to subtract.
    if far > size && size.is_finite() { low + (high - low) / 2.0 } else { DVec3::ZERO }
}

/// A point as a mesh with this origin stores it.
pub(super) fn relative(point: DVec3, origin: DVec3) -> [f64; 3] {
    (point - origin).to_array()
}

/// The object that shows such a mesh.
pub(super) fn placed(name: String, mesh: usize, origin: DVec3) -> SourceObject {
    SourceObject { name, mesh, world_from_mesh: DAffine3::from_translation(origin) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_points_and_points_round_the_origin_stay() {
        assert_eq!(origin(std::iter::empty()), DVec3::ZERO);
        assert_eq!(origin([DVec3::ZERO].into_iter()), DVec3::ZERO);
        assert_eq!(origin([DVec3::NEG_ONE, DVec3::ONE].into_iter()), DVec3::ZERO);
        assert_eq!(origin([DVec3::MIN, DVec3::MAX].into_iter()), DVec3::ZERO);
    }

    #[test]
    fn far_from_the_origin_little_is_lost() {
        let points = [DVec3::new(1e7, 5e6, 0.0), DVec3::new(1e7 + 0.001, 5e6 + 3.0, 1.0)];
        let middle = origin(points.into_iter());
        for point in points {
            let near = DVec3::from(relative(point, middle));
            let back = near.as_vec3().as_dvec3() + middle;
            assert!((back - point).length() < 1e-6, "{back} {point}");
        }
    }
}
