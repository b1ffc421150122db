//! The line that shows how a run goes on, on a terminal only.

use super::say::tell;
use coordinator::record::PhaseRecord;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// How often it changes.
const EVERY: Duration = Duration::from_millis(100);

pub(super) struct LiveLine {
    frames: u32,
    terminal: bool,
    shown: Option<Instant>,
}

impl LiveLine {
    pub(super) fn new(frames: u32) -> Self {
        Self { frames, terminal: std::io::stderr().is_terminal(), shown: None }
    }

    pub(super) fn show(&mut self, phase: &PhaseRecord) {
        if !self.terminal || self.shown.is_some_and(|shown| shown.elapsed() < EVERY) {
            return;
        }
        self.shown = Some(Instant::now());
        let work = || phase.reports.iter().filter_map(|(_, report)| report.work);
        let visible = work().find_map(|work| work.cull).map_or(0, |cull| cull.visible);
        let triangles =
            work().filter_map(|work| work.draw).map(|draw| draw.triangles).max().unwrap_or(0);
        let ms = (phase.ended - phase.started) as f64 / 1e6;
        tell(format_args!(
            "\r\x1b[Kframe {}/{}  {ms:.1} ms  {visible} hlods visible  {triangles} triangles",
            phase.phase.0 + 1,
            self.frames
        ));
    }

    pub(super) fn clear(&self) {
        if self.shown.is_some() {
            tell("\r\x1b[K");
        }
    }
}
