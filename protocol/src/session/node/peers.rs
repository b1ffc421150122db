//! What a node knows of its peers: their greeting, and whether they still live.

use super::Peer;
use crate::id::Seat;
use crate::message::{Message, Token, WIRE_VERSION};
use crate::schedule::SEATS;
use crate::session::{HEARTBEAT, PEER_TIMEOUT};
use crate::telemetry::Nanos;
use std::collections::BTreeMap;

/// Why a peer's greeting is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PeerHelloError {
    /// It says something else first.
    #[error("the peer did not greet first")]
    NoHello,
    /// It does not know the run's secret; answer nothing.
    #[error("the peer does not know this run's token")]
    WrongToken,
    /// It is of another version of the program.
    #[error(
        "the peer speaks wire version {0}, this program version {WIRE_VERSION}; use one version"
    )]
    WrongVersion(u32),
    /// It claims a seat that no rig has.
    #[error("the peer claims seat {0}, which does not exist")]
    NoSuchSeat(Seat),
}

/// Checks the first message of a peer link: the seat at its other end.
///
/// The token is compared first and in constant time, so that a stranger learns nothing.
pub fn check_peer_hello(message: &Message, run: &Token) -> Result<Seat, PeerHelloError> {
    let Message::PeerHello { version, token, seat } = message else {
        return Err(PeerHelloError::NoHello);
    };
    if !token.matches(run) {
        Err(PeerHelloError::WrongToken)
    } else if *version != WIRE_VERSION {
        Err(PeerHelloError::WrongVersion(*version))
    } else if !SEATS.contains(seat) {
        Err(PeerHelloError::NoSuchSeat(*seat))
    } else {
        Ok(*seat)
    }
}

/// A seat whose visible set is waited for.
#[derive(Debug, Clone, Copy)]
struct Wait {
    seat: Seat,
    since: Nanos,
    pinged: Nanos,
}

/// What falls due with time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Due {
    /// Ask a silent peer whether it lives.
    Ping(Seat),
    /// This one has been silent too long.
    Silent(Peer),
    /// This one hung up, and nobody has said why.
    Lost(Seat),
}

/// Watches for silence and for links that end.
///
/// The coordinator is expected to speak at all times (it pings); a peer only while its visible set
/// is waited for.
#[derive(Debug)]
pub(super) struct Watch {
    coordinator_heard: Nanos,
    seats_heard: BTreeMap<Seat, Nanos>,
    wait: Option<Wait>,
    lost: Option<(Seat, Nanos)>,
    sequence: u32,
}

impl Watch {
    /// Starts now.
    pub(super) fn new(now: Nanos) -> Self {
        Self {
            coordinator_heard: now,
            seats_heard: BTreeMap::new(),
            wait: None,
            lost: None,
            sequence: 0,
        }
    }

    /// `from` has spoken.
    pub(super) fn heard(&mut self, now: Nanos, from: Peer) {
        match from {
            Peer::Coordinator => self.coordinator_heard = now,
            Peer::Seat(seat) => {
                self.seats_heard.insert(seat, now);
            }
        }
    }

    /// `seat` is waited for from now on; none: nobody.
    pub(super) fn wait_for(&mut self, now: Nanos, seat: Option<Seat>) {
        self.wait = seat.map(|seat| Wait { seat, since: now, pinged: now });
    }

    /// `seat` hung up. The coordinator, which hears the reason, has one [`HEARTBEAT`] to tell it.
    pub(super) fn lost(&mut self, now: Nanos, seat: Seat) {
        self.lost.get_or_insert((seat, now.saturating_add(HEARTBEAT)));
    }

    /// The next ping.
    pub(super) fn ping(&mut self, now: Nanos) -> Message {
        self.sequence = self.sequence.wrapping_add(1);
        Message::Ping { sequence: self.sequence, sent: now }
    }

    /// What is due at `now`; a ping counts as sent.
    pub(super) fn due(&mut self, now: Nanos) -> Option<Due> {
        let (_, due) = self.alarms().into_iter().flatten().find(|&(at, _)| at <= now)?;
        if let (Due::Ping(_), Some(wait)) = (due, &mut self.wait) {
            wait.pinged = now;
        }
        Some(due)
    }

    /// When something falls due next.
    pub(super) fn next(&self) -> Option<Nanos> {
        self.alarms().into_iter().flatten().map(|(at, _)| at).min()
    }

    fn alarms(&self) -> [Option<(Nanos, Due)>; 4] {
        let after = |at: Nanos, wait: Nanos, due| Some((at.saturating_add(wait), due));
        let waited = self.wait.map(|wait| {
            let heard = self.seats_heard.get(&wait.seat).copied().unwrap_or(0).max(wait.since);
            (wait, heard)
        });
        [
            self.lost.map(|(seat, at)| (at, Due::Lost(seat))),
            after(self.coordinator_heard, PEER_TIMEOUT, Due::Silent(Peer::Coordinator)),
            waited.and_then(|(wait, heard)| {
                after(heard, PEER_TIMEOUT, Due::Silent(Peer::Seat(wait.seat)))
            }),
            waited.and_then(|(wait, heard)| {
                after(heard.max(wait.pinged), HEARTBEAT, Due::Ping(wait.seat))
            }),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_greeting_needs_token_version_and_seat_in_that_order() {
        let run = Token([1; 32]);
        let hello = |version, token, seat| Message::PeerHello { version, token, seat: Seat(seat) };
        let check = |message| check_peer_hello(&message, &run);
        assert_eq!(check(Message::Bye), Err(PeerHelloError::NoHello));
        let mut near = run;
        near.0[31] ^= 1;
        assert_eq!(check(hello(9, near, 9)), Err(PeerHelloError::WrongToken));
        assert_eq!(check(hello(9, run, 9)), Err(PeerHelloError::WrongVersion(9)));
        let expected = Err(PeerHelloError::NoSuchSeat(Seat(3)));
        assert_eq!(check(hello(WIRE_VERSION, run, 3)), expected);
        assert_eq!(check(hello(WIRE_VERSION, run, 2)), Ok(Seat(2)));
    }

    #[test]
    fn only_a_peer_that_is_waited_for_is_pinged_and_given_up() {
        let mut watch = Watch::new(0);
        assert_eq!(watch.next(), Some(PEER_TIMEOUT));
        watch.wait_for(0, Some(Seat(1)));
        assert_eq!(watch.due(HEARTBEAT), Some(Due::Ping(Seat(1))));
        assert_eq!(watch.due(HEARTBEAT), None);
        watch.heard(PEER_TIMEOUT - 1, Peer::Coordinator);
        assert_eq!(watch.due(PEER_TIMEOUT), Some(Due::Silent(Peer::Seat(Seat(1)))));
        watch.heard(PEER_TIMEOUT, Peer::Seat(Seat(1)));
        assert_eq!(watch.due(PEER_TIMEOUT), None);
    }
}
