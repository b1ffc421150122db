//! Far fields at run time: which blobs a viewpoint needs, and what is drawn of them.

use crate::redundancy::Tolerance;
use crate::select::{Budget, Choice, Selected, selected};
use crate::sight::{Shown, Sight, on_face};
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::projected::{FACES, FaceAxes, SUBPIXELS};
use protocol::format::{Blob, Cube, NONE, Skeleton, ViewCell};
use protocol::id::{BlobId, HlodId};
use protocol::settings::PictureSize;
use scene::backend::{Draw, NO_ITEM};
use scene::view_cells::Cells;
use std::sync::Arc;

/// What stands in for the far fields of a scene.
pub trait FarField: Send + Sync {
    /// The blobs that may be drawn from `eye`, wherever the camera looks, in order of need; none outside
    /// of the cells.
    fn wanted(&self, eye: [f64; 3]) -> Vec<BlobId>;

    /// The draws for a camera of the far field of one of the cells, which is an index into
    /// [`Skeleton::view_cells`], in the order of need.
    fn draws(&self, cell: usize, camera: &Camera, size: PictureSize) -> Vec<Draw>;
}

/// Scan cubes with a dependency tree, which a standard textured depth mesh is the smallest case of.
pub struct Cubes {
    skeleton: Arc<Skeleton>,
    cells: Arc<Cells>,
    budget: Budget,
}

impl Cubes {
    /// Those of `cells`, which are numbered as the skeleton's.
    pub fn new(skeleton: Arc<Skeleton>, cells: Arc<Cells>, budget: Budget) -> Self {
        Self { skeleton, cells, budget }
    }

    /// Cubes to draw of a cell, by index into its own; `triangles` tells how many of each lie in view.
    fn selected(
        &self,
        cell: &ViewCell,
        eye: [f64; 3],
        budget: &Budget,
        triangles: impl Fn(usize) -> u64,
    ) -> Selected {
        let cubes = self.skeleton.cubes_of(cell).iter().enumerate();
        let choices = cubes.map(|(at, cube)| Choice {
            eye: DVec3::from_array(cube.eye),
            parent: (cube.parent != NONE).then(|| (cube.parent - cell.first_cube) as usize),
            triangles: triangles(at),
        });
        selected(&choices.collect::<Vec<_>>(), DVec3::from_array(eye), budget)
    }

    /// The patches of a cube: face, number and record.
    fn patches(&self, cube: &Cube) -> impl Iterator<Item = (usize, BlobId, &Blob)> {
        let of_face = |face| cube.patches_of(face).map(move |blob| (face, BlobId(blob)));
        let all = (0..FACES.len()).flat_map(of_face);
        all.map(|(face, blob)| (face, blob, self.skeleton.blob(blob)))
    }
}

impl FarField for Cubes {
    fn wanted(&self, eye: [f64; 3]) -> Vec<BlobId> {
        // How many triangles lie in the frustum is not known, so they cannot end the list.
        let budget = Budget { triangles: None, ..self.budget };
        let compositions = self.cells.compositions(eye);
        let cells = compositions.iter().filter_map(|of| of.cell).map(|(cell, _)| cell);
        let cubes = cells.flat_map(|cell| {
            let cell = &self.skeleton.view_cells[cell];
            let of_cell = self.skeleton.cubes_of(cell);
            self.selected(cell, eye, &budget, |_| 0).cubes.into_iter().map(|at| &of_cell[at])
        });
        cubes.flat_map(Cube::blobs).map(BlobId).collect()
    }

    fn draws(&self, cell: usize, camera: &Camera, size: PictureSize) -> Vec<Draw> {
        let cell = &self.skeleton.view_cells[cell];
        let cubes = self.skeleton.cubes_of(cell);
        let sight = Sight::new(camera, size);
        let in_view = |cube| {
            let patches = self.patches(cube);
            patches.filter(|(face, _, patch)| sight.meets(&shown(cube, *face, patch))).collect()
        };
        let in_view: Vec<Vec<_>> = cubes.iter().map(in_view).collect();
        let triangles =
            |at: usize| in_view[at].iter().map(|(_, _, patch)| u64::from(patch.triangles)).sum();
        // Pictures that are mixed share the triangles.
        let pictures = || self.cells.compositions(camera.eye).len() as u64;
        let most = self.budget.triangles.map(|most| most / pictures());
        let budget = Budget { triangles: most, ..self.budget };
        let chosen = self.selected(cell, camera.eye, &budget, triangles);
        let of_cube = |(place, at): (usize, usize)| {
            let cube = &cubes[at];
            let back = if place < chosen.path { 0.0 } else { set_back(cube.side) };
            in_view[at].iter().map(move |(face, blob, patch)| {
                patch_draw(cube, *face, *blob, patch, camera.eye, back)
            })
        };
        chosen.cubes.iter().copied().enumerate().flat_map(of_cube).collect()
    }
}

/// Share of its distance by which a cube is drawn behind the nearest one and those that one depends on, so that what
/// several show is seen as the nearest saw it: as much as the points of two may differ and still be one
/// ([`crate::redundancy::Tolerance`]).
fn set_back(side: u32) -> f64 {
    Tolerance::default().at(1.0, side)
}

/// What a patch can show.
fn shown(cube: &Cube, face: usize, patch: &Blob) -> Shown {
    Shown {
        eye: DVec3::from_array(cube.eye),
        face,
        least: [patch.origin[0], patch.origin[1]].map(|at| on_face(at, cube.side)),
        across: f64::from(patch.image[0]) * 2.0 / f64::from(cube.side),
        step: patch.step,
    }
}

/// How a patch is drawn for an eye ([`protocol::format::projected`]), `back` of its distance behind where it
/// is: the fourth coordinate decides on the depth alone.
fn patch_draw(
    cube: &Cube,
    face: usize,
    blob: BlobId,
    patch: &Blob,
    eye: [f64; 3],
    back: f64,
) -> Draw {
    let FaceAxes { forward, right, up } = FACES[face];
    let unit = 2.0 / f64::from(cube.side) / f64::from(SUBPIXELS);
    let [left, top] = [patch.origin[0], patch.origin[1]].map(|at| on_face(at, cube.side));
    let vector = |of: &dyn Fn(usize) -> f64| std::array::from_fn(|k| of(k) as f32);
    Draw {
        blob,
        item: HlodId(NO_ITEM),
        linear: [
            vector(&|k| right[k] * unit),
            vector(&|k| -up[k] * unit),
            vector(&|k| (cube.eye[k] - eye[k]) * patch.step),
        ],
        offset: vector(&|k| forward[k] + right[k] * left - up[k] * top),
        distance: 0.0,
        disparity_step: (patch.step / (1.0 + back)) as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draw_takes_a_vertex_to_its_point() {
        let (at, eye) = ([10.0, 20.0, 30.0], [11.0, 19.0, 30.5]);
        let cube = Cube { eye: at, patches: [0; 7], side: 64, parent: NONE, triangles: 0 };
        let patch =
            Blob { step: 0.25, origin: [16.0, 0.0, 0.0], image: [48, 0], ..Blob::default() };
        for (face, FaceAxes { forward, right, up }) in FACES.into_iter().enumerate() {
            let draw = patch_draw(&cube, face, BlobId(face as u32), &patch, eye, 0.0);
            // Pixel (48, 8) of the face, which is (32, 8) of the window; disparity 0.5.
            let grid = [32.0 * 16.0, 8.0 * 16.0, 2.0];
            for k in 0..3 {
                let linear = (0..3).map(|j| draw.linear[j][k] * grid[j]).sum::<f32>();
                let point = cube.eye[k] + 2.0 * (forward[k] + 0.5 * right[k] + 0.75 * up[k]);
                let expected = (point - eye[k]) * 0.5;
                assert!((f64::from(linear + draw.offset[k]) - expected).abs() < 1e-5);
            }
            assert_eq!(draw.disparity_step, 0.25);
        }
    }
}
