//! `path`: a camera path through a scene.

use super::exit::{Failure, IO, OrExit};
use super::say::say;
use super::scene_file;
use coordinator::camera_path::{GenerateError, PathKind, Pose, generate, write_csv};
use protocol::file;
use protocol::message::FailureKind;
use scene::store::{Store, StoreError};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The scene file
    #[arg(value_name = "SCENE.occ")]
    scene: PathBuf,
    /// The path to write
    #[arg(short, long, value_name = "PATH.csv")]
    output: PathBuf,
    /// walk: through free space; orbit: around; zoom: from far into the densest part; wander: through
    /// everything, walls included, looking all around
    #[arg(long, default_value = "walk")]
    kind: PathKind,
    /// Poses
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Seed of the route
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let output = file::place(&args.output, || [args.scene.clone()]).map_err(Failure::of_output)?;
    let store = scene_file::open(&args.scene)?;
    let poses = poses(&store, args.kind, args.frames, args.seed)?;
    write_csv(&output, &poses).or_exit(IO)?;
    say(format_args!("{}: {} poses", args.output.display(), poses.len()))
}

/// Poses of a generated path.
pub(super) fn poses(
    store: &Store,
    kind: PathKind,
    frames: u32,
    seed: u64,
) -> Result<Vec<Pose>, Failure> {
    let read = |blob| store.load_blob(blob);
    generate(kind, store.skeleton(), read, frames, seed).map_err(|error| {
        let kind = match &error {
            GenerateError::Blob { source, .. } => source.downcast_ref().map(StoreError::kind),
            GenerateError::EmptyScene | GenerateError::Geometry { .. } => None,
        };
        let context = format!("no path through {}", store.path().display());
        let error = anyhow::Error::new(error).context(context);
        Failure::of(kind.unwrap_or(FailureKind::BadData), error)
    })
}
