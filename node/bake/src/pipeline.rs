//! The whole bake: sources in, one scene file out.

use crate::hlod::{Builder, PieceLevels, Subtree, Top, WrittenLevel, piece_levels};
use crate::import::{ImportError, ImportErrorKind, import_all};
use crate::options::{Options, OptionsError};
use crate::output::Output;
use crate::pieces::{Plan, plan};
use crate::progress::Progress;
use crate::source::Source;
use crate::summary::{StageSeconds, Summary, peak_memory_bytes};
use geometry::hierarchy::{self, Tree};
use protocol::format::WriteError;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicU64;
use std::time::Instant;

/// Source triangles of a subtree that is built as a whole before anything of it is written. Bounds
/// the memory; the file is the same for any value.
const BLOCK_TRIANGLES: u64 = 1 << 18;
/// Shared pieces whose levels are made before they are written.
const BATCH_PIECES: usize = 256;

/// Why a bake failed. Nothing is left at the output's name that was not there before.
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
            Self::Write(WriteError::TooMany { .. }) => 65,
            Self::Write(WriteError::Invalid { .. }) => 70,
            Self::Write(_) => 74,
            Self::Threads { .. } => 69,
        }
    }
}

/// Bakes all sources into one scene. The bytes written depend on sources and options alone, never on
/// the number of threads.
pub fn bake(
    inputs: &[PathBuf],
    output: &Path,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Summary, BakeError> {
    options.check()?;
    let start = Instant::now();
    progress.stage("import", inputs.len() as u64);
    let mut source = Source::default();
    for input in inputs {
        join(&mut source, import_all(input)?);
        progress.advance(1);
    }
    let names: Vec<String> = inputs.iter().map(|input| input.display().to_string()).collect();
    let import_s = start.elapsed().as_secs_f64();
    let mut summary = bake_source(&source, &names.join(", "), output, options, progress)?;
    summary.seconds.import = import_s;
    Ok(summary)
}

/// Bakes a scene that is in memory; `name` stands for it in messages.
pub fn bake_source(
    source: &Source,
    name: &str,
    output: &Path,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Summary, BakeError> {
    options.check()?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(options.jobs)
        .build()
        .map_err(|source| BakeError::Threads { jobs: options.jobs, source })?;
    pool.install(|| run(source, name, output, options, progress))
}

/// Appends another source's meshes and objects. The first one's up direction holds.
fn join(whole: &mut Source, mut part: Source) {
    if whole.meshes.is_empty() {
        whole.up = part.up;
    }
    let base = whole.meshes.len();
    part.objects.iter_mut().for_each(|object| object.mesh += base);
    whole.meshes.append(&mut part.meshes);
    whole.objects.append(&mut part.objects);
    whole.notes.append(&mut part.notes);
}

fn run(
    source: &Source,
    name: &str,
    output: &Path,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Summary, BakeError> {
    let mut seconds = StageSeconds::default();
    let mut clock = Instant::now();
    let mut lap = || std::mem::replace(&mut clock, Instant::now()).elapsed().as_secs_f64();

    progress.stage("partition", source.meshes.len() as u64);
    let plan = plan(source, options, || progress.advance(1));
    if plan.leaves.is_empty() {
        let notes: Vec<&str> = source.notes.iter().chain(&plan.notes).map(String::as_str).collect();
        let because =
            if notes.is_empty() { String::new() } else { format!(" ({})", notes.join("; ")) };
        return Err(BakeError::Empty { inputs: name.to_owned(), because });
    }
    seconds.partition = lap();

    progress.stage("hierarchy", 1);
    let boxes: Vec<_> = plan.leaves.iter().map(|leaf| leaf.bounds).collect();
    let tree = hierarchy::build(&boxes, options.branching);
    seconds.hierarchy = lap();

    let mut output = Output::create(output, tree.nodes.len())?;
    progress.stage("levels", tree.nodes.len() as u64);
    let shared = write_shared(source, &plan, options, &mut output)?;
    seconds.lods = lap() - output.seconds;
    let writing_before = output.seconds;
    let builder = Builder {
        source,
        plan: &plan,
        tree: &tree,
        shared: &shared,
        options,
        leaf_ns: AtomicU64::new(0),
        inner_ns: AtomicU64::new(0),
    };
    build_tree(&builder, &mut output, progress)?;
    let building = lap() - (output.seconds - writing_before);
    let leaf_ns = builder.leaf_ns.into_inner() as f64;
    let inner_ns = builder.inner_ns.into_inner() as f64;
    let leaf_share = leaf_ns / (leaf_ns + inner_ns).max(1.0);
    seconds.lods += building * leaf_share;
    seconds.hlods = building * (1.0 - leaf_share);

    progress.stage("write", 1);
    let mut summary = output.finish(source, &plan, &tree, options)?;
    progress.finish();
    seconds.write = summary.seconds.write + lap();
    summary.seconds = seconds;
    summary.peak_memory_bytes = peak_memory_bytes();
    Ok(summary)
}

/// Makes and writes the levels of every shared piece, in order.
fn write_shared(
    source: &Source,
    plan: &Plan,
    options: &Options,
    output: &mut Output,
) -> Result<Vec<Vec<WrittenLevel>>, WriteError> {
    let mut shared = Vec::with_capacity(plan.pieces.len());
    for batch in plan.pieces.chunks(BATCH_PIECES) {
        let made: Vec<PieceLevels> = batch
            .par_iter()
            .map(|piece| match piece.is_shared() {
                true => piece_levels(piece, &piece.gather(source), options),
                false => Vec::new(),
            })
            .collect();
        let start = Instant::now();
        for levels in made {
            let mut written = Vec::with_capacity(levels.len());
            for (error, packed) in levels {
                let blob = output.write_mesh(&packed)?;
                written.push(WrittenLevel { error, blob, triangles: packed.triangles() });
            }
            shared.push(written);
        }
        output.seconds += start.elapsed().as_secs_f64();
    }
    Ok(shared)
}

/// Builds and writes the whole tree: first the subtrees small enough to be held, a few at a time, in
/// tree order, then what lies above them, from the bottom.
fn build_tree(
    builder: &Builder<'_>,
    output: &mut Output,
    progress: &dyn Progress,
) -> Result<(), WriteError> {
    let tree = builder.tree;
    let triangles = source_triangles(builder.plan, tree);
    let is_block = |node: u32| {
        let node = node as usize;
        triangles[node] <= BLOCK_TRIANGLES || tree.nodes[node].item.is_some()
    };
    let all = 0..tree.nodes.len() as u32;
    let above_is_block = |node: u32| tree.nodes[node as usize].parent.is_some_and(is_block);
    let blocks: Vec<u32> = all.clone().filter(|&n| is_block(n) && !above_is_block(n)).collect();
    let mut tops: Vec<Option<Top>> = Vec::new();
    tops.resize_with(tree.nodes.len(), || None);
    for few in blocks.chunks(2 * rayon::current_num_threads()) {
        let subtrees: Vec<Subtree> = few.par_iter().map(|&node| builder.subtree(node)).collect();
        for (&node, subtree) in few.iter().zip(subtrees) {
            progress.advance(subtree.below.len() as u64 + 1);
            subtree.below.into_iter().try_for_each(|built| output.write(built))?;
            tops[node as usize] = Some(subtree.top);
        }
    }
    // A child's id is greater than its parent's, so this goes upwards.
    for node in all.rev().filter(|&n| !is_block(n)) {
        let children = tree.children(node).map(|child| tops[child as usize].take());
        let mut children: Vec<Top> =
            children.map(|top| top.expect("children come before")).collect();
        tops[node as usize] = Some(builder.inner(node, &mut children));
        children.into_iter().try_for_each(|child| output.write(child.built))?;
        progress.advance(1);
    }
    let root = tops[0].take().expect("the root was built last");
    output.write(root.built)
}

/// Source triangles below each node.
fn source_triangles(plan: &Plan, tree: &Tree) -> Vec<u64> {
    let mut triangles = vec![0; tree.nodes.len()];
    for (id, node) in tree.nodes.iter().enumerate().rev() {
        if let Some(item) = node.item {
            triangles[id] = plan.pieces[plan.leaves[item as usize].piece as usize].triangles();
        }
        if let Some(parent) = node.parent {
            triangles[parent as usize] += triangles[id];
        }
    }
    triangles
}

#[cfg(test)]
mod tests;
