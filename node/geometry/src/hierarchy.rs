//! The tree over a scene's leaves, top down: paper 004, section 2.2, step 4. Boxes are divided in two
//! where the surface-area heuristic says, each side keeping its share, until a node has its children.

pub use crate::bottom_up::plain;
use crate::bounds::Aabb;
use crate::divide::{Weighted, divide, halve};
use std::ops::Range;

/// Deepest a node may lie, the root lying at 0. Deeper subtrees, which only heaps of coincident boxes
/// make, are rebuilt evenly.
pub const MAX_DEPTH: usize = 48;

/// A node of a [`Tree`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TreeNode {
    /// Parent; `None` for the root.
    pub parent: Option<u32>,
    /// First child; children are contiguous. 0 for a leaf.
    pub first_child: u32,
    /// Number of children: 0 for a leaf, else 2 or more.
    pub child_count: u32,
    /// What a leaf holds: index into the boxes the tree was built over.
    pub item: Option<u32>,
}

/// A tree in depth-first blocks: node 0 is the root, and the children of a node, a contiguous run,
/// come after it and before the children of its later siblings.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Tree {
    /// Nodes, parents before children.
    pub nodes: Vec<TreeNode>,
}

impl Tree {
    /// A root that has neither children nor an item yet.
    pub(crate) fn root() -> Self {
        Self { nodes: vec![TreeNode { parent: None, first_child: 0, child_count: 0, item: None }] }
    }

    /// Appends the children of a node that has none and returns the first one's id.
    pub(crate) fn give_children(&mut self, node: u32, count: usize) -> u32 {
        let first = self.nodes.len() as u32;
        self.nodes[node as usize].first_child = first;
        self.nodes[node as usize].child_count = count as u32;
        let child = TreeNode { parent: Some(node), first_child: 0, child_count: 0, item: None };
        self.nodes.extend(std::iter::repeat_n(child, count));
        first
    }

    /// Ids of a node's children.
    pub fn children(&self, node: u32) -> Range<u32> {
        let TreeNode { first_child, child_count, .. } = self.nodes[node as usize];
        first_child..first_child + child_count
    }

    /// Depth of each node, the root at 0.
    pub fn depths(&self) -> Vec<u32> {
        let mut depths: Vec<u32> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            depths.push(node.parent.map_or(0, |parent| depths[parent as usize] + 1));
        }
        depths
    }
}

/// The smaller side of a division holds at least one in this many of the boxes, so the depth is at most
/// logarithmic. Measured on the leaves of six scenes, a third gave a tenth less overlap than a quarter
/// or no rule at all, and as short ways.
const LEAST_SHARE: usize = 3;

/// Builds a tree with one leaf a box and at most `branching` (2 or more) children a node. Empty only
/// for no boxes. The same arguments give the same tree.
///
/// `weights` are what the boxes hold, in triangles: surfaces are made small where there is most. The
/// child with the most boxes is divided again until a node has all its children. Takes O(n log n).
pub fn build(boxes: &[Aabb], weights: &[u32], branching: usize) -> Tree {
    assert!(branching >= 2 && boxes.len() < u32::MAX as usize / 2 && weights.len() == boxes.len());
    assert!(boxes.iter().all(|b| !b.is_empty() && b.min.is_finite() && b.max.is_finite()));
    if boxes.is_empty() {
        return Tree::default();
    }
    let mut items: Vec<Weighted> = (0..)
        .zip(boxes.iter().zip(weights))
        .map(|(id, (&bounds, &weight))| Weighted { bounds, weight: weight.max(1), id })
        .collect();
    let mut tree = Tree::root();
    // (tree node, its boxes, its depth); the next one last, so blocks come depth-first.
    let mut open = vec![(0u32, 0..items.len(), 0usize)];
    while let Some((node, range, depth)) = open.pop() {
        if range.len() == 1 {
            tree.nodes[node as usize].item = Some(items[range.start].id);
            continue;
        }
        // Whatever is cut off, an even tree over it would end in time.
        let free = depth + 1 + even_depth(range.len()) <= MAX_DEPTH;
        let mut children = vec![range];
        while children.len() < branching {
            let Some((at, range)) = most(&children).filter(|(_, range)| range.len() > 1) else {
                break;
            };
            let part = &mut items[range.clone()];
            let least = part.len().div_ceil(LEAST_SHARE);
            let division = if free { divide(part, least) } else { None };
            let cut = range.start + division.map_or_else(|| halve(part), |division| division.first);
            children.splice(at..=at, [range.start..cut, cut..range.end]);
        }
        let first = tree.give_children(node, children.len());
        let numbered = children.into_iter().enumerate();
        open.extend(numbered.rev().map(|(i, range)| (first + i as u32, range, depth + 1)));
    }
    tree
}

/// Levels below a node that is halved until single boxes are left.
fn even_depth(boxes: usize) -> usize {
    boxes.next_power_of_two().ilog2() as usize
}

/// The earliest of those with the most boxes.
fn most(children: &[Range<usize>]) -> Option<(usize, Range<usize>)> {
    children.iter().cloned().enumerate().rev().max_by_key(|(_, range)| range.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// Both trees hold what every tree must; the top-down one.
    fn check(boxes: &[Aabb], branching: usize) -> Tree {
        let weights = vec![1; boxes.len()];
        let tree = build(boxes, &weights, branching);
        for (tree, again) in [
            (&tree, build(boxes, &weights, branching)),
            (&plain(boxes, branching), plain(boxes, branching)),
        ] {
            assert_eq!(*tree, again);
            check_tree(tree, boxes, branching);
        }
        tree
    }

    fn check_tree(tree: &Tree, boxes: &[Aabb], branching: usize) {
        let mut items: Vec<u32> = tree.nodes.iter().filter_map(|node| node.item).collect();
        items.sort_unstable();
        assert_eq!(items, (0..boxes.len() as u32).collect::<Vec<_>>());
        let mut next = 1;
        let mut parents = vec![None; tree.nodes.len()];
        for (id, node) in tree.nodes.iter().enumerate() {
            assert_eq!(node.item.is_some(), node.child_count == 0);
            assert!(node.child_count != 1 && node.child_count as usize <= branching);
            if node.child_count > 0 {
                assert!(node.first_child as usize > id);
                for child in tree.children(id as u32) {
                    parents[child as usize] = Some(id as u32);
                    next += 1;
                }
            }
        }
        assert_eq!(next, tree.nodes.len());
        assert!(tree.nodes.iter().zip(&parents).all(|(node, parent)| node.parent == *parent));
        assert!(tree.depths().iter().all(|&depth| depth as usize <= MAX_DEPTH));
    }

    fn cube(center: DVec3, half: f64) -> Aabb {
        Aabb { min: center - half, max: center + half }
    }

    #[test]
    fn no_box_one_box_and_two() {
        assert!(build(&[], &[], 4).nodes.is_empty() && plain(&[], 4).nodes.is_empty());
        assert_eq!(check(&[cube(DVec3::ZERO, 0.0)], 4).nodes[0].item, Some(0));
        assert_eq!(check(&[cube(DVec3::ZERO, 0.0), cube(DVec3::ONE, 1.0)], 4).nodes.len(), 3);
    }

    #[test]
    fn a_heap_of_coincident_boxes_stays_shallow() {
        for count in [3, 100, 20_000] {
            check(&vec![cube(DVec3::splat(1e7), 0.5); count], 4);
            check(&vec![cube(DVec3::splat(1e7), 0.0); count], 2);
        }
    }

    #[test]
    fn rows_and_grids_of_equal_boxes_are_quick() {
        check(&(0..20_000).map(|i| cube(DVec3::X * f64::from(i), 0.5)).collect::<Vec<_>>(), 4);
        let at = |i: i32| DVec3::new(f64::from(i % 27), f64::from(i / 27 % 27), f64::from(i / 729));
        check(&(0..19_683).map(|i| cube(at(i), 0.5)).collect::<Vec<_>>(), 4);
        check(&(0..19_683).map(|i| cube(at(i), 50.0)).collect::<Vec<_>>(), 4);
    }

    #[test]
    fn nested_boxes_of_every_scale_stay_shallow() {
        let boxes: Vec<_> = (0..2000).map(|i| cube(DVec3::ZERO, 1.01f64.powi(i))).collect();
        check(&boxes, 2);
        check(&boxes, 8);
    }

    #[test]
    fn boxes_ever_farther_apart_make_no_chain() {
        let boxes: Vec<_> = (0..300).map(|i| cube(DVec3::X * 1.5f64.powi(i), 0.5)).collect();
        // A third at least goes either way, and 300 * (2/3)^15 is below 1.
        assert!(check(&boxes, 2).depths().iter().all(|&depth| depth <= 15));
    }

    #[test]
    fn neighbours_share_ancestors() {
        // Two far groups: below the root no node holds items of both.
        let boxes: Vec<_> = (0..200u32)
            .map(|i| cube(DVec3::new(f64::from(i % 100), 1e5 * f64::from(i / 100), 0.0) + 1e7, 0.4))
            .collect();
        let tree = check(&boxes, 4);
        let mut groups = vec![[false; 2]; tree.nodes.len()];
        for id in (0..tree.nodes.len()).rev() {
            if let Some(item) = tree.nodes[id].item {
                groups[id][item as usize / 100] = true;
            }
            if let Some(parent) = tree.nodes[id].parent {
                let below = groups[id];
                (0..2).for_each(|g| groups[parent as usize][g] |= below[g]);
            }
        }
        assert_eq!(groups.iter().filter(|g| g[0] && g[1]).count(), 1);
        assert!(tree.nodes.len() < 200 + 120, "{}", tree.nodes.len());
    }
}
