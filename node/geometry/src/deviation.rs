//! How far one surface strays from another: the one-sided Hausdorff distance over samples, with the
//! early break of Taha and Hanbury (2015): a point that is nearer than the greatest distance so far
//! needs no exact answer.

use crate::bounds::Aabb;
use crate::mesh::Mesh;
use glam::DVec3;

/// Most triangles of a leaf of the search tree.
const LEAF_TRIANGLES: usize = 4;
/// One sample in so many is taken in the first pass.
const SPARSE: usize = 61;

/// A mesh to measure distances to.
#[derive(Debug, Clone)]
pub struct Surface {
    triangles: Vec<[DVec3; 3]>,
    nodes: Vec<Node>,
}

#[derive(Debug, Clone)]
struct Node {
    bounds: Aabb,
    /// Triangles of a leaf; the children of an inner node are the next node and `right`.
    first: usize,
    count: usize,
    right: usize,
}

impl Surface {
    /// Prepares a mesh with at least one triangle.
    pub fn new(mesh: &Mesh) -> Self {
        assert!(!mesh.triangles.is_empty());
        let triangles = mesh.triangles.iter().map(|t| mesh.corners(*t)).collect();
        let mut surface = Self { triangles, nodes: Vec::new() };
        surface.build(0, surface.triangles.len());
        surface
    }

    /// Appends the subtree over a range of triangles, halved by rank along the longest axis.
    fn build(&mut self, first: usize, count: usize) {
        let range = &mut self.triangles[first..first + count];
        let bounds = Aabb::of(range.iter().flatten().copied());
        let id = self.nodes.len();
        self.nodes.push(Node { bounds, first, count, right: 0 });
        if count <= LEAF_TRIANGLES {
            return;
        }
        let extent = bounds.extent();
        let axis = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(0);
        let middle = |t: &[DVec3; 3]| t[0][axis] + t[1][axis] + t[2][axis];
        range.select_nth_unstable_by(count / 2, |a, b| middle(a).total_cmp(&middle(b)));
        self.build(first, count / 2);
        self.nodes[id].right = self.nodes.len();
        self.build(first + count / 2, count - count / 2);
    }

    /// Distance from `p` to the nearest triangle, or to any that is at most `enough` away. `hint`
    /// names a triangle to try first, and afterwards the one that was found.
    pub fn distance(&self, p: DVec3, enough: f64, hint: &mut usize) -> f64 {
        let enough = enough * enough;
        let to = |triangle: usize| closest_point(p, self.triangles[triangle]).distance_squared(p);
        let mut best = to(*hint);
        if best <= enough {
            return best.sqrt();
        }
        // Halving by rank keeps the tree below 64 levels, each of which leaves one node waiting.
        let mut waiting = [(0usize, 0.0f64); 64];
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let (id, bound) = waiting[count];
            if bound >= best {
                continue;
            }
            let node = &self.nodes[id];
            if node.right == 0 {
                for triangle in node.first..node.first + node.count {
                    let distance = to(triangle);
                    if distance < best {
                        (best, *hint) = (distance, triangle);
                    }
                }
                if best <= enough {
                    break;
                }
                continue;
            }
            let bound_of = |child: usize| {
                let distance = self.nodes[child].bounds.distance(p);
                (child, distance * distance)
            };
            let (mut near, mut far) = (bound_of(id + 1), bound_of(node.right));
            if far.1 < near.1 {
                std::mem::swap(&mut near, &mut far);
            }
            waiting[count] = far;
            waiting[count + 1] = near;
            count += 2;
        }
        best.sqrt()
    }
}

/// Greatest distance from a sample to `to`, or `least` if that is greater.
///
/// A first pass over few samples, far apart, finds about how great it is; in the second, neighbours
/// in the order given share their nearest triangle, and most are settled by that alone.
pub fn deviation(samples: impl Iterator<Item = DVec3> + Clone, to: &Surface, least: f64) -> f64 {
    let mut hint = 0;
    let sparse = samples.clone().step_by(SPARSE).chain(samples);
    sparse.fold(least, |greatest, p| greatest.max(to.distance(p, greatest, &mut hint)))
}

/// Samples of a finely divided mesh: its vertices and the centroids of its triangles.
pub fn fine_samples(mesh: &Mesh) -> impl Iterator<Item = DVec3> + Clone + '_ {
    let vertices = mesh.vertices.iter().map(|vertex| vertex.position);
    vertices.chain(mesh.triangles.iter().map(|t| mesh.corners(*t).into_iter().sum::<DVec3>() / 3.0))
}

/// Samples of a mesh whose vertices are known to be where they should: centroids and edge midpoints,
/// those of an edge shared by two triangles once.
pub fn inner_samples(mesh: &Mesh) -> impl Iterator<Item = DVec3> + Clone + '_ {
    mesh.triangles.iter().flat_map(|t| {
        let corners = mesh.corners(*t);
        // Neighbours run along a shared edge in opposite directions.
        let ascending = (0..3).filter(|&k| t[k] < t[(k + 1) % 3]);
        let middles = ascending.map(move |k| (corners[k] + corners[(k + 1) % 3]) * 0.5);
        std::iter::once(corners.into_iter().sum::<DVec3>() / 3.0).chain(middles)
    })
}

/// The point of a triangle that is nearest to `p` (Ericson 2005, section 5.1.5).
fn closest_point(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let scale = 1.0 / (va + vb + vc);
    a + ab * (vb * scale) + ac * (vc * scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::tests::{mesh_of, sphere};

    #[test]
    fn a_degenerate_triangle_has_a_distance() {
        let point = Surface::new(&mesh_of(&[[3.0, 4.0, 0.0]; 3], &[[0, 1, 2]]));
        assert_eq!(point.distance(DVec3::ZERO, 0.0, &mut 0), 5.0);
        let needle =
            Surface::new(&mesh_of(&[[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], &[[0, 1, 2]]));
        assert_eq!(needle.distance(DVec3::new(1.5, 2.0, 0.0), 0.0, &mut 0), 2.0);
    }

    #[test]
    fn each_region_of_a_triangle_is_nearest_to_something() {
        let corners = [DVec3::ZERO, DVec3::X * 2.0, DVec3::Y * 2.0];
        for (p, nearest) in [
            ([-1.0, -1.0, 1.0], [0.0, 0.0, 0.0]),
            ([3.0, -1.0, 1.0], [2.0, 0.0, 0.0]),
            ([-1.0, 3.0, 1.0], [0.0, 2.0, 0.0]),
            ([1.0, -1.0, 1.0], [1.0, 0.0, 0.0]),
            ([-1.0, 1.0, 1.0], [0.0, 1.0, 0.0]),
            ([2.0, 2.0, 1.0], [1.0, 1.0, 0.0]),
            ([0.5, 0.5, 1.0], [0.5, 0.5, 0.0]),
        ] {
            let found = closest_point(DVec3::from_array(p), corners);
            assert!(found.distance(DVec3::from_array(nearest)) < 1e-12, "{p:?} {found}");
        }
    }

    #[test]
    fn the_tree_finds_what_a_search_of_all_triangles_finds() {
        let ball = sphere(20, 30);
        let surface = Surface::new(&ball);
        let mut hint = 0;
        for i in 0..500 {
            let t = f64::from(i);
            let p =
                DVec3::new((t * 0.7).sin(), (t * 1.3).cos(), (t * 0.2).sin()) * (0.2 + t * 0.01);
            let all = ball.triangles.iter().map(|t| closest_point(p, ball.corners(*t)).distance(p));
            let nearest = all.fold(f64::INFINITY, f64::min);
            assert!((surface.distance(p, 0.0, &mut hint) - nearest).abs() < 1e-12);
            let early = surface.distance(p, nearest + 0.3, &mut hint);
            assert!(early >= nearest - 1e-12 && (early <= nearest + 0.3));
        }
    }

    #[test]
    fn a_missing_part_counts_with_its_distance() {
        let plate = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 7.0]];
        let whole = mesh_of(&plate, &[[0, 1, 2], [0, 1, 3]]);
        let part = mesh_of(&plate[..3], &[[0, 1, 2]]);
        let (to_part, to_whole) = (Surface::new(&part), Surface::new(&whole));
        assert_eq!(deviation(fine_samples(&whole), &to_part, 0.0), 7.0);
        assert_eq!(deviation(inner_samples(&whole), &to_part, 0.0), 3.5);
        assert!(deviation(fine_samples(&part), &to_whole, 0.0) < 1e-15);
        assert_eq!(deviation(inner_samples(&part), &to_whole, 0.5), 0.5);
    }
}
