//! What a bake did.

use serde::Serialize;
use std::fmt;

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

/// The closing figures of a bake.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Triangles of the source, instances counted each.
    pub source_triangles: u64,
    /// Triangles of the source, shared meshes counted once.
    pub unique_triangles: u64,
    /// Triangles of all meshes in the file.
    pub written_triangles: u64,
    /// Objects of the source.
    pub objects: u64,
    /// Meshes that several objects share.
    pub shared_meshes: u64,
    /// Leaves: pieces of objects, each instance counted.
    pub leaves: u64,
    /// Leaves and inner hlods.
    pub hlods: u64,
    /// Levels of all hlods.
    pub levels: u64,
    /// Bytes of the source's positions, normals, colours and indices, in memory.
    pub source_bytes: u64,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// BLAKE3 digest of the file, in hexadecimal.
    pub digest: String,
    /// By depth, the root first.
    pub depths: Vec<TreeDepth>,
    /// Wall-clock seconds by stage.
    pub seconds: StageSeconds,
    /// Largest resident set so far in this process, where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// What was skipped or simplified.
    pub notes: Vec<String>,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let megabytes = |bytes: u64| format!("{:.1} MB", bytes as f64 / 1e6);
        let mut row = |name: &str, value: String| writeln!(f, "{name:<22}{value:>14}");
        row("source triangles", self.source_triangles.to_string())?;
        row("  shared counted once", self.unique_triangles.to_string())?;
        row("written triangles", self.written_triangles.to_string())?;
        row("objects", self.objects.to_string())?;
        row("  shared meshes", self.shared_meshes.to_string())?;
        row("leaves", self.leaves.to_string())?;
        row("hlods", self.hlods.to_string())?;
        row("levels", self.levels.to_string())?;
        row("source geometry", megabytes(self.source_bytes))?;
        row("scene file", megabytes(self.file_bytes))?;
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
