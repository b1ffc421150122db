//! Ctrl-C and requests to terminate: what is finished of a scene is kept, a run ends its own nodes.

use super::exit::OTHER;
use super::say::tell;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How long a word at the end may take.
const LAST_WORDS: Duration = Duration::from_secs(1);

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
    /// A run, which is told.
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
        Self
    }
}

impl Drop for During {
    fn drop(&mut self) {
        *work() = Work::Other;
    }
}

/// Hears of signals on a thread of its own, from now on; elsewhere than on Unix the system ends the program.
pub(super) fn listen() {
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

/// A write beyond the limit on the size of files fails as on a full disk, instead of ending the program.
pub(super) fn survive_size_limit() {
    #[cfg(unix)]
    if let Err(error) = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default()) {
        tracing::warn!("a file that grows too long will end this without a word: {error}");
    }
}

#[cfg(unix)]
fn interrupted() {
    let words = match &*work() {
        Work::Running => return coordinator::run::interrupt(),
        Work::Baking { what, kept } => format!(
            "occluster: interrupted before {what} was written; what is finished is kept in {}, and the same \
             command goes on from it\n",
            kept.display()
        ),
        Work::Other => "occluster: interrupted\n".to_owned(),
    };
    // Somebody may be waiting for a reader that has stopped, with stderr in hand.
    let (said, is_said) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        tell(words);
        said.send(())
    });
    let _ = is_said.recv_timeout(LAST_WORDS);
    std::process::exit(OTHER.into());
}
