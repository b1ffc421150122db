//! Standard textured depth meshes: one sample a cell, its pixels all joined, skins and all. What paper 000
//! (section 5.4) compares itself with.

use crate::cube::{BakedCube, Viewpoints, faces};
use crate::field::{Cubes, FarField};
use crate::method::Method;
use crate::redundancy::{Tolerance, surviving};
use crate::sample::Sample;
use crate::select::Budget;
use protocol::format::Method as Number;
use protocol::format::Skeleton;
use scene::near_field::Cells;
use std::sync::Arc;

/// The method.
pub struct Tdm;

impl Method for Tdm {
    fn tag(&self) -> &'static str {
        "tdm"
    }

    fn number(&self) -> Number {
        Number::Tdm
    }

    fn open(
        &self,
        skeleton: Arc<Skeleton>,
        cells: Arc<Cells>,
        budget: Budget,
    ) -> Arc<dyn FarField> {
        Arc::new(Cubes::new(skeleton, cells, budget))
    }
}

/// The cube of one sample: a height field over all that it shows.
pub fn encode(sample: &Sample, viewpoints: &Viewpoints, tolerance_px: f64) -> BakedCube {
    let shown = surviving(sample, &[], &Tolerance::default());
    let faces = faces(sample, &shown, viewpoints, tolerance_px, &|_, _| true);
    BakedCube { eye: sample.eye, parent: None, faces }
}
