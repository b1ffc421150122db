//! Which blobs and textures a backend holds, and which of them go first where room is needed (Manocha, section
//! 5.4: the footprint is an input).
//!
//! Least recently used goes first. What the present frame uses is never offered here: a frame that
//! does not fit as a whole is drawn in parts, and its own are given up by whoever draws it.

use crate::asset::Asset;
use protocol::id::BlobId;
use std::collections::BTreeSet;

/// Counts drawings; an asset is as old as the last one that used it. [`Stamp::MAX`] is for good.
pub type Stamp = u64;

/// What is known of a resident asset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Held {
    used: Stamp,
    /// Read before it was needed, and not needed since.
    foreseen: bool,
}

/// The blobs and textures a backend holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Residency {
    /// Blobs of the scene.
    blobs: usize,
    /// By [`Asset::index`].
    held: Vec<Option<Held>>,
    by_age: BTreeSet<(Stamp, Asset)>,
}

/// What a use found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Use {
    /// The drawing that used it last, or took it in.
    pub before: Stamp,
    /// It was read ahead, and this is its first use.
    pub foreseen: bool,
}

impl Residency {
    /// Nothing is held of a scene of so many blobs and textures.
    pub fn new(blobs: usize, textures: usize) -> Self {
        Self { blobs, held: vec![None; blobs + textures], by_age: BTreeSet::new() }
    }

    fn slot(&mut self, asset: Asset) -> &mut Option<Held> {
        &mut self.held[asset.index(self.blobs)]
    }

    /// Whether the backend holds it.
    pub fn holds(&self, asset: Asset) -> bool {
        self.held[asset.index(self.blobs)].is_some()
    }

    /// Whether it is held, and for good.
    pub fn is_for_good(&self, asset: Asset) -> bool {
        self.held[asset.index(self.blobs)].is_some_and(|held| held.used == Stamp::MAX)
    }

    /// Notes an upload. `foreseen`: before it was needed.
    ///
    /// # Panics
    /// If it was held before.
    pub fn insert(&mut self, asset: Asset, now: Stamp, foreseen: bool) {
        let before = self.slot(asset).replace(Held { used: now, foreseen });
        assert!(before.is_none(), "{asset} was uploaded twice");
        self.by_age.insert((now, asset));
    }

    /// Notes that a held asset is used now, unless it is held for good.
    ///
    /// # Panics
    /// If it is not held.
    pub fn touch(&mut self, asset: Asset, now: Stamp) -> Use {
        let held = self.held[asset.index(self.blobs)].as_mut().expect("only what is held is used");
        let found = Use { before: held.used, foreseen: std::mem::take(&mut held.foreseen) };
        if held.used < now {
            self.by_age.remove(&(held.used, asset));
            self.by_age.insert((now, asset));
            held.used = now;
        }
        found
    }

    /// What was used, or taken in, at `stamp` or later.
    pub fn used_since(&self, stamp: Stamp) -> impl Iterator<Item = Asset> {
        self.by_age.range((stamp, Asset::Blob(BlobId(0)))..).map(|&(_, asset)| asset)
    }

    /// What nothing has used at `now` or later, the least recently used first; of equals the lowest.
    pub fn older_than(&self, now: Stamp) -> impl Iterator<Item = Asset> {
        self.by_age.range(..(now, Asset::Blob(BlobId(0)))).map(|&(_, asset)| asset)
    }

    /// Notes that it was evicted.
    ///
    /// # Panics
    /// If it is not held.
    pub fn remove(&mut self, asset: Asset) {
        let held = self.slot(asset).take().expect("only what is held is evicted");
        self.by_age.remove(&(held.used, asset));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    fn asset(index: u32) -> Asset {
        Asset::Blob(BlobId(index))
    }

    use rand::{Rng, SeedableRng, rngs::StdRng};

    #[test]
    fn of_nothing_nothing_goes() {
        let residency = Residency::new(0, 0);
        assert!(
            residency.older_than(9).next().is_none() && residency.used_since(0).next().is_none()
        );
    }

    #[test]
    fn the_least_recently_used_goes_first_and_never_the_present() {
        let mut residency = Residency::new(4, 0);
        for (blob, now) in [(2, 1), (0, 1), (1, 2), (3, 3)] {
            residency.insert(asset(blob), now, false);
        }
        residency.touch(asset(0), 3);
        assert_eq!(residency.older_than(3).next(), Some(asset(2)));
        residency.remove(asset(2));
        assert_eq!(residency.older_than(3).next(), Some(asset(1)));
        residency.remove(asset(1));
        assert_eq!(residency.older_than(3).next(), None);
        assert_eq!(residency.used_since(3).collect::<Vec<_>>(), [asset(0), asset(3)]);
    }

    #[test]
    fn what_was_foreseen_counts_once() {
        let mut residency = Residency::new(0, 1);
        residency.insert(Asset::Texture(0), 1, true);
        assert_eq!(residency.touch(Asset::Texture(0), 1), Use { before: 1, foreseen: true });
        assert_eq!(residency.touch(Asset::Texture(0), 2), Use { before: 1, foreseen: false });
        residency.remove(Asset::Texture(0));
        residency.insert(Asset::Texture(0), 3, false);
        assert_eq!(residency.touch(Asset::Texture(0), 3), Use { before: 3, foreseen: false });
    }

    #[test]
    fn what_is_held_for_good_stays() {
        let mut residency = Residency::new(0, 1);
        residency.insert(Asset::Texture(0), 1, false);
        residency.touch(Asset::Texture(0), Stamp::MAX);
        residency.touch(Asset::Texture(0), 2);
        assert_eq!(residency.older_than(Stamp::MAX).next(), None);
    }

    #[test]
    fn any_use_gives_the_order_of_a_plain_list() {
        let of = |id| if id < 7 { asset(id) } else { Asset::Texture(id - 7) };
        let mut rng = StdRng::seed_from_u64(3);
        let mut residency = Residency::new(7, 5);
        let mut uses: Vec<Option<Stamp>> = vec![None; 12];
        for now in 1..2000 {
            let blob = of(rng.random_range(0..12));
            match uses[blob.index(7)] {
                None => residency.insert(blob, now, rng.random_bool(0.5)),
                Some(_) if rng.random_bool(0.3) => {
                    residency.remove(blob);
                    uses[blob.index(7)] = None;
                    continue;
                }
                Some(_) => _ = residency.touch(blob, now),
            }
            uses[blob.index(7)] = Some(now);
            let oldest = (0..12).filter_map(|id| Some((uses[id as usize]?, of(id)))).min();
            let expected = oldest.filter(|(used, _)| *used < now).map(|(_, blob)| blob);
            assert_eq!(residency.older_than(now).next(), expected);
        }
    }
}
