//! Splitting one mesh into compact pieces, top down, by a binned surface-area heuristic (Wald 2007).

use glam::Vec3;

/// Bins an axis is divided into when a split is sought.
const BINS: usize = 16;
/// The smaller side of a split holds at least this share of the triangles, so that no slivers arise.
const LEAST_SHARE: usize = 8;
/// A split made for the extent's sake alone must lower the surface-area cost at least to this share.
const PAYING_COST: f32 = 0.75;
/// Margin on a box before its area is taken, as a share of the mesh: a line has a cost, too.
const MARGIN: f32 = 1e-3;

/// The box of one triangle, relative to somewhere near the mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriangleBox {
    /// Least corner.
    pub min: Vec3,
    /// Greatest corner.
    pub max: Vec3,
}

impl TriangleBox {
    const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The box of three corners.
    pub fn of(corners: [Vec3; 3]) -> Self {
        let [a, b, c] = corners;
        Self { min: a.min(b).min(c), max: a.max(b).max(c) }
    }

    fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    fn centroid(&self) -> Vec3 {
        self.min * 0.5 + self.max * 0.5
    }

    fn cost(&self, margin: f32, count: usize) -> f32 {
        let e = self.max - self.min + margin;
        (e.x * e.y + e.y * e.z + e.z * e.x) * count as f32
    }
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
}

/// Divides triangles into pieces: every triangle in exactly one, none empty, none above the limit.
/// The same input gives the same pieces in the same, spatially coherent order.
pub fn partition(boxes: &[TriangleBox], limits: &Limits) -> Vec<Vec<u32>> {
    assert!(limits.triangles > 0 && boxes.len() <= u32::MAX as usize);
    let whole = boxes.iter().fold(TriangleBox::EMPTY, |sum, b| sum.union(*b));
    let margin = ((whole.max - whole.min).max_element() * MARGIN).max(f32::MIN_POSITIVE);
    let mut ids: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut pieces = Vec::new();
    // Ranges still to be looked at, the next one last.
    let mut ranges = vec![(0, ids.len())];
    while let Some((start, end)) = ranges.pop() {
        let range = &mut ids[start..end];
        match split(range, boxes, limits, margin) {
            Some(left) => ranges.extend([(start + left, end), (start, start + left)]),
            None if range.is_empty() => {}
            None => {
                range.sort_unstable();
                pieces.push(range.to_vec());
            }
        }
    }
    pieces
}

/// Reorders `ids` so that a first part of the returned length is split off; `None` to leave it whole.
fn split(ids: &mut [u32], boxes: &[TriangleBox], limits: &Limits, margin: f32) -> Option<usize> {
    let bounds = ids.iter().fold(TriangleBox::EMPTY, |sum, &id| sum.union(boxes[id as usize]));
    let must = ids.len() > limits.triangles;
    let sprawls = ids.len() >= 2 * limits.least_triangles.max(1)
        && (bounds.max - bounds.min).max_element() > limits.extent;
    if !must && !sprawls {
        return None;
    }
    let least = if must { 1 } else { limits.least_triangles }.max(ids.len() / LEAST_SHARE).max(1);
    match best_plane(ids, boxes, margin, least) {
        Some(plane) if must || plane.cost <= PAYING_COST * bounds.cost(margin, ids.len()) => {
            let mut left = 0;
            for i in 0..ids.len() {
                if plane.bin_of(boxes[ids[i] as usize].centroid()) < plane.bin {
                    ids.swap(left, i);
                    left += 1;
                }
            }
            Some(left)
        }
        // Centroids in a heap: halve by rank, with the id to break ties.
        _ if must => {
            let extent = bounds.max - bounds.min;
            let axis = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(0);
            let middle = ids.len() / 2;
            ids.select_nth_unstable_by(middle, |&a, &b| {
                let key = |id: u32| boxes[id as usize].centroid()[axis];
                key(a).total_cmp(&key(b)).then(a.cmp(&b))
            });
            Some(middle)
        }
        _ => None,
    }
}

/// A candidate: triangles in bins below `bin` go left.
struct Plane {
    axis: usize,
    start: f32,
    bins_per_unit: f32,
    bin: usize,
    cost: f32,
}

impl Plane {
    fn bin_of(&self, centroid: Vec3) -> usize {
        (((centroid[self.axis] - self.start) * self.bins_per_unit) as usize).min(BINS - 1)
    }
}

/// The cheapest plane with at least `least` triangles on either side, over all axes and bins.
fn best_plane(ids: &[u32], boxes: &[TriangleBox], margin: f32, least: usize) -> Option<Plane> {
    let centroids = ids.iter().fold(TriangleBox::EMPTY, |sum, &id| {
        let c = boxes[id as usize].centroid();
        sum.union(TriangleBox { min: c, max: c })
    });
    let extent = centroids.max - centroids.min;
    let mut best: Option<Plane> = None;
    for axis in (0..3).filter(|&axis| extent[axis] > 0.0) {
        let mut plane = Plane {
            axis,
            start: centroids.min[axis],
            bins_per_unit: BINS as f32 / extent[axis],
            bin: 0,
            cost: f32::INFINITY,
        };
        let mut bins = [(TriangleBox::EMPTY, 0usize); BINS];
        for &id in ids {
            let b = boxes[id as usize];
            let bin = &mut bins[plane.bin_of(b.centroid())];
            *bin = (bin.0.union(b), bin.1 + 1);
        }
        let mut above = [(TriangleBox::EMPTY, 0usize); BINS + 1];
        for i in (0..BINS).rev() {
            above[i] = (above[i + 1].0.union(bins[i].0), above[i + 1].1 + bins[i].1);
        }
        let mut below = (TriangleBox::EMPTY, 0usize);
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

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { triangles: 100, extent: f32::INFINITY, least_triangles: 10 };

    fn dot(p: Vec3) -> TriangleBox {
        TriangleBox { min: p, max: p + 0.1 }
    }

    /// Every triangle once; the sizes.
    fn check(boxes: &[TriangleBox], limits: &Limits) -> Vec<usize> {
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
            piece.iter().fold(TriangleBox::EMPTY, |s, &id| s.union(boxes[id as usize])).cost(0.0, 1)
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
        let crossing = vec![TriangleBox { min: Vec3::ZERO, max: Vec3::splat(90.0) }; 90];
        assert_eq!(check(&crossing, &limits).len(), 1);
    }
}
