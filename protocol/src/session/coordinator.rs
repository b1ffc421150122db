//! The coordinator's side of a run.
//!
//! Seats the nodes in the order they greet, aligns their clocks, paces the phases and ends the run.
//! This file holds what a driver calls and the run's order; `clock` the ping-pong; `links` who is at
//! the other end of each link; `blame` whom a run that cannot go on is held up by.

mod blame;
mod clock;
mod links;

use crate::camera::Camera;
use crate::id::{FrameIndex, Seat};
use crate::message::{FailureKind, MAX_ADDRESS_BYTES, Message, PeerAddress, Token, WIRE_VERSION};
use crate::schedule::{self, Phase, SEATS};
use crate::session::{HEARTBEAT, PEER_TIMEOUT, PHASE_LIMIT};
use crate::settings::RunSettings;
use crate::telemetry::{BackendInfo, Nanos, PhaseReport};
use clock::Pings;
use links::{Links, Member};
use std::collections::{BTreeSet, VecDeque};

/// Time in which a link must greet, nanoseconds.
pub const HELLO_TIMEOUT: Nanos = 10_000_000_000;

/// A connection, named by the driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkId(pub u32);

/// What a run puts up with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Policy {
    /// Seats may draw with different renderers, which voids the proof that no visible pixel is lost.
    pub mixed: bool,
    /// Time without any report after which a phase has failed.
    pub phase_limit: Nanos,
}

impl Default for Policy {
    fn default() -> Self {
        Self { mixed: false, phase_limit: PHASE_LIMIT }
    }
}

/// What the coordinator's driver must do, or may log.
#[derive(Debug, Clone, PartialEq)]
pub enum Output {
    /// Put a message on a link.
    Send {
        /// The link.
        to: LinkId,
        /// The message.
        message: Message,
    },
    /// Hang up once what is queued has been sent; no `handle_disconnect` is expected.
    Close {
        /// The link.
        link: LinkId,
        /// Why, for the log.
        why: Option<String>,
    },
    /// A node has taken its seat.
    Seated {
        /// Its link.
        link: LinkId,
        /// Its seat.
        seat: Seat,
        /// Its process.
        pid: u32,
    },
    /// A node has the scene open and its backend up.
    Ready {
        /// Its seat.
        seat: Seat,
        /// Its renderer.
        backend: BackendInfo,
    },
    /// A node's clock: coordinator's time = node's time + `offset`, give or take `error`; nanoseconds.
    Clock {
        /// Its seat.
        seat: Seat,
        /// To be added to the node's times.
        offset: i64,
        /// Half the least round trip.
        error: Nanos,
        /// Median round trip.
        round_trip_p50: Nanos,
    },
    /// A phase is broadcast.
    PhaseStarted {
        /// The phase.
        phase: Phase,
        /// When.
        at: Nanos,
    },
    /// A seat has reported.
    Report {
        /// The seat.
        seat: Seat,
        /// What it says.
        report: PhaseReport,
    },
    /// A picture is hashed.
    Picture {
        /// The frame.
        frame: FrameIndex,
        /// Its hash.
        hash: u64,
        /// How long hashing took, nanoseconds.
        hashing: Nanos,
    },
    /// All seats have reported.
    PhaseEnded {
        /// The phase.
        phase: Phase,
        /// When.
        at: Nanos,
    },
    /// The run is over and all nodes have taken leave.
    Finished,
    /// The run has failed; the nodes have been told.
    Failed {
        /// The class of failure.
        kind: FailureKind,
        /// One sentence for a person, naming the seat.
        reason: String,
    },
}

/// How far the run has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// Fewer than three nodes are seated.
    Joining,
    /// The nodes open the scene.
    Preparing,
    /// Clocks are being aligned.
    Aligning,
    /// A phase is under way.
    Running(Phase),
    /// The nodes take leave.
    Finishing,
    Ended,
}

/// The coordinator's session: a state machine, driven as [`crate::session`] says.
#[derive(Debug)]
pub struct Coordinator {
    stage: Stage,
    outputs: VecDeque<Output>,
    token: Token,
    settings: RunSettings,
    cameras: Vec<Camera>,
    policy: Policy,
    links: Links,
    /// Pictures that are hashed.
    hashed: BTreeSet<FrameIndex>,
    /// When the phase, or the leave-taking, began.
    began: Nanos,
    /// When it last came any further.
    progress: Nanos,
}

impl Coordinator {
    /// Waits for nodes from now on.
    ///
    /// # Panics
    /// Unless there is at least one camera, and one for each of the run's frames.
    pub fn new(
        now: Nanos,
        token: Token,
        settings: RunSettings,
        cameras: Vec<Camera>,
        policy: Policy,
    ) -> Self {
        assert!(!cameras.is_empty(), "a run has at least one frame");
        assert_eq!(cameras.len(), settings.frames as usize, "every frame has one camera");
        Self {
            stage: Stage::Joining,
            outputs: VecDeque::new(),
            token,
            settings,
            cameras,
            policy,
            links: Links::default(),
            hashed: BTreeSet::new(),
            began: now,
            progress: now,
        }
    }

    /// A link was accepted.
    pub fn handle_connected(&mut self, now: Nanos, link: LinkId) {
        self.links.connected(now, link);
    }

    /// A message came over `link`.
    pub fn handle_message(&mut self, now: Nanos, link: LinkId, message: Message) {
        if self.stage == Stage::Ended {
            return;
        }
        if self.links.is_waiting(link) {
            return self.greet(now, link, message);
        }
        // What was on its way when the link was closed from here is of no interest.
        let Some(member) = self.links.member_mut(link) else { return };
        member.heard = now;
        let (seat, name) = (member.seat, message.name());
        if let Err(offence) = self.hear_member(now, seat, message) {
            let offence = offence.unwrap_or_else(|| format!("sent {name} out of turn"));
            self.fail(FailureKind::Protocol, format!("seat {seat} {offence}"), None);
        }
    }

    /// A link has ended.
    pub fn handle_disconnect(&mut self, _now: Nanos, link: LinkId) {
        self.links.forget_waiting(link);
        let Some(member) = self.links.member_mut(link) else { return };
        if self.stage == Stage::Ended || member.is_gone {
            return;
        }
        let (seat, pid) = (member.seat, member.pid);
        member.is_gone = true;
        let reason = format!("seat {seat} (process {pid}) has hung up in the middle of the run");
        self.fail(FailureKind::Unavailable, reason, Some(seat));
    }

    /// Time has passed.
    pub fn handle_timeout(&mut self, now: Nanos) {
        if self.stage == Stage::Ended {
            return;
        }
        for link in self.links.give_up_waiting(now) {
            self.close(link, "it did not greet within 10 s");
        }
        for seat in self.links.seats() {
            let member = self.links.seat_mut(seat);
            if member.is_gone {
                continue;
            }
            if now >= member.silence_ends() {
                let seconds = PEER_TIMEOUT / 1_000_000_000;
                let reason = format!("seat {seat} has been silent for {seconds} s");
                return self.fail(FailureKind::Unavailable, reason, Some(seat));
            }
            if now >= member.next_heartbeat() {
                member.pinged = now;
                if let Some(ping) = member.pings.send(now) {
                    self.send(seat, ping);
                }
            }
        }
        if self.limit_ends().is_some_and(|at| now >= at) {
            let reason = self.blame(now);
            self.fail(FailureKind::Unavailable, reason, None);
        }
    }

    /// When `handle_timeout` is to be called at the latest.
    pub fn poll_timeout(&self) -> Option<Nanos> {
        match self.stage {
            Stage::Ended => None,
            _ => self.links.next_alarm().into_iter().chain(self.limit_ends()).min(),
        }
    }

    /// When a run that comes no further has failed.
    fn limit_ends(&self) -> Option<Nanos> {
        let paced = matches!(self.stage, Stage::Running(_) | Stage::Finishing);
        paced.then(|| self.progress.saturating_add(self.policy.phase_limit))
    }

    /// What to do next; call until there is none.
    pub fn poll_output(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// First words of a link that has no seat yet.
    fn greet(&mut self, now: Nanos, link: LinkId, message: Message) {
        self.links.forget_waiting(link);
        let Message::Hello { version, token, peer_address: address, pid } = message else {
            return self.close(link, "it did not greet first");
        };
        // A stranger is told nothing, not even the version.
        if !token.matches(&self.token) {
            return self.close(link, "it does not know this run's token");
        }
        if version != WIRE_VERSION {
            let reason = format!(
                "process {pid} speaks wire version {version}, the coordinator version \
                 {WIRE_VERSION}; use one version of the program everywhere"
            );
            self.refuse(link, FailureKind::Protocol, &reason);
            return self.fail(FailureKind::Protocol, reason, None);
        }
        if address.len() > MAX_ADDRESS_BYTES {
            return self.refuse(link, FailureKind::Protocol, "its peer address is too long");
        }
        let seats = self.links.seats();
        let Some(&seat) = SEATS.get(seats.len()) else {
            return self.refuse(link, FailureKind::NotAllowed, "all three seats are taken");
        };
        self.links.seat(Member::new(now, link, seat, pid, address));
        self.outputs.push_back(Output::Seated { link, seat, pid });
        if self.links.seats().len() == SEATS.len() {
            self.stage = Stage::Preparing;
            let peers: Vec<PeerAddress> = self.links.addresses();
            for seat in SEATS {
                let (peers, settings) = (peers.clone(), self.settings.clone());
                self.send(seat, Message::Welcome { seat, peers, settings });
            }
        }
    }

    /// A seated node's message. The error is what it did wrong; none: it spoke out of turn.
    fn hear_member(
        &mut self,
        now: Nanos,
        seat: Seat,
        message: Message,
    ) -> Result<(), Option<String>> {
        let (stage, member) = (self.stage, self.links.seat_mut(seat));
        match message {
            Message::Pong { sequence, sent, answered } => {
                if !member.pings.answered(now, sequence, sent, answered) {
                    return Err(Some("answered a ping that was not sent".into()));
                }
                if stage == Stage::Aligning {
                    self.align(now);
                }
            }
            Message::Ready { scene_digest, backend }
                if stage == Stage::Preparing && member.renderer.is_none() =>
            {
                if scene_digest != self.settings.scene_digest {
                    let reason = format!("seat {seat} has opened another scene file");
                    self.fail(FailureKind::NotAllowed, reason, None);
                    return Ok(());
                }
                member.renderer = Some(backend.clone());
                self.outputs.push_back(Output::Ready { seat, backend });
                if self.links.all(|member| member.renderer.is_some()) {
                    if let Some(reason) = self.different_renderers().filter(|_| !self.policy.mixed)
                    {
                        self.fail(FailureKind::NotAllowed, reason, None);
                        return Ok(());
                    }
                    self.stage = Stage::Aligning;
                    self.links.for_each(|member| member.pings.start_over());
                    self.align(now);
                }
            }
            Message::PhaseDone(report)
                if stage == Stage::Running(report.phase) && !member.is_done =>
            {
                self.check_report(seat, &report)?;
                self.links.seat_mut(seat).is_done = true;
                self.progress = now;
                let phase = report.phase;
                self.outputs.push_back(Output::Report { seat, report });
                if self.links.all(|member| member.is_done) {
                    self.outputs.push_back(Output::PhaseEnded { phase, at: now });
                    self.begin_phase(now, phase.next());
                }
            }
            Message::PictureHash { frame, hash, hashing } => {
                self.check_picture(seat, frame)?;
                self.hashed.insert(frame);
                if stage == Stage::Finishing {
                    self.progress = now;
                }
                self.outputs.push_back(Output::Picture { frame, hash, hashing });
            }
            Message::Bye if stage == Stage::Finishing && !member.is_gone => {
                if let Some(frame) = self.unhashed(seat).next() {
                    let offence =
                        format!("took leave and has not hashed the picture of frame {frame}");
                    return Err(Some(offence));
                }
                self.links.seat_mut(seat).is_gone = true;
                self.progress = now;
                if self.links.all(|member| member.is_gone) {
                    self.stage = Stage::Ended;
                    self.outputs.push_back(Output::Finished);
                }
            }
            Message::Failed { kind, reason } => {
                self.fail(kind, format!("seat {seat}: {reason}"), Some(seat));
            }
            _ => return Err(None),
        }
        Ok(())
    }

    /// The work reported must be what the schedule has for that seat.
    fn check_report(&self, seat: Seat, report: &PhaseReport) -> Result<(), Option<String>> {
        let RunSettings { schedule, frames, .. } = self.settings;
        let due = schedule::role(schedule, seat, report.phase, frames);
        if report.work.map(|work| (work.role, work.frame)) == due {
            return Ok(());
        }
        Err(Some(format!("reported work that was not its own in phase {}", report.phase.0)))
    }

    /// A picture must be hashed once, by the seat that draws it, and not before its phase has begun.
    fn check_picture(&self, seat: Seat, frame: FrameIndex) -> Result<(), Option<String>> {
        let RunSettings { schedule, frames, .. } = self.settings;
        let is_own = frame.0 < frames
            && schedule::seat_of(schedule, schedule::Role::RenderVisibleGeometry, frame) == seat;
        let is_due = match self.stage {
            Stage::Running(phase) => is_own && schedule::drawn_in(schedule, frame) <= phase,
            Stage::Finishing => is_own,
            _ => false,
        };
        if is_due && !self.hashed.contains(&frame) { Ok(()) } else { Err(None) }
    }

    /// Pictures of `seat` that are not hashed.
    fn unhashed(&self, seat: Seat) -> impl Iterator<Item = FrameIndex> {
        let RunSettings { schedule, frames, .. } = self.settings;
        let drawn_by =
            move |frame| schedule::seat_of(schedule, schedule::Role::RenderVisibleGeometry, frame);
        (0..frames)
            .map(FrameIndex)
            .filter(move |&frame| drawn_by(frame) == seat && !self.hashed.contains(&frame))
    }

    /// Sends each node its next ping; ends when all have answered often enough.
    fn align(&mut self, now: Nanos) {
        for seat in SEATS {
            let pings = &mut self.links.seat_mut(seat).pings;
            if pings.estimate().is_none()
                && let Some(ping) = pings.send(now)
            {
                self.send(seat, ping);
            }
        }
        let estimates = SEATS.map(|seat| self.links.seat_mut(seat).pings.estimate());
        if estimates.iter().any(Option::is_none) {
            return;
        }
        for (seat, estimate) in SEATS.into_iter().zip(estimates.into_iter().flatten()) {
            let clock::Estimate { offset, error, round_trip_p50 } = estimate;
            self.outputs.push_back(Output::Clock { seat, offset, error, round_trip_p50 });
        }
        self.begin_phase(now, Phase::FIRST);
    }

    fn begin_phase(&mut self, now: Nanos, phase: Phase) {
        (self.began, self.progress) = (now, now);
        if phase > schedule::last_phase(self.settings.schedule, self.settings.frames) {
            self.stage = Stage::Finishing;
            return SEATS.into_iter().for_each(|seat| self.send(seat, Message::Finish));
        }
        self.stage = Stage::Running(phase);
        self.links.for_each(|member| member.is_done = false);
        self.outputs.push_back(Output::PhaseStarted { phase, at: now });
        let next_camera = self.cameras.get(phase.next().0 as usize).copied();
        for seat in SEATS {
            self.send(seat, Message::Phase { phase, next_camera });
        }
    }

    fn send(&mut self, to: Seat, message: Message) {
        let to = self.links.seat_mut(to).link;
        self.outputs.push_back(Output::Send { to, message });
    }

    fn close(&mut self, link: LinkId, why: &str) {
        self.outputs.push_back(Output::Close { link, why: Some(why.into()) });
    }

    /// Tells a node that knows the token why it cannot join.
    fn refuse(&mut self, link: LinkId, kind: FailureKind, reason: &str) {
        let message = Message::failed(kind, reason);
        self.outputs.push_back(Output::Send { to: link, message });
        self.close(link, reason);
    }

    /// Ends the run; all seats but the one that `ended` itself are told.
    fn fail(&mut self, kind: FailureKind, reason: String, ended: Option<Seat>) {
        self.stage = Stage::Ended;
        for seat in self.links.seats().into_iter().filter(|&seat| Some(seat) != ended) {
            self.send(seat, Message::failed(kind, &reason));
        }
        self.outputs.push_back(Output::Failed { kind, reason });
    }
}

#[cfg(test)]
mod tests;
