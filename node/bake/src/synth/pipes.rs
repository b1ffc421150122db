//! Replicated and instanced pipe-rack modules.
//!
//! Four designs of rack stand in a grid of ten by ten. A quarter of the places hold copies with a mesh of their own, the
//! others share their design's mesh and are turned, mirrored or stretched.

use super::builder::Builder;
use super::plant::pipes::{Run, build_run};
use super::random::Random;
use super::{Build, Group, Object, Plan, materials};
use glam::DVec3;

/// Places along a side of the grid.
const SIDE: u32 = 10;
/// Designs.
const DESIGNS: u32 = 4;
/// Every so many places hold a copy of their own.
const COPY_EVERY: u32 = 4;
/// Between places, metres.
const PITCH: f64 = 14.0;
/// A rack's length, height and depth.
const SIZE: DVec3 = DVec3::new(9.0, 5.0, 5.0);

const COLORS: [(&str, [f32; 3]); 4] = [
    ("rack red", [0.50, 0.12, 0.10]),
    ("rack blue", [0.10, 0.20, 0.48]),
    ("rack green", [0.14, 0.40, 0.20]),
    ("rack grey", [0.45, 0.45, 0.47]),
];

/// Lays the yard out.
pub(super) fn plan(seed: u64) -> Plan {
    let mut objects: Vec<Object> =
        (0..DESIGNS).map(|d| object(format!("rack-{d}"), d, seed, Vec::new())).collect();
    for place in 0..SIDE * SIDE {
        let design = place % DESIGNS;
        let matrix = placement(place, &mut Random::stream(seed, 1000 + u64::from(place)));
        if (place / DESIGNS).is_multiple_of(COPY_EVERY) {
            objects.push(object(format!("copy-{place}"), design, seed, vec![matrix]));
        } else {
            objects[design as usize].placements.push(matrix);
        }
    }
    Plan { materials: materials(&COLORS), groups: vec![Group { share: 1.0, objects }] }
}

fn object(name: String, design: u32, seed: u64, placements: Vec<[f64; 16]>) -> Object {
    let build = rack(&mut Random::stream(seed, u64::from(design)));
    Object { name, material: design as usize, build, placements }
}

/// A quarter turn, often a mirror, sometimes another size along each axis.
fn placement(place: u32, random: &mut Random) -> [f64; 16] {
    let mut scale = DVec3::ONE;
    if random.chance(0.3) {
        scale = DVec3::new(
            random.between(0.7, 1.4),
            random.between(0.7, 1.3),
            random.between(0.7, 1.4),
        );
    }
    if random.chance(0.4) {
        scale.x = -scale.x;
    }
    let (sin, cos) = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][random.below(4) as usize];
    let (x, z) = (f64::from(place % SIDE) * PITCH, f64::from(place / SIDE) * PITCH);
    [
        cos * scale.x,
        0.0,
        -sin * scale.x,
        0.0, //
        0.0,
        scale.y,
        0.0,
        0.0, //
        sin * scale.z,
        0.0,
        cos * scale.z,
        0.0, //
        x,
        0.0,
        z,
        1.0,
    ]
}

/// Frames of four posts with pipes that climb between the racks' tiers.
fn rack(random: &mut Random) -> Build {
    let half = SIZE * 0.5;
    let runs: Vec<Run> = (0..14)
        .map(|_| {
            let z = random.between(-half.z + 0.3, half.z - 0.3);
            let other = if z > 0.0 { z - half.z } else { z + half.z };
            let low = random.between(0.5, 0.45 * SIZE.y);
            let high = random.between(0.55 * SIZE.y, SIZE.y - 0.3);
            let x = random.between(-0.6 * half.x, 0.6 * half.x);
            let points = vec![
                DVec3::new(-half.x, low, z),
                DVec3::new(x, low, z),
                DVec3::new(x, high, z),
                DVec3::new(x, high, other),
                DVec3::new(half.x, high, other),
            ];
            Run { points, radius: random.between(0.05, 0.16) }
        })
        .collect();
    Box::new(move |b: &mut Builder| {
        for x in [-half.x + 0.2, 0.0, half.x - 0.2] {
            for z in [-half.z, half.z] {
                b.block(DVec3::new(x, 0.0, z), DVec3::new(0.2, SIZE.y, 0.2));
            }
            for y in [0.45 * SIZE.y, SIZE.y - 0.2] {
                let beam = DVec3::new(0.15, 0.2, SIZE.z);
                b.block(DVec3::new(x, y, 0.0), beam);
            }
        }
        runs.iter().for_each(|run| build_run(b, run));
    })
}
