//! What stands in the slots: tanks, pumps, cabinets, platforms; and the boilers in their shafts.
//!
//! Everything keeps within a slot (see `layout::SLOT_HALF`).

use super::layout::*;
use super::structure::{bolt, railing};
use crate::synth::Build;
use crate::synth::builder::{Builder, sin_cos_turns};
use crate::synth::random::Random;
use glam::DVec3;

/// An upright vessel with dished ends on legs, a manhole and stiffening rings.
pub(super) fn tank(foot: DVec3, random: &mut Random) -> Build {
    let (radius, height) = (random.between(0.6, 0.95), random.between(1.8, 3.2));
    Box::new(move |b| {
        let base = foot + DVec3::Y * 0.5;
        let (sides, rings) = (b.fine(64.0, 5), b.fine(24.0, 1));
        b.tube(base, base + DVec3::Y * height, radius, sides, rings, false);
        // Dished ends of a quarter of the radius.
        let rows = b.fine(8.0, 1);
        let dish = |up: f64| -> Vec<(f64, f64)> {
            let mut profile: Vec<(f64, f64)> = (0..=rows)
                .map(|k| {
                    let (sin, cos) = sin_cos_turns(0.25 * f64::from(k) / f64::from(rows));
                    (0.25 * radius * sin, if k == rows { 0.0 } else { radius * cos })
                })
                .collect();
            if up < 0.0 {
                profile.reverse();
                profile.iter_mut().for_each(|p| p.0 = -p.0);
            }
            profile
        };
        b.lathe(base + DVec3::Y * height, DVec3::Y, &dish(1.0), sides);
        b.lathe(base, DVec3::Y, &dish(-1.0), sides);
        for k in 0..4 {
            let (sin, cos) = sin_cos_turns(0.125 + 0.25 * f64::from(k));
            let leg = foot + DVec3::new(cos, 0.0, sin) * (0.8 * radius);
            b.block(leg, DVec3::new(0.12, 0.6, 0.12));
        }
        for k in 1..4 {
            if b.keep(0.3) {
                let (segments, tube) = (b.fine(64.0, 5), b.fine(10.0, 3));
                let at = base + DVec3::Y * (height * f64::from(k) / 4.0);
                b.torus(at, DVec3::Y, radius, 0.03, segments, tube);
            }
        }
        let sides = b.fine(32.0, 4);
        let hatch = base + DVec3::new(0.0, 0.4 * height, radius - 0.05);
        b.lathe(
            hatch,
            DVec3::Z,
            &[(0.0, 0.3), (0.2, 0.3), (0.2, 0.36), (0.26, 0.36), (0.26, 0.0)],
            sides,
        );
        for k in 0..16 {
            if b.keep(0.5) {
                let (sin, cos) = sin_cos_turns(f64::from(k) / 16.0);
                let rim = hatch + DVec3::new(cos * 0.33, sin * 0.33, 0.26);
                bolt(b, rim, DVec3::Z, 0.014);
            }
        }
    })
}

/// A pump and its finned motor on a plinth, shaft along z.
pub(super) fn pump(foot: DVec3, random: &mut Random) -> Build {
    let size = random.between(0.8, 1.15);
    Box::new(move |b| {
        b.block(foot, DVec3::new(1.1, 0.25, 2.3) * DVec3::new(size, 1.0, size));
        let axis = foot + DVec3::Y * (0.25 + 0.45 * size);
        let sides = b.fine(40.0, 5);
        let s = size;
        b.lathe(
            axis + DVec3::Z * -s,
            DVec3::Z,
            &[
                (0.0, 0.0),
                (0.0, 0.2 * s),
                (0.1 * s, 0.42 * s),
                (0.5 * s, 0.42 * s),
                (0.6 * s, 0.15 * s),
                (0.9 * s, 0.12 * s),
                (0.9 * s, 0.3 * s),
                (1.8 * s, 0.3 * s),
                (1.9 * s, 0.2 * s),
                (1.9 * s, 0.0),
            ],
            sides,
        );
        let fins = b.fine(28.0, 0);
        for k in 0..fins {
            let (segments, tube) = (b.fine(32.0, 5), 4);
            let at = axis + DVec3::Z * (s * (-0.08 + 0.86 * f64::from(k) / f64::from(fins)));
            b.torus(at, DVec3::Z, 0.32 * s, 0.02 * s, segments, tube);
        }
        // Outlet.
        let sides = b.fine(32.0, 4);
        b.lathe(
            axis + DVec3::new(0.0, 0.3 * s, -0.7 * s),
            DVec3::Y,
            &[(0.0, 0.16 * s), (0.5, 0.16 * s), (0.5, 0.26 * s), (0.56, 0.26 * s), (0.56, 0.0)],
            sides,
        );
        for k in 0..10 {
            let (sin, cos) = sin_cos_turns(f64::from(k) / 10.0);
            if b.keep(0.6) {
                let rim = DVec3::new(cos * 0.21 * s, 0.3 * s + 0.56, sin * 0.21 * s - 0.7 * s);
                bolt(b, axis + rim, DVec3::Y, 0.018);
            }
        }
    })
}

/// A row of control cabinets with louvres, handles and lamps, facing +x and -x.
pub(super) fn cabinets(foot: DVec3, random: &mut Random) -> Build {
    let (height, doors) = (random.between(1.9, 2.3), 3 + random.below(2));
    Box::new(move |b| {
        let (half_x, length) = (0.5, 2.5);
        b.block(foot, DVec3::new(2.0 * half_x, height, length));
        for door in 0..doors {
            let pitch = length / f64::from(doors);
            let z = foot.z - 0.5 * length + pitch * (f64::from(door) + 0.5);
            for side in [-1.0, 1.0] {
                let face = foot.x + side * half_x;
                let panel = |b: &mut Builder, y: [f64; 2], dz: [f64; 2], depth: f64| {
                    let far = face + side * depth;
                    b.cuboid(
                        DVec3::new(face.min(far), foot.y + y[0], z + dz[0]),
                        DVec3::new(face.max(far), foot.y + y[1], z + dz[1]),
                    );
                };
                if !b.keep(0.3) {
                    continue;
                }
                panel(b, [0.1, height - 0.1], [-0.45 * pitch, 0.45 * pitch], 0.02);
                panel(b, [0.9, 1.1], [0.34 * pitch, 0.38 * pitch], 0.06);
                let slats = b.fine(24.0, 0);
                for k in 0..slats {
                    let y = 0.2 + 0.5 * f64::from(k) / f64::from(slats);
                    panel(b, [y, y + 0.25 / f64::from(slats)], [-0.3 * pitch, 0.3 * pitch], 0.035);
                }
                for k in 0..12 {
                    if b.keep(0.8) {
                        let y = foot.y + 1.3 + 0.14 * f64::from(k / 3);
                        let dz = 0.12 * (f64::from(k % 3) - 1.0);
                        bolt(b, DVec3::new(face + side * 0.02, y, z + dz), DVec3::X * side, 0.02);
                    }
                }
            }
        }
    })
}

/// A raised platform of grating, 2.6 m up, on four posts, with railings.
pub(super) fn platform(foot: DVec3, _random: &mut Random) -> Build {
    Box::new(move |b| {
        let [hx, hz] = SLOT_HALF;
        let y = foot.y + 2.6;
        for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            let post = foot + DVec3::new(sx * (hx - 0.06), 0.0, sz * (hz - 0.06));
            b.block(post, DVec3::new(0.1, 2.6, 0.1));
        }
        grating(b, [foot.x - hx, foot.x + hx], y, [foot.z - hz, foot.z + hz]);
        let at = |x: f64, z: f64| DVec3::new(foot.x + x * (hx - 0.05), y, foot.z + z * (hz - 0.05));
        railing(b, &[at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0), at(-1.0, -1.0)]);
    })
}

/// Bearing bars along x, cross bars along z.
pub(super) fn grating(b: &mut Builder, x: [f64; 2], y: f64, z: [f64; 2]) {
    let bars = b.fine((z[1] - z[0]) / 0.03, 2);
    for k in 0..bars {
        let pitch = (z[1] - z[0]) / f64::from(bars);
        let at = z[0] + pitch * f64::from(k);
        b.cuboid(
            DVec3::new(x[0], y - 0.04, at),
            DVec3::new(x[1], y, at + (0.3 * pitch).max(0.005)),
        );
    }
    let cross = b.fine((x[1] - x[0]) / 0.1, 1);
    for k in 0..cross {
        let pitch = (x[1] - x[0]) / f64::from(cross);
        let at = x[0] + pitch * (f64::from(k) + 0.5);
        b.cuboid(DVec3::new(at, y - 0.02, z[0]), DVec3::new(at + 0.006, y - 0.002, z[1]));
    }
}

/// A boiler through all storeys: walls of upright tubes round a casing, with buckstays.
pub(super) fn boiler(shaft: Rect) -> Build {
    Box::new(move |b| {
        let (x, z) = ([shaft.x[0] + 0.7, shaft.x[1] - 0.7], [shaft.z[0] + 0.7, shaft.z[1] - 0.7]);
        let top = floor_y(FLOORS) - 1.5;
        b.cuboid(DVec3::new(x[0], 0.0, z[0]), DVec3::new(x[1], top, z[1]));
        let (tubes_x, tubes_z) = (44.0, 72.0);
        for (nominal, along_x) in [(tubes_x, true), (tubes_z, false)] {
            for far in [0, 1] {
                let count = b.fine(nominal, 2);
                for k in 0..count {
                    let t = (f64::from(k) + 0.5) / f64::from(count);
                    let foot = if along_x {
                        DVec3::new(x[0] + (x[1] - x[0]) * t, 0.5, z[far])
                    } else {
                        DVec3::new(x[far], 0.5, z[0] + (z[1] - z[0]) * t)
                    };
                    let (sides, rows) = (b.fine(12.0, 3), b.fine(28.0, 1));
                    b.tube(foot, foot + DVec3::Y * (top - 1.0), 0.045, sides, rows, false);
                }
            }
        }
        let stays = 12;
        for k in 1..stays {
            let y = top * f64::from(k) / f64::from(stays);
            for far in [0, 1] {
                let out = if far == 0 { -0.2 } else { 0.05 };
                b.cuboid(
                    DVec3::new(x[0] - 0.2, y, z[far] + out),
                    DVec3::new(x[1] + 0.2, y + 0.3, z[far] + out + 0.15),
                );
                b.cuboid(
                    DVec3::new(x[far] + out, y, z[0] - 0.2),
                    DVec3::new(x[far] + out + 0.15, y + 0.3, z[1] + 0.2),
                );
            }
        }
    })
}
