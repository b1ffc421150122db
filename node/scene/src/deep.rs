//! Whether the errors that a scene file stores are true: the `--deep` part of the `verify` verb.
//!
//! Every level but the original is held against the original surface below its hlod, both ways, at
//! many samples. A sample proves nothing good, but one that lies farther away than the stored error
//! proves that error false; this shares no code with the bake but the distance to a triangle.

mod leaves;
mod samples;

use crate::store::{Store, StoreError};
use geometry::hausdorff::Surface;
use leaves::Leaves;
use protocol::format::{Hlod, Level, NONE};
use protocol::id::HlodId;
use protocol::message::FailureKind;
use rayon::prelude::*;
use std::path::PathBuf;

/// Deviations below this share of the scene's diagonal say nothing about slack.
const LEAST_DEVIATION: f64 = 1e-9;
/// Rounding that a sampled distance is forgiven, as a share of the greatest term it is made of:
/// placing a vertex is off by less than 6u in each coordinate on either side ([`crate::verify`]),
/// a sample between vertices and the distance itself by less than 10u: below 32u = 16 EPSILON.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// How deep to look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Most samples of a level and of the original below it, each.
    pub samples: u32,
    /// Most bytes of search trees kept for use again.
    pub cache_bytes: usize,
}

impl Default for Effort {
    fn default() -> Self {
        Self { samples: 20_000, cache_bytes: 512 << 20 }
    }
}

/// What was found: no sample beyond its level's error.
#[derive(Debug, Clone, PartialEq)]
pub struct Deep {
    /// Hlods with a level that was measured.
    pub hlods: u64,
    /// Levels that were measured.
    pub levels: u64,
    /// Levels that are the original itself, up to the grid they lie on: nothing to measure.
    pub originals: u64,
    /// Samples, both ways.
    pub samples: u64,
    /// Stored error over sampled distance.
    pub slack: Slack,
    /// The same by depth in the tree, the root's first; depths without a measured level included.
    pub depths: Vec<Slack>,
}

/// How many times the sampled distance the stored errors are.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Slack {
    /// Levels with a quotient.
    pub levels: u64,
    /// Levels without, since no sample is farther away than 10^-9 of the scene's diagonal.
    pub exact: u64,
    /// Half of the levels have no more than this; 0 if there are none.
    pub median: f64,
    /// Nine tenths have no more than this.
    pub p90: f64,
    /// None has more.
    pub max: f64,
}

/// An error that is not true, or a file that cannot be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DeepError {
    /// A blob is damaged or cannot be read.
    #[error(transparent)]
    Blob(#[from] StoreError),
    /// A level strays farther than it says.
    #[error(
        "{}: level {level} of hlod {hlod} says it is within {stored:.6e} of the original, but a sample \
         is {found:.6e} away ({violations} of {levels} levels are wrong); bake the scene again",
        path.display()
    )]
    Beyond {
        /// The file.
        path: PathBuf,
        /// The first hlod with such a level.
        hlod: HlodId,
        /// Which of the hlod's levels, 0 the finest.
        level: u32,
        /// Its error, scene units.
        stored: f64,
        /// The greatest distance among the samples, scene units.
        found: f64,
        /// How many levels are wrong.
        violations: u64,
        /// How many were measured.
        levels: u64,
    },
}

impl DeepError {
    /// The class, which decides the exit code.
    pub fn kind(&self) -> FailureKind {
        match self {
            Self::Blob(error) => error.kind(),
            Self::Beyond { .. } => FailureKind::BadData,
        }
    }
}

/// The original surface of a file, to hold points against.
pub struct Original<'a>(Leaves<'a>);

impl<'a> Original<'a> {
    /// That of `store`; at most `cache_bytes` of search trees are kept.
    pub fn new(store: &'a Store, cache_bytes: usize) -> Self {
        Self(Leaves::new(store, cache_bytes))
    }

    /// Distance of a point to the original surface below an hlod, scene units.
    pub fn distance(&self, below: HlodId, point: [f64; 3]) -> Result<f64, StoreError> {
        Ok(self.0.farthest(below, &[point.into()])?.0)
    }
}

/// The surface of one level.
pub struct LevelSurface(Surface);

impl LevelSurface {
    /// That of `level`.
    pub fn new(store: &Store, level: &Level) -> Result<Self, StoreError> {
        Ok(Self(Surface::of_triangles(leaves::placed(store, level)?.triangles.into_iter())))
    }

    /// Distance of a point to it, scene units.
    pub fn distance(&self, point: [f64; 3]) -> f64 {
        self.0.exact_distance(point.into(), 0.0, &mut 0)
    }
}

/// A level held against the original.
#[derive(Debug, Clone, Copy)]
struct Measured {
    hlod: HlodId,
    level: u32,
    depth: u32,
    stored: f64,
    found: f64,
    rounding: f64,
    samples: u64,
}

/// Measures every level of a file that has passed [`crate::verify::verify`]. Of several faults the
/// same one is always reported, and the numbers are the same whatever the threads do.
pub fn deep(store: &Store, effort: &Effort) -> Result<Deep, DeepError> {
    let skeleton = store.skeleton();
    let mut depths: Vec<u32> = Vec::with_capacity(skeleton.hlods.len());
    for hlod in &skeleton.hlods {
        depths.push(if hlod.parent == NONE { 0 } else { depths[hlod.parent as usize] + 1 });
    }
    let leaves = Leaves::new(store, effort.cache_bytes);
    let mut results: Vec<Result<Vec<Measured>, StoreError>> = Vec::new();
    let each = skeleton.hlods.par_iter().enumerate().map(|(i, hlod)| {
        let first = u32::from(is_leaf(hlod));
        let levels = skeleton.levels_of(hlod).iter().zip(0..).skip(first as usize);
        let measured = levels.map(|(level, index)| {
            let id = HlodId(i as u32);
            let (found, rounding, samples) = measure(store, &leaves, id, level, effort.samples)?;
            let (depth, stored) = (depths[i], level.error);
            Ok(Measured { hlod: id, level: index, depth, stored, found, rounding, samples })
        });
        measured.collect()
    });
    each.collect_into_vec(&mut results);
    let by_hlod = results.into_iter().collect::<Result<Vec<_>, _>>()?;
    let measured: Vec<Measured> = by_hlod.iter().flatten().copied().collect();

    let mut wrong = measured.iter().filter(|m| m.found > m.stored + m.rounding).peekable();
    if let Some(&&Measured { hlod, level, stored, found, .. }) = wrong.peek() {
        let (violations, levels) = (wrong.count() as u64, measured.len() as u64);
        let path = store.path().to_path_buf();
        return Err(DeepError::Beyond { path, hlod, level, stored, found, violations, levels });
    }
    let least = skeleton.diagonal() * LEAST_DEVIATION;
    let deepest = depths.iter().fold(0, |most, depth| *depth.max(&most));
    let at = |depth| measured.iter().filter(move |m| m.depth == depth);
    Ok(Deep {
        hlods: by_hlod.iter().filter(|levels| !levels.is_empty()).count() as u64,
        levels: measured.len() as u64,
        originals: skeleton.hlods.iter().filter(|hlod| is_leaf(hlod)).count() as u64,
        samples: measured.iter().map(|m| m.samples).sum(),
        slack: slack_of(measured.iter(), least),
        depths: (0..=deepest).map(|depth| slack_of(at(depth), least)).collect(),
    })
}

fn is_leaf(hlod: &Hlod) -> bool {
    hlod.child_count == 0
}

/// The greatest distance of a sample, what rounding may have added to it, and the number of samples.
fn measure(
    store: &Store,
    leaves: &Leaves,
    id: HlodId,
    level: &Level,
    most: u32,
) -> Result<(f64, f64, u64), StoreError> {
    let coarse = leaves::placed(store, level)?;
    let of_coarse = samples::of_triangles(&coarse.triangles, most);
    let (out, reach) = leaves.farthest(id, &of_coarse)?;
    let of_original = samples::below(store, id, most)?;
    let surface = Surface::of_triangles(coarse.triangles.iter().copied());
    let mut hint = 0;
    let found = of_original
        .iter()
        .fold(out, |greatest, p| greatest.max(surface.exact_distance(*p, greatest, &mut hint)));
    let samples = (of_coarse.len() + of_original.len()) as u64;
    Ok((found, coarse.reach.max(reach) * ROUNDING, samples))
}

fn slack_of<'a>(measured: impl Iterator<Item = &'a Measured>, least: f64) -> Slack {
    let (told, exact): (Vec<&Measured>, Vec<_>) = measured.partition(|m| m.found > least);
    let mut quotients: Vec<f64> = told.iter().map(|m| m.stored / m.found).collect();
    quotients.sort_by(f64::total_cmp);
    // The least value that a share of all do not exceed.
    let ranked = |tenths: usize| {
        let rank = (quotients.len() * tenths).div_ceil(10).max(1);
        quotients.get(rank - 1).copied().unwrap_or(0.0)
    };
    let (median, p90, max) = (ranked(5), ranked(9), ranked(10));
    Slack { levels: told.len() as u64, exact: exact.len() as u64, median, p90, max }
}

#[cfg(test)]
mod tests;
