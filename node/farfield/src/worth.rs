//! What a far field costs to draw, as cubes and as geometry: triangles in view of those who will look at it.

use crate::cube::BakedCube;
use crate::select::{Budget, Choice, selected};
use crate::sight::{Shown, Sight, on_face};
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::Skeleton;
use protocol::format::projected::TILE;
use protocol::settings::{FAR_CUBES, PictureSize};
use scene::front::{Field, front_of};
use scene::near_field::NearField;

/// Cameras that are asked at most, evenly chosen.
const ASKED: usize = 64;

/// Pictures that are taken in a cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Views {
    cameras: Vec<Camera>,
    /// Pixels along a side of a face.
    side: u32,
}

impl Views {
    /// By these cameras, for cubes with faces of `side` pixels.
    pub fn new(cameras: &[Camera], side: u32) -> Self {
        let step = cameras.len().div_ceil(ASKED).max(1);
        Self { cameras: cameras.iter().step_by(step).copied().collect(), side }
    }

    /// A wide picture whose pixels are as large as those of a face: what both ways are equally fine in.
    fn size(&self, camera: &Camera) -> PictureSize {
        let height = f64::from(self.side) * f64::from(camera.tan_half_fov_y);
        let pixels = |length: f64| length.round().max(1.0) as u32;
        PictureSize { width: pixels(height * 16.0 / 9.0), height: pixels(height) }
    }

    /// Mean over the cameras.
    fn mean(&self, triangles: impl Fn(&Camera, PictureSize) -> u64) -> u64 {
        let all = self.cameras.iter().map(|camera| triangles(camera, self.size(camera)));
        all.sum::<u64>().div_ceil(self.cameras.len().max(1) as u64)
    }

    /// Triangles of all that is not `near`, as geometry at one pixel of error, without occlusion culling.
    pub fn of_geometry(&self, skeleton: &Skeleton, near: &NearField) -> u64 {
        self.mean(|camera, size| {
            let front = front_of(skeleton, camera, size, 1.0, &Field::Far(near));
            let levels = front.entries.iter().map(|entry| &skeleton.levels[entry.level as usize]);
            levels.map(|level| u64::from(level.triangles)).sum()
        })
    }

    /// Triangles of those of a cell's cubes that are drawn where nothing else is asked for.
    pub fn of_cubes(&self, cubes: &[BakedCube]) -> u64 {
        let budget = Budget { cubes: FAR_CUBES, triangles: None };
        self.mean(|camera, size| {
            let sight = Sight::new(camera, size);
            let choice = |cube: &BakedCube| {
                let (eye, parent) = (cube.eye, cube.parent);
                Choice { eye, parent, triangles: self.in_view(cube, &sight) }
            };
            let choices: Vec<Choice> = cubes.iter().map(choice).collect();
            let chosen = selected(&choices, DVec3::from_array(camera.eye), &budget);
            chosen.cubes.into_iter().map(|at| choices[at].triangles).sum()
        })
    }

    fn in_view(&self, cube: &BakedCube, sight: &Sight) -> u64 {
        let faces = cube.faces.iter().enumerate();
        let patches = faces.flat_map(|(face, baked)| {
            baked.iter().flat_map(move |baked| {
                baked.patches.iter().map(move |patch| (face, baked.mesh.step, patch))
            })
        });
        let seen = patches.filter(|(face, step, patch)| {
            sight.meets(&Shown {
                eye: cube.eye,
                face: *face,
                least: patch.window.at.map(|tile| on_face(f64::from(tile * TILE), self.side)),
                across: f64::from(patch.window.across * TILE) * 2.0 / f64::from(self.side),
                step: *step,
            })
        });
        seen.map(|(.., patch)| patch.triangles.len() as u64).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::BakedFace;
    use crate::depth_mesh::simplify::FaceMesh;
    use crate::patches::{BakedPatch, Window};
    use crate::picture::StoredPicture;
    use protocol::format::projected::{FACES, FaceAxes};

    const SIDE: u32 = 64;

    /// A face of two patches, the upper half of it in four tiles' width and the lower.
    fn face(upper: usize, lower: usize) -> BakedFace {
        let patch = |triangles, row| BakedPatch {
            triangles,
            window: Window { at: [1, row], across: 2 },
            picture: StoredPicture::default(),
        };
        let mesh = FaceMesh { vertices: vec![], triangles: vec![], step: 1e-7, error_px: 0.0 };
        BakedFace { mesh, patches: vec![patch(0..upper, 0), patch(upper..upper + lower, 2)] }
    }

    fn cube(eye: DVec3, parent: Option<usize>, triangles: [(usize, usize); 6]) -> BakedCube {
        BakedCube { eye, parent, faces: triangles.map(|(upper, lower)| Some(face(upper, lower))) }
    }

    /// A narrow camera along an axis, turned up or down.
    fn look(axes: &FaceAxes, upwards: f32) -> Camera {
        let [forward, up] = [axes.forward, axes.up].map(|axis| axis.map(|c| c as f32));
        let towards = std::array::from_fn(|k| forward[k] + upwards * up[k]);
        let target = towards.map(f64::from);
        let upright = axes.up;
        Camera::look_at([0.0; 3], target, upright, 10.0, 0.01).expect("a direction")
    }

    #[test]
    fn of_cubes_only_what_is_in_view_counts() {
        let counts = [(1, 2), (4, 8), (16, 32), (64, 128), (256, 512), (1024, 2048)];
        let cubes = [
            cube(DVec3::ZERO, None, counts),
            cube(DVec3::splat(0.001), Some(0), counts.map(|(upper, lower)| (10 * upper, lower))),
        ];
        for (number, axes) in FACES.iter().enumerate() {
            for (upwards, expected) in [(0.5, 11 * counts[number].0), (-0.5, 2 * counts[number].1)]
            {
                let views = Views::new(&[look(axes, upwards)], SIDE);
                assert_eq!(views.of_cubes(&cubes), expected as u64, "{number} {upwards}");
            }
        }
        let both = Views::new(&[look(&FACES[0], 0.5), look(&FACES[1], -0.5)], SIDE);
        assert_eq!(both.of_cubes(&cubes), (11 + 16u64).div_ceil(2));
        assert_eq!(both.of_cubes(&[]), 0);
        assert_eq!(Views::new(&[], SIDE).of_cubes(&cubes), 0);
    }

    #[test]
    fn no_more_cubes_are_asked_than_are_drawn_and_no_more_cameras_than_needed() {
        let many: Vec<BakedCube> = (0..20)
            .map(|at| cube(DVec3::splat(0.001 * f64::from(at)), (at > 0).then_some(0), [(1, 0); 6]))
            .collect();
        let camera = look(&FACES[2], 0.5);
        assert_eq!(Views::new(&[camera], SIDE).of_cubes(&many), u64::from(FAR_CUBES));
        for count in [1, ASKED, ASKED + 1, 1000] {
            let asked = Views::new(&vec![camera; count], SIDE).cameras.len();
            assert!(asked <= ASKED && asked * 2 >= count.min(ASKED), "{asked} of {count}");
        }
    }

    #[test]
    fn pictures_are_as_fine_as_faces() {
        let views = Views::new(&[], 512);
        let camera = |tan_half_fov_y| Camera { tan_half_fov_y, ..look(&FACES[0], 0.0) };
        assert_eq!(views.size(&camera(1.0)), PictureSize { width: 910, height: 512 });
        assert_eq!(views.size(&camera(0.5)), PictureSize { width: 455, height: 256 });
        assert_eq!(views.size(&camera(1e-9)), PictureSize { width: 1, height: 1 });
    }
}
