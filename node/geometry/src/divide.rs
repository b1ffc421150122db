//! Where a set of boxes is best divided in two: the surface-area heuristic, binned for many boxes
//! (Wald 2007, "On fast construction of SAH-based bounding volume hierarchies") and exact for few.

use crate::bounds::Aabb;
use glam::DVec3;

/// Bins an axis is divided into.
const BINS: usize = 16;
/// Up to this many boxes every place of a cut is tried.
const EXACT: usize = 16;
/// Margin on a box before its area is taken, as a share of the set's longest side: a line has a cost, too.
const MARGIN: f64 = 1e-3;

/// A box to be sorted with others. It is moved as a whole: jumping through memory for each box of a
/// large set takes longer than all arithmetic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Weighted {
    /// Its box, finite and not empty.
    pub(crate) bounds: Aabb,
    /// What it is worth in the cost, at least 1.
    pub(crate) weight: u32,
    /// Whose it is; settles ties.
    pub(crate) id: u32,
}

/// A division that was made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Division {
    /// Boxes in the first part.
    pub(crate) first: usize,
    /// Cost of the two parts over that of the undivided set; above 1 where they overlap much.
    pub(crate) cost: f64,
}

/// Some boxes of a set.
#[derive(Debug, Clone, Copy)]
struct Part {
    bounds: Aabb,
    count: usize,
    weight: f64,
}

impl Part {
    const EMPTY: Self = Self { bounds: Aabb::EMPTY, count: 0, weight: 0.0 };

    fn of(item: &Weighted) -> Self {
        Self { bounds: item.bounds, count: 1, weight: f64::from(item.weight) }
    }

    fn union(self, other: Self) -> Self {
        Self {
            bounds: self.bounds.union(other.bounds),
            count: self.count + other.count,
            weight: self.weight + other.weight,
        }
    }

    /// Half the surface of the box, grown by `margin`, times the weight; 0 where empty.
    fn cost(&self, margin: f64) -> f64 {
        if self.count == 0 {
            return 0.0;
        }
        let e = self.bounds.extent() + margin;
        (e.x * e.y + e.y * e.z + e.z * e.x) * self.weight
    }
}

/// Where a row of parts is cut.
#[derive(Debug, Clone, Copy)]
struct Cut {
    axis: usize,
    /// Parts before it.
    parts: usize,
    /// Boxes before it.
    boxes: usize,
    cost: f64,
}

/// Reorders `items` so that the two parts of the cheapest division follow each other, each with at
/// least `least` boxes, 1 or more. `None`, and the order as it was, where no plane does so, as for
/// coincident centres.
pub(crate) fn divide(items: &mut [Weighted], least: usize) -> Option<Division> {
    debug_assert!(least >= 1);
    if items.len() < 2 * least {
        return None;
    }
    let mut whole = Part::EMPTY;
    let mut centers = Aabb::EMPTY;
    for item in &*items {
        whole = whole.union(Part::of(item));
        centers = centers.with(item.bounds.center());
    }
    let margin = (whole.bounds.extent().max_element() * MARGIN).max(f64::MIN_POSITIVE);
    let cut = match items.len() <= EXACT {
        true => cut_exactly(items, least, margin),
        false => cut_between_bins(items, &centers, least, margin),
    }?;
    Some(Division { first: cut.boxes, cost: cut.cost / whole.cost(margin) })
}

fn cut_exactly(items: &mut [Weighted], least: usize, margin: f64) -> Option<Cut> {
    let mut best: Option<Cut> = None;
    for axis in 0..3 {
        sort(items, axis);
        let mut row = [Part::EMPTY; EXACT];
        row.iter_mut().zip(&*items).for_each(|(part, item)| *part = Part::of(item));
        // Boxes with one centre are not told apart by a plane.
        let apart = |i: usize| items[i - 1].bounds.center()[axis] < items[i].bounds.center()[axis];
        best = cheaper(best, cut(&row[..items.len()], axis, least, margin, apart));
    }
    sort(items, best?.axis);
    best
}

fn sort(items: &mut [Weighted], axis: usize) {
    items.sort_unstable_by(|a, b| along(axis, a, b));
}

fn along(axis: usize, a: &Weighted, b: &Weighted) -> std::cmp::Ordering {
    let key = |item: &Weighted| item.bounds.center()[axis];
    key(a).total_cmp(&key(b)).then(a.id.cmp(&b.id))
}

fn cut_between_bins(
    items: &mut [Weighted],
    centers: &Aabb,
    least: usize,
    margin: f64,
) -> Option<Cut> {
    // Infinite along an axis without extent, where all that matters is that all boxes meet in a bin.
    let per_unit = DVec3::splat(BINS as f64) / centers.extent();
    let bin_of = |item: &Weighted, axis: usize| {
        let bin = (item.bounds.center()[axis] - centers.min[axis]) * per_unit[axis];
        (bin as usize).min(BINS - 1)
    };
    let mut rows = [[Part::EMPTY; BINS]; 3];
    for item in &*items {
        for (axis, row) in rows.iter_mut().enumerate() {
            let bin = &mut row[bin_of(item, axis)];
            *bin = bin.union(Part::of(item));
        }
    }
    let cuts = (0..3).map(|axis| cut(&rows[axis], axis, least, margin, |_| true));
    let best = cuts.fold(None, cheaper)?;
    let mut first = 0;
    for i in 0..items.len() {
        if bin_of(&items[i], best.axis) < best.parts {
            items.swap(first, i);
            first += 1;
        }
    }
    debug_assert_eq!(first, best.boxes);
    Some(best)
}

/// The earlier one, if both cost the same.
fn cheaper(best: Option<Cut>, next: Option<Cut>) -> Option<Cut> {
    match (best, next) {
        (Some(a), Some(b)) => Some(if b.cost < a.cost { b } else { a }),
        (best, next) => best.or(next),
    }
}

/// The cheapest cut of a row of parts that leaves `least` boxes on either side.
fn cut(
    row: &[Part],
    axis: usize,
    least: usize,
    margin: f64,
    allowed: impl Fn(usize) -> bool,
) -> Option<Cut> {
    const { assert!(EXACT <= BINS) };
    let mut above = [Part::EMPTY; BINS + 1];
    for i in (0..row.len()).rev() {
        above[i] = above[i + 1].union(row[i]);
    }
    let mut below = Part::EMPTY;
    let mut best = None;
    for i in 1..row.len() {
        below = below.union(row[i - 1]);
        if below.count >= least && above[i].count >= least && allowed(i) {
            let cost = below.cost(margin) + above[i].cost(margin);
            best = cheaper(best, Some(Cut { axis, parts: i, boxes: below.count, cost }));
        }
    }
    best
}

/// Divides `items` into halves by the rank of their centres along the longest side, then by id. Returns
/// the length of the first half.
pub(crate) fn halve(items: &mut [Weighted]) -> usize {
    let extent = Aabb::of(items.iter().map(|item| item.bounds.center())).extent();
    let axis = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(0);
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| along(axis, a, b));
    middle
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(center: DVec3, half: f64) -> Aabb {
        Aabb { min: center - half, max: center + half }
    }

    fn weighted(boxes: &[Aabb]) -> Vec<Weighted> {
        (0..).zip(boxes).map(|(id, &bounds)| Weighted { bounds, weight: 1, id }).collect()
    }

    fn ids(items: &[Weighted]) -> Vec<u32> {
        let mut ids: Vec<u32> = items.iter().map(|item| item.id).collect();
        ids.sort_unstable();
        ids
    }

    fn parts(boxes: &[Aabb], least: usize) -> Option<[Vec<u32>; 2]> {
        let mut items = weighted(boxes);
        let division = divide(&mut items, least)?;
        let (first, second) = items.split_at(division.first);
        Some([first, second].map(ids))
    }

    #[test]
    fn none_one_and_a_heap_cannot_be_divided() {
        assert_eq!(parts(&[], 1), None);
        assert_eq!(parts(&[cube(DVec3::ONE, 1.0)], 1), None);
        for count in [2, EXACT, EXACT + 1, 1000] {
            assert_eq!(parts(&vec![cube(DVec3::splat(1e7), 1.0); count], 1), None);
        }
    }

    #[test]
    fn groups_come_apart_exactly_and_binned() {
        for (each, scale) in [(1, 1.0), (3, 1e-6), (8, 1e7), (9, 1.0), (500, 1e7)] {
            let boxes: Vec<_> = (0..2 * each)
                .map(|i| {
                    let inside = f64::from(i / 2 % 5) * 0.1;
                    cube(DVec3::new(inside, f64::from(i % 2) * 9.0, inside) * scale, 0.3 * scale)
                })
                .collect();
            let [a, b] = parts(&boxes, 1).expect("two groups");
            assert!(a.iter().all(|id| id % 2 == 0) && b.iter().all(|id| id % 2 == 1), "{each}");
            assert_eq!(a.len(), b.len());
        }
    }

    #[test]
    fn neither_part_is_smaller_than_asked_for() {
        // One far outlier: the cheapest cut would split it off.
        for count in [12u32, 200] {
            let boxes: Vec<_> = (0..count)
                .map(|i| cube(DVec3::X * f64::from(if i == 0 { 10 * count } else { i }), 0.4))
                .collect();
            assert_eq!(parts(&boxes, 1).expect("apart")[1], [0]);
            if let Some([a, b]) = parts(&boxes, count as usize / 4) {
                assert!(a.len().min(b.len()) >= count as usize / 4);
            }
        }
        let few: Vec<_> = (0..12).map(|i| cube(DVec3::X * f64::from(i * i), 0.4)).collect();
        let [a, b] = parts(&few, 3).expect("twelve centres");
        assert!(a.len() >= 3 && b.len() >= 3);
    }

    #[test]
    fn halves_by_rank_then_by_id() {
        let mut items = weighted(&[cube(DVec3::ONE, 1.0); 7]);
        items.reverse();
        assert_eq!(halve(&mut items), 3);
        assert_eq!(ids(&items[..3]), [0, 1, 2]);
        let mut row = weighted(&[5.0, 1.0, 4.0, 2.0].map(|x| cube(DVec3::Y * x, 1.0)));
        assert_eq!(halve(&mut row), 2);
        assert_eq!(ids(&row[..2]), [1, 3]);
    }
}
