//! `verify`: every checksum and invariant of a scene file.

use super::exit::{BAD_DATA, Failure, OrExit};
use super::say::say;
use super::scene_file;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The scene file
    #[arg(value_name = "SCENE.occ")]
    scene: PathBuf,
}

pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let store = scene_file::open(&args.scene)?;
    let verified = scene::verify::verify(&store).or_exit(BAD_DATA)?;
    let name = args.scene.display();
    say(format_args!("{name}: good: {} meshes, {} bytes", verified.blobs, verified.bytes))
}
