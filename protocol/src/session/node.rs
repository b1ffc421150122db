//! A node's side of a run.
//!
//! This file holds what a driver calls; `turns` what messages cause; `sets` the visible sets; `peers`
//! greetings and silence.

mod peers;
mod sets;
mod turns;

pub use peers::{PeerHelloError, check_peer_hello};

use crate::camera::Camera;
use crate::id::{FrameIndex, HlodId, Seat};
use crate::message::{FailureKind, Message, PeerAddress, Token, WIRE_VERSION};
use crate::schedule::{self, Phase, Role};
use crate::session::PEER_TIMEOUT;
use crate::settings::RunSettings;
use crate::telemetry::{
    BackendInfo, CullCounts, DrawCounts, IoCounts, Nanos, PhaseReport, WorkReport,
};
use crate::visible::{ChangeWriter, DeltaChunk, VisibleSet};
use peers::{Due, Watch};
use sets::{Held, Sets};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

/// The other end of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Peer {
    /// The coordinator.
    Coordinator,
    /// Another node.
    Seat(Seat),
}

/// What a node's driver must do.
#[allow(clippy::large_enum_variant, reason = "a queue holds a few, and most are messages")]
#[derive(Debug, Clone, PartialEq)]
pub enum Output {
    /// Put a message on a link.
    Send {
        /// The link.
        to: Peer,
        /// The message.
        message: Message,
    },
    /// Open the scene, start the backend, then link up with the peers (this seat calls seats above its
    /// own and accepts those below); answer with `handle_prepared`.
    Prepare {
        /// This node's seat.
        seat: Seat,
        /// The run.
        settings: RunSettings,
        /// All nodes' addresses.
        peers: Vec<PeerAddress>,
    },
    /// Render the occluders' depth for `frame`; answer with `handle_occluded`.
    Occlude {
        /// Frame whose depth is made.
        frame: FrameIndex,
        /// Its camera.
        camera: Camera,
        /// V_{frame-1}; for frame 0 the whole scene, so that it is culled like any other.
        occluders: Arc<VisibleSet>,
    },
    /// Cull `frame` against the depth held; answer with any number of `handle_culled_part` and one
    /// `handle_culled`.
    Cull {
        /// The frame.
        frame: FrameIndex,
        /// Its camera.
        camera: Camera,
    },
    /// Draw the picture of `frame`; answer with `handle_rendered`, and with `handle_hashed` before or after.
    Render {
        /// The frame.
        frame: FrameIndex,
        /// Its camera.
        camera: Camera,
        /// V_frame.
        visible: Arc<VisibleSet>,
    },
    /// The run is over: flush what is queued and leave.
    Finished,
    /// The run failed; the last message to the coordinator is already queued.
    Failed {
        /// The class of failure.
        kind: FailureKind,
        /// One sentence for a person.
        reason: String,
    },
}

/// When a role worked, and what it loaded.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WorkTimes {
    /// When the work began.
    pub started: Nanos,
    /// When it ended, measuring not counted.
    pub finished: Nanos,
    /// Geometry loaded for it.
    pub io: IoCounts,
}

/// What the driver knows of its process, stamped on each phase report.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ProcessState {
    /// Bytes sent to each peer so far.
    pub sent: Vec<crate::telemetry::LinkBytes>,
    /// Bytes sent to the coordinator so far.
    pub sent_control: u64,
    /// Highest resident set size so far.
    pub peak_rss: u64,
    /// Geometry bytes held for the backend.
    pub peak_resident: u64,
}

impl std::fmt::Display for Peer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Coordinator => f.write_str("the coordinator"),
            Self::Seat(seat) => write!(f, "seat {seat}"),
        }
    }
}

/// How far the run has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    Joining,
    Preparing,
    Running,
    /// No phase follows; some pictures are not hashed yet.
    Leaving,
    Ended,
}

/// Where the work of a phase stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Progress {
    /// Waits for this visible set.
    Awaiting(FrameIndex),
    /// The driver is at it.
    Working,
    /// Reported.
    Done,
}

/// The present phase.
#[derive(Debug)]
struct Beat {
    phase: Phase,
    received: Nanos,
    role: Option<(Role, FrameIndex)>,
    progress: Progress,
}

/// What a node was told when it was welcomed.
#[derive(Debug)]
struct Membership {
    seat: Seat,
    settings: RunSettings,
}

/// A node's session: a state machine, driven as [`crate::session`] says.
#[derive(Debug)]
pub struct Node {
    stage: Stage,
    outputs: VecDeque<Output>,
    membership: Option<Membership>,
    beat: Option<Beat>,
    cameras: BTreeMap<FrameIndex, Camera>,
    sets: Sets,
    culling: Option<ChangeWriter>,
    /// Pictures that are being drawn or hashed.
    unhashed: BTreeSet<FrameIndex>,
    process: ProcessState,
    watch: Watch,
}

impl Node {
    /// Starts by queueing `Hello`; `peer_address` is where this node's peers can reach it.
    pub fn new(now: Nanos, token: Token, peer_address: String, pid: u32) -> Self {
        let message = Message::Hello { version: WIRE_VERSION, token, peer_address, pid };
        Self {
            stage: Stage::Joining,
            outputs: VecDeque::from([Output::Send { to: Peer::Coordinator, message }]),
            membership: None,
            beat: None,
            cameras: BTreeMap::new(),
            sets: Sets::of_scene(0),
            culling: None,
            unhashed: BTreeSet::new(),
            process: ProcessState::default(),
            watch: Watch::new(now),
        }
    }

    /// Takes a message that came over the link to `from`.
    pub fn handle_message(&mut self, now: Nanos, from: Peer, message: Message) {
        if self.stage == Stage::Ended {
            return;
        }
        self.watch.heard(now, from);
        let handled = match (from, message) {
            (_, Message::Ping { sequence, sent }) => {
                self.send(from, Message::Pong { sequence, sent, answered: now });
                Ok(())
            }
            (Peer::Coordinator, message) => self.hear_coordinator(now, message),
            (Peer::Seat(seat), message) => self.hear_seat(now, seat, message),
        };
        if let Err(offence) = handled {
            self.fail(FailureKind::Protocol, format!("{from} {offence}"));
        }
    }

    /// The link to `peer` is closed.
    ///
    /// A peer's end is its own affair once this node's last phase is reported; before that the
    /// coordinator may have the better reason, and is given a moment to tell it.
    pub fn handle_disconnect(&mut self, now: Nanos, peer: Peer) {
        match peer {
            _ if self.stage == Stage::Ended => {}
            Peer::Coordinator => {
                self.fail(FailureKind::Unavailable, "the coordinator has hung up".into());
            }
            Peer::Seat(_) if self.has_reported_last_phase() => {}
            Peer::Seat(seat) => self.watch.lost(now, seat),
        }
    }

    /// Takes what is stamped on the next phase report.
    pub fn update_process(&mut self, state: ProcessState) {
        self.process = state;
    }

    /// The scene of so many `hlods` is open, the backend up, and all peers have greeted each other.
    pub fn handle_prepared(
        &mut self,
        _now: Nanos,
        scene_digest: [u8; 32],
        hlods: u32,
        backend: BackendInfo,
    ) {
        if self.stage == Stage::Ended {
            return;
        }
        assert_eq!(self.stage, Stage::Preparing, "prepared without being asked to");
        let settings = self.settings();
        if scene_digest != settings.scene_digest {
            let path = crate::path_text::from_text(&settings.scene_path);
            let path = path.display();
            let reason = format!("{path} is not the scene of this run; copy that file here");
            return self.fail(FailureKind::NotAllowed, reason);
        }
        self.stage = Stage::Running;
        self.sets = Sets::of_scene(hlods);
        self.send(Peer::Coordinator, Message::Ready { scene_digest, backend });
    }

    /// The occluders' depth for `frame` is made.
    pub fn handle_occluded(
        &mut self,
        _now: Nanos,
        frame: FrameIndex,
        times: WorkTimes,
        draw: DrawCounts,
    ) {
        self.handle_drawn(Role::OcclusionRepresentation, frame, times, draw);
    }

    /// All visible ids of `frame` above the previous part's `through`, up to this one's.
    ///
    /// # Panics
    /// If they are unsorted, outside that range, or `frame` is not being culled.
    pub fn handle_culled_part(
        &mut self,
        _now: Nanos,
        frame: FrameIndex,
        through: HlodId,
        visible: &[HlodId],
    ) {
        if self.stage == Stage::Ended {
            return;
        }
        self.assert_working(Role::HardwareCull, frame);
        let mut chunks = Vec::new();
        if let Some(writer) = &mut self.culling {
            writer.push(through, visible, &mut chunks);
        }
        self.send_chunks(frame, &chunks);
    }

    /// The cull of `frame` is complete; ids above the last part's `through` are not visible.
    /// `counts` need not say what the session knows better: sizes of set and change.
    pub fn handle_culled(
        &mut self,
        now: Nanos,
        frame: FrameIndex,
        times: WorkTimes,
        counts: CullCounts,
    ) {
        if self.stage == Stage::Ended {
            return;
        }
        self.assert_working(Role::HardwareCull, frame);
        let Some(writer) = self.culling.take() else { return };
        let mut chunks = Vec::new();
        let (set, totals) = writer.finish(&mut chunks);
        self.send_chunks(frame, &chunks);
        let visible = set.len() as u32;
        let end = Message::EndOfFrame { frame, visible, checksum: set.checksum() };
        for seat in schedule::receivers(self.settings().schedule, frame) {
            self.send(Peer::Seat(seat), end.clone());
        }
        self.sets.insert(frame, Held { set: Arc::new(set), received: None });
        let counts = CullCounts {
            visible,
            leaving: totals.leaving,
            entering: totals.entering,
            ids_delta_bits: totals.code_bits,
            ids_bound_bits: totals.bound_bits,
            ids_sent: totals.chunk_bytes,
            ids_full: visible.saturating_mul(4),
            ..counts
        };
        self.report(times, |work| {
            work.visible_sent = Some(now);
            work.cull = Some(counts);
        });
    }

    /// The picture of `frame` is drawn.
    pub fn handle_rendered(
        &mut self,
        _now: Nanos,
        frame: FrameIndex,
        times: WorkTimes,
        draw: DrawCounts,
    ) {
        self.handle_drawn(Role::RenderVisibleGeometry, frame, times, draw);
    }

    /// The picture of `frame`, which `Output::Render` asked for, has this hash; finding it took so long.
    pub fn handle_hashed(&mut self, _now: Nanos, frame: FrameIndex, hash: u64, hashing: Nanos) {
        if self.stage == Stage::Ended {
            return;
        }
        assert!(self.unhashed.remove(&frame), "the picture of frame {frame} is hashed once");
        self.send(Peer::Coordinator, Message::PictureHash { frame, hash, hashing });
        self.leave_if_done();
    }

    /// The driver cannot go on.
    pub fn handle_failure(&mut self, _now: Nanos, kind: FailureKind, reason: String) {
        self.fail(kind, reason);
    }

    /// Time has passed.
    pub fn handle_timeout(&mut self, now: Nanos) {
        while self.stage != Stage::Ended
            && let Some(due) = self.watch.due(now)
        {
            match due {
                Due::Ping(seat) => {
                    let ping = self.watch.ping(now);
                    self.send(Peer::Seat(seat), ping);
                }
                Due::Silent(peer) => {
                    let seconds = PEER_TIMEOUT / 1_000_000_000;
                    let reason = format!("{peer} has been silent for {seconds} s");
                    self.fail(FailureKind::Unavailable, reason);
                }
                Due::Lost(seat) => {
                    let reason = format!("seat {seat} has hung up in the middle of the run");
                    self.fail(FailureKind::Unavailable, reason);
                }
            }
        }
    }

    /// What to do next; call until there is none.
    pub fn poll_output(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// When `handle_timeout` is to be called at the latest.
    pub fn poll_timeout(&self) -> Option<Nanos> {
        if self.stage == Stage::Ended { None } else { self.watch.next() }
    }

    fn handle_drawn(&mut self, role: Role, frame: FrameIndex, times: WorkTimes, draw: DrawCounts) {
        if self.stage == Stage::Ended {
            return;
        }
        self.assert_working(role, frame);
        let input = match role {
            Role::OcclusionRepresentation => frame.0.checked_sub(1).map(FrameIndex),
            _ => Some(frame),
        };
        let received = input.and_then(|input| self.sets.get(input)?.received);
        self.report(times, |work| {
            work.visible_received = received;
            work.draw = Some(draw);
        });
    }

    fn report(&mut self, times: WorkTimes, fill: impl FnOnce(&mut WorkReport)) {
        let Some(beat) = &mut self.beat else { return };
        let Some((role, frame)) = beat.role else { return };
        beat.progress = Progress::Done;
        let mut work = WorkReport {
            role,
            frame,
            phase_received: beat.received,
            started: times.started,
            finished: times.finished,
            visible_sent: None,
            visible_received: None,
            cull: None,
            draw: None,
        };
        fill(&mut work);
        self.send_report(times.io, Some(work));
    }

    fn send_report(&mut self, io: IoCounts, work: Option<WorkReport>) {
        let Some(beat) = &self.beat else { return };
        let report = PhaseReport {
            phase: beat.phase,
            work,
            sent: self.process.sent.clone(),
            sent_control: self.process.sent_control,
            io,
            peak_rss: self.process.peak_rss,
            peak_resident: self.process.peak_resident,
        };
        self.send(Peer::Coordinator, Message::PhaseDone(report));
    }

    fn send_chunks(&mut self, frame: FrameIndex, chunks: &[DeltaChunk]) {
        let schedule = self.settings().schedule;
        let base = schedule::delta_base(schedule, frame);
        for seat in schedule::receivers(schedule, frame) {
            for chunk in chunks {
                let chunk = chunk.clone();
                self.send(Peer::Seat(seat), Message::Delta { frame, base, chunk });
            }
        }
    }

    fn send(&mut self, to: Peer, message: Message) {
        self.outputs.push_back(Output::Send { to, message });
    }

    fn fail(&mut self, kind: FailureKind, reason: String) {
        if self.stage == Stage::Ended {
            return;
        }
        self.stage = Stage::Ended;
        self.send(Peer::Coordinator, Message::failed(kind, &reason));
        self.outputs.push_back(Output::Failed { kind, reason });
    }

    /// Takes leave once it is time to and nothing is owed.
    fn leave_if_done(&mut self) {
        if self.stage == Stage::Leaving && self.unhashed.is_empty() {
            self.send(Peer::Coordinator, Message::Bye);
            self.stage = Stage::Ended;
            self.outputs.push_back(Output::Finished);
        }
    }

    fn has_reported_last_phase(&self) -> bool {
        self.beat.as_ref().is_some_and(|beat| {
            let settings = self.settings();
            beat.progress == Progress::Done
                && beat.phase == schedule::last_phase(settings.schedule, settings.frames)
        })
    }

    /// What the run is; only after the welcome.
    fn settings(&self) -> &RunSettings {
        let membership = self.membership.as_ref();
        &membership.expect("a node works only after its welcome").settings
    }

    fn assert_working(&self, role: Role, frame: FrameIndex) {
        let expected = self
            .beat
            .as_ref()
            .is_some_and(|b| b.progress == Progress::Working && b.role == Some((role, frame)));
        assert!(expected, "{role:?} of frame {frame} is not under way");
    }

    /// Falsifies V_`frame`, as a fault would.
    #[cfg(test)]
    pub(crate) fn corrupt(&mut self, frame: FrameIndex) {
        self.sets.corrupt(frame);
    }
}

#[cfg(test)]
mod tests;
