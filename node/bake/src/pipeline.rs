//! The whole bake: sources in, one scene file out, stage by stage. What a stage makes lies in the
//! working folder under the digest of what it was made from, so none is done twice.

use crate::built::{Subtree, Top};
use crate::bytes::{Decoder, Encoder};
use crate::hlod::{Builder, Tally};
use crate::import::{ImportError, ImportErrorKind, ImportLimits, import};
use crate::keys::{self, Keys};
use crate::levels::Setting;
use crate::options::{Options, OptionsError};
use crate::output::Output;
use crate::pack::Packed;
use crate::plan::{Pieces, Plan};
use crate::progress::Progress;
use crate::shared::{self, MadeLevel, SharedLevels, SharedWriter};
use crate::source::{Imported, Sink};
use crate::spool::{Scene, Spool};
use crate::summary::{self, StageSeconds, Summary};
use crate::work::{Key, Records, Work, WorkError};
use geometry::criteria::Criteria;
use protocol::format::{self, Rule, SceneInfo, WriteError};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Most source triangles of a subtree that is built as a whole before anything of it is written. The
/// file is the same for any value.
const MOST_BLOCK_TRIANGLES: u64 = 1 << 18;
/// Bytes that a subtree being built takes, by source triangle.
const BLOCK_BYTES: u64 = 1024;
/// Shared pieces whose levels are made before they are written.
const BATCH_PIECES: usize = 256;

/// Why a bake failed. Nothing is changed at the output's name.
#[derive(Debug, thiserror::Error)]
pub enum BakeError {
    /// A source cannot be read.
    #[error(transparent)]
    Import(#[from] ImportError),
    /// The settings are out of range.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// There is nothing to draw in any source.
    #[error(
        "{inputs}: no triangle is left to bake{because}; check that the scene has meshes with an area"
    )]
    Empty {
        /// The sources.
        inputs: String,
        /// What was left out, if anything.
        because: String,
    },
    /// The working folder cannot be used.
    #[error(transparent)]
    Work(WorkError),
    /// The scene file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The system gives no threads.
    #[error("cannot start {jobs} worker threads: {source}; try fewer with --jobs")]
    Threads {
        /// How many were asked for.
        jobs: usize,
        /// The system's reason.
        source: rayon::ThreadPoolBuildError,
    },
}

impl BakeError {
    /// The exit code of the program.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Import(error) => match error.kind() {
                ImportErrorKind::NotFound => 66,
                ImportErrorKind::Io => 74,
                ImportErrorKind::BadData => 65,
            },
            Self::Options(_) => 78,
            Self::Empty { .. } => 65,
            Self::Work(WorkError::Busy { .. }) => 75,
            Self::Work(WorkError::Io { .. }) => 74,
            Self::Write(WriteError::TooMany { .. }) => 65,
            // The source's fault, as what it places there.
            Self::Write(WriteError::Invalid { source, .. }) if source.rule == Rule::TooFar => 65,
            Self::Write(WriteError::Invalid { .. }) => 70,
            Self::Write(_) => 74,
            Self::Threads { .. } => 69,
        }
    }
}

/// Bakes all sources into one scene. The bytes written depend on sources and options alone, never on
/// the number of threads, the memory, or how often the bake was cut short. A scene that is already
/// there as it would become is left alone.
pub fn bake(
    inputs: &[PathBuf],
    output: &Path,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Summary, BakeError> {
    options.check()?;
    let mut clock = Clock::start();
    let keys = Keys::of_files(inputs, options)?;
    if let Some(summary) = summary::of_unchanged(output, &keys.scene) {
        Work::sweep(output);
        return Ok(summary);
    }
    let work = Work::open(output)?;
    progress.stage("import", inputs.len() as u64);
    let imported = imported(&work, inputs, options, &keys, progress);
    clock.seconds.import = clock.lap();
    let names: Vec<String> = inputs.iter().map(|input| input.display().to_string()).collect();
    let stored_key = keys.scene;
    let job = Job { name: names.join(", "), output, options, keys, stored_key, progress };
    let done = imported.and_then(|scene| job.run(&work, scene, clock));
    close(work, done)
}

/// Bakes a scene that is handed over piece by piece; `name` stands for it in messages. `fill` is
/// given the sink and returns what refers to its meshes and textures.
pub fn bake_scene(
    fill: impl FnOnce(&mut dyn Sink) -> std::io::Result<Imported>,
    name: &str,
    output: &Path,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Summary, BakeError> {
    options.check()?;
    let mut clock = Clock::start();
    let work = Work::open(output)?;
    work.forget("import");
    let mut spool = Spool::create(&work)?;
    let imported = fill(&mut spool).map_err(|e| WorkError::io(output, e))?;
    let scene = spool.finish(imported)?;
    clock.seconds.import = clock.lap();
    let keys = Keys::of_content(keys::unknown(), options);
    let job = Job { name: name.to_owned(), output, options, keys, stored_key: [0; 32], progress };
    let done = job.run(&work, scene, clock);
    close(work, done)
}

/// Takes the working folder away where nothing in it is of use any more.
fn close(work: Work, done: Result<Summary, BakeError>) -> Result<Summary, BakeError> {
    match done {
        Ok(_) => work.remove()?,
        // The source's fault, which is better told than that its traces cannot be removed.
        Err(BakeError::Import(_) | BakeError::Empty { .. }) => drop(work.remove()),
        Err(_) => {}
    }
    done
}

/// The imported scene, from the working folder or read now.
fn imported(
    work: &Work,
    inputs: &[PathBuf],
    options: &Options,
    keys: &Keys,
    progress: &dyn Progress,
) -> Result<Scene, BakeError> {
    // Without textures nobody reads the meshes any more once there are pieces.
    let is_usable = |scene: &Scene| {
        scene.is_whole(work) || scene.textures.is_empty() && kept_pieces(work, keys).is_some()
    };
    if let Some(scene) = loaded(work, "import", &keys.import, Scene::decode).filter(is_usable) {
        return Ok(scene);
    }
    // Its meshes are overwritten.
    work.forget("import");
    let scene = import_all(work, inputs, options, progress)?;
    work.save("import", &keys.import, &scene.encode())?;
    Ok(scene)
}

/// The pieces that are in the working folder.
fn kept_pieces(work: &Work, keys: &Keys) -> Option<Pieces> {
    loaded(work, "partition", &keys.pieces, Pieces::decode).filter(|pieces| pieces.is_whole(work))
}

/// Reads all sources into the working folder.
fn import_all(
    work: &Work,
    inputs: &[PathBuf],
    options: &Options,
    progress: &dyn Progress,
) -> Result<Scene, BakeError> {
    let mut spool = Spool::create(work)?;
    let mut whole: Option<Imported> = None;
    let Options { texture_side, memory, ref scene, .. } = *options;
    let limits = ImportLimits { texture_side, memory, scene: scene.clone() };
    for input in inputs {
        let (meshes, textures) = spool.counts();
        spool.next_file(whole.as_ref().map_or(0, |whole: &Imported| whole.surfaces.len()));
        let part = import(input, &limits, &mut spool)?;
        join(&mut whole, part, meshes, textures, [&inputs[0], input]);
        progress.advance(1);
    }
    Ok(spool.finish(whole.unwrap_or_default())?)
}

/// Appends another file's objects and surfaces, whose meshes and textures are numbered from
/// `meshes` and `textures` on. All stand as their coordinates say, and the first file's up direction holds; `files`
/// are the first and this one.
fn join(
    whole: &mut Option<Imported>,
    mut part: Imported,
    meshes: usize,
    textures: usize,
    files: [&Path; 2],
) {
    part.objects.iter_mut().for_each(|object| object.mesh += meshes);
    let moved = |texture: u32| texture + textures as u32;
    part.surfaces.iter_mut().for_each(|surface| surface.texture = surface.texture.map(moved));
    match whole {
        None => *whole = Some(part),
        Some(whole) => {
            whole.objects.append(&mut part.objects);
            whole.surfaces.append(&mut part.surfaces);
            whole.notes.append(&mut part.notes);
            if part.up != whole.up {
                let [first, this] = files.map(|file| file.display());
                whole.notes.push(format!(
                    "{this} has another direction up than {first}, as files of its format have: all stand as \
                     their coordinates say, turn one where that is not meant"
                ));
            }
        }
    }
}

/// What a stage left, if it can be used.
fn loaded<T>(
    work: &Work,
    stage: &str,
    key: &Key,
    decode: impl Fn(&[u8]) -> Result<T, crate::bytes::Torn>,
) -> Option<T> {
    decode(&work.load(stage, key)?).ok()
}

/// Wall-clock time by stage.
struct Clock {
    at: Instant,
    seconds: StageSeconds,
}

impl Clock {
    fn start() -> Self {
        Self { at: Instant::now(), seconds: StageSeconds::default() }
    }

    /// Seconds since the last call.
    fn lap(&mut self) -> f64 {
        std::mem::replace(&mut self.at, Instant::now()).elapsed().as_secs_f64()
    }
}

/// One bake, its sources imported.
struct Job<'a> {
    name: String,
    output: &'a Path,
    options: &'a Options,
    keys: Keys,
    /// What the scene says it was made from; zero if nobody can say.
    stored_key: Key,
    progress: &'a dyn Progress,
}

impl Job<'_> {
    fn run(self, work: &Work, scene: Scene, clock: Clock) -> Result<Summary, BakeError> {
        let jobs = self.options.jobs;
        let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build();
        let pool = pool.map_err(|source| BakeError::Threads { jobs, source })?;
        pool.install(|| self.stages(work, scene, clock))
    }

    fn stages(&self, work: &Work, scene: Scene, mut clock: Clock) -> Result<Summary, BakeError> {
        let pieces = self.pieces(work, &scene)?;
        clock.seconds.partition = clock.lap();
        self.progress.stage("hierarchy", 1);
        let plan = Plan::new(&scene, &pieces, self.options);
        clock.seconds.hierarchy = clock.lap();
        let nodes = plan.tree.nodes.len();
        let begin = || Output::begin(work, self.output, &self.keys.scene, nodes);
        let (mut output, mut notes) = begin()?;
        if notes.first().is_some_and(|table| !shared::is_whole(work, table)) {
            Output::forget(work);
            (output, notes) = begin()?;
        }
        let tally = self.build(work, &scene, &pieces, &plan, &mut output, notes)?;
        let building = clock.lap() - output.seconds;
        let (leaf_ns, inner_ns) = (tally.leaf_ns.load(ORDER), tally.inner_ns.load(ORDER));
        let leaf_share = leaf_ns as f64 / (leaf_ns + inner_ns).max(1) as f64;
        clock.seconds.lods = building * leaf_share;
        clock.seconds.hlods = building * (1.0 - leaf_share);

        self.progress.stage("write", 1);
        if !scene.textures.is_empty() {
            let source = Scene::open(work)?;
            for (index, texture) in scene.textures.iter().enumerate() {
                let rgba = scene.texture(&source, index)?;
                output.write_texture(texture.side, texture.wrap, &rgba)?;
            }
        }
        let info = self.info(&scene, &pieces, &plan);
        let (seconds, written_triangles) = (output.seconds, output.written_triangles);
        let written = output.finish(info, &plan)?;
        self.progress.finish();
        clock.seconds.write = seconds + clock.lap();
        let made = summary::Made { scene: &scene, pieces: &pieces, plan: &plan, tally: &tally };
        Ok(summary::of_bake(&made, written, written_triangles, clock.seconds, &info))
    }

    /// The pieces of all meshes, from the working folder or made now.
    fn pieces(&self, work: &Work, scene: &Scene) -> Result<Pieces, BakeError> {
        let pieces = match kept_pieces(work, &self.keys) {
            Some(pieces) => pieces,
            None => {
                self.progress.stage("partition", scene.meshes.len() as u64);
                let advance = || self.progress.advance(1);
                // Its pieces are overwritten.
                work.forget("partition");
                let pieces = Pieces::make(work, scene, self.options, advance)?;
                work.save("partition", &self.keys.pieces, &pieces.encode())?;
                pieces
            }
        };
        if scene.textures.is_empty() {
            Scene::forget(work);
        }
        if pieces.infos.is_empty() {
            let notes: Vec<&str> =
                scene.notes.iter().chain(&pieces.notes).map(String::as_str).collect();
            let because =
                if notes.is_empty() { String::new() } else { format!(" ({})", notes.join("; ")) };
            return Err(BakeError::Empty { inputs: self.name.clone(), because });
        }
        Ok(pieces)
    }

    /// Builds and writes the whole tree: subtrees small enough to be held, a few at a time, in tree
    /// order, and what lies above them as soon as all below is there.
    fn build(
        &self,
        work: &Work,
        scene: &Scene,
        pieces: &Pieces,
        plan: &Plan,
        output: &mut Output,
        notes: Vec<Vec<u8>>,
    ) -> Result<Tally, BakeError> {
        self.progress.stage("levels", plan.tree.nodes.len() as u64);
        let piece_file = Pieces::open(work)?;
        let repeats = scene.repeats();
        let mut notes = notes.into_iter();
        let table = match notes.next() {
            Some(table) => table,
            None => {
                let setting = Setting { options: self.options, depth: u8::MAX, repeats: &repeats };
                self.write_shared(work, scene, pieces, &piece_file, setting, output)?
            }
        };
        let shared = SharedLevels::open(work, &table, pieces, &piece_file)?;
        let builder = Builder {
            scene,
            pieces,
            piece_file: &piece_file,
            plan,
            shared: &shared,
            repeats: &repeats,
            options: self.options,
            tally: Tally::default(),
        };
        let mut climb = Climb { builder: &builder, tops: Vec::new() };
        climb.tops.resize_with(plan.tree.nodes.len(), || None);
        for note in notes {
            climb.recall(&note).map_err(|torn| WorkError::io(self.output, torn.into()))?;
        }
        let blocks = self.blocks(pieces, plan, &climb.tops);
        for few in blocks.chunks(2 * rayon::current_num_threads()) {
            let subtrees: Vec<Subtree> =
                few.par_iter().map(|&node| builder.subtree(node)).collect::<Result<_, _>>()?;
            for (&node, subtree) in few.iter().zip(subtrees) {
                self.progress.advance(subtree.below.len() as u64 + 1);
                subtree.below.into_iter().try_for_each(|built| output.write(built))?;
                let top = climb.up(node, subtree.top, output)?;
                output.checkpoint(&top)?;
            }
        }
        let root = climb.tops[0].take().expect("the root was built last");
        output.write(root.built)?;
        Ok(builder.tally)
    }

    /// Subtrees to build as a whole, in tree order, where none of `tops` is there already. Those may
    /// come from a bake with more or fewer threads, so of other subtrees than would be taken now.
    fn blocks(&self, pieces: &Pieces, plan: &Plan, tops: &[Option<Top>]) -> Vec<u32> {
        let in_flight = 2 * rayon::current_num_threads() as u64;
        let most = self.options.memory / (in_flight * BLOCK_BYTES);
        let most = most.clamp(1, MOST_BLOCK_TRIANGLES);
        let triangles = plan.source_triangles(pieces);
        let nodes = &plan.tree.nodes;
        let mut begun: Vec<bool> = tops.iter().map(Option::is_some).collect();
        // A parent's number is less than its children's.
        for (id, node) in nodes.iter().enumerate().rev() {
            if let Some(parent) = node.parent {
                begun[parent as usize] |= begun[id];
            }
        }
        let is_small = |node: usize| triangles[node] <= most || nodes[node].item.is_some();
        let mut blocks: Vec<u32> = Vec::new();
        // In the order of a walk that visits children before what comes after their parent.
        let mut open = vec![0u32];
        while let Some(node) = open.pop() {
            let index = node as usize;
            if tops[index].is_some() {
                continue;
            }
            if is_small(index) && !begun[index] {
                blocks.push(node);
            } else {
                open.extend(plan.tree.children(node).rev());
            }
        }
        blocks
    }

    /// Makes and writes the levels of every shared piece, in order.
    fn write_shared(
        &self,
        work: &Work,
        scene: &Scene,
        pieces: &Pieces,
        piece_file: &Records,
        setting: Setting<'_>,
        output: &mut Output,
    ) -> Result<Vec<u8>, BakeError> {
        let mut writer = SharedWriter::create(work)?;
        let all: Vec<usize> = (0..pieces.infos.len()).collect();
        for batch in all.chunks(BATCH_PIECES) {
            let make = |&index: &usize| match pieces.infos[index].is_shared {
                true => {
                    let piece = pieces.read(piece_file, index)?;
                    Ok(shared::make(&piece, setting, &scene.surfaces))
                }
                false => Ok(Vec::new()),
            };
            let made: Vec<Vec<MadeLevel>> =
                batch.par_iter().map(make).collect::<Result<_, WorkError>>()?;
            for levels in made {
                writer.add(levels, |mesh: &Packed| output.write_mesh(mesh))?;
            }
        }
        let table = writer.finish()?;
        output.checkpoint(&table)?;
        Ok(table)
    }

    fn info(&self, scene: &Scene, pieces: &Pieces, plan: &Plan) -> SceneInfo {
        SceneInfo {
            up: scene.up,
            source_triangles: plan.source_triangles(pieces)[0],
            unique_triangles: pieces.infos.iter().map(|piece| piece.source_triangles).sum(),
            objects: scene.objects.len() as u32,
            reserved: 0,
            seed: self.options.seed,
            reserved2: 0,
            key: self.stored_key,
            tree: stored(&plan.criteria),
            plain: stored(&plan.plain_criteria),
        }
    }
}

const ORDER: std::sync::atomic::Ordering = std::sync::atomic::Ordering::Relaxed;

fn stored(criteria: &Criteria) -> format::Criteria {
    format::Criteria {
        leaves: criteria.leaves,
        depth_max: criteria.depth_max,
        reserved: 0,
        depth_mean: criteria.depth_mean,
        ideal_depth: criteria.ideal_depth,
        overlap: criteria.overlap,
        localisation: criteria.localisation,
        size_p10: criteria.size_p10,
        size_p50: criteria.size_p50,
        size_p90: criteria.size_p90,
        reserved2: 0,
    }
}

/// Subtrees that wait for their siblings.
struct Climb<'a> {
    builder: &'a Builder<'a>,
    tops: Vec<Option<Top>>,
}

impl Climb<'_> {
    /// Takes a finished subtree and builds what stands above it as far as everything below is there.
    /// Returns a note of the highest hlod that came of it.
    fn up(&mut self, node: u32, top: Top, output: &mut Output) -> Result<Vec<u8>, BakeError> {
        let tree = &self.builder.plan.tree;
        let mut node = node;
        self.tops[node as usize] = Some(top);
        while let Some(parent) = tree.nodes[node as usize].parent {
            let children = tree.children(parent);
            if !children.clone().all(|child| self.tops[child as usize].is_some()) {
                break;
            }
            let mut below: Vec<Top> =
                children.filter_map(|child| self.tops[child as usize].take()).collect();
            self.tops[parent as usize] = Some(self.builder.inner(parent, &mut below)?);
            below.into_iter().try_for_each(|child| output.write(child.built))?;
            node = parent;
        }
        let mut note = Encoder::default();
        self.tops[node as usize].as_ref().expect("it was just put there").encode(&mut note);
        Ok(note.0)
    }

    /// Takes back what [`Climb::up`] noted.
    fn recall(&mut self, note: &[u8]) -> Result<(), crate::bytes::Torn> {
        let mut from = Decoder(note);
        let top = Top::decode(&mut from)?;
        from.end()?;
        let node = top.built.node;
        if node as usize >= self.tops.len() {
            return Err(crate::bytes::Torn);
        }
        // What stood below was taken up into it.
        let mut below: Vec<u32> = self.builder.plan.tree.children(node).collect();
        while let Some(child) = below.pop() {
            if self.tops[child as usize].take().is_none() {
                below.extend(self.builder.plan.tree.children(child));
            }
        }
        self.tops[node as usize] = Some(top);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
