//! What hangs from ceilings and walls: ducts, cable trays, lamps.

use super::layout::*;
use super::structure::bolt;
use crate::synth::Build;
use crate::synth::builder::Builder;
use glam::DVec3;

/// A point by its distance along a service and across it.
fn at(along_x: bool, along: f64, y: f64, across: f64) -> DVec3 {
    if along_x { DVec3::new(along, y, across) } else { DVec3::new(across, y, along) }
}

/// A straight rectangular duct with bolted flanges, ribs and outlets; `y` is its underside.
pub(super) fn duct(along_x: bool, span: [f64; 2], y: f64, across: f64, width: f64) -> Build {
    Box::new(move |b| {
        let (half, height) = (0.5 * width, 0.6 * width);
        let piece = |b: &mut Builder, s: [f64; 2], grow: f64| {
            b.cuboid(
                at(along_x, s[0], y - grow, across - half - grow),
                at(along_x, s[1], y + height + grow, across + half + grow),
            );
        };
        piece(b, span, 0.0);
        let joints = ((span[1] - span[0]) / 1.5) as u32;
        let forward = at(along_x, 1.0, 0.0, 0.0);
        for k in 1..joints {
            let s = span[0] + (span[1] - span[0]) * f64::from(k) / f64::from(joints);
            if !b.keep(0.25) {
                continue;
            }
            piece(b, [s - 0.02, s + 0.02], 0.05);
            let bolts = b.fine(12.0, 0);
            for j in 0..bolts {
                let t = (f64::from(j) + 0.5) / f64::from(bolts);
                let c = across - half + width * t;
                bolt(b, at(along_x, s + 0.02, y - 0.025, c), forward, 0.012);
                bolt(b, at(along_x, s + 0.02, y + height + 0.025, c), forward, 0.012);
            }
            // An outlet with vanes, below.
            let s = s - 0.75;
            let vanes = b.fine(10.0, 1);
            for j in 0..vanes {
                let v = s - 0.2 + 0.4 * f64::from(j) / f64::from(vanes);
                b.cuboid(
                    at(along_x, v, y - 0.06, across - 0.3 * width),
                    at(along_x, v + 0.2 / f64::from(vanes), y - 0.001, across + 0.3 * width),
                );
            }
        }
    })
}

/// A ladder tray with cables, `y` its underside, on brackets.
pub(super) fn cable_tray(along_x: bool, span: [f64; 2], y: f64, across: f64) -> Build {
    Box::new(move |b| {
        let width = 0.4;
        for side in [-0.5 * width, 0.5 * width] {
            b.cuboid(
                at(along_x, span[0], y, across + side - 0.01),
                at(along_x, span[1], y + 0.1, across + side + 0.01),
            );
        }
        let length = span[1] - span[0];
        let rungs = b.fine(length / 0.25, 2);
        for k in 0..rungs {
            let s = span[0] + length * (f64::from(k) + 0.5) / f64::from(rungs);
            b.cuboid(
                at(along_x, s - 0.015, y, across - 0.5 * width),
                at(along_x, s + 0.015, y + 0.02, across + 0.5 * width),
            );
        }
        let cables = b.fine(9.0, 1);
        for k in 0..cables {
            let c = across - 0.5 * width + width * (f64::from(k) + 0.5) / f64::from(cables);
            let radius = (0.3 * width / f64::from(cables)).min(0.02);
            let (sides, rows) = (b.fine(8.0, 3), b.fine(1.5 * length, 1));
            let lift = y + 0.02 + radius;
            b.tube(
                at(along_x, span[0], lift, c),
                at(along_x, span[1], lift, c),
                radius,
                sides,
                rows,
                true,
            );
        }
    })
}

/// A lamp below the ceiling, on two rods.
pub(super) fn lamp(hook: DVec3) -> Build {
    Box::new(move |b| {
        let y = hook.y - 1.2;
        b.block(DVec3::new(hook.x, y, hook.z), DVec3::new(1.5, 0.08, 0.25));
        for side in [-0.6, 0.6] {
            let sides = b.fine(8.0, 3);
            let foot = DVec3::new(hook.x + side, y + 0.08, hook.z);
            b.tube(foot, DVec3::new(foot.x, hook.y, foot.z), 0.008, sides, 1, false);
        }
        for side in [-0.07, 0.07] {
            let (sides, rows) = (b.fine(16.0, 3), b.fine(12.0, 1));
            let a = DVec3::new(hook.x - 0.7, y - 0.03, hook.z + side);
            b.tube(a, a + DVec3::X * 1.4, 0.02, sides, rows, true);
        }
    })
}

/// Places for lamps: over the corridor and the free strips and aisles of the rooms, floor by floor.
pub(super) fn lamp_hooks() -> Vec<DVec3> {
    let mut hooks = Vec::new();
    for (x, z) in [(4.0, 18.8), (12.0, 18.8), (8.0, 9.0), (4.0, 4.6), (12.0, 13.4), (12.0, 4.6)] {
        for room in Room::all() {
            hooks.push(DVec3::new(room.x0() + x, floor_y(room.floor + 1) - SLAB, room.z(z)));
        }
    }
    hooks
}
