//! Which blobs a backend holds, and which of them go first where room is needed (paper 004, section
//! 5.4: the footprint is an input).
//!
//! Least recently used goes first. What the present frame uses is never offered here: a frame that
//! does not fit as a whole is drawn in parts, and its own blobs are given up by whoever draws it.

use protocol::id::BlobId;
use std::collections::BTreeSet;

/// Counts drawings; a blob is as old as the last one that used it. [`Stamp::MAX`] is for good.
pub type Stamp = u64;

/// What is known of a resident blob.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Held {
    used: Stamp,
    /// Read before it was needed, and not needed since.
    foreseen: bool,
}

/// The blobs a backend holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Residency {
    blobs: Vec<Option<Held>>,
    by_age: BTreeSet<(Stamp, BlobId)>,
}

/// What a use found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Use {
    /// The drawing that used the blob last, or took it in.
    pub before: Stamp,
    /// It was read ahead, and this is its first use.
    pub foreseen: bool,
}

impl Residency {
    /// Nothing is held of a scene of so many blobs.
    pub fn new(blobs: usize) -> Self {
        Self { blobs: vec![None; blobs], by_age: BTreeSet::new() }
    }

    /// Whether the backend holds a blob.
    pub fn holds(&self, blob: BlobId) -> bool {
        self.blobs[blob.index()].is_some()
    }

    /// Notes an upload. `foreseen`: before it was needed.
    ///
    /// # Panics
    /// If it was held before.
    pub fn insert(&mut self, blob: BlobId, now: Stamp, foreseen: bool) {
        let before = self.blobs[blob.index()].replace(Held { used: now, foreseen });
        assert!(before.is_none(), "blob {blob} was uploaded twice");
        self.by_age.insert((now, blob));
    }

    /// Notes that a held blob is used now, unless it is held for good.
    ///
    /// # Panics
    /// If it is not held.
    pub fn touch(&mut self, blob: BlobId, now: Stamp) -> Use {
        let held = self.blobs[blob.index()].as_mut().expect("only what is held is used");
        let found = Use { before: held.used, foreseen: std::mem::take(&mut held.foreseen) };
        if held.used < now {
            self.by_age.remove(&(held.used, blob));
            self.by_age.insert((now, blob));
            held.used = now;
        }
        found
    }

    /// Blobs used, or taken in, at `stamp` or later.
    pub fn used_since(&self, stamp: Stamp) -> impl Iterator<Item = BlobId> {
        self.by_age.range((stamp, BlobId(0))..).map(|&(_, blob)| blob)
    }

    /// Blobs that nothing has used at `now` or later, the least recently used first; of equals the lowest.
    pub fn older_than(&self, now: Stamp) -> impl Iterator<Item = BlobId> {
        self.by_age.range(..(now, BlobId(0))).map(|&(_, blob)| blob)
    }

    /// Notes that a blob was evicted.
    ///
    /// # Panics
    /// If it is not held.
    pub fn remove(&mut self, blob: BlobId) {
        let held = self.blobs[blob.index()].take().expect("only what is held is evicted");
        self.by_age.remove(&(held.used, blob));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    #[test]
    fn of_nothing_nothing_goes() {
        let residency = Residency::new(0);
        assert!(
            residency.older_than(9).next().is_none() && residency.used_since(0).next().is_none()
        );
    }

    #[test]
    fn the_least_recently_used_goes_first_and_never_the_present() {
        let mut residency = Residency::new(4);
        for (blob, now) in [(2, 1), (0, 1), (1, 2), (3, 3)] {
            residency.insert(BlobId(blob), now, false);
        }
        residency.touch(BlobId(0), 3);
        assert_eq!(residency.older_than(3).next(), Some(BlobId(2)));
        residency.remove(BlobId(2));
        assert_eq!(residency.older_than(3).next(), Some(BlobId(1)));
        residency.remove(BlobId(1));
        assert_eq!(residency.older_than(3).next(), None);
        assert_eq!(residency.used_since(3).collect::<Vec<_>>(), [BlobId(0), BlobId(3)]);
    }

    #[test]
    fn what_was_foreseen_counts_once() {
        let mut residency = Residency::new(1);
        residency.insert(BlobId(0), 1, true);
        assert_eq!(residency.touch(BlobId(0), 1), Use { before: 1, foreseen: true });
        assert_eq!(residency.touch(BlobId(0), 2), Use { before: 1, foreseen: false });
        residency.remove(BlobId(0));
        residency.insert(BlobId(0), 3, false);
        assert_eq!(residency.touch(BlobId(0), 3), Use { before: 3, foreseen: false });
    }

    #[test]
    fn what_is_held_for_good_stays() {
        let mut residency = Residency::new(1);
        residency.insert(BlobId(0), 1, false);
        residency.touch(BlobId(0), Stamp::MAX);
        residency.touch(BlobId(0), 2);
        assert_eq!(residency.older_than(Stamp::MAX).next(), None);
    }

    #[test]
    fn any_use_gives_the_order_of_a_plain_list() {
        let mut rng = StdRng::seed_from_u64(3);
        let mut residency = Residency::new(12);
        let mut uses: Vec<Option<Stamp>> = vec![None; 12];
        for now in 1..2000 {
            let blob = BlobId(rng.random_range(0..12));
            match uses[blob.index()] {
                None => residency.insert(blob, now, rng.random_bool(0.5)),
                Some(_) if rng.random_bool(0.3) => {
                    residency.remove(blob);
                    uses[blob.index()] = None;
                    continue;
                }
                Some(_) => _ = residency.touch(blob, now),
            }
            uses[blob.index()] = Some(now);
            let oldest = (0..12).filter_map(|id| Some((uses[id as usize]?, BlobId(id)))).min();
            let expected = oldest.filter(|(used, _)| *used < now).map(|(_, blob)| blob);
            assert_eq!(residency.older_than(now).next(), expected);
        }
    }
}
