//! Which neighbouring pixels of a sample show one surface (paper 000, section 3.3.3).
//!
//! The edge between what two neighbours show is a skin, and they are not adjacent, by any of three tests:
//!
//! 1. One of them shows nothing, or something at a disparity not above [`Tests::least_disparity`].
//! 2. The edge makes an angle less than alpha with the ray through its midpoint.
//! 3. Another sample sees past the midpoint.
//!
//! The paper leaves the constants out. **Alpha.** Pixels in the middle of a face are `2 / side` radians apart,
//! so from one to the next a surface that is met at the grazing angle alpha recedes by `2 / side / tan(alpha)` of
//! its distance, and a gap in depth is taken for a surface where it is less. The default, 11 degrees, leaves
//! gaps under a fiftieth of their distance to the third test in faces of 512x512 pixels (a pipe half a metre before
//! a wall 20 m away is no part of it). It would cut a plain beyond five times the eye's height, too, the error that
//! section 6.2.2 of the paper tells of. So an edge that fails is held against what lies before and behind it: the
//! disparity of a plane is linear over its picture, and where the step to the pixel before or to the one behind
//! is as large, to within [`STRAIGHT`] of it, the edge lies in a plane that is seen at a grazing angle, and is none.
//!
//! **How far past is past.** The midpoint of an edge across a fold of a surface lies before the surface, by
//! less than the edge's length; that is a pixel of the sample over the sine of the angle of incidence.
//! The other sample knows the surface at its own pixels only, and errs likewise. So it must see farther by
//! [`Tests::slack_pixels`] pixels of both, which grow with the distance from either; the default of 2 is good
//! for folds that are met at 30 degrees and more. What the other sees is taken as the nearest of the four pixels
//! around the midpoint: disparity is linear over the picture of a plane, so that is never beyond a
//! plane through the midpoint, however it is seen, and a silhouette is not seen past by a rounding.

use crate::neighbours::{Pixel, step_of};
use crate::sample::{FACES, Sample};
use glam::DVec3;
use rayon::prelude::*;

/// How much steps of disparity along a plane may differ, as a share of a step: rounding and the bumps of a
/// simplified surface.
const STRAIGHT: f64 = 0.125;

/// The constants of the three tests.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tests {
    /// What has no greater disparity counts as nothing (test 1), 1 over scene units.
    pub least_disparity: f32,
    /// Least angle between an edge and the ray to its midpoint, radians (test 2).
    pub alpha: f64,
    /// Pixels by which another sample must see past an edge (test 3).
    pub slack_pixels: f64,
}

impl Default for Tests {
    fn default() -> Self {
        Self { least_disparity: 0.0, alpha: 11f64.to_radians(), slack_pixels: 2.0 }
    }
}

impl Tests {
    /// From the eye to what a pixel shows; none of nothing.
    fn offset(&self, sample: &Sample, pixel: Pixel) -> Option<DVec3> {
        let (ray, disparity) = pixel.ray(sample);
        (disparity > f64::from(self.least_disparity)).then(|| ray / disparity)
    }
}

/// For every pixel of a sample, which of its neighbours show the same surface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Adjacency {
    side: u32,
    /// Bit `k` for the neighbour [`STEPS`](crate::neighbours::STEPS)`[k]` away.
    bits: [Vec<u8>; 6],
}

impl Adjacency {
    /// By all three tests.
    pub fn new<'a>(
        sample: &Sample,
        others: impl IntoIterator<Item = &'a Sample>,
        tests: &Tests,
    ) -> Self {
        let mut adjacency = Self::alone(sample, tests);
        others.into_iter().for_each(|other| adjacency.see_past(sample, other, tests));
        adjacency
    }

    /// The same for the pixels that `is_wanted` alone, by face and pixel: of others nothing is adjacent.
    pub fn of_some<'a>(
        sample: &Sample,
        others: impl IntoIterator<Item = &'a Sample>,
        tests: &Tests,
        is_wanted: &[Vec<bool>; 6],
    ) -> Self {
        let mut adjacency = Self::alone(sample, tests);
        for (bits, wanted) in adjacency.bits.iter_mut().zip(is_wanted) {
            bits.iter_mut().zip(wanted).filter(|(_, wanted)| !**wanted).for_each(|(b, _)| *b = 0);
        }
        others.into_iter().for_each(|other| adjacency.see_past(sample, other, tests));
        adjacency
    }

    /// Whether a pixel and its neighbour `STEPS[step]` away show one surface; false where it has none there.
    /// Symmetric.
    pub fn adjacent(&self, pixel: Pixel, step: usize) -> bool {
        self.bits[pixel.face][pixel.in_face(self.side)] >> step & 1 != 0
    }

    /// By the first two tests.
    fn alone(sample: &Sample, tests: &Tests) -> Self {
        let side = sample.side;
        let everything = vec![u8::MAX; side as usize * side as usize];
        let mut adjacency = Self { side, bits: std::array::from_fn(|_| everything.clone()) };
        let least = tests.alpha.tan();
        adjacency.keep(sample, tests, |[first, second], from, to| {
            let (edge, middle) = (to - from, 0.5 * (from + to));
            edge.cross(middle).length() >= least * edge.dot(middle).abs()
                || lies_in_a_plane(sample, first, second)
        });
        adjacency
    }

    /// The third test, for one more sample of the group: what it sees past is adjacent no longer.
    pub fn see_past(&mut self, sample: &Sample, other: &Sample, tests: &Tests) {
        let slack =
            |side: u32, distance: f64| tests.slack_pixels * 2.0 / f64::from(side) * distance;
        self.keep(sample, tests, |_, from, to| {
            let middle = 0.5 * (from + to);
            let seen = sample.eye + middle - other.eye;
            let slack = slack(sample.side, middle.length()) + slack(other.side, seen.length());
            !sees_past(other, seen, slack, tests)
        });
    }

    /// Clears the bits of what does not meet a condition on the ends of the edge, relative to the
    /// sample's eye. The ends come in the same order from both pixels, so both get the same answer; inside a face
    /// one of them asks, and the other hears.
    fn keep(
        &mut self,
        sample: &Sample,
        tests: &Tests,
        meets: impl Fn([Pixel; 2], DVec3, DVec3) -> bool + Sync,
    ) {
        let side = self.side;
        let offset = |index| tests.offset(sample, Pixel::of_index(side, index));
        let offsets: Vec<Option<DVec3>> =
            (0..6 * side as usize * side as usize).into_par_iter().map(offset).collect();
        for (face, bits) in self.bits.iter_mut().enumerate() {
            let known = bits.clone();
            let hears = |pixel: Pixel, step: usize| {
                let other = (step < 4).then(|| pixel.neighbour(side, step)).flatten()?;
                let is_asked =
                    other.face == face && known[other.in_face(side)] >> (7 - step) & 1 != 0;
                is_asked.then(|| other.in_face(side))
            };
            bits.par_chunks_mut(side as usize).enumerate().for_each(|(y, row)| {
                for (x, bits) in row.iter_mut().enumerate().filter(|(_, bits)| **bits != 0) {
                    let pixel = Pixel { face, x: x as u32, y: y as u32 };
                    let holds = |step: &usize| {
                        let Some(other) = pixel.neighbour(side, *step) else { return false };
                        let (first, second) = (pixel.min(other), pixel.max(other));
                        let [from, to] = [first, second].map(|end| offsets[end.index(side)]);
                        from.zip(to).is_some_and(|(from, to)| meets([first, second], from, to))
                    };
                    *bits = (0..8)
                        .filter(|step| *bits >> step & 1 != 0)
                        .filter(|step| hears(pixel, *step).is_some() || holds(step))
                        .fold(0, |bits, step| bits | 1 << step);
                }
            });
            for at in 0..bits.len() {
                let pixel = Pixel { face, x: at as u32 % side, y: at as u32 / side };
                for step in (0..4).filter(|step| known[at] >> step & 1 != 0) {
                    if let Some(other) = hears(pixel, step)
                        && bits[other] >> (7 - step) & 1 == 0
                    {
                        bits[at] &= !(1 << step);
                    }
                }
            }
        }
    }
}

/// Whether the step of disparity between two pixels of a face is that before or behind it.
fn lies_in_a_plane(sample: &Sample, first: Pixel, second: Pixel) -> bool {
    if first.face != second.face {
        return false;
    }
    let of = |pixel: Pixel| pixel.ray(sample).1;
    let step = of(second) - of(first);
    // The pixel as far beyond `to` as that lies beyond `from`, in the same face.
    let beyond = |from: Pixel, to: Pixel| {
        let on = |from: u32, to: u32| (2 * to).checked_sub(from).filter(|&at| at < sample.side);
        let (x, y) = (on(from.x, to.x)?, on(from.y, to.y)?);
        Some(of(Pixel { face: to.face, x, y })).filter(|&disparity| disparity > 0.0)
    };
    let is_like = |other: f64| (other - step).abs() <= STRAIGHT * step.abs();
    let before = beyond(second, first).is_some_and(|before| is_like(of(first) - before));
    before || beyond(first, second).is_some_and(|behind| is_like(behind - of(second)))
}

/// Whether the first surface a sample sees towards a point, relative to its eye, lies beyond it by more than
/// `slack`; past nothing it sees without end.
fn sees_past(sample: &Sample, point: DVec3, slack: f64, tests: &Tests) -> bool {
    let Some((face, [u, v], depth)) = sample.project(point) else { return false };
    let forward = DVec3::from_array(FACES[face].forward);
    let last = sample.side - 1;
    let pixel = Pixel { face, x: (u as u32).min(last), y: (v as u32).min(last) };
    let beyond = depth * (1.0 + slack / point.length());
    let past = |pixel: Pixel| {
        let offset = tests.offset(sample, pixel);
        let seen = offset.map(|offset| offset.dot(forward)).filter(|&depth| depth > 0.0);
        seen.is_none_or(|seen| seen > beyond)
    };
    let towards = |at: f64, pixel: u32| if at - f64::from(pixel) < 0.5 { -1 } else { 1 };
    let (right, down) = (towards(u, pixel.x), towards(v, pixel.y));
    let around = [[right, 0], [0, down], [right, down]];
    past(pixel)
        && around
            .into_iter()
            .all(|step| pixel.neighbour(sample.side, step_of(step)).is_none_or(past))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analytic::Scene;

    fn pixels(side: u32) -> impl Iterator<Item = Pixel> {
        (0..6 * (side * side) as usize).map(move |index| Pixel::of_index(side, index))
    }

    #[test]
    fn a_plane_is_whole_down_to_alpha_and_over_borders() {
        let tests = Tests::default();
        // A wall that takes half of all directions, met at every angle, tilted to no axis by seeing it from a
        // corner of the cube too.
        for ground in [-1e-3, -1.0, -1e6] {
            let scene = Scene { boxes: Vec::new(), ground: Some(ground) };
            let (side, eye) = (64, DVec3::new(0.1, 0.2, 0.0));
            let sample = scene.sample(eye, side);
            let others = [DVec3::new(3.0, -2.0, 0.0), DVec3::new(0.1, 0.2, 0.5)];
            let others = others.map(|at| scene.sample(at * ground.abs(), 48));
            let adjacency = Adjacency::new(&sample, &others, &tests);
            let grazing = |pixel: Pixel| {
                let ray = pixel.ray(&sample).0.normalize();
                (-ray.z).asin()
            };
            let (mut whole, mut cut, mut past_borders) = (0, 0, 0);
            for pixel in pixels(side) {
                for (step, other) in (0..8).filter_map(|k| Some((k, pixel.neighbour(side, k)?))) {
                    let angle = grazing(pixel).min(grazing(other));
                    let adjacent = adjacency.adjacent(pixel, step);
                    if angle > 1.5 * tests.alpha {
                        assert!(adjacent, "{ground} {pixel:?} {step}");
                        whole += 1;
                        past_borders += u32::from(pixel.face != other.face);
                    }
                    if angle <= 0.0 {
                        assert!(!adjacent);
                        cut += 1;
                    }
                }
            }
            assert!(
                whole > 20_000 && cut > 20_000 && past_borders > 300,
                "{whole} {cut} {past_borders}"
            );
        }
    }

    #[test]
    fn a_wall_behind_another_is_not_the_same() {
        let scene = Scene::gap();
        let sample = scene.sample(DVec3::ZERO, 64);
        let adjacency = Adjacency::new(&sample, [], &Tests::default());
        let front = |pixel: Pixel| {
            let (ray, disparity) = pixel.ray(&sample);
            disparity > 0.0 && ray.y / disparity < 2.2
        };
        let mut gaps = 0;
        for pixel in pixels(64).filter(|&pixel| pixel.face == 2 && front(pixel)) {
            for (step, other) in (0..8).filter_map(|k| Some((k, pixel.neighbour(64, k)?))) {
                if other.face == 2 && !front(other) {
                    gaps += 1;
                    assert!(!adjacency.adjacent(pixel, step));
                }
            }
        }
        assert!(gaps > 200, "{gaps}");
    }

    #[test]
    fn another_sample_sees_past_a_small_gap() {
        // A wall that ends, and one a tenth behind: too near each other for the second test.
        let scene = Scene::of(&[
            [-90.0, 10.0, -90.0, 0.0, 10.1, 90.0],
            [-90.0, 11.2, -90.0, 90.0, 11.3, 90.0],
        ]);
        let side = 128;
        let (sample, other) =
            (scene.sample(DVec3::ZERO, side), scene.sample(DVec3::new(9.0, 4.0, 0.0), side));
        let edge = |x| Pixel { face: 2, x, y: 60 };
        let at =
            (0..127).find(|&x| edge(x + 1).ray(&sample).1 < edge(x).ray(&sample).1 * 0.95).unwrap();
        let tests = Tests { alpha: 0.0625, ..Tests::default() };
        let alone = Adjacency::new(&sample, [], &tests);
        let group = Adjacency::new(&sample, [&other], &tests);
        assert!(alone.adjacent(edge(at), 4) && !group.adjacent(edge(at), 4));
        assert!(group.adjacent(edge(at - 1), 4) && group.adjacent(edge(at + 1), 4));
        let cut = pixels(side)
            .map(|p| (0..8).filter(|&k| alone.adjacent(p, k) && !group.adjacent(p, k)).count());
        // Nothing but the gap: about a column of it, six edges a row, on three faces.
        let cut = cut.sum::<usize>();
        assert!((6 * 100..6 * 400).contains(&cut), "{cut}");
    }

    #[test]
    fn asking_once_for_each_edge_changes_no_bit() {
        let scene = Scene { ground: Some(-1.5), ..Scene::of(&[[1.0, -1.0, -2.0, 2.0, 0.3, 3.0]]) };
        let side = 21;
        let sample = scene.sample(DVec3::new(0.0, 0.1, 0.2), side);
        let tests = Tests::default();
        let whole = Adjacency::alone(&sample, &tests);
        // Some pixels' bits are gone, those of their neighbours are not.
        let some =
            std::array::from_fn(|face| (0..side * side).map(move |at| at % 3 != face as u32 % 2));
        let some = some.map(Iterator::collect::<Vec<bool>>);
        let partial = Adjacency::of_some(&sample, [], &tests, &some);
        // A condition that a wrong order of the ends would show.
        let meets =
            |_: [Pixel; 2], from: DVec3, to: DVec3| (from.x * 3.1 + to.y * 7.7).sin() > -0.2;
        for start in [whole, partial] {
            let mut kept = start.clone();
            kept.keep(&sample, &tests, meets);
            for (pixel, step) in pixels(side).flat_map(|p| (0..8).map(move |step| (p, step))) {
                let holds = pixel.neighbour(side, step).is_some_and(|other| {
                    let ends = [pixel.min(other), pixel.max(other)];
                    let at = ends.map(|end| tests.offset(&sample, end));
                    start.adjacent(pixel, step) && meets(ends, at[0].unwrap(), at[1].unwrap())
                });
                assert_eq!(kept.adjacent(pixel, step), holds, "{pixel:?} {step}");
            }
            assert!(kept != start);
        }
    }

    #[test]
    fn symmetric_whatever_is_seen() {
        let scene = Scene {
            boxes: Scene::of(&[
                [1.0, -1.0, -2.0, 2.0, 0.3, 3.0],
                [-4.0, 2.0, -1.0, -1.0, 3.0, 4.0],
            ])
            .boxes,
            ground: Some(-1.5),
        };
        for side in [1, 2, 17] {
            let sample = scene.sample(DVec3::new(0.0, 0.1, 0.2), side);
            let other = scene.sample(DVec3::new(0.5, -3.0, 0.2), side);
            // A sample sees past nothing of its own, and not past its own eye.
            let adjacency = Adjacency::new(&sample, [&other], &Tests::default());
            assert_eq!(
                Adjacency::new(&sample, [], &Tests::default()),
                Adjacency::new(&sample, [&sample], &Tests::default())
            );
            for pixel in pixels(side) {
                for step in 0..8 {
                    let back = pixel.neighbour(side, step).is_some_and(|other| {
                        adjacency.adjacent(other, other.step_to(side, pixel).unwrap())
                    });
                    assert_eq!(adjacency.adjacent(pixel, step), back);
                }
            }
        }
    }
}
