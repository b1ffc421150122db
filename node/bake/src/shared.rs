//! Levels of pieces that several objects show: made once, before the tree, and read back wherever an
//! hlod is made from them.

use crate::bytes::{Decoder, Encoder, Torn};
use crate::levels::{Chain, CoarseMesh, Setting};
use crate::pack::{Packed, pack};
use crate::pieces::PieceMesh;
use crate::plan::Pieces;
use crate::source::Surface;
use crate::work::{Appender, Records, Span, Work, WorkError};
use geometry::mesh::Mesh;
use protocol::id::BlobId;

/// Name of the file in the working folder.
const SHARED: &str = "shared";

/// A level of a shared piece that is in the scene file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SharedLevel {
    /// Deviation in mesh units.
    pub(crate) error: f64,
    pub(crate) blob: BlobId,
    pub(crate) triangles: u32,
    /// Mesh units.
    pub(crate) longest_edge: f64,
    /// Where its mesh lies in the working folder; no bytes for the finest, which is the piece itself.
    span: Span,
}

/// A level of a shared piece that is not written yet.
pub(crate) struct MadeLevel {
    error: f64,
    packed: Packed,
    /// None for the finest.
    piece: Option<PieceMesh>,
}

/// All levels of one shared piece. Its borders stay in all of them.
pub(crate) fn make(
    piece: &PieceMesh,
    setting: Setting<'_>,
    surfaces: &[Surface],
) -> Vec<MadeLevel> {
    let base = piece.mesh(|_| 0);
    let pack =
        |mesh: &Mesh| pack(mesh, piece.step, surfaces).expect("levels have triangles with an area");
    let mut made = vec![MadeLevel { error: piece.error, packed: pack(&base), piece: None }];
    let mut chain = Chain::new(&base, piece.error, 0.0, setting);
    let mut last: Option<CoarseMesh> = None;
    loop {
        let Ok(level) = chain.next(last.as_ref(), None) else { return made };
        let mut coarse =
            PieceMesh::of(&level.mesh, piece.step, piece.error).expect("it was just packed");
        coarse.inherit_seams(piece);
        made.push(MadeLevel { error: level.error, packed: pack(&level.mesh), piece: Some(coarse) });
        last = Some(level);
    }
}

/// Takes shared levels as they are written.
pub(crate) struct SharedWriter {
    file: Appender,
    levels: Vec<Vec<SharedLevel>>,
}

impl SharedWriter {
    pub(crate) fn create(work: &Work) -> Result<Self, WorkError> {
        Ok(Self { file: Appender::create(&work.path(SHARED))?, levels: Vec::new() })
    }

    /// Takes the levels of the next piece, none for one that is not shared. `write` puts a mesh into
    /// the scene file.
    pub(crate) fn add<E: From<WorkError>>(
        &mut self,
        made: Vec<MadeLevel>,
        mut write: impl FnMut(&Packed) -> Result<BlobId, E>,
    ) -> Result<(), E> {
        let mut levels = Vec::with_capacity(made.len());
        for MadeLevel { error, packed, piece } in made {
            let bytes = piece.map(|piece| piece.encode()).unwrap_or_default();
            let span = self.file.append(&[&bytes]).map_err(|e| self.file.error(e))?;
            let blob = write(&packed)?;
            let (triangles, longest_edge) = (packed.triangles(), packed.longest_edge());
            levels.push(SharedLevel { error, blob, triangles, longest_edge, span });
        }
        self.levels.push(levels);
        Ok(())
    }

    /// Hands all to the system, and the table as bytes.
    pub(crate) fn finish(mut self) -> Result<Vec<u8>, WorkError> {
        self.file.flush()?;
        let mut out = Encoder::default();
        out.put(self.levels.len() as u64);
        for levels in &self.levels {
            out.put(levels.len() as u64);
            for level in levels {
                out.put(level.error);
                out.put([level.blob.0, level.triangles]);
                out.put(level.longest_edge);
                out.put(level.span);
            }
        }
        Ok(out.0)
    }
}

/// Levels of all shared pieces.
pub(crate) struct SharedLevels<'a> {
    pieces: &'a Pieces,
    piece_file: &'a Records,
    file: Records,
    levels: Vec<Vec<SharedLevel>>,
}

impl<'a> SharedLevels<'a> {
    /// From the table that [`SharedWriter::finish`] made.
    pub(crate) fn open(
        work: &Work,
        table: &[u8],
        pieces: &'a Pieces,
        piece_file: &'a Records,
    ) -> Result<Self, WorkError> {
        let file = Records::open(&work.path(SHARED))?;
        let levels = decode(table).map_err(|_| file.torn())?;
        Ok(Self { pieces, piece_file, file, levels })
    }

    /// Levels of a piece, finest first.
    pub(crate) fn levels(&self, piece: usize) -> &[SharedLevel] {
        &self.levels[piece]
    }

    /// The mesh of a level, in the space of its mesh.
    pub(crate) fn mesh(&self, piece: usize, level: usize) -> Result<PieceMesh, WorkError> {
        if level == 0 {
            return self.pieces.read(self.piece_file, piece);
        }
        let span = self.levels[piece][level].span;
        PieceMesh::decode(&self.file.read(span)?).map_err(|_| self.file.torn())
    }
}

/// Whether all that the table speaks of is in the working folder, as it was written.
pub(crate) fn is_whole(work: &Work, table: &[u8]) -> bool {
    let Ok(levels) = decode(table) else { return false };
    let spans = levels.iter().flatten().map(|level| level.span);
    Records::open(&work.path(SHARED)).is_ok_and(|file| file.holds(spans))
}

fn decode(table: &[u8]) -> Result<Vec<Vec<SharedLevel>>, Torn> {
    let from = &mut Decoder(table);
    let mut all = Vec::new();
    for _ in 0..from.take_count()? {
        let mut levels = Vec::new();
        for _ in 0..from.take_count()? {
            let error = from.take()?;
            let [blob, triangles] = from.take::<[u32; 2]>()?;
            let (blob, longest_edge) = (BlobId(blob), from.take()?);
            levels.push(SharedLevel { error, blob, triangles, longest_edge, span: from.take()? });
        }
        all.push(levels);
    }
    if from.0.is_empty() { Ok(all) } else { Err(Torn) }
}
