//! `verify`: every checksum and invariant of a scene file; with `--deep`, its stored errors too.

use super::exit::Failure;
use super::say::{say, say_json};
use super::scene_file;
use scene::deep::{Deep, Effort, Slack};
use serde::Serialize;
use std::fmt::{Display, Formatter};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The scene file
    #[arg(value_name = "SCENE.occ")]
    scene: PathBuf,
    /// Hold every level against the original surface, at many samples
    #[arg(long)]
    deep: bool,
    /// Most samples of a level and of the original below it, each
    #[arg(long, value_name = "N", requires = "deep", default_value_t = Effort::default().samples)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..))]
    samples: u32,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What is said of a good file.
#[derive(Debug, Serialize)]
struct Report {
    scene: String,
    bytes: u64,
    meshes: u64,
    faces: u64,
    levels: u64,
    vertices: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    deep: Option<DeepReport>,
}

#[derive(Debug, Serialize)]
struct DeepReport {
    hlods: u64,
    levels: u64,
    originals: u64,
    samples: u64,
    violations: u64,
    slack: SlackReport,
    by_depth: Vec<SlackReport>,
}

/// Stored error over sampled distance: of `levels` with a distance, not of the `exact` ones.
#[derive(Debug, Serialize)]
struct SlackReport {
    levels: u64,
    exact: u64,
    median: f64,
    p90: f64,
    max: f64,
}

pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let store = scene_file::open(&args.scene)?;
    let verified =
        scene::verify::verify(&store).map_err(|error| Failure::of(error.kind(), error))?;
    let effort = Effort { samples: args.samples, ..Effort::default() };
    let deep = args.deep.then(|| scene::deep::deep(&store, &effort)).transpose();
    let deep = deep.map_err(|error| Failure::of(error.kind(), error))?;
    let report = Report {
        scene: args.scene.display().to_string(),
        bytes: verified.bytes,
        meshes: verified.meshes,
        faces: verified.faces,
        levels: verified.levels,
        vertices: verified.vertices,
        deep: deep.map(DeepReport::from),
    };
    if args.json { say_json(&report) } else { say(report) }
}

impl From<Deep> for DeepReport {
    fn from(deep: Deep) -> Self {
        Self {
            hlods: deep.hlods,
            levels: deep.levels,
            originals: deep.originals,
            samples: deep.samples,
            violations: 0,
            slack: deep.slack.into(),
            by_depth: deep.depths.into_iter().map(SlackReport::from).collect(),
        }
    }
}

impl From<Slack> for SlackReport {
    fn from(Slack { levels, exact, median, p90, max }: Slack) -> Self {
        Self { levels, exact, median, p90, max }
    }
}

impl Display for Report {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let Self { scene, meshes, faces, bytes, .. } = self;
        writeln!(f, "{scene}: good: {meshes} meshes, {faces} faces of scan cubes, {bytes} bytes")?;
        let Some(deep) = &self.deep else { return Ok(()) };
        writeln!(
            f,
            "errors: true at {} samples of {} levels of {} hlods; {} originals not measured",
            deep.samples, deep.levels, deep.hlods, deep.originals
        )?;
        writeln!(f, "stored error / sampled distance:")?;
        writeln!(f, "  depth   levels    exact   median      p90      max")?;
        for (depth, slack) in deep.by_depth.iter().enumerate() {
            writeln!(f, "  {depth:>5} {slack}")?;
        }
        writeln!(f, "    all {}", deep.slack)
    }
}

impl Display for SlackReport {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let Self { levels, exact, median, p90, max } = self;
        write!(f, "{levels:>8} {exact:>8} {median:>8.3} {p90:>8.3} {max:>8.3}")
    }
}
