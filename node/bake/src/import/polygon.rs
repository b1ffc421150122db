//! Polygons to triangles.

use glam::{DVec2, DVec3};
use spade::handles::FixedVertexHandle;
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation};
use std::collections::{HashMap, VecDeque};

/// Corners that may be looked at for one polygon that crosses itself: a millisecond. Up to 90 corners get all of it.
const MOST_TURNS: u64 = 1 << 17;

/// A polygon in triangles.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Division {
    /// They wind as the polygon does; places among its corners.
    pub(super) triangles: Vec<[usize; 3]>,
    /// The polygon crosses itself, so that what it covers is not known: it was divided as well as can be.
    pub(super) is_guess: bool,
}

/// Divides a polygon into `corners.len() - 2` triangles, fewer than three corners into none.
///
/// A convex polygon is fanned from its first corner. One with dents is divided in the plane that its area vector is
/// normal to, by a constrained Delaunay triangulation with exact predicates (Chew 1989), whose triangles belong to
/// it where it winds round them: so holes that a bridge joins to the border stay open.
pub(super) fn triangulate(corners: &[DVec3]) -> Division {
    let count = corners.len();
    let known = |triangles| Division { triangles, is_guess: false };
    if count < 3 {
        return known(Vec::new());
    }
    let fan = || (1..count - 1).map(|i| [0, i, i + 1]).collect();
    if count == 3 {
        return known(fan());
    }
    let flat = project(corners);
    let turn = |a: usize, b: usize, c: usize| (flat[b] - flat[a]).perp_dot(flat[c] - flat[a]);
    let turns = |i: usize| turn(i, (i + 1) % count, (i + 2) % count);
    // Without dents, yet with every corner beside the first: else it winds round more than once.
    let convex = (0..count).all(|i| turns(i) >= 0.0);
    if convex && (1..count - 1).all(|i| turn(0, i, i + 1) >= 0.0) {
        return known(fan());
    }
    let (left, mut triangles) = without_spikes(&flat);
    let without: Vec<DVec2> = left.iter().map(|&corner| flat[corner]).collect();
    match delaunay(&without) {
        // Without an area, as far as this plane shows.
        Some(rest) if rest.is_empty() => known(fan()),
        Some(rest) => {
            triangles.extend(rest.into_iter().map(|t| t.map(|place| left[place])));
            known(triangles)
        }
        None => Division { triangles: cut_ears(count, turn), is_guess: true },
    }
}

/// Corners from which the border runs back on itself, or stands still, cut off one after the other: what is left, and
/// the triangles cut off. They have no area in this plane; where the polygon is not plane, they may have one in space.
fn without_spikes(flat: &[DVec2]) -> (Vec<usize>, Vec<[usize; 3]>) {
    let is_spike = |[a, b, c]: [usize; 3]| {
        let (back, on) = (flat[a] - flat[b], flat[c] - flat[b]);
        let stands = back == DVec2::ZERO || on == DVec2::ZERO;
        stands || back.perp_dot(on) == 0.0 && back.dot(on) > 0.0
    };
    let mut left: VecDeque<usize> = VecDeque::new();
    let mut cut = Vec::new();
    let mut behind = |left: &mut VecDeque<usize>| {
        while let [.., a, b, c] = left.make_contiguous()[..]
            && is_spike([a, b, c])
        {
            cut.push([a, b, c]);
            left.remove(left.len() - 2);
        }
    };
    for corner in 0..flat.len() {
        left.push_back(corner);
        behind(&mut left);
    }
    // Round the end, until a whole turn finds none.
    let mut turns = 0;
    while turns < 3 && left.len() > 3 {
        let before = left.len();
        left.rotate_left(1);
        behind(&mut left);
        turns = if left.len() == before { turns + 1 } else { 0 };
    }
    (left.into(), cut)
}

type Delaunay = ConstrainedDelaunayTriangulation<Point2<f64>>;

/// The triangles that a polygon winds round; none where it crosses itself or has no size.
fn delaunay(flat: &[DVec2]) -> Option<Vec<[usize; 3]>> {
    let mut mesh = Delaunay::new();
    let vertices: Vec<FixedVertexHandle> = scaled(flat)?
        .into_iter()
        .map(|p| mesh.insert(Point2::new(p.x, p.y)).ok())
        .collect::<Option<_>>()?;
    // Corners in one place are one vertex: the first of them stands for all.
    let mut corner_of: HashMap<FixedVertexHandle, usize> = HashMap::new();
    for (corner, &vertex) in vertices.iter().enumerate() {
        corner_of.entry(vertex).or_insert(corner);
    }
    // How often the border runs along an edge from its lower to its higher vertex, less how often it runs back.
    let mut runs: HashMap<[FixedVertexHandle; 2], i32> = HashMap::new();
    for (at, &from) in vertices.iter().enumerate() {
        let to = vertices[(at + 1) % vertices.len()];
        if from == to {
            continue;
        }
        let along = mesh.try_add_constraint(from, to);
        if along.is_empty() {
            return None;
        }
        for edge in along {
            let [a, b] = mesh.directed_edge(edge).vertices().map(|vertex| vertex.fix());
            let forward = points_along(&mesh, [from, to], [a, b]);
            let (ends, step) = if a < b { ([a, b], 1) } else { ([b, a], -1) };
            *runs.entry(ends).or_default() += if forward { step } else { -step };
        }
    }
    Some(wound_round(&mesh, &runs, &corner_of))
}

/// The points within a square of -1 to 1, without a change of shape: a power of two is exact. None where they have
/// no size or are no numbers.
fn scaled(flat: &[DVec2]) -> Option<Vec<DVec2>> {
    let largest = flat.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
    let is_sound = largest > 0.0 && flat.iter().all(|p| p.is_finite());
    let factor = (-largest.log2().ceil()).exp2();
    // What is nearer to 0 than the triangulation can tell stands on it.
    let lane = |c: f64| if c.abs() < spade::MIN_ALLOWED_VALUE { 0.0 } else { c };
    let within = |p: &DVec2| DVec2::new(lane(p.x * factor), lane(p.y * factor));
    (is_sound && factor.is_finite()).then(|| flat.iter().map(within).collect())
}

fn points_along(
    mesh: &Delaunay,
    way: [FixedVertexHandle; 2],
    edge: [FixedVertexHandle; 2],
) -> bool {
    let between = |[from, to]: [FixedVertexHandle; 2]| {
        let [from, to] = [from, to].map(|vertex| mesh.vertex(vertex).position());
        DVec2::new(to.x - from.x, to.y - from.y)
    };
    between(way).dot(between(edge)) > 0.0
}

/// The triangles round which the border winds, from the outside inwards: who crosses an edge from its right to its
/// left is wound round once more each time that the border runs along it.
fn wound_round(
    mesh: &Delaunay,
    runs: &HashMap<[FixedVertexHandle; 2], i32>,
    corner_of: &HashMap<FixedVertexHandle, usize>,
) -> Vec<[usize; 3]> {
    let mut winding: HashMap<usize, i32> = HashMap::from([(mesh.outer_face().index(), 0)]);
    let mut left: Vec<_> = mesh.convex_hull().map(|edge| (edge.fix(), 0)).collect();
    // Edges of the hull have the outer face to their left.
    while let Some((edge, wound)) = left.pop() {
        let inward = mesh.directed_edge(edge).rev();
        let face = inward.face().index();
        if winding.contains_key(&face) {
            continue;
        }
        let [a, b] = inward.vertices().map(|vertex| vertex.fix());
        let along = match a < b {
            true => runs.get(&[a, b]).copied().unwrap_or(0),
            false => -runs.get(&[b, a]).copied().unwrap_or(0),
        };
        winding.insert(face, wound + along);
        let sides = inward.face().as_inner().into_iter().flat_map(|face| face.adjacent_edges());
        left.extend(sides.map(|side| (side.fix(), wound + along)));
    }
    let triangles = mesh.inner_faces().filter_map(|face| {
        let [a, b, c] = face.vertices().map(|vertex| corner_of[&vertex.fix()]);
        match winding[&face.index()] {
            0 => None,
            1.. => Some([a, b, c]),
            _ => Some([a, c, b]),
        }
    });
    triangles.collect()
}

/// Cuts ear by ear (Meisters 1975), as long as that does not take too long.
fn cut_ears(count: usize, turn: impl Fn(usize, usize, usize) -> f64) -> Vec<[usize; 3]> {
    let mut left: Vec<usize> = (0..count).collect();
    let mut triangles = Vec::with_capacity(count - 2);
    let mut turns = 0;
    while left.len() > 3 {
        let around = |i: usize| {
            let n = left.len();
            [left[(i + n - 1) % n], left[i], left[(i + 1) % n]]
        };
        let is_ear = |&i: &usize| {
            let [a, b, c] = around(i);
            let inside = |&p: &usize| {
                p != a
                    && p != b
                    && p != c
                    && turn(a, b, p) >= 0.0
                    && turn(b, c, p) >= 0.0
                    && turn(c, a, p) >= 0.0
            };
            turns += left.len() as u64;
            turns <= MOST_TURNS && turn(a, b, c) > 0.0 && !left.iter().any(inside)
        };
        // There may be no ear: then any corner does.
        let ear = (0..left.len()).find(is_ear).unwrap_or(1);
        triangles.push(around(ear));
        left.remove(ear);
    }
    triangles.push([left[0], left[1], left[2]]);
    triangles
}

/// The corners in a plane in which the polygon's area is positive, or largest, exactly: an axis is left out. Where
/// what it covers cancels out, as in a bow tie, the largest triangle of its fan decides.
fn project(corners: &[DVec3]) -> Vec<DVec2> {
    /// Of the fan's largest triangle, as rounding leaves it.
    const CANCELLED: f64 = 1e-12;
    let first = corners[0];
    let fan = || corners.windows(2).map(|pair| (pair[0] - first).cross(pair[1] - first));
    let (whole, largest) = fan().fold((DVec3::ZERO, DVec3::ZERO), |(sum, largest), part| {
        let is_larger = part.length_squared() > largest.length_squared();
        (sum + part, if is_larger { part } else { largest })
    });
    let is_cancelled = whole.length_squared() < CANCELLED * largest.length_squared();
    let area = if is_cancelled { largest } else { whole };
    let size = area.abs();
    let flat = |p: &DVec3| {
        // That which the area vector is longest along.
        let (u, v, along) = if size.x >= size.y && size.x >= size.z {
            (p.y, p.z, area.x)
        } else if size.y >= size.z {
            (p.z, p.x, area.y)
        } else {
            (p.x, p.y, area.z)
        };
        if along < 0.0 { DVec2::new(v, u) } else { DVec2::new(u, v) }
    };
    corners.iter().map(flat).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(corners: &[DVec3], triangles: &[[usize; 3]]) -> (DVec3, f64) {
        triangles.iter().fold((DVec3::ZERO, 0.0), |(sum, size), t| {
            let [a, b, c] = t.map(|i| corners[i]);
            let part = 0.5 * (b - a).cross(c - a);
            (sum + part, size + part.length())
        })
    }

    /// The triangles of a polygon that does not cross itself.
    fn divided(corners: &[DVec3]) -> Vec<[usize; 3]> {
        let division = triangulate(corners);
        assert!(!division.is_guess);
        division.triangles
    }

    /// A plane polygon, laid into space in several ways.
    fn laid(flat: &[[f64; 2]]) -> Vec<Vec<DVec3>> {
        let planes: [fn([f64; 2]) -> DVec3; 8] = [
            |[u, v]| DVec3::new(u, v, 5.0),
            |[u, v]| DVec3::new(v, u, 5.0),
            |[u, v]| DVec3::new(5.0, u, v),
            |[u, v]| DVec3::new(5.0, v, u),
            |[u, v]| DVec3::new(u, 5.0, v),
            |[u, v]| DVec3::new(v, 5.0, u),
            |[u, v]| DVec3::new(u + 1e7, v - 2e7, u * 0.5 - v),
            |[u, v]| DVec3::new(u * 1e-9, 0.25 * v * 1e-9, v * 1e-9),
        ];
        planes.iter().map(|place| flat.iter().map(|&p| place(p)).collect()).collect()
    }

    /// It is covered once, by as many triangles as it has corners but two.
    fn is_covered_once(flat: &[[f64; 2]]) {
        for corners in laid(flat) {
            let triangles = divided(&corners);
            assert_eq!(triangles.len(), corners.len() - 2);
            let (vector, size) = area(&corners, &triangles);
            let whole: Vec<[usize; 3]> = (1..corners.len() - 1).map(|i| [0, i, i + 1]).collect();
            let true_vector = area(&corners, &whole).0;
            let close = |a: f64, b: f64| (a - b).abs() <= 1e-7 * b.abs();
            assert!((vector - true_vector).length() <= 1e-7 * size, "the winding stays");
            assert!(close(size, true_vector.length()), "{size}, not {}", true_vector.length());
        }
    }

    #[test]
    fn degenerate_polygons_end() {
        for count in 0..3 {
            assert!(divided(&vec![DVec3::ZERO; count]).is_empty());
        }
        assert_eq!(divided(&[DVec3::ZERO; 6]).len(), 4);
        assert_eq!(triangulate(&[DVec3::NAN; 6]).triangles.len(), 4);
        assert_eq!(triangulate(&[DVec3::MAX, DVec3::X, DVec3::MIN, DVec3::Y]).triangles.len(), 2);
        let line: Vec<DVec3> = (0..5).map(|i| DVec3::X * f64::from(i)).collect();
        assert_eq!(divided(&line).len(), 3);
        let there_and_back = [0.0, 1.0, 2.0, 3.0, 1.5].map(|x| DVec3::X * x);
        triangulate(&there_and_back);
    }

    #[test]
    fn convex_polygons_are_fanned() {
        let square = [DVec3::ZERO, DVec3::X, DVec3::ONE.with_z(0.0), DVec3::Y];
        assert_eq!(divided(&square), [[0, 1, 2], [0, 2, 3]]);
        let wide: Vec<DVec3> = (0..5000)
            .map(|i| f64::from(i) * std::f64::consts::TAU / 5000.0)
            .map(|a| DVec3::new(a.cos(), a.sin(), 0.0))
            .collect();
        assert_eq!(divided(&wide).len(), 4998);
    }

    #[test]
    fn dents_stay_dents_in_every_direction() {
        // An L, whose fan from its first corner leaves the shape.
        is_covered_once(&[[2.0, 2.0], [1.0, 2.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0], [2.0, 0.0]]);
        // With corners on its sides.
        is_covered_once(&[
            [2.0, 2.0],
            [1.5, 2.0],
            [1.0, 2.0],
            [1.0, 1.5],
            [1.0, 1.0],
            [0.0, 1.0],
            [0.0, 0.5],
            [0.0, 0.0],
            [1.0, 0.0],
            [2.0, 0.0],
        ]);
    }

    #[test]
    fn combs_of_thousands_of_teeth_keep_their_gaps() {
        let teeth = 1000;
        let mut comb = vec![[f64::from(teeth), -1.0], [f64::from(teeth), 0.0]];
        for tooth in (0..teeth).rev() {
            comb.extend([[f64::from(tooth) + 0.5, 3.0], [f64::from(tooth), 0.0]]);
        }
        comb.push([0.0, -1.0]);
        is_covered_once(&comb);
    }

    #[test]
    fn holes_behind_bridges_stay_open() {
        let square = |half: f64, [x, y]: [f64; 2]| {
            [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
                .map(|[u, v]: [f64; 2]| [x + half * u, y + half * v])
        };
        // Bridges repeat corners of the border and of the hole, which runs the other way.
        let [a, b, c, d] = square(4.0, [0.0; 2]);
        let [e, f, g, h] = square(1.0, [-2.0, -2.0]);
        let [i, j, k, l] = square(1.0, [2.0, 2.0]);
        is_covered_once(&[a, e, h, g, f, e, a, b, c, d]);
        is_covered_once(&[a, b, c, k, j, i, l, k, c, d, a, e, h, g, f, e]);
        // Holes that touch the border.
        is_covered_once(&[a, b, [4.0, 0.0], [0.0, 0.5], [0.0, 3.0], [4.0, 0.0], c, d]);
        is_covered_once(&[[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 0.0], [4.0, 3.0], [4.0, 2.0]]);
    }

    #[test]
    fn polygons_that_are_not_plane_lose_no_triangle() {
        // Two corners lie above each other, or one above a side, in the plane that the area is normal to.
        for top in [[0.0, 5.0, -5.0], [-5.0, 5.0, -5.0]] {
            let corners =
                [[-5.0, 0.0, 5.0], [5.0, 0.0, 5.0], [5.0, 0.0, -5.0], [-5.0, 0.0, -5.0], top];
            for first in 0..5 {
                let mut turned = corners.map(DVec3::from);
                turned.rotate_left(first);
                let triangles = divided(&turned);
                assert_eq!(triangles.len(), 3, "{top:?} {first}");
                let whole: Vec<[usize; 3]> = (1..4).map(|i| [0, i, i + 1]).collect();
                let [vector, expected] = [&triangles, &whole].map(|t| area(&turned, t).0);
                assert!((vector - expected).length() < 1e-9, "the border is that of the polygon");
            }
        }
        // A slit, and a corner twice.
        is_covered_once(&[
            [0.0, 0.0],
            [4.0, 0.0],
            [4.0, 4.0],
            [2.0, 4.0],
            [2.0, 1.0],
            [2.0, 4.0],
            [0.0, 3.0],
        ]);
        is_covered_once(&[[0.0, 0.0], [4.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]]);
    }

    #[test]
    fn a_polygon_that_crosses_itself_is_a_guess_and_ends() {
        let circle = |turns: f64, count: u32, radius: f64| {
            (0..count).map(move |i| {
                let a = f64::from(i) * turns * std::f64::consts::TAU / f64::from(count);
                DVec3::new(a.cos(), a.sin(), 0.0) * radius
            })
        };
        let star: Vec<DVec3> = circle(2.0, 5, 1.0).collect();
        let division = triangulate(&star);
        assert_eq!((division.triangles.len(), division.is_guess), (3, true));
        // Round and round again: hardly an ear, and each looked at takes all corners.
        let rings: Vec<DVec3> = circle(1.0, 3000, 1.0).chain(circle(1.0, 3000, 0.9)).collect();
        let division = triangulate(&rings);
        assert!(division.is_guess);
        assert_eq!(division.triangles.len(), rings.len() - 2);
    }
}
