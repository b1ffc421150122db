//! Where the next sample may go: the places in a region that are as far from all samples as their
//! surroundings (paper 000, section 3.5.1).
//!
//! In a rectangle these are the vertices of the sites' Voronoi diagram that lie inside and the points where
//! its edges leave. In a box, likewise, its vertices (4 sites equally near), where its edges (3 sites)
//! leave through a face of the box, and where its faces (2 sites) cut the edges of the box. Fewer than two distinct
//! sites have no diagram: then the corners are what is far.
//!
//! Sites may coincide, lie in a line or on a circle, on the border or outside; what is not finite is left
//! out. Candidates are finite, inside, apart from each other and from the sites by more than [`APART`] of the
//! region's diagonal, and ordered by coordinates, whatever the order of the sites.

use glam::{DMat3, DVec2, DVec3};
use spade::handles::VoronoiVertex::{Inner, Outer};
use spade::{DelaunayTriangulation, Point2, Triangulation};

/// Points nearer to each other than this part of the region's diagonal are one.
pub const APART: f64 = 1e-6;
/// Rounding, in the same unit.
const ROUNDING: f64 = 1e-9;

/// Candidates in a rectangle.
pub fn in_rectangle(min: DVec2, max: DVec2, sites: &[DVec2]) -> Vec<DVec2> {
    let flat: Vec<DVec3> = sites.iter().map(|site| site.extend(0.0)).collect();
    let unit = Unit::new(min.extend(0.0), max.extend(0.0));
    let sites = unit.sites(&flat);
    let mut found = Vec::new();
    let mut diagram = DelaunayTriangulation::<Point2<f64>>::new();
    for site in &sites {
        let at = spade::mitigate_underflow(Point2::new(site.x, site.y));
        diagram.insert(at).expect("neither infinite nor too large or small");
    }
    let vector = |at: Point2<f64>| DVec2::new(at.x, at.y);
    found.extend(diagram.inner_faces().map(|face| vector(face.circumcenter()).extend(0.0)));
    for edge in diagram.undirected_edges() {
        // A Voronoi edge is a stretch of the bisector of two sites. Measured from the middle between
        // them it is exact where it is near, however far away its ends are.
        let [a, b] = edge.vertices().map(|vertex| vector(vertex.position()));
        let (middle, along) = (0.5 * (a + b), (b - a).perp().normalize_or_zero());
        let [mut low, mut high] = [f64::INFINITY, f64::NEG_INFINITY];
        for end in edge.as_directed().as_voronoi_edge().as_undirected().vertices() {
            let at = match end {
                Inner(face) => (vector(face.circumcenter()) - middle).dot(along),
                Outer(out) => f64::INFINITY * vector(out.direction_vector()).dot(along).signum(),
            };
            (low, high) = (low.min(at), high.max(at));
        }
        for (axis, border) in [(0, unit.min.x), (0, unit.max.x), (1, unit.min.y), (1, unit.max.y)] {
            let at = (border - middle[axis]) / along[axis];
            if at >= low - ROUNDING && at <= high + ROUNDING {
                found.push((middle + along * at).extend(0.0));
            }
        }
    }
    unit.finish(found, &sites).into_iter().map(DVec3::truncate).collect()
}

/// Candidates in a box; in a flat one, those of the rectangle. Takes time in the fifth power of the number
/// of sites: a region has tens of them.
pub fn in_box(min: DVec3, max: DVec3, sites: &[DVec3]) -> Vec<DVec3> {
    let unit = Unit::new(min, max);
    let sites = unit.sites(sites);
    let mut found = Vec::new();
    let borders: Vec<(DVec3, f64)> = (0..3)
        .flat_map(|axis| [(DVec3::AXES[axis], unit.min[axis]), (DVec3::AXES[axis], unit.max[axis])])
        .collect();
    for (first, site) in sites.iter().enumerate() {
        // A candidate lies on three planes: bisectors of this site and later ones, and faces of the box.
        let bisector = |other: &DVec3| {
            let normal = (other - site).normalize();
            (normal, normal.dot(0.5 * (other + site)))
        };
        let bisectors: Vec<_> = sites[first + 1..].iter().map(bisector).collect();
        let count = bisectors.len();
        let planes: Vec<_> = bisectors.into_iter().chain(borders.iter().copied()).collect();
        for a in 0..count {
            for (b, c) in
                (a + 1..planes.len()).flat_map(|b| (b + 1..planes.len()).map(move |c| (b, c)))
            {
                let Some(at) = meet([planes[a], planes[b], planes[c]]) else { continue };
                let radius = at.distance(*site);
                if sites.iter().all(|other| at.distance(*other) >= radius - ROUNDING) {
                    found.push(at);
                }
            }
        }
    }
    unit.finish(found, &sites)
}

/// Where three planes, given by unit normal and distance, meet; none if they hardly do.
fn meet(planes: [(DVec3, f64); 3]) -> Option<DVec3> {
    let rows = DMat3::from_cols(planes[0].0, planes[1].0, planes[2].0);
    let distances = DVec3::new(planes[0].1, planes[1].1, planes[2].1);
    (rows.determinant().abs() > ROUNDING).then(|| rows.transpose().inverse() * distances)
}

/// The region around 0, with a diagonal of 1.
struct Unit {
    middle: DVec3,
    scale: f64,
    min: DVec3,
    max: DVec3,
}

impl Unit {
    fn new(min: DVec3, max: DVec3) -> Self {
        let (middle, diagonal) = (0.5 * (min + max), (max - min).length());
        let scale = if diagonal > 0.0 { diagonal } else { 1.0 };
        Self { middle, scale, min: (min - middle) / scale, max: (max - middle) / scale }
    }

    /// Finite, distinct, and ordered.
    fn sites(&self, sites: &[DVec3]) -> Vec<DVec3> {
        let inside = sites.iter().map(|site| (site - self.middle) / self.scale);
        distinct(inside.filter(|site| site.is_finite() && site.abs().max_element() < 1e6).collect())
    }

    /// What is inside and at no site, back in the units of the region.
    fn finish(&self, mut found: Vec<DVec3>, sites: &[DVec3]) -> Vec<DVec3> {
        if sites.len() < 2 {
            found = (0..8)
                .map(|k| {
                    DVec3::select(
                        glam::BVec3::new(k & 1 != 0, k & 2 != 0, k & 4 != 0),
                        self.max,
                        self.min,
                    )
                })
                .collect();
        }
        let clamp = |at: DVec3| at.clamp(self.min, self.max);
        found.retain(|at| at.is_finite() && at.distance(clamp(*at)) <= ROUNDING);
        found.iter_mut().for_each(|at| *at = clamp(*at));
        found.retain(|at| sites.iter().all(|site| at.distance(*site) > APART));
        let found = distinct(found).into_iter();
        found.map(|at| self.middle + at * self.scale).collect()
    }
}

/// In the order of coordinates, without what is within [`APART`] of an earlier one.
fn distinct(mut points: Vec<DVec3>) -> Vec<DVec3> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z)));
    let mut kept: Vec<DVec3> = Vec::new();
    for point in points {
        if kept.iter().all(|known| known.distance(point) > APART) {
            kept.push(point);
        }
    }
    kept
}

#[cfg(test)]
mod tests;
