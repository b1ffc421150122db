//! Splitting one mesh into compact pieces, top down, by a binned surface-area heuristic (Wald 2007).
//!
//! Every decision is a function of sums over a set of boxes that do not depend on their order: so a set
//! that does not fit the memory is divided by reading it front to back, and gives the same pieces.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use rayon::prelude::*;

/// Bins an axis is divided into when a split is sought.
const BINS: usize = 16;
/// The smaller side of a split holds at least this share of the triangles, so that no slivers arise.
const LEAST_SHARE: usize = 8;
/// A split made for the extent's sake alone must lower the surface-area cost at least to this share.
const PAYING_COST: f32 = 0.75;
/// Margin on a box before its area is taken, as a share of the mesh: a line has a cost, too.
const MARGIN: f32 = 1e-3;
/// A triangle is out of proportion in a set whose box is more than so many times as long as its own.
const PROPORTION: f32 = 256.0;
/// Sets of so many boxes are worth a second thread.
const PARALLEL: usize = 1 << 14;

/// The box of a triangle, relative to somewhere near the mesh. It is moved as a whole: jumping through
/// memory for each box of a large set takes longer than all arithmetic.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Item {
    min: [f32; 3],
    max: [f32; 3],
    /// Which triangle; settles ties.
    pub id: u32,
}

impl Item {
    /// The box of three corners.
    pub fn of(id: u32, corners: [Vec3; 3]) -> Self {
        let [a, b, c] = corners;
        Self { min: a.min(b).min(c).to_array(), max: a.max(b).max(c).to_array(), id }
    }

    fn bounds(&self) -> Extent {
        Extent { min: Vec3::from_array(self.min), max: Vec3::from_array(self.max) }
    }

    fn is_small_in(&self, longest: f32) -> bool {
        self.bounds().longest() * PROPORTION < longest
    }

    fn center(&self) -> Vec3 {
        Vec3::from_array(self.min) * 0.5 + Vec3::from_array(self.max) * 0.5
    }

    /// Its rank along an axis: by its centre, then by id. No two of a mesh have the same.
    pub fn rank(&self, axis: usize) -> u64 {
        let bits = self.center()[axis].to_bits();
        // Floats in the order of `total_cmp`, as unsigned numbers.
        let ordered = if bits >> 31 == 1 { !bits } else { bits | 1 << 31 };
        u64::from(ordered) << 32 | u64::from(self.id)
    }
}

/// A box.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Extent {
    min: Vec3,
    max: Vec3,
}

impl Extent {
    const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    fn with(self, p: Vec3) -> Self {
        Self { min: self.min.min(p), max: self.max.max(p) }
    }

    fn longest(&self) -> f32 {
        (self.max - self.min).max_element()
    }

    fn cost(&self, margin: f32, count: usize) -> f32 {
        let e = self.max - self.min + margin;
        (e.x * e.y + e.y * e.z + e.z * e.x) * count as f32
    }
}

/// What must be known of a set before it is divided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tally {
    bounds: Extent,
    centers: Extent,
    /// Triangles in the set.
    pub count: usize,
}

impl Tally {
    /// Of no triangles.
    pub const EMPTY: Self = Self { bounds: Extent::EMPTY, centers: Extent::EMPTY, count: 0 };

    /// Counts a triangle.
    pub fn add(&mut self, item: &Item) {
        self.bounds = self.bounds.union(item.bounds());
        self.centers = self.centers.with(item.center());
        self.count += 1;
    }

    /// Of two sets together.
    pub fn union(self, other: Self) -> Self {
        Self {
            bounds: self.bounds.union(other.bounds),
            centers: self.centers.union(other.centers),
            count: self.count + other.count,
        }
    }

    /// Of some triangles.
    pub fn of(items: &[Item]) -> Self {
        in_chunks(items, |tally: &mut Self, item| tally.add(item), Self::EMPTY, Self::union)
    }

    /// The longest side of the box around the set.
    pub fn longest(&self) -> f32 {
        self.bounds.longest()
    }
}

/// Sums over a set, of which large ones are worth several threads: `union` must not mind the order.
fn in_chunks<T: Send + Sync + Clone>(
    items: &[Item],
    add: impl Fn(&mut T, &Item) + Sync,
    empty: T,
    union: impl Fn(T, T) -> T + Sync,
) -> T {
    let sum = |items: &[Item]| {
        let mut sum = empty.clone();
        items.iter().for_each(|item| add(&mut sum, item));
        sum
    };
    if items.len() < 2 * PARALLEL {
        return sum(items);
    }
    items.par_chunks(PARALLEL).map(sum).reduce(|| empty.clone(), &union)
}

/// The triangles of a set, sorted into bins along each axis.
#[derive(Debug, Clone)]
pub struct Bins {
    planes: [Option<Plane>; 3],
    rows: [[(Extent, usize); BINS]; 3],
}

impl Bins {
    /// For the set of `tally`; nothing counted yet.
    pub fn new(tally: &Tally) -> Self {
        let extent = tally.centers.max - tally.centers.min;
        let plane = |axis: usize| {
            (extent[axis] > 0.0).then(|| Plane {
                axis,
                start: tally.centers.min[axis],
                bins_per_unit: BINS as f32 / extent[axis],
                bin: 0,
                cost: f32::INFINITY,
            })
        };
        Self { planes: std::array::from_fn(plane), rows: [[(Extent::EMPTY, 0); BINS]; 3] }
    }

    /// Counts a triangle.
    pub fn add(&mut self, item: &Item) {
        let (bounds, center) = (item.bounds(), item.center());
        for (plane, row) in self.planes.iter().zip(&mut self.rows) {
            if let Some(plane) = plane {
                let bin = &mut row[plane.bin_of(center)];
                *bin = (bin.0.union(bounds), bin.1 + 1);
            }
        }
    }

    fn union(mut self, other: Self) -> Self {
        for (bin, more) in self.rows.as_flattened_mut().iter_mut().zip(other.rows.as_flattened()) {
            *bin = (bin.0.union(more.0), bin.1 + more.1);
        }
        self
    }

    /// The cheapest plane with at least `least` triangles on either side, over all axes and bins.
    fn best_plane(&self, margin: f32, least: usize) -> Option<Plane> {
        let mut best: Option<Plane> = None;
        for (plane, bins) in self.planes.iter().zip(&self.rows) {
            let Some(mut plane) = *plane else { continue };
            let mut above = [(Extent::EMPTY, 0usize); BINS + 1];
            for i in (0..BINS).rev() {
                above[i] = (above[i + 1].0.union(bins[i].0), above[i + 1].1 + bins[i].1);
            }
            let mut below = (Extent::EMPTY, 0usize);
            for i in 1..BINS {
                below = (below.0.union(bins[i - 1].0), below.1 + bins[i - 1].1);
                if below.1 < least || above[i].1 < least {
                    continue;
                }
                let cost = below.0.cost(margin, below.1) + above[i].0.cost(margin, above[i].1);
                if cost < plane.cost {
                    (plane.bin, plane.cost) = (i, cost);
                }
            }
            if plane.cost < best.as_ref().map_or(f32::INFINITY, |b| b.cost) {
                best = Some(plane);
            }
        }
        best
    }
}

/// Where a set is divided: triangles in bins below `bin` go left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    axis: usize,
    start: f32,
    bins_per_unit: f32,
    bin: usize,
    cost: f32,
}

impl Plane {
    fn bin_of(&self, center: Vec3) -> usize {
        (((center[self.axis] - self.start) * self.bins_per_unit) as usize).min(BINS - 1)
    }

    /// Whether a triangle goes left.
    pub fn is_left(&self, item: &Item) -> bool {
        self.bin_of(item.center()) < self.bin
    }
}

/// What becomes of a set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// It is a piece.
    Piece,
    /// It is cut by a plane.
    Cut(Plane),
    /// Its centres lie in a heap: the half of lesser [`Item::rank`] along this axis, rounded down, goes
    /// left.
    Halve(usize),
}

/// When a piece is split further.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Most triangles of a piece; at least 1.
    pub triangles: usize,
    /// A piece with a longer side than this is split even so, where that makes the boxes tighter.
    pub extent: f32,
    /// Fewest triangles of a piece that was split off for its extent.
    pub least_triangles: usize,
    /// A piece with a longer side than this holds no triangle that is small beside it: what lies together
    /// is divided from what does not, and from triangles that span it all. Such a piece may have few.
    pub in_proportion: f32,
}

/// How the sets of one mesh are divided.
#[derive(Debug, Clone, Copy)]
pub struct Splitter {
    limits: Limits,
    margin: f32,
}

impl Splitter {
    /// For a mesh with this tally.
    pub fn new(limits: Limits, whole: &Tally) -> Self {
        assert!(limits.triangles > 0);
        Self { limits, margin: (whole.longest() * MARGIN).max(f32::MIN_POSITIVE) }
    }

    /// What becomes of a set; `bins` counts its triangles, if need be.
    pub fn step<E>(
        &self,
        tally: &Tally,
        bins: impl FnOnce() -> Result<Bins, E>,
    ) -> Result<Step, E> {
        let Self { limits, margin } = self;
        let must = tally.count > limits.triangles;
        let sprawls = tally.count >= 2 * limits.least_triangles.max(1)
            && tally.bounds.longest() > limits.extent;
        if !must && !sprawls {
            return Ok(Step::Piece);
        }
        let least = if must { 1 } else { limits.least_triangles };
        let least = least.max(tally.count / LEAST_SHARE).max(1);
        let paying = PAYING_COST * tally.bounds.cost(*margin, tally.count);
        Ok(match bins()?.best_plane(*margin, least) {
            Some(plane) if must || plane.cost <= paying => Step::Cut(plane),
            _ if must => {
                let extent = tally.bounds.max - tally.bounds.min;
                let longest = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b]));
                Step::Halve(longest.unwrap_or(0))
            }
            _ => Step::Piece,
        })
    }

    /// Divides a set of a mesh into pieces: every triangle in exactly one, none empty, none above the
    /// limit. The order of the items does not matter, and the pieces lie in a spatially coherent one.
    pub fn divide(&self, items: &mut [Item], tally: &Tally) -> Vec<Piece> {
        debug_assert_eq!(items.len(), tally.count);
        if items.is_empty() {
            return Vec::new();
        }
        let count = || Ok::<_, std::convert::Infallible>(Self::bins(items, tally));
        let Ok(step) = self.step(tally, count);
        let left = match step {
            Step::Piece => return self.in_proportion(items),
            Step::Cut(plane) => divided_at(items, |item| plane.is_left(item)),
            Step::Halve(axis) => {
                let middle = items.len() / 2;
                items.select_nth_unstable_by_key(middle, |item| item.rank(axis));
                middle
            }
        };
        let (below, above) = items.split_at_mut(left);
        let divide = |items: &mut [Item]| self.divide(items, &Tally::of(items));
        let (mut pieces, mut others) = match tally.count < 2 * PARALLEL {
            true => (divide(below), divide(above)),
            false => rayon::join(|| divide(below), || divide(above)),
        };
        pieces.append(&mut others);
        pieces
    }

    /// The pieces that a set makes which is small enough: one, but for strays.
    fn in_proportion(&self, items: &mut [Item]) -> Vec<Piece> {
        let tally = Tally::of(items);
        let longest = tally.longest();
        let small = match longest > self.limits.in_proportion {
            true => divided_at(items, |item| item.is_small_in(longest)),
            false => 0,
        };
        // All of them are small, so they lie apart: no triangle reaches far across the middle.
        let left = match small == items.len() {
            true => {
                let extent = tally.centers.max - tally.centers.min;
                let axis = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(0);
                let middle = tally.centers.min[axis] + extent[axis] * 0.5;
                divided_at(items, |item| item.center()[axis] < middle)
            }
            false => small,
        };
        if left == 0 || left == items.len() {
            let mut triangles: Vec<u32> = items.iter().map(|item| item.id).collect();
            triangles.sort_unstable();
            let Extent { min, max } = tally.bounds;
            return vec![Piece { triangles, bounds: [min, max] }];
        }
        let (below, above) = items.split_at_mut(left);
        let (mut pieces, mut others) = (self.in_proportion(below), self.in_proportion(above));
        pieces.append(&mut others);
        pieces
    }

    fn bins(items: &[Item], tally: &Tally) -> Bins {
        in_chunks(items, |bins: &mut Bins, item| bins.add(item), Bins::new(tally), Bins::union)
    }
}

/// Brings the items that are meant to the front; how many there are.
fn divided_at(items: &mut [Item], is_meant: impl Fn(&Item) -> bool) -> usize {
    let mut meant = 0;
    for i in 0..items.len() {
        if is_meant(&items[i]) {
            items.swap(meant, i);
            meant += 1;
        }
    }
    meant
}

/// Part of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Piece {
    /// Ids of its triangles, ascending.
    pub triangles: Vec<u32>,
    /// Least and greatest corner of its box.
    pub bounds: [Vec3; 2],
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        triangles: 100,
        extent: f32::INFINITY,
        least_triangles: 10,
        in_proportion: f32::INFINITY,
    };

    fn dot(p: Vec3) -> Extent {
        Extent { min: p, max: p + 0.1 }
    }

    fn items(boxes: &[Extent]) -> Vec<Item> {
        let item = |(id, b): (u32, &Extent)| Item::of(id, [b.min, b.max, b.min]);
        (0..).zip(boxes).map(item).collect()
    }

    fn partition(boxes: &[Extent], limits: &Limits) -> Vec<Vec<u32>> {
        let mut items = items(boxes);
        let whole = Tally::of(&items);
        let pieces = Splitter::new(*limits, &whole).divide(&mut items, &whole);
        for piece in &pieces {
            let all = piece.triangles.iter().map(|&id| boxes[id as usize]);
            let Extent { min, max } = all.fold(Extent::EMPTY, Extent::union);
            assert_eq!(piece.bounds, [min, max]);
        }
        pieces.into_iter().map(|piece| piece.triangles).collect()
    }

    /// Every triangle once; the sizes.
    fn check(boxes: &[Extent], limits: &Limits) -> Vec<usize> {
        let pieces = partition(boxes, limits);
        let mut all: Vec<u32> = pieces.concat();
        all.sort_unstable();
        assert_eq!(all, (0..boxes.len() as u32).collect::<Vec<_>>());
        assert!(pieces.iter().all(|p| !p.is_empty() && p.len() <= limits.triangles));
        assert_eq!(pieces, partition(boxes, limits));
        pieces.iter().map(Vec::len).collect()
    }

    #[test]
    fn nothing_and_one_triangle() {
        assert!(check(&[], &LIMITS).is_empty());
        assert_eq!(check(&[dot(Vec3::ZERO)], &LIMITS), [1]);
    }

    #[test]
    fn a_heap_of_coincident_triangles_is_halved_by_rank() {
        let sizes = check(&vec![dot(Vec3::ONE); 1000], &LIMITS);
        assert!(sizes.iter().all(|&size| size >= 50), "{sizes:?}");
        assert_eq!(check(&[dot(Vec3::ONE); 3], &Limits { triangles: 1, ..LIMITS }), [1, 1, 1]);
    }

    #[test]
    fn pieces_are_compact() {
        let boxes: Vec<_> = (0..4000u32)
            .map(|i| dot(Vec3::new((i % 20) as f32, (i / 20 % 20) as f32, (i / 400) as f32)))
            .collect();
        let sizes = check(&boxes, &LIMITS);
        assert!(sizes.len() <= 80, "{}", sizes.len());
        let area = |piece: &Vec<u32>| {
            piece.iter().fold(Extent::EMPTY, |s, &id| s.union(boxes[id as usize])).cost(0.0, 1)
        };
        let mean = partition(&boxes, &LIMITS).iter().map(area).sum::<f32>() / sizes.len() as f32;
        // A cube of 100 unit cells has half the surface 3 * 100^(2/3) = 65.
        assert!(mean < 90.0, "{mean}");
    }

    #[test]
    fn a_long_thin_mesh_is_cut_by_extent_and_a_compact_one_is_not() {
        let pipe: Vec<_> = (0..90u32).map(|i| dot(Vec3::X * i as f32)).collect();
        let limits = Limits { extent: 30.0, ..LIMITS };
        assert_eq!(check(&pipe, &LIMITS).len(), 1);
        assert!(check(&pipe, &limits).len() >= 3);
        let crossing = vec![Extent { min: Vec3::ZERO, max: Vec3::splat(90.0) }; 90];
        assert_eq!(check(&crossing, &limits).len(), 1);
    }

    #[test]
    fn strays_and_what_spans_all_are_divided_from_the_rest() {
        let house: Vec<_> = (0..12u32).map(|i| dot(Vec3::X * i as f32)).collect();
        let stray = dot(Vec3::new(5e6, -3e6, 0.0));
        let plane = Extent { min: Vec3::splat(-5e6), max: Vec3::splat(5e6) };
        let limits = Limits { in_proportion: 100.0, ..LIMITS };
        for strays in [vec![stray], vec![dot(Vec3::splat(-7e6)), stray], vec![plane, plane, stray]]
        {
            // In the middle of the list.
            let boxes = [&house[..6], &strays, &house[6..]].concat();
            check(&boxes, &limits);
            let is_house = |id: &u32| *id < 6 || *id >= 6 + strays.len() as u32;
            let pieces = partition(&boxes, &limits);
            let houses: Vec<_> = pieces.iter().filter(|piece| piece.iter().any(is_house)).collect();
            assert!(matches!(&houses[..], [one] if one.len() == 12 && one.iter().all(is_house)));
        }
        // What is not so long stays together, however small some of it is.
        assert_eq!(check(&[&house[..], &[dot(Vec3::X * 90.0)]].concat(), &limits), [13]);
        let heap = [&vec![stray; 3][..], &[dot(Vec3::splat(f32::INFINITY))]].concat();
        check(&heap, &limits);
    }

    #[test]
    fn neither_order_nor_threads_matter() {
        // Enough for several threads, and a heap among them.
        let at = |i: u32| match i % 5 {
            0 => Vec3::splat(40.0),
            _ => Vec3::new((i % 97) as f32, (i % 89) as f32 * 0.7, (i % 83) as f32 * -1.3),
        };
        let boxes: Vec<_> = (0..100_000).map(|i| dot(at(i))).collect();
        let expected = partition(&boxes, &LIMITS);
        assert!(expected.iter().all(|piece| piece.len() <= 100));
        let mut shuffled = items(&boxes);
        (0..shuffled.len()).for_each(|i| shuffled.swap(i, i * 7919 % boxes.len()));
        let whole = Tally::of(&shuffled);
        let splitter = Splitter::new(LIMITS, &whole);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let pieces = pool.install(|| splitter.divide(&mut shuffled, &whole));
        assert!(pieces.into_iter().map(|piece| piece.triangles).eq(expected));
    }

    #[test]
    fn ranks_follow_centres_then_ids() {
        let xs = [f32::NEG_INFINITY, -2.0, -1e-40, 0.0, 1e-40, 3.0];
        let ranks = xs.map(|x| Item::of(7, [Vec3::splat(x); 3]).rank(1));
        assert!(ranks.is_sorted_by(|a, b| a < b), "{ranks:?}");
        let [a, b] = [1, 2].map(|id| Item::of(id, [Vec3::ONE; 3]).rank(0));
        assert!(a < b);
    }
}
