//! Where things may stand in the hall: floors, rooms, aisles, openings.
//!
//! x runs along the hall, y up, z across; a corridor runs the whole length of every floor between
//! two rows of rooms. All lengths in metres.

use crate::synth::random::Random;
use glam::DVec3;

/// Hall, x.
pub(super) const LENGTH: f64 = 80.0;
/// Hall, z.
pub(super) const WIDTH: f64 = 48.0;
/// Floor to floor.
pub(super) const STOREY: f64 = 6.0;
/// Storeys; the roof is the slab above the last.
pub(super) const FLOORS: u32 = 5;
/// Thickness of a slab, below its floor's height.
pub(super) const SLAB: f64 = 0.3;
/// Rooms along the hall, on either side of the corridor.
pub(super) const ROOMS: u32 = 5;
/// A room, x.
pub(super) const ROOM_LENGTH: f64 = LENGTH / ROOMS as f64;
/// The corridor's walls, z.
pub(super) const CORRIDOR: [f64; 2] = [22.0, 26.0];
/// Thickness of an inner wall.
pub(super) const WALL: f64 = 0.2;
/// Equipment keeps within this much of its slot's middle, x and z: the aisles are then 1.8 m wide.
pub(super) const SLOT_HALF: [f64; 2] = [1.1, 1.3];
/// Lines of columns, z.
pub(super) const COLUMN_LINES: [f64; 6] = [0.0, 11.2, 22.0, 26.0, 36.8, 48.0];
/// Pitch of columns, x.
pub(super) const COLUMN_PITCH: f64 = 8.0;

/// One room: `side` 0 lies before the corridor, 1 behind it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Room {
    pub(super) floor: u32,
    pub(super) side: u32,
    pub(super) index: u32,
}

/// A hole in a slab, or something else seen from above.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rect {
    pub(super) x: [f64; 2],
    pub(super) z: [f64; 2],
}

impl Rect {
    pub(super) fn overlaps(&self, other: &Self) -> bool {
        self.x[0] < other.x[1]
            && other.x[0] < self.x[1]
            && self.z[0] < other.z[1]
            && other.z[0] < self.z[1]
    }
}

/// Height of the top of a floor's slab.
pub(super) fn floor_y(floor: u32) -> f64 {
    STOREY * f64::from(floor)
}

impl Room {
    pub(super) fn all() -> impl Iterator<Item = Self> {
        (0..FLOORS).flat_map(|floor| {
            (0..2).flat_map(move |side| (0..ROOMS).map(move |index| Self { floor, side, index }))
        })
    }

    pub(super) fn x0(&self) -> f64 {
        ROOM_LENGTH * f64::from(self.index)
    }

    /// z at a distance from the outer wall.
    pub(super) fn z(&self, from_outer_wall: f64) -> f64 {
        if self.side == 0 { from_outer_wall } else { WIDTH - from_outer_wall }
    }

    pub(super) fn rect(&self) -> Rect {
        let (a, b) = (self.z(0.0), self.z(CORRIDOR[0]));
        Rect { x: [self.x0(), self.x0() + ROOM_LENGTH], z: [a.min(b), a.max(b)] }
    }

    /// Middles of the slots for equipment, on the floor: four by four, with aisles all round, and a
    /// free strip of 5 m by the corridor.
    pub(super) fn slots(&self) -> Vec<DVec3> {
        let mut slots = Vec::new();
        for x in [2.0, 6.0, 10.0, 14.0] {
            for z in [2.4, 6.8, 11.2, 15.6] {
                let (x, z) = (self.x0() + x, self.z(z));
                let [hx, hz] = SLOT_HALF;
                let slot = Rect { x: [x - hx, x + hx], z: [z - hz, z + hz] };
                let taken = stair_wells().into_iter().chain(boiler_shafts());
                if !taken.into_iter().any(|t| t.overlaps(&slot)) {
                    slots.push(DVec3::new(x, floor_y(self.floor), z));
                }
            }
        }
        slots
    }
}

/// The two stair wells; flights climb within them on every floor.
pub(super) fn stair_wells() -> [Rect; 2] {
    [Rect { x: [0.4, 6.0], z: [0.6, 3.8] }, Rect { x: [64.4, 70.0], z: [44.2, 47.4] }]
}

/// The two shafts through all floors that hold the boilers.
pub(super) fn boiler_shafts() -> [Rect; 2] {
    [Rect { x: [33.2, 39.0], z: [31.0, 39.6] }, Rect { x: [41.0, 46.8], z: [31.0, 39.6] }]
}

/// Equipment's places in seeded order, each with its room.
pub(super) fn shuffled_slots(random: &mut Random) -> Vec<(Room, DVec3)> {
    let mut slots: Vec<(Room, DVec3)> =
        Room::all().flat_map(|room| room.slots().into_iter().map(move |s| (room, s))).collect();
    // Fisher and Yates, from the end.
    for i in (1..slots.len()).rev() {
        slots.swap(i, random.below(i as u32 + 1) as usize);
    }
    slots
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_leave_aisles() {
        for room in Room::all() {
            let slots = room.slots();
            assert!(!slots.is_empty());
            for (i, a) in slots.iter().enumerate() {
                for b in &slots[..i] {
                    let gap_x = (a.x - b.x).abs() - 2.0 * SLOT_HALF[0];
                    let gap_z = (a.z - b.z).abs() - 2.0 * SLOT_HALF[1];
                    assert!(gap_x.max(gap_z) >= 1.6, "{a} {b}");
                }
                let r = room.rect();
                assert!(a.x > r.x[0] && a.x < r.x[1] && a.z > r.z[0] && a.z < r.z[1]);
            }
        }
    }
}
