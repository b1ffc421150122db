//! The change from one visible set to the next, coded as it is found.
//!
//! Both ends know the base and how many hlods there are, so an id that leaves is named by its position
//! among the base's ids, one that enters by its position among all others. A change is cut into
//! stretches of ids; a chunk says how many ids leave and enter in its stretch, and codes which
//! (`subset`): log2 C(base ids in the stretch, leaving) + log2 C(others in it, entering) bits, the last
//! bit rounded up. That is the code's own model and its bound: nothing is learnt from the ids, so no
//! choice of them costs less.

use super::interval::{Reader, Writer};
use super::{VisibleSet, entropy_bound_bits, subset};
use crate::id::HlodId;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Changed ids after which a chunk is cut: some 640 bytes, so that framing is a small part of it.
pub const CHUNK_IDS: usize = 512;
/// Bytes of a chunk beside its code: where its stretch ends, and its two counts.
const CHUNK_HEAD: u32 = 8;

/// The change in one stretch of ids, from behind the chunk before up to `through`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeltaChunk {
    /// Last id of the stretch.
    pub through: HlodId,
    /// How many ids of the base leave; with those that enter 1 to [`CHUNK_IDS`].
    pub leaving: u16,
    /// How many ids enter.
    pub entering: u16,
    /// Which, coded.
    #[serde(with = "crate::codec::bytes")]
    pub code: Vec<u8>,
}

/// Why chunks make no set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ChangeError {
    /// A chunk names nothing, too much, or more than its stretch has.
    #[error("a chunk of a change has impossible counts")]
    BadCount,
    /// No writer would have written these bytes.
    #[error("a chunk of a change has a damaged code")]
    BadCode,
    /// A stretch ends where the one before has ended, or beyond the last hlod.
    #[error("a chunk of a change ends at an hlod that is not its to end at")]
    NoSuchId,
}

/// What a change cost.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ChangeTotals {
    /// Ids that left.
    pub leaving: u32,
    /// Ids that entered.
    pub entering: u32,
    /// Bits of code in all chunks. What fills their last bytes is not counted.
    pub code_bits: u32,
    /// Least bits that any code of this model takes: the sum of the chunks' bounds.
    pub bound_bits: f64,
    /// Bytes of all chunks as they are sent: heads, and codes in whole bytes.
    pub chunk_bytes: u32,
}

/// A stretch of ids, split into those of the base and the others.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    /// First id.
    first: u32,
    /// Index in the base of the first base id that is not below `first`.
    base_from: usize,
    /// Base ids in it.
    base_ids: u64,
    /// Other ids in it.
    others: u64,
}

impl Stretch {
    /// From `first` to `through`; none if that is no stretch of `hlods` ids.
    fn new(base: &VisibleSet, hlods: u32, first: u32, through: HlodId) -> Option<Self> {
        if through.0 < first || through.0 >= hlods {
            return None;
        }
        let base_from = base.ids().partition_point(|id| id.0 < first);
        let base_to = base.ids().partition_point(|&id| id <= through);
        let base_ids = (base_to - base_from) as u64;
        let others = u64::from(through.0 - first) + 1 - base_ids;
        Some(Self { first, base_from, base_ids, others })
    }

    /// The code of a change within the stretch, and its bits. Leaving: positions among its base ids.
    /// Entering: positions among its other ids.
    fn code(&self, leaving: &[u32], entering: &[u32]) -> (Vec<u8>, u32) {
        let mut writer = Writer::new();
        subset::write(leaving, self.base_ids, &mut writer);
        subset::write(entering, self.others, &mut writer);
        writer.finish()
    }

    /// Least bits of so many changes within it.
    fn bound_bits(&self, leaving: u64, entering: u64) -> f64 {
        entropy_bound_bits(self.base_ids, leaving) + entropy_bound_bits(self.others, entering)
    }
}

/// Codes the change from a base while the next set is found in id order.
#[derive(Debug)]
pub struct ChangeWriter {
    base: Arc<VisibleSet>,
    hlods: u32,
    /// Base ids passed so far.
    passed: usize,
    next: Vec<HlodId>,
    /// First id behind the last chunk.
    first: u32,
    /// Ids of the base, and other ids, that changed since.
    leaving: Vec<HlodId>,
    entering: Vec<HlodId>,
    totals: ChangeTotals,
}

impl ChangeWriter {
    /// Starts at the lowest id of a scene of `hlods`.
    ///
    /// # Panics
    /// If the base names an hlod that the scene does not have.
    pub fn new(base: Arc<VisibleSet>, hlods: u32) -> Self {
        assert!(base.ids().last().is_none_or(|last| last.0 < hlods), "a base of this scene");
        Self {
            base,
            hlods,
            passed: 0,
            next: Vec::new(),
            first: 0,
            leaving: Vec::new(),
            entering: Vec::new(),
            totals: ChangeTotals::default(),
        }
    }

    /// Takes all ids of the next set up to `through`; appends chunks that have grown full.
    ///
    /// # Panics
    /// If the ids are not sorted, go beyond `through` or the scene, or do not follow those taken before.
    pub fn push(&mut self, through: HlodId, visible: &[HlodId], chunks: &mut Vec<DeltaChunk>) {
        assert!(through.0 < self.hlods, "hlods of this scene");
        for &id in visible {
            assert!(id <= through && self.next.last().is_none_or(|&last| last < id));
            self.leave_below(id, chunks);
            if self.base.ids().get(self.passed) == Some(&id) {
                self.passed += 1;
            } else {
                self.entering.push(id);
                self.cut_if_full(id, chunks);
            }
            self.next.push(id);
        }
        self.leave_below(HlodId(through.0 + 1), chunks);
    }

    /// Ends the set; appends the last chunk, if anything is left for it.
    pub fn finish(mut self, chunks: &mut Vec<DeltaChunk>) -> (VisibleSet, ChangeTotals) {
        while self.passed < self.base.len() {
            self.leave_next(chunks);
        }
        if self.leaving.len() + self.entering.len() > 0 {
            self.cut(HlodId(self.hlods - 1), chunks);
        }
        (VisibleSet::from_sorted(self.next), self.totals)
    }

    fn leave_below(&mut self, id: HlodId, chunks: &mut Vec<DeltaChunk>) {
        while self.base.ids().get(self.passed).is_some_and(|&base_id| base_id < id) {
            self.leave_next(chunks);
        }
    }

    fn leave_next(&mut self, chunks: &mut Vec<DeltaChunk>) {
        let id = self.base.ids()[self.passed];
        self.leaving.push(id);
        self.passed += 1;
        self.cut_if_full(id, chunks);
    }

    /// `changed` is the last id that changed.
    fn cut_if_full(&mut self, changed: HlodId, chunks: &mut Vec<DeltaChunk>) {
        if self.leaving.len() + self.entering.len() == CHUNK_IDS {
            self.cut(changed, chunks);
        }
    }

    /// Makes a chunk of what has changed since the last one.
    fn cut(&mut self, through: HlodId, chunks: &mut Vec<DeltaChunk>) {
        let stretch = Stretch::new(&self.base, self.hlods, self.first, through)
            .expect("changes come in id order");
        let base = &self.base.ids()[stretch.base_from..];
        let below = |id: HlodId| base.partition_point(|&base_id| base_id < id) as u32;
        let leaving: Vec<u32> = self.leaving.drain(..).map(below).collect();
        let entering: Vec<u32> =
            self.entering.drain(..).map(|id| id.0 - stretch.first - below(id)).collect();
        let (code, bits) = stretch.code(&leaving, &entering);

        let totals = &mut self.totals;
        totals.leaving += leaving.len() as u32;
        totals.entering += entering.len() as u32;
        totals.code_bits += bits;
        totals.bound_bits += stretch.bound_bits(leaving.len() as u64, entering.len() as u64);
        totals.chunk_bytes += CHUNK_HEAD + code.len() as u32;
        self.first = through.0 + 1;
        // At most `CHUNK_IDS` each.
        let (leaving, entering) = (leaving.len() as u16, entering.len() as u16);
        chunks.push(DeltaChunk { through, leaving, entering, code });
    }
}

/// Takes chunks in their order, gives the set.
#[derive(Debug)]
pub struct ChangeReader {
    base: Arc<VisibleSet>,
    hlods: u32,
    /// First id behind the last chunk.
    first: u32,
    /// Indices in the base of those that leave.
    leaving: Vec<usize>,
    entering: Vec<HlodId>,
}

impl ChangeReader {
    /// Starts at the lowest id of a scene of `hlods`.
    pub fn new(base: Arc<VisibleSet>, hlods: u32) -> Self {
        Self { base, hlods, first: 0, leaving: Vec::new(), entering: Vec::new() }
    }

    /// Takes the next chunk. After an error the reader is of no more use.
    ///
    /// Never panics, and holds no more than [`CHUNK_IDS`] ids a chunk.
    pub fn push(&mut self, chunk: &DeltaChunk) -> Result<(), ChangeError> {
        let stretch = Stretch::new(&self.base, self.hlods, self.first, chunk.through)
            .ok_or(ChangeError::NoSuchId)?;
        let (leave, enter) = (u64::from(chunk.leaving), u64::from(chunk.entering));
        let possible = leave <= stretch.base_ids && enter <= stretch.others;
        if !possible || !(1..=CHUNK_IDS as u64).contains(&(leave + enter)) {
            return Err(ChangeError::BadCount);
        }

        let mut reader = Reader::new(&chunk.code);
        let leaving = subset::read(&mut reader, leave, stretch.base_ids);
        let entering = subset::read(&mut reader, enter, stretch.others);
        // Any bytes mean something. Those that a writer would not have written are damage.
        if stretch.code(&leaving, &entering).0 != chunk.code {
            return Err(ChangeError::BadCode);
        }

        let base = &self.base.ids()[stretch.base_from..];
        let mut below = 0;
        for position in entering {
            // Of the ids below a base id, as many are others as its value exceeds its index.
            let others_below = |index: usize| base[index].0 - stretch.first - index as u32;
            while below < stretch.base_ids as usize && others_below(below) <= position {
                below += 1;
            }
            self.entering.push(HlodId(stretch.first + position + below as u32));
        }
        self.leaving.extend(leaving.iter().map(|&at| stretch.base_from + at as usize));
        self.first = chunk.through.0 + 1;
        Ok(())
    }

    /// The next set: the base without those that left, with those that entered.
    pub fn finish(self) -> VisibleSet {
        let mut leaving = self.leaving.iter().peekable();
        let mut entering = self.entering.iter().copied().peekable();
        let mut ids = Vec::with_capacity(self.base.len() + self.entering.len());
        for (index, &id) in self.base.ids().iter().enumerate() {
            while let Some(entered) = entering.next_if(|&entered| entered < id) {
                ids.push(entered);
            }
            if leaving.next_if(|&&left| left == index).is_none() {
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
