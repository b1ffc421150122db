//! Incremental textured depth meshes (paper 000, section 4): one cube a sample, each without what its
//! ancestors show, and without skins.

use crate::adjacency::{Adjacency, Tests};
use crate::cube::{BakedCube, Viewpoints, faces};
use crate::method::Method;
use crate::neighbours::Pixel;
use crate::redundancy::{Surviving, Tolerance, dilated, overlapping, surviving};
use crate::sample::Sample;
use crate::tree::DependencyTree;
use protocol::format::Method as Number;

/// The method.
pub struct Itdm;

impl Method for Itdm {
    fn tag(&self) -> &'static str {
        "itdm"
    }

    fn number(&self) -> Number {
        Number::Itdm
    }
}

/// Cubes of a group of samples, and what making them has come to.
#[derive(Debug, Clone, PartialEq)]
pub struct Encoded {
    /// The intra cube first, every other behind the one it depends on.
    pub cubes: Vec<BakedCube>,
    /// Points of the samples of these cubes that show something.
    pub points: u64,
    /// Of those, points of delta samples that an ancestor has seen.
    pub redundant: u64,
}

/// Encodes samples of one cell (sections 4.1 and 4.2). `keeps_all` leaves the redundant points where they
/// are, so that every cube is whole: what the removal is measured against. `goes_on` is asked after every cube; the rest
/// is not made once it says no.
pub fn encode(
    samples: &[Sample],
    viewpoints: &Viewpoints,
    tolerance_px: f64,
    keeps_all: bool,
    goes_on: impl Fn(&[BakedCube]) -> bool,
) -> Encoded {
    let eyes: Vec<_> = samples.iter().map(|sample| sample.eye).collect();
    let tree = DependencyTree::new(&eyes);
    let mut encoded = Encoded { cubes: Vec::new(), points: 0, redundant: 0 };
    let place_of = |sample: usize| tree.order.iter().position(|&other| other == sample);
    for &at in &tree.order {
        let sample = &samples[at];
        let ancestors: Vec<&Sample> =
            tree.ancestors(at).filter(|_| !keeps_all).map(|up| &samples[up]).collect();
        let pictures = sample.faces.iter().flat_map(|face| &face.disparity);
        let whole = pictures.filter(|disparity| **disparity > 0.0).count() as u64;
        let left = surviving(sample, &ancestors, &Tolerance::default());
        encoded.points += whole;
        encoded.redundant += whole - count(&left);
        let others = samples.iter().enumerate().filter(|(other, _)| *other != at);
        let others = others.map(|(_, other)| other);
        let adjacency =
            Adjacency::of_some(sample, others, &Tests::default(), &around(sample, &left));
        let joined = |a: Pixel, b: Pixel| {
            a.step_to(sample.side, b).is_some_and(|step| adjacency.adjacent(a, step))
        };
        let shown = overlapping(sample, &left, &joined);
        encoded.cubes.push(BakedCube {
            eye: sample.eye,
            parent: tree.parents[at].and_then(place_of),
            faces: faces(sample, &shown, viewpoints, tolerance_px, &joined),
        });
        if !goes_on(&encoded.cubes) {
            break;
        }
    }
    encoded
}

/// The pixels that meet at corners of those that survive or overlap, and the borders of faces.
fn around(sample: &Sample, surviving: &Surviving) -> Surviving {
    let mut around = dilated(sample, &dilated(sample, surviving));
    let last = sample.side - 1;
    for face in &mut around {
        for at in 0..sample.side {
            for (x, y) in [(at, 0), (at, last), (0, at), (last, at)] {
                face[sample.index(x, y)] = true;
            }
        }
    }
    around
}

fn count(surviving: &Surviving) -> u64 {
    surviving.iter().flatten().filter(|kept| **kept).count() as u64
}

#[cfg(test)]
mod tests;
