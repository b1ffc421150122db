//! The visible sets a node holds, and those on their way to it (paper 004, section 4.4).

use crate::id::FrameIndex;
use crate::telemetry::Nanos;
use crate::visible::{ChangeReader, ChangeWriter, DeltaChunk, VisibleSet};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A visible set that is known whole.
#[derive(Debug, Clone)]
pub(super) struct Held {
    /// The set.
    pub(super) set: Arc<VisibleSet>,
    /// When its end-of-frame message was handled; none where it was culled here.
    pub(super) received: Option<Nanos>,
}

/// What the end of a frame means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ended {
    /// The set is held now.
    Complete,
    /// Base or sum is wrong: the sender must be asked for the whole set.
    AskWhole,
}

/// Chunks of one frame.
#[derive(Debug, Default)]
struct Incoming {
    /// The base named by the first chunk, and its reader while that makes sense.
    stream: Option<(Option<FrameIndex>, Option<ChangeReader>)>,
    whole_asked: bool,
}

/// All sets by frame.
#[derive(Debug)]
pub(super) struct Sets {
    /// Hlods of the scene.
    hlods: u32,
    held: BTreeMap<FrameIndex, Held>,
    incoming: BTreeMap<FrameIndex, Incoming>,
}

impl Sets {
    /// No set of a scene of `hlods` is held.
    pub(super) fn of_scene(hlods: u32) -> Self {
        Self { hlods, held: BTreeMap::new(), incoming: BTreeMap::new() }
    }

    /// Hlods of the scene.
    pub(super) fn hlods(&self) -> u32 {
        self.hlods
    }

    /// V_`frame`, if it is held.
    pub(super) fn get(&self, frame: FrameIndex) -> Option<&Held> {
        self.held.get(&frame)
    }

    /// The set a change starts from; no base is the empty set.
    pub(super) fn base(&self, base: Option<FrameIndex>) -> Option<Arc<VisibleSet>> {
        match base {
            None => Some(Arc::default()),
            Some(frame) => self.get(frame).map(|held| held.set.clone()),
        }
    }

    /// Holds V_`frame`.
    pub(super) fn insert(&mut self, frame: FrameIndex, held: Held) {
        self.held.insert(frame, held);
    }

    /// Takes a chunk; the error is what the sender did wrong.
    pub(super) fn chunk(
        &mut self,
        frame: FrameIndex,
        base: Option<FrameIndex>,
        chunk: &DeltaChunk,
    ) -> Result<(), String> {
        let (set, hlods) = (self.base(base), self.hlods);
        let incoming = self.incoming.entry(frame).or_default();
        if incoming.whole_asked && base.is_some() {
            return Err(format!("sent a change where V_{frame} was asked for whole"));
        }
        let reader = || set.map(|base| ChangeReader::new(base, hlods));
        let (first_base, reader) = incoming.stream.get_or_insert_with(|| (base, reader()));
        if *first_base != base {
            return Err(format!("changed the base of V_{frame} half way"));
        }
        // A code that does not fit may come of a wrong base here: the end of the frame decides.
        if reader.as_mut().is_some_and(|reader| reader.push(chunk).is_err()) {
            *reader = None;
        }
        Ok(())
    }

    /// Takes the end of a frame; `base` is what no chunk at all is a change of.
    pub(super) fn end(
        &mut self,
        now: Nanos,
        frame: FrameIndex,
        base: Option<FrameIndex>,
        (visible, checksum): (u32, u64),
    ) -> Result<Ended, String> {
        let Incoming { stream, whole_asked } = self.incoming.remove(&frame).unwrap_or_default();
        let base = if whole_asked { None } else { base };
        let reader = match stream {
            Some((_, reader)) => reader,
            None => self.base(base).map(|base| ChangeReader::new(base, self.hlods)),
        };
        let right = |set: &VisibleSet| set.len() == visible as usize && set.checksum() == checksum;
        if let Some(set) = reader.map(ChangeReader::finish).filter(right) {
            self.insert(frame, Held { set: Arc::new(set), received: Some(now) });
            return Ok(Ended::Complete);
        }
        if whole_asked {
            return Err(format!("sent V_{frame} whole, and it does not match its checksum"));
        }
        self.incoming.insert(frame, Incoming { stream: None, whole_asked: true });
        Ok(Ended::AskWhole)
    }

    /// V_`frame` as a change of the empty set.
    pub(super) fn whole(&self, frame: FrameIndex) -> Option<(Vec<DeltaChunk>, Arc<VisibleSet>)> {
        let set = self.get(frame)?.set.clone();
        let mut chunks = Vec::new();
        let mut writer = ChangeWriter::new(Arc::default(), self.hlods);
        if let Some(&last) = set.ids().last() {
            writer.push(last, set.ids(), &mut chunks);
        }
        writer.finish(&mut chunks);
        Some((chunks, set))
    }

    /// Drops what lies before `frame`.
    pub(super) fn forget_before(&mut self, frame: FrameIndex) {
        self.held = self.held.split_off(&frame);
        self.incoming = self.incoming.split_off(&frame);
    }

    /// Replaces V_`frame` by the empty set, as a fault would.
    #[cfg(test)]
    pub(super) fn corrupt(&mut self, frame: FrameIndex) {
        if let Some(held) = self.held.get_mut(&frame) {
            held.set = Arc::default();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::HlodId;

    fn set(ids: &[u32]) -> Arc<VisibleSet> {
        Arc::new(VisibleSet::from_sorted(ids.iter().copied().map(HlodId).collect()))
    }

    fn with_base() -> Sets {
        let mut sets = Sets::of_scene(9);
        sets.insert(FrameIndex(0), Held { set: set(&[1, 2]), received: None });
        sets
    }

    #[test]
    fn no_chunk_means_no_change() {
        let mut sets = with_base();
        let sum = set(&[1, 2]).checksum();
        let ended = sets.end(5, FrameIndex(1), Some(FrameIndex(0)), (2, sum));
        assert_eq!(ended, Ok(Ended::Complete));
        assert_eq!(sets.get(FrameIndex(1)).unwrap().received, Some(5));
    }

    #[test]
    fn a_wrong_sum_or_size_alone_asks_for_the_whole() {
        let sum = set(&[1, 2]).checksum();
        for stated in [(2, sum ^ 1), (3, sum)] {
            let ended = with_base().end(0, FrameIndex(1), Some(FrameIndex(0)), stated);
            assert_eq!(ended, Ok(Ended::AskWhole));
        }
    }

    #[test]
    fn a_missing_base_is_asked_for_once() {
        let mut sets = Sets::of_scene(9);
        let (frame, base) = (FrameIndex(4), Some(FrameIndex(3)));
        assert_eq!(sets.end(0, frame, base, (1, 0)), Ok(Ended::AskWhole));
        let (chunks, whole) = with_base().whole(FrameIndex(0)).unwrap();
        assert!(sets.chunk(frame, base, &chunks[0]).is_err());
        sets.chunk(frame, None, &chunks[0]).unwrap();
        assert_eq!(sets.end(0, frame, base, (2, whole.checksum())), Ok(Ended::Complete));
        assert_eq!(sets.get(frame).unwrap().set, whole);
    }

    #[test]
    fn a_whole_set_that_is_wrong_ends_it() {
        let mut sets = Sets::of_scene(9);
        assert_eq!(sets.end(0, FrameIndex(0), None, (1, 0)), Ok(Ended::AskWhole));
        assert!(sets.end(0, FrameIndex(0), None, (1, 0)).is_err());
    }

    #[test]
    fn the_base_may_not_change_half_way() {
        let mut sets = with_base();
        let chunk = DeltaChunk { through: HlodId(8), leaving: 0, entering: 1, code: vec![0] };
        sets.chunk(FrameIndex(1), None, &chunk).unwrap();
        assert!(sets.chunk(FrameIndex(1), Some(FrameIndex(0)), &chunk).is_err());
    }
}
