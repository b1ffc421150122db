//! What a run leaves behind in memory, before anything is written.

use protocol::id::{FrameIndex, Seat};
use protocol::schedule::Phase;
use protocol::settings::RunSettings;
use protocol::telemetry::{BackendInfo, Nanos, PhaseReport};
use std::collections::BTreeMap;

/// A node's clock against the coordinator's: `coordinator = node + offset`.
///
/// From the ping with the least round trip, so the offset is off by half of it at most.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClockEstimate {
    /// Nanoseconds to add to the node's times.
    pub offset: i64,
    /// Greatest error of the offset: half the least round trip.
    pub error: Nanos,
    /// Median round trip of all pings.
    pub round_trip_p50: Nanos,
}

/// One node of the run.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeRecord {
    /// Its seat.
    pub seat: Seat,
    /// Its process.
    pub pid: u32,
    /// Its renderer.
    pub backend: BackendInfo,
    /// Its clock.
    pub clock: ClockEstimate,
}

/// One phase, as the coordinator saw it.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseRecord {
    /// The phase.
    pub phase: Phase,
    /// When it was broadcast, coordinator's clock.
    pub started: Nanos,
    /// When the last seat had reported, coordinator's clock.
    pub ended: Nanos,
    /// What each seat said, by seat.
    pub reports: Vec<(Seat, PhaseReport)>,
    /// Bytes the coordinator has sent to all nodes so far.
    pub control_sent: u64,
}

/// What is known of a picture beside its phase.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PictureRecord {
    /// First 8 bytes of the BLAKE3 of its RGBA bytes.
    pub hash: u64,
    /// How long hashing took, on a thread of its own.
    pub hashing: Nanos,
}

/// A whole run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunRecord {
    /// What the nodes were told.
    pub settings: RunSettings,
    /// Processes that rendered: 1 or 3.
    pub processes: u32,
    /// Most bytes of geometry and textures that each process was given; none leaves it to the nodes.
    pub memory_cap: Option<u64>,
    /// The nodes, by seat.
    pub nodes: Vec<NodeRecord>,
    /// The phases in order. Each ends when the next one starts.
    pub phases: Vec<PhaseRecord>,
    /// Every picture.
    pub pictures: BTreeMap<FrameIndex, PictureRecord>,
}
