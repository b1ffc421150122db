//! `demo`: the main job with nothing to prepare.

use super::exit::{Failure, IO, OrExit};
use super::replay::{self, RunOptions, word};
use super::say::{say, tell};
use super::{bake::bake_file, path, scene_file};
use ::bake::synth::{Kind, generate, write_glb};
use anyhow::Context;
use coordinator::camera_path::{PathKind, write_csv};
use coordinator::config::{Every, Pictures, Size};
use coordinator::log::table::table;
use protocol::file;
use protocol::settings::BackendChoice;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder for the scene, the path and the run
    #[arg(long, value_name = "DIR", default_value = "out/demo", env = "OCCLUSTER_OUT")]
    out: PathBuf,
    /// Triangles of the plant
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    triangles: u64,
    /// Frames of the walk
    #[arg(long, value_name = "N", default_value_t = 120, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "640x360")]
    size: Size,
    /// auto, gpu or cpu
    #[arg(long, default_value = "auto", env = "OCCLUSTER_BACKEND", value_parser = word::<BackendChoice>)]
    backend: BackendChoice,
}

pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let name = || format!("cannot make the folder {}", args.out.display());
    std::fs::create_dir_all(&args.out).with_context(name).or_exit(IO)?;
    let place = |name: &str| file::place(&args.out.join(name), || []).map_err(Failure::of_output);
    let (glb, occ, csv) = (place("plant.glb")?, place("plant.occ")?, place("walk.csv")?);

    tell(format_args!("1/4 building a plant of {} triangles\n", args.triangles));
    write_glb(&generate(Kind::Plant, Some(args.triangles), 1), &glb).or_exit(IO)?;
    tell("2/4 baking it\n");
    let baked = bake_file(std::slice::from_ref(&glb), &occ, &::bake::Options::default())?;
    tell(format_args!("3/4 planning a walk of {} frames\n", args.frames));
    let poses = path::poses(&scene_file::open(&occ)?, PathKind::Walk, args.frames, 1)?;
    write_csv(&csv, &poses).or_exit(IO)?;
    tell("4/4 replaying it with three processes\n");
    let (summary, out) = replay::replay(replay::Args {
        scene: occ,
        path: Some(csv),
        out: Some(args.out.join("run")),
        options: RunOptions {
            backend: Some(args.backend),
            size: Some(args.size),
            audit: Some(Every(10)),
            pictures: Some(Pictures::Png),
            ..RunOptions::default()
        },
        ..replay::Args::default()
    })?;

    say(format_args!("{baked}\n{}", replay::with_places(table(&summary), out.as_deref())))
}
