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
use crate::projection::Projection;
use crate::sample::Sample;
use crate::skins::Surfaces;
use crate::solid_angle::solid_angle;
use crate::wanted::Wanted;
use glam::DVec3;
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

    /// Adds a sample, of as many pixels as the others; what it sees past is no surface of theirs any longer, and
    /// conversely.
    pub fn push(&mut self, sample: Sample) {
        assert!(self.samples().all(|other| other.side == sample.side), "samples of one size");
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
    /// and nothing counted: 0. Where a sample was taken it is 0, too. Silhouettes are known to half a pixel of the
    /// sample.
    ///
    /// The nearest sample comes first. It leaves few pixels, and others are looked at but there: more samples hide
    /// more skins and leave fewer pixels with one of each.
    pub fn objective(&self, eye: DVec3, side: u32) -> Measure {
        let nothing = Measure { steradians: 0.0, pixels: 0 };
        if self.members.is_empty() {
            return nothing;
        }
        let pixels = side as usize * side as usize;
        let mut nearest_first: Vec<&Member> = self.members.iter().collect();
        let away = |member: &Member| member.sample.eye.distance_squared(eye);
        nearest_first.sort_by(|a, b| away(a).total_cmp(&away(b)));
        let nearest = |seen: &mut Vec<f64>, pixel: usize, disparity: f64| {
            seen[pixel] = seen[pixel].max(disparity);
        };
        let blank = || -> [Vec<f64>; 6] { std::array::from_fn(|_| vec![0.0; pixels]) };

        // Less than a pixel of the sample before a surface, a skin hides nothing it could have told apart.
        let before = 1.0 + 2.0 / f64::from(self.members[0].sample.side);
        // By pixel: disparity of the farthest of all members' nearest skins, and of the nearest surface.
        let mut void: [Vec<f64>; 6] = std::array::from_fn(|_| vec![f64::INFINITY; pixels]);
        let mut valid = blank();
        let is_void = |void: &[f64], valid: &[f64], pixel| void[pixel] > valid[pixel] * before;
        let mut left = [(); 6].map(|()| Wanted::new(side, |_| true));
        for member in &nearest_first {
            let projection =
                Projection::new(member.sample.eye, &member.surfaces.corners, eye, side);
            let mut skin = blank();
            projection.draw(&member.surfaces.skins, &left, side, &mut skin, nearest);
            for (void, skin) in void.iter_mut().zip(&skin) {
                void.iter_mut().zip(skin).for_each(|(void, skin)| *void = void.min(*skin));
            }
            let of_face = |face: usize, valid: &[Vec<f64>; 6]| {
                Wanted::new(side, |pixel| is_void(&void[face], &valid[face], pixel))
            };
            left = std::array::from_fn(|face| of_face(face, &valid));
            projection.draw(&member.surfaces.valid, &left, side, &mut valid, nearest);
            left = std::array::from_fn(|face| of_face(face, &valid));
            if left.iter().all(Wanted::is_empty) {
                return nothing;
            }
        }
        let of_face = |(void, valid): (&Vec<f64>, &Vec<f64>)| {
            (0..pixels).filter(|&pixel| is_void(void, valid, pixel)).collect::<Vec<_>>()
        };
        let seen = void.iter().zip(&valid).flat_map(of_face);
        seen.fold(nothing, |sum, pixel| {
            let (x, y) = (pixel as u32 % side, pixel as u32 / side);
            Measure { steradians: sum.steradians + solid_angle(side, x, y), pixels: sum.pixels + 1 }
        })
    }
}

#[cfg(test)]
mod tests;
