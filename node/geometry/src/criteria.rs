//! How good a hierarchy is: the criteria of paper 004, section 2.1.1, in numbers.

use crate::bounds::Aabb;
use crate::hierarchy::Tree;
use glam::DVec3;

/// A node's box and its children's are grown by this share of its longest side before they are
/// measured, so that flat ones have a volume, too.
const GROWN: f64 = 1e-6;

/// What is measured of a tree. All 0 for a tree without nodes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Criteria {
    /// Leaves.
    pub leaves: u64,
    /// Tree depth: edges from the root to the deepest leaf.
    pub depth_max: u32,
    /// Tree depth: mean over the leaves.
    pub depth_mean: f64,
    /// Depth of a full tree with as many leaves and children: the least whole number of levels.
    pub ideal_depth: f64,
    /// Non-overlapping boxes: volumes of all pairwise intersections of a node's children, summed, over
    /// the node's volume; mean over the inner nodes whose box is not a point. 0 is best.
    pub overlap: f64,
    /// Localisation: surfaces of the boxes on the way from the root to a leaf, summed, over the root's
    /// surface; mean over the triangles of the leaves. That many boxes around a triangle does a random
    /// line through the scene meet (Goldsmith and Salmon 1987). 1 is best: all boxes but the root's are
    /// small. Unlike a sum over the tree it can be compared between trees with other leaves.
    pub localisation: f64,
    /// Object size: triangles of a leaf, the least that a tenth of the leaves do not exceed.
    pub size_p10: u32,
    /// Object size: the median.
    pub size_p50: u32,
    /// Object size: the ninth tenth.
    pub size_p90: u32,
}

/// Measures a tree over `boxes`, whose leaves hold `triangles`.
pub fn measure(tree: &Tree, boxes: &[Aabb], triangles: &[u32]) -> Criteria {
    assert_eq!(boxes.len(), triangles.len());
    if tree.nodes.is_empty() {
        return Criteria::default();
    }
    let (bounds, below) = fold(tree, boxes, triangles);
    let depths = tree.depths();
    let leaves: Vec<(u32, u32)> = (0..tree.nodes.len())
        .filter_map(|id| tree.nodes[id].item.map(|item| (depths[id], triangles[item as usize])))
        .collect();
    let mut sizes: Vec<u32> = leaves.iter().map(|leaf| leaf.1).collect();
    sizes.sort_unstable();
    let rank = |tenths: usize| sizes[(sizes.len() * tenths).div_ceil(10).saturating_sub(1)];
    let branching = tree.nodes.iter().map(|node| u64::from(node.child_count)).max().unwrap_or(0);
    Criteria {
        leaves: leaves.len() as u64,
        depth_max: leaves.iter().map(|leaf| leaf.0).max().unwrap_or(0),
        depth_mean: leaves.iter().map(|leaf| f64::from(leaf.0)).sum::<f64>() / leaves.len() as f64,
        ideal_depth: f64::from(full_depth(leaves.len() as u64, branching)),
        overlap: overlap(tree, &bounds),
        localisation: localisation(&bounds, &below),
        size_p10: rank(1),
        size_p50: rank(5),
        size_p90: rank(9),
    }
}

/// Box of each node, and triangles below it, a leaf without any counting as one.
fn fold(tree: &Tree, boxes: &[Aabb], triangles: &[u32]) -> (Vec<Aabb>, Vec<u64>) {
    let mut bounds = vec![Aabb::EMPTY; tree.nodes.len()];
    let mut below = vec![0; tree.nodes.len()];
    for (id, node) in tree.nodes.iter().enumerate().rev() {
        if let Some(item) = node.item {
            bounds[id] = boxes[item as usize];
            below[id] = u64::from(triangles[item as usize].max(1));
        }
        if let Some(parent) = node.parent {
            bounds[parent as usize] = bounds[parent as usize].union(bounds[id]);
            below[parent as usize] += below[id];
        }
    }
    (bounds, below)
}

/// Least d with branching^d >= leaves, in whole numbers: a logarithm is not the same on every machine.
fn full_depth(leaves: u64, branching: u64) -> u32 {
    let (mut depth, mut full) = (0, 1u64);
    while full < leaves {
        full = full.saturating_mul(branching);
        depth += 1;
    }
    depth
}

fn volume(b: Aabb) -> f64 {
    b.extent().max(DVec3::ZERO).element_product()
}

fn overlap(tree: &Tree, bounds: &[Aabb]) -> f64 {
    let (mut sum, mut counted) = (0.0, 0u64);
    for (id, around) in bounds.iter().enumerate() {
        let side = around.extent().max_element();
        if tree.nodes[id].item.is_some() || side <= 0.0 {
            continue;
        }
        // In units of the node's own size, so that no volume under- or overflows.
        let unit =
            |b: &Aabb| Aabb { min: (b.min - around.min) / side, max: (b.max - around.min) / side };
        let children: Vec<Aabb> = tree
            .children(id as u32)
            .map(|child| unit(&bounds[child as usize]).grown(GROWN))
            .collect();
        let mut shared = 0.0;
        for (i, a) in children.iter().enumerate() {
            shared += children[i + 1..]
                .iter()
                .map(|b| volume(Aabb { min: a.min.max(b.min), max: a.max.min(b.max) }))
                .sum::<f64>();
        }
        sum += shared / volume(unit(around).grown(GROWN));
        counted += 1;
    }
    if counted > 0 { sum / counted as f64 } else { 0.0 }
}

fn localisation(bounds: &[Aabb], below: &[u64]) -> f64 {
    let side = bounds[0].extent().max_element();
    let margin = side * GROWN;
    let root = bounds[0].grown(margin).area();
    // Around a point all boxes are the same.
    let share = |b: &Aabb| if root > 0.0 { b.grown(margin).area() / root } else { 1.0 };
    let met: f64 = bounds.iter().zip(below).map(|(b, &below)| share(b) * below as f64).sum();
    met / below[0] as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hierarchy::build;

    fn cube(center: DVec3, half: f64) -> Aabb {
        Aabb { min: center - half, max: center + half }
    }

    fn of(boxes: &[Aabb], triangles: &[u32], branching: usize) -> Criteria {
        measure(&build(boxes, triangles, branching), boxes, triangles)
    }

    #[test]
    fn nothing_and_one_box() {
        assert_eq!(of(&[], &[], 4), Criteria::default());
        for half in [0.0, 1e-6, 1e7] {
            let one = Criteria {
                leaves: 1,
                localisation: 1.0,
                size_p10: 7,
                size_p50: 7,
                size_p90: 7,
                ..Criteria::default()
            };
            assert_eq!(of(&[cube(DVec3::splat(1e7), half)], &[7], 4), one);
        }
    }

    #[test]
    fn points_and_flat_boxes_give_numbers() {
        let heap = of(&[cube(DVec3::splat(1e7), 0.0); 8], &[0; 8], 2);
        assert_eq!((heap.overlap, heap.localisation), (0.0, 4.0));
        // Two flat unit squares that share half of each.
        let flat = |x: f64| Aabb { min: DVec3::X * x, max: DVec3::new(x + 1.0, 1.0, 0.0) };
        let squares = of(&[flat(0.0), flat(0.5)], &[1, 1], 2);
        assert!((squares.overlap - 0.5 / 1.5).abs() < 1e-5, "{squares:?}");
        assert!((squares.localisation - (1.0 + 1.0 / 1.5)).abs() < 1e-5, "{squares:?}");
    }

    #[test]
    fn overlap_is_the_shared_volume() {
        let boxes = [cube(DVec3::ZERO, 1.0), cube(DVec3::X, 1.0)];
        // [-1, 1] and [0, 2] share a third of [-1, 2].
        assert!((of(&boxes, &[1, 1], 2).overlap - 1.0 / 3.0).abs() < 1e-5);
        let apart = [cube(DVec3::ZERO, 1.0), cube(DVec3::X * 2.0, 1.0)];
        assert!(of(&apart, &[1, 1], 2).overlap < 1e-5);
        let moved = boxes.map(|b| Aabb { min: b.min * 1e-6 + 1.0, max: b.max * 1e-6 + 1.0 });
        assert!((of(&moved, &[1, 1], 2).overlap - 1.0 / 3.0).abs() < 1e-4);
    }

    #[test]
    fn localisation_goes_by_triangles() {
        // The root is [0, 4] x [0, 1]^2 with area 18; a unit cube has 6, the rest 14.
        let boxes = [
            Aabb { min: DVec3::ZERO, max: DVec3::ONE },
            Aabb { min: DVec3::X, max: DVec3::new(4.0, 1.0, 1.0) },
        ];
        let expected = 1.0 + (6.0 * 1.0 + 14.0 * 3.0) / 4.0 / 18.0;
        assert!((of(&boxes, &[1, 3], 2).localisation - expected).abs() < 1e-4);
    }

    #[test]
    fn depths_and_sizes_of_a_row() {
        let boxes: Vec<_> = (0..16).map(|i| cube(DVec3::X * f64::from(i), 0.5)).collect();
        let triangles: Vec<u32> = (1..=16).collect();
        let row = of(&boxes, &triangles, 4);
        assert_eq!((row.leaves, row.ideal_depth), (16, 2.0));
        assert!(row.depth_mean >= 2.0 && f64::from(row.depth_max) >= row.depth_mean);
        assert_eq!((row.size_p10, row.size_p50, row.size_p90), (2, 8, 15));
        assert_eq!(full_depth(17, 4), 3);
        assert_eq!(full_depth(1, 0), 0);
    }
}
