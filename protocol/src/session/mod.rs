//! The two ends of a run as state machines without I/O.
//!
//! Both are driven the same way: hand in what happened (`handle_*`), then drain `poll_output` until
//! it is empty, and call `handle_timeout` no later than `poll_timeout` says. `now` is nanoseconds on
//! the driver's own clock and never goes back. WIRE.md draws the order of messages.

pub mod coordinator;
pub mod node;
#[cfg(test)]
mod simulation;

/// Silence after which a peer counts as gone, nanoseconds.
pub const PEER_TIMEOUT: u64 = 30_000_000_000;
/// Time without any report after which a phase has failed where nothing else is said, nanoseconds. A node
/// whose render thread hangs still answers pings, so silence does not find it.
pub const PHASE_LIMIT: u64 = 60_000_000_000;
/// Silence after which a peer that something is expected of is pinged, nanoseconds.
pub const HEARTBEAT: u64 = 1_000_000_000;
