//! Places for squares of pixels on square pages: a buddy system (Knowlton 1965) in quarters.
//!
//! A place is a number along the curve that fills each page quarter by quarter (Morton 1966), page after
//! page. A square of side 2^k begins at a multiple of its area, so it is a whole quarter of a quarter, and
//! splitting and joining are arithmetic on that number.
//!
//! While squares only come, each finds a place as long as their area is no more than the pages': of each
//! size at most three are free below the smallest that was split, less than the next larger one in all.

use std::collections::BTreeSet;

/// Where a square lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Place {
    pub(crate) x: u32,
    pub(crate) y: u32,
    pub(crate) page: u32,
}

impl Place {
    /// As the shaders read it.
    pub(crate) fn packed(self) -> u32 {
        self.x | self.y << 10 | self.page << 20
    }
}

/// What is free of the pages.
#[derive(Debug)]
pub(crate) struct Squares {
    /// By the logarithm of the side, where free squares begin on the curve.
    free: Vec<BTreeSet<u64>>,
}

impl Squares {
    /// So many free pages of a side that is a power of two.
    pub(crate) fn new(page_side: u32, pages: u32) -> Self {
        let largest = page_side.ilog2() as usize;
        let mut free = vec![BTreeSet::new(); largest + 1];
        free[largest] = (0..u64::from(pages)).map(|page| page << (2 * largest)).collect();
        Self { free }
    }

    /// Takes a square of a side that is a power of two: of the smallest that hold it, the first on the curve.
    /// None where none does.
    pub(crate) fn take(&mut self, side: u32) -> Option<u64> {
        let wanted = side.ilog2() as usize;
        let found = (wanted..self.free.len()).find(|&size| !self.free[size].is_empty())?;
        let at = self.free[found].pop_first()?;
        for size in wanted..found {
            self.free[size].extend((1..4).map(|quarter| at + (quarter << (2 * size))));
        }
        Some(at)
    }

    /// Gives back what [`Squares::take`] returned for this side.
    pub(crate) fn give_back(&mut self, mut at: u64, side: u32) {
        let mut size = side.ilog2() as usize;
        loop {
            let whole = at >> (2 * size + 2) << (2 * size + 2);
            let quarters = (0..4).map(|quarter| whole + (quarter << (2 * size)));
            let others = quarters.filter(|&other| other != at);
            let is_whole = size + 1 < self.free.len()
                && others.clone().all(|other| self.free[size].contains(&other));
            if !is_whole {
                assert!(self.free[size].insert(at), "freed twice");
                return;
            }
            for other in others {
                self.free[size].remove(&other);
            }
            (at, size) = (whole, size + 1);
        }
    }

    /// The page, column and row of a place.
    pub(crate) fn place(&self, at: u64) -> Place {
        let largest = self.free.len() as u32 - 1;
        let every_other_bit =
            |from: u32| (0..largest).fold(0, |sum, bit| sum | (at >> (2 * bit + from) & 1) << bit);
        let [x, y] = [0, 1].map(|from| every_other_bit(from) as u32);
        Place { x, y, page: (at >> (2 * largest)) as u32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::seq::SliceRandom;
    use rand::{Rng, SeedableRng};
    use std::collections::HashSet;

    #[test]
    fn no_pages_hold_nothing() {
        assert_eq!(Squares::new(8, 0).take(1), None);
        assert_eq!(Squares::new(1, 1).take(1), Some(0));
    }

    #[test]
    fn whatever_comes_into_empty_pages_fits_if_its_area_does() {
        let mut random = StdRng::seed_from_u64(5);
        for _ in 0..200 {
            let mut sides: Vec<u32> =
                (0..random.random_range(1..40)).map(|_| 1 << random.random_range(0..7)).collect();
            sides.shuffle(&mut random);
            let area: u64 = sides.iter().map(|&side| u64::from(side).pow(2)).sum();
            let mut squares = Squares::new(64, area.div_ceil(64 * 64) as u32);
            assert!(sides.iter().all(|&side| squares.take(side).is_some()), "{sides:?}");
        }
    }

    #[test]
    fn random_use_never_overlaps_and_joins_again() {
        let mut random = StdRng::seed_from_u64(6);
        let mut squares = Squares::new(32, 3);
        let mut taken = HashSet::new();
        let mut held: Vec<(u64, u32)> = Vec::new();
        let mut full = 0;
        let pixels = |at: Place, side: u32| {
            (0..side * side).map(move |i| (at.page, at.x + i % side, at.y + i / side))
        };
        for _ in 0..3000 {
            if random.random_bool(0.45) && !held.is_empty() {
                let (at, side) = held.swap_remove(random.random_range(0..held.len()));
                pixels(squares.place(at), side).for_each(|pixel| assert!(taken.remove(&pixel)));
                squares.give_back(at, side);
                continue;
            }
            let side = 1 << random.random_range(0..6);
            let Some(at) = squares.take(side) else {
                full += 1;
                continue;
            };
            let place = squares.place(at);
            assert!(place.x + side <= 32 && place.y + side <= 32 && place.page < 3);
            assert!(pixels(place, side).all(|pixel| taken.insert(pixel)), "{place:?} {side}");
            held.push((at, side));
        }
        assert!(full > 50);
        held.into_iter().for_each(|(at, side)| squares.give_back(at, side));
        assert!((0..3).all(|_| squares.take(32).is_some()), "whole pages again");
    }

    #[test]
    #[should_panic(expected = "freed twice")]
    fn freeing_twice_is_our_mistake() {
        let mut squares = Squares::new(8, 1);
        let at = squares.take(2).unwrap();
        squares.give_back(at, 2);
        squares.give_back(at, 8);
    }

    #[test]
    fn a_place_keeps_its_parts_apart() {
        let last = Place { x: 1023, y: 1023, page: 4095 };
        assert_eq!(last.packed(), u32::MAX);
        assert_eq!(Place { x: 1, y: 2, page: 3 }.packed(), 1 | 2 << 10 | 3 << 20);
    }
}
