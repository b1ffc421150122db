//! Where to take samples (paper 000, sections 3.2, 3.4 and 3.5): at the corners of the region, then, again and
//! again, at the candidate from which most of the void surface is seen, until that is little.

use crate::adjacency::{Adjacency, Tests};
use crate::objective::Group;
use crate::sample::Sample;
use crate::voronoi::{self, APART};
use glam::{DVec2, DVec3};

/// Takes samples of a scene.
pub trait Source {
    /// Why a sample could not be taken.
    type Error;
    /// The sample at a viewpoint.
    fn sample(&mut self, eye: DVec3) -> Result<Sample, Self::Error>;
}

/// Where viewpoints may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Region {
    /// A rectangle at one height: someone who walks.
    Rectangle {
        /// Least coordinates.
        min: DVec3,
        /// Greatest coordinates; along `up` the same.
        max: DVec3,
        /// The axis that points up.
        up: usize,
    },
    /// A box.
    Box {
        /// Least coordinates.
        min: DVec3,
        /// Greatest coordinates.
        max: DVec3,
    },
}

impl Region {
    /// Least and greatest coordinates.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        match *self {
            Self::Rectangle { min, max, .. } | Self::Box { min, max } => (min, max),
        }
    }

    /// The region without a part of its extent along each axis, half of it at either end.
    pub fn inset(&self, part: f64) -> Self {
        let (min, max) = self.bounds();
        let by = (max - min) * 0.5 * part;
        let (low, high) = (min + by, max - by);
        match *self {
            Self::Rectangle { up, .. } => Self::Rectangle { min: low, max: high, up },
            Self::Box { .. } => Self::Box { min: low, max: high },
        }
    }

    /// The axes along which viewpoints differ.
    pub fn axes(&self) -> Vec<usize> {
        match *self {
            Self::Rectangle { up, .. } => (0..3).filter(|&axis| axis != up).collect(),
            Self::Box { .. } => vec![0, 1, 2],
        }
    }

    /// `k` viewpoints along each axis, from border to border; the middle if `k` is 1.
    pub fn grid(&self, k: usize) -> Vec<DVec3> {
        let (min, max) = self.bounds();
        let axes = self.axes();
        let along = |axis: usize, place: usize| match k {
            1 => 0.5 * (min[axis] + max[axis]),
            _ => min[axis] + (max[axis] - min[axis]) * place as f64 / (k - 1) as f64,
        };
        let eye = |place: usize| {
            let mut eye = min;
            let mut rest = place;
            for &axis in &axes {
                eye[axis] = along(axis, rest % k);
                rest /= k;
            }
            eye
        };
        (0..k.pow(axes.len() as u32)).map(eye).collect()
    }

    /// The four or eight corners.
    pub fn corners(&self) -> Vec<DVec3> {
        self.grid(2)
    }

    /// Where the next sample may be taken, given where samples were.
    pub fn candidates(&self, eyes: &[DVec3]) -> Vec<DVec3> {
        let (min, max) = self.bounds();
        let &[x, y] = &self.axes()[..] else { return voronoi::in_box(min, max, eyes) };
        let flat = |p: &DVec3| DVec2::new(p[x], p[y]);
        let sites: Vec<DVec2> = eyes.iter().map(flat).collect();
        let found = voronoi::in_rectangle(flat(&min), flat(&max), &sites);
        let lifted = |p: DVec2| {
            let mut at = min;
            (at[x], at[y]) = (p.x, p.y);
            at
        };
        found.into_iter().map(lifted).collect()
    }
}

/// When to stop, and how finely to look.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Void surface that may be seen, in steradians: the paper's epsilon.
    pub epsilon_sr: f64,
    /// Samples to take at most, corners included; the corners are taken in any case.
    pub budget: usize,
    /// Part of the region's extent that is kept free of viewpoints, so that the corners lie inside.
    pub inset: f64,
    /// Pixels along a side of a face in which void surface is counted.
    pub side: u32,
    /// When neighbouring pixels show one surface.
    pub tests: Tests,
}

impl Default for Settings {
    fn default() -> Self {
        Self { epsilon_sr: 0.2, budget: 64, inset: 0.02, side: 64, tests: Tests::default() }
    }
}

/// The samples of a region.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// In the order in which they were taken, each with its adjacency in the whole group.
    pub samples: Vec<(Sample, Adjacency)>,
    /// The greatest void surface seen from any candidate, in steradians: first with the corners, then with each
    /// further sample. The last is less than epsilon, or the budget is spent.
    pub worst_sr: Vec<f64>,
}

/// Takes the samples of a region.
pub fn place<S: Source>(
    region: &Region,
    settings: &Settings,
    source: &mut S,
) -> Result<Placement, S::Error> {
    let region = region.inset(settings.inset);
    let mut group = Group::new(settings.tests);
    let mut eyes = region.corners();
    for &eye in &eyes {
        group.push(source.sample(eye)?);
    }
    let (min, max) = region.bounds();
    let mut search = Search { known: Vec::new(), near: APART * (max - min).length() };
    let mut worst_sr = Vec::new();
    loop {
        search.candidates(region.candidates(&eyes));
        let worst = search.worst(&group, settings);
        worst_sr.push(worst.map_or(0.0, |(_, seen)| seen));
        match worst {
            Some((eye, seen)) if seen >= settings.epsilon_sr && eyes.len() < settings.budget => {
                group.push(source.sample(eye)?);
                eyes.push(eye);
            }
            _ => return Ok(Placement { samples: group.into_parts(), worst_sr }),
        }
    }
}

/// The greatest void surface, in steradians, seen from any of some viewpoints if samples are taken at
/// others: what a placement is compared by.
pub fn worst_of<S: Source>(
    eyes: &[DVec3],
    viewpoints: &[DVec3],
    settings: &Settings,
    source: &mut S,
) -> Result<f64, S::Error> {
    let mut group = Group::new(settings.tests);
    for &eye in eyes {
        group.push(source.sample(eye)?);
    }
    let seen = viewpoints.iter().map(|&at| group.objective(at, settings.side).steradians);
    Ok(seen.fold(0.0, f64::max))
}

struct Candidate {
    eye: DVec3,
    /// What was seen from here by a group no larger than the present one.
    seen: f64,
    /// Whether it was the present one.
    fresh: bool,
}

/// Candidates and what they saw when last looked from. As a group grows less is seen, so an old
/// value serves as a bound, and only those that may be the greatest are looked from again.
struct Search {
    known: Vec<Candidate>,
    near: f64,
}

impl Search {
    /// Goes on to the candidates of a grown group; one that was there before keeps its bound.
    fn candidates(&mut self, eyes: Vec<DVec3>) {
        let known = std::mem::take(&mut self.known);
        let bound = |eye: DVec3| {
            let before = known.iter().find(|candidate| candidate.eye.distance(eye) <= self.near);
            before.map_or(f64::INFINITY, |candidate| candidate.seen)
        };
        self.known =
            eyes.into_iter().map(|eye| Candidate { eye, seen: bound(eye), fresh: false }).collect();
    }

    /// The candidate that sees most, the first of equals. Where a surface was taken back
    /// ([`Group`]) an old value may be too low, so nothing is called little on an old value.
    fn worst(&mut self, group: &Group, settings: &Settings) -> Option<(DVec3, f64)> {
        loop {
            let ahead = |a: &&mut Candidate, b: &&mut Candidate| a.seen.total_cmp(&b.seen);
            let top = self.known.iter_mut().rev().max_by(ahead)?;
            let found = (top.eye, top.seen);
            let next = match top.fresh {
                false => top,
                true if found.1 >= settings.epsilon_sr => return Some(found),
                true => match self.known.iter_mut().find(|candidate| !candidate.fresh) {
                    Some(stale) => stale,
                    None => return Some(found),
                },
            };
            next.seen = group.objective(next.eye, settings.side).steradians;
            next.fresh = true;
        }
    }
}

#[cfg(test)]
mod tests;
