//! The one seam between deciding what to draw and drawing it: data both ways.
//!
//! Coordinates reaching a backend are relative to the eye, in scene axes. Depth is reversed
//! (1 at the near plane, 0 at infinity) in 32-bit floats, cleared to 0, tested with GreaterEqual. A backend
//! whose depth does not stem from the corners that decide coverage moves it by the biases of
//! [`crate::occludee`], in all passes alike.

pub mod cpu;
pub mod light;

use protocol::format::{Blob, Texture, Wrap, texture};
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
    /// Distance from the eye to the middle of its hlod's box: what blends is drawn far to near.
    pub distance: f32,
}

impl Draw {
    /// It turns counter-clockwise corners clockwise.
    pub fn is_mirrored(&self) -> bool {
        let [x, y, z] = self.linear.map(|column| column.map(f64::from));
        let cross =
            [y[1] * z[2] - y[2] * z[1], y[2] * z[0] - y[0] * z[2], y[0] * z[1] - y[1] * z[0]];
        x[0] * cross[0] + x[1] * cross[1] + x[2] * cross[2] < 0.0
    }
}

/// Indices of the draws that `blends` picks by index, far to near; at one distance in the order given.
///
/// Of a list with draws left out it is the same order with those left out.
pub fn far_to_near(draws: &[Draw], blends: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut order: Vec<usize> = (0..draws.len()).filter(|&index| blends(index)).collect();
    order.sort_by(|&a, &b| draws[b].distance.total_cmp(&draws[a].distance));
    order
}

/// A texture's record and its mips as they lie in the file.
pub type TextureUpload<'a> = (Texture, &'a [u8]);

/// Most pixels along a side of what a backend stores; larger mips are left out.
pub const LARGEST_STORED_SIDE: u32 = 1024;

/// Side, wrap modes and mips of a texture as a backend stores it. The bytes may come from anywhere.
pub fn stored_mips<'a>(
    record: &Texture,
    bytes: &'a [u8],
) -> Result<(u32, [Wrap; 2], &'a [u8]), BackendError> {
    let damaged = || BackendError::Device(format!("a texture of side {} is damaged", record.side));
    let wrap = Wrap::unpack(record.wrap).ok_or_else(damaged)?;
    if !texture::is_side(record.side) || bytes.len() as u64 != texture::mip_bytes(record.side) {
        return Err(damaged());
    }
    let side = record.side.min(LARGEST_STORED_SIDE);
    let left_out = bytes.len() - texture::mip_bytes(side) as usize;
    Ok((side, wrap, &bytes[left_out..]))
}

/// An eye-relative box, already grown; it neither holds the eye nor crosses the near plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoxQuery {
    /// Least corner.
    pub min: [f32; 3],
    /// Greatest corner.
    pub max: [f32; 3],
}

/// Work for a backend.
///
/// Draws are rendered class by class in the order given, but what blends in that of [`far_to_near`].
/// Single-sided triangles are drawn from their front alone, in every pass.
#[derive(Debug, Clone, PartialEq)]
pub enum Pass {
    /// Clear the occlusion depth and render what is opaque of these into it. It stays with the backend.
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
    /// Draw a picture with its own colour and depth and read it back. What blends leaves no depth.
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
        /// The nearest that does not blend.
        items: Vec<u32>,
        /// The last drawn of those that blend and lie before it: what blends hides nothing.
        blended: Vec<u32>,
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

    /// Takes all textures of the scene, by their index, in place of any before. They come before the
    /// first textured blob.
    fn upload_textures(&mut self, textures: &[TextureUpload<'_>]) -> Result<(), BackendError>;

    /// Takes a blob's bytes: [`protocol::format::vertex`] vertices, then 16-bit indices. Of `blob` it
    /// reads counts, layout and classes.
    fn upload(&mut self, id: BlobId, blob: &Blob, bytes: &[u8]) -> Result<(), BackendError>;

    /// Forgets a blob.
    fn evict(&mut self, blob: BlobId);

    /// Starts a pass.
    fn submit(&mut self, pass: Pass) -> Result<Ticket, BackendError>;

    /// Appends what has come of submitted passes, in order, waiting until there is at least one
    /// completion if any pass is under way.
    fn poll(&mut self, completions: &mut Vec<Completion>) -> Result<(), BackendError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draw(item: u32, distance: f32) -> Draw {
        let linear = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        Draw { blob: BlobId(0), item: HlodId(item), linear, offset: [0.0; 3], distance }
    }

    #[test]
    fn what_blends_is_drawn_far_to_near() {
        assert!(far_to_near(&[], |_| true).is_empty());
        let draws: Vec<Draw> =
            (0..).zip([1.0, 3.0, 2.0, 3.0, 0.0]).map(|(i, d)| draw(i, d)).collect();
        assert_eq!(far_to_near(&draws, |_| true), [1, 3, 2, 0, 4]);
        assert_eq!(far_to_near(&draws, |index| index != 1), [3, 2, 0, 4]);
    }

    #[test]
    fn an_odd_number_of_mirrors_mirrors() {
        let mut draw = draw(0, 0.0);
        for mirrored in [true, false, true] {
            let k = draw.linear.iter().position(|column| column.iter().all(|&c| c >= 0.0)).unwrap();
            draw.linear[k] = draw.linear[k].map(|c| -c * 1e-20);
            assert_eq!(draw.is_mirrored(), mirrored);
        }
    }

    #[test]
    fn textures_beyond_the_largest_side_lose_their_largest_mips() {
        let record = |side, bytes| Texture { offset: 0, bytes, side, wrap: 0, crc: 0, reserved: 0 };
        let bytes = vec![7; texture::mip_bytes(2048) as usize];
        let (side, _, mips) = stored_mips(&record(2048, 0), &bytes).unwrap();
        assert_eq!((side, mips.len() as u64), (1024, texture::mip_bytes(1024)));
        let one = stored_mips(&record(1, 0), &[1, 2, 3, 4]).unwrap();
        assert_eq!(one, (1, [Wrap::Repeat; 2], &[1, 2, 3, 4][..]));
        for side in [0, 2, 3, u32::MAX] {
            assert!(stored_mips(&record(side, 4), &[1, 2, 3, 4]).is_err(), "{side}");
        }
        assert!(stored_mips(&Texture { wrap: 3, ..record(1, 4) }, &[1, 2, 3, 4]).is_err());
    }
}
