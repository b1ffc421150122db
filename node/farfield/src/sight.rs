//! What of a cube a camera can see, for culling patches.

use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::projected::{FACES, FaceAxes};
use protocol::format::vertex::POSITION_MAX;
use protocol::settings::PictureSize;
use scene::view::frustum;

/// What a patch can show: all over its window, from the nearest that its grid holds to infinity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shown {
    /// The sample's viewpoint.
    pub eye: DVec3,
    /// Index into [`FACES`].
    pub face: usize,
    /// Where its window begins, see [`on_face`].
    pub least: [f64; 2],
    /// A side of it, likewise.
    pub across: f64,
    /// Disparity of a unit of its grid.
    pub step: f64,
}

/// A place of a face of `side` pixels, from -1 to 1.
pub fn on_face(pixel: f64, side: u32) -> f64 {
    pixel * 2.0 / f64::from(side) - 1.0
}

/// What a camera sees.
pub struct Sight {
    eye: DVec3,
    /// Normals of the frustum's sides, inwards.
    sides: [DVec3; 5],
}

impl Sight {
    /// Of a picture of this size.
    pub fn new(camera: &Camera, size: PictureSize) -> Self {
        let sides = frustum(camera, size).normals();
        Self { eye: DVec3::from_array(camera.eye), sides }
    }

    /// Whether something of it may lie in the picture: no side of the frustum has all of it beyond.
    pub fn meets(&self, shown: &Shown) -> bool {
        let apex = shown.eye - self.eye;
        let nearest = 1.0 / (shown.step * f64::from(POSITION_MAX));
        let FaceAxes { forward, right, up } = FACES[shown.face];
        let [forward, right, up] = [forward, right, up].map(DVec3::from_array);
        let [across, down] = shown.least.map(|least| [least, least + shown.across]);
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
    /// Pixels of a face.
    const SIDE: u32 = 64;

    #[test]
    fn a_patch_is_seen_where_a_point_of_it_is_in_the_picture() {
        use rand::{Rng, SeedableRng, rngs::StdRng};
        let mut rng = StdRng::seed_from_u64(3);
        let mut of =
            |reach: f64| -> [f64; 3] { std::array::from_fn(|_| rng.random_range(-reach..reach)) };
        // Where it begins, and its side; nothing nearer than 0.7 is shown.
        let windows = [([0.0, 0.0], 64.0), ([16.0, 0.0], 32.0), ([48.0, 32.0], 16.0)];
        let step = 1.0 / (0.7 * f64::from(POSITION_MAX));
        let mut seen = [0; 3];
        let mut hidden = [0; 3];
        for _ in 0..300 {
            let (eye, target) = (of(1.0), of(5.0));
            let camera = Camera::look_at(eye, target, [0.0, 0.0, 1.0], 60.0, 0.01).unwrap();
            let at = of(1.0);
            let sight = Sight::new(&camera, SIZE);
            for (face, FaceAxes { forward, right, up }) in FACES.into_iter().enumerate() {
                for (k, (least, most)) in windows.into_iter().enumerate() {
                    let any = (0..200).any(|_| {
                        let [a, b, z] = of(1.0);
                        let place =
                            |at: f64, least: f64| (least + 0.5 * (at + 1.0) * most) / 32.0 - 1.0;
                        let (a, b) = (place(a, least[0]), place(b, least[1]));
                        let depth = 0.7 + 50.0 * (z + 1.0);
                        let p: [f64; 3] = std::array::from_fn(|k| {
                            at[k] + depth * (forward[k] + a * right[k] - b * up[k]) - eye[k]
                        });
                        sight.sides.iter().all(|side| side.dot(DVec3::from_array(p)) > 0.0)
                    });
                    let meets = sight.meets(&Shown {
                        eye: DVec3::from_array(at),
                        face,
                        least: least.map(|least| on_face(least, SIDE)),
                        across: most * 2.0 / f64::from(SIDE),
                        step,
                    });
                    assert!(!any || meets);
                    seen[k] += usize::from(any);
                    hidden[k] += usize::from(!meets);
                }
            }
        }
        assert!(seen.iter().chain(&hidden).all(|&count| count > 80), "{seen:?} {hidden:?}");
        assert!(hidden.is_sorted_by(|a, b| a < b), "the smaller, the less is seen: {hidden:?}");
    }
}
