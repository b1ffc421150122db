//! A list of draws cut where its geometry ends: which blob it needs next, and which it can spare.

use protocol::id::BlobId;
use scene::backend::Draw;
use scene::backend::Draws;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Range;

/// Draws of one blob that follow each other.
#[derive(Debug, Clone)]
struct Run {
    blob: BlobId,
    blends: bool,
    draws: Range<usize>,
}

/// A list on its way to the backend.
#[derive(Debug)]
pub(crate) struct Runs<'a> {
    draws: &'a Draws,
    runs: Vec<Run>,
    /// The first that is not drawn.
    at: usize,
    /// By blob, its last run.
    last: BTreeMap<BlobId, usize>,
    /// Drawn and not needed any more, first drawn first.
    spare: VecDeque<BlobId>,
    /// Ordered and not come yet.
    ordered: BTreeSet<BlobId>,
}

impl<'a> Runs<'a> {
    /// All of `draws` is to be drawn.
    pub(crate) fn new(draws: &'a Draws) -> Self {
        let mut runs = Vec::new();
        for (list, blends) in [(&draws.solid, false), (&draws.blending, true)] {
            let mut start = 0;
            for chunk in list.chunk_by(|a: &Draw, b: &Draw| a.blob == b.blob) {
                let draws = start..start + chunk.len();
                start = draws.end;
                runs.push(Run { blob: chunk[0].blob, blends, draws });
            }
        }
        let last = runs.iter().enumerate().map(|(at, run)| (run.blob, at)).collect();
        Self { draws, runs, at: 0, last, spare: VecDeque::new(), ordered: BTreeSet::new() }
    }

    /// Number of runs.
    pub(crate) fn len(&self) -> usize {
        self.runs.len()
    }

    /// Every blob once.
    pub(crate) fn blobs(&self) -> impl Iterator<Item = BlobId> {
        self.last.keys().copied()
    }

    /// The runs that can be drawn now: up to the first that lacks its blob.
    pub(crate) fn ready(&self, holds: impl Fn(BlobId) -> bool) -> Range<usize> {
        let ready = self.runs[self.at..].iter().take_while(|run| holds(run.blob)).count();
        self.at..self.at + ready
    }

    /// The blob of the first run that is not drawn.
    pub(crate) fn next_blob(&self) -> Option<BlobId> {
        self.runs.get(self.at).map(|run| run.blob)
    }

    /// The draws of some runs.
    pub(crate) fn draws(&self, runs: Range<usize>) -> Draws {
        let mut draws = Draws::default();
        for run in &self.runs[runs] {
            if run.blends {
                draws.blending.extend_from_slice(&self.draws.blending[run.draws.clone()]);
            } else {
                draws.solid.extend_from_slice(&self.draws.solid[run.draws.clone()]);
            }
        }
        draws
    }

    /// Notes that all runs before `end` are drawn.
    pub(crate) fn advance(&mut self, end: usize) {
        for at in self.at..end {
            let blob = self.runs[at].blob;
            if self.last[&blob] == at {
                self.spare.push_back(blob);
            }
        }
        self.at = end;
    }

    /// Missing blobs to order now, in the order of need: as many as `room` bytes hold together with
    /// those on their way, and one at least where none is.
    pub(crate) fn next_orders(
        &mut self,
        room: u64,
        bytes: impl Fn(BlobId) -> u64,
        holds: impl Fn(BlobId) -> bool,
    ) -> Vec<BlobId> {
        let mut under_way: u64 = self.ordered.iter().map(|&blob| bytes(blob)).sum();
        let mut orders = Vec::new();
        for run in &self.runs[self.at..] {
            if holds(run.blob) || self.ordered.contains(&run.blob) {
                continue;
            }
            under_way += bytes(run.blob);
            if under_way > room && !self.ordered.is_empty() {
                break;
            }
            self.ordered.insert(run.blob);
            orders.push(run.blob);
        }
        orders
    }

    /// Notes that a blob has come; whether it is still to be drawn.
    pub(crate) fn arrived(&mut self, blob: BlobId) -> bool {
        self.ordered.remove(&blob);
        self.last.get(&blob).is_some_and(|&last| last >= self.at)
    }

    /// A blob that this list can do without rather than without `arrived`: one it has drawn, else the
    /// one it draws last.
    pub(crate) fn victim(
        &mut self,
        arrived: BlobId,
        holds: impl Fn(BlobId) -> bool,
    ) -> Option<BlobId> {
        while let Some(blob) = self.spare.pop_front() {
            if holds(blob) {
                return Some(blob);
            }
        }
        let first = self.runs[self.at..].iter().position(|run| run.blob == arrived)? + self.at;
        let later = self.runs[first + 1..].iter().rev();
        later.map(|run| run.blob).find(|&blob| {
            // Not one that is drawn before as well.
            holds(blob) && self.runs[self.at..=first].iter().all(|run| run.blob != blob)
        })
    }

    /// Notes that a blob that had come could not be kept.
    pub(crate) fn forget(&mut self, blob: BlobId) {
        self.ordered.remove(&blob);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::id::HlodId;

    fn draws(solid: &[u32], blending: &[u32]) -> Draws {
        let draw = |(item, &blob): (usize, &u32)| Draw {
            blob: BlobId(blob),
            item: HlodId(item as u32),
            linear: [[0.0; 3]; 3],
            offset: [0.0; 3],
            distance: 0.0,
            disparity_step: 0.0,
        };
        let list = |blobs: &[u32]| blobs.iter().enumerate().map(draw).collect();
        Draws { solid: list(solid), blending: list(blending) }
    }

    #[test]
    fn of_nothing_nothing_is_left() {
        let none = Draws::default();
        let mut runs = Runs::new(&none);
        assert_eq!((runs.len(), runs.ready(|_| false)), (0, 0..0));
        assert!(runs.next_orders(9, |_| 1, |_| false).is_empty());
        assert!(!runs.arrived(BlobId(3)) && runs.victim(BlobId(3), |_| true).is_none());
    }

    #[test]
    fn draws_of_one_blob_stay_together_and_all_come_in_order() {
        let list = draws(&[1, 1, 2, 5, 5, 5], &[5, 1, 5]);
        let mut runs = Runs::new(&list);
        assert_eq!(runs.len(), 6);
        assert_eq!(runs.draws(0..6), list);
        assert_eq!(runs.ready(|blob| blob != BlobId(5)), 0..2);
        assert_eq!(runs.draws(0..2).solid, list.solid[..3]);
        runs.advance(2);
        assert_eq!(runs.ready(|_| true), 2..6);
        assert_eq!(runs.draws(3..5).blending, list.blending[..2]);
    }

    #[test]
    fn what_is_missing_is_ordered_in_the_order_of_need_and_once() {
        let list = draws(&[3, 1, 4, 2], &[4]);
        let mut runs = Runs::new(&list);
        let ids = |blobs: Vec<BlobId>| blobs.iter().map(|blob| blob.0).collect::<Vec<_>>();
        let holds = |blob| blob == BlobId(1);
        assert_eq!(ids(runs.next_orders(20, |_| 10, holds)), [3, 4]);
        assert!(runs.next_orders(20, |_| 10, holds).is_empty());
        assert!(runs.arrived(BlobId(3)) && !runs.arrived(BlobId(9)));
        assert_eq!(ids(runs.next_orders(20, |_| 10, |blob| blob.0 < 4 && blob.0 != 2)), [2]);
        // One at least, however large.
        let mut runs = Runs::new(&list);
        assert_eq!(ids(runs.next_orders(5, |_| 10, holds)), [3]);
    }

    #[test]
    fn a_list_spares_what_it_has_drawn_and_then_what_it_draws_last() {
        let list = draws(&[1, 2, 3, 4], &[1]);
        let mut runs = Runs::new(&list);
        runs.advance(2);
        // 1 is needed again, behind all others.
        assert_eq!(runs.victim(BlobId(3), |_| true), Some(BlobId(2)));
        assert_eq!(runs.victim(BlobId(3), |blob| blob != BlobId(2)), Some(BlobId(1)));
        assert_eq!(runs.victim(BlobId(3), |blob| blob == BlobId(4)), Some(BlobId(4)));
        assert_eq!(runs.victim(BlobId(4), |blob| blob == BlobId(3)), None);
        assert!(!runs.arrived(BlobId(2)) && runs.arrived(BlobId(1)));
    }

    #[test]
    fn any_list_is_drawn_whole_and_in_order_with_room_for_one_blob() {
        use rand::{Rng, SeedableRng, rngs::StdRng};
        let mut rng = StdRng::seed_from_u64(4);
        for room in [1, 2, 5] {
            let mut blobs = |count: usize| -> Vec<u32> {
                (0..count).map(|_| rng.random_range(0..12)).collect()
            };
            let (mut solid, blending) = (blobs(40), blobs(15));
            solid.sort_unstable();
            let list = draws(&solid, &blending);
            let mut runs = Runs::new(&list);
            let (mut held, mut drawn, mut steps) = (Vec::<BlobId>::new(), Draws::default(), 0);
            loop {
                let ready = runs.ready(|blob| held.contains(&blob));
                let part = runs.draws(ready.clone());
                drawn.solid.extend(part.solid);
                drawn.blending.extend(part.blending);
                runs.advance(ready.end);
                if ready.end == runs.len() {
                    break;
                }
                steps += 1;
                assert!(steps < 1000, "no way forward with room for {room}");
                for blob in runs.next_orders(3, |_| 1, |blob| held.contains(&blob)) {
                    assert!(runs.arrived(blob));
                    while held.len() >= room {
                        match runs.victim(blob, |blob| held.contains(&blob)) {
                            Some(victim) => held.retain(|&other| other != victim),
                            None => break,
                        }
                    }
                    if held.len() < room {
                        held.push(blob);
                    } else {
                        runs.forget(blob);
                    }
                }
            }
            assert_eq!(drawn, list);
        }
    }
}
