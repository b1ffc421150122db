//! The plant: an 80 x 48 x 30 m hall of five storeys with a corridor, fifty rooms and two boilers.

mod equipment;
mod layout;
pub(super) mod pipes;
mod services;
mod structure;

use super::random::Random;
use super::{Build, Group, Object, Plan, materials};
use layout::*;
use structure::Wall;

/// Objects of the hall, as in the UNC power plant.
pub(super) const OBJECTS: usize = 1185;

/// Kinds of things; each has its colour.
#[derive(Debug, Clone, Copy)]
enum Stuff {
    Pipe,
    Concrete,
    Steel,
    Wall,
    Cladding,
    Stair,
    Rail,
    Duct,
    Tray,
    Tank,
    Pump,
    Cabinet,
    Platform,
    Boiler,
    Lamp,
}

const COLORS: [(&str, [f32; 3]); 15] = [
    ("pipe", [0.46, 0.52, 0.58]),
    ("concrete", [0.42, 0.41, 0.39]),
    ("steel", [0.11, 0.22, 0.38]),
    ("wall", [0.66, 0.63, 0.54]),
    ("cladding", [0.35, 0.45, 0.50]),
    ("stair", [0.30, 0.30, 0.32]),
    ("rail", [0.80, 0.58, 0.06]),
    ("duct", [0.58, 0.60, 0.62]),
    ("cable tray", [0.20, 0.20, 0.20]),
    ("tank", [0.16, 0.42, 0.24]),
    ("pump", [0.10, 0.26, 0.52]),
    ("cabinet", [0.55, 0.56, 0.50]),
    ("platform", [0.36, 0.33, 0.28]),
    ("boiler", [0.52, 0.16, 0.10]),
    ("lamp", [0.88, 0.88, 0.80]),
];

struct Objects(Vec<Object>);

impl Objects {
    fn add(&mut self, stuff: Stuff, build: Build) {
        let material = stuff as usize;
        let name = format!("{}-{:04}", COLORS[material].0.replace(' ', "-"), self.0.len());
        self.0.push(Object { name, material, build, placements: Vec::new() });
    }
}

/// Lays the hall out.
pub(super) fn plan(seed: u64) -> Plan {
    let mut random = Random::new(seed);
    let mut objects = Objects(Vec::new());
    structure(&mut objects, &mut random);
    services(&mut objects);
    fill_slots(&mut objects, &mut random);
    let lamps = OBJECTS - 1 - objects.0.len();
    let hooks = services::lamp_hooks();
    assert!((1..=hooks.len()).contains(&lamps), "{lamps} lamps must make up the number of objects");
    for &hook in &hooks[..lamps] {
        objects.add(Stuff::Lamp, services::lamp(hook));
    }
    let network = Object {
        name: "pipe-network".to_owned(),
        material: Stuff::Pipe as usize,
        build: pipes::network(&mut random),
        placements: Vec::new(),
    };
    Plan {
        materials: materials(&COLORS),
        groups: vec![
            Group { share: 0.5, objects: vec![network] },
            Group { share: 0.5, objects: objects.0 },
        ],
    }
}

fn structure(objects: &mut Objects, random: &mut Random) {
    let holes: Vec<Rect> = stair_wells().into_iter().chain(boiler_shafts()).collect();
    for level in 0..=FLOORS {
        // Neither the ground nor the roof has openings.
        let holes = if level == 0 || level == FLOORS { Vec::new() } else { holes.clone() };
        for room in Room::all().filter(|r| r.floor == 0) {
            let slab = structure::slab(floor_y(level), room.rect(), holes.clone());
            objects.add(Stuff::Concrete, slab);
        }
        let corridor = Rect { x: [0.0, LENGTH], z: CORRIDOR };
        objects.add(Stuff::Concrete, structure::slab(floor_y(level), corridor, Vec::new()));
    }
    for k in 0..=(LENGTH / COLUMN_PITCH) as u32 {
        for z in COLUMN_LINES {
            let x = COLUMN_PITCH * f64::from(k);
            objects.add(Stuff::Steel, structure::column(x, z));
        }
    }
    for level in 1..=FLOORS {
        for z in COLUMN_LINES {
            for bay in 0..ROOMS {
                let x = ROOM_LENGTH * f64::from(bay);
                let beam = structure::beam([x, x + ROOM_LENGTH], floor_y(level) - SLAB, z);
                objects.add(Stuff::Steel, beam);
            }
        }
    }
    walls(objects, random);
    for floor in 0..FLOORS - 1 {
        for well in stair_wells() {
            objects.add(Stuff::Stair, structure::stair(well, floor));
            objects.add(Stuff::Rail, structure::stair_rails(well, floor));
        }
        for shaft in boiler_shafts() {
            objects.add(Stuff::Rail, structure::shaft_rails(shaft, floor + 1));
        }
    }
}

fn walls(objects: &mut Objects, random: &mut Random) {
    for room in Room::all() {
        let span = [room.x0(), room.x0() + ROOM_LENGTH];
        // A doorway at the end of one or both of the aisles that meet the corridor.
        let doors = match random.below(3) {
            0 => vec![room.x0() + 4.0],
            1 => vec![room.x0() + 12.0],
            _ => vec![room.x0() + 4.0, room.x0() + 12.0],
        };
        let plane = CORRIDOR[room.side as usize];
        let wall = Wall { along_x: true, plane, span, floor: room.floor, doors };
        objects.add(Stuff::Wall, wall.build());
        objects.add(Stuff::Cladding, structure::cladding(true, room.z(0.0), span, room.floor));
        let across = room.rect().z;
        if room.index == 0 || room.index == ROOMS - 1 {
            let plane = if room.index == 0 { 0.0 } else { LENGTH };
            let cladding = structure::cladding(false, plane, across, room.floor);
            objects.add(Stuff::Cladding, cladding);
        }
        if room.index > 0 {
            // Half of the rooms are linked to their neighbour, at the free strip.
            let doors = if random.chance(0.5) { vec![room.z(19.4)] } else { Vec::new() };
            let wall =
                Wall { along_x: false, plane: span[0], span: across, floor: room.floor, doors };
            objects.add(Stuff::Wall, wall.build());
        }
    }
    // The corridor's ends.
    for floor in 0..FLOORS {
        for plane in [0.0, LENGTH] {
            objects.add(Stuff::Cladding, structure::cladding(false, plane, CORRIDOR, floor));
        }
    }
}

fn services(objects: &mut Objects) {
    for room in Room::all() {
        let y = floor_y(room.floor);
        let [x0, x1] = room.rect().x;
        let span = [x0 + 0.3, x1 - 0.3];
        objects.add(Stuff::Duct, services::duct(true, span, y + 3.2, room.z(6.8), 0.8));
        objects.add(Stuff::Tray, services::cable_tray(true, span, y + 3.0, room.z(21.6)));
        objects.add(Stuff::Tray, services::cable_tray(true, span, y + 2.9, room.z(0.5)));
    }
    for floor in 0..FLOORS {
        let span = [0.5, LENGTH - 0.5];
        let duct = services::duct(true, span, floor_y(floor) + 3.1, 24.0, 0.9);
        objects.add(Stuff::Duct, duct);
        let tray = services::cable_tray(true, span, floor_y(floor) + 2.8, 22.5);
        objects.add(Stuff::Tray, tray);
    }
}

/// How many of each stand in the slots.
const EQUIPMENT: [(Stuff, u32); 4] =
    [(Stuff::Tank, 80), (Stuff::Pump, 80), (Stuff::Cabinet, 90), (Stuff::Platform, 40)];

fn fill_slots(objects: &mut Objects, random: &mut Random) {
    for shaft in boiler_shafts() {
        objects.add(Stuff::Boiler, equipment::boiler(shaft));
    }
    let mut slots = shuffled_slots(random).into_iter();
    for (stuff, count) in EQUIPMENT {
        for (_, foot) in slots.by_ref().take(count as usize) {
            let build = match stuff {
                Stuff::Tank => equipment::tank(foot, random),
                Stuff::Pump => equipment::pump(foot, random),
                Stuff::Cabinet => equipment::cabinets(foot, random),
                _ => equipment::platform(foot, random),
            };
            objects.add(stuff, build);
        }
    }
}
