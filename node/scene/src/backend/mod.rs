//! The one seam between deciding what to draw and drawing it: data both ways.
//!
//! Coordinates reaching a backend are relative to the eye, in scene axes. Depth is reversed
//! (1 at the near plane, 0 at infinity) in 32-bit floats, cleared to 0, tested with GreaterEqual. A backend
//! whose depth does not stem from the corners that decide coverage moves it by the biases of
//! [`crate::occludee`], in all passes alike; that of projected blobs stays where it is.
//!
//! A projected blob ([`protocol::format::projected`]) is shown as it was shaded: its picture under a bilinear
//! filter, without mips, whose pixels are made linear before they are weighed. Beyond the picture its border
//! goes on; for a pixel whose tile is not stored stands the nearest of the filter's four that is. Under another sun
//! than the bake's, pixels that have normals are lit again ([`light`]).

pub mod cpu;
pub mod light;
pub mod normal;
mod part;
mod texture_room;
mod warm_up;

pub use part::{Part, UnderWay};
pub use texture_room::{
    LARGEST_STORED_SIDE, list_bytes, page_side, stored_bytes, stored_mips, stored_shape,
    texture_room,
};
pub use warm_up::warm_up;

use crate::occludee::Precision;
use crate::store::{Store, StoreError};
use protocol::format::{Blob, Texture};
use protocol::id::{BlobId, HlodId};
use protocol::settings::{Cull, PictureSize};
use protocol::sun::Sun;
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
    /// Distance from the eye to the middle of its hlod's box, by which what blends is put in order.
    pub distance: f32,
    /// Disparity of a unit of z of a projected blob's grid, 0 for other blobs. With it `linear * grid +
    /// offset` is the eye-relative position times the disparity `grid.z * disparity_step`
    /// ([`protocol::format::projected`]); what is nearer than the near plane is cut off. The first two columns
    /// lie along the face's right and down, which tell what the axes of its normals are.
    pub disparity_step: f32,
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

/// What a picture is drawn of. A draw with classes of both kinds stands in both lists.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Draws {
    /// Of these the classes that do not blend are drawn. Neighbours of one blob are drawn class by class.
    pub solid: Vec<Draw>,
    /// Of these the classes that blend are drawn, after all that is solid, draw by draw.
    pub blending: Vec<Draw>,
}

/// A texture's record and its mips as they lie in the file.
pub type TextureUpload<'a> = (Texture, &'a [u8]);

/// An eye-relative box, already grown. It does not hold the eye, and nothing of it that the picture shows
/// lies before the near plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoxQuery {
    /// Least corner.
    pub min: [f32; 3],
    /// Greatest corner.
    pub max: [f32; 3],
}

/// What the pixels of a picture are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shading {
    /// Colours under [`light`], sRGB-encoded.
    Lit {
        /// Unit vector towards the sun, scene axes.
        sun: [f32; 3],
    },
    /// Codes ([`normal`]) of unit normals in scene axes that face the viewer, of the nearest that does not
    /// blend: what blends shows through, and is left out. Where nothing is drawn, and on projected blobs,
    /// stands the code of no normal.
    Normals,
}

impl Default for Shading {
    fn default() -> Self {
        Self::Lit { sun: Sun::default().unit() }
    }
}

/// Work for a backend.
///
/// Draws are rendered in the order given, see [`Draws`]. Single-sided triangles are drawn from their front
/// alone, in every pass. A pass that draws may come in consecutive [parts](Part).
#[derive(Debug, Clone, PartialEq)]
pub enum Pass {
    /// Render what is opaque of these into the occlusion depth. It stays with the backend.
    Occluders {
        /// The camera.
        view: View,
        /// Occluders, as [`Draws::solid`].
        draws: Vec<Draw>,
        /// They are drawn to what is there of the same view, which is not cleared.
        adds: bool,
        /// Which part of the pass this is.
        part: Part,
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
    /// Test meshes against the occlusion depth, which stays as it is. All classes count as opaque. It is answered
    /// as boxes are, with one answer for each stretch of draws of one item.
    QueryMeshes {
        /// The camera: the same as the occluders'.
        view: View,
        /// The meshes; those of an item follow each other.
        draws: Vec<Draw>,
    },
    /// Draw a picture with its own colour and depth and read it back. What blends leaves no depth.
    Shade {
        /// The camera.
        view: View,
        /// What its pixels are.
        shading: Shading,
        /// What is seen.
        draws: Draws,
        /// Return the depth as well; the part that closes decides.
        with_depth: bool,
        /// Which part of the pass this is.
        part: Part,
    },
    /// Draw item ids with their own depth and read them back.
    Items {
        /// The camera.
        view: View,
        /// What is seen.
        draws: Draws,
        /// Which part of the pass this is.
        part: Part,
    },
}

/// Names a submitted pass, or part of one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub u64);

/// A picture: `4 * width * height` bytes, top row first.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// RGB as its [`Shading`] says, and 255.
    pub rgba: Vec<u8>,
    /// Depth, `width * height`, where it was asked for.
    pub depth: Option<Vec<f32>>,
}

/// Stands in the item buffer where nothing was drawn.
pub const NO_ITEM: u32 = u32::MAX;

/// What came of a pass; its ticket is that of the part that closed it.
#[derive(Debug, Clone, PartialEq)]
pub enum Completion {
    /// The depth is made.
    Occluders {
        /// The pass.
        ticket: Ticket,
    },
    /// Answers for `boxes[first..first + visible.len()]`, or for as many items; parts come in order, `last`
    /// ends them.
    Boxes {
        /// The pass.
        ticket: Ticket,
        /// Index of the first box or item answered here.
        first: usize,
        /// Whether a pixel of it would pass.
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

/// The budget of a backend that may take all the memory there is.
pub const UNLIMITED: u64 = u64::MAX;

/// What became of an upload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[must_use]
pub enum Upload {
    /// It is there.
    Done,
    /// The backend's budget has no room for it, and nothing changed. Evicting makes room.
    Full,
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
///
/// A backend is made with a budget: the bytes that meshes and textures take together never exceed it.
pub trait Backend {
    /// What this is, for the log.
    fn info(&self) -> BackendInfo;

    /// What its depths may err by.
    fn precision(&self) -> Precision;

    /// All memory taken for meshes and textures, bytes: also what is kept for those to come, so it need
    /// not fall when a blob is evicted.
    fn held_bytes(&self) -> u64;

    /// Names all textures of the scene, in place of any before, and sets room apart for them: what all of
    /// them take ([`texture_room`]), `room` bytes at most. Meshes have the rest of the budget. None of the
    /// textures is there yet. `Full`, and nothing changed, where meshes leave no such room.
    fn declare_textures(&mut self, textures: &[Texture], room: u64)
    -> Result<Upload, BackendError>;

    /// Takes the mips of the declared texture of this index, before the first pass whose meshes name it; one
    /// that is there stays as it is. `Full`: evicting textures makes room, and into room without any fits
    /// what [`texture_room`] says.
    fn upload_texture(&mut self, index: u32, bytes: &[u8]) -> Result<Upload, BackendError>;

    /// Forgets a texture. Passes that were submitted still show it.
    fn evict_texture(&mut self, index: u32);

    /// Waits until all that was uploaded lies where passes read it, so that none of them waits for that.
    fn settle(&mut self) -> Result<(), BackendError>;

    /// Takes a blob's bytes: [`protocol::format::vertex`] vertices, then 16-bit indices, or those of a
    /// [`protocol::format::projected`] blob. Of `blob` it reads counts, layout, classes and the picture's
    /// size. One that takes the place of another of that id needs room beside it.
    ///
    /// What is free may lie in pieces too short for a blob. When all blobs are evicted, any has room that,
    /// its bytes rounded up to a multiple of 32, the budget less the textures holds.
    fn upload(&mut self, id: BlobId, blob: &Blob, bytes: &[u8]) -> Result<Upload, BackendError>;

    /// Forgets a blob. Passes that were submitted still draw it.
    fn evict(&mut self, blob: BlobId);

    /// Starts a pass or goes on with one.
    ///
    /// A part out of turn and a blob that is not there are the caller's mistakes and panic.
    fn submit(&mut self, pass: Pass) -> Result<Ticket, BackendError>;

    /// Appends what has come of submitted passes, in order, waiting until there is at least one
    /// completion if any pass is under way. Parts that do not close their pass are not waited for.
    fn poll(&mut self, completions: &mut Vec<Completion>) -> Result<(), BackendError>;
}

/// Declares and uploads textures that are all to be there at once.
pub fn upload_textures(
    backend: &mut dyn Backend,
    textures: &[TextureUpload<'_>],
) -> Result<Upload, BackendError> {
    let records: Vec<Texture> = textures.iter().map(|(record, _)| *record).collect();
    let mut upload = backend.declare_textures(&records, UNLIMITED)?;
    for ((_, bytes), index) in textures.iter().zip(0..) {
        if upload == Upload::Full {
            break;
        }
        upload = backend.upload_texture(index, bytes)?;
    }
    Ok(upload)
}

/// [`upload_textures`] of a whole scene; the backend has none of it yet.
pub fn upload_textures_of<E: From<StoreError> + From<BackendError>>(
    store: &Store,
    backend: &mut dyn Backend,
) -> Result<Upload, E> {
    let records = &store.skeleton().textures;
    let mut upload = backend.declare_textures(records, UNLIMITED)?;
    for index in 0..records.len() as u32 {
        if upload == Upload::Full {
            break;
        }
        upload = backend.upload_texture(index, &store.load_texture(index)?)?;
    }
    Ok(upload)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_odd_number_of_mirrors_mirrors() {
        let linear = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let (blob, item) = (BlobId(0), HlodId(0));
        let mut draw =
            Draw { blob, item, linear, offset: [0.0; 3], distance: 0.0, disparity_step: 0.0 };
        for mirrored in [true, false, true] {
            let k = draw.linear.iter().position(|column| column.iter().all(|&c| c >= 0.0)).unwrap();
            draw.linear[k] = draw.linear[k].map(|c| -c * 1e-20);
            assert_eq!(draw.is_mirrored(), mirrored);
        }
    }
}
