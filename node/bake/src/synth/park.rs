//! A statuary park: 956 distinct statues on a 2400 x 2000 ground (paper 003, section 5).
//!
//! Every statue stands on a plinth on its own paved plot; the plots together make the ground, so that
//! the number of objects is the number of statues.

use super::builder::{Builder, sin_cos_turns};
use super::random::Random;
use super::{Build, Group, Object, Plan, materials};
use glam::DVec3;

/// Statues.
pub(super) const STATUES: u32 = 956;
const GROUND: [f64; 2] = [2400.0, 2000.0];
const ROWS: u32 = 30;

const COLORS: [(&str, [f32; 3]); 5] = [
    ("marble", [0.74, 0.72, 0.68]),
    ("sandstone", [0.58, 0.44, 0.28]),
    ("bronze", [0.22, 0.30, 0.20]),
    ("granite", [0.30, 0.28, 0.30]),
    ("terracotta", [0.50, 0.22, 0.13]),
];

/// Lays the park out.
pub(super) fn plan(seed: u64) -> Plan {
    let mut objects = Vec::new();
    for row in 0..ROWS {
        // As even as whole numbers allow.
        let in_row = STATUES * (row + 1) / ROWS - STATUES * row / ROWS;
        let depth = GROUND[1] / f64::from(ROWS);
        let width = GROUND[0] / f64::from(in_row);
        for k in 0..in_row {
            let mut random = Random::stream(seed, objects.len() as u64);
            let corner = DVec3::new(
                f64::from(k) * width - 0.5 * GROUND[0],
                0.0,
                f64::from(row) * depth - 0.5 * GROUND[1],
            );
            objects.push(Object {
                name: format!("statue-{:03}", objects.len()),
                material: random.below(COLORS.len() as u32) as usize,
                build: statue(corner, [width, depth], &mut random),
                placements: Vec::new(),
            });
        }
    }
    Plan { materials: materials(&COLORS), groups: vec![Group { share: 1.0, objects }] }
}

/// One wave on a statue's surface.
#[derive(Debug, Clone, Copy)]
struct Wave {
    turns: f64,
    rises: f64,
    phase: f64,
    depth: f64,
}

/// A plot, a plinth, and a body whose radius along its height is a seeded curve with waves on it.
fn statue(corner: DVec3, plot: [f64; 2], random: &mut Random) -> Build {
    let middle = corner
        + DVec3::new(
            plot[0] * random.between(0.35, 0.65),
            0.0,
            plot[1] * random.between(0.35, 0.65),
        );
    let height = random.between(12.0, 34.0);
    let girth = height * random.between(0.12, 0.28);
    let profile: Vec<f64> = (0..7).map(|_| random.between(0.45, 1.0)).collect();
    let waves: Vec<Wave> = (0..6)
        .map(|i| Wave {
            turns: f64::from(1 + random.below(3 + 2 * i)),
            rises: random.between(-3.0, 3.0),
            phase: random.unit(),
            depth: random.between(0.03, 0.16) / f64::from(1 + i),
        })
        .collect();
    let radius = move |t: f64, turn: f64| {
        // Linear between the knots, drawn in to a point at both ends.
        let knot = (t * 6.0).min(5.999_999);
        let k = knot as usize;
        let body = profile[k] + (profile[k + 1] - profile[k]) * (knot - k as f64);
        let ends = (1.0 - (2.0 * t - 1.0).powi(6)).max(0.0).sqrt();
        let relief: f64 = waves
            .iter()
            .map(|w| w.depth * sin_cos_turns(w.turns * turn + w.rises * t + w.phase).0)
            .sum();
        girth * ends * body * (1.0 + relief)
    };
    Box::new(move |b: &mut Builder| {
        let far = corner + DVec3::new(plot[0], 0.0, plot[1]);
        let at = |x: f64, z: f64| DVec3::new(x, 0.0, z);
        b.polygon(
            &[at(corner.x, corner.z), at(corner.x, far.z), at(far.x, far.z), at(far.x, corner.z)],
            DVec3::Y,
        );
        let base = 0.15 * height;
        b.block(middle, DVec3::new(2.4 * girth, base, 2.4 * girth));
        let (rows, sides) = (b.fine(36.0, 4), b.fine(32.0, 5));
        let point = |t: f64, turn: f64| {
            let (sin, cos) = sin_cos_turns(turn);
            let r = radius(t, turn).max(1e-3 * girth);
            middle + DVec3::new(sin * r, base + t * height, cos * r)
        };
        b.rings(rows + 1, sides, |row, side| {
            let (t, turn) = (f64::from(row) / f64::from(rows), f64::from(side) / f64::from(sides));
            let step = 1e-4;
            let (below, above) = ((t - step).max(0.0), (t + step).min(1.0));
            let up = point(above, turn) - point(below, turn);
            let around = point(t, turn + step) - point(t, turn - step);
            (point(t, turn), around.cross(up))
        });
    })
}
