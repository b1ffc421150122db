//! The pipe network: one object through the whole building.
//!
//! A run leaves a slot, climbs to the rack under the ceiling, crosses to the corridor, follows it in
//! one of its lanes, if need be climbs through the slabs along the corridor's wall, and comes down at
//! another slot. Runs along x and runs along z keep to different heights, as on a real pipe rack.

use super::layout::*;
use super::structure::bolt;
use crate::synth::Build;
use crate::synth::builder::{Builder, frame, sin_cos_turns};
use crate::synth::random::Random;
use glam::DVec3;

/// Runs of the network.
const RUNS: u32 = 420;
/// Between flanges, metres.
const FLANGE_PITCH: f64 = 3.0;

/// A pipe along an axis-parallel polyline.
#[derive(Debug, Clone)]
pub(in crate::synth) struct Run {
    pub(in crate::synth) points: Vec<DVec3>,
    pub(in crate::synth) radius: f64,
}

/// The whole network.
pub(super) fn network(random: &mut Random) -> Build {
    let rooms: Vec<Room> = Room::all().collect();
    let mut runs = Vec::new();
    while runs.len() < RUNS as usize {
        let from = rooms[random.below(rooms.len() as u32) as usize];
        let mut to = rooms[random.below(rooms.len() as u32) as usize];
        // Most runs stay on their floor.
        if random.chance(0.6) {
            to.floor = from.floor;
        }
        if let Some(run) = route(from, to, random) {
            runs.push(run);
        }
    }
    Box::new(move |b| runs.iter().for_each(|run| build_run(b, run)))
}

/// A way from a slot of `from` to a slot of `to`; none if the two are too close in x to be worth it.
fn route(from: Room, to: Room, random: &mut Random) -> Option<Run> {
    // Small pipes are many, large ones few.
    let radius = 0.03 + 0.14 * random.unit() * random.unit();
    let pick = |room: Room, random: &mut Random| {
        let slots = room.slots();
        slots[random.below(slots.len() as u32) as usize]
    };
    let (a, b) = (pick(from, random), pick(to, random));
    if (a.x - b.x).abs() < 3.0 {
        return None;
    }
    // Behind the equipment, still inside the slot.
    let (ax, bx) = (a.x + random.between(0.85, 1.0), b.x - random.between(0.85, 1.0));
    let rack_x = [4.15, 4.4][random.below(2) as usize] + random.between(-0.03, 0.03);
    let rack_z = random.between(4.75, 5.1);
    let lane = CORRIDOR[0] + 0.7 + 0.37 * f64::from(random.below(8));
    let mut points = vec![
        DVec3::new(a.x, a.y + 0.9, a.z),
        DVec3::new(ax, a.y + 0.9, a.z),
        DVec3::new(ax, a.y + rack_z, a.z),
        DVec3::new(ax, a.y + rack_z, lane),
        DVec3::new(ax, a.y + rack_x, lane),
    ];
    let mut out = lane;
    if from.floor != to.floor {
        // Clear of doors at 4 and 12 and of columns at 0, 8 and 16 m of every room.
        let places = [1.2, 1.8, 2.4, 5.6, 6.2, 6.8, 9.2, 9.8, 10.4, 13.6, 14.2, 14.8];
        let room = random.below(ROOMS);
        let x = ROOM_LENGTH * f64::from(room) + places[random.below(12) as usize];
        let wall = [CORRIDOR[0] + 0.32, CORRIDOR[1] - 0.32][random.below(2) as usize];
        out = CORRIDOR[0] + 0.7 + 0.37 * f64::from(random.below(8));
        points.extend([
            DVec3::new(x, a.y + rack_x, lane),
            DVec3::new(x, a.y + rack_x, wall),
            DVec3::new(x, b.y + rack_x, wall),
            DVec3::new(x, b.y + rack_x, out),
        ]);
    }
    points.extend([
        DVec3::new(bx, b.y + rack_x, out),
        DVec3::new(bx, b.y + rack_z, out),
        DVec3::new(bx, b.y + rack_z, b.z),
        DVec3::new(bx, b.y + 0.9, b.z),
        DVec3::new(b.x, b.y + 0.9, b.z),
    ]);
    Some(Run { points, radius })
}

/// Builds one run: straights, elbows where it turns, flanges and valves along it.
pub(in crate::synth) fn build_run(b: &mut Builder, run: &Run) {
    let radius = run.radius;
    let sides = b.fine(14.0 + 60.0 * radius, 3);
    let points = &run.points;
    let length = |i: usize| (points[i + 1] - points[i]).length();
    // An elbow takes at most 0.45 of either straight, so that two of them never meet.
    let turn = |i: usize| {
        if i == 0 || i + 1 == points.len() {
            0.0
        } else {
            (3.0 * radius).min(0.45 * length(i - 1)).min(0.45 * length(i))
        }
    };
    for i in 0..points.len() - 1 {
        let direction = (points[i + 1] - points[i]).normalize();
        let (from, to) = (points[i] + direction * turn(i), points[i + 1] - direction * turn(i + 1));
        straight(b, from, to, radius, sides);
        if i + 2 < points.len() {
            let next = (points[i + 2] - points[i + 1]).normalize();
            // Straight on, or back on itself, needs no elbow.
            if direction.dot(next).abs() < 0.5 {
                let rows = b.fine(7.0, 1);
                b.bend(to, direction, next, turn(i + 1), radius, sides, rows);
            }
        }
    }
}

fn straight(b: &mut Builder, from: DVec3, to: DVec3, radius: f64, sides: u32) {
    let length = (to - from).length();
    let rows = b.fine(length / 0.7, 1);
    b.tube(from, to, radius, sides, rows, false);
    let axis = (to - from) / length;
    let flanges = (length / FLANGE_PITCH) as u32;
    for k in 0..flanges {
        let at = from + axis * (FLANGE_PITCH * (f64::from(k) + 0.5));
        b.optional(0.5, |b| flange(b, at, axis, radius));
        // A valve at every fifth.
        if k % 5 == 2 {
            b.optional(0.3, |b| valve(b, at + axis * (FLANGE_PITCH * 0.4), axis, radius));
        }
    }
}

/// Two discs held by bolts.
fn flange(b: &mut Builder, at: DVec3, axis: DVec3, radius: f64) {
    let (rim, half) = (1.5 * radius + 0.02, 0.02 + 0.1 * radius);
    let sides = b.fine(24.0, 4);
    b.lathe(
        at - axis * half,
        axis,
        &[(0.0, radius), (0.0, rim), (2.0 * half, rim), (2.0 * half, radius)],
        sides,
    );
    let bolts = b.fine(8.0, 0);
    let (u, v) = frame(axis);
    for k in 0..bolts {
        let (sin, cos) = sin_cos_turns(f64::from(k) / f64::from(bolts));
        let place = at + (u * cos + v * sin) * (0.5 * (radius + rim));
        bolt(b, place + axis * half, axis, 0.12 * radius + 0.003);
        bolt(b, place - axis * half, -axis, 0.12 * radius + 0.003);
    }
}

/// A body, a stem and a hand wheel.
fn valve(b: &mut Builder, at: DVec3, axis: DVec3, radius: f64) {
    let sides = b.fine(28.0, 4);
    let r = radius;
    b.lathe(
        at - axis * (2.5 * r),
        axis,
        &[
            (0.0, r),
            (0.0, 1.5 * r),
            (0.5 * r, 1.5 * r),
            (1.5 * r, 1.9 * r),
            (3.5 * r, 1.9 * r),
            (4.5 * r, 1.5 * r),
            (5.0 * r, 1.5 * r),
            (5.0 * r, r),
        ],
        sides,
    );
    let (_, stem) = frame(axis);
    // The wheel stays above or beside the pipe, never below it.
    let stem = if stem.y < 0.0 { -stem } else { stem };
    let sides = b.fine(12.0, 3);
    let top = at + stem * (3.6 * r);
    b.tube(at + stem * (1.8 * r), top, 0.25 * r, sides, 1, true);
    let (segments, tube) = (b.fine(28.0, 4), b.fine(10.0, 3));
    b.torus(top, stem, 1.6 * r, 0.18 * r, segments, tube);
}
