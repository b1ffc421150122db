//! A surface to measure distances to: triangles prepared for it, and a search tree over them.

use crate::bounds::Aabb;
use crate::mesh::Mesh;
use glam::{DVec3, Vec3, Vec3A};

/// Most triangles of a leaf of the search tree.
const LEAF_TRIANGLES: usize = 2;
/// Growth of boxes as a share of the greatest coordinate: both ends and the point are rounded.
const BOX_MARGIN: f32 = 8.0 * f32::EPSILON;
/// What rounding leaves of a squared distance from a box.
const BOX_SHARE: f32 = 1.0 - 8.0 * f32::EPSILON;
/// Squared height over squared length below which a triangle is measured as its edges.
const NEEDLE: f64 = 1e-20;

/// A triangle as distances need it, relative to the surface's middle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Triangle {
    a: DVec3,
    ab: DVec3,
    ac: DVec3,
    /// Products `ab.ab`, `ab.ac`, `ac.ac`.
    pub(super) products: [f64; 3],
    /// The square of twice the area; 0 for a needle.
    pub(super) area: f64,
}

impl Triangle {
    fn new([a, b, c]: [DVec3; 3]) -> Self {
        let (ab, ac) = (b - a, c - a);
        let products @ [bb, bc, cc] = [ab.length_squared(), ab.dot(ac), ac.length_squared()];
        let area = ab.cross(ac).length_squared();
        let longest = bb.max(cc).max(bb - 2.0 * bc + cc);
        let wide = area > NEEDLE * longest * longest;
        Self { a, ab, ac, products, area: if wide { area } else { 0.0 } }
    }

    /// Squared distance from `p` (Ericson 2005, section 5.1.5; two products a point, the others are
    /// the triangle's own).
    #[inline]
    pub(super) fn distance2(&self, p: DVec3) -> f64 {
        let ap = p - self.a;
        let (b, c) = (self.ab.dot(ap), self.ac.dot(ap));
        let [bb, bc, cc] = self.products;
        if self.area == 0.0 {
            return self.edges_distance2(ap);
        }
        let (v, w) = (cc * b - bc * c, bb * c - bc * b);
        let (v, w) = if v >= 0.0 && w >= 0.0 && v + w <= self.area {
            let v = (v / self.area).min(1.0);
            (v, (w / self.area).min(1.0 - v))
        } else if b <= 0.0 && c <= 0.0 {
            (0.0, 0.0)
        } else if b >= bb && c - bc <= b - bb {
            (1.0, 0.0)
        } else if c >= cc && b - bc <= c - cc {
            (0.0, 1.0)
        } else if w <= 0.0 && b >= 0.0 && b <= bb {
            (b / bb, 0.0)
        } else if v <= 0.0 && c >= 0.0 && c <= cc {
            (0.0, c / cc)
        } else {
            let w = ((c - bc + bb - b) / (bb - 2.0 * bc + cc)).clamp(0.0, 1.0);
            (1.0 - w, w)
        };
        (ap - self.ab * v - self.ac * w).length_squared()
    }

    /// Squared distance from the nearest edge to the point at `ap` from the first corner.
    #[cold]
    fn edges_distance2(&self, ap: DVec3) -> f64 {
        let segment = |from: DVec3, along: DVec3| {
            let (to, length) = (ap - from, along.length_squared());
            let t = if length > 0.0 { (to.dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
            (to - along * t).length_squared()
        };
        let opposite = segment(self.ab, self.ac - self.ab);
        segment(DVec3::ZERO, self.ab).min(segment(DVec3::ZERO, self.ac)).min(opposite)
    }

    /// Affine coordinates of the foot of `p` in the triangle's plane, times [`Self::area`], and the
    /// squared distance from the plane. The triangle is no needle.
    pub(super) fn coordinates(&self, p: DVec3) -> ([f64; 3], f64) {
        let ap = p - self.a;
        let (b, c) = (self.ab.dot(ap), self.ac.dot(ap));
        let [bb, bc, cc] = self.products;
        let (v, w) = (cc * b - bc * c, bb * c - bc * b);
        let off = ap - self.ab * (v / self.area) - self.ac * (w / self.area);
        ([self.area - v - w, v, w], off.length_squared())
    }
}

/// A node of the search tree. Boxes are rounded outwards, and as far again as a point may be.
#[derive(Debug, Clone, Copy)]
struct Node {
    min: Vec3A,
    max: Vec3A,
    /// First triangle of a leaf; the right child of an inner node, whose left child comes next.
    first: u32,
    /// Triangles of a leaf; 0 in an inner node.
    count: u32,
}

impl Node {
    fn leaf(triangles: &[Triangle], first: usize, reach: f64) -> Self {
        let (mut min, mut max) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        for t in triangles {
            for corner in [t.a, t.a + t.ab, t.a + t.ac] {
                (min, max) = (min.min(corner.as_vec3a()), max.max(corner.as_vec3a()));
            }
        }
        let margin = reach as f32 * BOX_MARGIN;
        let count = triangles.len() as u32;
        Self { min: min - margin, max: max + margin, first: first as u32, count }
    }

    /// A squared distance that is not more than that of `p`, which lies at most as far out as the
    /// surface. That of a point farther out is rounded by more, but so is it greater.
    #[inline]
    fn distance2(&self, p: Vec3A) -> f32 {
        (self.min - p).max(p - self.max).max(Vec3A::ZERO).length_squared() * BOX_SHARE
    }
}

/// A surface to measure distances to: a search tree over triangles.
#[derive(Debug, Clone)]
pub struct Surface {
    /// What all coordinates are relative to.
    pub(super) origin: DVec3,
    /// Greatest distance of a corner from the origin.
    pub(super) reach: f64,
    pub(super) triangles: Vec<Triangle>,
    nodes: Vec<Node>,
}

impl Surface {
    /// Prepares a mesh.
    pub fn new(mesh: &Mesh) -> Self {
        Self::of_triangles(mesh.triangles.iter().map(|t| mesh.corners(*t)))
    }

    /// Prepares loose triangles with finite corners. Of none everything is infinitely far.
    pub fn of_triangles(corners: impl Iterator<Item = [DVec3; 3]> + Clone) -> Self {
        let bounds = Aabb::of(corners.clone().flatten());
        let origin = if bounds.is_empty() { DVec3::ZERO } else { bounds.center() };
        let mut reach = 0.0f64;
        let unsorted: Vec<Triangle> = corners
            .map(|triangle| {
                let local = triangle.map(|corner| corner - origin);
                reach = local.iter().fold(reach, |most, p| most.max(p.length()));
                Triangle::new(local)
            })
            .collect();
        let mut order: Vec<(Vec3, u32)> = Vec::with_capacity(unsorted.len());
        let middle = |t: &Triangle| (t.a + (t.ab + t.ac) * (1.0 / 3.0)).as_vec3();
        order.extend(unsorted.iter().zip(0..).map(|(t, id)| (middle(t), id)));
        let nodes = Vec::with_capacity(unsorted.len());
        let mut surface =
            Self { origin, reach, triangles: Vec::with_capacity(unsorted.len()), nodes };
        if !order.is_empty() {
            surface.build(&mut order, &unsorted);
        }
        surface
    }

    /// Appends the subtree over some triangles, halved by rank along the longest axis.
    fn build(&mut self, order: &mut [(Vec3, u32)], unsorted: &[Triangle]) {
        if order.len() <= LEAF_TRIANGLES {
            let first = self.triangles.len();
            self.triangles.extend(order.iter().map(|&(_, id)| unsorted[id as usize]));
            self.nodes.push(Node::leaf(&self.triangles[first..], first, self.reach));
            return;
        }
        let start = (order[0].0, order[0].0);
        let (min, max) = order.iter().fold(start, |(l, h), (m, _)| (l.min(*m), h.max(*m)));
        let extent = max - min;
        let axis = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(0);
        let by_rank =
            |a: &(Vec3, u32), b: &(Vec3, u32)| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1));
        let half = order.len() / 2;
        order.select_nth_unstable_by(half, by_rank);
        let id = self.nodes.len();
        self.nodes.push(Node { min: Vec3A::ZERO, max: Vec3A::ZERO, first: 0, count: 0 });
        let (left, right) = order.split_at_mut(half);
        self.build(left, unsorted);
        let second = self.nodes.len();
        self.build(right, unsorted);
        let (l, r) = (self.nodes[id + 1], self.nodes[second]);
        self.nodes[id] =
            Node { min: l.min.min(r.min), max: l.max.max(r.max), first: second as u32, count: 0 };
    }

    /// Bytes it takes in memory.
    pub fn bytes(&self) -> usize {
        self.triangles.capacity() * size_of::<Triangle>()
            + self.nodes.capacity() * size_of::<Node>()
    }

    /// Distance from `p` to the nearest triangle, or to any that is at most `enough` away; infinite
    /// when there is none. `hint` names a triangle to try first, and afterwards the one found; 0
    /// will do.
    pub fn distance(&self, p: DVec3, enough: f64, hint: &mut u32) -> f64 {
        let local = p - self.origin;
        *hint = (*hint).min(self.triangles.len().saturating_sub(1) as u32);
        self.nearest2(local, enough * enough, hint).sqrt()
    }

    /// The same, squared, from a point relative to the origin.
    pub(super) fn nearest2(&self, p: DVec3, enough: f64, hint: &mut u32) -> f64 {
        let Some(first) = self.triangles.get(*hint as usize) else { return f64::INFINITY };
        let mut best = first.distance2(p);
        if best <= enough {
            return best;
        }
        // Halving by rank keeps the tree below 33 levels, each of which leaves one node waiting.
        let mut waiting = [(0u32, 0.0f32); 40];
        let rounded = p.as_vec3a();
        let mut below = (best as f32).next_up();
        let mut count = 0;
        let mut id = 0u32;
        loop {
            let node = &self.nodes[id as usize];
            if node.count > 0 {
                let range = node.first as usize..(node.first + node.count) as usize;
                for (triangle, t) in self.triangles[range].iter().zip(node.first..) {
                    let distance = triangle.distance2(p);
                    if distance < best {
                        (best, *hint) = (distance, t);
                    }
                }
                if best <= enough {
                    return best;
                }
                below = (best as f32).next_up();
            } else {
                let (left, right) = (id + 1, node.first);
                let (l, r) = (
                    self.nodes[left as usize].distance2(rounded),
                    self.nodes[right as usize].distance2(rounded),
                );
                let ((near, near_bound), (far, far_bound)) =
                    if l <= r { ((left, l), (right, r)) } else { ((right, r), (left, l)) };
                if far_bound < below {
                    waiting[count] = (far, far_bound);
                    count += 1;
                }
                if near_bound < below {
                    id = near;
                    continue;
                }
            }
            loop {
                if count == 0 {
                    return best;
                }
                count -= 1;
                if waiting[count].1 < below {
                    id = waiting[count].0;
                    break;
                }
            }
        }
    }
}
