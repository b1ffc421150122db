//! Units on the wire. WIRE.md draws them.

use crate::camera::Camera;
use crate::id::{FrameIndex, Seat};
use crate::schedule::Phase;
use crate::settings::RunSettings;
use crate::telemetry::{BackendInfo, Nanos, PhaseReport};
use crate::visible::DeltaChunk;
use serde::{Deserialize, Serialize};

/// Version of the messages below; both ends must speak the same.
pub const WIRE_VERSION: u32 = 5;

/// Secret of one run: whoever does not know it is hung up on.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Token(pub [u8; 32]);

impl Token {
    /// Whether both are the same, in a time that does not tell where they differ.
    pub fn matches(&self, other: &Self) -> bool {
        let differing = self.0.iter().zip(&other.0).fold(0, |bits, (a, b)| bits | (a ^ b));
        std::hint::black_box(differing) == 0
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(..)")
    }
}

/// Where a node listens for its peers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PeerAddress {
    /// The node's seat.
    pub seat: Seat,
    /// `host:port`.
    pub address: String,
}

/// Why a node gives up; maps one to one on an exit code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum FailureKind {
    /// The scene file is damaged or foreign (65).
    BadData,
    /// The scene file cannot be opened (66).
    NoInput,
    /// No adapter, or a peer is gone (69).
    Unavailable,
    /// A broken promise of our own (70).
    Internal,
    /// Reading or writing failed (74).
    Io,
    /// A peer broke the protocol (76).
    Protocol,
    /// Wrong token, another scene, or another renderer than the other seats have (77).
    NotAllowed,
    /// A setting that this scene cannot be shown with (78).
    Config,
}

/// A message, either way, on either kind of link.
///
/// `Hello`, `PeerHello` and `Failed` keep their place and layout in every version, so that a peer of
/// another version can be told so; a test holds their bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// Node to coordinator, first.
    Hello {
        /// [`WIRE_VERSION`] of the sender.
        version: u32,
        /// The run's secret.
        token: Token,
        /// Where this node's peers can reach it.
        peer_address: String,
        /// Process id.
        pid: u32,
    },
    /// Node to node, first.
    PeerHello {
        /// [`WIRE_VERSION`] of the sender.
        version: u32,
        /// The run's secret.
        token: Token,
        /// The sender's seat.
        seat: Seat,
    },
    /// Either way, last: why the sender gives up.
    Failed {
        /// The class of failure.
        kind: FailureKind,
        /// One sentence for a person, naming file or peer and what to do.
        reason: String,
    },
    /// Coordinator to node, answer to `Hello`.
    Welcome {
        /// The node's seat.
        seat: Seat,
        /// Addresses of all nodes, its own included.
        #[serde(deserialize_with = "crate::codec::list")]
        peers: Vec<PeerAddress>,
        /// The run.
        settings: RunSettings,
    },
    /// Node to coordinator: scene open, backend up, peers joined.
    Ready {
        /// Digest of the scene it opened.
        scene_digest: [u8; 32],
        /// The renderer it chose.
        backend: BackendInfo,
    },
    /// Coordinator to node, or node to a node it waits for; `sent` on the sender's clock.
    Ping {
        /// Counter.
        sequence: u32,
        /// When it was sent.
        sent: Nanos,
    },
    /// Answer to a ping, at once.
    Pong {
        /// As in the ping.
        sequence: u32,
        /// As in the ping.
        sent: Nanos,
        /// The answering end's clock when it answered.
        answered: Nanos,
    },
    /// Coordinator to all nodes: phase i with camera C_{i+1}.
    Phase {
        /// The phase.
        phase: Phase,
        /// Camera of frame `phase + 1`; none once the path has ended.
        next_camera: Option<Camera>,
    },
    /// HC to OR and RVG: part of the change from the base to V_frame, in id order.
    Delta {
        /// The frame.
        frame: FrameIndex,
        /// The set that changes; none is the empty set.
        base: Option<FrameIndex>,
        /// Changed ids.
        chunk: DeltaChunk,
    },
    /// HC to OR and RVG: the sentinel of paper 004, section 6.
    EndOfFrame {
        /// The frame.
        frame: FrameIndex,
        /// Size of V_frame.
        visible: u32,
        /// [`crate::visible::VisibleSet::checksum`] of V_frame.
        checksum: u64,
    },
    /// OR or RVG to HC: my base or my sum is wrong, send V_frame whole (as `Delta` with no base).
    WantFull {
        /// The frame.
        frame: FrameIndex,
    },
    /// Node to coordinator: the phase's work is done.
    PhaseDone(PhaseReport),
    /// Coordinator to node: no more phases.
    Finish,
    /// Node to coordinator, answer to `Finish` once all its pictures are hashed; then it hangs up.
    Bye,
    /// Node to coordinator: the picture of a frame this seat has drawn, once hashed. Before or after the
    /// phase's report, and before `Bye`.
    PictureHash {
        /// The frame.
        frame: FrameIndex,
        /// First 8 bytes of the BLAKE3 of the picture's RGBA bytes.
        hash: u64,
        /// How long hashing took, beside the render thread.
        hashing: Nanos,
    },
}

/// Most characters of a [`Message::Failed`] reason; what a peer says beyond that is not passed on.
pub const MAX_REASON_CHARS: usize = 2000;
/// Most bytes of a [`Message::Hello`] peer address: a host name's 253 and room for the port.
pub const MAX_ADDRESS_BYTES: usize = 300;

impl Message {
    /// `Failed` with the reason cut to [`MAX_REASON_CHARS`].
    pub fn failed(kind: FailureKind, reason: &str) -> Self {
        Self::Failed { kind, reason: reason.chars().take(MAX_REASON_CHARS).collect() }
    }

    /// Its name, for a person.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Hello { .. } => "Hello",
            Self::PeerHello { .. } => "PeerHello",
            Self::Failed { .. } => "Failed",
            Self::Welcome { .. } => "Welcome",
            Self::Ready { .. } => "Ready",
            Self::Ping { .. } => "Ping",
            Self::Pong { .. } => "Pong",
            Self::Phase { .. } => "Phase",
            Self::Delta { .. } => "Delta",
            Self::EndOfFrame { .. } => "EndOfFrame",
            Self::WantFull { .. } => "WantFull",
            Self::PhaseDone(_) => "PhaseDone",
            Self::Finish => "Finish",
            Self::Bye => "Bye",
            Self::PictureHash { .. } => "PictureHash",
        }
    }
}
