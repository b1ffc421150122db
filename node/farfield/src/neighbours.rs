//! The grid of all pixels of a sample: which pixel lies beside which, across the borders of faces too.

use crate::sample::{FACES, Sample};
use glam::DVec3;

/// Steps right and down to the eight neighbours of a pixel, in the order of their bits.
pub const STEPS: [[i32; 2]; 8] =
    [[-1, -1], [0, -1], [1, -1], [-1, 0], [1, 0], [-1, 1], [0, 1], [1, 1]];

/// The place of a step in [`STEPS`].
pub(crate) fn step_of([right, down]: [i32; 2]) -> usize {
    let place = (3 * (down + 1) + right + 1) as usize;
    place - usize::from(place > 4)
}

/// A pixel of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pixel {
    /// Place in [`FACES`].
    pub face: usize,
    /// From the left.
    pub x: u32,
    /// From the top.
    pub y: u32,
}

impl Pixel {
    /// The pixel of an index over all faces, row by row, face by face.
    pub fn of_index(side: u32, index: usize) -> Self {
        let (across, face) = (side as usize, side as usize * side as usize);
        let (x, y) = (index % face % across, index % face / across);
        Self { face: index / face, x: x as u32, y: y as u32 }
    }

    /// Index over all faces.
    pub fn index(self, side: u32) -> usize {
        self.face * side as usize * side as usize + self.in_face(side)
    }

    /// Index in its face.
    pub(crate) fn in_face(self, side: u32) -> usize {
        self.y as usize * side as usize + self.x as usize
    }

    /// The neighbour one of [`STEPS`] away. Past a border lies the pixel of the next face that touches the
    /// same stretch of the border. Diagonally past a corner of the cube, where three faces meet, lies
    /// none: such a pixel has seven neighbours (with one pixel a face, four). Being neighbours is symmetric.
    pub fn neighbour(self, side: u32, step: usize) -> Option<Self> {
        let [right, down] = STEPS[step];
        let (n, x, y) = (
            i64::from(side),
            i64::from(self.x) + i64::from(right),
            i64::from(self.y) + i64::from(down),
        );
        let inside = |k: i64| (0..n).contains(&k);
        match (inside(x), inside(y)) {
            (true, true) => Some(Self { face: self.face, x: x as u32, y: y as u32 }),
            (false, false) => None,
            _ => Some(Self::past_border(self.face, n, [x, y])),
        }
    }

    /// In units of half a pixel, with the cube's middle at 0 and its faces at distance `n`: the neighbour's
    /// centre lies on the next face, one unit from the border.
    fn past_border(face: usize, n: i64, [x, y]: [i64; 2]) -> Self {
        let centre = |k: i64| (2 * k + 1 - n).clamp(-n, n) as f64;
        let axes = FACES[face];
        let at = DVec3::from_array(axes.forward) * (n - 1) as f64
            + DVec3::from_array(axes.right) * centre(x)
            - DVec3::from_array(axes.up) * centre(y);
        let along = |axis: [f64; 3]| at.dot(DVec3::from_array(axis)) as i64;
        let face = (0..6).find(|&face| along(FACES[face].forward) == n);
        let face = face.expect("one coordinate is n, the others are less");
        let (right, up) = (along(FACES[face].right), along(FACES[face].up));
        Self { face, x: ((n - 1 + right) / 2) as u32, y: ((n - 1 - up) / 2) as u32 }
    }

    /// The step that leads to another pixel, if that is a neighbour.
    pub fn step_to(self, side: u32, other: Self) -> Option<usize> {
        (0..8).find(|&step| self.neighbour(side, step) == Some(other))
    }

    /// Direction of the centre, of unit view depth, and the disparity there.
    pub fn ray(self, sample: &Sample) -> (DVec3, f64) {
        let ray = sample.ray(self.face, f64::from(self.x) + 0.5, f64::from(self.y) + 0.5);
        let disparity = sample.faces[self.face].disparity[sample.index(self.x, self.y)];
        (ray, f64::from(disparity))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_near_distinct_and_mutual() {
        assert!((0..8).all(|step| step_of(STEPS[step]) == step));
        for side in [1u32, 2, 3, 8] {
            let direction = |p: Pixel| {
                let axes = FACES[p.face];
                let at = |k: u32| (2.0 * f64::from(k) + 1.0) / f64::from(side) - 1.0;
                (DVec3::from_array(axes.forward) + DVec3::from_array(axes.right) * at(p.x)
                    - DVec3::from_array(axes.up) * at(p.y))
                .normalize()
            };
            for index in 0..6 * (side * side) as usize {
                let pixel = Pixel::of_index(side, index);
                assert_eq!(pixel.index(side), index);
                let mut near: Vec<Pixel> =
                    (0..8).filter_map(|k| pixel.neighbour(side, k)).collect();
                let corner = |k: u32| k == 0 || k == side - 1;
                let count = match (side, corner(pixel.x) && corner(pixel.y)) {
                    (1, _) => 4,
                    (_, true) => 7,
                    _ => 8,
                };
                assert_eq!(near.len(), count, "{side} {pixel:?}");
                for &other in &near {
                    assert!(other.step_to(side, pixel).is_some(), "{pixel:?} {other:?}");
                    let angle = direction(pixel).angle_between(direction(other));
                    assert!(angle < 3.0 / f64::from(side), "{pixel:?} {other:?} {angle}");
                }
                near.sort_unstable();
                near.dedup();
                assert_eq!(near.len(), count);
                assert!(!near.contains(&pixel));
            }
        }
    }
}
