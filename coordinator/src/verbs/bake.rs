//! `bake`: source scene to scene file.

use super::exit::{CONFIG, Failure, OrExit};
use super::interrupt::{During, Work};
use super::say::{say, say_json};
use ::bake::Options;
use ::bake::progress::Bars;
use coordinator::config::Bytes;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The source files (glTF, GLB, OBJ, PLY, STL); several become one scene
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// The scene file to write
    #[arg(short, long, value_name = "SCENE.occ")]
    output: PathBuf,
    /// Bake settings (TOML)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Threads [default: one a core]
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Memory to work in, such as 512MiB [default: 1GiB]
    #[arg(long, value_name = "BYTES")]
    memory: Option<Bytes>,
    /// Seed of everything random
    #[arg(long)]
    seed: Option<u64>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let mut options = match &args.config {
        Some(path) => Options::from_file(path).or_exit(CONFIG)?,
        None => Options::default(),
    };
    options.jobs = args.jobs.unwrap_or(options.jobs);
    options.memory = args.memory.map_or(options.memory, |memory| memory.0);
    options.seed = args.seed.unwrap_or(options.seed);
    let summary = bake_file(&args.inputs, &args.output, &options)?;
    if args.json { say_json(&summary) } else { say(summary) }
}

/// Bakes with progress bars on a terminal.
pub(super) fn bake_file(
    inputs: &[PathBuf],
    output: &Path,
    options: &Options,
) -> Result<::bake::Summary, Failure> {
    let _during = During::new(Work::Baking(output.to_owned()));
    ::bake::bake(inputs, output, options, &Bars::default())
        .map_err(|error| Failure { code: error.exit_code(), error: Some(error.into()) })
}
