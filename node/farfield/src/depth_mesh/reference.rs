//! How far a simplified mesh strays from the dense one, and the dense one from it, as proofs.
//!
//! A dense mesh has one quad a pixel, so where a triangle lies over pixels of its own sheet it is enough to
//! compare the third coordinate in the same place: on the part of the triangle over half a pixel both are
//! linear, and their difference is greatest at the part's corners. Only parts that are too far by that, or reach
//! beyond the sheet, are left to the bound for general meshes ([`geometry::hausdorff`]), which also does
//! the way back.

use super::sheets::sheets;
use geometry::hausdorff::{Goal, Stray, Surface, directed_but};
use geometry::mesh::{Mesh, MeshVertex};
use geometry::weld::Welded;
use glam::{DVec2, DVec3, Vec3};

/// Cuts that a proof is worth, for each triangle.
const CUTS_PER_TRIANGLE: usize = 64;
/// Share of a tolerance that a proof may use itself; the rest is for its rounding.
const SHARE: f64 = 0.999;
/// Rounding of clipped corners, pixels.
const ROUNDING: f64 = 1e-9;

/// A dense mesh in projective space, and what is needed to measure against it.
pub struct Reference {
    /// Positions `(u, v, w)`, pixels.
    mesh: Mesh,
    /// By vertex, the sheet it belongs to.
    sheets: Vec<u32>,
    side: u32,
    /// By pixel, 1 + the pair of triangles that it has, or 0.
    pairs: Vec<u32>,
    surface: Surface,
}

/// Triangles that stray, and a bound for the others.
#[derive(Debug, Clone)]
pub struct Deviation {
    /// Of those that do not stray, pixels.
    pub bound: f64,
    /// A point of each that does.
    pub strays: Vec<Stray>,
}

impl Reference {
    /// Of a face of `side` pixels: two triangles for each of `pixels`, as in
    /// [`DenseMesh`](super::dense::DenseMesh).
    pub fn new(dense: &Welded, pixels: &[[u32; 2]], side: u32) -> Self {
        assert_eq!(dense.triangles.len(), 2 * pixels.len(), "triangles of a dense mesh");
        let mut pairs = vec![0; side as usize * side as usize];
        for (&[x, y], pair) in pixels.iter().zip(1..) {
            pairs[(y * side + x) as usize] = pair;
        }
        let sheets = sheets(dense.vertices.len(), &dense.triangles);
        let mesh = Mesh { vertices: dense.vertices.clone(), triangles: dense.triangles.clone() };
        let surface = Surface::new(&mesh);
        Self { mesh, sheets, side, pairs, surface }
    }

    /// The sheet that a triangle of the mesh, or of a simplified one, is part of: one of its vertices.
    pub fn sheet(&self, triangle: [u32; 3]) -> usize {
        self.sheets[triangle[0] as usize] as usize
    }

    /// How far triangles over the same vertices stray from the mesh by more than `tolerance` pixels.
    pub fn there(&self, triangles: &[[u32; 3]], tolerance: f64) -> Deviation {
        let tolerance = SHARE * tolerance;
        let mut over = Over { reference: self, tolerance, bound: 0.0, left: Parts::default() };
        for (triangle, number) in triangles.iter().zip(0..) {
            over.add(number, *triangle);
        }
        let Parts { mesh, of } = over.left;
        let mut rest = deviation(&mesh, &self.surface, tolerance);
        rest.strays.iter_mut().for_each(|stray| stray.triangle = of[stray.triangle as usize]);
        rest.strays.dedup_by_key(|stray| stray.triangle);
        Deviation { bound: over.bound.max(rest.bound), ..rest }
    }

    /// How far triangles of the mesh, `own`, stray from `triangles` over the same vertices.
    pub fn back(&self, own: &[[u32; 3]], triangles: &[[u32; 3]], tolerance: f64) -> Deviation {
        let to = Surface::of_triangles(triangles.iter().map(|triangle| self.corners(*triangle)));
        let own = Mesh { vertices: self.mesh.vertices.clone(), triangles: own.to_vec() };
        deviation(&own, &to, SHARE * tolerance)
    }

    fn corners(&self, triangle: [u32; 3]) -> [DVec3; 3] {
        triangle.map(|v| self.mesh.vertices[v as usize].position)
    }
}

fn deviation(from: &Mesh, to: &Surface, tolerance: f64) -> Deviation {
    let budget = from.triangles.len() * CUTS_PER_TRIANGLE;
    let goal = Goal { enough: tolerance, slack: 0.0, budget };
    let (bound, strays) = directed_but(from, to, &[], &goal, tolerance);
    Deviation { bound: bound.upper, strays }
}

/// Parts of triangles that are left to the general bound.
#[derive(Default)]
struct Parts {
    mesh: Mesh,
    /// By part, the triangle it is of.
    of: Vec<u32>,
}

impl Parts {
    fn add(&mut self, number: u32, corners: &[DVec3]) {
        let first = self.mesh.vertices.len() as u32;
        let vertices = corners.iter().map(|p| MeshVertex::plain(*p, Vec3::Z, [0; 4]));
        self.mesh.vertices.extend(vertices);
        for k in 2..corners.len() as u32 {
            self.mesh.triangles.push([first, first + k - 1, first + k]);
            self.of.push(number);
        }
    }
}

/// Compares triangles with the pixels they lie over.
struct Over<'a> {
    reference: &'a Reference,
    tolerance: f64,
    bound: f64,
    left: Parts,
}

impl Over<'_> {
    fn add(&mut self, number: u32, triangle: [u32; 3]) {
        let corners = self.reference.corners(triangle);
        let sheet = self.reference.sheet(triangle);
        let last = self.reference.side - 1;
        let whole = Polygon::of(&corners);
        for y in whole.range(1, last) {
            let top = f64::from(y);
            let strip = whole.between(DVec2::Y, top, top + 1.0);
            for x in strip.range(0, last) {
                let left = f64::from(x);
                let part = strip.between(DVec2::X, left, left + 1.0);
                self.add_part(number, sheet, [x, y], &part);
            }
        }
    }

    /// A part of a triangle over one pixel.
    fn add_part(&mut self, number: u32, sheet: usize, [x, y]: [u32; 2], part: &Polygon) {
        if part.is_empty() {
            return;
        }
        let reference = self.reference;
        let pair = reference.pairs[(y * reference.side + x) as usize] as usize;
        let halves = pair.checked_sub(1).map(|at| [2 * at, 2 * at + 1]);
        let [first, second] =
            match halves.map(|halves| halves.map(|at| reference.mesh.triangles[at])) {
                Some(halves) if reference.sheet(halves[0]) == sheet => halves,
                _ => return self.left.add(number, part.corners()),
            };
        // The diagonal runs from the upper right corner to the lower left one.
        let diagonal = f64::from(x + y + 1);
        for (half, below, above) in
            [(first, f64::NEG_INFINITY, diagonal), (second, diagonal, f64::INFINITY)]
        {
            let over = part.between(DVec2::ONE, below, above);
            if over.is_empty() {
                continue;
            }
            let plane = Plane::of(reference.corners(half));
            let off = over.corners().iter().map(|p| (p.z - plane.at(*p)).abs());
            let off = off.fold(0.0, f64::max) + ROUNDING;
            if off <= self.tolerance {
                self.bound = self.bound.max(off);
            } else {
                self.left.add(number, over.corners());
            }
        }
    }
}

/// The third coordinate over the first two of half a pixel.
struct Plane {
    at: DVec3,
    slope: DVec2,
}

impl Plane {
    /// Through three corners of a pixel, of which two sides lie along the axes.
    fn of([a, b, c]: [DVec3; 3]) -> Self {
        let slope = |axis: usize| {
            let along = |(p, q): &(DVec3, DVec3)| p[1 - axis] == q[1 - axis];
            let side = [(a, b), (b, c), (c, a)].into_iter().find(along);
            side.map_or(0.0, |(p, q)| (q.z - p.z) / (q[axis] - p[axis]))
        };
        Self { at: a, slope: DVec2::new(slope(0), slope(1)) }
    }

    fn at(&self, p: DVec3) -> f64 {
        self.at.z + self.slope.dot((p - self.at).truncate())
    }
}

/// A convex polygon: a triangle cut by up to six lines.
#[derive(Clone, Copy)]
struct Polygon {
    corners: [DVec3; 9],
    count: usize,
}

impl Polygon {
    fn of(triangle: &[DVec3; 3]) -> Self {
        let mut corners = [DVec3::ZERO; 9];
        corners[..3].copy_from_slice(triangle);
        Self { corners, count: 3 }
    }

    fn corners(&self) -> &[DVec3] {
        &self.corners[..self.count]
    }

    fn is_empty(&self) -> bool {
        self.count < 3
    }

    /// Numbers of the unit intervals up to `last` that it reaches into along an axis; one at least.
    fn range(&self, axis: usize, last: u32) -> std::ops::Range<u32> {
        let along = self.corners().iter().map(|p| p[axis]);
        let (least, most) =
            along.fold((f64::INFINITY, 0.0f64), |(least, most), at| (least.min(at), most.max(at)));
        let first = (least.floor() as u32).min(last);
        first..(most.ceil() as u32).clamp(first + 1, last + 1)
    }

    /// What lies where `direction . (u, v)` is between two numbers.
    fn between(&self, direction: DVec2, least: f64, most: f64) -> Self {
        let along = |p: DVec3| direction.dot(p.truncate());
        self.within(|p| along(p) - least).within(|p| most - along(p))
    }

    /// What lies where a linear function is not negative.
    fn within(&self, inside: impl Fn(DVec3) -> f64) -> Self {
        let corners = self.corners();
        if corners.iter().all(|p| inside(*p) >= 0.0) {
            return *self;
        }
        let mut cut = Self { corners: [DVec3::ZERO; 9], count: 0 };
        let mut add = |p: DVec3| {
            cut.corners[cut.count] = p;
            cut.count += 1;
        };
        for (k, &p) in corners.iter().enumerate() {
            let q = corners[(k + 1) % corners.len()];
            let (at_p, at_q) = (inside(p), inside(q));
            if at_p >= 0.0 {
                add(p);
            }
            if at_p > 0.0 && at_q < 0.0 || at_p < 0.0 && at_q > 0.0 {
                add(p + (q - p) * (at_p / (at_p - at_q)));
            }
        }
        cut
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::hausdorff::sampled;
    use geometry::weld::{Weld, weld};
    use rand::{Rng, SeedableRng, rngs::StdRng};

    const SIDE: u32 = 12;

    /// Quads of all pixels for which `of` gives a sheet and its height at a corner.
    fn quads(of: impl Fn(u32, u32, [u32; 2]) -> Option<f64>) -> (Welded, Vec<[u32; 2]>) {
        let (mut mesh, mut pixels) = (Mesh::default(), Vec::new());
        for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
            let corners = [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[dx, dy]| [x + dx, y + dy]);
            let first = mesh.vertices.len() as u32;
            for at in corners {
                let Some(w) = of(x, y, at) else { continue };
                let place = DVec3::new(f64::from(at[0]), f64::from(at[1]), w);
                mesh.vertices.push(MeshVertex::plain(place, Vec3::Z, [0; 4]));
            }
            if mesh.vertices.len() as u32 > first {
                mesh.triangles.extend([[0, 2, 1], [1, 2, 3]].map(|t| t.map(|k: u32| first + k)));
                pixels.push([x, y]);
            }
        }
        (weld(&mesh, Weld::within(0.0)), pixels)
    }

    fn vertex(dense: &Welded, u: f64, v: f64, w: f64) -> u32 {
        let place = DVec3::new(u, v, w);
        dense.vertices.iter().position(|vertex| vertex.position == place).unwrap() as u32
    }

    #[test]
    fn a_plane_over_its_own_pixels_does_not_stray_and_one_over_a_hole_does() {
        let plane = |at: [u32; 2]| 0.5 * f64::from(at[0]) + 0.25 * f64::from(at[1]);
        let (whole, pixels) = quads(|_, _, at| Some(plane(at)));
        let reference = Reference::new(&whole, &pixels, SIDE);
        let corner = |dense: &Welded, u: u32, v: u32| {
            vertex(dense, f64::from(u), f64::from(v), plane([u, v]))
        };
        let both = |dense: &Welded| {
            let [a, b, c, d] =
                [(0, 0), (SIDE, 0), (0, SIDE), (SIDE, SIDE)].map(|(u, v)| corner(dense, u, v));
            [[a, c, b], [b, c, d]]
        };
        let there = reference.there(&both(&whole), 0.5);
        assert!(there.strays.is_empty() && there.bound < 1e-8, "{there:?}");
        let back = reference.back(&whole.triangles, &both(&whole), 0.5);
        assert!(back.strays.is_empty() && back.bound < 1e-8, "{back:?}");
        let half = reference.back(&whole.triangles, &both(&whole)[..1], 0.5);
        assert!(half.strays.len() > 50, "{}", half.strays.len());
        // A hole of 4x4 pixels: its middle is two pixels from the rim.
        let hole = |x: u32, y: u32| (4..8).contains(&x) && (4..8).contains(&y);
        let (open, pixels) = quads(|x, y, at| (!hole(x, y)).then(|| plane(at)));
        let reference = Reference::new(&open, &pixels, SIDE);
        let there = reference.there(&both(&open), 0.5);
        let strays: Vec<u32> = there.strays.iter().map(|stray| stray.triangle).collect();
        assert_eq!(strays, [0, 1]);
        let far = 2.0 * (1.0 + 0.25f64).sqrt() + 0.1;
        assert!(reference.there(&both(&open), far).strays.is_empty());
    }

    #[test]
    fn what_lies_behind_another_sheet_is_measured_against_its_own() {
        // The lower half lies ten farther, and a triangle of the upper one reaches over it.
        let (dense, pixels) = quads(|_, y, _| Some(if y < 6 { 10.0 } else { 0.0 }));
        let reference = Reference::new(&dense, &pixels, SIDE);
        let [a, b, c] = [(0.0, 0.0, 10.0), (12.0, 6.0, 10.0), (0.0, 12.0, 0.0)]
            .map(|(u, v, w)| vertex(&dense, u, v, w));
        assert_ne!(reference.sheet([a, b, b]), reference.sheet([c, c, c]));
        let there = reference.there(&[[a, c, b]], 0.5);
        assert_eq!(there.strays.len(), 1);
        assert!(there.strays[0].distance > 0.5);
    }

    #[test]
    fn bounds_hold_for_whatever_is_handed_in() {
        let mut rng = StdRng::seed_from_u64(5);
        let (mut kept, mut strayed) = (0, 0);
        for _ in 0..60 {
            let heights: Vec<f64> =
                (0..(SIDE + 1).pow(2)).map(|_| rng.random_range(0.0..0.8)).collect();
            let missing: Vec<bool> = (0..SIDE * SIDE).map(|_| rng.random_bool(0.05)).collect();
            let (dense, pixels) = quads(|x, y, at| {
                let seen = !missing[(y * SIDE + x) as usize];
                seen.then(|| heights[(at[1] * (SIDE + 1) + at[0]) as usize])
            });
            let reference = Reference::new(&dense, &pixels, SIDE);
            let corner = |rng: &mut StdRng| rng.random_range(0..dense.vertices.len() as u32);
            let triangles: Vec<[u32; 3]> =
                (0..20).map(|_| [0; 3].map(|_| corner(&mut rng))).collect();
            for tolerance in [0.3, 0.5, 1.0] {
                let found = reference.there(&triangles, tolerance);
                let far: Vec<u32> = found.strays.iter().map(|stray| stray.triangle).collect();
                assert!(far.is_sorted_by(|a, b| a < b));
                assert!(found.bound <= tolerance);
                let surface = Surface::new(&reference.mesh);
                for stray in &found.strays {
                    assert!(surface.distance(stray.at, 0.0, &mut 0) > 0.99 * tolerance);
                }
                let near = (0..20u32).filter(|number| !far.contains(number));
                let near = near.map(|number| triangles[number as usize]).collect();
                let near = Mesh { vertices: dense.vertices.clone(), triangles: near };
                assert!(sampled(&near, &surface, 24) <= found.bound + 1e-9);
                kept += near.triangles.len();
                strayed += far.len();
            }
        }
        assert!(kept > 200 && strayed > 200, "{kept} {strayed}");
    }
}
