//! A scan cube: the meshes and pictures made of one sample (paper 000, section 4).

use crate::depth_mesh::dense::dense_mesh;
use crate::depth_mesh::simplify::{FaceMesh, Purpose, simplified};
use crate::neighbours::Pixel;
use crate::normals::FaceNormals;
use crate::patches::{BakedPatch, patches};
use crate::picture::stored_picture;
use crate::redundancy::Surviving;
use crate::sample::{FACES, Sample};
use glam::DVec3;
use rayon::prelude::*;

/// A face that shows something.
#[derive(Debug, Clone, PartialEq)]
pub struct BakedFace {
    /// Its mesh, the triangles of a patch one after another.
    pub mesh: FaceMesh,
    /// What its mesh is cut into, and the picture of each.
    pub patches: Vec<BakedPatch>,
}

/// A cube as it is stored.
#[derive(Debug, Clone, PartialEq)]
pub struct BakedCube {
    /// The sample's viewpoint.
    pub eye: DVec3,
    /// The earlier cube of the cell that it depends on.
    pub parent: Option<usize>,
    /// None where nothing survives.
    pub faces: [Option<BakedFace>; 6],
}

impl BakedCube {
    /// Of all faces.
    pub fn triangles(&self) -> u64 {
        self.faces.iter().flatten().map(|face| face.mesh.triangles.len() as u64).sum()
    }
}

/// What a cell's cubes are made to look right from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewpoints {
    /// Least corner.
    pub min: DVec3,
    /// Greatest corner.
    pub max: DVec3,
}

impl Viewpoints {
    /// Greatest distance from a point to any of them.
    pub fn reach(&self, from: DVec3) -> f64 {
        (from - self.min).abs().max((self.max - from).abs()).length()
    }
}

/// Makes the faces of a cube of those pixels of a sample that survive, within `tolerance_px` pixels.
pub fn faces(
    sample: &Sample,
    surviving: &Surviving,
    viewpoints: &Viewpoints,
    tolerance_px: f64,
    joined: &(impl Fn(Pixel, Pixel) -> bool + Sync),
) -> [Option<BakedFace>; 6] {
    let reach = viewpoints.reach(sample.eye);
    let made: Vec<Option<BakedFace>> = (0..6)
        .into_par_iter()
        .map(|face| {
            let dense = dense_mesh(sample, face, surviving, joined);
            if dense.triangles.is_empty() {
                return None;
            }
            let purpose = Purpose { side: sample.side, reach, tolerance_px };
            let mut mesh = simplified(&dense, &purpose);
            let (picture, side) = (&sample.faces[face], sample.side);
            let normals = FaceNormals::of(picture, side, &FACES[face]);
            let cut = patches(&mut mesh, side).into_iter().map(|(triangles, window)| {
                let shown = &mesh.triangles[triangles.clone()];
                let normals = normals.as_ref();
                let picture = stored_picture(picture, normals, side, &mesh, shown, window);
                BakedPatch { triangles, window, picture }
            });
            let patches = cut.collect();
            Some(BakedFace { mesh, patches })
        })
        .collect();
    made.try_into().expect("six faces")
}
