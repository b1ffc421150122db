//! The change from one visible set to the next, coded as it is found.
//!
//! The base is known at both ends, so an id that leaves is named by its position within the base
//! and an id that enters by its position among all ids that are not in it: together less than naming
//! both among all ids, which is what log2 C(N, k) counts. A chunk holds, packed from the least
//! significant bit: how many of its ids leave (absent where the base is empty), their gaps, then the
//! gaps of those that enter. Positions and the learnt mean gaps carry on from chunk to chunk.

use super::VisibleSet;
use super::rice::{BitReader, BitWriter, GapModel};
use crate::id::HlodId;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Changed ids after which a chunk is cut: some 640 bytes, so that framing is a small part of it.
const CHUNK_IDS: usize = 512;
/// Guess of the mean gap of a whole set, until a gap is seen.
const WHOLE_SET_MEAN_GAP: u32 = 16;

/// A part of a change, compactly coded.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeltaChunk {
    /// How many ids it names, at least 1.
    pub count: u32,
    /// Their gaps, coded.
    #[serde(with = "crate::codec::bytes")]
    pub code: Vec<u8>,
}

/// Why chunks make no set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ChangeError {
    /// A chunk names nothing, or more ids leave than it names.
    #[error("a chunk of a change has impossible counts")]
    BadCount,
    /// Bits end early, are left over, or no writer would have written them.
    #[error("a chunk of a change has a damaged code")]
    BadCode,
    /// An id leaves that the base does not have, or one enters beyond 32 bits.
    #[error("a change names an id that does not exist")]
    NoSuchId,
}

/// What a change cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ChangeTotals {
    /// Ids that left or entered.
    pub changed: u32,
    /// Bytes of code in all chunks.
    pub code_bytes: u32,
}

/// One of the two lists: a rising sequence of positions, sent as gaps.
#[derive(Debug)]
struct Track {
    next: u32,
    gaps: GapModel,
}

impl Track {
    fn new(mean: u32) -> Self {
        Self { next: 0, gaps: GapModel::new(mean) }
    }

    fn write(&mut self, position: u32, out: &mut BitWriter) {
        self.gaps.write(position - self.next, out);
        // Position u32::MAX is the last there is, so nothing is written after a saturated one.
        self.next = position.saturating_add(1);
    }

    fn read(&mut self, from: &mut BitReader<'_>) -> Result<u32, ChangeError> {
        let gap = self.gaps.read(from).ok_or(ChangeError::BadCode)?;
        let position = self.next.checked_add(gap).ok_or(ChangeError::NoSuchId)?;
        self.next = position.saturating_add(1);
        Ok(position)
    }
}

/// Both lists, first guesses made from the base and the first chunk's counts, as both ends can.
#[derive(Debug)]
struct Tracks {
    leaving: Track,
    entering: Track,
}

impl Tracks {
    fn new(base: &VisibleSet, leaving: u32, entering: u32) -> Self {
        let mean =
            |universe: u32, picked: u32| universe.saturating_sub(picked) / picked.saturating_add(1);
        let size = base.len() as u32;
        // Ids go on about as far as the base does.
        let outside = base.ids().last().map(|last| last.0 - (size - 1));
        Self {
            leaving: Track::new(mean(size, leaving)),
            entering: Track::new(outside.map_or(WHOLE_SET_MEAN_GAP, |n| mean(n, entering))),
        }
    }
}

/// Bits that tell how many of `count` ids leave.
fn split_bits(base: &VisibleSet, count: u32) -> u32 {
    if base.is_empty() { 0 } else { u32::BITS - count.leading_zeros() }
}

/// Codes the change from a base while the next set is found in id order.
#[derive(Debug)]
pub struct ChangeWriter {
    base: Arc<VisibleSet>,
    /// Base ids passed so far.
    passed: usize,
    next: Vec<HlodId>,
    leaving: Vec<u32>,
    entering: Vec<u32>,
    tracks: Option<Tracks>,
    totals: ChangeTotals,
}

impl ChangeWriter {
    /// Starts at the lowest id.
    pub fn new(base: Arc<VisibleSet>) -> Self {
        Self {
            base,
            passed: 0,
            next: Vec::new(),
            leaving: Vec::new(),
            entering: Vec::new(),
            tracks: None,
            totals: ChangeTotals::default(),
        }
    }

    /// Takes all ids of the next set up to `through`; appends chunks that have grown full.
    ///
    /// # Panics
    /// If the ids are not sorted, go beyond `through` or do not follow those taken before.
    pub fn push(&mut self, through: HlodId, visible: &[HlodId], chunks: &mut Vec<DeltaChunk>) {
        for &id in visible {
            assert!(id <= through && self.next.last().is_none_or(|&last| last < id));
            self.leave_below(id, chunks);
            if self.base.ids().get(self.passed) == Some(&id) {
                self.passed += 1;
            } else {
                self.entering.push(id.0 - self.passed as u32);
                self.cut_if(CHUNK_IDS, chunks);
            }
            self.next.push(id);
        }
        self.leave_below(HlodId(through.0.saturating_add(1)), chunks);
    }

    /// Ends the set; appends the last chunk, if anything is left for it.
    pub fn finish(mut self, chunks: &mut Vec<DeltaChunk>) -> (VisibleSet, ChangeTotals) {
        while self.passed < self.base.len() {
            self.leave_next(chunks);
        }
        self.cut_if(1, chunks);
        (VisibleSet::from_sorted(self.next), self.totals)
    }

    fn leave_below(&mut self, id: HlodId, chunks: &mut Vec<DeltaChunk>) {
        while self.base.ids().get(self.passed).is_some_and(|&base_id| base_id < id) {
            self.leave_next(chunks);
        }
    }

    fn leave_next(&mut self, chunks: &mut Vec<DeltaChunk>) {
        self.leaving.push(self.passed as u32);
        self.passed += 1;
        self.cut_if(CHUNK_IDS, chunks);
    }

    fn cut_if(&mut self, least: usize, chunks: &mut Vec<DeltaChunk>) {
        let count = self.leaving.len() + self.entering.len();
        if count < least {
            return;
        }
        let (count, leave) = (count as u32, self.leaving.len() as u32);
        let tracks =
            self.tracks.get_or_insert_with(|| Tracks::new(&self.base, leave, count - leave));
        let mut out = BitWriter::default();
        out.put(leave, split_bits(&self.base, count));
        self.leaving.drain(..).for_each(|position| tracks.leaving.write(position, &mut out));
        self.entering.drain(..).for_each(|position| tracks.entering.write(position, &mut out));
        let code = out.into_bytes();
        self.totals.changed += count;
        self.totals.code_bytes += code.len() as u32;
        chunks.push(DeltaChunk { count, code });
    }
}

/// Rebuilds the next set from its base and chunks.
#[derive(Debug)]
pub struct ChangeReader {
    base: Arc<VisibleSet>,
    /// Base ids below the last one that entered.
    passed: usize,
    leaving: Vec<u32>,
    entering: Vec<HlodId>,
    tracks: Option<Tracks>,
}

impl ChangeReader {
    /// Starts at the lowest id.
    pub fn new(base: Arc<VisibleSet>) -> Self {
        Self { base, passed: 0, leaving: Vec::new(), entering: Vec::new(), tracks: None }
    }

    /// Takes the next chunk. After an error the reader is of no more use.
    ///
    /// Never panics, and allocates no more than the code's bits can name.
    pub fn push(&mut self, chunk: &DeltaChunk) -> Result<(), ChangeError> {
        let count = chunk.count;
        let mut bits = BitReader::new(&chunk.code);
        let leave = bits.take(split_bits(&self.base, count)).ok_or(ChangeError::BadCode)?;
        let enter = count.checked_sub(leave).ok_or(ChangeError::BadCount)?;
        if count == 0 {
            return Err(ChangeError::BadCount);
        }
        let tracks = self.tracks.get_or_insert_with(|| Tracks::new(&self.base, leave, enter));
        for _ in 0..leave {
            let position = tracks.leaving.read(&mut bits)?;
            if position as usize >= self.base.len() {
                return Err(ChangeError::NoSuchId);
            }
            self.leaving.push(position);
        }
        for _ in 0..enter {
            let position = tracks.entering.read(&mut bits)?;
            // Of the ids below a base id, as many are outside the base as its value exceeds its index.
            let outside_below = |(index, id): (usize, &HlodId)| id.0 - index as u32;
            while let Some(id) = self.base.ids().get(self.passed)
                && outside_below((self.passed, id)) <= position
            {
                self.passed += 1;
            }
            let id = position.checked_add(self.passed as u32).ok_or(ChangeError::NoSuchId)?;
            // A saturated position repeats: only a damaged code does that.
            if self.entering.last().is_some_and(|last| last.0 >= id) {
                return Err(ChangeError::NoSuchId);
            }
            self.entering.push(HlodId(id));
        }
        if bits.ends_here() { Ok(()) } else { Err(ChangeError::BadCode) }
    }

    /// The next set: the base without those that left, with those that entered.
    pub fn finish(self) -> VisibleSet {
        let mut leaving = self.leaving.iter().peekable();
        let mut entering = self.entering.iter().copied().peekable();
        let mut ids = Vec::with_capacity(self.base.len() + self.entering.len());
        for (position, &id) in self.base.ids().iter().enumerate() {
            while let Some(entered) = entering.next_if(|&entered| entered < id) {
                ids.push(entered);
            }
            if leaving.next_if(|&&left| left as usize == position).is_none() {
                ids.push(id);
            }
        }
        ids.extend(entering);
        VisibleSet::from_sorted(ids)
    }
}

#[cfg(test)]
#[path = "change_tests.rs"]
mod tests;
