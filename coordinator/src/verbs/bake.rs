//! `bake`: source scene to scene file.

use super::exit::{BAD_DATA, CONFIG, Failure, IO, OrExit, TRY_AGAIN, UNAVAILABLE, USAGE};
use super::interrupt::{During, Work};
use super::replay::{read_path, word};
use super::say::{say, say_json};
use super::{path, scene_file};
use ::bake::far::{FarError, FarSummary, Settings};
use ::bake::import::references;
use ::bake::progress::Bars;
use ::bake::{Options, WorkError};
use anyhow::anyhow;
use coordinator::camera_path::{PathKind, Pose, cameras};
use coordinator::config::{Bytes, Near};
use protocol::camera::near_plane;
use protocol::file;
use protocol::format::Method;
use protocol::format::projected::is_side;
use protocol::settings::{BackendChoice, PictureSize};
use scene::backend::BackendError;
use scene::store::Store;
use std::path::{Path, PathBuf};

/// Poses of the walk whose cells get far fields where no path is given.
const WALKED_POSES: u32 = 240;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The source files (glTF, GLB, OBJ, PLY, STL); several become one scene
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// The scene file to write [default: of one input, its name with the ending .occ]
    #[arg(short, long, value_name = "SCENE.occ")]
    output: Option<PathBuf>,
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
    /// Name or number of the scene to read of a glTF that holds several [default: the one it names]
    #[arg(long, value_name = "SCENE")]
    scene: Option<String>,
    /// none, tdm or itdm: far fields for the view cells that people walk through; INPUT may be a baked
    /// scene then
    #[arg(long, value_name = "METHOD", default_value = "none", value_parser = method)]
    far: Method,
    /// Only for cells that this camera path visits [default: a generated walk]
    #[arg(long, value_name = "PATH.csv")]
    cells_along: Option<PathBuf>,
    /// Viewpoints at all heights of a cell, not only at that of the path
    #[arg(long)]
    far_in_space: bool,
    /// Pixels along a side of a sample's faces, a power of two
    #[arg(long, value_name = "PX", default_value_t = 512)]
    far_side: u32,
    /// Most samples of a cell
    #[arg(long, value_name = "N", default_value_t = 16)]
    far_samples: usize,
    /// Solid angle of what no sample saw that may be left, steradians
    #[arg(long, value_name = "SR", default_value_t = 0.2)]
    far_epsilon: f64,
    /// Keep cubes where geometry is cheaper, too
    #[arg(long)]
    far_always: bool,
    /// Keep what is redundant: every cube is whole
    #[arg(long)]
    far_all_intra: bool,
    /// Store normals, so that cubes can be drawn under another sun (replay --sun): twice the bytes of pictures
    #[arg(long)]
    far_relight: bool,
    /// Most triangles of the source in a view cell before it is divided
    #[arg(long, value_name = "N", default_value_t = ::bake::far::DEFAULT_CELL_TRIANGLES)]
    far_cell_triangles: u64,
    /// Distance of the near plane of samples, and of views where the path does not say, scene units [default: a
    /// ten thousandth of how far the scene reaches]
    #[arg(long, value_name = "DISTANCE", env = "OCCLUSTER_NEAR")]
    near: Option<Near>,
    /// The renderer that takes samples: auto, gpu or cpu. The same bytes everywhere come of cpu alone
    #[arg(long, default_value = "cpu", value_parser = word::<BackendChoice>)]
    backend: BackendChoice,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

fn method(text: &str) -> Result<Method, String> {
    match text {
        "none" => Ok(Method::None),
        "tdm" => Ok(Method::Tdm),
        "itdm" => Ok(Method::Itdm),
        other => Err(format!("`{other}` is not none, tdm or itdm")),
    }
}

pub(crate) fn run(args: Args) -> Result<(), Failure> {
    if !is_side(args.far_side) {
        let reason = anyhow!("--far-side {}: give a power of two from 16 to 4096", args.far_side);
        return Err(reason).or_exit(USAGE);
    }
    let output = place(&args)?;
    let mut options = match &args.config {
        Some(path) => Options::from_file(path).or_exit(CONFIG)?,
        None => Options::default(),
    };
    options.jobs = args.jobs.unwrap_or(options.jobs);
    options.memory = args.memory.map_or(options.memory, |memory| memory.0);
    options.seed = args.seed.unwrap_or(options.seed);
    options.scene = args.scene.clone().unwrap_or(options.scene);
    if args.far == Method::None {
        let summary = bake_file(&args.inputs, &output, &options)?;
        return if args.json { say_json(&summary) } else { say(summary) };
    }
    let is_baked = args.inputs.len() == 1
        && args.inputs[0].extension().is_some_and(|extension| extension == "occ");
    let poses = args.cells_along.as_deref().map(read_path).transpose()?;
    let summary = if is_baked {
        add_far(&args, &options, &args.inputs[0], &output, poses)?
    } else {
        let plain = ::bake::plain_scene(&output).or_exit(IO)?;
        forget_damaged(&plain);
        bake_file(&args.inputs, &plain, &options).inspect_err(|_| {
            // It goes where nothing is kept in it.
            let _ = std::fs::remove_dir(::bake::far_folder(&output));
        })?;
        add_far(&args, &options, &plain, &output, poses)?
    };
    if args.json { say_json(&summary) } else { say(summary) }
}

/// Where the scene goes, which is no place of anything that it is made from.
fn place(args: &Args) -> Result<PathBuf, Failure> {
    let named = match (&args.output, &args.inputs[..]) {
        (Some(output), _) => output.clone(),
        (None, [input]) => input.with_extension("occ"),
        (None, _) => {
            return Err(anyhow!("several inputs: name the scene file, -o SCENE.occ"))
                .or_exit(USAGE);
        }
    };
    // A file that cannot be read refers to nothing; why it cannot, the bake will tell.
    let referred = |input: &PathBuf| match file::open(input) {
        Ok(_) => references(input).unwrap_or_default(),
        Err(_) => Vec::new(),
    };
    let inputs = || {
        let others = args.config.iter().chain(&args.cells_along);
        let all = args.inputs.iter().chain(others).cloned();
        all.chain(args.inputs.iter().flat_map(referred)).collect::<Vec<_>>()
    };
    let output = file::place(&named, inputs).map_err(Failure::of_output)?;
    for folder in [::bake::working_folder(&output), ::bake::far_folder(&output)] {
        if let Some(input) = args.inputs.iter().find(|input| is_below(input, &folder)) {
            return Err(anyhow!(
                "{}: lies in {}, which goes once the scene is there; copy it to another place",
                input.display(),
                folder.display()
            ))
            .or_exit(USAGE);
        }
    }
    Ok(output)
}

/// Whether a file lies in a folder or below it.
fn is_below(file: &Path, folder: &Path) -> bool {
    match (file.canonicalize(), folder.canonicalize()) {
        (Ok(file), Ok(folder)) => file.starts_with(folder),
        _ => false,
    }
}

/// Removes a scene that was kept and is not as it was written: it is made again.
fn forget_damaged(kept: &Path) {
    if let Ok(store) = Store::open(kept)
        && scene::verify::verify(&store).is_err()
    {
        // Where it stays, the damage is found when far fields are added.
        let _ = std::fs::remove_file(kept);
    }
}

/// Adds far fields to the scene at `baked`, for the cells of `poses` or of a walk.
fn add_far(
    args: &Args,
    options: &Options,
    baked: &Path,
    output: &Path,
    poses: Option<Vec<Pose>>,
) -> Result<FarSummary, Failure> {
    let kept = ::bake::far_folder(output);
    let what = format!("{} with far fields", output.display());
    let _during = During::new(Work::Baking { what, kept });
    let store = scene_file::open(baked)?;
    let poses = match poses {
        Some(poses) => poses,
        None => path::poses(&store, PathKind::Walk, WALKED_POSES, 1)?,
    };
    let near = args.near.map_or_else(|| near_plane(store.skeleton()), |near| near.0);
    drop(store);
    let views = cameras(&poses, near).or_exit(BAD_DATA)?;
    let mut settings = Settings::new(args.far, views, near as f32);
    (settings.side, settings.in_space) = (args.far_side, args.far_in_space);
    (settings.samples, settings.epsilon_sr) = (args.far_samples, args.far_epsilon);
    (settings.always, settings.relight) = (args.far_always, args.far_relight);
    (settings.all_intra, settings.search_side) = (args.far_all_intra, args.far_side.min(128));
    settings.division.most_triangles = args.far_cell_triangles;
    let mut make = |side: u32| {
        let size = PictureSize { width: side, height: side };
        // One renderer looks for viewpoints, one takes the samples.
        node::choose_backend(args.backend, size, options.memory / 2)
            .map_err(|error| BackendError::NoAdapter(error.to_string()))
    };
    let work = || ::bake::far::add_far(baked, output, &settings, &mut make, &Bars::default());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(options.jobs).build();
    pool.or_exit(UNAVAILABLE)?.install(work).map_err(|error| match error {
        FarError::Work(WorkError::Busy { .. }) => {
            Failure { code: TRY_AGAIN, error: Some(error.into()) }
        }
        _ => Failure::of(error.kind(), error),
    })
}

/// Bakes with progress bars on a terminal.
pub(super) fn bake_file(
    inputs: &[PathBuf],
    output: &Path,
    options: &Options,
) -> Result<::bake::Summary, Failure> {
    let kept = ::bake::working_folder(output);
    let _during = During::new(Work::Baking { what: output.display().to_string(), kept });
    ::bake::bake(inputs, output, options, &Bars::default()).map_err(refused)
}

/// Why sources make no scene, with the code for it.
pub(super) fn refused(error: ::bake::BakeError) -> Failure {
    Failure { code: error.exit_code(), error: Some(error.into()) }
}
