//! A run from the first process to the last picture: starts the nodes, pumps the session, keeps the
//! record.

use crate::launch::{Children, PATIENCE};
use crate::net::{self, Event, Outbox};
use crate::record::{PhaseRecord, PictureRecord, RunRecord};
use crate::tally::Tally;
use protocol::camera::Camera;
use protocol::message::{FailureKind, Message, Token};
use protocol::schedule::SEATS;
use protocol::session::coordinator::{Coordinator, LinkId, Output, Policy};
use protocol::settings::RunSettings;
use protocol::telemetry::Nanos;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use tokio::io::DuplexStream;
use tokio::net::TcpListener;
use tokio::sync::{mpsc, oneshot};

/// Events that may wait for the session; readers wait beyond that.
const QUEUED: usize = 256;
/// Bytes in flight in a pipe inside one process.
const PIPE_BYTES: usize = 64 << 10;
/// How long after a node's end the reason it gave may still be on its way.
const LAST_WORDS: Duration = Duration::from_millis(500);
/// How long nodes may take to write their last pictures.
const FLUSH: Duration = Duration::from_secs(60);

/// Runs three nodes inside this process, each on one end of a link to the coordinator, until the run
/// ends.
pub type RunThreads = Box<dyn FnOnce([DuplexStream; 3], Token) -> Result<(), RunError> + Send>;

/// Where the nodes live.
pub enum Rig {
    /// Three children of this process, which call `bind`.
    Children {
        /// The program; its verb `node` is a render process.
        program: PathBuf,
        /// Where to listen; port 0 takes a free one.
        bind: SocketAddr,
    },
    /// Three threads of this process.
    Threads(RunThreads),
}

/// What to run.
pub struct RunPlan {
    /// What the nodes are told.
    pub settings: RunSettings,
    /// Camera of each frame.
    pub cameras: Vec<Camera>,
    /// Where the nodes live.
    pub rig: Rig,
    /// What the run puts up with.
    pub policy: Policy,
    /// Most bytes of geometry and textures that each process was given, for the record.
    pub memory_cap: Option<u64>,
}

/// Why a run did not end as it should.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RunError {
    /// Ctrl-C or a request to terminate.
    #[error("interrupted")]
    Interrupted,
    /// Anything else.
    #[error("{reason}")]
    Failed {
        /// The class, which maps on an exit code.
        kind: FailureKind,
        /// One sentence for a person.
        reason: String,
    },
}

impl RunError {
    pub(crate) fn new(kind: FailureKind, reason: impl Into<String>) -> Self {
        Self::Failed { kind, reason: reason.into() }
    }
}

/// Runs `plan` and returns the record; `progress` sees each phase as it ends.
///
/// When this returns, no node is left: each has ended by itself or was killed.
pub fn run(plan: RunPlan, progress: &mut dyn FnMut(&PhaseRecord)) -> Result<RunRecord, RunError> {
    let unavailable = |what: &str, error: &dyn std::fmt::Display| {
        RunError::new(FailureKind::Unavailable, format!("{what}: {error}"))
    };
    let mut secret = [0; 32];
    getrandom::fill(&mut secret).map_err(|e| unavailable("cannot draw a random token", &e))?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|e| unavailable("cannot start the network reactor", &e))?;
    runtime.block_on(conduct(plan, Token(secret), progress))
}

async fn conduct(
    plan: RunPlan,
    token: Token,
    progress: &mut dyn FnMut(&PhaseRecord),
) -> Result<RunRecord, RunError> {
    let RunPlan { settings, cameras, rig, policy, memory_cap } = plan;
    let interrupted = interrupted();
    tokio::pin!(interrupted);
    let (sender, mut events) = mpsc::channel(QUEUED);
    let processes = if matches!(rig, Rig::Children { .. }) { 3 } else { 1 };
    let mut nodes = Nodes::start(rig, token, &sender).await?;
    let start = Instant::now();
    let mut conductor = Conductor {
        start,
        session: Coordinator::new(0, token, settings.clone(), cameras, policy),
        links: BTreeMap::new(),
        tally: Tally::default(),
        control_sent: 0,
    };
    // A node that has ended badly, and until when its own word on it may come.
    let mut ended: Option<(RunError, tokio::time::Instant)> = None;
    let outcome = loop {
        if let Some(outcome) = conductor.drain(progress).await {
            break outcome;
        }
        let timer = conductor.session.poll_timeout();
        let timer = timer.map(|at| (start + Duration::from_nanos(at)).into());
        tokio::select! {
            () = &mut interrupted => break Err(RunError::Interrupted),
            Some(event) = events.recv() => conductor.handle(event),
            () = sleep_until(timer) => conductor.session.handle_timeout(conductor.now()),
            failure = nodes.next_failure(), if ended.is_none() => {
                ended = Some((failure, tokio::time::Instant::now() + LAST_WORDS));
            }
            () = sleep_until(ended.as_ref().map(|(_, at)| *at)) => {
                if let Some((failure, _)) = ended.take() {
                    break Err(failure);
                }
            }
        }
    };
    match outcome {
        Ok(()) => {
            conductor.hang_up().await;
            let flushed = tokio::select! {
                () = &mut interrupted => Err(RunError::Interrupted),
                flushed = nodes.flush(FLUSH) => flushed,
            };
            if let Err(error) = flushed {
                nodes.end(PATIENCE).await;
                return Err(error);
            }
            conductor.tally.finish(settings, processes, memory_cap)
        }
        Err(error) => {
            conductor.tell_all(&error).await;
            conductor.hang_up().await;
            let end = nodes.end(PATIENCE).await;
            Err(better(error, ended.map(|(failure, _)| failure).or(end)))
        }
    }
}

/// Of what the session says and how a node ended, what explains more: a lost link is explained by the
/// end of the process behind it.
fn better(said: RunError, ended: Option<RunError>) -> RunError {
    match (&said, ended) {
        (
            RunError::Failed { kind: FailureKind::Unavailable, reason },
            Some(RunError::Failed { kind, reason: end }),
        ) if *reason != end => RunError::new(kind, format!("{reason}; {end}")),
        _ => said,
    }
}

/// Waits for `deadline`, for ever if there is none.
async fn sleep_until(deadline: Option<tokio::time::Instant>) {
    match deadline {
        Some(deadline) => tokio::time::sleep_until(deadline).await,
        None => std::future::pending().await,
    }
}

/// Wakes a run that is to end; kept for one that is about to begin.
static INTERRUPT: tokio::sync::Notify = tokio::sync::Notify::const_new();

/// Ends the run that this process conducts, with [`RunError::Interrupted`], or the next as soon as it begins.
/// Whoever listens for signals calls this: a signal must find somebody listening before there is a run.
pub fn interrupt() {
    INTERRUPT.notify_one();
}

/// Ends at a call of [`interrupt`] and, where nobody listens for signals, at Ctrl-C.
async fn interrupted() {
    #[cfg(unix)]
    INTERRUPT.notified().await;
    #[cfg(not(unix))]
    tokio::select! {
        () = INTERRUPT.notified() => {}
        _ = tokio::signal::ctrl_c() => {}
    }
}

/// The nodes that have not ended.
enum Nodes {
    Children(Children),
    /// What the threads' run comes to; none once it is known.
    Threads(Option<oneshot::Receiver<Result<(), RunError>>>),
}

impl Nodes {
    async fn start(rig: Rig, token: Token, events: &mpsc::Sender<Event>) -> Result<Self, RunError> {
        let unavailable = |reason| RunError::new(FailureKind::Unavailable, reason);
        match rig {
            Rig::Children { program, bind } => {
                let taken = |error| {
                    unavailable(format!(
                        "cannot listen on {bind}: {error}; choose another port, or 0"
                    ))
                };
                let listener = TcpListener::bind(bind).await.map_err(taken)?;
                let address = listener.local_addr().map_err(taken)?;
                tokio::spawn(net::listen(listener, events.clone()));
                let children = Children::launch(&program, address, token, SEATS.len()).await;
                Ok(Self::Children(children.map_err(|error| unavailable(error.to_string()))?))
            }
            Rig::Threads(run) => {
                let ends = SEATS.map(|seat| {
                    let (ours, theirs) = tokio::io::duplex(PIPE_BYTES);
                    let link = LinkId(u32::from(seat.0));
                    tokio::spawn(net::serve(link, Box::new(ours), events.clone(), None));
                    theirs
                });
                let (tell, result) = oneshot::channel();
                // A run that was given up does not wait for what its threads come to.
                std::thread::spawn(move || drop(tell.send(run(ends, token))));
                Ok(Self::Threads(Some(result)))
            }
        }
    }

    /// Waits until a node ends badly.
    async fn next_failure(&mut self) -> RunError {
        match self {
            Self::Children(children) => loop {
                if let Some((kind, reason)) = children.next_exit().await.failure() {
                    return RunError::new(kind, reason);
                }
            },
            Self::Threads(result) => {
                if let Some(running) = result {
                    let ended = running.await;
                    *result = None;
                    if let Err(error) = of_threads(ended) {
                        return error;
                    }
                }
                std::future::pending().await
            }
        }
    }

    /// Waits for the nodes to end once all is drawn. One that does not has pictures that nobody will see.
    async fn flush(&mut self, patience: Duration) -> Result<(), RunError> {
        if let Some(failure) = self.end(patience).await {
            return Err(failure);
        }
        let lost = |who: String| {
            let waited = patience.as_secs();
            let reason = format!(
                "{who} did not end within {waited} s of the last frame; its last pictures are not written"
            );
            Err(RunError::new(FailureKind::Io, reason))
        };
        match self {
            Self::Children(children) => match children.killed() {
                [] => Ok(()),
                [pid, ..] => lost(format!("the render process {pid}")),
            },
            Self::Threads(Some(_)) => lost("a render thread".to_owned()),
            Self::Threads(None) => Ok(()),
        }
    }

    /// Waits for the nodes to end, kills those that do not, and returns the failure that says most.
    async fn end(&mut self, patience: Duration) -> Option<RunError> {
        match self {
            Self::Children(children) => {
                let exits = children.end(patience).await;
                let mut failures: Vec<_> = exits.iter().filter_map(|exit| exit.failure()).collect();
                failures.sort_by_key(|(kind, _)| *kind == FailureKind::Unavailable);
                failures.into_iter().next().map(|(kind, reason)| RunError::new(kind, reason))
            }
            Self::Threads(result) => {
                let running = result.as_mut()?;
                let ended = tokio::time::timeout(patience, running).await.ok()?;
                *result = None;
                of_threads(ended).err()
            }
        }
    }
}

fn of_threads(
    ended: Result<Result<(), RunError>, oneshot::error::RecvError>,
) -> Result<(), RunError> {
    let broken = |_| RunError::new(FailureKind::Internal, "the nodes' thread broke down");
    ended.map_err(broken)?
}

/// The session and what it acts through.
struct Conductor {
    start: Instant,
    session: Coordinator,
    links: BTreeMap<LinkId, Outbox>,
    tally: Tally,
    control_sent: u64,
}

impl Conductor {
    /// Nanoseconds on the coordinator's clock.
    fn now(&self) -> Nanos {
        // 64 bits of nanoseconds last 584 years.
        self.start.elapsed().as_nanos() as Nanos
    }

    fn handle(&mut self, event: Event) {
        let now = self.now();
        match event {
            Event::Connected(link, outbox) => {
                self.links.insert(link, outbox);
                self.session.handle_connected(now, link);
            }
            Event::Message(link, message) => self.session.handle_message(now, link, *message),
            Event::Closed(link, why) => {
                if let Some(why) = why {
                    tracing::warn!("link {} is lost: {why}", link.0);
                }
                self.links.remove(&link);
                self.session.handle_disconnect(now, link);
            }
        }
    }

    /// Does what the session wants until it wants nothing; some once the run is over.
    async fn drain(
        &mut self,
        progress: &mut dyn FnMut(&PhaseRecord),
    ) -> Option<Result<(), RunError>> {
        while let Some(output) = self.session.poll_output() {
            match output {
                Output::Send { to, message } => self.send(to, &message).await,
                Output::Close { link, why } => {
                    if let Some(why) = why {
                        tracing::warn!("hung up on link {}: {why}", link.0);
                    }
                    if let Some(mut outbox) = self.links.remove(&link) {
                        outbox.hang_up().await;
                    }
                }
                Output::Seated { link, seat, pid } => {
                    if let Some(outbox) = self.links.get_mut(&link) {
                        outbox.trust();
                    }
                    self.tally.seated(seat, pid);
                }
                Output::Ready { seat, backend } => self.tally.ready(seat, backend),
                Output::Clock { seat, offset, error, round_trip_p50 } => {
                    self.tally.clock(seat, offset, error, round_trip_p50);
                }
                Output::PhaseStarted { phase, at } => self.tally.phase_started(phase, at),
                Output::Report { seat, report } => self.tally.report(seat, report),
                Output::Picture { frame, hash, hashing } => {
                    self.tally.picture(frame, PictureRecord { hash, hashing });
                }
                Output::PhaseEnded { phase, at } => {
                    progress(self.tally.phase_ended(phase, at, self.control_sent));
                }
                Output::Finished => return Some(Ok(())),
                Output::Failed { kind, reason } => return Some(Err(RunError::new(kind, reason))),
            }
        }
        None
    }

    async fn send(&mut self, to: LinkId, message: &Message) {
        let Some(outbox) = self.links.get_mut(&to) else { return };
        match outbox.send(message).await {
            Ok(bytes) => self.control_sent += bytes,
            Err(error) => {
                tracing::warn!("cannot send on link {}: {error}", to.0);
                self.links.remove(&to);
                self.session.handle_disconnect(self.now(), to);
            }
        }
    }

    /// Tells every node that the run is over. One that knows already has hung up or ignores it.
    async fn tell_all(&mut self, error: &RunError) {
        let kind = match error {
            RunError::Interrupted => FailureKind::Unavailable,
            RunError::Failed { kind, .. } => *kind,
        };
        let message = Message::Failed { kind, reason: error.to_string() };
        for outbox in self.links.values_mut() {
            // A node that cannot be told is about to be killed.
            let _ = tokio::time::timeout(PATIENCE, outbox.send(&message)).await;
        }
    }

    /// Ends every link from this side, which lets the nodes go.
    async fn hang_up(&mut self) {
        for outbox in self.links.values_mut() {
            outbox.hang_up().await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_that_does_not_end_has_lost_pictures() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let flush = |receiver| {
            let mut nodes = Nodes::Threads(Some(receiver));
            runtime.block_on(nodes.flush(Duration::from_millis(20)))
        };
        let (hangs, receiver) = oneshot::channel();
        let error = flush(receiver).unwrap_err();
        assert!(matches!(error, RunError::Failed { kind: FailureKind::Io, .. }), "{error}");
        drop(hangs);
        let (ends, receiver) = oneshot::channel();
        ends.send(Ok(())).unwrap();
        assert_eq!(flush(receiver), Ok(()));
    }

    #[test]
    fn a_lost_link_is_explained_by_the_end_of_its_process() {
        let lost = RunError::new(FailureKind::Unavailable, "seat 1 is gone");
        let killed = RunError::new(FailureKind::Unavailable, "process 7 was killed");
        let crashed = RunError::new(FailureKind::Internal, "process 7 ended with 70");
        let said = RunError::new(FailureKind::BadData, "the scene is damaged");
        assert_eq!(better(lost.clone(), None), lost);
        assert_eq!(
            better(lost.clone(), Some(killed)).to_string(),
            "seat 1 is gone; process 7 was killed"
        );
        let RunError::Failed { kind, .. } = better(lost, Some(crashed.clone())) else { panic!() };
        assert_eq!(kind, FailureKind::Internal);
        assert_eq!(better(said.clone(), Some(crashed.clone())), said);
        assert_eq!(better(RunError::Interrupted, Some(crashed)), RunError::Interrupted);
    }
}
