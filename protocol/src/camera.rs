//! The camera of one frame, in the scene's own units and axes.

use crate::format::Skeleton;
use serde::{Deserialize, Serialize};

/// A pinhole camera: 56 bytes on the wire, below the 72 of paper 004, section 4.5.
///
/// `forward` and `up` are unit length and perpendicular (to f32 rounding); the picture's right is
/// `forward x up`. Made by [`Camera::look_at`] on the coordinator alone, so that the nodes' own
/// arithmetic on it needs only `+ - * / sqrt`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Position, scene units.
    pub eye: [f64; 3],
    /// Direction of view.
    pub forward: [f32; 3],
    /// Up in the picture.
    pub up: [f32; 3],
    /// Tangent of half the vertical field of view.
    pub tan_half_fov_y: f32,
    /// Distance of the near plane, scene units.
    pub near: f32,
}

/// Bounds of the tangent of half the field of view: what [`Camera::forward`] can tell apart, and its reciprocal.
const LEAST_TAN: f64 = 8e-8;
const GREATEST_TAN: f64 = 1.25e7;

/// Why a pose makes no camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CameraError {
    /// A coordinate is NaN or infinite.
    #[error("a coordinate is not a finite number")]
    NotFinite,
    /// Eye and target coincide.
    #[error("eye and target are the same point")]
    NoDirection,
    /// Up is zero or along the view direction.
    #[error("the up vector is zero or parallel to the view direction")]
    NoUp,
    /// Field of view not in (0, 180) degrees, or so near to an end that there is no picture.
    #[error("the vertical field of view must lie between 0.00001 and 179.99999 degrees")]
    BadFieldOfView,
    /// Near plane not positive.
    #[error("the near plane must be a positive distance")]
    BadNear,
}

impl Camera {
    /// Camera at `eye` looking at `target`; `fov_y_deg` is the full vertical angle.
    pub fn look_at(
        eye: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        fov_y_deg: f64,
        near: f64,
    ) -> Result<Self, CameraError> {
        let finite = eye.iter().chain(&target).chain(&up).all(|c| c.is_finite());
        if !finite || !fov_y_deg.is_finite() {
            return Err(CameraError::NotFinite);
        }
        let tan_half_fov_y = (fov_y_deg.to_radians() * 0.5).tan();
        if fov_y_deg >= 180.0 || !(LEAST_TAN..=GREATEST_TAN).contains(&tan_half_fov_y) {
            return Err(CameraError::BadFieldOfView);
        }
        let near_f32 = near as f32;
        if !near_f32.is_finite() || near_f32 <= 0.0 {
            return Err(CameraError::BadNear);
        }
        let forward =
            unit(std::array::from_fn(|i| target[i] - eye[i])).ok_or(CameraError::NoDirection)?;
        let up = unit(up).ok_or(CameraError::NoUp)?;
        let right = cross(forward, up);
        if right.iter().all(|c| c.abs() < 1e-9) {
            return Err(CameraError::NoUp);
        }
        let right = unit(right).ok_or(CameraError::NoUp)?;
        let up = cross(right, forward);
        Ok(Self {
            eye,
            forward: forward.map(|c| c as f32),
            up: up.map(|c| c as f32),
            tan_half_fov_y: tan_half_fov_y as f32,
            near: near_f32,
        })
    }

    /// The picture's right: `forward x up`, in f64.
    pub fn right(&self) -> [f64; 3] {
        cross(self.forward.map(f64::from), self.up.map(f64::from))
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Unit vector, or none where the length vanishes beside the largest coordinate.
fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    let largest = v.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    if largest == 0.0 || !largest.is_finite() {
        return None;
    }
    let scaled = v.map(|c| c / largest);
    let length = scaled.iter().map(|c| c * c).sum::<f64>().sqrt();
    Some(scaled.map(|c| c / length))
}

/// Distance of the near plane as a share of how far a scene reaches: a centimetre in a hall of 100 m.
pub const NEAR_OF_REACH: f64 = 1e-4;
/// A leaf so many times as long as one of the shorter ones is out of proportion: a ground plane, say.
const OUT_OF_PROPORTION: f64 = 256.0;
/// Bounds of the near distance, scene units: `near / w` is a normal `f32` up to 1e7 times as far away
/// as the scene reaches, and no scene is so large that its near distance is none.
const LEAST_NEAR: f64 = 1e-30;
const GREATEST_NEAR: f64 = 1e30;
/// The same as a share of the scene's diagonal.
const LEAST_OF_DIAGONAL: f64 = 1e-18;

/// Distance of the near plane for a scene, in its units: [`NEAR_OF_REACH`] of how far it reaches.
///
/// A scene reaches as far as its leaves cover it: the diagonal of a box whose sides are as long as the
/// leaves' boxes cover each axis, gaps left out. So what stands kilometres beside a hall adds its own
/// size and not the way there. Leaves out of proportion do not count, lest a plane below everything
/// cover it all: those more than [`OUT_OF_PROPORTION`] times as long as the lower quartile of all.
/// Where leaves lie close to each other, as they do in most scenes, that is the diagonal of the whole,
/// and it is never more.
///
/// Depth is reversed, in 32-bit floats (`near / w`): its relative precision is the same for any near
/// distance, so nothing is lost by a short one but what numbers can hold. A vertex where the near plane cuts
/// an edge is off by a share of the edge's length, however near that plane is.
///
/// A scene whose leaves have no extent has no scale to go by: its near plane is [`NEAR_OF_REACH`]
/// units away.
pub fn near_plane(skeleton: &Skeleton) -> f64 {
    let leaves = skeleton.hlods.iter().filter(|hlod| hlod.child_count == 0);
    let boxes: Vec<[[f64; 3]; 2]> = leaves.map(|leaf| [leaf.min, leaf.max]).collect();
    near_of(&boxes, skeleton.diagonal())
}

/// The same for the boxes of leaves and the diagonal around them.
fn near_of(boxes: &[[[f64; 3]; 2]], diagonal: f64) -> f64 {
    let reach = reach(boxes).min(diagonal);
    let near = NEAR_OF_REACH * if reach > 0.0 { reach } else { 1.0 };
    near.max(diagonal * LEAST_OF_DIAGONAL).clamp(LEAST_NEAR, GREATEST_NEAR)
}

/// How far boxes reach that are not out of proportion, gaps between them left out.
fn reach(boxes: &[[[f64; 3]; 2]]) -> f64 {
    let length = |sides: [f64; 3]| sides.iter().map(|side| side * side).sum::<f64>().sqrt();
    let sized = |[min, max]: &[[f64; 3]; 2]| length(std::array::from_fn(|k| max[k] - min[k]));
    let mut sizes: Vec<f64> = boxes.iter().map(sized).collect();
    sizes.sort_by(f64::total_cmp);
    let quartile = sizes.get(sizes.len().saturating_sub(1) / 4).copied().unwrap_or(0.0);

    let counted: Vec<&[[f64; 3]; 2]> =
        boxes.iter().filter(|own| sized(own) <= OUT_OF_PROPORTION * quartile).collect();
    length(std::array::from_fn(|axis| {
        let mut spans: Vec<[f64; 2]> =
            counted.iter().map(|[min, max]| [min[axis], max[axis]]).collect();
        spans.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let (mut covered, mut end) = (0.0, f64::NEG_INFINITY);
        for [low, high] in spans {
            covered += (high - low.max(end)).max(0.0);
            end = high.max(end);
        }
        covered
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looks_where_it_is_told() {
        let camera =
            Camera::look_at([1e7, 0.0, 0.0], [1e7, 0.0, -5.0], [0.0, 1.0, 0.0], 90.0, 0.1).unwrap();
        assert_eq!(camera.forward, [0.0, 0.0, -1.0]);
        assert_eq!(camera.right(), [1.0, 0.0, 0.0]);
        assert!((camera.tan_half_fov_y - 1.0).abs() < 1e-6);
    }

    #[test]
    fn refuses_poses_without_a_direction() {
        let look =
            |eye, target, up, fov, near| Camera::look_at(eye, target, up, fov, near).unwrap_err();
        let (o, y, z) = ([0.0; 3], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        assert_eq!(look(o, o, y, 60.0, 0.1), CameraError::NoDirection);
        assert_eq!(look(o, y, y, 60.0, 0.1), CameraError::NoUp);
        assert_eq!(look(o, z, [0.0; 3], 60.0, 0.1), CameraError::NoUp);
        assert_eq!(look(o, z, y, 180.0, 0.1), CameraError::BadFieldOfView);
        for fov in [0.0, -1.0, 1e-44, 1e-38, 1e-6, 179.999_999, 180.0_f64.next_down(), 181.0, 1e300]
        {
            assert_eq!(look(o, z, y, fov, 0.1), CameraError::BadFieldOfView, "{fov}");
        }
        for fov in [0.000_01, 179.999_99] {
            assert!(Camera::look_at(o, z, y, fov, 0.1).is_ok(), "{fov}");
        }
        assert_eq!(look(o, z, y, 60.0, 0.0), CameraError::BadNear);
        assert_eq!(look([f64::NAN, 0.0, 0.0], z, y, 60.0, 0.1), CameraError::NotFinite);
    }

    /// The near plane of a scene with these leaves, and its diagonal.
    fn near(leaves: &[[[f64; 3]; 2]]) -> (f64, f64) {
        let sides = (0..3).map(|k| {
            let low = leaves.iter().fold(f64::INFINITY, |low, [min, _]| low.min(min[k]));
            leaves.iter().fold(f64::NEG_INFINITY, |high, [_, max]| high.max(max[k])) - low
        });
        let diagonal = sides.map(|side| side * side).sum::<f64>().sqrt();
        (near_of(leaves, diagonal), diagonal)
    }

    fn cube(at: f64, side: f64) -> [[f64; 3]; 2] {
        [[at; 3], [at + side; 3]]
    }

    /// A hall of 100 cubes in a row, a unit each.
    fn hall(at: f64) -> Vec<[[f64; 3]; 2]> {
        let room = |i: u8| {
            let x = at + f64::from(i);
            [[x, at, at], [x + 1.0, at + 1.0, at + 1.0]]
        };
        (0..100).map(room).collect()
    }

    #[test]
    fn without_gaps_the_near_plane_is_a_share_of_the_diagonal() {
        for at in [0.0, -1e7] {
            let (near, diagonal) = near(&hall(at));
            assert_eq!(near, 1e-4 * diagonal);
        }
        for size in [1e-9, 1.0, 1e9] {
            let (near, diagonal) = near(&[cube(3.0 * size, size)]);
            assert_eq!(near, 1e-4 * diagonal, "{size}");
        }
        assert_eq!(near(&[[[0.0; 3], [4.0, 3.0, 0.0]]]).0, 5e-4);
    }

    #[test]
    fn strays_do_not_move_the_near_plane() {
        let (alone, _) = near(&hall(0.0));
        let two_strays = [cube(5e6, 2.0), cube(-5e6, 2.0)];
        let strays: [&[[[f64; 3]; 2]]; 3] =
            [&two_strays[..1], &two_strays, &[[[-5e6, -5e6, 0.0], [5e6, 5e6, 0.0]]]];
        for stray in strays {
            let (near, _) = near(&[&hall(0.0), stray].concat());
            assert!((alone..1.1 * alone).contains(&near), "{near} {alone} {stray:?}");
        }
        let (pair, _) = near(&[cube(0.0, 2.0), cube(5e6, 2.0)]);
        assert!(pair < 1e-3, "{pair}");
    }

    #[test]
    fn the_near_plane_is_a_distance_whatever_the_scene() {
        assert_eq!(near(&[cube(5.0, 0.0)]).0, NEAR_OF_REACH);
        for leaves in [
            vec![cube(0.0, 1e-150)],
            vec![cube(0.0, 1e300)],
            vec![cube(0.0, 0.0), cube(1e15, 0.0)],
            vec![cube(0.0, 1e-20), cube(1e15, 1e-20)],
        ] {
            let (near, diagonal) = near(&leaves);
            let farthest = diagonal.clamp(1e-30, 1e35) as f32;
            assert!((near as f32).is_normal() && near <= 1e-4 * diagonal.max(1.0));
            assert!((near as f32 / farthest).is_normal(), "{near} {farthest}");
        }
    }
}
