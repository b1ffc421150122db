//! The normals of a face as they are stored, so that what it shows can be lit again: blocks of two octahedral ends
//! and selectors ([`protocol::format::projected`]).

use crate::picture::own_or_beside;
use crate::sample::{FaceAxes, FacePicture};
use glam::Vec3;
use protocol::format::projected::{TILE, TILE_BYTES, from_normal_code, mixed};
use protocol::format::vertex::octahedral;
use scene::backend::normal;

/// A code of each axis of the octahedron.
type Code = [u8; 2];

/// Straight at the viewpoint.
const AT_VIEWPOINT: Code = [128; 2];

/// Codes of all pixels of a face, in its own axes.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceNormals {
    side: u32,
    codes: Vec<Code>,
}

impl FaceNormals {
    /// Of a picture of `side` pixels a side; none where it was taken without. Pixels without a normal take a
    /// neighbour's, as they take its colour.
    pub fn of(picture: &FacePicture, side: u32, axes: &FaceAxes) -> Option<Self> {
        if picture.normal.is_empty() {
            return None;
        }
        let code = |x: u32, y: u32| {
            let at = (y * side + x) as usize;
            let stored = picture.normal[at];
            let is_seen = picture.disparity[at] > 0.0 && stored != normal::encode([0.0; 3]);
            is_seen.then(|| in_axes(stored, axes))
        };
        let pixels = (0..side * side).map(|at| (at % side, at / side));
        let codes = pixels.map(|at| own_or_beside(side, at, code).unwrap_or(AT_VIEWPOINT));
        Some(Self { side, codes: codes.collect() })
    }

    /// One tile, 16 blocks row by row.
    pub fn tile(&self, [column, row]: [u32; 2]) -> [u8; TILE_BYTES] {
        let mut tile = [0; TILE_BYTES];
        let (blocks, _) = tile.as_chunks_mut::<8>();
        for (at, stored) in (0..).zip(blocks) {
            let [left, top] = [column * TILE + at % 4 * 4, row * TILE + at / 4 * 4];
            *stored = block(std::array::from_fn(|k| {
                let [x, y] = [left + k as u32 % 4, top + k as u32 / 4];
                self.codes[(y * self.side + x) as usize]
            }));
        }
        tile
    }
}

/// A sample's code in the axes of its face.
fn in_axes(stored: [u8; 3], axes: &FaceAxes) -> Code {
    // Of any length: an octahedron holds directions.
    let n = stored.map(|c| f32::from(c) - 127.5);
    let along = |axis: [f64; 3]| (0..3).map(|k| axis[k] as f32 * n[k]).sum::<f32>();
    let place = octahedral([along(axes.right), along(axes.up), -along(axes.forward)]);
    place.map(|c| (127.0 * c + 128.5) as u8)
}

/// The unit vector of a code.
fn unit(code: Code) -> Vec3 {
    Vec3::from_array(from_normal_code(code)).normalize()
}

/// A block of 4x4 pixels: of all pairs of their codes that between whose four the normals lie closest, by the sum of
/// squared distances of unit vectors.
fn block(pixels: [Code; 16]) -> [u8; 8] {
    let normals = pixels.map(unit);
    let mut ends = pixels.to_vec();
    ends.sort_unstable();
    ends.dedup();
    let (mut best, mut least) = ([0; 8], f32::INFINITY);
    for (at, &a) in ends.iter().enumerate() {
        for &b in &ends[at..] {
            let [from, to] = [a, b].map(|end| end.map(u32::from));
            let between = [0, 1, 2, 3].map(|selector| unit(mixed(from, to, selector)));
            let (mut selectors, mut error) = (0u32, 0.0);
            for (pixel, normal) in (0..).zip(&normals) {
                let distance = |selector: usize| between[selector].distance_squared(*normal);
                let closest = (1..4).fold(0, |closest, selector| {
                    if distance(selector) < distance(closest) { selector } else { closest }
                });
                selectors |= (closest as u32) << (2 * pixel);
                error += distance(closest);
                if error >= least {
                    break;
                }
            }
            if error < least {
                let [c, d, e, f] = selectors.to_le_bytes();
                (best, least) = ([a[0], a[1], b[0], b[1], c, d, e, f], error);
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::FACES;
    use protocol::format::projected::normal_pixel;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    /// A face whose pixels have normals where there is one.
    fn face(side: u32, of: impl Fn(u32, u32) -> Option<Vec3>) -> FacePicture {
        let seen = (0..side * side).map(|at| of(at % side, at / side));
        let (disparity, normal) = seen
            .map(|n| match n {
                Some(n) => (0.5, normal::encode(n.to_array())),
                None => (0.0, normal::encode([0.0; 3])),
            })
            .unzip();
        FacePicture { disparity, normal, color: vec![[0; 3]; (side * side) as usize] }
    }

    /// Normals of the first tile, scene axes.
    fn stored(picture: &FacePicture, side: u32, axes: &FaceAxes) -> Vec<Vec3> {
        let tile = FaceNormals::of(picture, side, axes).unwrap().tile([0; 2]);
        let [right, up, forward] =
            [axes.right, axes.up, axes.forward].map(|a| Vec3::from_array(a.map(|c| c as f32)));
        let pixel = |at: u32| {
            let (x, y) = (at % TILE, at / TILE);
            let block = tile.as_chunks::<8>().0[(y / 4 * 4 + x / 4) as usize];
            let n = Vec3::from_array(normal_pixel(block, x % 4, y % 4)).normalize();
            right * n.x + up * n.y - forward * n.z
        };
        (0..TILE * TILE).map(pixel).collect()
    }

    #[test]
    fn a_picture_without_normals_stores_none() {
        let bare = FacePicture { normal: Vec::new(), ..face(16, |_, _| Some(Vec3::X)) };
        assert_eq!(FaceNormals::of(&bare, 16, &FACES[0]), None);
    }

    #[test]
    fn a_flat_face_keeps_its_normal_to_a_degree_whatever_it_is() {
        let mut rng = StdRng::seed_from_u64(1);
        let mut worst = 0f32;
        for round in 0..600 {
            let n = Vec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0f32)));
            let n = n.normalize();
            let found = stored(&face(16, |_, _| Some(n)), 16, &FACES[round % 6]);
            worst = found.iter().fold(worst, |worst, found| worst.max(found.angle_between(n)));
        }
        assert!(worst.to_degrees() < 1.2, "{} degrees", worst.to_degrees());
    }

    #[test]
    fn two_sides_that_meet_in_a_block_are_both_kept() {
        let sides = [Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.8, 0.6, 0.0)];
        let of = |x: u32, y: u32| sides[usize::from(3 * x > 2 * y + 5)];
        let picture = face(16, |x, y| Some(of(x, y)));
        for (at, found) in (0..).zip(stored(&picture, 16, &FACES[5])) {
            let off = found.angle_between(of(at % 16, at / 16)).to_degrees();
            assert!(off < 1.2, "{at}: {off} degrees");
        }
    }

    #[test]
    fn a_bend_is_followed_and_noise_is_never_far_off() {
        let mut rng = StdRng::seed_from_u64(2);
        let around: Vec<Vec3> = (0..256)
            .map(|_| Vec3::Z + Vec3::from_array([0; 3].map(|_| rng.random_range(-0.2..0.2))))
            .map(Vec3::normalize)
            .collect();
        let bend = |x: u32| Vec3::new((x as f32 * 0.06).sin(), 0.0, (x as f32 * 0.06).cos());
        for (most, of) in [
            (2.5, &(|x, _| bend(x)) as &dyn Fn(u32, u32) -> Vec3),
            (20.0, &|x, y| around[(16 * y + x) as usize]),
        ] {
            let picture = face(16, |x, y| Some(of(x, y)));
            for (at, found) in (0..).zip(stored(&picture, 16, &FACES[5])) {
                let off = found.angle_between(of(at % 16, at / 16)).to_degrees();
                assert!(off < most, "{at}: {off} degrees");
            }
        }
    }

    #[test]
    fn beside_the_edge_of_what_is_seen_the_normal_goes_on() {
        let n = Vec3::new(0.0, -0.6, 0.8);
        let picture = face(32, |x, _| (x < 10).then_some(n));
        let found = stored(&picture, 32, &FACES[5]);
        for y in 0..16 {
            assert!(found[16 * y + 10].angle_between(n).to_degrees() < 1.2);
        }
        // Beyond, it looks at the viewpoint.
        assert!(found[15].angle_between(Vec3::Z) < 0.02);
    }
}
