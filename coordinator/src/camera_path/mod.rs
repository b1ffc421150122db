//! Camera paths: the poses of a replay, from a file or made for a scene.

mod csv;
mod generate;
mod grid;
mod route;
mod voxels;
mod walk;
mod wander;

pub use self::csv::{PathError, read_csv, write_csv};
pub use generate::{GenerateError, PathKind, generate};

use protocol::camera::{Camera, CameraError};

/// Full vertical field of view of generated poses, degrees.
pub const FOV_Y_DEG: f64 = 60.0;

/// Where one picture is taken from, in the scene's units and axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Position.
    pub eye: [f64; 3],
    /// A point in the middle of the picture.
    pub target: [f64; 3],
    /// Roughly up; neither zero nor along the view.
    pub up: [f64; 3],
    /// Full vertical field of view, degrees, in (0, 180).
    pub fov_y_deg: f64,
    /// Distance of the near plane, scene units; `None` for that of the scene.
    pub near: Option<f64>,
}

/// A pose that makes no camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("frame {frame}: {source}")]
pub struct CamerasError {
    /// Index of the pose.
    pub frame: usize,
    /// What is wrong with it.
    pub source: CameraError,
}

/// Cameras of `poses`, with the near plane at `near` scene units where a pose does not say.
///
/// # Errors
/// The first pose that makes no camera.
pub fn cameras(poses: &[Pose], near: f64) -> Result<Vec<Camera>, CamerasError> {
    poses
        .iter()
        .enumerate()
        .map(|(frame, pose)| {
            Camera::look_at(
                pose.eye,
                pose.target,
                pose.up,
                pose.fov_y_deg,
                pose.near.unwrap_or(near),
            )
            .map_err(|source| CamerasError { frame, source })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bad_pose_is_named() {
        let good = Pose {
            eye: [0.0; 3],
            target: [1.0, 0.0, 0.0],
            up: [0.0, 1.0, 0.0],
            fov_y_deg: FOV_Y_DEG,
            near: None,
        };
        let bad = Pose { up: [3.0, 0.0, 0.0], ..good };
        assert_eq!(cameras(&[good, good], 0.1).unwrap().len(), 2);
        assert_eq!(
            cameras(&[good, bad], 0.1),
            Err(CamerasError { frame: 1, source: CameraError::NoUp })
        );
        let own = Pose { near: Some(0.5), ..good };
        let near = cameras(&[good, own], 0.1).unwrap().into_iter().map(|camera| camera.near);
        assert!(near.eq([0.1, 0.5]));
    }
}
