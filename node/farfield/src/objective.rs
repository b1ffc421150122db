//! How much of what surrounds a viewpoint no sample of a group saw (paper 000, sections 3.3.4 and 3.3.5).
//!
//! The global void surface is what bounds the space that no sample sees. Its projection from a viewpoint is
//! where the projections of all samples' skins meet, each before every valid surface:
//!
//! ```text
//! F(V, S_1 .. S_n) = sum of the solid angles of the pixels in the intersection of Proj(Skins(S_i), V)
//! ```
//!
//! The paper counts in a stencil buffer; here each sample strikes out the pixels where it has no skin.
//! A sample that shows no surface in a direction has none there to strike out or to keep: sky that one
//! sample saw as sky is not void.
//!
//! At fixed adjacency F never rises as a group grows: a sample adds surfaces before which skins are hidden, and
//! one more set to intersect with. The third test may raise it, by taking back a surface that was none.

use crate::adjacency::{Adjacency, Tests};
use crate::neighbours::Pixel;
use crate::raster::{cover, outside};
use crate::sample::Sample;
use crate::skins::Surfaces;
use crate::solid_angle::solid_angle;
use glam::{DVec3, DVec4};
use rayon::prelude::*;

/// The visible part of the global void surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measure {
    /// The objective F: its solid angle.
    pub steradians: f64,
    /// Its pixels.
    pub pixels: usize,
}

struct Member {
    sample: Sample,
    adjacency: Adjacency,
    surfaces: Surfaces,
}

/// Samples, each with its surfaces as the others know them.
pub struct Group {
    tests: Tests,
    members: Vec<Member>,
}

impl Group {
    /// No samples yet.
    pub fn new(tests: Tests) -> Self {
        Self { tests, members: Vec::new() }
    }

    /// Adds a sample; what it sees past is no surface of the others any longer, and conversely.
    pub fn push(&mut self, sample: Sample) {
        let tests = self.tests;
        let adjacency = Adjacency::new(&sample, self.samples(), &tests);
        self.members.par_iter_mut().for_each(|member| {
            let known = member.adjacency.clone();
            member.adjacency.see_past(&member.sample, &sample, &tests);
            if member.adjacency != known {
                let least = tests.least_disparity;
                member.surfaces = Surfaces::new(&member.sample, &member.adjacency, least);
            }
        });
        let surfaces = Surfaces::new(&sample, &adjacency, tests.least_disparity);
        self.members.push(Member { sample, adjacency, surfaces });
    }

    /// In the order in which they were added.
    pub fn samples(&self) -> impl Iterator<Item = &Sample> {
        self.members.iter().map(|member| &member.sample)
    }

    /// The samples, each with its adjacency in the whole group.
    pub fn into_parts(self) -> Vec<(Sample, Adjacency)> {
        self.members.into_iter().map(|member| (member.sample, member.adjacency)).collect()
    }

    /// The objective at a viewpoint, over six faces of `side * side` pixels. Of no samples, nothing is known
    /// and nothing counted: 0. Surfaces are as fine as the samples' pixels, so a silhouette has a skin a
    /// pixel of the sample wide even from the sample's own eye.
    pub fn objective(&self, eye: DVec3, side: u32) -> Measure {
        let pixels = side as usize * side as usize;
        let mut faces: [Face; 6] = std::array::from_fn(|_| Face {
            valid: vec![0.0; pixels],
            void: vec![!self.members.is_empty(); pixels],
        });
        for member in &self.members {
            let corners = Corners::new(member, eye, self.tests.least_disparity);
            faces.par_iter_mut().enumerate().for_each(|(face, picture)| {
                corners.draw(&member.surfaces.valid, face, side, |pixel, disparity| {
                    picture.valid[pixel] = picture.valid[pixel].max(disparity);
                });
            });
        }
        for member in &self.members {
            let corners = Corners::new(member, eye, self.tests.least_disparity);
            // Less than a pixel of the sample before a surface, a skin hides nothing it could have told apart.
            let before = 1.0 + 2.0 / f64::from(member.sample.side);
            faces.par_iter_mut().enumerate().for_each(|(face, picture)| {
                if !picture.void.contains(&true) {
                    return;
                }
                let mut skin = vec![false; pixels];
                corners.draw(&member.surfaces.skins, face, side, |pixel, disparity| {
                    skin[pixel] |= disparity > picture.valid[pixel] * before;
                });
                picture.void.iter_mut().zip(&skin).for_each(|(void, skin)| *void &= skin);
            });
        }
        let void = faces.iter().flat_map(|face| (0..pixels).filter(|&pixel| face.void[pixel]));
        let nothing = Measure { steradians: 0.0, pixels: 0 };
        void.fold(nothing, |sum, pixel| {
            let (x, y) = (pixel as u32 % side, pixel as u32 / side);
            Measure { steradians: sum.steradians + solid_angle(side, x, y), pixels: sum.pixels + 1 }
        })
    }
}

struct Face {
    /// Disparity of the nearest valid surface, 0 where there is none.
    valid: Vec<f64>,
    /// Where every sample so far has a skin before that.
    void: Vec<bool>,
}

/// A sample's pixels as a viewpoint sees them, each with [`outside`].
struct Corners(Vec<(DVec4, u32)>);

impl Corners {
    /// What pixel `p` shows lies at `S + ray / d`, so relative to `V` at `(ray + (S - V) d) / d`.
    fn new(member: &Member, eye: DVec3, least: f32) -> Self {
        let sample = &member.sample;
        let count = 6 * sample.side as usize * sample.side as usize;
        let corner = |index| {
            let (ray, disparity) = Pixel::of_index(sample.side, index).ray(sample);
            let disparity = if disparity > f64::from(least) { disparity } else { 0.0 };
            let at = (ray + (sample.eye - eye) * disparity).extend(disparity);
            (at, outside(at))
        };
        Self((0..count).into_par_iter().map(corner).collect())
    }

    fn draw(
        &self,
        triangles: &[[u32; 3]],
        face: usize,
        side: u32,
        mut visit: impl FnMut(usize, f64),
    ) {
        for triangle in triangles {
            let [a, b, c] = triangle.map(|corner| self.0[corner as usize]);
            if (a.1 & b.1 & c.1) >> (4 * face) & 15 == 0 {
                cover(face, side, [a.0, b.0, c.0], &mut visit);
            }
        }
    }
}

#[cfg(test)]
mod tests;
