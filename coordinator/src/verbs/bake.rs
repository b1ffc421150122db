//! `bake`: source scene to scene file.

use super::exit::{CONFIG, Failure, OrExit};
use super::interrupt::{During, Work};
use super::say::{say, say_json};
use ::bake::Options;
use ::bake::progress::Bars;
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
    #[arg(long, value_name = "BYTES", value_parser = bytes)]
    memory: Option<u64>,
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
    options.memory = args.memory.unwrap_or(options.memory);
    options.seed = args.seed.unwrap_or(options.seed);
    let summary = bake_file(&args.inputs, &args.output, &options)?;
    if args.json { say_json(&summary) } else { say(summary) }
}

/// A number of bytes, with or without a unit.
fn bytes(text: &str) -> Result<u64, String> {
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let shift = match unit {
        "" | "B" => 0,
        "KiB" => 10,
        "MiB" => 20,
        "GiB" => 30,
        "TiB" => 40,
        _ => return Err("write bytes as 1048576, 64MiB or 1GiB".to_owned()),
    };
    let number: u64 = number.parse().map_err(|_| "write bytes as 64MiB or 1GiB".to_owned())?;
    number.checked_mul(1 << shift).ok_or_else(|| "too many bytes".to_owned())
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
