//! The nearest neighbours of each of many boxes, by a tree of medians over their centres.

use crate::bounds::Aabb;
use glam::DVec3;

/// Boxes of a leaf of the tree.
const LEAF: usize = 8;

/// How near a box is, the most telling first: squared gap between the boxes, squared distance of the
/// centres, distance of the indices. The last makes a heap of coincident boxes a chain; without it all
/// of them would be neighbours of the same few.
type Nearness = (f64, f64, u32);

struct Node {
    /// Around the boxes.
    bounds: Aabb,
    /// Around their centres.
    centers: Aabb,
    /// Least and greatest index.
    indices: [u32; 2],
    /// Where its items are in the order.
    start: u32,
    end: u32,
    /// The second child, the first one following its parent; 0 for a leaf.
    second: u32,
}

/// Calls `found` with each box and its up to `count` nearest others, the nearest first, in an order
/// that depends on the boxes alone. Takes O(n log n) unless most boxes overlap most others.
///
/// Gaps are Euclidean, 0 for boxes that overlap. Ties are settled by the distance of the centres, then
/// by that of the indices, then by the index. All boxes must be finite and not empty.
pub(crate) fn nearest(boxes: &[Aabb], count: usize, mut found: impl FnMut(u32, &[u32])) {
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut nodes = Vec::with_capacity(boxes.len() / LEAF * 3 + 1);
    if !boxes.is_empty() {
        grow(boxes, &mut order, 0, &mut nodes);
    }
    // Leaves are scanned where they lie in memory.
    let placed: Vec<Aabb> = order.iter().map(|&id| boxes[id as usize]).collect();
    let tree = Tree { order, placed, nodes };
    let mut best: Vec<(Nearness, u32)> = Vec::with_capacity(count + 1);
    let mut ids = Vec::with_capacity(count);
    let mut open: Vec<(Nearness, u32)> = Vec::new();
    // In the tree's order, so that one query walks where the last one did.
    for (&query, b) in tree.order.iter().zip(&tree.placed) {
        tree.search(query, b, count, &mut best, &mut open);
        ids.clear();
        ids.extend(best.iter().map(|&(_, id)| id));
        found(query, &ids);
    }
}

/// Appends the subtree over `order`, which starts at `start` of the whole order.
fn grow(boxes: &[Aabb], order: &mut [u32], start: usize, nodes: &mut Vec<Node>) {
    let mut node = Node {
        bounds: Aabb::EMPTY,
        centers: Aabb::EMPTY,
        indices: [u32::MAX, 0],
        start: start as u32,
        end: (start + order.len()) as u32,
        second: 0,
    };
    for &id in &*order {
        let b = boxes[id as usize];
        node.bounds = node.bounds.union(b);
        node.centers = node.centers.with(b.center());
        node.indices = [node.indices[0].min(id), node.indices[1].max(id)];
    }
    let extent = node.centers.extent();
    let at = nodes.len();
    nodes.push(node);
    if order.len() <= LEAF {
        return;
    }
    let axis = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(0);
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |&a, &b| {
        let key = |id: u32| boxes[id as usize].center()[axis];
        key(a).total_cmp(&key(b)).then(a.cmp(&b))
    });
    let (first, second) = order.split_at_mut(middle);
    grow(boxes, first, start, nodes);
    nodes[at].second = nodes.len() as u32;
    grow(boxes, second, start + middle, nodes);
}

/// Squared Euclidean gap between two boxes: 0 where they overlap. Symmetric to the bit.
fn gap_squared(a: &Aabb, b: &Aabb) -> f64 {
    (a.min - b.max).max(b.min - a.max).max(DVec3::ZERO).length_squared()
}

/// Euclidean gap between two boxes: 0 where they overlap. Symmetric to the bit.
pub(crate) fn gap(a: &Aabb, b: &Aabb) -> f64 {
    gap_squared(a, b).sqrt()
}

/// All boxes with the tree over them.
struct Tree {
    /// Indices of the boxes, leaf by leaf.
    order: Vec<u32>,
    /// The boxes in that order.
    placed: Vec<Aabb>,
    nodes: Vec<Node>,
}

impl Tree {
    /// Fills `best` with the `count` nearest boxes to `b`, which has the index `query`.
    fn search(
        &self,
        query: u32,
        b: &Aabb,
        count: usize,
        best: &mut Vec<(Nearness, u32)>,
        open: &mut Vec<(Nearness, u32)>,
    ) {
        let center = b.center();
        // Rounding is monotonic, so no item of a node is nearer than its node.
        let bound = |node: &Node| {
            let off = (node.centers.min - center).max(center - node.centers.max).max(DVec3::ZERO);
            let [least, greatest] = node.indices;
            let aside = least.saturating_sub(query).max(query.saturating_sub(greatest));
            (gap_squared(&node.bounds, b), off.length_squared(), aside)
        };
        let too_far = |best: &[(Nearness, u32)], nearness: &Nearness| {
            best.len() == count && best.last().is_none_or(|worst| worst.0 < *nearness)
        };
        best.clear();
        open.clear();
        open.push(((0.0, 0.0, 0), 0));
        while let Some((nearness, id)) = open.pop() {
            if too_far(best, &nearness) {
                continue;
            }
            let node = &self.nodes[id as usize];
            if node.second != 0 {
                let mut children =
                    [id + 1, node.second].map(|id| (bound(&self.nodes[id as usize]), id));
                if children[0].0 < children[1].0 {
                    children.swap(0, 1);
                }
                open.extend(children.into_iter().filter(|child| !too_far(best, &child.0)));
                continue;
            }
            let range = node.start as usize..node.end as usize;
            for (&other, c) in self.order[range.clone()].iter().zip(&self.placed[range]) {
                let off = (c.center() - center).length_squared();
                let found = ((gap_squared(c, b), off, other.abs_diff(query)), other);
                if other == query || too_far(best, &found.0) {
                    continue;
                }
                let place = best.partition_point(|have| *have < found);
                if place < count {
                    best.truncate(count - 1);
                    best.insert(place, found);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(center: DVec3, half: f64) -> Aabb {
        Aabb { min: center - half, max: center + half }
    }

    fn all(boxes: &[Aabb], count: usize) -> Vec<Vec<u32>> {
        let mut lists = vec![None; boxes.len()];
        nearest(boxes, count, |id, ids| {
            assert!(lists[id as usize].replace(ids.to_vec()).is_none(), "asked twice");
        });
        lists.into_iter().map(|list| list.expect("asked once")).collect()
    }

    #[test]
    fn none_one_and_fewer_than_asked_for() {
        assert!(all(&[], 8).is_empty());
        assert_eq!(all(&[cube(DVec3::ZERO, 0.0)], 8), [[0u32; 0]]);
        let three = [1.0, 5.0, 2.0].map(|x| cube(DVec3::X * x, 0.1));
        assert_eq!(all(&three, 8), [[2, 1], [2, 0], [0, 1]]);
        assert_eq!(all(&three, 1), [[2], [2], [0]]);
    }

    #[test]
    fn a_heap_of_coincident_boxes_is_a_chain() {
        let lists = all(&vec![cube(DVec3::splat(1e7), 0.0); 20_000], 4);
        assert_eq!(lists[0], [1, 2, 3, 4]);
        assert_eq!(lists[9_999], [9_998, 10_000, 9_997, 10_001]);
    }

    #[test]
    fn agrees_with_trying_all_pairs() {
        use rand::{Rng, SeedableRng};
        let mut random = rand::rngs::StdRng::seed_from_u64(5);
        for scale in [1e-6, 1.0, 1e7] {
            let boxes: Vec<Aabb> = (0..400)
                .map(|_| {
                    // Whole numbers make ties.
                    let mut place =
                        || DVec3::from_array([0; 3].map(|_| random.random_range(0..9).into()));
                    let (min, size) = (place(), place() * 0.3);
                    Aabb { min: min * scale, max: (min + size) * scale }
                })
                .collect();
            for (id, list) in all(&boxes, 8).into_iter().enumerate() {
                let mut others: Vec<(Nearness, u32)> = (0..400u32)
                    .filter(|&other| other as usize != id)
                    .map(|other| {
                        let (a, b) = (&boxes[id], &boxes[other as usize]);
                        let off = (b.center() - a.center()).length_squared();
                        ((gap_squared(b, a), off, other.abs_diff(id as u32)), other)
                    })
                    .collect();
                others.sort_by(|a, b| a.partial_cmp(b).expect("no NaN"));
                assert_eq!(list, others[..8].iter().map(|o| o.1).collect::<Vec<_>>());
            }
        }
    }
}
