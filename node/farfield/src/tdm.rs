//! Standard textured depth meshes: one sample a cell, its pixels all joined, skins and all. What paper 000
//! (section 5.4) compares itself with.

use crate::cube::{BakedCube, Viewpoints, faces};
use crate::method::Method;
use crate::redundancy::{Tolerance, surviving};
use crate::sample::Sample;
use protocol::format::Method as Number;

/// The method.
pub struct Tdm;

impl Method for Tdm {
    fn tag(&self) -> &'static str {
        "tdm"
    }

    fn number(&self) -> Number {
        Number::Tdm
    }
}

/// The cube of one sample: a height field over all that it shows.
pub fn encode(sample: &Sample, viewpoints: &Viewpoints, tolerance_px: f64) -> BakedCube {
    let shown = surviving(sample, &[], &Tolerance::default());
    let faces = faces(sample, &shown, viewpoints, tolerance_px, &|_, _| true);
    BakedCube { eye: sample.eye, parent: None, faces }
}
