//! Which pixels of the faces around a viewpoint are still of interest.

use std::ops::Range;

/// Pixels of one face, each wanted or not, and how many are in any rectangle.
pub(crate) struct Wanted {
    side: usize,
    /// At `(side + 1) * y + x`: how many of the pixels left of `x` and above `y`.
    sums: Vec<u32>,
}

impl Wanted {
    /// Of `side * side` pixels, row by row, those that `is_wanted`.
    pub(crate) fn new(side: u32, is_wanted: impl Fn(usize) -> bool) -> Self {
        let side = side as usize;
        let across = side + 1;
        let mut sums = vec![0; across * across];
        for y in 0..side {
            let mut row = 0;
            for x in 0..side {
                row += u32::from(is_wanted(y * side + x));
                sums[(y + 1) * across + x + 1] = sums[y * across + x + 1] + row;
            }
        }
        Self { side, sums }
    }

    /// How many of a rectangle inside the face.
    fn count(&self, columns: &Range<u32>, rows: &Range<u32>) -> u32 {
        let at = |x: u32, y: u32| self.sums[y as usize * (self.side + 1) + x as usize];
        let (left, right) = (columns.start, columns.end);
        let until = |y: u32| at(right, y) - at(left, y);
        until(rows.end) - until(rows.start)
    }

    /// Whether any of a rectangle inside the face is; of an empty one none.
    pub(crate) fn any(&self, columns: &Range<u32>, rows: &Range<u32>) -> bool {
        !columns.is_empty() && !rows.is_empty() && self.count(columns, rows) > 0
    }

    /// Whether one pixel is.
    pub(crate) fn has(&self, x: u32, y: u32) -> bool {
        self.count(&(x..x + 1), &(y..y + 1)) > 0
    }

    /// Whether none of all is.
    pub(crate) fn is_empty(&self) -> bool {
        self.sums.last() == Some(&0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_hold_what_they_hold() {
        let is_wanted = |pixel: usize| pixel * pixel % 7 == 2;
        let wanted = Wanted::new(5, is_wanted);
        for (left, right) in (0..=5).flat_map(|a| (0..=5).map(move |b| (a, b))) {
            for (top, bottom) in (0..=5).flat_map(|a| (0..=5).map(move |b| (a, b))) {
                let there = (top..bottom).any(|y| (left..right).any(|x| is_wanted(5 * y + x)));
                assert_eq!(
                    wanted.any(&(left as u32..right as u32), &(top as u32..bottom as u32)),
                    there
                );
            }
        }
        assert!((0..25).all(|at| wanted.has(at % 5, at / 5) == is_wanted(at as usize)));
        assert!(!wanted.is_empty() && Wanted::new(3, |_| false).is_empty());
        assert!(Wanted::new(0, |_| true).is_empty());
    }
}
