//! Telling how far a bake is.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Mutex;

/// Hears of a bake's stages. Called from many threads.
pub trait Progress: Sync {
    /// A stage of `total` steps begins; the one before it is over.
    fn stage(&self, name: &str, total: u64);
    /// So many more steps are done.
    fn advance(&self, steps: u64);
    /// The last stage is over.
    fn finish(&self);
}

/// Says nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn stage(&self, _name: &str, _total: u64) {}
    fn advance(&self, _steps: u64) {}
    fn finish(&self) {}
}

/// A bar on stderr, where that is a terminal; else nothing.
#[derive(Debug)]
pub struct Bars {
    bar: Mutex<ProgressBar>,
    on_terminal: bool,
}

impl Default for Bars {
    fn default() -> Self {
        let on_terminal = std::io::stderr().is_terminal();
        Self { bar: Mutex::new(ProgressBar::hidden()), on_terminal }
    }
}

impl Bars {
    /// A bar that another thread died with is as good as any.
    fn bar(&self) -> std::sync::MutexGuard<'_, ProgressBar> {
        self.bar.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl Progress for Bars {
    fn stage(&self, name: &str, total: u64) {
        if !self.on_terminal {
            return;
        }
        let style = ProgressStyle::with_template("{msg:>10} [{bar:40}] {pos}/{len} {eta}")
            .expect("the template is a constant")
            .progress_chars("=> ");
        let next = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr());
        next.set_style(style);
        next.set_message(name.to_owned());
        std::mem::replace(&mut *self.bar(), next).finish_and_clear();
    }

    fn advance(&self, steps: u64) {
        self.bar().inc(steps);
    }

    fn finish(&self) {
        self.bar().finish_and_clear();
    }
}
