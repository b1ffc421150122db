//! Which vertices several pieces of one mesh share.

use crate::pieces::{ALL_PIECES, PieceMesh};
use crate::scratch::Buckets;
use crate::work::{Appender, Span, Work, WorkError};
use bytemuck::{Pod, Zeroable};
use glam::DVec3;
use rayon::prelude::*;

/// More pieces than this round one vertex count as all of the mesh's.
const MOST_SHARERS: usize = 8;

/// A vertex of a piece by the hash of where it is: two that collide are only held in place without need.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct Place {
    hash: u64,
    piece: u32,
    vertex: u32,
}

/// A vertex of a piece, and another piece that has one in the same place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct Seam {
    piece: u32,
    vertex: u32,
    other: u32,
}

fn places(number: u32, piece: &PieceMesh) -> impl Iterator<Item = Place> {
    piece.vertices.iter().zip(0..).map(move |(vertex, index)| Place {
        hash: hash_of(piece.position(vertex)),
        piece: number,
        vertex: index,
    })
}

/// A hash of a place; that of -0 and of 0 is the same.
pub(crate) fn hash_of(place: DVec3) -> u64 {
    let bits = place.to_array().map(|c| (c + 0.0).to_bits());
    bits.iter()
        .fold(0u64, |hash, word| (hash.rotate_left(23) ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15))
}

/// The seams among all places that have one of some hashes, in no order.
fn matched(mut places: Vec<Place>, mut found: impl FnMut(Seam)) {
    places.par_sort_unstable();
    let mut sharers: Vec<u32> = Vec::new();
    for group in places.chunk_by(|a, b| a.hash == b.hash) {
        sharers.clear();
        sharers.extend(group.iter().map(|place| place.piece));
        sharers.dedup();
        if sharers.len() < 2 {
            continue;
        }
        for &Place { piece, vertex, .. } in group {
            if sharers.len() > MOST_SHARERS {
                found(Seam { piece, vertex, other: ALL_PIECES });
            } else {
                let others = sharers.iter().filter(|&&other| other != piece);
                others.for_each(|&other| found(Seam { piece, vertex, other }));
            }
        }
    }
}

/// Notes for every vertex which other pieces have one in the same place.
pub(crate) fn find(pieces: &mut [PieceMesh]) {
    if pieces.len() < 2 {
        return;
    }
    let all = pieces.par_iter().enumerate();
    let all = all.flat_map_iter(|(number, piece)| places(number as u32, piece)).collect();
    matched(all, |Seam { piece, vertex, other }| {
        pieces[piece as usize].seams.push([vertex, other]);
    });
    pieces.par_iter_mut().for_each(|piece| piece.seams.sort_unstable());
}

/// Finds the seams of more pieces than are in memory at once.
pub(crate) struct SeamFinder<'a> {
    work: &'a Work,
    places: Buckets<Place>,
    pieces: u32,
}

impl<'a> SeamFinder<'a> {
    /// For a mesh of about so many vertices, `most` of whose places may be in memory at once.
    pub(crate) fn new(work: &'a Work, vertices: u64, most: u64) -> Result<Self, WorkError> {
        // The vertices on seams count more than once.
        let buckets = (2 * vertices).div_ceil(most.max(1));
        Ok(Self { work, places: Buckets::create(work, "places", buckets)?, pieces: 0 })
    }

    /// Takes the next piece.
    pub(crate) fn add(&mut self, piece: &PieceMesh) -> Result<(), WorkError> {
        let number = self.pieces;
        self.pieces += 1;
        places(number, piece).try_for_each(|place| {
            let share = ((place.hash >> 32) * self.places.count()) >> 32;
            self.places.push(share, place)
        })
    }

    /// Appends what is found to `file`: where the seams of each piece lie, as pairs of a vertex and
    /// another piece.
    pub(crate) fn finish(self, file: &mut Appender) -> Result<Vec<Span>, WorkError> {
        let Self { work, places, pieces } = self;
        let mut seams = Buckets::create(work, "seams", places.count())?;
        for bucket in places.finish()? {
            let mut written = Ok(());
            matched(bucket.load()?, |seam| {
                let share = u64::from(seam.piece) * seams.count() / u64::from(pieces);
                if written.is_ok() {
                    written = seams.push(share, seam);
                }
            });
            written?;
        }
        let mut spans = vec![Span::default(); pieces as usize];
        for bucket in seams.finish()? {
            let mut bucket = bucket.load()?;
            bucket.par_sort_unstable();
            for group in bucket.chunk_by(|a, b| a.piece == b.piece) {
                let pairs: Vec<[u32; 2]> = group.iter().map(|s| [s.vertex, s.other]).collect();
                spans[group[0].piece as usize] = file.add(&[bytemuck::cast_slice(&pairs)])?;
            }
        }
        Ok(spans)
    }
}
