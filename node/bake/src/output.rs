//! The scene file while it grows: meshes go out as they come, the skeleton is kept for the end.

use crate::hlod::{Built, Geometry, PendingLevel};
use crate::options::Options;
use crate::pack::Packed;
use crate::pieces::{Piece, Plan};
use crate::source::Source;
use crate::summary::{StageSeconds, Summary, TreeDepth};
use geometry::hierarchy::Tree;
use protocol::format::{
    Class, Hlod, Level, NONE, Part, SceneInfo, SceneWriter, Vertices, WriteError,
};
use protocol::id::BlobId;
use std::path::Path;
use std::time::Instant;

/// Levels of one hlod and the only part of each, its place in the table still open.
type OwnLevels = Vec<(Level, Part)>;

/// What has been written so far.
pub(crate) struct Output {
    writer: SceneWriter,
    /// By node: the hlod, its links and first level still open, and its levels.
    hlods: Vec<Option<(Hlod, OwnLevels)>>,
    written_triangles: u64,
    /// Spent writing.
    pub(crate) seconds: f64,
}

impl Output {
    /// Starts the file of a tree with so many nodes.
    pub(crate) fn create(path: &Path, nodes: usize) -> Result<Self, WriteError> {
        let writer = SceneWriter::create(path)?;
        Ok(Self { writer, hlods: vec![None; nodes], written_triangles: 0, seconds: 0.0 })
    }

    /// Writes one mesh.
    pub(crate) fn write_mesh(&mut self, mesh: &Packed) -> Result<BlobId, WriteError> {
        self.written_triangles += u64::from(mesh.triangles());
        let (vertices, classes) = (&mesh.vertices, Class::OpaqueDouble.all(mesh.triangles()));
        let vertices = Vertices::Plain(vertices);
        self.writer.add_blob(mesh.origin, mesh.step, vertices, &mesh.indices, classes)
    }

    /// Writes an hlod's meshes and keeps its entry.
    pub(crate) fn write(&mut self, built: Built) -> Result<(), WriteError> {
        let start = Instant::now();
        let mut levels = Vec::with_capacity(built.levels.len());
        for level in built.levels {
            let PendingLevel { error, geometry, triangles, transform } = level;
            let blob = match geometry {
                Geometry::Written(blob) => blob,
                Geometry::Packed(mesh) => self.write_mesh(&mesh)?,
            };
            let level = Level { error, first_part: 0, part_count: 1, triangles, reserved: 0 };
            levels.push((level, Part { blob: blob.0, transform }));
        }
        let hlod = Hlod {
            min: built.bounds.min.to_array(),
            max: built.bounds.max.to_array(),
            parent: NONE,
            first_child: 0,
            child_count: 0,
            first_level: 0,
            level_count: levels.len() as u32,
            object: built.object,
            source_triangles: built.source_triangles,
        };
        self.hlods[built.node as usize] = Some((hlod, levels));
        self.seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Numbers the levels, links the tree and completes the file.
    pub(crate) fn finish(
        self,
        source: &Source,
        plan: &Plan,
        tree: &Tree,
        options: &Options,
    ) -> Result<Summary, WriteError> {
        let mut hlods = Vec::with_capacity(tree.nodes.len());
        let (mut levels, mut parts) = (Vec::new(), Vec::new());
        let mut depths: Vec<TreeDepth> = Vec::new();
        let by_node = self.hlods.into_iter().zip(&tree.nodes).zip(tree.depths());
        for ((written, node), depth) in by_node {
            let (mut hlod, own) = written.expect("every node was written");
            hlod.parent = node.parent.unwrap_or(NONE);
            hlod.first_child = node.first_child;
            hlod.child_count = node.child_count;
            hlod.first_level = levels.len() as u32;
            if depths.len() <= depth as usize {
                depths.resize(depth as usize + 1, TreeDepth::default());
            }
            let row = &mut depths[depth as usize];
            row.hlods += 1;
            row.leaves += u64::from(node.item.is_some());
            row.finest_triangles += own.first().map_or(0, |(level, _)| u64::from(level.triangles));
            row.coarsest_triangles += own.last().map_or(0, |(level, _)| u64::from(level.triangles));
            for (level, part) in own {
                levels.push(Level { first_part: parts.len() as u32, ..level });
                parts.push(part);
            }
            hlods.push(hlod);
        }
        let source_triangles = hlods[0].source_triangles;
        let unique_triangles = plan.pieces.iter().map(Piece::triangles).sum();
        let info = SceneInfo {
            up: source.up,
            source_triangles,
            unique_triangles,
            objects: source.objects.len() as u32,
            seed: options.seed,
            ..SceneInfo::default()
        };
        let summary = Summary {
            source_triangles,
            unique_triangles,
            written_triangles: self.written_triangles,
            objects: source.objects.len() as u64,
            shared_meshes: shared_meshes(source),
            leaves: plan.leaves.len() as u64,
            hlods: hlods.len() as u64,
            levels: levels.len() as u64,
            source_bytes: source_bytes(source),
            file_bytes: 0,
            digest: String::new(),
            depths,
            seconds: StageSeconds { write: self.seconds, ..StageSeconds::default() },
            peak_memory_bytes: None,
            notes: source.notes.iter().chain(&plan.notes).cloned().collect(),
        };
        let finished = self.writer.finish(info, hlods, levels, parts, plan.transforms.clone())?;
        let digest = finished.digest.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Summary { file_bytes: finished.bytes, digest, ..summary })
    }
}

fn shared_meshes(source: &Source) -> u64 {
    let mut users = vec![0u32; source.meshes.len()];
    source.objects.iter().for_each(|object| users[object.mesh] += 1);
    users.iter().filter(|&&count| count > 1).count() as u64
}

/// Positions and normals of 12 bytes, colours of 4, triangles of 12.
fn source_bytes(source: &Source) -> u64 {
    source.meshes.iter().map(|m| 28 * m.positions.len() as u64 + 12 * m.indices.len() as u64).sum()
}
