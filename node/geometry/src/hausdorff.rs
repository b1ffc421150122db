//! How far one surface strays from another: an upper bound on the one-sided Hausdorff distance
//! between triangle meshes that is a proof, with a lower bound beside it.
//!
//! The distance to a single triangle is a convex function, so on a piece of surface it is greatest
//! at the piece's corners (Tang, Lee, Kim 2009, *Interactive Hausdorff distance computation for
//! general polygonal models*, section 4). A piece all of whose corners are near one triangle is
//! settled; others are cut, first along the sides of the triangle that is nearest to their middle,
//! so that each part lies over one triangle, and where that does not help, in halves.
//!
//! # Rounding
//! Everything is computed relative to the middle of the surface measured to, so errors go with the
//! extent of the two meshes and not with where they are. With `R` the greatest distance of a corner
//! from there and `u = 2^-53`: moving a corner there is off by at most `sqrt(3) u R`; a distance is
//! that to a point given by clamped barycentric coordinates, within `16 u R` of a point of the
//! triangle whatever its shape; and a cut misses the edge it cuts by `8 u R`, at most [`DEEPEST`]
//! times. Together less than `600 u R`; [`MARGIN`] is added to what is proven. An inexact nearest
//! point only makes a distance greater, which is the safe side for the upper bound.

use crate::mesh::Mesh;
use fans::NONE;
use glam::DVec3;
use std::collections::{BinaryHeap, HashSet};

mod fans;
mod surface;
#[cfg(test)]
mod tests;
mod tree;
mod triangle;

pub use surface::Surface;

/// Rounding added to upper bounds, as a share of the greatest coordinate: 1024 u.
const MARGIN: f64 = 512.0 * f64::EPSILON;
/// Most cuts one within the other.
const DEEPEST: u8 = 60;
/// Cuts of one triangle before others have their turn.
const CUTS_AT_ONCE: usize = 24;
/// Triangles looked at first, to learn about how great the distance is.
const FIRST_LOOKS: usize = 8;
/// A triangle this share of the wanted distance away is as good as the nearest.
const NEAR_SHARE: f64 = 0.15;
/// Least reach of both parts of a piece from where it is cut, as a share of the wanted distance.
const CUT_SHARE: f64 = 0.125;

/// Bounds on the greatest distance from a point of one surface to another surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bound {
    /// No point is farther away than this.
    pub upper: f64,
    /// Some point is this far away.
    pub lower: f64,
}

/// How much work a bound is worth.
#[derive(Debug, Clone, Copy)]
pub struct Goal {
    /// Up to this distance the bound need not be tight.
    pub enough: f64,
    /// Nor any tighter than this share above the lower bound.
    pub slack: f64,
    /// Most cuts of triangles; what is then unsettled counts with the bound it has.
    pub budget: usize,
}

/// Bounds the greatest distance from a point of `from` to `to`, both ends finite; 0 if `from` has no
/// triangle, infinite if only `to` has none.
pub fn directed(from: &Mesh, to: &Surface, goal: &Goal) -> Bound {
    directed_but(from, to, &[], goal, f64::INFINITY).0
}

/// A point that was seen farther away than a limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stray {
    /// The triangle it lies in.
    pub triangle: u32,
    /// Where.
    pub at: DVec3,
    /// How far away it is, unless something nearer was overlooked.
    pub distance: f64,
}

/// The same for those triangles of `from` that nothing is known of to be farther away than `limit`; of each of
/// the others a point is returned, triangles ascending. Where the budget ends before a triangle is known to
/// lie within a finite limit, it counts as one of the others.
///
/// `places` are those of the vertices of `from`, numbered as those that `to` was prepared with, or
/// empty. They save searches. Nothing is taken for granted from them: what is wrong in them costs time,
/// and no bound.
pub fn directed_but(
    from: &Mesh,
    to: &Surface,
    places: &[u32],
    goal: &Goal,
    limit: f64,
) -> (Bound, Vec<Stray>) {
    assert!(places.is_empty() || places.len() == from.vertices.len(), "one place a vertex");
    if from.triangles.is_empty() {
        return (Bound { upper: 0.0, lower: 0.0 }, Vec::new());
    }
    if to.triangles.is_empty() {
        if limit < f64::INFINITY {
            let all = from.triangles.iter().zip(0..).map(|(corners, triangle)| Stray {
                triangle,
                at: from.vertices[corners[0] as usize].position,
                distance: f64::INFINITY,
            });
            let all = all.collect();
            return (Bound { upper: 0.0, lower: 0.0 }, all);
        }
        return (Bound { upper: f64::INFINITY, lower: f64::INFINITY }, Vec::new());
    }
    let mut prover = Prover::new(from, to, goal.enough, 1.0 + goal.slack);
    prover.limit = limit;
    prover.places = places;
    for (near, &place) in prover.near.iter_mut().zip(places) {
        *near = to.fans.any(place);
    }
    let mut far = Vec::new();
    let stride = from.triangles.len().div_ceil(FIRST_LOOKS);
    for triangle in from.triangles.iter().step_by(stride) {
        let piece = prover.piece(*triangle);
        prover.look(piece.middle(), piece.near[0], prover.seen);
    }
    prover.strayed = None;
    let mut left = goal.budget;
    let mut unsettled = BinaryHeap::new();
    for (triangle, id) in from.triangles.iter().zip(0..) {
        prover.triangle = id;
        left -= prover.settle(*triangle, left.min(CUTS_AT_ONCE));
        if let Some((at, distance)) = prover.strayed.take() {
            far.push(Stray { triangle: id, at: at + to.origin, distance });
            prover.open.clear();
        }
        unsettled.extend(prover.open.drain(..));
    }
    // Those that stray only here.
    let mut has_strayed = HashSet::new();
    // Worst first: none that ends below the bound is ever cut.
    while let Some(worst) = unsettled.pop() {
        if has_strayed.contains(&worst.triangle) {
            continue;
        }
        if worst.upper <= prover.wanted || left == 0 || worst.piece.depth >= DEEPEST {
            if limit < f64::INFINITY && worst.upper > prover.wanted.max(limit) {
                let at = worst.piece.middle() + to.origin;
                far.push(Stray { triangle: worst.triangle, at, distance: worst.upper });
                has_strayed.insert(worst.triangle);
                continue;
            }
            prover.proven = prover.proven.max(worst.upper * worst.upper);
            break;
        }
        left -= 1;
        prover.triangle = worst.triangle;
        for part in prover.cut(&worst) {
            if !prover.near_a_corner(&part)
                && let Some(open) = prover.near_its_middle(part)
            {
                unsettled.push(Open { upper: open.upper.min(worst.upper), ..open });
            }
        }
        if let Some((at, distance)) = prover.strayed.take() {
            far.push(Stray { triangle: worst.triangle, at: at + to.origin, distance });
            has_strayed.insert(worst.triangle);
        }
    }
    far.sort_by_key(|stray| stray.triangle);
    (prover.bound(), far)
}

/// The greatest distance to `to` from a sample of `from`: corners, and `per_edge - 1` more along
/// each edge with the triangular grid they span. Nothing is proven about what lies between.
pub fn sampled(from: &Mesh, to: &Surface, per_edge: u32) -> f64 {
    let (n, mut hint, mut greatest) = (per_edge.max(1), 0, 0.0f64);
    for triangle in &from.triangles {
        let [a, b, c] = from.corners(*triangle);
        for i in 0..=n {
            for j in 0..=n - i {
                let (v, w) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                let p = a + (b - a) * v + (c - a) * w;
                greatest = greatest.max(to.distance(p, greatest, &mut hint));
            }
        }
    }
    greatest
}

/// A part of a triangle of the surface that is measured.
#[derive(Debug, Clone, Copy)]
struct Piece {
    corners: [DVec3; 3],
    /// A triangle near each corner.
    near: [u32; 3],
    /// Cuts it comes from.
    depth: u8,
}

impl Piece {
    fn middle(&self) -> DVec3 {
        (self.corners[0] + self.corners[1] + self.corners[2]) * (1.0 / 3.0)
    }

    /// Corners in turned order, `first` at the front.
    fn turned(&self, first: usize) -> ([DVec3; 3], [u32; 3]) {
        let at = |k: usize| (first + k) % 3;
        ([0, 1, 2].map(|k| self.corners[at(k)]), [0, 1, 2].map(|k| self.near[at(k)]))
    }

    /// Cut where each of two sides has gone a share of its way from corner `first`.
    fn cut_corner(&self, first: usize, [s, t]: [f64; 2], near: u32) -> [Self; 3] {
        let ([a, b, c], [na, nb, nc]) = self.turned(first);
        let (p, q) = (a + (b - a) * s, a + (c - a) * t);
        let depth = self.depth + 1;
        let part = |corners, near| Self { corners, near, depth };
        [
            part([p, b, q], [near, nb, near]),
            part([q, b, c], [near, nb, nc]),
            part([a, p, q], [na, near, near]),
        ]
    }

    /// Halved across the longest side.
    fn halves(&self, near: u32) -> [Self; 2] {
        let side = |k: usize| self.corners[k].distance_squared(self.corners[(k + 1) % 3]);
        let longest = (0..3).max_by(|&a, &b| side(a).total_cmp(&side(b))).unwrap_or(0);
        let ([a, b, c], [na, nb, nc]) = self.turned(longest);
        let (p, depth) = ((a + b) * 0.5, self.depth + 1);
        [
            Self { corners: [p, b, c], near: [near, nb, nc], depth },
            Self { corners: [a, p, c], near: [na, near, nc], depth },
        ]
    }
}

/// A piece that is not settled; the worst is the greatest.
#[derive(Debug, Clone, Copy)]
struct Open {
    /// Proven for the piece, rounding aside.
    upper: f64,
    /// The triangle it is of.
    triangle: u32,
    /// The triangle near its middle.
    near: u32,
    piece: Piece,
}

impl PartialEq for Open {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Open {}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.upper.total_cmp(&other.upper)
    }
}

/// What is known so far.
struct Prover<'a> {
    to: &'a Surface,
    /// Vertices relative to the surface's origin.
    points: Vec<DVec3>,
    /// The place of each vertex, or none.
    places: &'a [u32],
    /// A triangle near each vertex, once asked for.
    near: Vec<u32>,
    /// By vertex, the squared distance to one triangle.
    known: Vec<(u32, f64)>,
    margin: f64,
    /// Factor from the lower bound to what is wanted.
    factor: f64,
    /// A piece within this is settled.
    wanted: f64,
    /// Greatest distance seen, up to the limit.
    seen: f64,
    limit: f64,
    /// Something farther away than the limit that was seen, and how far.
    strayed: Option<(DVec3, f64)>,
    /// The triangle that is looked at.
    triangle: u32,
    /// Square of the greatest bound of a settled piece.
    proven: f64,
    /// The triangle that settled the last piece.
    hint: u32,
    waiting: Vec<Piece>,
    open: Vec<Open>,
}

impl<'a> Prover<'a> {
    fn new(from: &Mesh, to: &'a Surface, enough: f64, factor: f64) -> Self {
        let points: Vec<DVec3> = from.vertices.iter().map(|v| v.position - to.origin).collect();
        let reach = points.iter().fold(0.0f64, |most, p| most.max(p.length_squared())).sqrt();
        let margin = (reach.max(to.reach)) * MARGIN;
        Self {
            places: &[],
            near: vec![NONE; points.len()],
            known: vec![(NONE, 0.0); points.len()],
            points,
            to,
            margin,
            factor,
            // Less than rounding cannot be told from nothing.
            wanted: enough.max(margin),
            seen: 0.0,
            limit: f64::INFINITY,
            strayed: None,
            triangle: 0,
            proven: 0.0,
            hint: 0,
            waiting: Vec::new(),
            open: Vec::new(),
        }
    }

    fn bound(&self) -> Bound {
        Bound {
            upper: self.proven.sqrt().max(self.seen) + self.margin,
            lower: (self.seen - self.margin).max(0.0),
        }
    }

    fn piece(&self, triangle: [u32; 3]) -> Piece {
        let corners = triangle.map(|v| self.points[v as usize]);
        Piece { corners, near: triangle.map(|v| self.near[v as usize]), depth: 0 }
    }

    /// The distance from a point, and a triangle near it; exact where it is more than `enough`.
    /// `first` names one to begin with, if it is known.
    fn look(&mut self, p: DVec3, first: u32, enough: f64) -> (f64, u32) {
        let mut near = if first == NONE { self.hint } else { first };
        let distance = self.to.nearest2(p, enough * enough, &mut near).sqrt();
        if distance > self.limit {
            self.strayed = Some((p, distance));
        } else if distance > self.seen && distance > enough {
            self.seen = distance;
            self.wanted = self.wanted.max(distance * self.factor);
        }
        (distance, near)
    }

    /// The greatest squared distance of the corners to one triangle, if that is wanted.
    fn covered(&self, corners: &[DVec3; 3], by: u32, wanted: f64) -> Option<f64> {
        let triangle = &self.to.triangles[by as usize];
        let mut greatest = 0.0f64;
        for corner in corners {
            greatest = greatest.max(triangle.distance2(*corner));
            if greatest > wanted {
                return None;
            }
        }
        Some(greatest)
    }

    /// [`Prover::covered`] by the last triangle that settled something. Neighbours are mostly settled
    /// by the same one, and share corners.
    fn covered_again(&mut self, triangle: [u32; 3]) -> Option<f64> {
        let (by, wanted) = (self.hint, self.wanted * self.wanted);
        let mut greatest = 0.0f64;
        for v in triangle {
            let known = &mut self.known[v as usize];
            if known.0 != by {
                *known = (by, self.to.triangles[by as usize].distance2(self.points[v as usize]));
            }
            greatest = greatest.max(known.1);
            if greatest > wanted {
                return None;
            }
        }
        Some(greatest)
    }

    /// Settles a triangle, or leaves what it cannot settle in `open`; returns how often it cut.
    fn settle(&mut self, triangle: [u32; 3], most: usize) -> usize {
        if let Some(greatest) = self.covered_again(triangle) {
            self.proven = self.proven.max(greatest);
            return 0;
        }
        if self.share_a_side(triangle) {
            return 0;
        }
        for v in triangle {
            if self.near[v as usize] == NONE {
                let enough = self.wanted * NEAR_SHARE;
                let near = self.look(self.points[v as usize], NONE, enough).1;
                if self.strayed.is_some() {
                    return 0;
                }
                self.near[v as usize] = near;
            }
        }
        self.waiting.push(self.piece(triangle));
        let mut cuts = 0;
        while let Some(piece) = self.waiting.pop() {
            if self.strayed.is_some() {
                self.waiting.clear();
                return cuts;
            }
            if self.near_a_corner(&piece) {
                continue;
            }
            let may_cut = cuts < most && piece.depth < DEEPEST;
            if may_cut && let Some(parts) = self.clip_at_a_corner(&piece) {
                self.waiting.extend(parts);
                cuts += 1;
            } else if let Some(open) = self.near_its_middle(piece) {
                if self.seen > self.wanted {
                    // Only where nothing farther is wanted, and that is settled now.
                    self.waiting.clear();
                    self.open.push(open);
                } else if may_cut {
                    let parts = self.cut(&open);
                    self.waiting.extend(parts);
                    cuts += 1;
                } else {
                    self.open.push(open);
                }
            }
        }
        cuts
    }

    /// Whether a triangle settles this one that has two corners in common with it.
    fn share_a_side(&mut self, triangle: [u32; 3]) -> bool {
        if self.places.is_empty() {
            return false;
        }
        let (to, wanted) = (self.to, self.wanted * self.wanted);
        // The corner that is not shared comes first: it decides.
        let [p, q, r] = triangle.map(|v| self.points[v as usize]);
        let [a, b, c] = triangle.map(|v| self.places[v as usize]);
        let at_first = to.fans.sharing(a, [b, c]).map(|by| ([r, q, p], by));
        let beside = to.fans.sharing(b, [c, c]).map(|by| ([p, q, r], by));
        let found = at_first
            .chain(beside)
            .find_map(|(corners, by)| self.covered(&corners, by, wanted).map(|g| (by, g)));
        if let Some((by, greatest)) = found {
            (self.proven, self.hint) = (self.proven.max(greatest), by);
        }
        found.is_some()
    }

    /// Whether a triangle near a corner, or the last one that settled a piece, settles this one.
    fn near_a_corner(&mut self, piece: &Piece) -> bool {
        let wanted = self.wanted * self.wanted;
        let [x, y, z] = piece.near;
        for (k, by) in [x, y, z, self.hint].into_iter().enumerate() {
            if k > 0 && by == x || k > 1 && by == y || k > 2 && by == z {
                continue;
            }
            // The corner that it is near to comes last: others decide.
            let corners = [1, 2, 3].map(|next| piece.corners[(k + next) % 3]);
            if let Some(greatest) = self.covered(&corners, by, wanted) {
                (self.proven, self.hint) = (self.proven.max(greatest), by);
                return true;
            }
        }
        false
    }

    /// Nothing if the triangle near the piece's middle settles it, or the middle's distance does.
    fn near_its_middle(&mut self, piece: Piece) -> Option<Open> {
        let middle = piece.middle();
        let (distance, near) = self.look(middle, piece.near[0], self.wanted * NEAR_SHARE);
        let wanted = self.wanted * self.wanted;
        if let Some(greatest) = self.covered(&piece.corners, near, wanted) {
            (self.proven, self.hint) = (self.proven.max(greatest), near);
            return None;
        }
        let radius = piece.corners.iter().fold(0.0f64, |r, c| r.max(c.distance_squared(middle)));
        let mut upper = distance + radius.sqrt();
        if upper <= self.wanted {
            self.proven = self.proven.max(upper * upper);
            return None;
        }
        let [x, y, z] = piece.near;
        for by in [near, x, y, z] {
            if let Some(greatest) = self.covered(&piece.corners, by, upper * upper) {
                upper = upper.min(greatest.sqrt());
            }
        }
        Some(Open { upper, triangle: self.triangle, near, piece })
    }

    /// Cuts a piece along a side of a triangle that could settle the part over it; halves it if
    /// there is none.
    fn cut(&self, open: &Open) -> impl Iterator<Item = Piece> + use<> {
        let Open { piece, near, .. } = open;
        let clipped = self.clip(piece, *near).or_else(|| self.clip_at_a_corner(piece));
        let halves = clipped.is_none().then(|| piece.halves(*near));
        clipped.into_iter().flatten().chain(halves.into_iter().flatten())
    }

    /// Cuts a piece along a side of a triangle near a corner.
    fn clip_at_a_corner(&self, piece: &Piece) -> Option<[Piece; 3]> {
        let [x, y, z] = piece.near;
        self.clip(piece, x)
            .or_else(|| if y == x { None } else { self.clip(piece, y) })
            .or_else(|| if z == x || z == y { None } else { self.clip(piece, z) })
    }

    /// Cuts a piece along that side of triangle `by` beyond which it reaches farthest.
    fn clip(&self, piece: &Piece, by: u32) -> Option<[Piece; 3]> {
        let triangle = &self.to.triangles[by as usize];
        if triangle.area == 0.0 {
            return None;
        }
        let found = piece.corners.map(|corner| triangle.coordinates(corner));
        if found.iter().any(|(_, off)| *off > self.wanted * self.wanted) {
            return None;
        }
        let [bb, bc, cc] = triangle.products;
        // Squared length of the side on which each coordinate is zero.
        let sides = [bb - 2.0 * bc + cc, cc, bb];
        // Both parts are to reach some way from the cut, or it would be made again and again.
        let least_reach = self.wanted * CUT_SHARE;
        let mut farthest = (least_reach * least_reach, None);
        for (k, side) in sides.into_iter().enumerate() {
            let values = found.map(|(coordinates, _)| coordinates[k]);
            let [out, within] =
                [values.into_iter().fold(0.0, f64::min), values.into_iter().fold(0.0, f64::max)]
                    .map(|v| v * v / (side * triangle.area).max(f64::MIN_POSITIVE));
            if out > farthest.0 && within > least_reach * least_reach {
                farthest = (out, Some(values));
            }
        }
        let values = farthest.1?;
        let alone = (0..3).find(|&k| {
            let others = [values[(k + 1) % 3], values[(k + 2) % 3]];
            values[k] > 0.0 && others.iter().all(|&v| v <= 0.0)
                || values[k] < 0.0 && others.iter().all(|&v| v >= 0.0)
        })?;
        let share = |to: usize| values[alone] / (values[alone] - values[to]);
        Some(piece.cut_corner(alone, [share((alone + 1) % 3), share((alone + 2) % 3)], by))
    }
}
