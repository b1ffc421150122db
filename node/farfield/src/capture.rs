//! Takes samples through a backend (paper 000, section 3.1): six pictures with depth, of the far field
//! alone, at no more than half a pixel of error, in the corners of a face as in its middle.

use crate::placement::Source;
use crate::sample::{FACES, FaceAxes, FacePicture, Sample};
use glam::DVec3;
use protocol::camera::Camera;
use protocol::id::BlobId;
use protocol::settings::PictureSize;
use scene::asset::Asset;
use scene::backend::{
    Backend, BackendError, Completion, Draw, Draws, Part, Pass, Picture, Shading, Upload, View,
    upload_textures_of,
};
use scene::draw_list::draw_list;
use scene::front::{Field, front_of};
use scene::near_field::NearField;
use scene::residency::{Residency, Stamp};
use scene::store::{Store, StoreError};

/// Pixels of its faces by which what a sample is taken of is seen away from its place at most.
pub const LOD_PX: f64 = 0.5;

/// Why a sample cannot be taken.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The renderer gave up.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// A mesh or texture cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// They do not fit.
    #[error("the textures take more than the memory that samples are taken in; raise --memory")]
    Textures,
    /// One mesh beside the textures is more than the backend may hold.
    #[error("mesh {0} does not fit the memory that samples are taken in; raise --memory")]
    NoRoom(BlobId),
}

/// A scene on a backend whose pictures are the faces of samples.
pub struct Studio<'a> {
    store: &'a Store,
    backend: Box<dyn Backend + 'a>,
    side: u32,
    near_plane: f32,
    takes_normals: bool,
    residency: Residency,
    now: Stamp,
}

impl<'a> Studio<'a> {
    /// `backend` was made for square pictures of `side` pixels and holds nothing yet.
    pub fn new(
        store: &'a Store,
        mut backend: Box<dyn Backend + 'a>,
        side: u32,
        near_plane: f32,
    ) -> Result<Self, CaptureError> {
        if upload_textures_of::<CaptureError>(store, backend.as_mut())? == Upload::Full {
            return Err(CaptureError::Textures);
        }
        let residency = Residency::new(store.skeleton().blobs.len(), 0);
        Ok(Self { store, backend, side, near_plane, takes_normals: false, residency, now: 0 })
    }

    /// This one, whose samples hold normals ([`FacePicture::normal`]), which takes twice the time.
    pub fn with_normals(self) -> Self {
        Self { takes_normals: true, ..self }
    }

    /// What is seen from `eye` of all that is not `near`.
    pub fn sample(&mut self, eye: DVec3, near: &NearField) -> Result<Sample, CaptureError> {
        let mut faces: [FacePicture; 6] = Default::default();
        for (face, axes) in faces.iter_mut().zip(FACES) {
            *face = self.face(&self.camera(eye, &axes), near)?;
        }
        Ok(Sample { eye, side: self.side, faces })
    }

    fn camera(&self, eye: DVec3, axes: &FaceAxes) -> Camera {
        Camera {
            eye: eye.to_array(),
            forward: axes.forward.map(|c| c as f32),
            up: axes.up.map(|c| c as f32),
            tan_half_fov_y: 1.0,
            near: self.near_plane,
        }
    }

    fn face(&mut self, camera: &Camera, near: &NearField) -> Result<FacePicture, CaptureError> {
        let skeleton = self.store.skeleton();
        let size = PictureSize { width: self.side, height: self.side };
        let front = front_of(skeleton, camera, size, LOD_PX, &Field::Far(near));
        let draws = draw_list(skeleton, &front.entries, camera.eye);
        let view = View::new(camera, size);
        let Picture { rgba, depth } = self.picture(view, Shading::default(), &draws)?;
        let normal = match self.takes_normals {
            true => {
                let solid = Draws { blending: Vec::new(), ..draws };
                rgb(&self.picture(view, Shading::Normals, &solid)?.rgba)
            }
            false => Vec::new(),
        };
        let depth = depth.expect("it was asked for");
        let disparity = depth.iter().map(|d| d / self.near_plane).collect();
        Ok(FacePicture { disparity, color: rgb(&rgba), normal })
    }

    /// Draws all of a list, in parts where it does not fit at once.
    fn picture(
        &mut self,
        view: View,
        shading: Shading,
        draws: &Draws,
    ) -> Result<Picture, CaptureError> {
        self.now += 1;
        let mut pending = Pending { view, shading, draws: Draws::default(), opens: true };
        for (list, blends) in [(&draws.solid, false), (&draws.blending, true)] {
            for run in list.chunk_by(|a, b| a.blob == b.blob) {
                self.hold(run[0].blob, &mut pending)?;
                pending.push(run, blends);
            }
        }
        self.backend.submit(pending.pass(true))?;
        let mut completions = Vec::new();
        while completions.is_empty() {
            self.backend.poll(&mut completions)?;
        }
        let Some(Completion::Picture { picture, .. }) = completions.pop() else {
            unreachable!("a picture answers as such")
        };
        Ok(picture)
    }

    /// Makes sure that a blob is there: at the cost of those this face does not use, else by drawing what
    /// is pending and giving up what that used.
    fn hold(&mut self, blob: BlobId, pending: &mut Pending) -> Result<(), CaptureError> {
        let asset = Asset::Blob(blob);
        if self.residency.holds(asset) {
            self.residency.touch(asset, self.now);
            return Ok(());
        }
        let bytes = self.store.load_blob(blob)?;
        let record = self.store.skeleton().blob(blob);
        while self.backend.upload(blob, record, &bytes)? == Upload::Full {
            let victim = match self.oldest() {
                Some(victim) => victim,
                None => {
                    self.backend.submit(pending.pass(false))?;
                    self.now += 1;
                    self.oldest().ok_or(CaptureError::NoRoom(blob))?
                }
            };
            self.backend.evict(victim);
            self.residency.remove(Asset::Blob(victim));
        }
        self.residency.insert(asset, self.now, false);
        Ok(())
    }

    /// The blob that has not been used for longest, and not by this face.
    fn oldest(&self) -> Option<BlobId> {
        self.residency.older_than(self.now).find_map(|asset| match asset {
            Asset::Blob(id) => Some(id),
            Asset::Texture(_) => None,
        })
    }
}

/// Samples of the far field beside one near field.
pub struct OfCell<'s, 'a> {
    /// Where they are taken.
    pub studio: &'s mut Studio<'a>,
    /// What they leave out.
    pub near: &'s NearField,
}

impl Source for OfCell<'_, '_> {
    type Error = CaptureError;

    fn sample(&mut self, eye: DVec3) -> Result<Sample, CaptureError> {
        self.studio.sample(eye, self.near)
    }
}

/// Draws of a pass that have not been submitted.
struct Pending {
    view: View,
    shading: Shading,
    draws: Draws,
    opens: bool,
}

impl Pending {
    fn push(&mut self, run: &[Draw], blends: bool) {
        let list = if blends { &mut self.draws.blending } else { &mut self.draws.solid };
        list.extend_from_slice(run);
    }

    /// The part of the pass that they are.
    fn pass(&mut self, closes: bool) -> Pass {
        let part = Part { opens: std::mem::take(&mut self.opens), closes };
        let (view, shading, draws) = (self.view, self.shading, std::mem::take(&mut self.draws));
        Pass::Shade { view, shading, draws, with_depth: closes, part }
    }
}

fn rgb(rgba: &[u8]) -> Vec<[u8; 3]> {
    rgba.as_chunks::<4>().0.iter().map(|&[r, g, b, _]| [r, g, b]).collect()
}

#[cfg(test)]
mod tests;
