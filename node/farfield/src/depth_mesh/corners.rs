//! Which pixels of a cube meet at a corner of a pixel, over the borders of faces too.

use crate::neighbours::{Pixel, STEPS};

/// The pixels that meet at corner `(i, j)` of a face of `side` pixels, `0 <= i, j <= side`: four inside,
/// four at a border of two faces, three where three faces meet. Sorted, so that it is the same list from every
/// face that has the corner.
pub fn around(side: u32, face: usize, i: u32, j: u32) -> Vec<Pixel> {
    let inside = |at: i64| at.clamp(0, i64::from(side) - 1);
    let mut pixels: Vec<Pixel> = [(-1, -1), (0, -1), (-1, 0), (0, 0)]
        .into_iter()
        .filter_map(|(dx, dy)| {
            let (x, y) = (i64::from(i) + dx, i64::from(j) + dy);
            let within = Pixel { face, x: inside(x) as u32, y: inside(y) as u32 };
            let beyond = [(x - inside(x)) as i32, (y - inside(y)) as i32];
            match STEPS.iter().position(|step| *step == beyond) {
                // Diagonally beyond a corner of the cube there is nothing.
                Some(step) => within.neighbour(side, step),
                None => Some(within),
            }
        })
        .collect();
    pixels.sort_unstable();
    pixels.dedup();
    pixels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{FacePicture, Sample};
    use glam::DVec3;

    #[test]
    fn four_pixels_meet_inside_and_at_borders_three_at_corners_of_the_cube() {
        for face in 0..6 {
            for i in 0..=8 {
                for j in 0..=8 {
                    let at_corner = i % 8 == 0 && j % 8 == 0;
                    let found = around(8, face, i, j);
                    assert_eq!(found.len(), if at_corner { 3 } else { 4 }, "{face} {i} {j}");
                    let faces: std::collections::BTreeSet<_> =
                        found.iter().map(|pixel| pixel.face).collect();
                    let borders = usize::from(i % 8 == 0) + usize::from(j % 8 == 0);
                    assert_eq!(faces.len(), 1 + borders);
                }
            }
        }
    }

    #[test]
    fn all_of_them_touch_the_corner_and_every_face_tells_the_same() {
        let picture =
            FacePicture { disparity: vec![0.0; 64], color: vec![[0; 3]; 64], ..Default::default() };
        let faces = std::array::from_fn(|_| picture.clone());
        let sample = Sample { eye: DVec3::ZERO, side: 8, faces };
        for face in 0..6 {
            for (i, j) in (0..=8).flat_map(|i| (0..=8).map(move |j| (i, j))) {
                let corner = sample.ray(face, f64::from(i), f64::from(j));
                let found = around(8, face, i, j);
                for pixel in &found {
                    let touches = [(0, 0), (1, 0), (0, 1), (1, 1)].iter().any(|(dx, dy)| {
                        let (x, y) = (pixel.x + dx, pixel.y + dy);
                        let other = sample.ray(pixel.face, f64::from(x), f64::from(y));
                        let same = other.normalize().distance(corner.normalize()) < 1e-9;
                        assert!(!same || around(8, pixel.face, x, y) == found);
                        same
                    });
                    assert!(touches, "{pixel:?} does not touch {i} {j} of {face}");
                }
            }
        }
    }
}
