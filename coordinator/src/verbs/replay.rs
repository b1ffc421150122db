//! `replay`: a run along a camera path, and its log.

use super::exit::{BAD_DATA, CONFIG, Failure, IO, OTHER, OrExit, TRY_AGAIN, USAGE, code_of};
use super::interrupt::{During, Work};
use super::live::LiveLine;
use super::say::{say, say_json};
use super::{path, scene_file};
use anyhow::{Context, anyhow};
use coordinator::camera_path::{self, PathKind, Pose};
use coordinator::config::{
    Bytes, Every, Near, Pictures, PixelError, Processes, Rig, Size, Switch, Towards,
};
use coordinator::log::stats::Stats;
use coordinator::log::summary::Summary;
use coordinator::log::table::table;
use coordinator::log::{SceneFacts, write_all};
use coordinator::out_folder::{self, FolderError, OutFolder, frames_of};
use coordinator::run::{self as rig_run, RunError, RunPlan};
use protocol::camera::{Camera, near_plane};
use protocol::path_text;
use protocol::session::PHASE_LIMIT;
use protocol::session::coordinator::Policy;
use protocol::settings::{
    AuditAgainst, BackendChoice, Cull, FAR_CUBES, Far, PictureSize, Residency, RunSettings,
    Schedule,
};
use scene::store::Store;
use std::net::SocketAddr;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

/// Frames of the walk that is made where no path is given.
const DEFAULT_FRAMES: u32 = 120;
/// An item buffer is drawn for every n-th frame, to know how many hlods really have a visible pixel.
const ITEMS_EVERY: u32 = 8;

#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct Args {
    /// The scene file
    #[arg(value_name = "SCENE.occ")]
    pub(super) scene: PathBuf,
    /// Camera path (CSV) [default: a walk]
    #[arg(long, value_name = "PATH.csv")]
    pub(super) path: Option<PathBuf>,
    /// Rig file (TOML)
    #[arg(long, value_name = "RIG.toml", env = "OCCLUSTER_RIG")]
    pub(super) rig: Option<PathBuf>,
    /// Folder for summary, frames, trace, report and pictures
    #[arg(long, value_name = "DIR", env = "OCCLUSTER_OUT")]
    pub(super) out: Option<PathBuf>,
    #[command(flatten)]
    pub(super) options: RunOptions,
    /// Print the summary as JSON
    #[arg(long)]
    pub(super) json: bool,
}

/// What a run can be told; unset here, the rig file and then the default decide.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct RunOptions {
    /// auto, gpu or cpu
    #[arg(long, env = "OCCLUSTER_BACKEND", value_parser = word::<BackendChoice>)]
    pub(super) backend: Option<BackendChoice>,
    /// Picture size
    #[arg(long, value_name = "WxH", env = "OCCLUSTER_SIZE")]
    pub(super) size: Option<Size>,
    /// queries, boxes or off
    #[arg(long, env = "OCCLUSTER_CULL", value_parser = word::<Cull>)]
    pub(super) cull: Option<Cull>,
    /// Pixels by which a point may be seen away from its place; 0 draws the original geometry
    #[arg(long, value_name = "PX", env = "OCCLUSTER_LOD")]
    pub(super) lod: Option<PixelError>,
    /// Distance of the near plane, scene units [default: the path's, or a ten thousandth of how far the scene
    /// reaches]
    #[arg(long, value_name = "DISTANCE", env = "OCCLUSTER_NEAR")]
    pub(super) near: Option<Near>,
    /// Direction towards the sun, scene axes, of any length [default: 0.35,0.85,0.4]
    #[arg(long, value_name = "X,Y,Z", env = "OCCLUSTER_SUN", allow_hyphen_values = true)]
    pub(super) sun: Option<Towards>,
    /// 1 or 3
    #[arg(long, env = "OCCLUSTER_PROCESSES")]
    pub(super) processes: Option<Processes>,
    /// switch or rotate
    #[arg(long, env = "OCCLUSTER_SCHEDULE", value_parser = word::<Schedule>)]
    pub(super) schedule: Option<Schedule>,
    /// Compare pictures with and without culling: every=N or off
    #[arg(long, env = "OCCLUSTER_AUDIT")]
    pub(super) audit: Option<Every>,
    /// front: against what the frustum holds; scene: against all of the scene, and the levels against --lod
    #[arg(long, env = "OCCLUSTER_AUDIT_AGAINST", value_parser = word::<AuditAgainst>)]
    pub(super) audit_against: Option<AuditAgainst>,
    /// png or off
    #[arg(long, env = "OCCLUSTER_PICTURES", value_parser = word::<Pictures>)]
    pub(super) pictures: Option<Pictures>,
    /// Most memory for skeleton, geometry and textures, for each process: 64MiB, 1GiB [default: an eighth of the
    /// machine's for each node]
    #[arg(long, value_name = "BYTES", env = "OCCLUSTER_MEMORY")]
    pub(super) memory: Option<Bytes>,
    /// exact: a frame waits for what it needs; deadline: never, something coarser stands in
    #[arg(long, env = "OCCLUSTER_RESIDENCY", value_parser = word::<Residency>)]
    pub(super) residency: Option<Residency>,
    /// Read geometry before it is needed: on or off
    #[arg(long, env = "OCCLUSTER_PREFETCH", value_parser = word::<Switch>)]
    pub(super) prefetch: Option<Switch>,
    /// off, tdm or itdm: what stands in for what is far, in view cells that were baked with it
    #[arg(long, env = "OCCLUSTER_FAR", value_parser = word::<Far>)]
    pub(super) far: Option<Far>,
    /// Most cubes of a view cell that are drawn [default: 8]
    #[arg(long, value_name = "K", env = "OCCLUSTER_FAR_CUBES", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) far_cubes: Option<u32>,
    /// Most triangles of cubes in the frustum that are drawn
    #[arg(long, value_name = "N", env = "OCCLUSTER_FAR_TRIANGLES")]
    pub(super) far_triangles: Option<u64>,
    /// Let seats draw with different renderers; the pictures may then lack visible pixels
    #[arg(long, env = "OCCLUSTER_MIXED", value_parser = clap::builder::FalseyValueParser::new())]
    pub(super) mixed: bool,
    /// Time without any report after which a phase has failed [default: 60]
    #[arg(long, value_name = "SECONDS", env = "OCCLUSTER_PHASE_LIMIT")]
    pub(super) phase_limit: Option<NonZeroU32>,
    /// Show only the first N poses
    #[arg(long, value_name = "N", env = "OCCLUSTER_FRAMES", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) frames: Option<u32>,
}

/// Reads a word as the settings spell it.
pub(super) fn word<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_value(text.into()).map_err(|error| error.to_string())
}

pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let json = args.json;
    let scene = args.scene.clone();
    let (summary, out) = replay(args)?;
    if json {
        say_json(&summary)?;
    } else {
        say(with_places(table(&summary), out.as_deref()))?;
    }
    match summary.io.faults {
        0 => Ok(()),
        faults => Err(anyhow!(
            "{}: {faults} meshes could not be read and something coarser was shown, see the warnings; \
             copy or bake the file again",
            scene.display()
        ))
        .or_exit(BAD_DATA),
    }
}

/// The closing table and where the files are.
pub(super) fn with_places(mut table: String, out: Option<&Path>) -> String {
    if let Some(out) = out {
        table += &format!("{:<22}{}", "report", out.join("report.html").display());
    }
    table
}

/// Runs, writes the log where a folder was named, and returns the figures and that folder.
pub(super) fn replay(args: Args) -> Result<(Summary, Option<PathBuf>), Failure> {
    let rig = args.rig.as_deref().map(Rig::read).transpose().or_exit(CONFIG)?.unwrap_or_default();
    let store = scene_file::open(&args.scene)?;
    let mut poses = match &args.path {
        Some(path) => read_path(path)?,
        None => {
            path::poses(&store, PathKind::Walk, args.options.frames.unwrap_or(DEFAULT_FRAMES), 1)?
        }
    };
    poses.truncate(args.options.frames.map_or(usize::MAX, |frames| frames as usize));

    if let Some(Near(near)) = args.options.near.or(rig.near) {
        poses.iter_mut().for_each(|pose| pose.near = Some(near));
    }
    let near = near_plane(store.skeleton());
    let cameras = camera_path::cameras(&poses, near).or_exit(BAD_DATA)?;
    let settings = settings(&args, &rig, &store, cameras.len())?;
    let frames = settings.frames;
    let facts = facts(&args.scene, &store, &cameras);
    let memory_cap = args.options.memory.or(rig.memory).map(|Bytes(memory)| memory);
    let (policy, rig) = (policy(&args, &rig), rig_of(&args, &rig)?);
    let plan = RunPlan { settings, cameras, rig, policy, memory_cap };
    // From here on the command is not refused any more.
    let _folder = args.out.as_deref().map(|out| take_folder(out, &args, &plan)).transpose()?;
    let during = During::new(Work::Running);
    let mut live = LiveLine::new(frames);
    let record = rig_run::run(plan, &mut |phase| live.show(phase));
    live.clear();
    drop(during);
    let record = record.map_err(|error| {
        let code = match &error {
            RunError::Interrupted => OTHER,
            RunError::Failed { kind, .. } => code_of(*kind),
        };
        Failure { code, error: Some(error.into()) }
    })?;

    match &args.out {
        Some(out) => Ok((write_all(&record, &facts, out).or_exit(IO)?, args.out)),
        None => Ok((coordinator::log::figures(&record, &facts), None)),
    }
}

/// What this run puts up with.
fn policy(args: &Args, rig: &Rig) -> Policy {
    let seconds = args.options.phase_limit.or(rig.phase_limit);
    Policy {
        mixed: args.options.mixed || rig.mixed == Some(true),
        phase_limit: seconds.map_or(PHASE_LIMIT, |s| u64::from(s.get()) * 1_000_000_000),
    }
}

/// Where the nodes of this run live.
fn rig_of(args: &Args, rig: &Rig) -> Result<rig_run::Rig, Failure> {
    let processes = args.options.processes.or(rig.processes).map_or(3, |processes| processes.0);
    if processes == 1 {
        let threads = |controls, token| {
            let failed = |error: node::NodeError| RunError::Failed {
                kind: error.kind,
                reason: error.reason,
            };
            node::run_in_process(controls, token).map_err(failed)
        };
        return Ok(rig_run::Rig::Threads(Box::new(threads)));
    }
    let program =
        std::env::current_exe().context("cannot find the program's own file").or_exit(OTHER)?;
    let bind = rig.bind.unwrap_or(SocketAddr::from(([127, 0, 0, 1], 0)));
    Ok(rig_run::Rig::Children { program, bind })
}

pub(super) fn read_path(path: &Path) -> Result<Vec<Pose>, Failure> {
    camera_path::read_csv(path)
        .map_err(|error| Failure { code: error.exit_code(), error: Some(error.into()) })
}

fn settings(args: &Args, rig: &Rig, store: &Store, frames: usize) -> Result<RunSettings, Failure> {
    let o = &args.options;
    let pictures = o.pictures.or(rig.pictures).unwrap_or(Pictures::Off);
    let pictures_dir = match (pictures, &args.out) {
        (Pictures::Off, _) => None,
        (Pictures::Png, None) => {
            return Err(anyhow!("--pictures png needs a folder: add --out DIR")).or_exit(USAGE);
        }
        (Pictures::Png, Some(out)) => Some(frames_of(out)),
    };
    let absolute = |path: &Path| -> Result<String, Failure> {
        let name = || format!("cannot resolve {}", path.display());
        let path = std::path::absolute(path).with_context(name).or_exit(IO)?;
        Ok(path_text::to_text(&path))
    };
    let residency = o.residency.or(rig.residency).unwrap_or_default();
    // The three seats of one process share what it is given.
    let seats = if o.processes.or(rig.processes).is_some_and(|count| count.0 == 1) { 3 } else { 1 };
    let memory = o.memory.or(rig.memory).map(|Bytes(memory)| memory / seats);
    let far = o.far.or(rig.far).unwrap_or_default();
    node::check_memory(memory, store.skeleton(), residency, far).or_exit(CONFIG)?;
    let sun = o.sun.map(|Towards(sun)| sun).or(rig.sun).unwrap_or_default();
    node::check_sun(sun, store.skeleton(), far).or_exit(CONFIG)?;
    Ok(RunSettings {
        scene_path: absolute(&args.scene)?,
        scene_digest: store.digest(),
        size: o.size.or(rig.size).map_or(PictureSize { width: 640, height: 360 }, |size| size.0),
        lod_px: o.lod.or(rig.lod).map_or(1.0, |lod| lod.0),
        sun,
        cull: o.cull.or(rig.cull).unwrap_or_default(),
        schedule: o.schedule.or(rig.schedule).unwrap_or_default(),
        backend: o.backend.or(rig.backend).unwrap_or_default(),
        frames: frames as u32,
        audit_every: o.audit.or(rig.audit).map_or(0, |every| every.0),
        audit_against: o.audit_against.or(rig.audit_against).unwrap_or_default(),
        items_every: ITEMS_EVERY,
        memory,
        residency,
        prefetch: o.prefetch.or(rig.prefetch) != Some(Switch::Off),
        far,
        far_cubes: o.far_cubes.or(rig.far_cubes.map(NonZeroU32::get)).unwrap_or(FAR_CUBES),
        far_triangles: o.far_triangles.or(rig.far_triangles),
        pictures_dir: pictures_dir.as_deref().map(absolute).transpose()?,
    })
}

/// Makes and takes the folder of a run. A folder used again must not show an earlier run's pictures or figures
/// as this one's.
fn take_folder(out: &Path, args: &Args, plan: &RunPlan) -> Result<OutFolder, Failure> {
    let RunSettings { pictures_dir, frames, .. } = &plan.settings;
    let pictures = if pictures_dir.is_some() { *frames } else { 0 };
    let inputs = [Some(&args.scene), args.path.as_ref(), args.rig.as_ref()];
    let inputs: Vec<PathBuf> = inputs.into_iter().flatten().cloned().collect();
    let taken =
        out_folder::check(out, pictures, &inputs).and_then(|()| OutFolder::take(out, pictures));
    taken.map_err(|error| match error {
        FolderError::Output(error) => Failure::of_output(error),
        FolderError::Busy(_) => Failure { code: TRY_AGAIN, error: Some(error.into()) },
        FolderError::Io { .. } => Failure { code: IO, error: Some(error.into()) },
    })
}

fn facts(path: &Path, store: &Store, cameras: &[Camera]) -> SceneFacts {
    let skeleton = store.skeleton();
    SceneFacts {
        path: path.display().to_string(),
        hlods: skeleton.hlods.len() as u64,
        triangles: skeleton.info.source_triangles,
        objects: u64::from(skeleton.info.objects),
        near: Stats::of(cameras.iter().map(|camera| f64::from(camera.near))),
        digest: store.digest().iter().map(|byte| format!("{byte:02x}")).collect(),
    }
}
