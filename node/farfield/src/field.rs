//! Far fields at run time: which blobs a viewpoint needs, and what is drawn of them.

use crate::select::{Budget, Choice, selected};
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::projected::{FACES, FaceAxes, SUBPIXELS};
use protocol::format::vertex::POSITION_MAX;
use protocol::format::{Cube, NONE, Skeleton, ViewCell};
use protocol::id::{BlobId, HlodId};
use protocol::settings::PictureSize;
use scene::backend::{Draw, NO_ITEM};
use scene::near_field::Cells;
use scene::view::frustum;
use std::sync::Arc;

/// What stands in for the far fields of a scene.
pub trait FarField: Send + Sync {
    /// The blobs that may be drawn from `eye`, wherever the camera looks, in order of need; none outside
    /// of the cells.
    fn wanted(&self, eye: [f64; 3]) -> Vec<BlobId>;

    /// The draws for a camera, in the order of need.
    fn draws(&self, camera: &Camera, size: PictureSize) -> Vec<Draw>;
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

    fn cell(&self, eye: [f64; 3]) -> Option<&ViewCell> {
        self.cells.at(eye).map(|cell| &self.skeleton.view_cells[cell])
    }

    /// A face shows nothing nearer along its axis: the greatest disparity that its grid holds.
    fn nearest(&self, cube: &Cube, face: usize) -> f64 {
        let step = self.skeleton.blob(BlobId(cube.faces[face])).step;
        1.0 / (step * f64::from(POSITION_MAX))
    }

    /// Cubes to draw of a cell; `sees` tells whether a face may lie in the picture.
    fn cubes(
        &self,
        cell: &ViewCell,
        eye: [f64; 3],
        budget: &Budget,
        sees: impl Fn(&Cube, usize) -> bool,
    ) -> Vec<&Cube> {
        let cubes = self.skeleton.cubes_of(cell);
        let choices: Vec<Choice> = cubes
            .iter()
            .map(|cube| Choice {
                eye: DVec3::from_array(cube.eye),
                parent: (cube.parent != NONE).then(|| (cube.parent - cell.first_cube) as usize),
                triangles: faces_of(cube)
                    .filter(|(face, _)| sees(cube, *face))
                    .map(|(_, blob)| u64::from(self.skeleton.blob(blob).triangles))
                    .sum(),
            })
            .collect();
        let chosen = selected(&choices, DVec3::from_array(eye), budget);
        chosen.into_iter().map(|at| &cubes[at]).collect()
    }
}

impl FarField for Cubes {
    fn wanted(&self, eye: [f64; 3]) -> Vec<BlobId> {
        let Some(cell) = self.cell(eye) else { return Vec::new() };
        // How many triangles lie in the frustum is not known, so they cannot end the list.
        let budget = Budget { triangles: None, ..self.budget };
        let cubes = self.cubes(cell, eye, &budget, |_, _| true);
        cubes.into_iter().flat_map(faces_of).map(|(_, blob)| blob).collect()
    }

    fn draws(&self, camera: &Camera, size: PictureSize) -> Vec<Draw> {
        let Some(cell) = self.cell(camera.eye) else { return Vec::new() };
        let sight = Sight::new(camera, size);
        let sees = |cube: &Cube, face| sight.meets(cube, face, self.nearest(cube, face));
        let cubes = self.cubes(cell, camera.eye, &self.budget, sees);
        let of_cube = |cube: &Cube| {
            let faces: Vec<Draw> = faces_of(cube)
                .filter(|(face, _)| sees(cube, *face))
                .map(|(face, blob)| face_draw(&self.skeleton, cube, face, blob, camera.eye))
                .collect();
            faces
        };
        cubes.into_iter().flat_map(of_cube).collect()
    }
}

/// The faces of a cube that show something, and their blobs.
fn faces_of(cube: &Cube) -> impl Iterator<Item = (usize, BlobId)> + use<> {
    let faces = cube.faces;
    (0..6).filter(move |&face| faces[face] != NONE).map(move |face| (face, BlobId(faces[face])))
}

/// How a face is drawn for an eye ([`protocol::format::projected`]).
fn face_draw(skeleton: &Skeleton, cube: &Cube, face: usize, blob: BlobId, eye: [f64; 3]) -> Draw {
    let record = skeleton.blob(blob);
    let FaceAxes { forward, right, up } = FACES[face];
    let unit = 2.0 / f64::from(record.image[0] * SUBPIXELS);
    let vector = |of: &dyn Fn(usize) -> f64| std::array::from_fn(|k| of(k) as f32);
    Draw {
        blob,
        item: HlodId(NO_ITEM),
        linear: [
            vector(&|k| right[k] * unit),
            vector(&|k| -up[k] * unit),
            vector(&|k| (cube.eye[k] - eye[k]) * record.step),
        ],
        offset: vector(&|k| forward[k] - right[k] + up[k]),
        distance: 0.0,
        disparity_step: record.step as f32,
    }
}

/// What a camera sees, for culling faces.
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

    /// Whether something of a face, which shows nothing nearer than `nearest`, may lie in the picture: no
    /// side of the frustum has all of its pyramid, from there to infinity, beyond it.
    fn meets(&self, cube: &Cube, face: usize, nearest: f64) -> bool {
        let apex = DVec3::from_array(cube.eye) - self.eye;
        let [forward, right, up] = {
            let FaceAxes { forward, right, up } = FACES[face];
            [forward, right, up].map(DVec3::from_array)
        };
        let corners = [
            forward + right + up,
            forward + right - up,
            forward - right + up,
            forward - right - up,
        ];
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
        Cube { eye, faces: [0, 1, 2, 3, 4, 5], parent: NONE, triangles: 6 }
    }

    #[test]
    fn a_face_is_seen_where_a_point_of_it_is_in_the_picture() {
        use rand::{Rng, SeedableRng, rngs::StdRng};
        let mut rng = StdRng::seed_from_u64(3);
        let mut of =
            |reach: f64| -> [f64; 3] { std::array::from_fn(|_| rng.random_range(-reach..reach)) };
        let (mut seen, mut hidden) = (0, 0);
        for _ in 0..300 {
            let (eye, target) = (of(1.0), of(5.0));
            let camera = Camera::look_at(eye, target, [0.0, 0.0, 1.0], 60.0, 0.01).unwrap();
            let cube = cube(of(1.0));
            let sight = Sight::new(&camera, SIZE);
            for (face, FaceAxes { forward, right, up }) in FACES.into_iter().enumerate() {
                let any = (0..200).any(|_| {
                    let [a, b, z] = of(1.0);
                    let depth = 0.7 + 50.0 * (z + 1.0);
                    let p: [f64; 3] = std::array::from_fn(|k| {
                        cube.eye[k] + depth * (forward[k] + a * right[k] + b * up[k]) - eye[k]
                    });
                    sight.sides.iter().all(|side| side.dot(DVec3::from_array(p)) > 0.0)
                });
                assert!(!any || sight.meets(&cube, face, 0.7));
                seen += usize::from(any);
                hidden += usize::from(!sight.meets(&cube, face, 0.7));
            }
        }
        assert!(seen > 100 && hidden > 100, "{seen} {hidden}");
    }

    #[test]
    fn a_draw_takes_a_vertex_to_its_point() {
        let skeleton = {
            let blob = protocol::format::Blob { step: 0.25, image: [64, 0], ..Default::default() };
            Skeleton {
                info: Default::default(),
                hlods: vec![],
                levels: vec![],
                parts: vec![],
                blobs: vec![blob; 6],
                transforms: vec![],
                textures: vec![],
                view_cells: vec![],
                cubes: vec![],
            }
        };
        let (cube, eye) = (cube([10.0, 20.0, 30.0]), [11.0, 19.0, 30.5]);
        for (face, FaceAxes { forward, right, up }) in FACES.into_iter().enumerate() {
            let draw = face_draw(&skeleton, &cube, face, BlobId(face as u32), eye);
            // Pixel (48, 8) of 64, disparity 0.5.
            let grid = [48.0 * 16.0, 8.0 * 16.0, 2.0];
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
