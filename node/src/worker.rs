//! The render thread: opens the scene, then does one role's work after another.

use crate::NodeError;
use crate::open::{Scene, open};
use crate::pictures::{Hashed, PictureError, PictureThread};
use crate::role::Coming;
use crate::role::audit::{self, Measured};
use crate::role::hardware_cull::Culled;
use crate::role::{hardware_cull, occlusion_representation, render_visible_geometry};
use crate::runner::Event;
use crate::telemetry::Clock;
use protocol::camera::Camera;
use protocol::id::FrameIndex;
use protocol::message::FailureKind;
use protocol::path_text;
use protocol::session::node::WorkTimes;
use protocol::settings::RunSettings;
use protocol::telemetry::{BackendInfo, CullCounts, DrawCounts, IoCounts};
use protocol::visible::VisibleSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use tokio::sync::{mpsc, oneshot};

/// Jobs that may wait: a phase has one, and one more that prepares it.
const QUEUED: usize = 8;

/// What the render thread is told to do.
pub(crate) enum Job {
    /// Open the scene and start the backend.
    Open { settings: RunSettings },
    /// A phase begins.
    Prepare(Coming),
    /// OR: make the depth of `frame`.
    Occlude { frame: FrameIndex, camera: Camera, occluders: Arc<VisibleSet> },
    /// HC: find V_frame.
    Cull { frame: FrameIndex, camera: Camera },
    /// RVG: draw the picture of `frame`.
    Render { frame: FrameIndex, camera: Camera, visible: Arc<VisibleSet> },
}

/// The scene and backend that were opened.
pub(crate) struct Opened {
    /// Hlods of the scene.
    pub(crate) hlods: u32,
    /// Digest of the scene file.
    pub(crate) scene_digest: [u8; 32],
    /// The renderer.
    pub(crate) backend: BackendInfo,
}

/// What the render thread says.
pub(crate) enum Done {
    /// Open is done.
    Opened(Opened),
    /// OR is done.
    Occluded { frame: FrameIndex, times: WorkTimes, counts: DrawCounts },
    /// HC is done: V_frame.
    Culled { frame: FrameIndex, visible: Arc<VisibleSet>, times: WorkTimes, counts: CullCounts },
    /// RVG is done.
    Rendered { frame: FrameIndex, times: WorkTimes, counts: DrawCounts },
    /// A picture is hashed, on the picture thread.
    Hashed(Hashed),
    /// The thread has ended, or the picture thread has.
    Failed(NodeError),
}

/// A handle on the render thread.
pub(crate) struct Worker {
    jobs: Option<crossbeam_channel::Sender<Job>>,
    ended: Option<oneshot::Receiver<Result<(), NodeError>>>,
    abandoned: Arc<AtomicBool>,
    peak_resident: Arc<AtomicU64>,
}

impl Worker {
    /// Starts the thread; what it does goes to `events`.
    pub(crate) fn start(clock: Clock, events: mpsc::Sender<Event>) -> Self {
        let (jobs, inbox) = crossbeam_channel::bounded(QUEUED);
        let (tell_end, ended) = oneshot::channel();
        let peak_resident = Arc::new(AtomicU64::new(0));
        let shared = Arc::clone(&peak_resident);
        let abandoned = Arc::new(AtomicBool::new(false));
        let is_abandoned = Arc::clone(&abandoned);
        std::thread::spawn(move || {
            let say = |done| events.blocking_send(Event::Done(done)).map_err(|_| Stop::Unheard);
            let work = || serve(clock, &inbox, &say, &events, &is_abandoned, &shared);
            let result = match std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)) {
                Ok(Err(Stop::Failed(error))) => {
                    // Nobody listens once the session has ended.
                    let _ = say(Done::Failed(error.clone()));
                    Err(error)
                }
                Ok(_) => Ok(()),
                Err(_) => {
                    let reason = "the render thread broke down; see its message above".to_owned();
                    let error = NodeError::new(FailureKind::Internal, reason);
                    let _ = say(Done::Failed(error.clone()));
                    Err(error)
                }
            };
            let _ = tell_end.send(result);
        });
        Self { jobs: Some(jobs), ended: Some(ended), abandoned, peak_resident }
    }

    /// Queues a job. One that comes after the thread has failed is dropped: its failure is on the way.
    pub(crate) fn order(&self, job: Job) {
        let Some(jobs) = &self.jobs else { return };
        let refused = jobs.try_send(job).err();
        assert!(!refused.is_some_and(|error| error.is_full()), "a session orders one job a phase");
    }

    /// Most bytes of geometry and textures held so far, buffers included.
    pub(crate) fn peak_resident(&self) -> u64 {
        self.peak_resident.load(Ordering::Relaxed)
    }

    /// Has the thread end after the job it is at, its pictures and the jobs that are queued forgotten.
    pub(crate) fn abandon(&self) {
        self.abandoned.store(true, Ordering::Relaxed);
    }

    /// Lets the thread end its work and write its last pictures.
    pub(crate) async fn finish(&mut self) -> Result<(), NodeError> {
        self.jobs = None;
        match self.ended.take() {
            Some(ended) => ended.await.unwrap_or(Ok(())),
            None => Ok(()),
        }
    }
}

/// Why the thread stops before its jobs end.
enum Stop {
    Failed(NodeError),
    /// Nobody hears what it says any more.
    Unheard,
}

impl<E: Into<NodeError>> From<E> for Stop {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

fn serve(
    clock: Clock,
    jobs: &crossbeam_channel::Receiver<Job>,
    say: &dyn Fn(Done) -> Result<(), Stop>,
    events: &mpsc::Sender<Event>,
    is_abandoned: &AtomicBool,
    peak_resident: &Arc<AtomicU64>,
) -> Result<(), Stop> {
    let Ok(Job::Open { settings }) = jobs.recv() else { return Ok(()) };
    let Scene { digest, mut stage } = open(&settings, peak_resident)?;
    let mut pictures = picture_thread(&settings, events.clone())?;
    let (hlods, backend) = (stage.hlods(), stage.backend_info());
    say(Done::Opened(Opened { scene_digest: digest, hlods, backend }))?;
    while let Some(job) = stage.next_job(jobs)? {
        if is_abandoned.load(Ordering::Relaxed) {
            return Ok(());
        }
        let started = clock.now();
        let times = |io: IoCounts| WorkTimes { started, finished: clock.now(), io };
        match job {
            Job::Open { .. } => unreachable!("a session prepares once"),
            Job::Prepare(coming) => stage.prepare(coming),
            Job::Occlude { frame, camera, occluders } => {
                let counts = occlusion_representation::run(&mut stage, &camera, &occluders)?;
                let times = times(stage.take_io());
                say(Done::Occluded { frame, times, counts })?;
                stage.note_visible(frame, &occluders);
            }
            Job::Cull { frame, camera } => {
                let Culled { visible, counts } = hardware_cull::run(&mut stage, &camera)?;
                let visible = Arc::new(VisibleSet::from_sorted(visible));
                let times = times(stage.take_io());
                say(Done::Culled { frame, visible: Arc::clone(&visible), times, counts })?;
                stage.note_visible(frame, &visible);
            }
            Job::Render { frame, camera, visible } => {
                let audited = is_nth(frame, settings.audit_every);
                let drawn = render_visible_geometry::run(&mut stage, &camera, &visible, audited)?;
                let times = times(stage.take_io());
                let mut counts = drawn.counts;

                let counted = audited || is_nth(frame, settings.items_every);
                let begun = clock.now();
                let measured = audit::measure(&mut stage, &camera, &drawn, audited, counted)?;
                if let Some(Measured { audit, hlods_with_pixels, front, stand_in_error_px }) =
                    measured
                {
                    (counts.audit, counts.hlods_with_pixels) = (audit, hlods_with_pixels);
                    (counts.front, counts.missing.error_px) = (front, stand_in_error_px);
                    counts.measuring_ns = (clock.now() - begun).max(1);
                    // Loading for the audit's sake is not the role's.
                    stage.take_io();
                }

                let begun = clock.now();
                pictures.hand_over(frame, drawn.into_rgba())?;
                counts.hand_over_ns = clock.now() - begun;
                say(Done::Rendered { frame, times, counts })?;
                stage.note_visible(frame, &visible);
            }
        }
    }
    pictures.finish()?;
    Ok(())
}

/// The thread that hashes the run's pictures and writes them if that is asked for. What it says goes to `events`.
fn picture_thread(
    settings: &RunSettings,
    events: mpsc::Sender<Event>,
) -> Result<PictureThread, NodeError> {
    let folder = settings.pictures_dir.as_deref().map(path_text::from_text);
    let tell = move |news: Result<Hashed, &PictureError>| {
        let done = news.map_or_else(|error| Done::Failed(error.into()), Done::Hashed);
        // Nobody listens once the session has ended.
        let _ = events.blocking_send(Event::Done(done));
    };
    Ok(PictureThread::start(folder, settings.size, tell)?)
}

/// `frame` is one of every `n`; 0 picks none.
fn is_nth(frame: FrameIndex, n: u32) -> bool {
    n > 0 && frame.0.is_multiple_of(n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_nth_frame_counts_from_the_first() {
        let picked = |n| (0..7).filter(|&frame| is_nth(FrameIndex(frame), n)).collect::<Vec<_>>();
        assert_eq!(picked(0), []);
        assert_eq!(picked(1), [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(picked(3), [0, 3, 6]);
    }
}
