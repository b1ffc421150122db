//! Who does what: a pure function of (schedule, seat, phase). Paper 004, section 4.3.
//!
//! Phase i is the beat in which HC works on frame i; phase -1 only makes the first depth,
//! for which the whole scene counts as seen before.
//!
//! | phase i  | `switch`                                   | `rotate`                                  |
//! |----------|--------------------------------------------|-------------------------------------------|
//! | HC(i)    | seat i mod 2                               | seat i mod 3                              |
//! | OR(i+1)  | the other switch seat                      | seat (i+1) mod 3                          |
//! | RVG      | RVG(i) on seat 2                           | RVG(i-1) on seat (i-1) mod 3              |

use crate::id::{FrameIndex, Seat};
use crate::settings::Schedule;
use serde::{Deserialize, Serialize};

/// Seats of a rig.
pub const SEATS: [Seat; 3] = [Seat(0), Seat(1), Seat(2)];

/// What a seat does in a phase.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Role {
    /// Renders the last visible set's depth under the next camera.
    OcclusionRepresentation,
    /// Tests the front's boxes against its own depth.
    HardwareCull,
    /// Draws the picture.
    RenderVisibleGeometry,
}

impl Role {
    /// Its short name, as Manocha has it.
    pub fn short(self) -> &'static str {
        match self {
            Self::OcclusionRepresentation => "OR",
            Self::HardwareCull => "HC",
            Self::RenderVisibleGeometry => "RVG",
        }
    }
}

/// A beat of the pipeline; -1 is the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Phase(pub i32);

impl Phase {
    /// The phase before any picture: OR(0) alone.
    pub const FIRST: Self = Self(-1);

    /// The phase after this one.
    pub fn next(self) -> Self {
        Self(self.0 + 1)
    }
}

/// Role and frame of `seat` in `phase`; none where it idles (before the first and after the last of
/// `frames` pictures).
pub fn role(
    schedule: Schedule,
    seat: Seat,
    phase: Phase,
    frames: u32,
) -> Option<(Role, FrameIndex)> {
    let i = phase.0;
    let (role, frame) = match schedule {
        Schedule::Switch if seat == SEATS[2] => (Role::RenderVisibleGeometry, i),
        Schedule::Switch if i.rem_euclid(2) == i32::from(seat.0) => (Role::HardwareCull, i),
        Schedule::Switch => (Role::OcclusionRepresentation, i + 1),
        Schedule::Rotate => match (i32::from(seat.0) - i).rem_euclid(3) {
            0 => (Role::HardwareCull, i),
            1 => (Role::OcclusionRepresentation, i + 1),
            _ => (Role::RenderVisibleGeometry, i - 1),
        },
    };
    let frame = u32::try_from(frame).ok().filter(|&frame| frame < frames)?;
    Some((role, FrameIndex(frame)))
}

/// The work of `seat` from `phase` on, in order.
pub fn work_from(
    schedule: Schedule,
    seat: Seat,
    phase: Phase,
    frames: u32,
) -> impl Iterator<Item = (Role, FrameIndex)> {
    let phases = (phase.0..=last_phase(schedule, frames).0).map(Phase);
    phases.filter_map(move |phase| role(schedule, seat, phase, frames))
}

/// The seat that does `wanted` for `frame`.
pub fn seat_of(schedule: Schedule, wanted: Role, frame: FrameIndex) -> Seat {
    let frame = frame.0;
    match (schedule, wanted) {
        (Schedule::Switch, Role::RenderVisibleGeometry) => SEATS[2],
        (Schedule::Switch, _) => SEATS[(frame % 2) as usize],
        (Schedule::Rotate, _) => SEATS[(frame % 3) as usize],
    }
}

/// The phase in which the picture of `frame` is drawn.
pub fn drawn_in(schedule: Schedule, frame: FrameIndex) -> Phase {
    let culled_in = Phase(frame.0 as i32);
    match schedule {
        Schedule::Switch => culled_in,
        Schedule::Rotate => culled_in.next(),
    }
}

/// The seats HC(`frame`) sends its visible set to.
pub fn receivers(schedule: Schedule, frame: FrameIndex) -> Vec<Seat> {
    let next = seat_of(schedule, Role::HardwareCull, FrameIndex(frame.0 + 1));
    match schedule {
        Schedule::Switch => vec![next, SEATS[2]],
        Schedule::Rotate => vec![next],
    }
}

/// The earlier frame whose visible set both ends hold, that V_`frame` is sent as a change of.
///
/// In `switch` every seat holds V_{i-1}. In `rotate` sender i mod 3 and receiver (i+1) mod 3 last
/// shared V_{i-3}, which the sender culled and the receiver was sent. None: the change of the empty set.
pub fn delta_base(schedule: Schedule, frame: FrameIndex) -> Option<FrameIndex> {
    let back = match schedule {
        Schedule::Switch => 1,
        Schedule::Rotate => 3,
    };
    frame.0.checked_sub(back).map(FrameIndex)
}

/// The last phase in which any seat has work for a run of `frames` pictures.
pub fn last_phase(schedule: Schedule, frames: u32) -> Phase {
    let last = frames as i32 - 1;
    match schedule {
        Schedule::Switch => Phase(last),
        Schedule::Rotate => Phase(last + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAMES: u32 = 20;

    fn roles(schedule: Schedule, phase: i32) -> Vec<(Role, FrameIndex)> {
        SEATS.iter().filter_map(|&seat| role(schedule, seat, Phase(phase), FRAMES)).collect()
    }

    #[test]
    fn every_phase_has_one_of_each_role_on_the_right_frame() {
        for schedule in [Schedule::Switch, Schedule::Rotate] {
            let drawn = if schedule == Schedule::Switch { 0 } else { -1 };
            for i in 1..(FRAMES as i32 - 1) {
                let mut roles = roles(schedule, i);
                roles.sort();
                let frame = |offset: i32| FrameIndex((i + offset) as u32);
                let expected = vec![
                    (Role::OcclusionRepresentation, frame(1)),
                    (Role::HardwareCull, frame(0)),
                    (Role::RenderVisibleGeometry, frame(drawn)),
                ];
                assert_eq!(roles, expected, "{schedule:?} phase {i}");
            }
        }
    }

    #[test]
    fn a_frame_is_culled_where_its_depth_was_rendered() {
        for schedule in [Schedule::Switch, Schedule::Rotate] {
            for frame in 0..FRAMES {
                let seat = seat_of(schedule, Role::HardwareCull, FrameIndex(frame));
                let before = Phase(frame as i32 - 1);
                let expected = Some((Role::OcclusionRepresentation, FrameIndex(frame)));
                assert_eq!(role(schedule, seat, before, FRAMES), expected);
                let expected = Some((Role::HardwareCull, FrameIndex(frame)));
                assert_eq!(role(schedule, seat, before.next(), FRAMES), expected);
            }
        }
    }

    #[test]
    fn the_work_of_all_seats_is_every_role_of_every_frame_once() {
        for schedule in [Schedule::Switch, Schedule::Rotate] {
            let of = |seat| work_from(schedule, seat, Phase::FIRST, FRAMES);
            let mut all: Vec<_> = SEATS.iter().flat_map(|&seat| of(seat)).collect();
            all.sort();
            let frames = |role| (0..FRAMES).map(move |frame| (role, FrameIndex(frame)));
            let expected: Vec<_> = frames(Role::OcclusionRepresentation)
                .chain(frames(Role::HardwareCull))
                .chain(frames(Role::RenderVisibleGeometry))
                .collect();
            assert_eq!(all, expected);
            let late = work_from(schedule, SEATS[0], last_phase(schedule, FRAMES).next(), FRAMES);
            assert_eq!(late.count(), 0);
        }
    }

    #[test]
    fn both_ends_of_a_delta_hold_its_base() {
        for schedule in [Schedule::Switch, Schedule::Rotate] {
            let holds = |seat: Seat, frame: FrameIndex| {
                seat == seat_of(schedule, Role::HardwareCull, frame)
                    || receivers(schedule, frame).contains(&seat)
            };
            for frame in (0..FRAMES).map(FrameIndex) {
                let Some(base) = delta_base(schedule, frame) else { continue };
                assert!(holds(seat_of(schedule, Role::HardwareCull, frame), base));
                assert!(receivers(schedule, frame).iter().all(|&seat| holds(seat, base)));
            }
        }
    }

    #[test]
    fn nothing_is_left_after_the_last_phase() {
        for schedule in [Schedule::Switch, Schedule::Rotate] {
            let last = last_phase(schedule, FRAMES);
            assert!(!roles(schedule, last.0).is_empty());
            assert!(roles(schedule, last.0 + 1).is_empty());
            assert_eq!(roles(schedule, -1), [(Role::OcclusionRepresentation, FrameIndex(0))]);
        }
    }
}
