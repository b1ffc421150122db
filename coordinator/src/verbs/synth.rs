//! `synth`: generated scenes.

use super::exit::{Failure, IO, OrExit, USAGE};
use super::say::say;
use ::bake::synth::{self, Kind, MAX_BUILDINGS, Model, generate, sprawl, write_glb, write_town};
use protocol::file;
use std::path::PathBuf;

/// Triangles of a town, unless asked for.
const TOWN_TRIANGLES: u64 = 20_000_000;
/// Side of a building's share of the ground, metres, unless the city's extent is asked for.
const BUILDING_PITCH: f64 = 15.0;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// What to build: plant, pipes, park, city, or town, the last of copies of another scene
    #[arg(value_parser = what)]
    kind: What,
    /// The GLB file to write
    #[arg(short, long, value_name = "FILE.glb")]
    output: PathBuf,
    /// About how many triangles; a town has at least as many [default: the kind's own full size]
    #[arg(long, value_name = "N")]
    triangles: Option<u64>,
    /// The scene that a town consists of
    #[arg(long, value_name = "FILE.glb")]
    from: Option<PathBuf>,
    /// A city of exactly so many buildings, each a plain box
    #[arg(long, value_name = "N", conflicts_with = "triangles", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_BUILDINGS)))]
    buildings: Option<u32>,
    /// Side of that city, metres [default: 15 times the root of the number of buildings]
    #[arg(long, value_name = "METRES", requires = "buildings", value_parser = metres)]
    extent: Option<f64>,
    /// Seed of everything random
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum What {
    Generated(Kind),
    Town,
}

fn what(text: &str) -> Result<What, String> {
    match text {
        "plant" => Ok(What::Generated(Kind::Plant)),
        "pipes" => Ok(What::Generated(Kind::Pipes)),
        "park" => Ok(What::Generated(Kind::Park)),
        "city" => Ok(What::Generated(Kind::City)),
        "town" => Ok(What::Town),
        _ => Err("give plant, pipes, park, city or town".to_owned()),
    }
}

fn metres(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(metres) if (1.0..=1e6).contains(&metres) => Ok(metres),
        _ => Err("give a number of metres from 1 to 1000000".to_owned()),
    }
}

pub(crate) fn run(mut args: Args) -> Result<(), Failure> {
    args.output = file::place(&args.output, || args.from.clone()).map_err(Failure::of_output)?;
    match (args.kind, &args.from, args.buildings) {
        (What::Town, Some(from), None) => {
            let triangles = args.triangles.unwrap_or(TOWN_TRIANGLES);
            let town = write_town(from, triangles, args.seed, &args.output)
                .map_err(|error| Failure { code: error.exit_code(), error: Some(error.into()) })?;
            let synth::Town { copies, objects, triangles } = town;
            let name = args.output.display();
            say(format_args!("{name}: {triangles} triangles, {objects} objects, {copies} copies"))
        }
        (What::Generated(Kind::City), None, Some(buildings)) => {
            let extent = args.extent.unwrap_or(BUILDING_PITCH * f64::from(buildings).sqrt());
            write(&sprawl(buildings, extent, args.seed), &args)
        }
        (What::Generated(kind), None, None) => {
            write(&generate(kind, args.triangles, args.seed), &args)
        }
        (What::Town, None, _) => {
            Err(usage("a town needs the scene that it consists of: --from FILE.glb"))
        }
        (_, Some(_), None) => Err(usage("--from goes with town alone")),
        (_, _, Some(_)) => Err(usage("--buildings goes with city alone")),
    }
}

fn usage(what: &'static str) -> Failure {
    Failure { code: USAGE, error: Some(anyhow::Error::msg(what)) }
}

fn write(model: &Model, args: &Args) -> Result<(), Failure> {
    write_glb(model, &args.output).or_exit(IO)?;
    let (name, objects) = (args.output.display(), model.nodes.len());
    say(format_args!("{name}: {} triangles, {objects} objects", model.triangles()))
}
