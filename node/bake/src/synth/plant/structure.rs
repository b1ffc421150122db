//! The building: slabs, columns, beams, walls, stairs.

use super::layout::*;
use crate::synth::Build;
use crate::synth::builder::Builder;
use glam::DVec3;

/// A rectangle of slab with holes, top at `y`, cut into the fewest cells of the holes' own grid.
pub(super) fn slab(y: f64, rect: Rect, holes: Vec<Rect>) -> Build {
    let holes: Vec<Rect> = holes.into_iter().filter(|h| h.overlaps(&rect)).collect();
    Box::new(move |b| {
        let cuts = |bounds: [f64; 2], edges: Vec<f64>| {
            let mut cuts: Vec<f64> =
                edges.into_iter().filter(|e| bounds[0] < *e && *e < bounds[1]).collect();
            cuts.extend(bounds);
            cuts.sort_by(f64::total_cmp);
            cuts.dedup();
            cuts
        };
        let xs = cuts(rect.x, holes.iter().flat_map(|h| h.x).collect());
        let zs = cuts(rect.z, holes.iter().flat_map(|h| h.z).collect());
        for x in xs.windows(2) {
            for z in zs.windows(2) {
                let cell = Rect { x: [x[0], x[1]], z: [z[0], z[1]] };
                if !holes.iter().any(|h| h.overlaps(&cell)) {
                    b.cuboid(DVec3::new(x[0], y - SLAB, z[0]), DVec3::new(x[1], y, z[1]));
                }
            }
        }
        // Kerbs round the holes keep feet and water from going over.
        for h in &holes {
            for (x, z) in [
                ([h.x[0] - 0.1, h.x[0]], [h.z[0] - 0.1, h.z[1] + 0.1]),
                ([h.x[1], h.x[1] + 0.1], [h.z[0] - 0.1, h.z[1] + 0.1]),
                ([h.x[0], h.x[1]], [h.z[0] - 0.1, h.z[0]]),
                ([h.x[0], h.x[1]], [h.z[1], h.z[1] + 0.1]),
            ] {
                if b.keep(0.3) {
                    b.cuboid(DVec3::new(x[0], y, z[0]), DVec3::new(x[1], y + 0.08, z[1]));
                }
            }
        }
    })
}

/// A bolt: hexagonal head on a plate, pointing along `axis`.
pub(super) fn bolt(b: &mut Builder, at: DVec3, axis: DVec3, radius: f64) {
    let sides = b.fine(8.0, 4);
    b.lathe(
        at,
        axis,
        &[(0.0, radius), (radius, radius), (1.2 * radius, 0.7 * radius), (1.2 * radius, 0.0)],
        sides,
    );
}

/// An H-section column through all storeys, with bolted splices at every floor.
pub(super) fn column(x: f64, z: f64) -> Build {
    Box::new(move |b| {
        let top = floor_y(FLOORS) - SLAB;
        let foot = DVec3::new(x, 0.0, z);
        for side in [-0.19, 0.19] {
            b.block(foot + DVec3::X * side, DVec3::new(0.02, top, 0.4));
        }
        b.block(foot, DVec3::new(0.36, top, 0.02));
        for floor in 0..FLOORS {
            let base = DVec3::new(x, floor_y(floor), z);
            if b.keep(0.2) {
                b.block(base, DVec3::new(0.6, 0.03, 0.6));
            }
            for k in 0..8 {
                if b.keep(0.9) {
                    let corner = DVec3::new(
                        if k % 2 == 0 { -0.26 } else { 0.26 },
                        0.03,
                        [-0.26, -0.09, 0.09, 0.26][k / 2],
                    );
                    bolt(b, base + corner, DVec3::Y, 0.025);
                }
            }
        }
    })
}

/// An I-section beam under the ceiling at `y`, along x, with stiffeners and bolts.
pub(super) fn beam(x: [f64; 2], y: f64, z: f64) -> Build {
    Box::new(move |b| {
        let piece = |b: &mut Builder, y: [f64; 2], half: f64| {
            b.cuboid(DVec3::new(x[0], y[0], z - half), DVec3::new(x[1], y[1], z + half));
        };
        piece(b, [y - 0.02, y], 0.15);
        piece(b, [y - 0.43, y - 0.02], 0.01);
        piece(b, [y - 0.45, y - 0.43], 0.15);
        let stiffeners = b.fine(16.0, 0);
        for k in 0..stiffeners {
            let at = x[0] + (x[1] - x[0]) * (f64::from(k) + 0.5) / f64::from(stiffeners);
            for side in [-1.0, 1.0] {
                b.block(DVec3::new(at, y - 0.43, z + side * 0.08), DVec3::new(0.02, 0.41, 0.13));
                if b.keep(0.8) {
                    bolt(b, DVec3::new(at + 0.1, y - 0.43, z + side * 0.08), DVec3::Y, 0.015);
                }
            }
        }
    })
}

/// An upright wall along x or z with doorways 2.4 m high.
#[derive(Debug, Clone)]
pub(super) struct Wall {
    /// Runs along x, or else along z.
    pub(super) along_x: bool,
    /// Coordinate of its middle plane.
    pub(super) plane: f64,
    /// From and to, along it.
    pub(super) span: [f64; 2],
    /// Floor it stands on.
    pub(super) floor: u32,
    /// Middles of the doorways, along it.
    pub(super) doors: Vec<f64>,
}

/// A doorway's width and height.
const DOOR: [f64; 2] = [1.8, 2.4];

impl Wall {
    fn piece(&self, b: &mut Builder, span: [f64; 2], y: [f64; 2], depth: [f64; 2]) {
        let base = floor_y(self.floor);
        let (p, q) = (self.plane + depth[0], self.plane + depth[1]);
        let corner = |along: f64, across: f64, up: f64| {
            let (x, z) = if self.along_x { (along, across) } else { (across, along) };
            DVec3::new(x, base + up, z)
        };
        b.cuboid(corner(span[0], p, y[0]), corner(span[1], q, y[1]));
    }

    /// Wall, door frames, and a skirting and coving that more detail divides into panels.
    pub(super) fn build(self) -> Build {
        Box::new(move |b| {
            let (half, height) = (0.5 * WALL, STOREY - SLAB);
            let mut from = self.span[0];
            for &door in &self.doors {
                let hole = [door - 0.5 * DOOR[0], door + 0.5 * DOOR[0]];
                self.piece(b, [from, hole[0]], [0.0, height], [-half, half]);
                self.piece(b, hole, [DOOR[1], height], [-half, half]);
                for edge in hole {
                    let frame = [edge - 0.04, edge + 0.04];
                    self.piece(b, frame, [0.0, DOOR[1]], [-half - 0.03, half + 0.03]);
                }
                from = hole[1];
            }
            self.piece(b, [from, self.span[1]], [0.0, height], [-half, half]);
            let panels = b.fine(40.0, 0);
            for k in 0..panels {
                let at = |t: f64| self.span[0] + (self.span[1] - self.span[0]) * t;
                let n = f64::from(panels);
                let span = [at((f64::from(k) + 0.1) / n), at((f64::from(k) + 0.9) / n)];
                for depth in [[-half - 0.02, -half], [half, half + 0.02]] {
                    self.piece(b, span, [3.0, 5.0], depth);
                }
            }
        })
    }
}

/// Outer cladding on an inner wall: ribs of trapezoid sheet.
pub(super) fn cladding(along_x: bool, plane: f64, span: [f64; 2], floor: u32) -> Build {
    let wall = Wall { along_x, plane, span, floor, doors: Vec::new() };
    let outward = if plane <= 0.0 { -1.0 } else { 1.0 };
    Box::new(move |b| {
        wall.piece(b, span, [-SLAB, STOREY - SLAB], [-0.1, 0.1]);
        let ribs = b.fine(60.0, 0);
        for k in 0..ribs {
            let at = |t: f64| span[0] + (span[1] - span[0]) * (f64::from(k) + t) / f64::from(ribs);
            let (near, far): (f64, f64) = (outward * 0.1, outward * 0.16);
            wall.piece(
                b,
                [at(0.2), at(0.7)],
                [-SLAB, STOREY - SLAB],
                [near.min(far), near.max(far)],
            );
        }
    })
}

/// Steps of one of a stair's two flights.
const STEPS: u32 = 16;
const FLIGHT: [f64; 2] = [1.8, 6.0];

/// Two flights and a landing in `well`, from `floor` to the next.
pub(super) fn stair(well: Rect, floor: u32) -> Build {
    Box::new(move |b| {
        let y0 = floor_y(floor);
        let x0 = well.x[0] - 0.4;
        let going = (FLIGHT[1] - FLIGHT[0]) / f64::from(STEPS);
        let rise = 0.5 * STOREY / f64::from(STEPS);
        for flight in 0..2 {
            let z = [well.z[0] + 0.1 + 1.6 * f64::from(flight), 0.0];
            let z = [z[0], z[0] + 1.4];
            for step in 0..STEPS {
                // The first flight climbs towards -x, the second back.
                let back = if flight == 0 { STEPS - 1 - step } else { step };
                let x = x0 + FLIGHT[0] + going * f64::from(back);
                let y = y0 + 0.5 * STOREY * f64::from(flight) + rise * f64::from(step + 1);
                let bars = b.fine(14.0, 1);
                for k in 0..bars {
                    let w = 1.4 / f64::from(bars);
                    let zk = z[0] + w * f64::from(k);
                    let gap = if bars > 1 { 0.3 * w } else { 0.0 };
                    b.cuboid(DVec3::new(x, y - 0.04, zk), DVec3::new(x + going, y, zk + w - gap));
                }
            }
        }
        let y = y0 + 0.5 * STOREY;
        b.cuboid(
            DVec3::new(x0 + 0.4, y - 0.08, well.z[0] + 0.1),
            DVec3::new(x0 + FLIGHT[0], y, well.z[1] - 0.1),
        );
    })
}

/// A railing of posts and three rails through `path`, 1.1 m high.
pub(super) fn railing(b: &mut Builder, path: &[DVec3]) {
    for pair in path.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let length = (to - from).length();
        for (height, radius) in [(1.1, 0.025), (0.75, 0.015), (0.4, 0.015)] {
            let (sides, rows) = (b.fine(10.0, 3), b.fine(2.0 * length, 1));
            let up = DVec3::Y * height;
            b.tube(from + up, to + up, radius, sides, rows, false);
        }
        let posts = b.fine(length, 1);
        for k in 0..=posts {
            let at = from.lerp(to, f64::from(k) / f64::from(posts));
            let sides = b.fine(10.0, 3);
            b.tube(at, at + DVec3::Y * 1.1, 0.02, sides, 1, false);
        }
    }
}

/// Handrails of a stair.
pub(super) fn stair_rails(well: Rect, floor: u32) -> Build {
    Box::new(move |b| {
        let (x0, y0) = (well.x[0] - 0.4, floor_y(floor));
        for (z, y) in [(well.z[0] + 1.5, [y0 + 3.0, y0]), (well.z[0] + 1.7, [y0 + 3.0, y0 + 6.0])] {
            railing(b, &[DVec3::new(x0 + FLIGHT[0], y[0], z), DVec3::new(x0 + FLIGHT[1], y[1], z)]);
        }
        let (z0, z1) = (well.z[0] + 0.1, well.z[1] - 0.1);
        railing(b, &[DVec3::new(x0 + 0.45, y0 + 3.0, z0), DVec3::new(x0 + 0.45, y0 + 3.0, z1)]);
    })
}

/// Railing round a shaft on a floor.
pub(super) fn shaft_rails(shaft: Rect, floor: u32) -> Build {
    Box::new(move |b| {
        let y = floor_y(floor);
        let (x, z) = ([shaft.x[0] - 0.1, shaft.x[1] + 0.1], [shaft.z[0] - 0.1, shaft.z[1] + 0.1]);
        let at = |i: usize, k: usize| DVec3::new(x[i], y, z[k]);
        railing(b, &[at(0, 0), at(1, 0), at(1, 1), at(0, 1), at(0, 0)]);
    })
}
