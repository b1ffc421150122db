//! A search tree over triangles, four children a node, whose boxes are tested together.

use super::triangle::Triangle;
use glam::{Vec3, Vec3A, Vec4, Vec4Swizzles};

/// Growth of boxes as a share of the greatest coordinate: both ends and the point are rounded.
const BOX_MARGIN: f32 = 8.0 * f32::EPSILON;
/// What rounding leaves of a squared distance from a box.
const BOX_SHARE: f32 = 1.0 - 8.0 * f32::EPSILON;
/// Children of a node.
const WIDTH: usize = 4;
/// Marks a child that is a triangle.
const IS_TRIANGLE: u32 = 1 << 31;
/// Most children that wait in a search: three of each level, of which 2^31 triangles have 17.
const MOST_WAITING: usize = 64;

/// A node: the boxes of its children by axis, one a lane, rounded outwards and as far again as a point
/// may be. A lane without a child is infinitely far from everything.
#[derive(Debug, Clone, Copy)]
struct Node {
    min: [Vec4; 3],
    max: [Vec4; 3],
    /// A node, or a triangle with [`IS_TRIANGLE`].
    children: [u32; WIDTH],
}

impl Node {
    /// Squared distances from each child's box, not more than those of `p`, which lies at most as far
    /// out as the surface. That of a point farther out is rounded by more, but so is it greater.
    #[inline]
    fn distances2(&self, p: [Vec4; 3]) -> Vec4 {
        let off = |k: usize| (self.min[k] - p[k]).max(p[k] - self.max[k]).max(Vec4::ZERO);
        let [x, y, z] = [off(0), off(1), off(2)];
        (x * x + y * y + z * z) * BOX_SHARE
    }
}

/// The tree. Of no triangles there is none.
#[derive(Debug, Clone)]
pub(super) struct Tree {
    nodes: Vec<Node>,
}

/// A tree that is being built.
struct Builder<'a> {
    triangles: &'a [Triangle],
    /// What they are sorted by.
    middles: Vec<Vec3>,
    /// Space to sort in.
    keys: Vec<u64>,
    /// Numbers of the triangles in the tree's order.
    order: Vec<u32>,
    margin: f32,
    nodes: Vec<Node>,
}

impl Tree {
    /// A tree over triangles whose corners are at most `reach` from the origin, and their numbers in
    /// its order, by which it knows them.
    pub(super) fn new(triangles: &[Triangle], reach: f64) -> (Self, Vec<u32>) {
        assert!(triangles.len() < IS_TRIANGLE as usize, "too many triangles");
        let middle = |t: &Triangle| {
            let [a, b, c] = t.corners();
            ((a + b + c) * (1.0 / 3.0)).as_vec3()
        };
        let mut numbers: Vec<u32> = (0..triangles.len() as u32).collect();
        let mut builder = Builder {
            triangles,
            middles: triangles.iter().map(middle).collect(),
            keys: Vec::with_capacity(triangles.len()),
            order: Vec::with_capacity(triangles.len()),
            margin: reach as f32 * BOX_MARGIN,
            nodes: Vec::with_capacity(triangles.len() / 2 + 1),
        };
        if !numbers.is_empty() {
            builder.node(&mut numbers);
        }
        (Self { nodes: builder.nodes }, builder.order)
    }

    /// Bytes it takes in memory.
    pub(super) fn bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<Node>()
    }

    /// Offers triangles that may be nearer to `p` than the square root of `best` to `nearer`, those in
    /// near boxes first. It takes a triangle and returns the new `best`; below 0 the search ends.
    #[inline]
    pub(super) fn search(&self, p: Vec3A, best: f64, mut nearer: impl FnMut(u32) -> f64) {
        // Above any distance in f64 that is less than `best`.
        let above = |best: f64| (best as f32).next_up();
        let p = Vec4::from((p, 0.0));
        let p = [p.xxxx(), p.yyyy(), p.zzzz()];
        let mut below = above(best);
        let mut waiting = [0u64; MOST_WAITING];
        let mut count = 0;
        let mut id = 0;
        loop {
            let node = &self.nodes[id as usize];
            let distances2 = node.distances2(p);
            let near = distances2.cmplt(Vec4::splat(below)).bitmask();
            let distances2 = distances2.to_array();
            // Distances are not negative, so their bits are in their order.
            let mut found: [u64; WIDTH] = std::array::from_fn(|k| {
                let is_near = u64::from(near >> k & 1).wrapping_neg();
                (u64::from(distances2[k].to_bits()) << 32 | u64::from(node.children[k])) & is_near
            });
            for (a, b) in [(0, 1), (2, 3), (0, 2), (1, 3), (1, 2)] {
                (found[a], found[b]) = (found[a].max(found[b]), found[a].min(found[b]));
            }
            waiting[count..count + WIDTH].copy_from_slice(&found);
            count += near.count_ones() as usize;
            loop {
                if count == 0 {
                    return;
                }
                count -= 1;
                let next = waiting[count];
                if f32::from_bits((next >> 32) as u32) >= below {
                    continue;
                }
                if next as u32 & IS_TRIANGLE == 0 {
                    id = next as u32;
                    break;
                }
                let best = nearer(next as u32 & !IS_TRIANGLE);
                if best < 0.0 {
                    return;
                }
                below = above(best);
            }
        }
    }
}

impl Builder<'_> {
    /// Appends the subtree over some triangles; returns the box around it.
    fn node(&mut self, numbers: &mut [u32]) -> (Vec3A, Vec3A) {
        let id = self.nodes.len();
        let lane = [Vec4::INFINITY; 3];
        let empty = Node { min: lane, max: lane.map(|l| -l), children: [0; WIDTH] };
        self.nodes.push(empty);
        let mut sets = [numbers, &mut [], &mut [], &mut []];
        let mut count = 1;
        if sets[0].len() <= WIDTH {
            count = sets[0].len();
            let mut singles = std::mem::take(&mut sets[0]).chunks_mut(1);
            sets = std::array::from_fn(|_| singles.next().unwrap_or_default());
        }
        while count < WIDTH {
            let largest = (0..count).max_by_key(|&k| (sets[k].len(), WIDTH - k)).unwrap_or(0);
            let length = sets[largest].len();
            if length <= WIDTH {
                break;
            }
            // Whole nodes of triangles, as far as possible.
            let half = (length / 2).next_multiple_of(WIDTH);
            let (first, second) = self.halved(std::mem::take(&mut sets[largest]), half);
            (sets[largest], sets[count]) = (first, second);
            count += 1;
        }
        let (mut min, mut max) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        for (k, set) in sets.into_iter().take(count).enumerate() {
            let (child, low, high) = if let [only] = *set {
                let (low, high) = self.triangle(only);
                ((self.order.len() as u32 - 1) | IS_TRIANGLE, low, high)
            } else {
                let child = self.nodes.len() as u32;
                let (low, high) = self.node(set);
                (child, low, high)
            };
            (min, max) = (min.min(low), max.max(high));
            let node = &mut self.nodes[id];
            node.children[k] = child;
            for axis in 0..3 {
                (node.min[axis][k], node.max[axis][k]) = (low[axis], high[axis]);
            }
        }
        (min, max)
    }

    /// Takes a triangle over, and returns the box around it.
    fn triangle(&mut self, number: u32) -> (Vec3A, Vec3A) {
        self.order.push(number);
        let [a, b, c] = self.triangles[number as usize].corners().map(|corner| corner.as_vec3a());
        (a.min(b).min(c) - self.margin, a.max(b).max(c) + self.margin)
    }

    /// Divides triangles by rank along the longest axis of their middles.
    fn halved<'t>(
        &mut self,
        numbers: &'t mut [u32],
        half: usize,
    ) -> (&'t mut [u32], &'t mut [u32]) {
        let middles = &self.middles;
        let first = middles[numbers[0] as usize];
        let (min, max) = numbers.iter().fold((first, first), |(low, high), &number| {
            let middle = middles[number as usize];
            (low.min(middle), high.max(middle))
        });
        let extent = max - min;
        let axis = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(0);
        self.keys.clear();
        self.keys.extend(numbers.iter().map(|&number| {
            // Bits in the order of the numbers they stand for.
            let bits = middles[number as usize][axis].to_bits();
            let ordered = if bits >> 31 == 0 { bits | 1 << 31 } else { !bits };
            u64::from(ordered) << 32 | u64::from(number)
        }));
        self.keys.select_nth_unstable(half);
        numbers.iter_mut().zip(&self.keys).for_each(|(number, &key)| *number = key as u32);
        numbers.split_at_mut(half)
    }
}
