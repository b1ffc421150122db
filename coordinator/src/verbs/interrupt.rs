//! Ctrl-C and requests to terminate: what is finished of a scene is kept, a run ends its own nodes.

use super::exit::OTHER;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, Once, PoisonError};

/// What an interrupt finds the program at.
#[derive(Debug, Default)]
pub(super) enum Work {
    /// Nothing that needs care.
    #[default]
    Other,
    /// Baking something.
    Baking {
        /// What is to be written.
        what: String,
        /// Where what is finished is kept.
        kept: PathBuf,
    },
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
        static LISTENING: Once = Once::new();
        LISTENING.call_once(listen);
        Self
    }
}

impl Drop for During {
    fn drop(&mut self) {
        *work() = Work::Other;
    }
}

/// Hears of signals on a thread of its own; elsewhere than on Unix the system ends the program.
fn listen() {
    #[cfg(unix)]
    match signal_hook::iterator::Signals::new([
        signal_hook::consts::SIGINT,
        signal_hook::consts::SIGTERM,
    ]) {
        Ok(mut signals) => {
            std::thread::spawn(move || signals.forever().for_each(|_| interrupted()));
        }
        Err(error) => tracing::warn!("an interrupt will end this without a word: {error}"),
    }
}

#[cfg(unix)]
fn interrupted() {
    match &*work() {
        Work::Running => return,
        Work::Baking { what, kept } => eprintln!(
            "occluster: interrupted before {what} was written; what is finished is kept in {}, and the same \
             command goes on from it",
            kept.display()
        ),
        Work::Other => eprintln!("occluster: interrupted"),
    }
    std::process::exit(OTHER.into());
}
