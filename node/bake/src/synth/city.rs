//! Streets and blocks of houses with facades.

use super::builder::Builder;
use super::random::Random;
use super::{Build, Group, Object, Plan, materials};
use glam::DVec3;

/// Blocks along a side.
const BLOCKS: u32 = 8;
/// A block's side, and the street between two, metres.
const BLOCK: f64 = 60.0;
const STREET: f64 = 16.0;
/// Houses along a block's side.
const HOUSES: u32 = 3;
/// Height of a storey, width of a facade's bay.
const STOREY: f64 = 3.2;
const BAY: f64 = 3.0;

pub(super) const COLORS: [(&str, [f32; 3]); 7] = [
    ("street", [0.12, 0.12, 0.13]),
    ("pavement", [0.36, 0.35, 0.33]),
    ("brick", [0.40, 0.14, 0.09]),
    ("plaster", [0.72, 0.66, 0.50]),
    ("stone", [0.46, 0.44, 0.40]),
    ("render", [0.50, 0.56, 0.58]),
    ("clay", [0.56, 0.30, 0.16]),
];
const STREET_COLOR: usize = 0;
const PAVEMENT_COLOR: usize = 1;
pub(super) const FACADE_COLORS: std::ops::Range<u32> = 2..7;

/// Lays the city out.
pub(super) fn plan(seed: u64) -> Plan {
    let mut random = Random::new(seed);
    let side = f64::from(BLOCKS) * (BLOCK + STREET) + STREET;
    let object =
        |name: String, material, build| Object { name, material, build, placements: Vec::new() };
    let ground: Build = Box::new(move |b| {
        b.cuboid(DVec3::new(0.0, -0.5, 0.0), DVec3::new(side, 0.0, side));
    });
    let mut objects = vec![object("ground".to_owned(), STREET_COLOR, ground)];
    for block in 0..BLOCKS * BLOCKS {
        let corner = DVec3::new(
            STREET + f64::from(block % BLOCKS) * (BLOCK + STREET),
            0.0,
            STREET + f64::from(block / BLOCKS) * (BLOCK + STREET),
        );
        let pavement: Build = Box::new(move |b| {
            let out = DVec3::new(2.5, 0.0, 2.5);
            let far = corner + DVec3::new(BLOCK, 0.15, BLOCK);
            b.cuboid(corner - out, far + out);
        });
        objects.push(object(format!("pavement-{block:02}"), PAVEMENT_COLOR, pavement));
        // The blocks of the middle are the tall ones.
        let off = |i: u32| (f64::from(i) - 0.5 * f64::from(BLOCKS - 1)).abs();
        let storeys = 12.0 - 2.0 * off(block % BLOCKS).max(off(block / BLOCKS));
        for lot in 0..HOUSES * HOUSES {
            let (i, k) = (lot % HOUSES, lot / HOUSES);
            // The middle of a block is its yard.
            if (1..HOUSES - 1).contains(&i) && (1..HOUSES - 1).contains(&k) {
                continue;
            }
            let pitch = BLOCK / f64::from(HOUSES);
            let foot = corner + DVec3::new(f64::from(i) * pitch, 0.15, f64::from(k) * pitch);
            let floors = (storeys * random.between(0.6, 1.5)) as u32 + 2;
            let set_back = random.between(0.0, 1.2);
            let pitched = random.chance(0.5);
            let color = FACADE_COLORS.start + random.below(FACADE_COLORS.len() as u32);
            objects.push(object(
                format!("house-{block:02}-{lot}"),
                color as usize,
                house(foot, pitch, set_back, floors, pitched),
            ));
        }
    }
    Plan { materials: materials(&COLORS), groups: vec![Group { share: 1.0, objects }] }
}

/// A house on a square lot: body, ledges, windows on all four sides, and a pitched or flat roof.
fn house(foot: DVec3, lot: f64, set_back: f64, floors: u32, pitched: bool) -> Build {
    let low = foot + DVec3::new(set_back, 0.0, set_back);
    let size = lot - 2.0 * set_back;
    let height = STOREY * f64::from(floors) + 0.6;
    Box::new(move |b| {
        b.cuboid(low, low + DVec3::new(size, height, size));
        for floor in 1..=floors {
            if b.keep(0.2) {
                let y = low.y + STOREY * f64::from(floor);
                b.cuboid(
                    DVec3::new(low.x - 0.15, y, low.z - 0.15),
                    DVec3::new(low.x + size + 0.15, y + 0.12, low.z + size + 0.15),
                );
            }
        }
        let bays = (size / BAY) as u32;
        for face in 0..4 {
            for floor in 0..floors {
                for bay in 0..bays {
                    let across = size * (f64::from(bay) + 0.5) / f64::from(bays);
                    let facade = Facade { low, size, face };
                    window(b, &facade, across, STOREY * f64::from(floor) + 0.9);
                }
            }
        }
        roof(b, low + DVec3::Y * height, size, pitched);
    })
}

/// One of a house's four walls.
struct Facade {
    low: DVec3,
    size: f64,
    face: u32,
}

impl Facade {
    /// A box on the wall: along it, up, and out of it.
    fn panel(&self, b: &mut Builder, along: [f64; 2], up: [f64; 2], out: [f64; 2]) {
        let far = if self.face % 2 == 1 { self.size + out[0] } else { -out[1] };
        let depth = [far, far + out[1] - out[0]];
        let (x, z) = if self.face < 2 { (along, depth) } else { (depth, along) };
        b.cuboid(
            self.low + DVec3::new(x[0], up[0], z[0]),
            self.low + DVec3::new(x[1], up[1], z[1]),
        );
    }
}

/// A pane, its frame and sill, glazing bars, and a balcony's railing with more and more detail.
fn window(b: &mut Builder, facade: &Facade, across: f64, y: f64) {
    let (half, height) = (0.6, 1.5);
    if !b.keep(0.15) {
        return;
    }
    facade.panel(b, [across - half, across + half], [y, y + height], [0.0, 0.03]);
    if b.keep(0.6) {
        facade.panel(b, [across - 0.8, across + 0.8], [y - 0.1, y], [0.0, 0.25]);
        facade.panel(b, [across - 0.7, across + 0.7], [y + height, y + height + 0.1], [0.0, 0.15]);
    }
    if b.keep(1.0) {
        for edge in [-half, half] {
            let bar = [across + edge - 0.05, across + edge + 0.05];
            facade.panel(b, bar, [y, y + height], [0.0, 0.08]);
        }
    }
    let bars = b.fine(2.5, 0);
    for k in 0..bars {
        let x = across - half + 2.0 * half * (f64::from(k) + 1.0) / f64::from(bars + 1);
        let width = 0.2 / f64::from(bars + 4);
        facade.panel(b, [x - width, x + width], [y, y + height], [0.03, 0.06]);
    }
}

fn roof(b: &mut Builder, low: DVec3, size: f64, pitched: bool) {
    if !pitched {
        let parapet = 0.3;
        for (x, z) in [
            ([0.0, size], [0.0, parapet]),
            ([0.0, size], [size - parapet, size]),
            ([0.0, parapet], [parapet, size - parapet]),
            ([size - parapet, size], [parapet, size - parapet]),
        ] {
            b.cuboid(low + DVec3::new(x[0], 0.0, z[0]), low + DVec3::new(x[1], 0.9, z[1]));
        }
        return;
    }
    let (eave, ridge) = (0.4, 0.35 * size);
    let at = |x: f64, y: f64, z: f64| low + DVec3::new(x, y, z);
    let (far, mid) = (size + eave, 0.5 * size);
    let (a, c) = (at(-eave, 0.0, -eave), at(far, 0.0, -eave));
    let (d, e) = (at(far, 0.0, far), at(-eave, 0.0, far));
    let (r0, r1) = (at(-eave, ridge, mid), at(far, ridge, mid));
    let slope = mid + eave;
    b.polygon(&[a, r0, r1, c], DVec3::new(0.0, slope, -ridge));
    b.polygon(&[e, d, r1, r0], DVec3::new(0.0, slope, ridge));
    b.polygon(&[a, e, r0], DVec3::NEG_X);
    b.polygon(&[c, r1, d], DVec3::X);
    b.polygon(&[a, c, d, e], DVec3::NEG_Y);
    // Rows of tiles.
    let courses = b.fine(24.0, 0);
    for k in 0..courses {
        let t = (f64::from(k) + 0.5) / f64::from(courses);
        for side in [-1.0, 1.0] {
            let z = mid + side * slope * (1.0 - t);
            let lift = DVec3::new(0.5 * size, ridge * t - 0.05, z);
            b.block(low + lift, DVec3::new(size + 2.0 * eave, 0.12, 0.12));
        }
    }
}
