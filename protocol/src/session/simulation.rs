//! A run on a simulated network: one coordinator, three nodes, a seed, and a number for a clock.
//!
//! Every link keeps its order and nothing else: latencies are random, some very long. Messages pass
//! through the codec. The culler is a list of sets made beforehand; whoever is told to occlude or
//! draw with another set than that list's stops the test.

mod tests;

use super::coordinator::{Coordinator, LinkId, Output as CoordinatorOutput, Policy};
use super::node::{Node, Output, Peer, ProcessState, WorkTimes};
use crate::camera::Camera;
use crate::codec::{Decoder, encode};
use crate::id::{FrameIndex, HlodId, Seat};
use crate::message::{FailureKind, Message, Token};
use crate::schedule;
use crate::settings::{
    AuditAgainst, BackendChoice, Cull, PictureSize, Residency, RunSettings, Schedule,
};
use crate::sun::Sun;
use crate::telemetry::{BackendInfo, CullCounts, DrawCounts, Nanos};
use crate::visible::VisibleSet;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use std::collections::{BTreeMap, VecDeque};

const TOKEN: Token = Token([5; 32]);
const DIGEST: [u8; 32] = [9; 32];
const MS: Nanos = 1_000_000;

/// Hlods of the scene: more than [`walk`] names.
const HLODS: u32 = 6500;

/// An end of a link: a node by its index, or the coordinator.
const COORDINATOR: usize = 3;

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    None,
    /// The node on this seat dies after so many events; what it had sent is lost or not.
    Dies {
        seat: u8,
        after: usize,
        in_flight_lost: bool,
    },
    /// The node on this seat stops for good, its links stay open.
    Hangs {
        seat: u8,
        after: usize,
    },
    /// The render thread on this seat never ends this frame's work; the node itself lives.
    Stalls {
        seat: u8,
        frame: u32,
    },
    /// The picture thread on this seat never hashes this frame.
    LosesHash {
        seat: u8,
        frame: u32,
    },
    /// Nothing passes between these two seats any more.
    Cut {
        seats: [u8; 2],
        after: usize,
    },
    /// This seat's base of this frame is falsified before the frame's phase.
    Corrupts {
        seat: u8,
        frame: u32,
    },
}

#[derive(Debug)]
enum Event {
    Connect,
    Deliver { from: usize, to: usize, frame: Vec<u8> },
    HungUp { from: usize, to: usize },
    Work(usize, Work),
}

/// What a node's driver hands in.
#[derive(Debug)]
enum Work {
    Prepared,
    Occluded(FrameIndex),
    CulledPart(FrameIndex, HlodId, Vec<HlodId>),
    Culled(FrameIndex),
    Rendered(FrameIndex),
    Hashed(FrameIndex),
}

/// How an end of the run came out.
type Ending = Result<(), (FailureKind, String)>;

struct Simulation {
    rng: StdRng,
    now: Nanos,
    fault: Fault,
    settings: RunSettings,
    cameras: Vec<Camera>,
    expected: Vec<VisibleSet>,
    coordinator: Coordinator,
    nodes: Vec<Node>,
    decoders: BTreeMap<(usize, usize), Decoder>,
    /// Nodes and coordinator; a node that died or hangs has an ending of its own making.
    endings: [Option<Ending>; 4],
    /// Which node has which seat.
    node_of_seat: BTreeMap<Seat, usize>,
    seat_of_node: BTreeMap<usize, Seat>,
    events: BTreeMap<(Nanos, u64), Event>,
    sequence: u64,
    /// When the last byte on a link arrives.
    busy_until: BTreeMap<(usize, usize), Nanos>,
    rendered: Vec<FrameIndex>,
    whole_sets_wanted: usize,
    trace: Vec<CoordinatorOutput>,
    steps: usize,
}

impl Simulation {
    fn new(schedule: Schedule, frames: u32, seed: u64, fault: Fault) -> Self {
        let settings = RunSettings {
            scene_path: "plant.occ".into(),
            scene_digest: DIGEST,
            size: PictureSize { width: 64, height: 64 },
            lod_px: 1.0,
            sun: Sun::default(),
            cull: Cull::Queries,
            schedule,
            backend: BackendChoice::Cpu,
            frames,
            audit_every: 0,
            audit_against: AuditAgainst::Front,
            items_every: 0,
            memory: None,
            residency: Residency::Exact,
            prefetch: true,
            far: crate::settings::Far::Off,
            far_cubes: 8,
            far_triangles: None,
            pictures_dir: None,
        };
        let look = |i: u32| {
            Camera::look_at([f64::from(i), 0.0, 0.0], [0.0, 0.0, -9.0], [0.0, 1.0, 0.0], 60.0, 0.1)
                .unwrap()
        };
        let cameras: Vec<Camera> = (0..frames).map(look).collect();
        let mut simulation = Self {
            rng: StdRng::seed_from_u64(seed),
            now: 0,
            fault,
            expected: walk(frames),
            coordinator: Coordinator::new(
                0,
                TOKEN,
                settings.clone(),
                cameras.clone(),
                Policy::default(),
            ),
            settings,
            cameras,
            nodes: Vec::new(),
            decoders: BTreeMap::new(),
            endings: [const { None }; 4],
            node_of_seat: BTreeMap::new(),
            seat_of_node: BTreeMap::new(),
            events: BTreeMap::new(),
            sequence: 0,
            busy_until: BTreeMap::new(),
            rendered: Vec::new(),
            whole_sets_wanted: 0,
            trace: Vec::new(),
            steps: 0,
        };
        for i in 0..3 {
            simulation.nodes.push(Node::new(
                simulation.clock(i),
                TOKEN,
                format!("n:{i}"),
                i as u32,
            ));
            simulation.coordinator.handle_connected(0, LinkId(i as u32));
        }
        simulation.later(0, Event::Connect);
        simulation
    }

    /// Runs until all ends have come out.
    fn run(mut self) -> Self {
        while self.endings.iter().any(Option::is_none) {
            self.strike();
            let alarm = self.next_alarm();
            let event = self.events.first_key_value().map(|(&(at, _), _)| at);
            let next = [alarm, event].into_iter().flatten().min();
            self.now = self.now.max(next.expect("deadlock: nobody waits for anything"));
            assert!(self.now < 3_600_000 * MS, "the run never ends: {:?}", self.endings);
            if event.is_some_and(|at| at <= self.now) {
                let (_, event) = self.events.pop_first().unwrap();
                self.handle(event);
            }
            self.coordinator.handle_timeout(self.now);
            for i in 0..3 {
                let now = self.clock(i);
                if self.is_up(i) {
                    self.nodes[i].handle_timeout(now);
                }
            }
            self.drain();
            self.steps += 1;
        }
        self
    }

    /// Node `i`'s clock: each has its own start.
    fn clock(&self, i: usize) -> Nanos {
        self.now + [0, 77_000 * MS, 5][i]
    }

    fn is_up(&self, end: usize) -> bool {
        let hangs = matches!(self.fault, Fault::Hangs { seat, after }
            if self.steps >= after && self.seat_of_node.get(&end) == Some(&Seat(seat)));
        self.endings[end].is_none() && !hangs
    }

    fn next_alarm(&self) -> Option<Nanos> {
        let nodes = (0..3)
            .filter(|&i| self.is_up(i))
            .filter_map(|i| self.nodes[i].poll_timeout().map(|at| at - (self.clock(i) - self.now)));
        nodes.chain(self.coordinator.poll_timeout()).min()
    }

    /// Lets the fault happen when its time has come.
    fn strike(&mut self) {
        match self.fault {
            Fault::Dies { seat, after, in_flight_lost } if self.steps >= after => {
                let Some(&dead) = self.node_of_seat.get(&Seat(seat)) else { return };
                if self.endings[dead].is_some() {
                    return;
                }
                if in_flight_lost {
                    self.events.retain(
                        |_, event| !matches!(event, Event::Deliver { from, .. } if *from == dead),
                    );
                }
                self.end(dead, Err((FailureKind::Internal, "killed".into())));
            }
            Fault::Hangs { seat, after } if self.steps == after => {
                // It comes out only when all others have; see `end`.
                assert!(self.node_of_seat.contains_key(&Seat(seat)));
            }
            _ => {}
        }
    }

    fn later(&mut self, delay: Nanos, event: Event) {
        self.sequence += 1;
        self.events.insert((self.now + delay, self.sequence), event);
    }

    /// Puts something on a link, behind what is already on it.
    fn carry(&mut self, from: usize, to: usize, event: Event) {
        let latency = match self.rng.random_range(0..200) {
            0 => self.rng.random_range(0..3000 * MS),
            _ => self.rng.random_range(MS / 50..2 * MS),
        };
        let arrival =
            (self.now + latency).max(self.busy_until.get(&(from, to)).map_or(0, |t| t + 1));
        self.busy_until.insert((from, to), arrival);
        self.later(arrival - self.now, event);
    }

    fn send(&mut self, from: usize, to: usize, message: &Message) {
        if let Fault::Cut { seats, after } = self.fault
            && self.steps >= after
            && seats.iter().all(|&seat| {
                self.node_of_seat.get(&Seat(seat)).is_some_and(|&end| end == from || end == to)
            })
        {
            return;
        }
        self.whole_sets_wanted += usize::from(matches!(message, Message::WantFull { .. }));
        let mut frame = Vec::new();
        encode(message, &mut frame);
        self.carry(from, to, Event::Deliver { from, to, frame });
    }

    fn end(&mut self, end: usize, ending: Ending) {
        self.endings[end] = Some(ending);
        for other in (0..=COORDINATOR).filter(|&other| other != end) {
            self.carry(end, other, Event::HungUp { from: end, to: other });
        }
        if let Fault::Hangs { seat, .. } = self.fault
            && let Some(&hung) = self.node_of_seat.get(&Seat(seat))
            && self.endings.iter().enumerate().all(|(i, e)| i == hung || e.is_some())
        {
            self.endings[hung] = Some(Ok(()));
        }
    }

    fn peer(&self, end: usize) -> Peer {
        if end == COORDINATOR { Peer::Coordinator } else { Peer::Seat(self.seat_of_node[&end]) }
    }

    fn handle(&mut self, event: Event) {
        match event {
            Event::Connect => {}
            Event::Deliver { to, .. } | Event::HungUp { to, .. } if !self.is_up(to) => {}
            Event::Deliver { from, to, frame } => {
                let decoder = self.decoders.entry((from, to)).or_default();
                let cut = self.rng.random_range(0..=frame.len());
                decoder.push(&frame[..cut]);
                decoder.push(&frame[cut..]);
                let message = decoder.next().unwrap().unwrap();
                if to == COORDINATOR {
                    self.coordinator.handle_message(self.now, LinkId(from as u32), message);
                } else {
                    self.corrupt_before(to, &message);
                    let (now, peer) = (self.clock(to), self.peer(from));
                    self.nodes[to].handle_message(now, peer, message);
                }
            }
            Event::HungUp { from, to: COORDINATOR } => {
                self.coordinator.handle_disconnect(self.now, LinkId(from as u32));
            }
            // Nodes link up with each other only once all are seated.
            Event::HungUp { from, .. } if from < 3 && !self.seat_of_node.contains_key(&from) => {}
            Event::HungUp { from, to } => {
                let (now, peer) = (self.clock(to), self.peer(from));
                self.nodes[to].handle_disconnect(now, peer);
            }
            Event::Work(node, _) if !self.is_up(node) => {}
            Event::Work(node, work) => self.hand_in(node, work),
        }
    }

    fn corrupt_before(&mut self, node: usize, message: &Message) {
        if let (Fault::Corrupts { seat, frame }, Message::Phase { phase, .. }) =
            (self.fault, message)
            && self.seat_of_node[&node] == Seat(seat)
            && phase.0 == frame as i32
        {
            let base = schedule::delta_base(self.settings.schedule, FrameIndex(frame)).unwrap();
            self.nodes[node].corrupt(base);
        }
    }

    fn hand_in(&mut self, i: usize, work: Work) {
        let now = self.clock(i);
        let (node, times) = (&mut self.nodes[i], WorkTimes::default());
        node.update_process(ProcessState { peak_rss: 1, ..ProcessState::default() });
        match work {
            Work::Prepared => {
                let backend = BackendInfo { name: "cpu".into(), driver: String::new() };
                node.handle_prepared(now, DIGEST, HLODS, backend);
            }
            Work::Occluded(frame) => node.handle_occluded(now, frame, times, DrawCounts::default()),
            Work::CulledPart(frame, through, ids) => {
                node.handle_culled_part(now, frame, through, &ids);
            }
            Work::Culled(frame) => node.handle_culled(now, frame, times, CullCounts::default()),
            Work::Rendered(frame) => node.handle_rendered(now, frame, times, DrawCounts::default()),
            Work::Hashed(frame) => node.handle_hashed(now, frame, u64::from(frame.0), 1),
        }
    }

    fn drain(&mut self) {
        while let Some(output) = self.coordinator.poll_output() {
            self.trace.push(output.clone());
            match output {
                CoordinatorOutput::Send { to, message } => {
                    self.send(COORDINATOR, to.0 as usize, &message);
                }
                CoordinatorOutput::Seated { link, seat, .. } => {
                    self.node_of_seat.insert(seat, link.0 as usize);
                    self.seat_of_node.insert(link.0 as usize, seat);
                }
                CoordinatorOutput::Finished => self.end(COORDINATOR, Ok(())),
                CoordinatorOutput::Failed { kind, reason } => {
                    self.end(COORDINATOR, Err((kind, reason)));
                }
                _ => {}
            }
        }
        for i in 0..3 {
            while self.is_up(i)
                && let Some(output) = self.nodes[i].poll_output()
            {
                self.act(i, output);
            }
        }
    }

    /// A node's driver.
    fn act(&mut self, i: usize, output: Output) {
        let stalls = |frame| self.fault == Fault::Stalls { seat: self.seat_of_node[&i].0, frame };
        match output {
            Output::Occlude { frame: FrameIndex(frame), .. }
            | Output::Cull { frame: FrameIndex(frame), .. }
            | Output::Render { frame: FrameIndex(frame), .. }
                if stalls(frame) =>
            {
                return;
            }
            _ => {}
        }
        let delay = self.rng.random_range(0..20 * MS);
        match output {
            Output::Send { to: Peer::Coordinator, message } => self.send(i, COORDINATOR, &message),
            Output::Send { to: Peer::Seat(seat), message } => {
                self.send(i, self.node_of_seat[&seat], &message);
            }
            Output::Prepare { seat, .. } => {
                assert_eq!(seat, self.seat_of_node[&i]);
                self.later(delay * 300, Event::Work(i, Work::Prepared));
            }
            Output::Occlude { frame, camera, occluders } => {
                assert_eq!(camera, self.cameras[frame.index()]);
                let expected = frame.index().checked_sub(1).map(|before| &self.expected[before]);
                assert_eq!(*occluders, expected.cloned().unwrap_or_default());
                self.later(delay, Event::Work(i, Work::Occluded(frame)));
            }
            Output::Cull { frame, camera } => {
                assert_eq!(camera, self.cameras[frame.index()]);
                self.cull(i, frame);
            }
            Output::Render { frame, camera, visible } => {
                assert_eq!(camera, self.cameras[frame.index()]);
                assert_eq!(*visible, self.expected[frame.index()]);
                self.rendered.push(frame);
                self.later(delay, Event::Work(i, Work::Rendered(frame)));
                if self.fault
                    != (Fault::LosesHash { seat: self.seat_of_node[&i].0, frame: frame.0 })
                {
                    // Before the report or long after it.
                    let hashed_in = self.rng.random_range(0..60 * MS);
                    self.later(hashed_in, Event::Work(i, Work::Hashed(frame)));
                }
            }
            Output::Finished => self.end(i, Ok(())),
            Output::Failed { kind, reason } => self.end(i, Err((kind, reason))),
        }
    }

    /// Hands the expected set in, in parts.
    fn cull(&mut self, i: usize, frame: FrameIndex) {
        let mut left: VecDeque<HlodId> =
            self.expected[frame.index()].ids().iter().copied().collect();
        let mut at = 0;
        while !left.is_empty() {
            let part: Vec<HlodId> = left.drain(..self.rng.random_range(1..=left.len())).collect();
            at += self.rng.random_range(0..5 * MS);
            self.later(at, Event::Work(i, Work::CulledPart(frame, part[part.len() - 1], part)));
        }
        self.later(at + MS, Event::Work(i, Work::Culled(frame)));
    }
}

/// Visible sets of a walk: some frames change nothing, some little, one everything, one is empty.
fn walk(frames: u32) -> Vec<VisibleSet> {
    let set = |frame: u32| match frame {
        3 => VisibleSet::default(),
        7 => VisibleSet::from_sorted((0..3000).map(|i| HlodId(i * 2)).collect()),
        _ => {
            let ids = (0..400).map(|i| i * 11 + u32::from((i + frame / 2).is_multiple_of(17)));
            VisibleSet::from_sorted(ids.map(HlodId).collect())
        }
    };
    (0..frames).map(set).collect()
}
