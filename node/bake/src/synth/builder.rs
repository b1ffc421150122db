//! Solid primitives, tessellated as finely as a detail factor asks, or only counted.
//!
//! A scene is laid out once; only the detail factor changes with the number of triangles asked for.
//! Counting runs the very code that builds, so that the count is exact.

use super::random::Random;
use glam::DVec3;

/// Sine and cosine of an angle in turns, with `+ - *` alone: the same bits on every machine.
pub(super) fn sin_cos_turns(turns: f64) -> (f64, f64) {
    let turns = turns - turns.floor();
    let quarter = (turns * 4.0).round();
    // Taylor series on [-pi/4, pi/4]: the first term left out is below 1e-14.
    let x = (turns - quarter * 0.25) * std::f64::consts::TAU;
    let q = x * x;
    // sum of q^n / ((2n+1)!) and q^n / ((2n)!) with alternating signs, by Horner's rule.
    let series = |divisors: [f64; 7]| divisors.iter().rev().fold(1.0, |sum, d| 1.0 - q / d * sum);
    let sin = x * series([6.0, 20.0, 42.0, 72.0, 110.0, 156.0, 210.0]);
    let cos = series([2.0, 12.0, 30.0, 56.0, 90.0, 132.0, 182.0]);
    match quarter as u32 % 4 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// Vertices and triangles of one mesh.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Surface {
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) normals: Vec<[f32; 3]>,
    pub(super) indices: Vec<u32>,
}

/// Adds primitives to one object.
pub(super) struct Builder {
    detail: f64,
    phases: Random,
    triangles: u64,
    surface: Option<Surface>,
}

/// Two unit vectors that make a right-handed frame with the unit vector `axis` as third.
pub(super) fn frame(axis: DVec3) -> (DVec3, DVec3) {
    let a = axis.abs();
    let helper = if a.x <= a.y && a.x <= a.z {
        DVec3::X
    } else if a.y <= a.z {
        DVec3::Y
    } else {
        DVec3::Z
    };
    let u = helper.cross(axis).normalize();
    (u, axis.cross(u))
}

/// Directions of a ring's corners around the unit vector `axis`, right-handed.
fn circle(axis: DVec3, sides: u32) -> Vec<DVec3> {
    let (u, v) = frame(axis);
    let corner = |side| {
        let (sin, cos) = sin_cos_turns(f64::from(side) / f64::from(sides));
        u * cos + v * sin
    };
    (0..sides).map(corner).collect()
}

impl Builder {
    /// Only counts.
    pub(super) fn counting(detail: f64, seed: u64) -> Self {
        Self { detail, phases: Random::new(seed), triangles: 0, surface: None }
    }

    /// Builds.
    pub(super) fn meshing(detail: f64, seed: u64) -> Self {
        Self { surface: Some(Surface::default()), ..Self::counting(detail, seed) }
    }

    pub(super) fn triangles(&self) -> u64 {
        self.triangles
    }

    pub(super) fn finish(self) -> Surface {
        let surface = self.surface.unwrap_or_default();
        assert_eq!(surface.indices.len() as u64, 3 * self.triangles, "count and mesh must agree");
        surface
    }

    /// A number of subdivisions: `nominal` at full detail, in proportion otherwise, at least `least`.
    ///
    /// Every call rounds at another point, so that the sum over a scene grows evenly with the detail.
    pub(super) fn fine(&mut self, nominal: f64, least: u32) -> u32 {
        let phase = self.phases.unit();
        ((nominal * self.detail + phase).floor() as u32).max(least)
    }

    /// Whether a small part is there at all: always from `detail` on, with less detail ever more seldom.
    pub(super) fn keep(&mut self, detail: f64) -> bool {
        self.phases.unit() * detail < self.detail
    }

    /// A part that [`Builder::keep`] decides on and that rounds by itself: whether it is there changes
    /// nothing in the parts that follow.
    pub(super) fn optional(&mut self, detail: f64, build: impl FnOnce(&mut Self)) {
        let own = Random::new(self.phases.bits());
        if self.keep(detail) {
            let others = std::mem::replace(&mut self.phases, own);
            build(self);
            self.phases = others;
        }
    }

    /// Rows of closed rings: `vertex(row, side)` gives position and normal; counter-clockwise from
    /// outside when sides turn right-handed around the direction of growing rows.
    pub(super) fn rings(
        &mut self,
        rows: u32,
        sides: u32,
        mut vertex: impl FnMut(u32, u32) -> (DVec3, DVec3),
    ) {
        debug_assert!(rows >= 2 && sides >= 3);
        self.triangles += 2 * u64::from(rows - 1) * u64::from(sides);
        let Some(surface) = &mut self.surface else { return };
        let first = surface.positions.len() as u32;
        for row in 0..rows {
            for side in 0..sides {
                let (position, normal) = vertex(row, side);
                surface.positions.push(position.as_vec3().to_array());
                surface.normals.push(normal.normalize().as_vec3().to_array());
            }
        }
        for row in 0..rows - 1 {
            for side in 0..sides {
                let next = (side + 1) % sides;
                let (a, b) = (first + row * sides + side, first + row * sides + next);
                surface.indices.extend([a, b, b + sides, a, b + sides, a + sides]);
            }
        }
    }

    /// A flat convex polygon, corners counter-clockwise around `normal`.
    pub(super) fn polygon(&mut self, corners: &[DVec3], normal: DVec3) {
        self.triangles += corners.len() as u64 - 2;
        let Some(surface) = &mut self.surface else { return };
        let first = surface.positions.len() as u32;
        let normal = normal.normalize().as_vec3().to_array();
        for corner in corners {
            surface.positions.push(corner.as_vec3().to_array());
            surface.normals.push(normal);
        }
        for k in 1..corners.len() as u32 - 1 {
            surface.indices.extend([first, first + k, first + k + 1]);
        }
    }

    /// An axis-aligned box.
    pub(super) fn cuboid(&mut self, min: DVec3, max: DVec3) {
        debug_assert!(min.cmplt(max).all(), "{min} {max}");
        if self.surface.is_none() {
            self.triangles += 12;
            return;
        }
        for axis in 0..3 {
            let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
            for outer in [false, true] {
                let at = |pi: bool, pj: bool| {
                    let mut p = min;
                    p[axis] = if outer { max[axis] } else { min[axis] };
                    p[i] = if pi { max[i] } else { min[i] };
                    p[j] = if pj { max[j] } else { min[j] };
                    p
                };
                let mut corners =
                    [at(false, false), at(true, false), at(true, true), at(false, true)];
                let mut normal = DVec3::ZERO;
                normal[axis] = if outer { 1.0 } else { -1.0 };
                if !outer {
                    corners.reverse();
                }
                self.polygon(&corners, normal);
            }
        }
    }

    /// A box by the middle of its bottom and its size.
    pub(super) fn block(&mut self, foot: DVec3, size: DVec3) {
        let half = DVec3::new(size.x * 0.5, 0.0, size.z * 0.5);
        self.cuboid(foot - half, foot + half + DVec3::Y * size.y);
    }

    /// A cylinder from `a` to `b`, with `rows` rings of quads, closed by discs if `capped`.
    pub(super) fn tube(
        &mut self,
        a: DVec3,
        b: DVec3,
        radius: f64,
        sides: u32,
        rows: u32,
        capped: bool,
    ) {
        if self.surface.is_none() {
            let ends = if capped { 2 * (sides - 2) } else { 0 };
            self.triangles += u64::from(2 * sides * rows + ends);
            return;
        }
        let axis = (b - a).normalize();
        let directions = circle(axis, sides);
        self.rings(rows + 1, sides, |row, side| {
            let n = directions[side as usize];
            (a.lerp(b, f64::from(row) / f64::from(rows)) + n * radius, n)
        });
        if capped {
            let end: Vec<DVec3> = directions.iter().map(|&n| b + n * radius).collect();
            self.polygon(&end, axis);
            let start: Vec<DVec3> = directions.iter().rev().map(|&n| a + n * radius).collect();
            self.polygon(&start, -axis);
        }
    }

    /// A quarter of a torus that leads from direction `from` into the perpendicular `to`; it starts
    /// at `start` and turns with radius `turn`.
    #[expect(clippy::too_many_arguments, reason = "a bend has this many degrees of freedom")]
    pub(super) fn bend(
        &mut self,
        start: DVec3,
        from: DVec3,
        to: DVec3,
        turn: f64,
        radius: f64,
        sides: u32,
        rows: u32,
    ) {
        if self.surface.is_none() {
            self.triangles += u64::from(2 * sides * rows);
            return;
        }
        let center = start + to * turn;
        let side_axis = from.cross(to);
        let circle: Vec<(f64, f64)> =
            (0..sides).map(|s| sin_cos_turns(f64::from(s) / f64::from(sides))).collect();
        self.rings(rows + 1, sides, |row, side| {
            let (sin, cos) = sin_cos_turns(0.25 * f64::from(row) / f64::from(rows));
            let outward = from * sin - to * cos;
            let (s, c) = circle[side as usize];
            // side_axis x outward points along the pipe, as `rings` wants it.
            let n = outward * c - side_axis * s;
            (center + outward * turn + n * radius, n)
        });
    }

    /// A solid of revolution: `profile` holds (height along `axis`, radius), heights not falling, with
    /// sharp edges between the bands; it is open where it does not end at radius 0.
    pub(super) fn lathe(&mut self, foot: DVec3, axis: DVec3, profile: &[(f64, f64)], sides: u32) {
        if self.surface.is_none() {
            let bands = profile.windows(2).map(|band| {
                let pointed = band[0].1 == 0.0 || band[1].1 == 0.0;
                match (pointed, band[0].0 == band[1].0) {
                    (true, true) => sides - 2,
                    (true, false) => sides,
                    (false, _) => 2 * sides,
                }
            });
            self.triangles += u64::from(bands.sum::<u32>());
            return;
        }
        let circle = circle(axis, sides);
        for band in profile.windows(2) {
            let [(h0, r0), (h1, r1)] = [band[0], band[1]];
            let (rise, run) = (h1 - h0, r1 - r0);
            if rise == 0.0 && (r0 == 0.0 || r1 == 0.0) {
                let (r, up) = if r1 == 0.0 { (r0, 1.0) } else { (r1, -1.0) };
                let mut disc: Vec<DVec3> =
                    circle.iter().map(|&d| foot + axis * h0 + d * r).collect();
                if up < 0.0 {
                    disc.reverse();
                }
                self.polygon(&disc, axis * up);
            } else if r0 == 0.0 || r1 == 0.0 {
                // A cone: one triangle a side.
                for s in 0..sides as usize {
                    let (d0, d1) = (circle[s], circle[(s + 1) % sides as usize]);
                    let normal = (d0 + d1).normalize() * rise - axis * run;
                    let (low, high) = (foot + axis * h0, foot + axis * h1);
                    if r1 == 0.0 {
                        self.polygon(&[low + d0 * r0, low + d1 * r0, high], normal);
                    } else {
                        self.polygon(&[low, high + d1 * r1, high + d0 * r1], normal);
                    }
                }
            } else {
                self.rings(2, sides, |row, side| {
                    let d = circle[side as usize];
                    let (h, r) = if row == 0 { (h0, r0) } else { (h1, r1) };
                    (foot + axis * h + d * r, d * rise - axis * run)
                });
            }
        }
    }

    /// A torus around `axis`.
    pub(super) fn torus(
        &mut self,
        center: DVec3,
        axis: DVec3,
        ring: f64,
        radius: f64,
        segments: u32,
        sides: u32,
    ) {
        let (u, v) = frame(axis);
        self.rings(segments + 1, sides, |row, side| {
            let (sin, cos) = sin_cos_turns(f64::from(row % segments) / f64::from(segments));
            let (s, c) = sin_cos_turns(f64::from(side) / f64::from(sides));
            let outward = u * cos + v * sin;
            let n = outward * c - axis * s;
            (center + outward * ring + n * radius, n)
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Volume by the divergence theorem: positive only if all faces wind outwards.
    fn volume(s: &Surface) -> f64 {
        let p = |i: u32| DVec3::from(s.positions[i as usize].map(f64::from));
        s.indices.chunks(3).map(|t| p(t[0]).dot(p(t[1]).cross(p(t[2]))) / 6.0).sum()
    }

    /// Every face's winding agrees with its vertices' normals.
    fn assert_consistent(s: &Surface) {
        let p = |i: u32| DVec3::from(s.positions[i as usize].map(f64::from));
        let n = |i: u32| DVec3::from(s.normals[i as usize].map(f64::from));
        for t in s.indices.chunks(3) {
            let face = (p(t[1]) - p(t[0])).cross(p(t[2]) - p(t[0]));
            assert!(face.length() > 0.0, "degenerate");
            for &i in t {
                assert!((n(i).length() - 1.0).abs() < 1e-5);
                assert!(face.dot(n(i)) > 0.0, "turned");
            }
        }
    }

    #[test]
    fn circle_agrees_with_the_library() {
        for k in -50..150 {
            let t = f64::from(k) / 37.0;
            let (sin, cos) = sin_cos_turns(t);
            let x = t * std::f64::consts::TAU;
            assert!((sin - x.sin()).abs() < 1e-12 && (cos - x.cos()).abs() < 1e-12, "{t}");
        }
    }

    #[test]
    fn primitives_are_closed_outwards_and_counted() {
        type Build = fn(&mut Builder);
        let cases: [(Build, f64, u64); 5] = [
            (|b| b.cuboid(DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0)), 6.0, 12),
            (
                |b| b.tube(DVec3::X, DVec3::X * 3.0, 1.0, 64, 2, true),
                std::f64::consts::TAU,
                2 * 2 * 64 + 2 * 62,
            ),
            (
                |b| {
                    let profile = [(0.0, 0.0), (0.0, 1.0), (2.0, 1.0), (3.0, 0.0)];
                    b.lathe(DVec3::ONE, DVec3::Y, &profile, 64);
                },
                7.33,
                62 + 128 + 64,
            ),
            (
                |b| b.lathe(DVec3::ONE, DVec3::Z, &[(0.0, 0.0), (1.0, 1.0), (1.0, 0.0)], 64),
                1.047,
                64 + 62,
            ),
            (|b| b.torus(DVec3::ONE, DVec3::Z, 2.0, 0.5, 48, 24), 9.87, 2 * 48 * 24),
        ];
        for (build, expected, triangles) in cases {
            let mut counter = Builder::counting(1.0, 0);
            build(&mut counter);
            assert_eq!(counter.triangles(), triangles);
            let mut mesher = Builder::meshing(1.0, 0);
            build(&mut mesher);
            let surface = mesher.finish();
            assert_eq!(surface.indices.len() as u64, 3 * triangles);
            assert_consistent(&surface);
            let v = volume(&surface);
            assert!((v - expected).abs() < 0.02 * expected, "{v} for {expected}");
        }
    }

    #[test]
    fn a_bend_joins_its_two_directions() {
        let mut b = Builder::meshing(1.0, 0);
        b.bend(DVec3::ZERO, DVec3::X, DVec3::Y, 1.0, 0.2, 8, 4);
        let s = b.finish();
        assert_consistent(&s);
        let last = &s.positions[32..];
        assert!(last.iter().all(|p| (p[1] - 1.0).abs() < 1e-6 && (p[0] - 1.0).abs() < 0.2001));
    }
}
