//! The surfaces of a sample as triangles over its pixels' centres: those it saw, and the skins that
//! bound what it did not see (paper 000, section 3.3.3).
//!
//! Around every corner of the pixel grid lie four pixels, two triangles; at a corner of the cube three, one
//! triangle. Together they close around the eye. A triangle of three adjacent pixels is a surface that was
//! seen. One of three pixels that show nothing is no surface: the sample saw that nothing is there. All
//! others are skins, also from a thing's silhouette to what is endlessly far.

use crate::adjacency::Adjacency;
use crate::neighbours::{Pixel, step_of};
use crate::sample::Sample;

/// Triangles of [`Pixel::index`]es.
pub(crate) struct Surfaces {
    /// What the sample saw.
    pub(crate) valid: Vec<[u32; 3]>,
    /// Its void surface.
    pub(crate) skins: Vec<[u32; 3]>,
}

impl Surfaces {
    /// Of a sample in which what has no greater disparity than `least` counts as nothing.
    pub(crate) fn new(sample: &Sample, adjacency: &Adjacency, least: f32) -> Self {
        let side = sample.side;
        let mut surfaces = Self { valid: Vec::new(), skins: Vec::new() };
        let mut quad = |[a, b, c, d]: [Pixel; 4], joined: &dyn Fn(Pixel, Pixel) -> bool| {
            let [ab, bc, cd, da] = [joined(a, b), joined(b, c), joined(c, d), joined(d, a)];
            let (ac, bd) = (joined(a, c), joined(b, d));
            let one = [ab && bc && ac, ac && cd && da];
            let two = [ab && bd && da, bc && cd && bd];
            let count = |halves: [bool; 2]| halves.iter().filter(|half| **half).count();
            if count(one) >= count(two) {
                surfaces.add(sample, least, [a, b, c], one[0]);
                surfaces.add(sample, least, [a, c, d], one[1]);
            } else {
                surfaces.add(sample, least, [a, b, d], two[0]);
                surfaces.add(sample, least, [b, c, d], two[1]);
            }
        };
        let joined =
            |a: Pixel, b: Pixel| a.step_to(side, b).is_some_and(|step| adjacency.adjacent(a, step));
        let inside = |a: Pixel, b: Pixel| adjacency.adjacent(a, step_inside(a, b));
        for face in 0..6 {
            let at = |x, y| Pixel { face, x, y };
            for (x, y) in (1..side).flat_map(|y| (1..side).map(move |x| (x, y))) {
                quad([at(x - 1, y - 1), at(x, y - 1), at(x, y), at(x - 1, y)], &inside);
            }
            let last = side - 1;
            for (step, horizontal, fixed) in
                [(1, true, 0), (3, false, 0), (4, false, last), (6, true, last)]
            {
                let along = |k: u32| if horizontal { at(k, fixed) } else { at(fixed, k) };
                for (a, b) in (1..side).map(|k| (along(k - 1), along(k))) {
                    let past = a.neighbour(side, step).zip(b.neighbour(side, step));
                    if let Some((past_a, past_b)) = past.filter(|(past, _)| face < past.face) {
                        quad([a, b, past_b, past_a], &joined);
                    }
                }
            }
        }
        for (face, y, x) in corners(side) {
            let corner = Pixel { face, x: x.0, y: y.0 };
            let beside = corner.neighbour(side, x.1).zip(corner.neighbour(side, y.1));
            if let Some((b, c)) = beside.filter(|(b, c)| face < b.face && face < c.face) {
                let valid = joined(corner, b) && joined(b, c) && joined(corner, c);
                surfaces.add(sample, least, [corner, b, c], valid);
            }
        }
        surfaces
    }

    fn add(&mut self, sample: &Sample, least: f32, corners: [Pixel; 3], valid: bool) {
        let something = |pixel: &Pixel| pixel.ray(sample).1 > f64::from(least);
        let list = match valid {
            true => &mut self.valid,
            false if corners.iter().any(something) => &mut self.skins,
            false => return,
        };
        list.push(corners.map(|pixel| pixel.index(sample.side) as u32));
    }
}

/// The step between neighbours on one face.
fn step_inside(from: Pixel, to: Pixel) -> usize {
    step_of([to.x as i32 - from.x as i32, to.y as i32 - from.y as i32])
}

/// The four corners of each face: pixel coordinates, each with the step that leads past the border there.
fn corners(side: u32) -> impl Iterator<Item = (usize, (u32, usize), (u32, usize))> {
    let (left, right, top, bottom) = ((0, 3), (side - 1, 4), (0, 1), (side - 1, 6));
    let of_face = [(top, left), (top, right), (bottom, left), (bottom, right)];
    (0..6).flat_map(move |face| of_face.map(|(y, x)| (face, y, x)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adjacency::Tests;
    use crate::analytic::Scene;
    use glam::DVec3;
    use std::collections::HashMap;

    fn surfaces(scene: &Scene, side: u32) -> Surfaces {
        let sample = scene.sample(DVec3::ZERO, side);
        Surfaces::new(&sample, &Adjacency::new(&sample, [], &Tests::default()), 0.0)
    }

    #[test]
    fn a_room_is_closed_and_has_no_skin() {
        let room = Scene::of(&[[-2.0, -2.0, -2.0, 2.0, 2.0, 2.0]]);
        for side in [2, 16, 33] {
            let Surfaces { valid, skins } = surfaces(&room, side);
            let mut edges = HashMap::new();
            for [a, b, c] in valid.iter().chain(&skins).copied() {
                for (a, b) in [(a, b), (b, c), (c, a)] {
                    *edges.entry((a.min(b), a.max(b))).or_insert(0) += 1;
                }
            }
            assert!(edges.values().all(|&count| count == 2));
            let pixels = 6 * side * side;
            assert_eq!(valid.len() + skins.len(), 2 * pixels as usize - 4, "Euler");
            assert!(side < 16 || skins.is_empty(), "{side}: {}", skins.len());
        }
    }

    #[test]
    fn the_sky_is_no_surface_but_a_silhouette_has_a_skin() {
        let Surfaces { valid, skins } = surfaces(&Scene::default(), 8);
        assert!(valid.is_empty() && skins.is_empty());
        let Surfaces { valid, skins } =
            surfaces(&Scene::of(&[[2.0, -1.0, -1.0, 3.0, 1.0, 1.0]]), 16);
        // Eight pixels across: 7 x 7 quads of wall, and a ring of 32 quads around. Of its corners two are cut so
        // that one half is all sky.
        assert_eq!((valid.len(), skins.len()), (2 * 49, 2 * 32 - 2));
        assert_eq!(surfaces(&Scene::default(), 1).skins.len(), 0);
    }
}
