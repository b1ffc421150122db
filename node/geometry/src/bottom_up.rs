//! A plain bottom-up hierarchy, which the top-down one is held against: a binary bounding volume
//! hierarchy by parallel locally-ordered clustering (Meister and Bittner 2018, through obvhs),
//! collapsed to a wider one.

use crate::bounds::Aabb;
use crate::hierarchy::{MAX_DEPTH, Tree};
use obvhs::Boundable;
use obvhs::bvh2::Bvh2;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

/// Builds a tree with one leaf a box and at most `branching` (2 or more) children a node. Empty only
/// for no boxes. The same boxes give the same tree.
pub fn plain(boxes: &[Aabb], branching: usize) -> Tree {
    assert!(branching >= 2 && boxes.len() < u32::MAX as usize / 2);
    assert!(boxes.iter().all(|b| !b.is_empty() && b.min.is_finite() && b.max.is_finite()));
    if boxes.is_empty() {
        return Tree::default();
    }
    let distinct = Distinct::of(boxes);
    let bvh = binary(&distinct.boxes);
    let mut tree = Tree::root();
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
        let first = tree.give_children(id, children.len());
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
