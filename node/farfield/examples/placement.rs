//! What it saves to choose viewpoints by Voronoi candidates (paper 000, sections 3.4 and 3.5, figure 8):
//! `cargo run --release -p farfield --example placement -- SCENE.occ [--side PX] [--samples N] [--cells N]
//! [--cell-triangles N] [--in-space]`.
//!
//! For cells along the default walk: the objective F over one fixed set of viewpoints, spread evenly and by chance
//! over the whole cell, after each Voronoi sample and for uniform grids. Of each size a grid has its best: samples from
//! border to border or in the middles of its fields, as many along all axes or one more along the longest. Then
//! how many samples Voronoi placement needs before F is as low as each grid makes it: levels at which a grid wastes
//! none. Between two numbers of samples nothing is interpolated.

use coordinator::camera_path::{PathKind, generate};
use farfield::capture::{CaptureError, OfCell, Studio};
use farfield::cells::{Cell, Division, cells_along, up_axis};
use farfield::objective::Group;
use farfield::placement::{Region, Settings, Source, place};
use glam::DVec3;
use protocol::camera::near_plane;
use protocol::settings::PictureSize;
use rand::{Rng, SeedableRng, rngs::StdRng};
use rayon::prelude::*;
use scene::backend::cpu::CpuBackend;
use scene::store::Store;
use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

/// Poses of the walk, its seed, and that of the places from which F is looked at.
const POSES: u32 = 240;
const SEED: u64 = 1;
/// Of these along each axis of a rectangle, and of a box.
const JUDGES: [usize; 2] = [7, 4];

struct Args {
    scene: PathBuf,
    /// Pixels along a side of a sample's faces.
    side: u32,
    /// Voronoi samples of a cell.
    samples: usize,
    /// Cells at most, evenly chosen of those along the walk.
    cells: usize,
    division: Division,
    in_space: bool,
}

impl Args {
    fn read() -> Result<Self, Box<dyn Error>> {
        let mut args = std::env::args_os().skip(1);
        let scene = PathBuf::from(args.next().ok_or("name a scene file")?);
        let division = Division::default();
        let mut read = Self { scene, side: 64, samples: 16, cells: 4, division, in_space: false };
        while let Some(name) = args.next() {
            let mut number = || -> Result<u32, Box<dyn Error>> {
                let text = args.next().and_then(|text| text.into_string().ok());
                Ok(text.ok_or("give a number")?.parse()?)
            };
            match name.to_str() {
                Some("--side") => read.side = number()?,
                Some("--samples") => read.samples = number()? as usize,
                Some("--cells") => read.cells = number()? as usize,
                Some("--cell-triangles") => read.division.most_triangles = number()?.into(),
                Some("--in-space") => read.in_space = true,
                _ => return Err(format!("what is {}?", name.display()).into()),
            }
        }
        Ok(read)
    }
}

/// F over the places from which it is looked at, steradians, with so many samples.
#[derive(Clone, Copy)]
struct Score {
    samples: usize,
    max: f64,
    mean: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::read()?;
    let store = Store::open(&args.scene)?;
    let skeleton = store.skeleton();
    let walk = generate(PathKind::Walk, skeleton, |blob| store.load_blob(blob), POSES, SEED)?;
    let eyes: Vec<DVec3> = walk.iter().map(|pose| pose.eye.into()).collect();
    let cells = cells_along(skeleton, &eyes, &args.division);
    let chosen = args.cells.min(cells.len());
    let size = PictureSize { width: args.side, height: args.side };
    let near = near_plane(skeleton) as f32;
    let backend = Box::new(CpuBackend::new(size));
    let mut studio = Studio::new(&store, backend, args.side, near)?;
    println!("{} of {} cells, faces of {} pixels", chosen, cells.len(), args.side);
    let mut found = Vec::new();
    for at in (0..chosen).map(|k| k * cells.len() / chosen) {
        let cell = &cells[at];
        let [x, y, z] = (cell.max - cell.min).to_array();
        println!("\ncell {at}, {x:.1} by {y:.1} by {z:.1}");
        found.push(measure(cell, up_axis(skeleton), &mut studio, &args)?);
    }
    println!();
    for (of, key) in KEYS {
        let levels: Vec<Option<f64>> = found.iter().flat_map(|found| found.ratios(key)).collect();
        let mut ratios: Vec<f64> = levels.iter().copied().flatten().collect();
        ratios.sort_by(f64::total_cmp);
        let below = levels.len() - ratios.len();
        print!("{of}: {} levels of grids of {LEAST} samples and more", ratios.len());
        if let [low, .., high] = ratios[..] {
            let middle = ratios[ratios.len() / 2];
            print!(", grid over Voronoi {low:.2} to {high:.2}, median {middle:.2}");
        }
        println!("; {below} below what {} samples reach", args.samples);
    }
    Ok(())
}

/// What is seen from one of the places, or on average.
type Key = fn(&Score) -> f64;
const KEYS: [(&str, Key); 2] = [("greatest F", |score| score.max), ("mean F", |score| score.mean)];
/// Smaller grids are coarse steps from the corners, where Voronoi placement begins.
const LEAST: usize = 9;

/// Scores of one cell, by number of samples.
struct Found {
    voronoi: Vec<Score>,
    grids: Vec<(String, Score)>,
}

impl Found {
    /// Whether no grid of as many samples or fewer makes F as low as this one.
    fn is_level(&self, at: usize, key: Key) -> bool {
        let (_, grid) = &self.grids[at];
        let others = self.grids.iter().enumerate().filter(|(other, _)| *other != at);
        let mut rivals = others.filter(|(_, (_, other))| other.samples <= grid.samples);
        rivals.all(|(_, (_, other))| key(other) > key(grid))
    }

    /// The fewest samples with which F is no greater than a level.
    fn needs<'a>(
        mut scores: impl Iterator<Item = &'a Score>,
        key: Key,
        level: f64,
    ) -> Option<usize> {
        scores.find(|score| key(score) <= level).map(|score| score.samples)
    }

    /// How many times the samples of Voronoi placement a grid has, at the levels of larger grids; none where those
    /// that there are do not suffice.
    fn ratios(&self, key: Key) -> Vec<Option<f64>> {
        let levels = (0..self.grids.len()).filter(|&at| self.is_level(at, key));
        let grids = levels.map(|at| &self.grids[at].1).filter(|grid| grid.samples >= LEAST);
        let ratio = |grid: &Score| {
            let needs = Self::needs(self.voronoi.iter(), key, key(grid));
            needs.map(|samples| grid.samples as f64 / samples as f64)
        };
        grids.map(ratio).collect()
    }

    fn print(&self) {
        println!(
            "  {:14} {:>11} {:>14} {:>9} {:>14}",
            "grid", "greatest F", "Voronoi needs", "mean", "Voronoi needs"
        );
        for (at, (name, grid)) in self.grids.iter().enumerate() {
            let needs = KEYS.map(|(_, key)| {
                let needs = Self::needs(self.voronoi.iter(), key, key(grid));
                match needs {
                    _ if !self.is_level(at, key) => "-".to_owned(),
                    Some(count) => format!("{count} ({:.2})", grid.samples as f64 / count as f64),
                    None => "more".to_owned(),
                }
            });
            println!(
                "  {name:14} {:11.3} {:>14} {:9.3} {:>14}",
                grid.max, needs[0], grid.mean, needs[1]
            );
        }
        for (of, key) in KEYS {
            let epsilon = Settings::default().epsilon_sr;
            let grids = self.grids.iter().map(|(_, grid)| grid);
            let both =
                [Self::needs(self.voronoi.iter(), key, epsilon), Self::needs(grids, key, epsilon)];
            let [voronoi, grid] =
                both.map(|needs| needs.map_or("more".to_owned(), |n| n.to_string()));
            println!("  for {of} of {epsilon} sr: Voronoi {voronoi}, grid {grid}");
        }
        for (of, key) in KEYS {
            let steps = self.voronoi.windows(2).map(|pair| key(&pair[1]) - key(&pair[0]));
            let rises: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
            let most = rises.iter().copied().fold(0.0, f64::max);
            println!("  {of} rises with {} samples, by {most:.3} at most", rises.len());
        }
    }
}

/// Places samples in one cell, both ways, and prints what they are worth.
fn measure(
    cell: &Cell,
    up: usize,
    studio: &mut Studio<'_>,
    args: &Args,
) -> Result<Found, CaptureError> {
    let region = cell.region(up, args.in_space);
    let axes = region.axes();
    let judges = judges(&region, &axes);
    let settings = Settings { epsilon_sr: 0.0, budget: args.samples, ..Settings::default() };
    let mut source = OfCell { studio, near: &cell.near };
    let began = Instant::now();
    let placed = place(&region, &settings, &mut source)?;
    let took = began.elapsed().as_secs_f64();
    println!("  {} placed in {took:.1} s", placed.samples.len());
    println!("  samples  greatest F      mean   detected");
    let mut group = Group::new(settings.tests);
    let mut found = Found { voronoi: Vec::new(), grids: Vec::new() };
    let first = placed.samples.len() + 1 - placed.worst_sr.len();
    for (sample, _) in &placed.samples {
        group.push(sample.clone());
        let Some(step) = group.samples().count().checked_sub(first) else { continue };
        let score = score(&group, &judges, settings.side);
        let detected = placed.worst_sr[step];
        println!("{:9} {:11.3} {:9.3} {detected:10.3}", score.samples, score.max, score.mean);
        found.voronoi.push(score);
    }
    for (counts, in_fields) in grids_up_to(2 * args.samples, &region, &axes) {
        let mut group = Group::new(settings.tests);
        for eye in grid(&region.inset(settings.inset), &axes, &counts, in_fields) {
            group.push(source.sample(eye)?);
        }
        let name = counts.iter().map(usize::to_string).collect::<Vec<_>>().join("x");
        let kind = if in_fields { "fields" } else { "borders" };
        found.grids.push((format!("{name} {kind}"), score(&group, &judges, settings.side)));
    }
    found.grids.sort_by_key(|(_, score)| score.samples);
    found.print();
    Ok(found)
}

/// From where F is looked at: one place in each field of a fine grid, by chance.
fn judges(region: &Region, axes: &[usize]) -> Vec<DVec3> {
    let (min, max) = region.bounds();
    let count = JUDGES[axes.len() - 2];
    let mut random = StdRng::seed_from_u64(SEED);
    let place = |rest: usize| {
        let mut rest = rest;
        let mut eye = min;
        for &axis in axes {
            let at = (rest % count) as f64 + random.random::<f64>();
            eye[axis] = min[axis] + (max[axis] - min[axis]) * at / count as f64;
            rest /= count;
        }
        eye
    };
    (0..count.pow(axes.len() as u32)).map(place).collect()
}

/// Numbers of samples along each axis, of no more than `most` samples in all: the same along all axes, or one more along the
/// longest. Each from border to border, and in the middles of fields.
fn grids_up_to(most: usize, region: &Region, axes: &[usize]) -> Vec<(Vec<usize>, bool)> {
    let (min, max) = region.bounds();
    let size = max - min;
    let longest = axes.iter().copied().max_by(|&a, &b| size[a].total_cmp(&size[b]));
    let of = |k: usize, more: usize| -> Vec<usize> {
        axes.iter().map(|&axis| if Some(axis) == longest { k + more } else { k }).collect()
    };
    let all = (2..most).flat_map(|k| [of(k, 0), of(k, 1)]);
    let some = all.filter(|counts| counts.iter().product::<usize>() <= most);
    some.flat_map(|counts| [(counts.clone(), false), (counts, true)]).collect()
}

fn grid(region: &Region, axes: &[usize], counts: &[usize], in_fields: bool) -> Vec<DVec3> {
    let (min, max) = region.bounds();
    let eye = |rest: usize| {
        let mut rest = rest;
        let mut eye = min;
        for (&axis, &count) in axes.iter().zip(counts) {
            let (at, count) = ((rest % count) as f64, count as f64);
            let part = if in_fields { (at + 0.5) / count } else { at / (count - 1.0) };
            eye[axis] = min[axis] + (max[axis] - min[axis]) * part;
            rest /= count as usize;
        }
        eye
    };
    (0..counts.iter().product()).map(eye).collect()
}

fn score(group: &Group, judges: &[DVec3], side: u32) -> Score {
    let seen: Vec<f64> =
        judges.par_iter().map(|&eye| group.objective(eye, side).steradians).collect();
    let max = seen.iter().copied().fold(0.0, f64::max);
    let mean = seen.iter().sum::<f64>() / seen.len() as f64;
    Score { samples: group.samples().count(), max, mean }
}
