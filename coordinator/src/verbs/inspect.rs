//! `inspect`: what is in a scene file.

use super::exit::Failure;
use super::say::{say, say_json};
use super::scene_file;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The scene file
    #[arg(value_name = "SCENE.occ")]
    scene: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let store = scene_file::open(&args.scene)?;
    let inspection = protocol::format::inspect::summary(store.skeleton());
    if args.json { say_json(&inspection) } else { say(inspection) }
}
