//! What a node reads off its own machine.

use protocol::telemetry::Nanos;
use std::time::Instant;

/// A monotonic clock that starts at 0 when it is made.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    start: Instant,
}

impl Clock {
    /// Starts now.
    pub fn start() -> Self {
        Self { start: Instant::now() }
    }

    /// Nanoseconds since the start.
    pub fn now(&self) -> Nanos {
        // 64 bits of nanoseconds last 584 years.
        self.start.elapsed().as_nanos() as Nanos
    }

    /// The instant at which this clock shows `at`.
    pub fn instant(&self, at: Nanos) -> Instant {
        self.start + std::time::Duration::from_nanos(at)
    }
}

/// Highest resident set size of this process so far, bytes; 0 where the system does not tell.
pub fn peak_rss() -> u64 {
    std::fs::read_to_string("/proc/self/status").map_or(0, |status| parse_peak_rss(&status))
}

/// `VmHWM` of a Linux `/proc/<pid>/status`, bytes; 0 if it is not there.
fn parse_peak_rss(status: &str) -> u64 {
    status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .and_then(|rest| rest.trim().strip_suffix("kB"))
        .and_then(|number| number.trim().parse::<u64>().ok())
        .map_or(0, |kib| kib.saturating_mul(1024))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_figure_reads_as_zero() {
        assert_eq!(parse_peak_rss(""), 0);
        assert_eq!(parse_peak_rss("VmHWM:\n"), 0);
        assert_eq!(parse_peak_rss("VmHWM:  x kB\n"), 0);
        assert_eq!(parse_peak_rss("VmHWM:  99999999999999999999 kB\n"), 0);
    }

    #[test]
    fn kibibytes_become_bytes() {
        assert_eq!(parse_peak_rss("Name:\tx\nVmHWM:\t    2048 kB\nVmRSS: 1 kB\n"), 2048 * 1024);
    }

    #[test]
    fn the_clock_does_not_run_backwards() {
        let clock = Clock::start();
        let first = clock.now();
        assert!(clock.now() >= first);
        assert!(clock.instant(u64::from(u32::MAX)) > Instant::now());
    }
}
