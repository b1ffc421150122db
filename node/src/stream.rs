//! A list of draws cut where what it needs ends: which blob or texture it lacks next, and which it can spare.

use protocol::id::BlobId;
use scene::asset::Asset;
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
    /// By blob, what must be there when it is drawn.
    needs: BTreeMap<BlobId, Vec<Asset>>,
    /// The first that is not drawn.
    at: usize,
    /// By asset, the last run that needs it.
    last: BTreeMap<Asset, usize>,
    /// Drawn and not needed any more, first drawn first.
    spare: VecDeque<Asset>,
    /// Ordered and not come yet.
    ordered: BTreeSet<Asset>,
    /// Nothing may come between what the first run that is not drawn needs.
    in_order: bool,
}

impl<'a> Runs<'a> {
    /// All of `draws` is to be drawn, each blob with all that `needs` names.
    pub(crate) fn new<I: Iterator<Item = Asset>>(
        draws: &'a Draws,
        needs: impl Fn(BlobId) -> I,
    ) -> Self {
        let mut runs = Vec::new();
        for (list, blends) in [(&draws.solid, false), (&draws.blending, true)] {
            let mut start = 0;
            for chunk in list.chunk_by(|a: &Draw, b: &Draw| a.blob == b.blob) {
                let draws = start..start + chunk.len();
                start = draws.end;
                runs.push(Run { blob: chunk[0].blob, blends, draws });
            }
        }
        let needs: BTreeMap<BlobId, Vec<Asset>> =
            runs.iter().map(|run| (run.blob, needs(run.blob).collect())).collect();
        let of_run =
            |(at, run): (usize, &Run)| needs[&run.blob].iter().map(move |&need| (need, at));
        let last = runs.iter().enumerate().flat_map(of_run).collect();
        let (spare, ordered) = (VecDeque::new(), BTreeSet::new());
        Self { draws, runs, needs, at: 0, last, spare, ordered, in_order: false }
    }

    /// Number of runs.
    pub(crate) fn len(&self) -> usize {
        self.runs.len()
    }

    /// All that is needed, once.
    pub(crate) fn assets(&self) -> impl Iterator<Item = Asset> {
        self.last.keys().copied()
    }

    fn needs_of(&self, run: &Run) -> &[Asset] {
        &self.needs[&run.blob]
    }

    /// The runs that can be drawn now: up to the first that lacks something.
    pub(crate) fn ready(&self, holds: impl Fn(Asset) -> bool) -> Range<usize> {
        let is_there = |run: &&Run| self.needs_of(run).iter().all(|&need| holds(need));
        let ready = self.runs[self.at..].iter().take_while(is_there).count();
        self.at..self.at + ready
    }

    /// What the first run that is not drawn needs.
    pub(crate) fn next_needs(&self) -> &[Asset] {
        self.runs.get(self.at).map_or(&[], |run| self.needs_of(run))
    }

    /// Whether anything is missing of what is still to be drawn.
    pub(crate) fn lacks(&self, holds: impl Fn(Asset) -> bool) -> bool {
        self.last.iter().any(|(&asset, &last)| last >= self.at && !holds(asset))
    }

    /// From now on until the first run is drawn that is not, what it needs comes first and alone.
    pub(crate) fn bring_in_order(&mut self) {
        self.in_order = true;
    }

    /// Whether that is so now.
    pub(crate) fn needs_order(&self) -> bool {
        self.in_order
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
            let needs = &self.needs[&self.runs[at].blob];
            self.spare.extend(needs.iter().filter(|need| self.last[need] == at));
        }
        self.in_order &= end == self.at;
        self.at = end;
    }

    /// What is missing and to be ordered now, in the order of need: as much as `room` bytes hold together
    /// with what is on its way, and one at least where nothing is.
    pub(crate) fn next_orders(
        &mut self,
        room: u64,
        bytes: impl Fn(Asset) -> u64,
        holds: impl Fn(Asset) -> bool,
    ) -> Vec<Asset> {
        let mut under_way: u64 = self.ordered.iter().map(|&asset| bytes(asset)).sum();
        let mut orders = Vec::new();
        let needed = self.runs[self.at..].iter().flat_map(|run| &self.needs[&run.blob]);
        for &asset in needed {
            if holds(asset) || self.ordered.contains(&asset) {
                continue;
            }
            under_way += bytes(asset);
            if under_way > room && !self.ordered.is_empty() {
                break;
            }
            self.ordered.insert(asset);
            orders.push(asset);
        }
        orders
    }

    /// Notes that something has come; whether it is still to be drawn.
    pub(crate) fn arrived(&mut self, asset: Asset) -> bool {
        self.ordered.remove(&asset);
        self.last.get(&asset).is_some_and(|&last| last >= self.at)
    }

    /// One of the same kind that this list can do without rather than without `arrived`: one it has drawn,
    /// else the one it draws last.
    pub(crate) fn victim(
        &mut self,
        arrived: Asset,
        holds: impl Fn(Asset) -> bool,
    ) -> Option<Asset> {
        let is_held = |asset: Asset| asset.is_texture() == arrived.is_texture() && holds(asset);
        if let Some(at) = self.spare.iter().position(|&asset| is_held(asset)) {
            return self.spare.remove(at);
        }
        let rest = &self.runs[self.at..];
        let first = rest.iter().position(|run| self.needs_of(run).contains(&arrived))?;
        // Not one that is drawn before as well.
        let sooner: BTreeSet<Asset> =
            rest[..=first].iter().flat_map(|run| self.needs_of(run)).copied().collect();
        let later = rest[first + 1..].iter().rev().flat_map(|run| self.needs_of(run));
        later.copied().find(|asset| is_held(*asset) && !sooner.contains(asset))
    }

    /// Notes that something that had come could not be kept.
    pub(crate) fn forget(&mut self, asset: Asset) {
        self.ordered.remove(&asset);
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

    fn blob(id: u32) -> Asset {
        Asset::Blob(BlobId(id))
    }

    /// Runs of a list whose blobs need nothing but themselves.
    fn bare(list: &Draws) -> Runs<'_> {
        Runs::new(list, |id| std::iter::once(Asset::Blob(id)))
    }

    /// The same where each blob needs two textures, too: one of its own and one that all share.
    fn textured(list: &Draws) -> Runs<'_> {
        Runs::new(list, |id| {
            [Asset::Blob(id), Asset::Texture(0), Asset::Texture(id.0 + 1)].into_iter()
        })
    }

    #[test]
    fn of_nothing_nothing_is_left() {
        let none = Draws::default();
        let mut runs = bare(&none);
        assert_eq!((runs.len(), runs.ready(|_| false)), (0, 0..0));
        assert!(runs.next_orders(9, |_| 1, |_| false).is_empty() && !runs.lacks(|_| false));
        assert!(!runs.arrived(blob(3)) && runs.victim(blob(3), |_| true).is_none());
    }

    #[test]
    fn draws_of_one_blob_stay_together_and_all_come_in_order() {
        let list = draws(&[1, 1, 2, 5, 5, 5], &[5, 1, 5]);
        let mut runs = bare(&list);
        assert_eq!(runs.len(), 6);
        assert_eq!(runs.draws(0..6), list);
        assert_eq!(runs.ready(|asset| asset != blob(5)), 0..2);
        assert_eq!(runs.draws(0..2).solid, list.solid[..3]);
        runs.advance(2);
        assert_eq!(runs.ready(|_| true), 2..6);
        assert_eq!(runs.draws(3..5).blending, list.blending[..2]);
    }

    #[test]
    fn what_is_missing_is_ordered_in_the_order_of_need_and_once() {
        let list = draws(&[3, 1, 4, 2], &[4]);
        let mut runs = bare(&list);
        let holds = |asset| asset == blob(1);
        assert_eq!(runs.next_orders(20, |_| 10, holds), [3, 4].map(blob));
        assert!(runs.next_orders(20, |_| 10, holds).is_empty());
        assert!(runs.arrived(blob(3)) && !runs.arrived(blob(9)));
        let but_two = |asset| [1, 3].map(blob).contains(&asset);
        assert_eq!(runs.next_orders(20, |_| 10, but_two), [blob(2)]);
        // One at least, however large.
        let mut runs = bare(&list);
        assert_eq!(runs.next_orders(5, |_| 10, holds), [blob(3)]);
    }

    #[test]
    fn a_blob_is_drawn_once_its_textures_are_there() {
        let list = draws(&[1, 2], &[]);
        let mut runs = textured(&list);
        let [shared, own] = [0, 2].map(Asset::Texture);
        assert_eq!(runs.ready(|asset| !asset.is_texture()), 0..0);
        assert_eq!(runs.next_needs(), [blob(1), shared, own]);
        let all = [blob(1), shared, own, blob(2), Asset::Texture(3)];
        assert_eq!(runs.next_orders(99, |_| 1, |_| false), all);
        let mut held = vec![blob(1), own];
        assert_eq!(runs.ready(|asset| held.contains(&asset)), 0..0);
        held.push(shared);
        assert_eq!(runs.ready(|asset| held.contains(&asset)), 0..1);
        runs.advance(1);
        // A texture goes for a texture, and not one that is still needed.
        assert_eq!(runs.victim(Asset::Texture(3), |asset| held.contains(&asset)), Some(own));
        assert_eq!(runs.victim(Asset::Texture(3), |asset| asset == shared), None);
        assert_eq!(runs.victim(blob(2), |asset| held.contains(&asset)), Some(blob(1)));
        assert!(runs.lacks(|asset| held.contains(&asset)));
        held.extend([blob(2), Asset::Texture(3)]);
        assert!(!runs.lacks(|asset| held.contains(&asset)));
    }

    #[test]
    fn a_list_spares_what_it_has_drawn_and_then_what_it_draws_last() {
        let list = draws(&[1, 2, 3, 4], &[1]);
        let mut runs = bare(&list);
        runs.advance(2);
        // 1 is needed again, behind all others.
        assert_eq!(runs.victim(blob(3), |_| true), Some(blob(2)));
        assert_eq!(runs.victim(blob(3), |asset| asset != blob(2)), Some(blob(1)));
        assert_eq!(runs.victim(blob(3), |asset| asset == blob(4)), Some(blob(4)));
        assert_eq!(runs.victim(blob(4), |asset| asset == blob(3)), None);
        assert!(!runs.arrived(blob(2)) && runs.arrived(blob(1)));
    }

    #[test]
    fn any_list_is_drawn_whole_and_in_order_with_room_for_one_blob() {
        use rand::{Rng, SeedableRng, rngs::StdRng};
        let mut rng = StdRng::seed_from_u64(4);
        for (room, with_textures) in [(1, false), (2, false), (5, false), (1, true), (3, true)] {
            let mut blobs = |count: usize| -> Vec<u32> {
                (0..count).map(|_| rng.random_range(0..12)).collect()
            };
            let (mut solid, blending) = (blobs(40), blobs(15));
            solid.sort_unstable();
            let list = draws(&solid, &blending);
            let mut runs = if with_textures { textured(&list) } else { bare(&list) };
            // Textures have room of their own.
            let room_of = |asset: Asset| if asset.is_texture() { room + 1 } else { room };
            let (mut held, mut drawn, mut steps) = (Vec::<Asset>::new(), Draws::default(), 0);
            loop {
                let ready = runs.ready(|asset| held.contains(&asset));
                let part = runs.draws(ready.clone());
                drawn.solid.extend(part.solid);
                drawn.blending.extend(part.blending);
                runs.advance(ready.end);
                if ready.end == runs.len() {
                    break;
                }
                steps += 1;
                assert!(steps < 1000, "no way forward with room for {room}");
                for asset in runs.next_orders(3, |_| 1, |asset| held.contains(&asset)) {
                    assert!(runs.arrived(asset));
                    let of_kind = |held: &[Asset]| {
                        held.iter().filter(|one| one.is_texture() == asset.is_texture()).count()
                    };
                    while of_kind(&held) >= room_of(asset) {
                        match runs.victim(asset, |other| held.contains(&other)) {
                            Some(victim) => held.retain(|&other| other != victim),
                            None => break,
                        }
                    }
                    if of_kind(&held) < room_of(asset) {
                        held.push(asset);
                    } else {
                        runs.forget(asset);
                    }
                }
            }
            assert_eq!(drawn, list);
        }
    }
}
