//! Small objects that lie together become one: paper 004, section 2.2, steps 2 and 3.
//!
//! Step 2, bottom up, is the graph segmentation of Felzenszwalb and Huttenlocher ("Image segmentation
//! using local variation", 1998; the criterion as in "Efficient graph-based image segmentation", 2004,
//! section 3): edges in Kruskal's order join two clusters unless the edge is longer than either
//! cluster's own longest edge by more than the scale allows. Step 3, top down, divides clusters whose
//! box is mostly empty.

use crate::bounds::Aabb;
use crate::divide::{Division, Weighted, divide};
use crate::nearest::{gap, nearest};

/// Neighbours an item has edges to.
const NEIGHBOURS: usize = 8;
/// Share of the growth of the common box in the length of an edge; orders boxes that overlap.
const GROWTH: f64 = 0.125;
/// Times the clusters' own neighbours are looked for. Each time fewer are left.
const ROUNDS: usize = 8;
/// Another round is worth its time if the last one joined one in this many.
const WORTHWHILE: usize = 32;
/// An uneven cluster is divided if the surface-area cost falls at least to this share.
const PAYING_COST: f64 = 0.75;

/// An object, or a piece of one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClusterItem {
    /// Its box, finite and not empty.
    pub bounds: Aabb,
    /// Its triangles; none counts as one.
    pub triangles: u32,
}

/// How large clusters may grow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClusterLimits {
    /// Most triangles of a cluster of several items.
    pub triangles: u32,
    /// Longest side of the box of a cluster of several items, scene units.
    pub extent: f64,
    /// The paper's k, scene units times triangles: an edge of this length over the triangles of a cluster
    /// is still no border. Infinite: only the limits above count.
    pub scale: f64,
}

/// What is known of a cluster, kept with its first item.
struct Clusters<'a> {
    limits: &'a ClusterLimits,
    /// Of each item: itself, or an earlier one of the same cluster.
    parent: Vec<u32>,
    bounds: Vec<Aabb>,
    triangles: Vec<u64>,
    /// Length of the longest edge in its spanning tree.
    internal: Vec<f64>,
}

/// Sorts items into clusters: every item is in exactly one, items ascend in a cluster, clusters
/// are ordered by their first items. Takes O(n log n) for objects of which few overlap.
///
/// The length of an edge, in scene units, is the gap between the boxes plus an eighth of what the sides of the
/// common box have more, in sum, than those of the larger one; it is 0 for coincident boxes alone.
/// Edges lead from each item to its 8 nearest; once those are in one cluster, from each cluster to its nearest.
pub fn cluster(items: &[ClusterItem], limits: &ClusterLimits) -> Vec<Vec<u32>> {
    assert!(items.len() < u32::MAX as usize && limits.extent >= 0.0 && limits.scale >= 0.0);
    let finite = |b: &Aabb| !b.is_empty() && b.min.is_finite() && b.max.is_finite();
    assert!(items.iter().all(|item| finite(&item.bounds)));
    let mut clusters = Clusters {
        limits,
        parent: (0..items.len() as u32).collect(),
        bounds: items.iter().map(|item| item.bounds).collect(),
        triangles: items.iter().map(|item| u64::from(item.triangles.max(1))).collect(),
        internal: vec![0.0; items.len()],
    };
    for _ in 0..ROUNDS {
        let open = clusters.open();
        if open.len() < 2 || clusters.round(&open) * WORTHWHILE < open.len() {
            break;
        }
    }
    clusters.members()
}

impl Clusters<'_> {
    /// Clusters that could take up another one. Others would only stand in their neighbours' way.
    fn open(&self) -> Vec<u32> {
        let extends = |b: &Aabb| b.extent().max_element() <= self.limits.extent;
        let most = u64::from(self.limits.triangles);
        let mut open: Vec<u32> = (0..self.parent.len() as u32)
            .filter(|&id| self.parent[id as usize] == id && extends(&self.bounds[id as usize]))
            .collect();
        let least = open.iter().map(|&id| self.triangles[id as usize]).min().unwrap_or(0);
        open.retain(|&id| self.triangles[id as usize] + least <= most);
        open
    }

    /// Kruskal's algorithm over the edges between clusters; how many were joined.
    fn round(&mut self, open: &[u32]) -> usize {
        let boxes: Vec<Aabb> = open.iter().map(|&id| self.bounds[id as usize]).collect();
        let mut edges = Vec::with_capacity(open.len() * NEIGHBOURS);
        nearest(&boxes, NEIGHBOURS, |a, others| {
            edges.extend(others.iter().map(|&b| {
                let weight = length(&boxes[a as usize], &boxes[b as usize]);
                (weight, open[a.min(b) as usize], open[a.max(b) as usize])
            }));
        });
        edges.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        edges.dedup();
        edges.into_iter().filter(|&(weight, a, b)| self.join(weight, a, b)).count()
    }

    fn first(&mut self, mut id: u32) -> u32 {
        while self.parent[id as usize] != id {
            let above = self.parent[self.parent[id as usize] as usize];
            self.parent[id as usize] = above;
            id = above;
        }
        id
    }

    /// Joins the clusters of two items if the edge is no border and the limits hold.
    fn join(&mut self, weight: f64, a: u32, b: u32) -> bool {
        let (a, b) = (self.first(a), self.first(b));
        let (a, b) = (a.min(b) as usize, a.max(b) as usize);
        let triangles = self.triangles[a] + self.triangles[b];
        if a == b || triangles > u64::from(self.limits.triangles) {
            return false;
        }
        let slack = |c: usize| self.internal[c] + self.limits.scale / self.triangles[c] as f64;
        let bounds = self.bounds[a].union(self.bounds[b]);
        if weight > slack(a).min(slack(b)) || bounds.extent().max_element() > self.limits.extent {
            return false;
        }
        self.parent[b] = a as u32;
        self.triangles[a] = triangles;
        self.bounds[a] = bounds;
        self.internal[a] = weight.max(self.internal[a]).max(self.internal[b]);
        true
    }

    fn members(mut self) -> Vec<Vec<u32>> {
        let mut place = vec![u32::MAX; self.parent.len()];
        let mut members: Vec<Vec<u32>> = Vec::new();
        for id in 0..self.parent.len() as u32 {
            // The first item of a cluster is its least one, so it comes first.
            let first = self.first(id) as usize;
            if place[first] == u32::MAX {
                place[first] = members.len() as u32;
                members.push(Vec::new());
            }
            members[place[first] as usize].push(id);
        }
        members
    }
}

/// Length of the edge between two boxes; the same whichever comes first.
fn length(a: &Aabb, b: &Aabb) -> f64 {
    let sides = |b: &Aabb| b.extent().element_sum();
    let growth = sides(&a.union(*b)) - sides(a).max(sides(b));
    gap(a, b) + GROWTH * growth.max(0.0)
}

/// When a cluster is uneven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SplitLimits {
    /// A cluster is left whole where the surfaces of its members' boxes sum up to this share of its own
    /// box's surface. A solid row of cubes has 1.3 and more, two far ones nearly 0.
    pub fill: f64,
    /// Fewest triangles of what is divided further.
    pub least_triangles: u32,
}

/// Divides a cluster whose box is badly filled, as long as that pays: paper 004, section 2.2, step 3,
/// after which the parts, each with its members ascending, come in a fixed order. Nothing for no members.
pub fn split_uneven(items: &[ClusterItem], cluster: &[u32], limits: &SplitLimits) -> Vec<Vec<u32>> {
    let mut members: Vec<Weighted> = cluster
        .iter()
        .map(|&id| {
            let ClusterItem { bounds, triangles } = items[id as usize];
            Weighted { bounds, weight: triangles.max(1), id }
        })
        .collect();
    let mut parts = Vec::new();
    let mut open = vec![(0, members.len())];
    while let Some((start, end)) = open.pop() {
        let part = &mut members[start..end];
        let triangles: u64 = part.iter().map(|member| u64::from(member.weight)).sum();
        if triangles >= u64::from(limits.least_triangles) && fill(part) < limits.fill {
            let division = divide(part, 1).filter(|division| division.cost <= PAYING_COST);
            if let Some(Division { first, .. }) = division {
                open.extend([(start + first, end), (start, start + first)]);
                continue;
            }
        }
        let mut ids: Vec<u32> = part.iter().map(|member| member.id).collect();
        ids.sort_unstable();
        parts.extend((!ids.is_empty()).then_some(ids));
    }
    parts
}

/// Surfaces of some boxes over that of the box around them; infinite where that has none.
fn fill(members: &[Weighted]) -> f64 {
    let around = members.iter().fold(Aabb::EMPTY, |sum, member| sum.union(member.bounds)).area();
    let sum: f64 = members.iter().map(|member| member.bounds.area()).sum();
    if around > 0.0 { sum / around } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    const LIMITS: ClusterLimits =
        ClusterLimits { triangles: 100, extent: 1e9, scale: f64::INFINITY };

    fn item(center: DVec3, half: f64, triangles: u32) -> ClusterItem {
        ClusterItem { bounds: Aabb { min: center - half, max: center + half }, triangles }
    }

    /// Every item once, in order, within the limits; the clusters.
    fn check(items: &[ClusterItem], limits: &ClusterLimits) -> Vec<Vec<u32>> {
        let clusters = cluster(items, limits);
        let mut all = clusters.concat();
        all.sort_unstable();
        assert_eq!(all, (0..items.len() as u32).collect::<Vec<_>>());
        assert!(clusters.iter().all(|c| c.is_sorted()));
        assert!(clusters.is_sorted_by_key(|c| c[0]));
        for several in clusters.iter().filter(|c| c.len() > 1) {
            let of = |id: &u32| items[*id as usize];
            let around = several.iter().fold(Aabb::EMPTY, |sum, id| sum.union(of(id).bounds));
            assert!(around.extent().max_element() <= limits.extent);
            assert!(
                several.iter().map(|id| of(id).triangles.max(1)).sum::<u32>() <= limits.triangles
            );
        }
        assert_eq!(clusters, cluster(items, limits));
        clusters
    }

    #[test]
    fn none_one_and_two() {
        assert!(check(&[], &LIMITS).is_empty());
        let dot = item(DVec3::splat(1e7), 0.0, 0);
        assert_eq!(check(&[dot], &LIMITS), [[0]]);
        assert_eq!(check(&[dot, dot], &LIMITS), [[0, 1]]);
        assert_eq!(check(&[dot, dot], &ClusterLimits { triangles: 1, ..LIMITS }), [[0], [1]]);
        let none = ClusterLimits { triangles: 0, extent: 0.0, scale: 0.0 };
        assert_eq!(check(&[dot, dot], &none), [[0], [1]]);
    }

    #[test]
    fn a_heap_of_coincident_items_fills_clusters_to_the_brim() {
        for (scale, half) in [(f64::INFINITY, 0.0), (0.0, 0.5)] {
            let items = vec![item(DVec3::splat(1e7), half, 10); 20_000];
            let clusters = check(&items, &ClusterLimits { scale, ..LIMITS });
            assert!(clusters.len() <= 4_000, "{} clusters, 2000 at best", clusters.len());
        }
    }

    #[test]
    fn a_grid_of_equal_boxes_makes_compact_clusters() {
        for scale in [1e-6, 1.0, 1e7] {
            let at = |i: u32| DVec3::new((i % 30).into(), (i / 30 % 30).into(), (i / 900).into());
            let items: Vec<_> = (0..9000).map(|i| item(at(i) * scale, 0.5 * scale, 12)).collect();
            let limits = ClusterLimits { triangles: 1200, extent: 12.0 * scale, ..LIMITS };
            let clusters = check(&items, &limits);
            assert!(clusters.len() <= 300, "{} clusters, 90 at best", clusters.len());
        }
    }

    #[test]
    fn a_border_is_an_edge_longer_than_those_inside() {
        // Two rows with a gap three times as wide as within.
        let along = |i: u32| f64::from(i) * 2.0 + if i < 10 { 0.0 } else { 4.0 };
        let items: Vec<_> = (0..20).map(|i| item(DVec3::X * along(i), 0.5, 1)).collect();
        let rows = [(0..10).collect::<Vec<u32>>(), (10..20).collect()];
        assert_eq!(check(&items, &ClusterLimits { scale: 4.0, ..LIMITS }), rows);
        // As the paper has it, too small a scale leaves single items and a large one joins all.
        assert_eq!(check(&items, &ClusterLimits { scale: 1.0, ..LIMITS }).len(), 20);
        assert_eq!(check(&items, &ClusterLimits { scale: 400.0, ..LIMITS }).len(), 1);
    }

    #[test]
    fn large_items_stay_alone_and_do_not_stand_between_others() {
        let floor = item(DVec3::ZERO, 50.0, 1);
        let at = |i: u32| DVec3::X * f64::from(i);
        // Around each small item more heavy ones than it has edges, all nearer than its like.
        let mut items = vec![floor];
        items.extend((0..80).map(|i| item(at(i / 10), 0.4, 101)));
        items.extend((0..8).map(|i| item(at(i), 0.4, 10)));
        let clusters = check(&items, &ClusterLimits { extent: 20.0, ..LIMITS });
        assert_eq!(clusters.len(), 81 + 1);
        assert_eq!(clusters[81], (81..89).collect::<Vec<u32>>());
    }

    #[test]
    fn an_edge_has_the_same_length_both_ways_and_none_is_not_a_number() {
        let a = item(DVec3::splat(1e7), 1e-6, 1).bounds;
        let b = item(DVec3::new(-1e7, 3.0, 0.1), 1e3, 1).bounds;
        assert_eq!(length(&a, &b).to_bits(), length(&b, &a).to_bits());
        assert!(length(&a, &b) > 1.7e7 && length(&a, &a) == 0.0);
        let unit = item(DVec3::ZERO, 0.5, 1).bounds;
        let moved = item(DVec3::X * 3.0, 0.5, 1).bounds;
        assert_eq!(length(&unit, &moved), 2.0 + 0.125 * 3.0);
    }

    const SPLIT: SplitLimits = SplitLimits { fill: 1.0, least_triangles: 2 };

    #[test]
    fn nothing_one_and_a_heap_are_not_uneven() {
        let dot = item(DVec3::splat(1e7), 0.0, 1);
        assert!(split_uneven(&[], &[], &SPLIT).is_empty());
        assert_eq!(split_uneven(&[dot], &[0], &SPLIT), [[0]]);
        assert_eq!(split_uneven(&[dot; 3], &[0, 1, 2], &SPLIT), [[0, 1, 2]]);
    }

    #[test]
    fn two_far_groups_are_told_apart_and_a_full_box_is_not() {
        let far = |i: u32| DVec3::new((i % 2 * 40).into(), (i % 2 * 40).into(), (i / 2).into());
        let items: Vec<_> = (0..20).map(|i| item(far(i), 0.5, 1)).collect();
        let cluster: Vec<u32> = (0..20).filter(|i| *i != 3).collect();
        let parts = split_uneven(&items, &cluster, &SPLIT);
        let of = |odd: u32| cluster.iter().copied().filter(|i| i % 2 == odd).collect::<Vec<_>>();
        assert_eq!(parts, [of(0), of(1)]);
        let least = SplitLimits { least_triangles: 20, ..SPLIT };
        assert_eq!(split_uneven(&items, &cluster, &least), [cluster]);
        let at = |i: u32| DVec3::new((i % 3).into(), (i / 3 % 3).into(), (i / 9).into());
        let full: Vec<_> = (0..27).map(|i| item(at(i), 0.5, 1)).collect();
        let all: Vec<u32> = (0..27).collect();
        assert_eq!(split_uneven(&full, &all, &SPLIT), [all]);
    }
}
