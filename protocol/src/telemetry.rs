//! What a node measures and reports. Times are nanoseconds on the node's own clock.

use crate::id::{FrameIndex, Seat};
use crate::schedule::{Phase, Role};
use serde::{Deserialize, Serialize};

/// Nanoseconds since an arbitrary start of the clock they were read from.
pub type Nanos = u64;

/// The renderer a node chose.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BackendInfo {
    /// `gpu` or `cpu`.
    pub name: String,
    /// Adapter and driver in words, for example `llvmpipe (LLVM 15.0.6, 256 bits), Mesa 22.3.6`.
    pub driver: String,
}

/// Result of drawing one frame with and without culling on one device. Where pictures are mixed, pixels are
/// summed over them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Audit {
    /// Pixels whose colour or depth bits differ.
    pub differing_pixels: u64,
    /// Pixels that say nothing: something was not there that may have hidden what differs.
    pub unknown_pixels: u64,
    /// Hlods that are not on the front as they should be, where that was asked.
    pub front_faults: u32,
}

/// Counts of HC(i).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct CullCounts {
    /// Hlods on the front F_i and in the frustum.
    pub in_frustum: u32,
    /// Boxes tested against the depth.
    pub queries: u32,
    /// Meshes tested by their own triangles.
    pub mesh_queries: u32,
    /// Triangles drawn as further occluders, in a second look, and to be tested themselves.
    pub triangles: u64,
    /// Visible without a test: the box holds the eye or lies within a few near distances of it.
    pub at_eye: u32,
    /// Visible without a test for any other reason.
    pub untested: u32,
    /// Hlods in V_i.
    pub visible: u32,
    /// Triangles of the *source* under the hlods in the frustum.
    pub source_triangles_in_frustum: u64,
    /// Ids of the base that are not in V_i.
    pub leaving: u32,
    /// Ids of V_i that are not in the base.
    pub entering: u32,
    /// Bits of the coded change, for one receiver.
    pub ids_delta_bits: u32,
    /// Least bits of it ([`crate::visible::ChangeTotals::bound_bits`]).
    pub ids_bound_bits: f64,
    /// Bytes of its chunks, counts and whole last bytes included, for one receiver; framing is not.
    pub ids_sent: u32,
    /// Bytes of V_i as plain 4-byte ids.
    pub ids_full: u32,
}

/// Counts of OR(i) and RVG(i).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct DrawCounts {
    /// Hlods drawn.
    pub hlods: u32,
    /// Triangles drawn, those of cubes included.
    pub triangles: u64,
    /// Of these, triangles of cubes (RVG alone).
    pub far_triangles: u64,
    /// Hlods with a visible pixel, on frames where the item buffer was drawn.
    pub hlods_with_pixels: Option<u32>,
    /// Hlods on the front, in the frustum or not, on the same frames.
    pub front: Option<u32>,
    /// On audited frames (RVG alone).
    pub audit: Option<Audit>,
    /// Time spent on audit, item buffer and stand-ins' error, after the work and before the report; 0
    /// exactly where none of them was taken.
    pub measuring_ns: Nanos,
    /// Time in which the render thread hands the picture over to be hashed and written, after the work
    /// and before the report (RVG alone).
    pub hand_over_ns: Nanos,
    /// What was not there.
    pub missing: Missing,
}

/// Hlods whose geometry was not there when it was to be drawn.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Missing {
    /// Hlods that something coarser stood for (RVG), or that were left out as occluders (OR).
    pub replaced: u32,
    /// Hlods that nothing stood for: holes in the picture.
    pub holes: u32,
    /// Greatest error of what stood in, where it is seen, pixels (RVG).
    pub error_px: f64,
}

/// Loading of meshes and textures in one phase. One that several draws share counts once.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct IoCounts {
    /// Of those needed, how many were already with the backend.
    pub hits: u64,
    /// How many were not.
    pub misses: u64,
    /// How often a drawing waited for one to be read.
    pub waits: u64,
    /// Time that work of the phase waited because of loading: reading, uploads, the device's memory for them
    /// and what was drawn before that, hand-overs to the thread that reads.
    pub stall_ns: Nanos,
    /// Bytes that the drawing uploaded of what it did not need: 16 MiB at most.
    pub besides: u64,
    /// Bytes read, prefetched ones included.
    pub bytes_read: u64,
    /// Bytes read before they were needed.
    pub prefetched: u64,
    /// Of those, bytes needed later, counted when they are.
    pub prefetched_used: u64,
    /// Of those needed, how many the drawing before did not need: the events of a front.
    pub events: u64,
    /// Of those, there in time.
    pub events_foreseen: u64,
    /// Bytes given up to make room.
    pub evicted: u64,
    /// Meshes and textures that cannot be read.
    pub faults: u64,
}

/// Bytes written to one peer's socket since the run began, framing and handshake included.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkBytes {
    /// The other end.
    pub to: Seat,
    /// Bytes.
    pub bytes: u64,
}

/// Everything a seat says of one phase.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhaseReport {
    /// The phase.
    pub phase: Phase,
    /// What the seat did; none if it idled.
    pub work: Option<WorkReport>,
    /// Bytes sent to each peer so far.
    #[serde(deserialize_with = "crate::codec::list")]
    pub sent: Vec<LinkBytes>,
    /// Bytes sent to the coordinator so far.
    pub sent_control: u64,
    /// Demand loading in this phase.
    pub io: IoCounts,
    /// Highest resident set size of the process so far, bytes.
    pub peak_rss: u64,
    /// Most bytes of skeleton, geometry and textures held so far, buffers on their way included.
    pub peak_resident: u64,
}

/// One role's work on one frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct WorkReport {
    /// The role.
    pub role: Role,
    /// The frame it worked on.
    pub frame: FrameIndex,
    /// When the phase message was handled.
    pub phase_received: Nanos,
    /// When the role's own work began (after its input had come).
    pub started: Nanos,
    /// When it ended, measuring not counted.
    pub finished: Nanos,
    /// HC: when the end-of-frame message was queued, behind the chunks that the socket has not taken yet.
    pub visible_sent: Option<Nanos>,
    /// OR and RVG in `switch`, OR in `rotate`: when the end-of-frame message was handled.
    pub visible_received: Option<Nanos>,
    /// HC alone.
    pub cull: Option<CullCounts>,
    /// OR and RVG.
    pub draw: Option<DrawCounts>,
}
