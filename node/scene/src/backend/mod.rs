//! The one seam between deciding what to draw and drawing it: data both ways.
//!
//! Coordinates reaching a backend are relative to the eye, in scene axes. Depth is reversed
//! (1 at the near plane, 0 at infinity) in 32-bit floats, cleared to 0, tested with GreaterEqual.

pub mod cpu;
pub mod light;

use protocol::id::{BlobId, HlodId};
use protocol::settings::{Cull, PictureSize};
use protocol::telemetry::BackendInfo;

/// Where the camera looks, for a whole pass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Picture size.
    pub size: PictureSize,
    /// `clip_from_eye`, four columns: rotation and infinite reversed-Z projection. Clip w is the depth
    /// along the view direction in scene units, clip z the near distance.
    pub clip_from_eye: [[f32; 4]; 4],
}

/// One mesh to draw: `eye_relative = linear * grid + offset`, `grid` being the vertex's integers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Draw {
    /// The mesh; must have been uploaded.
    pub blob: BlobId,
    /// What the item buffer stores.
    pub item: HlodId,
    /// Columns: placement's linear part times the blob's step.
    pub linear: [[f32; 3]; 3],
    /// Grid origin relative to the eye.
    pub offset: [f32; 3],
}

/// An eye-relative box, already grown; it neither holds the eye nor crosses the near plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoxQuery {
    /// Least corner.
    pub min: [f32; 3],
    /// Greatest corner.
    pub max: [f32; 3],
}

/// Work for a backend. Draws are rendered in the order given.
#[derive(Debug, Clone, PartialEq)]
pub enum Pass {
    /// Clear the occlusion depth and render these into it. It stays with the backend.
    Occluders {
        /// The camera.
        view: View,
        /// Occluders.
        draws: Vec<Draw>,
    },
    /// Test boxes against the occlusion depth, which stays as it is.
    QueryBoxes {
        /// The camera: the same as the occluders'.
        view: View,
        /// The boxes.
        boxes: Vec<BoxQuery>,
        /// `Queries` or `Boxes`; a backend without such a choice uses the one way it has.
        method: Cull,
    },
    /// Draw a picture with its own colour and depth and read it back.
    Shade {
        /// The camera.
        view: View,
        /// What is seen.
        draws: Vec<Draw>,
        /// Return the depth as well.
        with_depth: bool,
    },
    /// Draw item ids with their own depth and read them back.
    Items {
        /// The camera.
        view: View,
        /// What is seen.
        draws: Vec<Draw>,
    },
}

/// Names a submitted pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub u64);

/// A picture: `4 * width * height` bytes, sRGB-encoded RGBA, top row first.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// RGBA bytes.
    pub rgba: Vec<u8>,
    /// Depth, `width * height`, where it was asked for.
    pub depth: Option<Vec<f32>>,
}

/// Stands in the item buffer where nothing was drawn.
pub const NO_ITEM: u32 = u32::MAX;

/// What came of a pass.
#[derive(Debug, Clone, PartialEq)]
pub enum Completion {
    /// The depth is made.
    Occluders {
        /// The pass.
        ticket: Ticket,
    },
    /// Answers for `boxes[first..first + visible.len()]`; parts come in order, `last` ends them.
    Boxes {
        /// The pass.
        ticket: Ticket,
        /// Index of the first box answered here.
        first: usize,
        /// Whether a pixel of the box would pass.
        visible: Vec<bool>,
        /// No more parts.
        last: bool,
    },
    /// A picture.
    Picture {
        /// The pass.
        ticket: Ticket,
        /// The picture.
        picture: Picture,
    },
    /// Item ids, `width * height`, top row first; [`NO_ITEM`] where nothing was drawn.
    Items {
        /// The pass.
        ticket: Ticket,
        /// Ids.
        items: Vec<u32>,
    },
}

/// Why a backend cannot go on.
#[derive(Debug, Clone, thiserror::Error)]
pub enum BackendError {
    /// No adapter of the kind asked for.
    #[error("no graphics adapter: {0}")]
    NoAdapter(String),
    /// The adapter lacks something, or the picture is too large for it.
    #[error("the graphics adapter {adapter} cannot do this: {reason}")]
    Unsupported {
        /// Its name.
        adapter: String,
        /// What it lacks.
        reason: String,
    },
    /// The device was lost or ran out of memory.
    #[error("the graphics device failed: {0}")]
    Device(String),
}

/// Draws passes. Uploads come before the passes that use them.
pub trait Backend {
    /// What this is, for the log.
    fn info(&self) -> BackendInfo;

    /// Takes a blob's bytes: [`protocol::format::vertex`] vertices, then 16-bit indices.
    fn upload(
        &mut self,
        blob: BlobId,
        vertices: u32,
        triangles: u32,
        bytes: &[u8],
    ) -> Result<(), BackendError>;

    /// Forgets a blob.
    fn evict(&mut self, blob: BlobId);

    /// Starts a pass.
    fn submit(&mut self, pass: Pass) -> Result<Ticket, BackendError>;

    /// Appends what has come of submitted passes, in order, waiting until there is at least one
    /// completion if any pass is under way.
    fn poll(&mut self, completions: &mut Vec<Completion>) -> Result<(), BackendError>;
}
