//! Pumps one node's session: messages and finished work in, messages and work out.
//!
//! The session lives in one task, rendering on a thread of its own ([`crate::worker`]), so that a
//! ping is answered while a long cull runs.

use crate::net::{self, Inbox, LinkError, Outbox, PeerLink, Peers, Stream};
use crate::pictures::Hashed;
use crate::role::Coming;
use crate::telemetry::{Clock, peak_rss};
use crate::worker::{Done, Job, Worker};
use crate::{NodeError, worker};
use protocol::camera::Camera;
use protocol::id::{FrameIndex, Seat};
use protocol::message::{FailureKind, Message, Token};
use protocol::schedule::{self, Phase, Role};
use protocol::session::node::{Node, Output, Peer, ProcessState};
use protocol::settings::{Cull, RunSettings};
use protocol::telemetry::LinkBytes;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::sync::mpsc;

/// Events that may wait for the session; readers and the worker wait beyond that.
const QUEUED: usize = 256;
/// Drawings to come that the worker is told of: the phase's own, and what is looked ahead at after it.
const DRAWINGS_TOLD: usize = 3;
/// How long a node that is done waits for the coordinator to hang up.
const FAREWELL: Duration = Duration::from_secs(10);

/// What reaches the session's task.
pub(crate) enum Event {
    /// A message came.
    Message(Peer, Message),
    /// A link ended.
    Closed(Peer),
    /// Every peer is linked, or one is not.
    Joined(Result<Vec<PeerLink>, LinkError>),
    /// The render thread has something to say.
    Done(Done),
}

/// What a node is started with.
pub(crate) struct Start {
    /// The link to the coordinator.
    pub(crate) control: Box<dyn Stream>,
    /// The way to the other nodes.
    pub(crate) peers: Peers,
    /// Where they are told to call.
    pub(crate) peer_address: String,
    /// The run's secret.
    pub(crate) token: Token,
}

/// Runs a node until the run ends.
pub(crate) async fn drive(start: Start) -> Result<(), NodeError> {
    let clock = Clock::start();
    let (sender, mut events) = mpsc::channel(QUEUED);
    let (control, mut inbox) = net::link(start.control);
    inbox.trust();
    tokio::spawn(read(Peer::Coordinator, inbox, sender.clone()));
    let worker = Worker::start(clock, sender.clone());
    let node = Node::new(clock.now(), start.token, start.peer_address, std::process::id());
    let mut runner = Runner {
        clock,
        node,
        token: start.token,
        peers: Some(start.peers),
        links: BTreeMap::from([(Peer::Coordinator, control)]),
        worker,
        prepared: Prepared::default(),
        run: None,
        camera: None,
        events: sender,
    };
    let outcome = loop {
        if let Some(outcome) = runner.drain().await {
            break outcome;
        }
        let deadline = runner.node.poll_timeout().map(|at| clock.instant(at));
        tokio::select! {
            Some(event) = events.recv() => runner.handle(event),
            () = sleep_until(deadline) => runner.node.handle_timeout(clock.now()),
        }
    };
    runner.leave(events, outcome).await
}

/// Waits for `deadline`, for ever if there is none.
async fn sleep_until(deadline: Option<std::time::Instant>) {
    match deadline {
        Some(deadline) => tokio::time::sleep_until(deadline.into()).await,
        None => std::future::pending().await,
    }
}

/// Hands over what comes on a link until it ends.
async fn read(from: Peer, mut inbox: Inbox, events: mpsc::Sender<Event>) {
    loop {
        match inbox.receive().await {
            Ok(Some(message)) => {
                if events.send(Event::Message(from, message)).await.is_err() {
                    return;
                }
            }
            Ok(None) => break,
            Err(error) => {
                tracing::warn!("the link to {from} is lost: {error}");
                break;
            }
        }
    }
    // The session may have ended meanwhile.
    let _ = events.send(Event::Closed(from)).await;
}

/// Both halves of being ready.
#[derive(Default)]
struct Prepared {
    opened: Option<worker::Opened>,
    joined: bool,
}

struct Runner {
    clock: Clock,
    node: Node,
    token: Token,
    peers: Option<Peers>,
    links: BTreeMap<Peer, Outbox>,
    worker: Worker,
    prepared: Prepared,
    run: Option<(Seat, RunSettings)>,
    /// C_{i+1} of the last phase message.
    camera: Option<Camera>,
    events: mpsc::Sender<Event>,
}

impl Runner {
    fn handle(&mut self, event: Event) {
        let now = self.clock.now();
        match event {
            Event::Message(from, message) => {
                if let Message::Phase { phase, next_camera } = &message {
                    self.prepare(*phase, *next_camera);
                    self.node.update_process(self.process_state());
                }
                self.node.handle_message(now, from, message);
            }
            Event::Closed(peer) => {
                self.links.remove(&peer);
                self.node.handle_disconnect(now, peer);
            }
            Event::Joined(Ok(links)) => {
                for (seat, outbox, inbox) in links {
                    self.links.insert(Peer::Seat(seat), outbox);
                    tokio::spawn(read(Peer::Seat(seat), inbox, self.events.clone()));
                }
                self.prepared.joined = true;
                self.tell_prepared();
            }
            Event::Joined(Err(error)) => {
                let reason = format!("the nodes cannot link up: {error}");
                self.node.handle_failure(now, FailureKind::Unavailable, reason);
            }
            Event::Done(done) => {
                self.node.update_process(self.process_state());
                self.handle_done(done);
            }
        }
    }

    fn handle_done(&mut self, done: Done) {
        let now = self.clock.now();
        match done {
            Done::Opened(opened) => {
                self.prepared.opened = Some(opened);
                self.tell_prepared();
            }
            Done::Occluded { frame, times, counts } => {
                self.node.handle_occluded(now, frame, times, counts);
            }
            Done::Culled { frame, visible, times, counts } => {
                if let Some(&last) = visible.ids().last() {
                    self.node.handle_culled_part(now, frame, last, visible.ids());
                }
                self.node.handle_culled(now, frame, times, counts);
            }
            Done::Rendered { frame, times, counts } => {
                self.node.handle_rendered(now, frame, times, counts);
            }
            Done::Hashed(Hashed { frame, hash, hashing }) => {
                self.node.handle_hashed(now, frame, hash, hashing);
            }
            Done::Failed(error) => self.node.handle_failure(now, error.kind, error.reason),
        }
    }

    fn tell_prepared(&mut self) {
        if self.prepared.joined
            && let Some(opened) = self.prepared.opened.take()
        {
            let worker::Opened { scene_digest, hlods, backend } = opened;
            self.node.handle_prepared(self.clock.now(), scene_digest, hlods, backend);
        }
    }

    /// Lets the worker prepare a phase before the visible set it waits for has come.
    fn prepare(&mut self, phase: Phase, next_camera: Option<Camera>) {
        let present = std::mem::replace(&mut self.camera, next_camera);
        let Some((seat, settings)) = &self.run else { return };
        let next_frame = u32::try_from(phase.0 + 1).ok().map(FrameIndex);
        let work = schedule::role(settings.schedule, *seat, phase, settings.frames);
        let front = match work {
            Some((_, frame)) if Some(frame) == next_frame => next_camera,
            Some((_, frame)) if i64::from(frame.0) == i64::from(phase.0) => present,
            _ => None,
        };
        let draws = |role| match role {
            Role::OcclusionRepresentation => settings.cull != Cull::Off,
            Role::HardwareCull => false,
            Role::RenderVisibleGeometry => true,
        };
        let coming = schedule::work_from(settings.schedule, *seat, phase, settings.frames)
            .filter_map(|(role, frame)| draws(role).then_some(frame))
            .take(DRAWINGS_TOLD)
            .collect();
        let newest = next_frame.zip(next_camera);
        self.worker.order(Job::Prepare(Coming { newest, front, draws: coming }));
    }

    /// Does what the session wants until it wants nothing; some once the run is over for this node.
    async fn drain(&mut self) -> Option<Result<(), NodeError>> {
        while let Some(output) = self.node.poll_output() {
            match output {
                Output::Send { to, message } => self.send(to, message).await,
                Output::Prepare { seat, settings, peers } => {
                    self.run = Some((seat, settings.clone()));
                    self.worker.order(Job::Open { settings });
                    let (token, events) = (self.token, self.events.clone());
                    let way = self.peers.take().expect("a session prepares once");
                    tokio::spawn(async move {
                        let joined = net::join_peers(way, seat, token, &peers).await;
                        // The session may have ended meanwhile.
                        let _ = events.send(Event::Joined(joined)).await;
                    });
                }
                Output::Occlude { frame, camera, occluders } => {
                    self.worker.order(Job::Occlude { frame, camera, occluders });
                }
                Output::Cull { frame, camera } => self.worker.order(Job::Cull { frame, camera }),
                Output::Render { frame, camera, visible } => {
                    self.worker.order(Job::Render { frame, camera, visible });
                }
                Output::Finished => return Some(Ok(())),
                Output::Failed { kind, reason } => {
                    let told = self.run.is_some() && self.links.contains_key(&Peer::Coordinator);
                    return Some(Err(NodeError { kind, reason, told }));
                }
            }
        }
        None
    }

    async fn send(&mut self, to: Peer, mut message: Message) {
        if let Message::PhaseDone(report) = &mut message {
            // What this phase sent is on the sockets by now, and was not when the report was made.
            let state = self.process_state();
            (report.sent, report.sent_control) = (state.sent, state.sent_control);
        }
        let Some(link) = self.links.get_mut(&to) else { return };
        if let Err(error) = link.send(&message).await {
            tracing::warn!("cannot send to {to}: {error}");
            self.links.remove(&to);
            // The reader of a broken link notices and tells the session; that of a stuck one waits on.
            if matches!(error, LinkError::Stuck) {
                self.node.handle_disconnect(self.clock.now(), to);
            }
        }
    }

    fn process_state(&self) -> ProcessState {
        let sent = self.links.iter().filter_map(|(peer, link)| match peer {
            Peer::Seat(to) => Some(LinkBytes { to: *to, bytes: link.sent }),
            Peer::Coordinator => None,
        });
        ProcessState {
            sent: sent.collect(),
            sent_control: self.links.get(&Peer::Coordinator).map_or(0, |link| link.sent),
            peak_rss: peak_rss(),
            peak_resident: self.worker.peak_resident(),
        }
    }

    /// Lets the render thread end its work, after a failure only what it is at, and waits until the coordinator
    /// hangs up: a socket closed with bytes unread is reset, which could cost the other end this node's
    /// last words. A failure is told before the thread ends, success after it.
    async fn leave(
        mut self,
        mut events: mpsc::Receiver<Event>,
        outcome: Result<(), NodeError>,
    ) -> Result<(), NodeError> {
        let farewell = async move {
            while let Some(event) = events.recv().await {
                if matches!(event, Event::Closed(Peer::Coordinator)) {
                    break;
                }
            }
        };
        let linked = self.links.contains_key(&Peer::Coordinator);
        if let Err(error) = outcome {
            self.worker.abandon();
            self.hang_up().await;
            // A coordinator that never hangs up is left all the same, and so is a render thread that
            // never ends; what the thread still says nobody hears.
            let _ = tokio::join!(
                tokio::time::timeout(FAREWELL, self.worker.finish()),
                tokio::time::timeout(if linked { FAREWELL } else { Duration::ZERO }, farewell),
            );
            return Err(error);
        }
        let flushed = self.worker.finish().await;
        self.hang_up().await;
        if linked {
            let _ = tokio::time::timeout(FAREWELL, farewell).await;
        }
        flushed
    }

    async fn hang_up(&mut self) {
        if let Some(control) = self.links.get_mut(&Peer::Coordinator) {
            control.hang_up().await;
        }
    }
}
