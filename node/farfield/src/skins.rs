//! The surfaces of a sample as triangles over its pixels: those it saw, and the skins that bound what it did not
//! see (paper 000, section 3.3.3).
//!
//! A pixel that shows something is a surface over its whole solid angle, as in the mesh that will be drawn
//! ([`crate::depth_mesh`]): the disparity of a corner is the mean over those pixels around it that are joined to the pixel,
//! so what is joined has its corners in common. Where two pixels have not, the skin between them lies along the rays through
//! the side that they share, from one surface to the other, or without end where one shows nothing. All of it together
//! closes around the eye. From the sample's own eye a skin is seen edge-on: there nothing is void, by the meaning of the
//! word. The paper spans skins from one pixel's centre to the next; then each silhouette is void a pixel wide, from
//! anywhere and however many samples there are, and in faces as coarse as ours that is more than all the rest.

use crate::adjacency::Adjacency;
use crate::depth_mesh::corners::around;
use crate::neighbours::{Pixel, STEPS, step_of};
use crate::sample::Sample;
use glam::DVec3;

/// Triangles of [`Self::corners`].
pub(crate) struct Surfaces {
    /// Direction from the eye and disparity: the corner lies at one over the other.
    pub(crate) corners: Vec<(DVec3, f64)>,
    /// What the sample saw.
    pub(crate) valid: Vec<[u32; 3]>,
    /// Its void surface.
    pub(crate) skins: Vec<[u32; 3]>,
}

/// Steps right and down from a pixel's place to its corners' places.
const CORNERS: [[u32; 2]; 4] = [[0, 0], [1, 0], [0, 1], [1, 1]];

impl Surfaces {
    /// Of a sample in which what has no greater disparity than `least` counts as nothing.
    pub(crate) fn new(sample: &Sample, adjacency: &Adjacency, least: f32) -> Self {
        let making = Making { sample, adjacency, least };
        let (corners, of_pixels) = making.corners();
        let mut surfaces = Self { corners, valid: Vec::new(), skins: Vec::new() };
        let side = sample.side;
        for index in 0..of_pixels.len() {
            let pixel = Pixel::of_index(side, index);
            let [a, b, c, d] = of_pixels[index];
            if making.disparity(pixel) > 0.0 {
                surfaces.valid.extend([[a, c, b], [b, c, d]]);
            }
            // By step, the corners at that side.
            for (step, from, to) in [(1, 0, 1), (3, 0, 2), (4, 1, 3), (6, 2, 3)] {
                let Some(other) = pixel.neighbour(side, step).filter(|other| pixel < *other) else {
                    continue;
                };
                let ours = [of_pixels[index][from], of_pixels[index][to]];
                let places = match other.face == pixel.face {
                    // The sides that face each other.
                    true if step == 4 => [0, 2],
                    true if step == 6 => [0, 1],
                    true => unreachable!("what lies before comes first"),
                    false => [from, to].map(|k| making.same_corner(pixel, k, other)),
                };
                let theirs = places.map(|place| of_pixels[other.index(side)][place]);
                surfaces.skin(ours, theirs);
            }
        }
        surfaces
    }

    /// The skin between two sides that lie on the same rays, where they are not the same.
    fn skin(&mut self, [a, b]: [u32; 2], [c, d]: [u32; 2]) {
        if a != c {
            self.skins.push([a, b, c]);
        }
        if b != d {
            self.skins.push([b, d, c]);
        }
    }
}

struct Making<'a> {
    sample: &'a Sample,
    adjacency: &'a Adjacency,
    least: f32,
}

impl Making<'_> {
    /// What a pixel shows; 0 of nothing.
    fn disparity(&self, pixel: Pixel) -> f64 {
        let known = self.sample.faces[pixel.face].disparity[self.sample.index(pixel.x, pixel.y)];
        if known > self.least { f64::from(known) } else { 0.0 }
    }

    fn corner(&self, pixel: Pixel, place: usize) -> DVec3 {
        let [right, down] = CORNERS[place];
        self.sample.ray(pixel.face, f64::from(pixel.x + right), f64::from(pixel.y + down))
    }

    /// Which corner of `other` is corner `place` of a pixel beside it, past a border.
    fn same_corner(&self, pixel: Pixel, place: usize, other: Pixel) -> usize {
        let at = self.corner(pixel, place);
        // On the border both faces have the same coordinate along their axes, so the same vector.
        let away = |place: &usize| self.corner(other, *place).distance_squared(at);
        (0..4).min_by(|a, b| away(a).total_cmp(&away(b))).expect("four corners")
    }

    /// All corners, and by pixel its four.
    fn corners(&self) -> (Vec<(DVec3, f64)>, Vec<[u32; 4]>) {
        let side = self.sample.side;
        let mut corners = Vec::new();
        let mut of_pixels = vec![[0; 4]; 6 * side as usize * side as usize];
        for face in 0..6 {
            for (i, j) in (0..=side).flat_map(|j| (0..=side).map(move |i| (i, j))) {
                let is_inside = (1..side).contains(&i) && (1..side).contains(&j);
                if is_inside {
                    let at = |place: usize| {
                        let [right, down] = CORNERS[place];
                        Pixel { face, x: i - 1 + right, y: j - 1 + down }
                    };
                    // Corner 3 of the first of them, corner 0 of the last.
                    let pixels = [0, 1, 2, 3].map(|place| (at(place), 3 - place));
                    self.add(
                        self.sample.ray(face, i.into(), j.into()),
                        &pixels,
                        &mut corners,
                        &mut of_pixels,
                    );
                    continue;
                }
                let around = around(side, face, i, j);
                if around[0].face < face {
                    continue;
                }
                let ray = self.sample.ray(face, i.into(), j.into());
                let away =
                    |pixel: Pixel, place: usize| self.corner(pixel, place).distance_squared(ray);
                let nearest = |pixel: Pixel| {
                    (0..4).min_by(|a, b| away(pixel, *a).total_cmp(&away(pixel, *b)))
                };
                let pixels: Vec<_> =
                    around.iter().map(|&pixel| (pixel, nearest(pixel).expect("four"))).collect();
                self.add(ray, &pixels, &mut corners, &mut of_pixels);
            }
        }
        (corners, of_pixels)
    }

    /// One corner for each of the groups that pixels around a place fall into: joined ones, directly or through
    /// others, and those that show nothing.
    fn add(
        &self,
        ray: DVec3,
        pixels: &[(Pixel, usize)],
        corners: &mut Vec<(DVec3, f64)>,
        of_pixels: &mut [[u32; 4]],
    ) {
        let side = self.sample.side;
        let mut group = [0, 1, 2, 3];
        for (a, &(first, _)) in pixels.iter().enumerate() {
            for (b, &(second, _)) in pixels.iter().enumerate().skip(a + 1) {
                let nothing = self.disparity(first) == 0.0 && self.disparity(second) == 0.0;
                if group[a] != group[b] && (nothing || self.joined(first, second)) {
                    let (kept, gone) = (group[a].min(group[b]), group[a].max(group[b]));
                    group.iter_mut().filter(|of| **of == gone).for_each(|of| *of = kept);
                }
            }
        }
        for wanted in 0..pixels.len() {
            let members = || pixels.iter().zip(group).filter(|(_, of)| *of == wanted);
            let count = members().count();
            if count == 0 {
                continue;
            }
            let sum: f64 = members().map(|((pixel, _), _)| self.disparity(*pixel)).sum();
            let number = corners.len() as u32;
            corners.push((ray, sum / count as f64));
            for ((pixel, place), _) in members() {
                of_pixels[pixel.index(side)][*place] = number;
            }
        }
    }

    fn joined(&self, a: Pixel, b: Pixel) -> bool {
        if a.face == b.face {
            let step = [b.x as i32 - a.x as i32, b.y as i32 - a.y as i32];
            return self.adjacency.adjacent(a, step_of(step));
        }
        let beside = |step: &usize| a.neighbour(self.sample.side, *step) == Some(b);
        (0..STEPS.len()).filter(beside).any(|step| self.adjacency.adjacent(a, step))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adjacency::Tests;
    use crate::analytic::Scene;
    use std::collections::HashMap;

    fn surfaces(scene: &Scene, side: u32) -> Surfaces {
        let sample = scene.sample(DVec3::ZERO, side);
        Surfaces::new(&sample, &Adjacency::new(&sample, [], &Tests::default()), 0.0)
    }

    /// Sides of triangles that do not belong to two.
    fn open(triangles: &[[u32; 3]]) -> usize {
        let mut sides = HashMap::new();
        for &[a, b, c] in triangles {
            for (a, b) in [(a, b), (b, c), (c, a)] {
                *sides.entry((a.min(b), a.max(b))).or_insert(0) += 1;
            }
        }
        sides.values().filter(|&&count| count != 2).count()
    }

    #[test]
    fn a_room_is_closed_and_has_no_skin() {
        let room = Scene::of(&[[-2.0, -2.0, -2.0, 2.0, 2.0, 2.0]]);
        for side in [2, 16, 33] {
            let Surfaces { corners, valid, skins } = surfaces(&room, side);
            let pixels = 6 * side * side;
            assert_eq!(valid.len(), 2 * pixels as usize);
            assert!(side < 16 || skins.is_empty(), "{side}: {}", skins.len());
            // Euler.
            assert!(side < 16 || corners.len() == pixels as usize + 2);
            assert!(side < 16 || open(&valid) == 0);
            // Half a pixel from where the planes are at most, over the cube's sides.
            for (ray, disparity) in corners.into_iter().filter(|_| side >= 16) {
                let want = 0.5 * ray.abs().max_element();
                assert!(
                    (disparity / want - 1.0).abs() < 1.5 / f64::from(side),
                    "{ray} {disparity}"
                );
            }
        }
    }

    #[test]
    fn the_sky_is_no_surface_but_a_silhouette_has_a_skin() {
        let Surfaces { valid, skins, .. } = surfaces(&Scene::default(), 8);
        assert!(valid.is_empty() && skins.is_empty());
        let wall = Scene::of(&[[2.0, -1.0, -1.0, 3.0, 1.0, 1.0]]);
        let Surfaces { corners, valid, skins } = surfaces(&wall, 16);
        // Eight pixels across, and 32 of their sides around.
        assert_eq!((valid.len(), skins.len()), (2 * 64, 2 * 32));
        let far = |corner: u32| corners[corner as usize].1 == 0.0;
        assert!(skins.iter().all(|skin| skin.iter().any(|&corner| far(corner))));
        assert_eq!(surfaces(&Scene::default(), 1).skins.len(), 0);
    }

    #[test]
    fn a_skin_lies_along_the_rays_and_closes_what_was_seen() {
        for side in [2, 9, 32] {
            let Surfaces { corners, valid, skins } = surfaces(&Scene::gap(), side);
            assert!(side == 2 || !skins.is_empty());
            for skin in &skins {
                let [a, b, c] = skin.map(|corner| corners[corner as usize].0);
                assert!(a.dot(b.cross(c)).abs() < 1e-12);
            }
            assert_eq!(open(&[valid, skins].concat()), 0);
        }
    }
}
