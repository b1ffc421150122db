//! `synth`: generated scenes.

use super::exit::{Failure, IO, OrExit};
use super::say::say;
use ::bake::synth::{Kind, generate, write_glb};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// What to build
    #[arg(value_parser = kind)]
    kind: Kind,
    /// The GLB file to write
    #[arg(short, long, value_name = "FILE.glb")]
    output: PathBuf,
    /// About how many triangles [default: the kind's own full size]
    #[arg(long, value_name = "N")]
    triangles: Option<u64>,
    /// Seed of everything random
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn kind(text: &str) -> Result<Kind, String> {
    match text {
        "plant" => Ok(Kind::Plant),
        "pipes" => Ok(Kind::Pipes),
        "park" => Ok(Kind::Park),
        "city" => Ok(Kind::City),
        _ => Err("give plant, pipes, park or city".to_owned()),
    }
}

pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let model = generate(args.kind, args.triangles, args.seed);
    write_glb(&model, &args.output).or_exit(IO)?;
    let (name, objects) = (args.output.display(), model.nodes.len());
    say(format_args!("{name}: {} triangles, {objects} objects", model.triangles()))
}
