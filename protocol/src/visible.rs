//! Visible sets and their changes (paper 004, section 4.4).
//!
//! V_i = (V_{i-1} - d_{i-1,i}) u d_{i,i-1}. [`change`] codes the two differences: the ids that leave
//! as positions within the base, the ids that enter as positions among all other ids.

pub mod change;
mod interval;
mod subset;

pub use change::{ChangeError, ChangeReader, ChangeTotals, ChangeWriter, DeltaChunk};

use crate::id::HlodId;

/// A visible set V_i: sorted, without repeats.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct VisibleSet {
    ids: Vec<HlodId>,
}

impl VisibleSet {
    /// The set of these ids.
    ///
    /// # Panics
    /// If they are not sorted or one repeats: a mistake of the caller, never of the wire.
    pub fn from_sorted(ids: Vec<HlodId>) -> Self {
        assert!(ids.is_sorted_by(|a, b| a < b), "ids of a visible set must be sorted and unique");
        Self { ids }
    }

    /// The ids, sorted.
    pub fn ids(&self) -> &[HlodId] {
        &self.ids
    }

    /// Number of ids.
    pub fn len(&self) -> usize {
        self.ids.len()
    }

    /// Nothing is visible.
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// Whether `id` is visible.
    pub fn contains(&self, id: HlodId) -> bool {
        self.ids.binary_search(&id).is_ok()
    }

    /// First 8 bytes, as a little-endian number, of the BLAKE3 of the ids as little-endian u32.
    ///
    /// Two ends whose sets differ in any way find out by it.
    pub fn checksum(&self) -> u64 {
        let mut hasher = blake3::Hasher::new();
        let mut bytes = Vec::with_capacity(4 * self.ids.len());
        bytes.extend(self.ids.iter().flat_map(|id| id.0.to_le_bytes()));
        hasher.update(&bytes);
        let mut first = [0; 8];
        hasher.finalize_xof().fill(&mut first);
        u64::from_le_bytes(first)
    }
}

/// Least bits that tell which `chosen` of `among` ids, all choices being equally likely and both numbers
/// known: log2 C(among, chosen); relative error below 1e-9. More than there are: 0, as for none.
pub fn entropy_bound_bits(among: u64, chosen: u64) -> f64 {
    let Some(kept) = among.checked_sub(chosen) else { return 0.0 };
    let fewer = kept.min(chosen);
    // C(n, k) = product over i < k of (n - i) / (i + 1).
    (0..fewer).fold(0.0, |bits, i| bits + ((among - i) as f64 / (i + 1) as f64).log2())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(ids: &[u32]) -> VisibleSet {
        VisibleSet::from_sorted(ids.iter().copied().map(HlodId).collect())
    }

    #[test]
    fn the_empty_set_has_nothing() {
        let empty = VisibleSet::default();
        assert!(empty.is_empty() && !empty.contains(HlodId(0)));
        assert_ne!(empty.checksum(), set(&[0]).checksum());
    }

    #[test]
    fn membership_and_checksum_follow_the_ids() {
        let a = set(&[1, 5, 9]);
        assert!(a.contains(HlodId(5)) && !a.contains(HlodId(6)));
        assert_eq!(a.checksum(), set(&[1, 5, 9]).checksum());
        for other in [&[1, 5][..], &[1, 5, 8], &[0, 1, 5, 9]] {
            assert_ne!(a.checksum(), set(other).checksum());
        }
    }

    #[test]
    fn the_checksum_is_fixed_across_versions() {
        let hash = blake3::hash(&[7, 0, 0, 0, 0, 1, 0, 0]);
        let expected = u64::from_le_bytes(hash.as_bytes()[..8].try_into().unwrap());
        assert_eq!(set(&[7, 256]).checksum(), expected);
    }

    #[test]
    #[should_panic(expected = "sorted")]
    fn repeats_are_a_mistake_of_ours() {
        set(&[3, 3]);
    }

    #[test]
    fn the_bound_is_log2_of_the_binomial() {
        assert_eq!(entropy_bound_bits(0, 0), 0.0);
        assert_eq!(entropy_bound_bits(5, 9), 0.0);
        assert_eq!(entropy_bound_bits(1000, 0), 0.0);
        assert!((entropy_bound_bits(1000, 1) - 1000f64.log2()).abs() < 1e-9);
        assert!((entropy_bound_bits(52, 5) - 2_598_960f64.log2()).abs() < 1e-9);
        assert_eq!(entropy_bound_bits(52, 47), entropy_bound_bits(52, 5));
        // The figure measured for 120,000 hlods, 280 of them changed: 356 bytes.
        assert!((entropy_bound_bits(120_000, 280) / 8.0 - 356.0).abs() < 1.0);
    }
}
