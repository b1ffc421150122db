//! Pings, and what they tell of a node's clock.
//!
//! The node's answer lies somewhere within the round trip, so taking its middle is off by half of it
//! at most: the ping with the least round trip bounds the error best (minimum filter, as in NTP,
//! RFC 5905 section 10).

use crate::message::Message;
use crate::telemetry::Nanos;

/// Pings that make an estimate.
const SAMPLES: usize = 32;

/// A node's clock: coordinator's time = node's time + `offset`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Estimate {
    pub(super) offset: i64,
    pub(super) error: Nanos,
    pub(super) round_trip_p50: Nanos,
}

/// One node's pings: one at a time is on its way.
#[derive(Debug, Default)]
pub(super) struct Pings {
    sequence: u32,
    on_its_way: Option<(u32, Nanos)>,
    /// Round trip and offset.
    samples: Vec<(Nanos, i64)>,
}

impl Pings {
    /// The next ping; none while one is on its way.
    pub(super) fn send(&mut self, now: Nanos) -> Option<Message> {
        if self.on_its_way.is_some() {
            return None;
        }
        self.sequence = self.sequence.wrapping_add(1);
        self.on_its_way = Some((self.sequence, now));
        Some(Message::Ping { sequence: self.sequence, sent: now })
    }

    /// Takes an answer; false where it answers nothing that was sent.
    pub(super) fn answered(
        &mut self,
        now: Nanos,
        sequence: u32,
        sent: Nanos,
        answered: Nanos,
    ) -> bool {
        if self.on_its_way.take() != Some((sequence, sent)) {
            return false;
        }
        let round_trip = now.saturating_sub(sent);
        let middle = i128::from(sent) + i128::from(round_trip / 2);
        let Ok(offset) = i64::try_from(middle - i128::from(answered)) else { return false };
        if self.samples.len() < SAMPLES {
            self.samples.push((round_trip, offset));
        }
        true
    }

    /// Forgets the answers so far: they came while the node was busy starting.
    pub(super) fn start_over(&mut self) {
        self.samples.clear();
    }

    /// The clock, once there are enough answers.
    pub(super) fn estimate(&self) -> Option<Estimate> {
        if self.samples.len() < SAMPLES {
            return None;
        }
        let mut sorted = self.samples.clone();
        sorted.sort_unstable();
        let (least, offset) = sorted[0];
        let round_trip_p50 = sorted[SAMPLES / 2].0;
        Some(Estimate { offset, error: least.div_ceil(2), round_trip_p50 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_to_nothing_is_refused() {
        let mut pings = Pings::default();
        assert!(!pings.answered(1, 0, 0, 0));
        assert_eq!(pings.send(5), Some(Message::Ping { sequence: 1, sent: 5 }));
        assert_eq!(pings.send(6), None);
        assert!(!pings.answered(7, 1, 6, 0));
    }

    #[test]
    fn a_clock_that_no_number_reaches_is_refused() {
        let mut pings = Pings::default();
        pings.send(0);
        assert!(!pings.answered(1, 1, 0, u64::MAX));
    }

    #[test]
    fn the_quickest_answer_counts_and_bounds_the_error() {
        // The node is 1000 ahead; the ways there and back take very different times.
        let mut pings = Pings::default();
        for i in 0..SAMPLES as u64 {
            assert_eq!(pings.estimate(), None);
            let (there, back) = (10 + i * 7 % 13, 10 + i * 31 % 101);
            let sent = i * 10_000;
            let sequence = i as u32 + 1;
            pings.send(sent);
            assert!(pings.answered(sent + there + back, sequence, sent, sent + there + 1000));
        }
        let estimate = pings.estimate().unwrap();
        assert!(estimate.offset.abs_diff(-1000) <= estimate.error);
        assert!(estimate.error <= 15 && estimate.round_trip_p50 > 2 * estimate.error);
    }
}
