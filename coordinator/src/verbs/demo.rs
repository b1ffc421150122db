//! `demo`: the main job with nothing to prepare.

use super::exit::{Failure, IO, OrExit};
use super::replay::{self, RunOptions, word};
use super::say::say;
use super::{bake::bake_file, path, scene_file};
use ::bake::synth::{Kind, generate, write_glb};
use anyhow::Context;
use coordinator::camera_path::{PathKind, write_csv};
use coordinator::config::{Every, Pictures, Size};
use coordinator::log::table::table;
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
    let (glb, occ, csv) =
        (args.out.join("plant.glb"), args.out.join("plant.occ"), args.out.join("walk.csv"));

    eprintln!("1/4 building a plant of {} triangles", args.triangles);
    write_glb(&generate(Kind::Plant, Some(args.triangles), 1), &glb).or_exit(IO)?;
    eprintln!("2/4 baking it");
    let baked = bake_file(std::slice::from_ref(&glb), &occ, &::bake::Options::default())?;
    eprintln!("3/4 planning a walk of {} frames", args.frames);
    let poses = path::poses(&scene_file::open(&occ)?, PathKind::Walk, args.frames, 1)?;
    write_csv(&csv, &poses).or_exit(IO)?;
    eprintln!("4/4 replaying it with three processes");
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
