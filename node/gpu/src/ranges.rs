//! Sub-allocation of one buffer: best fit over the free ranges, neighbours joined when freed.

use std::collections::BTreeMap;

/// Free ranges of a buffer, in bytes.
#[derive(Debug, Clone)]
pub(crate) struct Ranges {
    size: u64,
    /// Offset to length; no two touch.
    free: BTreeMap<u64, u64>,
}

impl Ranges {
    /// All of `size` bytes free.
    pub(crate) fn new(size: u64) -> Self {
        let free = if size == 0 { BTreeMap::new() } else { BTreeMap::from([(0, size)]) };
        Self { size, free }
    }

    /// Takes `length` bytes and returns their offset, or none if no free range is that long. The
    /// shortest range that fits is used, the lowest among equals.
    pub(crate) fn take(&mut self, length: u64) -> Option<u64> {
        debug_assert!(length > 0);
        let (&offset, &room) =
            self.free.iter().filter(|&(_, &room)| room >= length).min_by_key(|&(_, &room)| room)?;
        self.free.remove(&offset);
        if room > length {
            self.free.insert(offset + length, room - length);
        }
        Some(offset)
    }

    /// Gives back what [`Ranges::take`] returned.
    pub(crate) fn give_back(&mut self, offset: u64, length: u64) {
        let (mut start, mut end) = (offset, offset + length);
        assert!(length > 0 && end <= self.size, "not a range of this buffer");
        let before = self.free.range(..=start).next_back().map(|(&at, &room)| (at, at + room));
        let after = self.free.range(start..).next().map(|(&at, &room)| (at, at + room));
        assert!(before.is_none_or(|(_, e)| e <= start), "freed twice");
        assert!(after.is_none_or(|(s, _)| s >= end), "freed twice");
        if let Some((at, _)) = before.filter(|&(_, e)| e == start) {
            self.free.remove(&at);
            start = at;
        }
        if let Some((at, beyond)) = after.filter(|&(s, _)| s == end) {
            self.free.remove(&at);
            end = beyond;
        }
        self.free.insert(start, end - start);
    }

    /// Nothing is taken.
    pub(crate) fn is_unused(&self) -> bool {
        self.free.get(&0).copied().unwrap_or(0) == self.size
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    #[test]
    fn an_empty_buffer_gives_nothing() {
        let mut ranges = Ranges::new(0);
        assert_eq!(ranges.take(1), None);
        assert!(ranges.is_unused());
    }

    #[test]
    fn takes_the_tightest_hole_and_joins_neighbours() {
        let mut ranges = Ranges::new(100);
        assert_eq!(ranges.take(101), None);
        let [a, b, c, d] = [40, 10, 20, 30].map(|length| ranges.take(length).unwrap());
        assert_eq!((a, b, c, d, ranges.take(1)), (0, 40, 50, 70, None));
        ranges.give_back(a, 40);
        ranges.give_back(c, 20);
        assert_eq!(ranges.take(15), Some(50));
        ranges.give_back(50, 15);
        ranges.give_back(b, 10);
        assert_eq!(ranges.take(70), Some(0));
        ranges.give_back(0, 70);
        ranges.give_back(d, 30);
        assert!(ranges.is_unused());
        assert_eq!(ranges.take(100), Some(0));
    }

    #[test]
    #[should_panic(expected = "freed twice")]
    fn freeing_twice_is_our_mistake() {
        let mut ranges = Ranges::new(10);
        let offset = ranges.take(4).unwrap();
        ranges.give_back(offset, 4);
        ranges.give_back(offset, 4);
    }

    #[test]
    fn random_use_never_overlaps_and_never_leaks() {
        let mut random = StdRng::seed_from_u64(7);
        let mut ranges = Ranges::new(4096);
        let mut owner = vec![false; 4096];
        let mut live: Vec<(u64, u64)> = Vec::new();
        for _ in 0..4000 {
            if random.random_bool(0.5) {
                let length = random.random_range(1..200);
                if let Some(offset) = ranges.take(length) {
                    let cells = &mut owner[offset as usize..(offset + length) as usize];
                    assert!(cells.iter().all(|taken| !taken));
                    cells.fill(true);
                    live.push((offset, length));
                }
            } else if !live.is_empty() {
                let (offset, length) = live.swap_remove(random.random_range(0..live.len()));
                owner[offset as usize..(offset + length) as usize].fill(false);
                ranges.give_back(offset, length);
            }
            let taken = owner.iter().filter(|&&taken| taken).count() as u64;
            assert_eq!(ranges.free.values().sum::<u64>(), 4096 - taken);
        }
        for (offset, length) in live {
            ranges.give_back(offset, length);
        }
        assert!(ranges.is_unused());
    }
}
