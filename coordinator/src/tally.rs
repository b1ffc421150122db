//! Gathers what the session tells into the run's record.

use crate::record::{ClockEstimate, NodeRecord, PhaseRecord, PictureRecord, RunRecord};
use crate::run::RunError;
use protocol::id::{FrameIndex, Seat};
use protocol::message::FailureKind;
use protocol::schedule::{Phase, SEATS};
use protocol::settings::RunSettings;
use protocol::telemetry::{BackendInfo, Nanos, PhaseReport};
use std::collections::BTreeMap;

/// What is known of a node so far.
#[derive(Default)]
struct Node {
    pid: Option<u32>,
    backend: Option<BackendInfo>,
    clock: Option<ClockEstimate>,
}

/// The record so far.
#[derive(Default)]
pub(crate) struct Tally {
    nodes: BTreeMap<Seat, Node>,
    phases: Vec<PhaseRecord>,
    pictures: BTreeMap<FrameIndex, PictureRecord>,
}

impl Tally {
    fn node(&mut self, seat: Seat) -> &mut Node {
        self.nodes.entry(seat).or_default()
    }

    pub(crate) fn seated(&mut self, seat: Seat, pid: u32) {
        self.node(seat).pid = Some(pid);
    }

    pub(crate) fn ready(&mut self, seat: Seat, backend: BackendInfo) {
        self.node(seat).backend = Some(backend);
    }

    /// The newest estimate is the best.
    pub(crate) fn clock(&mut self, seat: Seat, offset: i64, error: Nanos, round_trip_p50: Nanos) {
        self.node(seat).clock = Some(ClockEstimate { offset, error, round_trip_p50 });
    }

    pub(crate) fn phase_started(&mut self, phase: Phase, at: Nanos) {
        let record =
            PhaseRecord { phase, started: at, ended: at, reports: Vec::new(), control_sent: 0 };
        self.phases.push(record);
    }

    pub(crate) fn report(&mut self, seat: Seat, report: PhaseReport) {
        let phase = self.phase(report.phase);
        phase.reports.push((seat, report));
        phase.reports.sort_by_key(|(seat, _)| *seat);
    }

    pub(crate) fn picture(&mut self, frame: FrameIndex, picture: PictureRecord) {
        self.pictures.insert(frame, picture);
    }

    /// The phase's whole record.
    pub(crate) fn phase_ended(
        &mut self,
        phase: Phase,
        at: Nanos,
        control_sent: u64,
    ) -> &PhaseRecord {
        let record = self.phase(phase);
        (record.ended, record.control_sent) = (at, control_sent);
        record
    }

    /// The record of `phase`, which has started.
    fn phase(&mut self, phase: Phase) -> &mut PhaseRecord {
        let last = self.phases.last_mut().expect("a phase starts before anything is said of it");
        assert_eq!(last.phase, phase, "phases follow each other");
        last
    }

    /// The record, once every node has said what it must.
    pub(crate) fn finish(
        mut self,
        settings: RunSettings,
        processes: u32,
        memory_cap: Option<u64>,
    ) -> Result<RunRecord, RunError> {
        let nodes = SEATS.iter().map(|&seat| {
            let node = self.nodes.remove(&seat)?;
            Some(NodeRecord { seat, pid: node.pid?, backend: node.backend?, clock: node.clock? })
        });
        let nodes = nodes.collect::<Option<Vec<_>>>().ok_or_else(|| {
            RunError::new(FailureKind::Internal, "the run ended before every node was known")
        })?;
        let Self { phases, pictures, .. } = self;
        Ok(RunRecord { settings, processes, memory_cap, nodes, phases, pictures })
    }
}
