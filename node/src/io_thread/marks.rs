//! A bit an asset, for both threads to see.

use protocol::format::Skeleton;
use scene::asset::Asset;
use std::sync::atomic::{AtomicU64, Ordering};

/// A bit for each asset of a scene.
#[derive(Debug)]
pub(crate) struct Marks {
    blobs: usize,
    words: Vec<AtomicU64>,
}

impl Marks {
    /// None is set.
    pub(super) fn new(skeleton: &Skeleton) -> Self {
        let (blobs, textures) = (skeleton.blobs.len(), skeleton.textures.len());
        let words = (blobs + textures).div_ceil(64);
        Self { blobs, words: std::iter::repeat_with(AtomicU64::default).take(words).collect() }
    }

    fn word(&self, asset: Asset) -> (&AtomicU64, u64) {
        let index = asset.index(self.blobs);
        (&self.words[index / 64], 1 << (index % 64))
    }

    /// Whether it is set.
    pub(crate) fn has(&self, asset: Asset) -> bool {
        let (word, bit) = self.word(asset);
        word.load(Ordering::Acquire) & bit != 0
    }

    /// Sets it; whether that is new.
    pub(super) fn set(&self, asset: Asset) -> bool {
        let (word, bit) = self.word(asset);
        word.fetch_or(bit, Ordering::AcqRel) & bit == 0
    }

    /// Takes it back.
    pub(crate) fn clear(&self, asset: Asset) {
        let (word, bit) = self.word(asset);
        word.fetch_and(!bit, Ordering::AcqRel);
    }

    pub(super) fn clear_all(&self) {
        self.words.iter().for_each(|word| word.store(0, Ordering::Release));
    }
}
