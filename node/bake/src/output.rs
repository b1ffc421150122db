//! The scene file while it grows: meshes go out as they come, the skeleton is kept for the end. What
//! has been written is noted in a journal, so that a bake that was cut short goes on behind it.

use crate::built::{Built, Geometry, PendingLevel};
use crate::bytes::{Decoder, Encoder, Torn};
use crate::pack::Packed;
use crate::pipeline::BakeError;
use crate::plan::Plan;
use crate::summary::TreeDepth;
use crate::work::{Appender, Key, Work, WorkError};
use protocol::format::{
    Blob, Finished, Hlod, Level, NONE, Part, SceneInfo, SceneWriter, Tables, Wrap, WriteError,
    WriterState,
};
use protocol::id::BlobId;
use std::path::Path;
use std::time::Instant;

const JOURNAL: &str = "journal";
const SCENE: &str = "scene";
/// Bytes of a record's length and checksum.
const SEAL: usize = 40;

/// An hlod as it will stand in the skeleton, its links and the numbers of levels and parts still open.
#[derive(Debug, Clone, PartialEq)]
struct Row {
    hlod: Hlod,
    levels: Vec<Level>,
    parts: Vec<Part>,
}

/// What has been written so far.
pub(crate) struct Output {
    writer: SceneWriter,
    journal: Appender,
    /// Blobs and rows that the journal does not have yet.
    blobs: usize,
    fresh: Vec<u32>,
    /// By node.
    rows: Vec<Option<Row>>,
    pub(crate) written_triangles: u64,
    /// Spent writing.
    pub(crate) seconds: f64,
}

impl Output {
    /// Starts the file that becomes `path`, for a tree of so many nodes; or goes on with it, if what
    /// the working folder has was made under the same key. Then also returns the notes of every
    /// checkpoint.
    pub(crate) fn begin(
        work: &Work,
        path: &Path,
        key: &Key,
        nodes: usize,
    ) -> Result<(Self, Vec<Vec<u8>>), BakeError> {
        let bytes = std::fs::read(work.path(JOURNAL)).unwrap_or_default();
        let mut so_far = SoFar::new(nodes);
        let valid = so_far.read(&bytes, key);
        let state = WriterState {
            geometry_bytes: so_far.geometry_bytes,
            blobs: std::mem::take(&mut so_far.blobs),
        };
        let blobs = state.blobs.len();
        let resumed = match so_far.notes.is_empty() {
            true => None,
            false => SceneWriter::resume(&work.path(SCENE), path, state).ok(),
        };
        let (writer, journal, so_far, blobs) = match resumed {
            Some(writer) => {
                (writer, Appender::resume(&work.path(JOURNAL), valid as u64)?, so_far, blobs)
            }
            None => {
                let mut journal = Appender::create(&work.path(JOURNAL))?;
                journal.append(&[key]).map_err(|e| journal.error(e))?;
                journal.flush()?;
                let writer = SceneWriter::create_at(&work.path(SCENE), path)?;
                (writer, journal, SoFar::new(nodes), 0)
            }
        };
        let SoFar { rows, notes, written_triangles, .. } = so_far;
        let output = Self {
            writer,
            journal,
            blobs,
            fresh: Vec::new(),
            rows,
            written_triangles,
            seconds: 0.0,
        };
        Ok((output, notes))
    }

    /// Forgets what was written, so that [`Output::begin`] starts anew.
    pub(crate) fn forget(work: &Work) {
        work.forget(JOURNAL);
    }

    /// Writes one mesh.
    pub(crate) fn write_mesh(&mut self, mesh: &Packed) -> Result<BlobId, BakeError> {
        let start = Instant::now();
        self.written_triangles += u64::from(mesh.triangles());
        let (vertices, classes) = (mesh.vertices(), mesh.classes);
        let blob =
            self.writer.add_blob(mesh.origin, mesh.step, vertices, &mesh.indices, classes)?;
        self.seconds += start.elapsed().as_secs_f64();
        Ok(blob)
    }

    /// Writes an hlod's meshes and keeps its entry.
    pub(crate) fn write(&mut self, built: Built) -> Result<(), BakeError> {
        let mut row = Row {
            hlod: Hlod {
                min: built.bounds.min.to_array(),
                max: built.bounds.max.to_array(),
                parent: NONE,
                first_child: 0,
                child_count: 0,
                first_level: 0,
                level_count: built.levels.len() as u32,
                object: built.object,
                source_triangles: built.source_triangles,
            },
            levels: Vec::with_capacity(built.levels.len()),
            parts: Vec::new(),
        };
        for PendingLevel { error, triangles, parts } in built.levels {
            let (first_part, part_count) = (row.parts.len() as u32, parts.len() as u32);
            let mut longest = 0.0f64;
            for part in parts {
                let (blob, longest_edge) = match part.geometry {
                    Geometry::Written { blob, longest_edge } => (blob, longest_edge),
                    Geometry::Packed(mesh) => (self.write_mesh(&mesh)?, mesh.longest_edge()),
                };
                longest = longest.max(longest_edge);
                row.parts.push(Part { blob: blob.0, transform: part.transform });
            }
            // More than what rounding takes.
            let longest_edge = (longest as f32).next_up();
            row.levels.push(Level { error, first_part, part_count, triangles, longest_edge });
        }
        self.rows[built.node as usize] = Some(row);
        self.fresh.push(built.node);
        Ok(())
    }

    /// Makes sure that a bake begun anew goes on from here, with this note in its hands.
    pub(crate) fn checkpoint(&mut self, note: &[u8]) -> Result<(), BakeError> {
        let start = Instant::now();
        let state = self.writer.checkpoint()?;
        let mut out = Encoder::default();
        out.put_slice(&state.blobs[self.blobs..]);
        out.put([state.geometry_bytes, self.written_triangles]);
        out.put(self.fresh.len() as u64);
        for node in self.fresh.drain(..) {
            let row = self.rows[node as usize].as_ref().expect("a fresh row was written");
            out.put(node);
            out.put(row.hlod);
            out.put_slice(&row.levels);
            out.put_slice(&row.parts);
        }
        out.put_slice(note);
        self.blobs = state.blobs.len();
        let (length, hash) = (out.0.len() as u64, blake3::hash(&out.0));
        let record: [&[u8]; 3] = [&length.to_le_bytes(), hash.as_bytes(), &out.0];
        self.journal.append(&record).map_err(|source| self.journal.error(source))?;
        self.journal.flush()?;
        self.seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Appends a texture.
    pub(crate) fn write_texture(
        &mut self,
        side: u32,
        wrap: [Wrap; 2],
        rgba: &[u8],
    ) -> Result<(), WriteError> {
        self.writer.add_texture(side, wrap, rgba).map(drop)
    }

    /// Numbers levels and parts, links the tree and completes the file.
    pub(crate) fn finish(self, info: SceneInfo, plan: &Plan) -> Result<Written, WriteError> {
        let nodes = &plan.tree.nodes;
        let mut hlods = Vec::with_capacity(nodes.len());
        let mut levels: Vec<Level> = Vec::new();
        let mut parts = Vec::new();
        let mut depths: Vec<TreeDepth> = Vec::new();
        for ((row, node), &depth) in self.rows.into_iter().zip(nodes).zip(&plan.depths) {
            let mut row = row.expect("every node was written");
            row.hlod.parent = node.parent.unwrap_or(NONE);
            row.hlod.first_child = node.first_child;
            row.hlod.child_count = node.child_count;
            row.hlod.first_level = levels.len() as u32;
            if depths.len() <= usize::from(depth) {
                depths.resize(usize::from(depth) + 1, TreeDepth::default());
            }
            let at_depth = &mut depths[usize::from(depth)];
            at_depth.hlods += 1;
            at_depth.leaves += u64::from(node.item.is_some());
            let triangles = |level: Option<&Level>| level.map_or(0, |l| u64::from(l.triangles));
            at_depth.finest_triangles += triangles(row.levels.first());
            at_depth.coarsest_triangles += triangles(row.levels.last());
            row.levels.iter_mut().for_each(|level| level.first_part += parts.len() as u32);
            levels.append(&mut row.levels);
            parts.append(&mut row.parts);
            hlods.push(row.hlod);
        }
        let count = levels.len() as u64;
        let transforms = plan.transforms.clone();
        let tables = Tables { info, hlods, levels, parts, transforms, ..Tables::default() };
        let finished = self.writer.finish(tables)?;
        Ok(Written { finished, levels: count, depths })
    }
}

/// A finished file.
pub(crate) struct Written {
    pub(crate) finished: Finished,
    pub(crate) levels: u64,
    pub(crate) depths: Vec<TreeDepth>,
}

/// What a journal says.
struct SoFar {
    blobs: Vec<Blob>,
    geometry_bytes: u64,
    written_triangles: u64,
    rows: Vec<Option<Row>>,
    notes: Vec<Vec<u8>>,
}

impl SoFar {
    fn new(nodes: usize) -> Self {
        let (blobs, notes) = (Vec::new(), Vec::new());
        Self { blobs, geometry_bytes: 0, written_triangles: 0, rows: vec![None; nodes], notes }
    }

    /// Takes the whole records of a journal under this key; returns how far they reach.
    fn read(&mut self, bytes: &[u8], key: &Key) -> usize {
        if !bytes.starts_with(key) {
            return 0;
        }
        let mut at = key.len();
        while let Some(seal) = bytes.get(at..at + SEAL) {
            let (length, hash) = seal.split_at(8);
            let length = u64::from_le_bytes(length.try_into().expect("eight bytes")) as usize;
            let end = (at + SEAL).saturating_add(length);
            let Some(record) = bytes.get(at + SEAL..end) else { break };
            if blake3::hash(record).as_bytes()[..] != *hash || self.take(record).is_err() {
                break;
            }
            at = end;
        }
        at
    }

    fn take(&mut self, record: &[u8]) -> Result<(), Torn> {
        let mut from = Decoder(record);
        let blobs = from.take_slice()?;
        let [geometry_bytes, written_triangles] = from.take()?;
        let mut rows = Vec::new();
        for _ in 0..from.take_count()? {
            let node = from.take::<u32>()?;
            let (hlod, levels, parts) = (from.take()?, from.take_slice()?, from.take_slice()?);
            rows.push((node, Row { hlod, levels, parts }));
        }
        let note = from.take_slice()?;
        from.end()?;
        if rows.iter().any(|(node, _)| *node as usize >= self.rows.len()) {
            return Err(Torn);
        }
        self.blobs.extend_from_slice(&blobs);
        self.geometry_bytes = geometry_bytes;
        self.written_triangles = written_triangles;
        rows.into_iter().for_each(|(node, row)| self.rows[node as usize] = Some(row));
        self.notes.push(note);
        Ok(())
    }
}

impl From<WorkError> for BakeError {
    fn from(error: WorkError) -> Self {
        Self::Work(error)
    }
}
