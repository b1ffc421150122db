//! What a bake did.

use crate::hlod::Tally;
use crate::output::Written;
use crate::plan::{Pieces, Plan};
use crate::spool::{MeshInfo, Scene};
use crate::work::Key;
use protocol::format::{SceneInfo, read_skeleton};
use serde::Serialize;
use std::fmt;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Wall-clock seconds by stage. Levels of leaves and stand-ins of inner hlods are made together;
/// their time is shared out by the work of either.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct StageSeconds {
    /// Reading the sources.
    pub import: f64,
    /// Splitting large objects.
    pub partition: f64,
    /// Building the tree.
    pub hierarchy: f64,
    /// Levels of detail of leaves.
    pub lods: f64,
    /// Stand-ins of inner hlods.
    pub hlods: f64,
    /// Writing, syncing and renaming the file.
    pub write: f64,
}

impl StageSeconds {
    /// All of them.
    pub fn total(&self) -> f64 {
        self.import + self.partition + self.hierarchy + self.lods + self.hlods + self.write
    }
}

/// Hlods at one depth of the tree.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct TreeDepth {
    /// Hlods.
    pub hlods: u64,
    /// Of these, leaves.
    pub leaves: u64,
    /// Triangles of their finest levels, instances counted each.
    pub finest_triangles: u64,
    /// Triangles of their coarsest levels.
    pub coarsest_triangles: u64,
}

/// How many things there were after each step of building the hierarchy (paper 004, table 1).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Objects {
    /// Objects of the source.
    pub source: u64,
    /// After large ones were divided.
    pub divided: u64,
    /// After small ones were clustered.
    pub clusters: u64,
    /// After uneven clusters were divided again: leaves.
    pub leaves: u64,
}

/// What the scene did not need.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Skipped {
    /// Chains of levels that ended because a coarser form would have saved too little.
    pub unpaying: u64,
    /// Levels rejected because they erred by more than half of their size.
    pub wrong: u64,
    /// Levels dropped because one of their parent errs no more.
    pub needless: u64,
    /// Levels of inner hlods for which instances of what is there serve.
    pub instanced: u64,
    /// Inner hlods without a level of their own.
    pub bare: u64,
}

/// The closing figures of a bake.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// The scene was there already, just as it would become: nothing was done, and what only a bake
    /// knows is 0.
    pub unchanged: bool,
    /// Triangles of the source, instances counted each.
    pub source_triangles: u64,
    /// Triangles of the source, shared meshes counted once.
    pub unique_triangles: u64,
    /// Triangles of all meshes in the file.
    pub written_triangles: u64,
    /// Objects by step.
    pub objects: Objects,
    /// Meshes that several objects share.
    pub shared_meshes: u64,
    /// Base colour textures.
    pub textures: u64,
    /// Leaves and inner hlods.
    pub hlods: u64,
    /// Levels of all hlods.
    pub levels: u64,
    /// Bytes of the source's positions, normals, colours, texture coordinates and indices, in memory.
    pub source_bytes: u64,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// BLAKE3 digest of the file, in hexadecimal.
    pub digest: String,
    /// What was skipped.
    pub skipped: Skipped,
    /// By depth, the root first.
    pub depths: Vec<TreeDepth>,
    /// Wall-clock seconds by stage.
    pub seconds: StageSeconds,
    /// Source triangles, shared meshes counted once, a second of the whole bake.
    pub triangles_per_second: f64,
    /// Largest resident set so far in this process, where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// What was left out or simplified.
    pub notes: Vec<String>,
}

/// What a bake made its scene from.
pub(crate) struct Made<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) pieces: &'a Pieces,
    pub(crate) plan: &'a Plan,
    pub(crate) tally: &'a Tally,
}

/// The summary of a bake that is done.
pub(crate) fn of_bake(
    made: &Made<'_>,
    written: Written,
    written_triangles: u64,
    seconds: StageSeconds,
    info: &SceneInfo,
) -> Summary {
    let Made { scene, pieces, plan, tally } = *made;
    let sum = |count: &AtomicU64| count.load(Ordering::Relaxed);
    let counts = plan.counts;
    let mut users = vec![0u32; scene.meshes.len()];
    scene.objects.iter().for_each(|object| users[object.mesh] += 1);
    let shown = scene.meshes.iter().zip(&users).filter(|(_, users)| **users > 0);
    let source_bytes = shown.map(|(mesh, _)| MeshInfo::bytes(mesh)).sum();
    Summary {
        unchanged: false,
        source_triangles: info.source_triangles,
        unique_triangles: info.unique_triangles,
        written_triangles,
        objects: Objects {
            source: counts.objects,
            divided: counts.divided,
            clusters: counts.clusters,
            leaves: counts.leaves,
        },
        shared_meshes: users.iter().filter(|&&count| count > 1).count() as u64,
        textures: scene.textures.len() as u64,
        hlods: plan.tree.nodes.len() as u64,
        levels: written.levels,
        source_bytes,
        file_bytes: written.finished.bytes,
        digest: hexadecimal(&written.finished.digest),
        skipped: Skipped {
            unpaying: sum(&tally.unpaying),
            wrong: sum(&tally.wrong),
            needless: sum(&tally.needless),
            instanced: sum(&tally.instanced),
            bare: sum(&tally.bare),
        },
        depths: written.depths,
        triangles_per_second: info.unique_triangles as f64 / seconds.total().max(1e-9),
        seconds,
        peak_memory_bytes: peak_memory_bytes(),
        notes: scene.notes.iter().chain(&pieces.notes).cloned().collect(),
    }
}

/// The summary of a scene that is there already, made under this key; none if it is not.
pub(crate) fn of_unchanged(path: &Path, key: &Key) -> Option<Summary> {
    let scene = read_skeleton(path).ok().filter(|scene| scene.skeleton.info.key == *key)?;
    let skeleton = &scene.skeleton;
    let leaves = skeleton.hlods.iter().filter(|hlod| hlod.child_count == 0).count() as u64;
    let meshes = skeleton.blobs.iter().filter(|blob| !blob.is_projected());
    Some(Summary {
        unchanged: true,
        source_triangles: skeleton.info.source_triangles,
        unique_triangles: skeleton.info.unique_triangles,
        written_triangles: meshes.map(|blob| u64::from(blob.triangles)).sum(),
        objects: Objects { source: u64::from(skeleton.info.objects), leaves, ..Objects::default() },
        textures: skeleton.textures.len() as u64,
        hlods: skeleton.hlods.len() as u64,
        levels: skeleton.levels.len() as u64,
        file_bytes: scene.file_bytes,
        digest: hexadecimal(&scene.digest),
        ..Summary::default()
    })
}

fn hexadecimal(digest: &[u8]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let megabytes = |bytes: u64| format!("{:.1} MB", bytes as f64 / 1e6);
        let mut row = |name: &str, value: String| writeln!(f, "{name:<24}{value:>14}");
        let mut count = |name: &str, value: u64| row(name, value.to_string());
        count("source triangles", self.source_triangles)?;
        count("  shared counted once", self.unique_triangles)?;
        count("written triangles", self.written_triangles)?;
        count("objects", self.objects.source)?;
        if !self.unchanged {
            count("  large ones divided", self.objects.divided)?;
            count("  small ones clustered", self.objects.clusters)?;
        }
        count("  leaves", self.objects.leaves)?;
        if self.shared_meshes > 0 {
            count("shared meshes", self.shared_meshes)?;
        }
        if self.textures > 0 {
            count("textures", self.textures)?;
        }
        count("hlods", self.hlods)?;
        count("levels", self.levels)?;
        let Skipped { unpaying, wrong, needless, instanced, bare } = self.skipped;
        for (name, value) in [
            ("  would save too little", unpaying),
            ("  would err too much", wrong),
            ("  parent errs no more", needless),
            ("  instances serve", instanced),
            ("hlods without levels", bare),
        ] {
            if value > 0 {
                count(name, value)?;
            }
        }
        if self.source_bytes > 0 {
            row("source geometry", megabytes(self.source_bytes))?;
        }
        row("scene file", megabytes(self.file_bytes))?;
        if self.unchanged {
            return writeln!(f, "note: nothing has changed since it was baked");
        }
        let s = &self.seconds;
        for (name, seconds) in [
            ("import", s.import),
            ("partition", s.partition),
            ("hierarchy", s.hierarchy),
            ("levels of leaves", s.lods),
            ("inner hlods", s.hlods),
            ("write", s.write),
            ("total", s.total()),
        ] {
            row(name, format!("{seconds:.2} s"))?;
        }
        row("triangles a second", format!("{:.0}", self.triangles_per_second))?;
        if let Some(bytes) = self.peak_memory_bytes {
            row("peak memory", megabytes(bytes))?;
        }
        self.notes.iter().try_for_each(|note| writeln!(f, "note: {note}"))
    }
}

/// The largest resident set of this process so far, from `/proc/self/status`.
pub(crate) fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}
