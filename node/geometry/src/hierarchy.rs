//! The tree over a scene's leaves: a binary bounding volume hierarchy by parallel locally-ordered
//! clustering (Meister and Bittner 2018, through obvhs), collapsed to a wider one.

use crate::bounds::Aabb;
use obvhs::Boundable;
use obvhs::bvh2::Bvh2;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

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
    /// Ids of a node's children.
    pub fn children(&self, node: u32) -> std::ops::Range<u32> {
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

/// Builds a tree with one leaf a box and at most `branching` (2 or more) children a node. Empty only
/// for no boxes. The same boxes give the same tree.
pub fn build(boxes: &[Aabb], branching: usize) -> Tree {
    assert!(branching >= 2 && boxes.len() < u32::MAX as usize / 2);
    assert!(boxes.iter().all(|b| !b.is_empty() && b.min.is_finite() && b.max.is_finite()));
    if boxes.is_empty() {
        return Tree::default();
    }
    let distinct = Distinct::of(boxes);
    let bvh = binary(&distinct.boxes);
    let mut tree =
        Tree { nodes: vec![TreeNode { parent: None, first_child: 0, child_count: 0, item: None }] };
    // (tree node, what it stands for, its depth); the next one last, so blocks come depth-first.
    let mut open = vec![(0u32, Part::Node(0), 0usize)];
    while let Some((id, part, depth)) = open.pop() {
        let children = match part {
            Part::Items(items) if items.len() == 1 => {
                tree.nodes[id as usize].item = Some(items[0]);
                continue;
            }
            Part::Items(items) => share(&items, branching),
            Part::Node(node) if is_leaf(&bvh, node) => {
                // The same part once more, as the items it stands for.
                open.push((id, Part::Items(distinct.items(&bvh, node)), depth));
                continue;
            }
            Part::Node(node) => match too_deep(&bvh, &distinct, node, depth, branching) {
                Some(items) => share(&items, branching),
                None => widen(&bvh, node, branching),
            },
        };
        let first = tree.nodes.len() as u32;
        tree.nodes[id as usize].first_child = first;
        tree.nodes[id as usize].child_count = children.len() as u32;
        let child = TreeNode { parent: Some(id), first_child: 0, child_count: 0, item: None };
        tree.nodes.extend(std::iter::repeat_n(child, children.len()));
        let numbered = children.into_iter().enumerate();
        open.extend(numbered.rev().map(|(i, part)| (first + i as u32, part, depth + 1)));
    }
    tree
}

/// What a tree node is made from.
enum Part {
    /// A node of the binary hierarchy.
    Node(usize),
    /// Boxes that are to be shared out evenly, in this order.
    Items(Vec<u32>),
}

/// The different boxes among the given ones. Locally-ordered clustering pairs nearest neighbours, and
/// in a heap of equal boxes it would find one pair a pass, so it sees each box once.
struct Distinct {
    boxes: Vec<Aabb>,
    /// Given boxes, equal ones together.
    order: Vec<u32>,
    /// Those equal to `boxes[i]`: `order[start[i]..start[i + 1]]`.
    start: Vec<u32>,
}

impl Distinct {
    fn of(boxes: &[Aabb]) -> Self {
        let key = |id: u32| {
            let b = &boxes[id as usize];
            [b.min.to_array(), b.max.to_array()].map(|corner| corner.map(|c| (c + 0.0).to_bits()))
        };
        let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
        order.sort_unstable_by_key(|&id| (key(id), id));
        let mut distinct = Self { boxes: Vec::new(), order, start: Vec::new() };
        for (rank, &id) in distinct.order.iter().enumerate() {
            if rank == 0 || key(distinct.order[rank - 1]) != key(id) {
                distinct.boxes.push(boxes[id as usize]);
                distinct.start.push(rank as u32);
            }
        }
        distinct.start.push(boxes.len() as u32);
        distinct
    }

    /// The given boxes of a leaf of the binary hierarchy.
    fn items(&self, bvh: &Bvh2, leaf: usize) -> Vec<u32> {
        let index = bvh.primitive_indices[bvh.nodes[leaf].first_index as usize] as usize;
        self.order[self.start[index] as usize..self.start[index + 1] as usize].to_vec()
    }
}

struct UnitBox(obvhs::aabb::Aabb);

impl Boundable for UnitBox {
    fn aabb(&self) -> obvhs::aabb::Aabb {
        self.0
    }
}

/// The binary hierarchy. Its coordinates are `f32`: they are taken relative to the scene's middle, in
/// units of its size. Its boxes only guide the clustering; bounds are made afterwards, in `f64`.
fn binary(boxes: &[Aabb]) -> Bvh2 {
    let whole = boxes.iter().fold(Aabb::EMPTY, |sum, b| sum.union(*b));
    let size = whole.extent().max_element();
    let scale = if size > 0.0 { 1.0 / size } else { 1.0 };
    let units: Vec<UnitBox> = boxes
        .iter()
        .map(|b| {
            let relative = |p: glam::DVec3| ((p - whole.center()) * scale).as_vec3a();
            UnitBox(obvhs::aabb::Aabb::new(relative(b.min), relative(b.max)))
        })
        .collect();
    PlocBuilder::with_capacity(units.len()).build(
        PlocSearchDistance::High,
        &units,
        (0..units.len() as u32).collect(),
        SortPrecision::U64,
        0,
    )
}

fn is_leaf(bvh: &Bvh2, node: usize) -> bool {
    bvh.nodes[node].prim_count > 0
}

/// Opens the largest child again and again until there are `branching` of them.
fn widen(bvh: &Bvh2, node: usize, branching: usize) -> Vec<Part> {
    let children_of = |node: usize| {
        let first = bvh.nodes[node].first_index as usize;
        [first, first + 1]
    };
    let mut children = children_of(node).to_vec();
    while children.len() < branching {
        let area = |node: usize| bvh.nodes[node].aabb().half_area();
        let inner = (0..children.len()).filter(|&i| !is_leaf(bvh, children[i]));
        // The earliest of the largest, so that ties are settled.
        let Some(largest) =
            inner.rev().max_by(|&a, &b| area(children[a]).total_cmp(&area(children[b])))
        else {
            break;
        };
        let opened = children_of(children[largest]);
        children.splice(largest..=largest, opened);
    }
    children.into_iter().map(Part::Node).collect()
}

/// The items below `node` when an even tree over them would still end at [`MAX_DEPTH`] but one a
/// level lower would not.
fn too_deep(
    bvh: &Bvh2,
    distinct: &Distinct,
    node: usize,
    depth: usize,
    branching: usize,
) -> Option<Vec<u32>> {
    // 2^32 items fit below an even binary tree of 32 levels, so nothing is decided above this.
    if depth + 32 < MAX_DEPTH {
        return None;
    }
    let mut items = Vec::new();
    let mut stack = vec![node];
    while let Some(node) = stack.pop() {
        if is_leaf(bvh, node) {
            items.extend(distinct.items(bvh, node));
        } else {
            let first = bvh.nodes[node].first_index as usize;
            stack.extend([first + 1, first]);
        }
    }
    let mut levels = 0;
    let mut capacity = 1usize;
    while capacity < items.len() {
        capacity = capacity.saturating_mul(branching);
        levels += 1;
    }
    (depth + levels + 1 > MAX_DEPTH).then_some(items)
}

/// Up to `branching` runs of items, equally long but for one.
fn share(items: &[u32], branching: usize) -> Vec<Part> {
    let parts = branching.min(items.len());
    let cut = |i: usize| i * items.len() / parts;
    (0..parts).map(|i| Part::Items(items[cut(i)..cut(i + 1)].to_vec())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn check(boxes: &[Aabb], branching: usize) -> Tree {
        let tree = build(boxes, branching);
        assert_eq!(tree, build(boxes, branching));
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
        tree
    }

    fn cube(center: DVec3, half: f64) -> Aabb {
        Aabb { min: center - half, max: center + half }
    }

    #[test]
    fn no_box_one_box_and_two() {
        assert!(build(&[], 4).nodes.is_empty());
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
