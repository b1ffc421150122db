//! The camera of one frame, in the scene's own units and axes.

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
    /// Field of view not in (0, 180) degrees.
    #[error("the vertical field of view must lie between 0 and 180 degrees")]
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
        if fov_y_deg <= 0.0 || fov_y_deg >= 180.0 {
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
            tan_half_fov_y: (fov_y_deg.to_radians() * 0.5).tan() as f32,
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

/// Distance of the near plane as a share of the scene's diagonal: a centimetre in a hall of 100 m.
pub const NEAR_OF_DIAGONAL: f64 = 1e-4;

/// Near plane for a scene whose box has this diagonal, scene units.
///
/// A scene without extent has no scale to go by; its near plane is [`NEAR_OF_DIAGONAL`] units.
pub fn near_plane(diagonal: f64) -> f64 {
    NEAR_OF_DIAGONAL * if diagonal > 0.0 { diagonal } else { 1.0 }
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
        assert_eq!(look(o, z, y, 60.0, 0.0), CameraError::BadNear);
        assert_eq!(look([f64::NAN, 0.0, 0.0], z, y, 60.0, 0.1), CameraError::NotFinite);
    }
}
