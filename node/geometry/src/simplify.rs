//! Edge-collapse simplification by meshoptimizer (Garland and Heckbert 1997), its arguments checked
//! and its borders kept.

use crate::bounds::Aabb;
use crate::weld::Welded;
use glam::DVec3;
use meshopt::{SimplifyOptions, VertexDataAdapter};

/// Share of the mesh's size that its inner arithmetic in `f32` may lose.
const ROUNDING: f64 = 1.0 / (1 << 22) as f64;
/// Weights of attributes against a position in units of the mesh's size: a colour channel of 0..1, a
/// normal's coordinate. Small: they choose among collapses that cost about the same, and keep creases
/// together. A texture coordinate weighs as much as the way on the surface that it stands for.
const COLOR_WEIGHT: f32 = 0.1;
const NORMAL_WEIGHT: f32 = 0.01;

/// A simplified index list.
#[derive(Debug, Clone, PartialEq)]
pub struct Simplified {
    /// Triangles over the same vertices.
    pub triangles: Vec<[u32; 3]>,
    /// What the simplifier thinks the deviation from the mesh given is, in its units; never 0, and
    /// no bound: it has been seen 1.9 times too small.
    pub estimate: f64,
}

/// Reduces `mesh` to about `target` triangles, or as near to it as `max_error` (mesh units, by
/// estimate) and the topology allow; thousands of triangles that share one edge stay as they are. Disjoint parts smaller than the error are dropped, unless they
/// hold a locked vertex, so the result may be empty. Vertices are kept where they are; borders between
/// colours, surfaces and charts survive as borders.
pub fn simplify(mesh: &Welded, target: usize, max_error: f64) -> Simplified {
    assert!(max_error >= 0.0);
    let bounds = Aabb::of(mesh.vertices.iter().map(|vertex| vertex.position));
    let rounding = bounds.diagonal() * ROUNDING;
    // The foreign code aborts when asked for more triangles than there are.
    if mesh.triangles.len() <= target {
        return Simplified { triangles: mesh.triangles.clone(), estimate: rounding };
    }
    if has_fins(mesh) {
        return Simplified { triangles: mesh.triangles.clone(), estimate: rounding };
    }
    let input = Input::new(mesh, &bounds);
    let limit = (max_error / input.scale) as f32;
    let pruned = input.simplify(mesh, target, limit, SimplifyOptions::Prune);
    let (triangles, reported) = if keeps_borders(mesh, &pruned.0) {
        pruned
    } else {
        input.simplify(mesh, target, limit, SimplifyOptions::None)
    };
    Simplified { triangles, estimate: f64::from(reported) * input.scale + rounding }
}

/// A position in more triangles than this is a hub, and more fins than this are many.
const MANY: u32 = 256;

/// Whether many vertices have no neighbours but hubs. The foreign code works in passes, each with one
/// collapse at a vertex, so that these take as many passes as they are.
fn has_fins(mesh: &Welded) -> bool {
    let places = || mesh.triangles.iter().map(|triangle| triangle.map(|v| mesh.place(v)));
    let mut uses = vec![0u32; mesh.places()];
    places().flatten().for_each(|place| uses[place] += 1);
    let is_hub = |place: usize| uses[place] > MANY;

    let mut is_fin: Vec<bool> = uses.iter().map(|&uses| uses > 0 && uses <= MANY).collect();
    for [a, b, c] in places() {
        for (own, others) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
            is_fin[own] &= others.into_iter().all(is_hub);
        }
    }
    is_fin.into_iter().filter(|&is_fin| is_fin).count() > MANY as usize
}

/// Whether every locked vertex that a triangle used is still used.
fn keeps_borders(mesh: &Welded, triangles: &[[u32; 3]]) -> bool {
    let used = |triangles: &[[u32; 3]]| {
        let mut used = vec![false; mesh.vertices.len()];
        let corners = triangles.as_flattened().iter();
        corners.filter(|&&v| mesh.locked[v as usize]).for_each(|&v| used[v as usize] = true);
        used
    };
    mesh.locked.iter().all(|locked| !locked) || used(&mesh.triangles) == used(triangles)
}

/// What the foreign code is handed.
struct Input {
    scale: f64,
    positions: Vec<u8>,
    attributes: Vec<f32>,
    weights: Vec<f32>,
}

impl Input {
    fn new(mesh: &Welded, bounds: &Aabb) -> Self {
        // Relative to the middle and in units of the size, so that neither 1e7 nor 1e-6 costs
        // precision.
        let (center, scale) = (bounds.center(), bounds.diagonal().max(f64::MIN_POSITIVE));
        let unit = |p: DVec3| ((p - center) / scale).as_vec3().to_array();
        let positions = mesh.vertices.iter().flat_map(|vertex| unit(vertex.position));
        let has_texture = mesh.has_texture();
        let has_gradients = has_gradients(mesh);
        let mut weights = vec![NORMAL_WEIGHT; 3];
        weights.extend([COLOR_WEIGHT; 3].iter().filter(|_| has_gradients));
        let way = (mesh.way_per_texture() / scale) as f32;
        weights.extend([way; 2].iter().filter(|_| has_texture));
        let mut attributes = Vec::with_capacity(mesh.vertices.len() * weights.len());
        for vertex in &mesh.vertices {
            attributes.extend(vertex.normal.to_array());
            let [r, g, b, _] = vertex.color.map(|channel| f32::from(channel) / 255.0);
            attributes.extend([r, g, b].iter().filter(|_| has_gradients));
            attributes.extend(vertex.tex_coord.iter().filter(|_| has_texture));
        }
        let positions = positions.flat_map(f32::to_ne_bytes).collect();
        Self { scale, positions, attributes, weights }
    }

    fn simplify(
        &self,
        mesh: &Welded,
        target: usize,
        limit: f32,
        options: SimplifyOptions,
    ) -> (Vec<[u32; 3]>, f32) {
        let adapter = VertexDataAdapter::new(&self.positions, size_of::<[f32; 3]>(), 0)
            .expect("the stride divides the bytes it was made from");
        let indices = mesh.triangles.as_flattened();
        // The foreign code reads by these numbers without looking.
        let count = mesh.vertices.len();
        assert!(indices.iter().all(|&index| (index as usize) < count));
        assert_eq!(self.positions.len(), size_of::<[f32; 3]>() * count);
        assert_eq!(self.attributes.len(), self.weights.len() * count);
        assert_eq!(mesh.locked.len(), count);
        let mut reported = 0.0f32;
        let kept = meshopt::simplify_with_attributes_and_locks(
            indices,
            &adapter,
            &self.attributes,
            &self.weights,
            self.weights.len() * size_of::<f32>(),
            &mesh.locked,
            3 * target,
            limit,
            options | SimplifyOptions::ErrorAbsolute,
            Some(&mut reported),
        );
        let (triangles, rest) = kept.as_chunks::<3>();
        assert!(rest.is_empty() && kept.iter().all(|&index| (index as usize) < count));
        (triangles.to_vec(), reported)
    }
}

/// Whether any triangle blends between colours. Elsewhere colour borders alone hold colours in place.
fn has_gradients(mesh: &Welded) -> bool {
    mesh.triangles.iter().any(|triangle| {
        let [a, b, c] = triangle.map(|vertex| mesh.vertices[vertex as usize].color);
        a != b || b != c
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::tests::{mesh_of, sphere};
    use crate::weld::{Weld, weld};

    /// Distance from `p` to a triangle (Ericson 2005, section 5.1.5).
    fn distance(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
        let (ab, ac, ap) = (b - a, c - a, p - a);
        let normal = ab.cross(ac);
        let inside = [(a, ab), (b, c - b), (c, a - c)]
            .iter()
            .all(|(start, edge)| normal.cross(*edge).dot(p - *start) >= 0.0);
        if inside {
            return ap.dot(normal).abs() / normal.length();
        }
        [(a, b), (b, c), (c, a)]
            .iter()
            .map(|(s, e)| {
                let t = ((p - *s).dot(*e - *s) / (*e - *s).length_squared()).clamp(0.0, 1.0);
                p.distance(*s + (*e - *s) * t)
            })
            .fold(f64::INFINITY, f64::min)
    }

    fn deviation(from: &Mesh, to: &Mesh) -> f64 {
        let nearest = |p: DVec3| {
            to.triangles.iter().map(|t| distance(p, to.corners(*t))).fold(f64::INFINITY, f64::min)
        };
        let samples = from.triangles.iter().flat_map(|t| {
            let [a, b, c] = from.corners(*t);
            [a, b, c, (a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5, (a + b + c) / 3.0]
        });
        samples.map(nearest).fold(0.0, f64::max)
    }

    #[test]
    fn nothing_simplifies_to_nothing() {
        let welded = weld(&Mesh::default(), Weld::within(0.0));
        assert_eq!(simplify(&welded, 10, 1.0).triangles, Vec::<[u32; 3]>::new());
        let coincident = weld(&mesh_of(&[[1e7; 3]; 3], &[[0, 1, 2]]), Weld::within(0.0));
        assert!(simplify(&coincident, 10, 1.0).triangles.is_empty());
    }

    #[test]
    fn a_mesh_below_its_target_stays() {
        let one = weld(
            &mesh_of(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], &[[0, 1, 2]]),
            Weld::within(0.0),
        );
        for target in [1, 2, usize::MAX] {
            assert_eq!(simplify(&one, target, 1.0).triangles, one.triangles);
        }
        assert!(simplify(&one, 0, 0.0).triangles.len() <= 1);
    }

    #[test]
    fn a_sphere_stays_near_its_estimate_both_ways() {
        let ball = sphere(24, 48);
        let welded = weld(&ball, Weld::within(0.0));
        for target in [1000, 300, 80] {
            let simplified = simplify(&welded, target, 10.0);
            assert!(simplified.triangles.len() <= target + target / 10);
            let level = welded.with_triangles(&simplified.triangles, simplified.estimate).0;
            let measured = deviation(&level, &ball).max(deviation(&ball, &level));
            let estimate = simplified.estimate;
            assert!(
                measured < 2.0 * estimate && estimate < measured,
                "{target}: {measured} {estimate}"
            );
        }
    }

    #[test]
    fn an_edge_that_many_triangles_share_is_left_alone() {
        let fins = |count: u32| {
            let around = |i: u32| f64::from(i).sin_cos();
            let mut positions = vec![[0.0; 3], [0.0, 0.0, 1.0]];
            positions.extend((0..count).map(around).map(|(x, y)| [x, y, 0.5]));
            let triangles: Vec<[u32; 3]> = (0..count).map(|i| [0, 1, i + 2]).collect();
            weld(&mesh_of(&positions, &triangles), Weld::within(0.0))
        };
        assert_eq!(simplify(&fins(600), 100, 10.0).triangles.len(), 600);
        assert!(simplify(&fins(200), 100, 10.0).triangles.len() <= 100);
        // A cone has a hub, and its rim can be collapsed anywhere.
        let rim = |i: u32| (f64::from(i) / 600.0 * std::f64::consts::TAU).sin_cos();
        let mut positions = vec![[0.0, 0.0, 1.0]];
        positions.extend((0..600).map(rim).map(|(x, y)| [x, y, 0.0]));
        let triangles: Vec<[u32; 3]> = (0..600).map(|i| [0, i + 1, (i + 1) % 600 + 1]).collect();
        let cone = weld(&mesh_of(&positions, &triangles), Weld::within(0.0));
        assert!(simplify(&cone, 100, 10.0).triangles.len() <= 100);
    }

    #[test]
    fn locked_vertices_stay_even_where_their_part_would_vanish() {
        let mut mesh = sphere(12, 24);
        let base = mesh.vertices.len() as u32;
        let far = mesh_of(&[[3.0, 0.0, 0.0], [3.01, 0.0, 0.0], [3.0, 0.01, 0.0]], &[[0, 1, 2]]);
        mesh.append(&far);
        mesh.vertices[base as usize..].iter_mut().for_each(|vertex| vertex.seam = 0);
        let mut welded = weld(&mesh, Weld { depth: 1, ..Weld::within(0.0) });
        let at = welded.locked.iter().position(|&locked| locked).unwrap() as u32;
        let is_used = |s: &Simplified| s.triangles.as_flattened().contains(&at);
        assert!(is_used(&simplify(&welded, 20, 1.0)));
        welded.locked.fill(false);
        assert!(!is_used(&simplify(&welded, 20, 1.0)));
    }

    #[test]
    fn the_error_limit_is_kept() {
        let welded = weld(&sphere(24, 48), Weld::within(0.0));
        let simplified = simplify(&welded, 4, 0.02);
        assert!(simplified.estimate <= 0.0201, "{}", simplified.estimate);
        assert!(simplified.triangles.len() > 50);
    }

    #[test]
    fn scale_and_distance_change_nothing() {
        let ball = sphere(16, 32);
        let plain = simplify(&weld(&ball, Weld::within(0.0)), 200, 10.0);
        for (scale, offset) in [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e7)] {
            let mut moved = ball.clone();
            moved.vertices.iter_mut().for_each(|v| v.position = v.position * scale + offset);
            let simplified = simplify(&weld(&moved, Weld::within(0.0)), 200, 10.0 * scale);
            let ratio = simplified.estimate / (plain.estimate * scale);
            assert!((0.9..1.1).contains(&ratio), "{scale} {offset} {ratio}");
        }
    }

    #[test]
    fn a_colour_border_survives() {
        // A flat strip of 40 quads, half red, half blue: two quads must be left, not one.
        let mut positions = Vec::new();
        let mut triangles = Vec::new();
        for i in 0..40u32 {
            let x = f64::from(i);
            positions.extend([
                [x, 0.0, 0.0],
                [x + 1.0, 0.0, 0.0],
                [x, 1.0, 0.0],
                [x + 1.0, 1.0, 0.0],
            ]);
            triangles.extend([[4 * i, 4 * i + 1, 4 * i + 2], [4 * i + 1, 4 * i + 3, 4 * i + 2]]);
        }
        let mut mesh = mesh_of(&positions, &triangles);
        mesh.vertices[80..].iter_mut().for_each(|v| v.color = [0, 0, 255, 255]);
        let welded = weld(&mesh, Weld::within(0.0));
        let simplified = simplify(&welded, 2, 0.5);
        let level = welded.with_triangles(&simplified.triangles, simplified.estimate).0;
        for color in [[128, 128, 128, 255], [0, 0, 255, 255]] {
            let area: f64 = level
                .triangles
                .iter()
                .filter(|t| level.vertices[t[0] as usize].color == color)
                .map(|t| {
                    let [a, b, c] = level.corners(*t);
                    (b - a).cross(c - a).length() * 0.5
                })
                .sum();
            assert!((area - 20.0).abs() < 1e-9, "{color:?} {area}");
        }
    }
}
