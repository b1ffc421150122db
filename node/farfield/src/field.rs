//! Far fields at run time: which blobs a viewpoint needs, and what is drawn of them.

use crate::redundancy::Tolerance;
use crate::select::{Budget, Choice, selected};
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::projected::{FACES, FaceAxes, SUBPIXELS};
use protocol::format::vertex::POSITION_MAX;
use protocol::format::{Blob, Cube, NONE, Skeleton, ViewCell};
use protocol::id::{BlobId, HlodId};
use protocol::settings::PictureSize;
use scene::backend::{Draw, NO_ITEM};
use scene::view::frustum;
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

    /// Cubes to draw of a cell; `sees` tells whether a patch may lie in the picture.
    fn cubes(
        &self,
        cell: &ViewCell,
        eye: [f64; 3],
        budget: &Budget,
        sees: impl Fn(&Cube, usize, &Blob) -> bool,
    ) -> Vec<&Cube> {
        let cubes = self.skeleton.cubes_of(cell);
        let choices: Vec<Choice> = cubes
            .iter()
            .map(|cube| Choice {
                eye: DVec3::from_array(cube.eye),
                parent: (cube.parent != NONE).then(|| (cube.parent - cell.first_cube) as usize),
                triangles: self
                    .patches(cube)
                    .filter(|(face, _, patch)| sees(cube, *face, patch))
                    .map(|(_, _, patch)| u64::from(patch.triangles))
                    .sum(),
            })
            .collect();
        let chosen = selected(&choices, DVec3::from_array(eye), budget);
        chosen.into_iter().map(|at| &cubes[at]).collect()
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
            self.cubes(cell, eye, &budget, |_, _, _| true)
        });
        cubes.flat_map(Cube::blobs).map(BlobId).collect()
    }

    fn draws(&self, cell: usize, camera: &Camera, size: PictureSize) -> Vec<Draw> {
        let cell = &self.skeleton.view_cells[cell];
        let sight = Sight::new(camera, size);
        let sees = |cube: &Cube, face, patch: &Blob| sight.meets(cube, face, patch);
        let cubes = self.cubes(cell, camera.eye, &self.budget, sees);
        let distance = |cube: &&Cube| {
            DVec3::from_array(cube.eye).distance_squared(DVec3::from_array(camera.eye))
        };
        let nearest = cubes.iter().map(distance).fold(f64::INFINITY, f64::min);
        // The nearest is the last of the first path, none of which gives way.
        let path = cubes.iter().position(|cube| distance(cube) == nearest).map_or(0, |at| at + 1);
        let of_cube = |(place, cube): (usize, &Cube)| {
            let back = if place < path { 0.0 } else { set_back(cube.side) };
            let patches = self.patches(cube).filter(|(face, _, patch)| sees(cube, *face, patch));
            let draws: Vec<Draw> = patches
                .map(|(face, blob, patch)| patch_draw(cube, face, blob, patch, camera.eye, back))
                .collect();
            draws
        };
        cubes.into_iter().enumerate().flat_map(of_cube).collect()
    }
}

/// Share of its distance by which a cube is drawn behind the nearest one and those that one depends on, so that what
/// several show is seen as the nearest saw it: as much as the points of two may differ and still be one
/// ([`crate::redundancy::Tolerance`]).
fn set_back(side: u32) -> f64 {
    Tolerance::default().at(1.0, side)
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
    let pixel = 2.0 / f64::from(cube.side);
    let unit = pixel / f64::from(SUBPIXELS);
    let [left, top] = [0, 1].map(|k| patch.origin[k] * pixel - 1.0);
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

/// What a camera sees, for culling patches.
struct Sight {
    eye: DVec3,
    /// Normals of the frustum's sides, inwards.
    sides: [DVec3; 5],
}

impl Sight {
    fn new(camera: &Camera, size: PictureSize) -> Self {
        let sides = frustum(camera, size).normals();
        Self { eye: DVec3::from_array(camera.eye), sides }
    }

    /// Whether something of a patch may lie in the picture: no side of the frustum has all of the pyramid over
    /// its window, from the nearest that the patch can show to infinity, beyond it.
    fn meets(&self, cube: &Cube, face: usize, patch: &Blob) -> bool {
        let apex = DVec3::from_array(cube.eye) - self.eye;
        // The greatest disparity that its grid holds.
        let nearest = 1.0 / (patch.step * f64::from(POSITION_MAX));
        let FaceAxes { forward, right, up } = FACES[face];
        let [forward, right, up] = [forward, right, up].map(DVec3::from_array);
        let pixel = 2.0 / f64::from(cube.side);
        let ends = |k: usize| {
            let first = patch.origin[k] * pixel - 1.0;
            [first, first + f64::from(patch.image[0]) * pixel]
        };
        let (across, down) = (ends(0), ends(1));
        let corners = [(0, 0), (0, 1), (1, 0), (1, 1)];
        let corners = corners.map(|(x, y)| forward + right * across[x] - up * down[y]);
        self.sides.iter().all(|side| {
            corners
                .iter()
                .any(|corner| side.dot(*corner) > 0.0 || side.dot(apex + *corner * nearest) > 0.0)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: PictureSize = PictureSize { width: 64, height: 48 };

    fn cube(eye: [f64; 3]) -> Cube {
        Cube { eye, patches: [0, 1, 2, 3, 4, 5, 6], side: 64, parent: NONE, triangles: 6 }
    }

    /// A patch whose window begins at a column and row and has a side, pixels; it shows nothing nearer than 0.7.
    fn patch(at: [u32; 2], side: u32) -> Blob {
        let origin = [f64::from(at[0]), f64::from(at[1]), 0.0];
        let step = 1.0 / (0.7 * f64::from(POSITION_MAX));
        Blob { origin, step, image: [side, 0], ..Blob::default() }
    }

    #[test]
    fn a_patch_is_seen_where_a_point_of_it_is_in_the_picture() {
        use rand::{Rng, SeedableRng, rngs::StdRng};
        let mut rng = StdRng::seed_from_u64(3);
        let mut of =
            |reach: f64| -> [f64; 3] { std::array::from_fn(|_| rng.random_range(-reach..reach)) };
        let windows = [patch([0, 0], 64), patch([16, 0], 32), patch([48, 32], 16)];
        let mut seen = [0; 3];
        let mut hidden = [0; 3];
        for _ in 0..300 {
            let (eye, target) = (of(1.0), of(5.0));
            let camera = Camera::look_at(eye, target, [0.0, 0.0, 1.0], 60.0, 0.01).unwrap();
            let cube = cube(of(1.0));
            let sight = Sight::new(&camera, SIZE);
            for (face, FaceAxes { forward, right, up }) in FACES.into_iter().enumerate() {
                for (k, window) in windows.iter().enumerate() {
                    let (least, most) =
                        ([0, 1].map(|k| window.origin[k]), f64::from(window.image[0]));
                    let any = (0..200).any(|_| {
                        let [a, b, z] = of(1.0);
                        let place =
                            |at: f64, least: f64| (least + 0.5 * (at + 1.0) * most) / 32.0 - 1.0;
                        let (a, b) = (place(a, least[0]), place(b, least[1]));
                        let depth = 0.7 + 50.0 * (z + 1.0);
                        let p: [f64; 3] = std::array::from_fn(|k| {
                            cube.eye[k] + depth * (forward[k] + a * right[k] - b * up[k]) - eye[k]
                        });
                        sight.sides.iter().all(|side| side.dot(DVec3::from_array(p)) > 0.0)
                    });
                    let meets = sight.meets(&cube, face, window);
                    assert!(!any || meets);
                    seen[k] += usize::from(any);
                    hidden[k] += usize::from(!meets);
                }
            }
        }
        assert!(seen.iter().chain(&hidden).all(|&count| count > 80), "{seen:?} {hidden:?}");
        assert!(hidden.is_sorted_by(|a, b| a < b), "the smaller, the less is seen: {hidden:?}");
    }

    #[test]
    fn a_draw_takes_a_vertex_to_its_point() {
        let patch = Blob { step: 0.25, ..patch([16, 0], 48) };
        let (cube, eye) = (cube([10.0, 20.0, 30.0]), [11.0, 19.0, 30.5]);
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
