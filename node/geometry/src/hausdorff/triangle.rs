//! Distances from a point to one triangle.

use glam::DVec3;

/// Squared height over squared length below which a triangle is measured as its edges.
const NEEDLE: f64 = 1e-20;

/// Likewise, squared height over squared length below which products of products are not exact enough.
const SLIM: f64 = 1e-4;

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
    pub(super) fn new([a, b, c]: [DVec3; 3]) -> Self {
        let (ab, ac) = (b - a, c - a);
        let products @ [bb, bc, cc] = [ab.length_squared(), ab.dot(ac), ac.length_squared()];
        let area = ab.cross(ac).length_squared();
        let longest = bb.max(cc).max(bb - 2.0 * bc + cc);
        let wide = area > NEEDLE * longest * longest;
        Self { a, ab, ac, products, area: if wide { area } else { 0.0 } }
    }

    pub(super) fn corners(&self) -> [DVec3; 3] {
        [self.a, self.a + self.ab, self.a + self.ac]
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

    /// [`Self::distance2`] that is off by roundings of the lengths alone, however slim the triangle: products of
    /// products cancel where it is, and the foot it finds is then another point of the triangle, too far away.
    pub(super) fn exact_distance2(&self, p: DVec3) -> f64 {
        let [bb, bc, cc] = self.products;
        let longest = bb.max(cc).max(bb - 2.0 * bc + cc);
        if self.area > SLIM * longest * longest {
            return self.distance2(p);
        }
        let edges = self.edges_distance2(p - self.a);
        self.plane_distance2(p).map_or(edges, |inside| inside.min(edges))
    }

    /// Squared distance from the plane, of a point that lies above or below the triangle: measured along its
    /// longest edge and its height over that.
    fn plane_distance2(&self, p: DVec3) -> Option<f64> {
        let corners = self.corners();
        let length2 = |k: usize| (corners[(k + 1) % 3] - corners[k]).length_squared();
        let first = (0..3).max_by(|&i, &j| length2(i).total_cmp(&length2(j)))?;
        let [from, to, top] = [0, 1, 2].map(|k| corners[(first + k) % 3]);
        let (base, side, ap) = (to - from, top - from, p - from);
        let length = base.length();
        let along = base / length;
        let foot = side.dot(along);
        let up = side - along * foot;
        let height = up.length();
        let up = up / height;
        let (x, y) = (ap.dot(along), ap.dot(up));
        let share = y / height;
        let within = foot * share..=length + (foot - length) * share;
        // Also false where there is no height.
        let inside = (0.0..=1.0).contains(&share) && within.contains(&x);
        inside.then(|| (ap - along * x - up * y).length_squared())
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
