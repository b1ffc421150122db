//! Ctrl-C and requests to terminate: a half-written scene goes, a run ends its own nodes.

use super::exit::OTHER;
use protocol::format::SceneWriter;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What an interrupt finds the program at.
#[derive(Debug, Default)]
pub(super) enum Work {
    /// Nothing that needs care.
    #[default]
    Other,
    /// Writing this scene file.
    Baking(PathBuf),
    /// A run, which listens for interrupts itself.
    Running,
}

static WORK: Mutex<Work> = Mutex::new(Work::Other);

fn work() -> MutexGuard<'static, Work> {
    WORK.lock().unwrap_or_else(PoisonError::into_inner)
}

/// While this lives, an interrupt treats the program as being at some work.
pub(super) struct During;

impl During {
    pub(super) fn new(now: Work) -> Self {
        *work() = now;
        // The work after the first finds the handler in place.
        if let Err(error) = ctrlc::try_set_handler(interrupted) {
            tracing::debug!("interrupts are handled already, or not at all: {error}");
        }
        Self
    }
}

impl Drop for During {
    fn drop(&mut self) {
        *work() = Work::Other;
    }
}

fn interrupted() {
    match &*work() {
        Work::Running => return,
        Work::Baking(output) => {
            SceneWriter::abandon(output);
            eprintln!("occluster: interrupted: {} was not written", output.display());
        }
        Work::Other => eprintln!("occluster: interrupted"),
    }
    std::process::exit(OTHER.into());
}
