//! Where the camera was, is, and is likely to be.

use glam::{DMat3, DQuat, DVec3};
use protocol::camera::Camera;
use protocol::id::FrameIndex;

/// The last cameras of a path, a frame apart.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trajectory {
    /// The newest last.
    cameras: Vec<Camera>,
    newest: FrameIndex,
}

/// Cameras that a prediction needs: two turns and two steps.
const KEPT: usize = 3;

impl Trajectory {
    /// Notes the camera of a frame. One that does not follow the last begins a new path.
    pub fn note(&mut self, frame: FrameIndex, camera: Camera) {
        if frame.0 != self.newest.0 + 1 {
            self.cameras.clear();
        }
        self.cameras.push(camera);
        if self.cameras.len() > KEPT {
            self.cameras.remove(0);
        }
        self.newest = frame;
    }

    /// The camera of a frame: as noted, or if it is to come, as it will be if the camera keeps its turn
    /// and the eye its acceleration (or its speed, where no more is known). None of a frame before those
    /// that are kept.
    pub fn at(&self, frame: FrameIndex) -> Option<Camera> {
        match self.newest.0.checked_sub(frame.0) {
            Some(back) => {
                let back = (back as usize).checked_add(1)?;
                self.cameras.len().checked_sub(back).map(|at| self.cameras[at])
            }
            None => self.predicted(f64::from(frame.0 - self.newest.0)),
        }
    }

    fn predicted(&self, ahead: f64) -> Option<Camera> {
        let (now, earlier) = self.cameras.split_last()?;
        let Some((before, earlier)) = earlier.split_last() else { return Some(*now) };
        let (from, to) = (turn_of(before), turn_of(now));
        let (axis, angle) = (to * from.inverse()).normalize().to_axis_angle();
        // The short way round.
        let angle =
            if angle > std::f64::consts::PI { angle - 2.0 * std::f64::consts::PI } else { angle };
        let turned = DQuat::from_axis_angle(axis, angle * ahead);
        let turn = |v: [f32; 3]| {
            let v = DVec3::from_array(v.map(f64::from));
            (turned * v).normalize_or(v).to_array().map(|c| c as f32)
        };
        let eye = std::array::from_fn(|k| {
            let way = now.eye[k] - before.eye[k];
            let gain = earlier.last().map_or(0.0, |earlier| way - (before.eye[k] - earlier.eye[k]));
            now.eye[k] + way * ahead + gain * (ahead * (ahead + 1.0) / 2.0)
        });
        Some(Camera { eye, forward: turn(now.forward), up: turn(now.up), ..*now })
    }
}

fn turn_of(camera: &Camera) -> DQuat {
    let wide = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
    let (forward, up) = (wide(camera.forward), wide(camera.up));
    DQuat::from_mat3(&DMat3::from_cols(forward.cross(up), up, -forward)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn look(eye: [f64; 3], target: [f64; 3]) -> Camera {
        Camera::look_at(eye, target, [0.0, 0.0, 1.0], 60.0, 0.1).unwrap()
    }

    fn apart(a: [f32; 3], b: [f32; 3]) -> f32 {
        (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt()
    }

    fn path(cameras: &[Camera]) -> Trajectory {
        let mut path = Trajectory::default();
        for (frame, camera) in (0..).zip(cameras) {
            path.note(FrameIndex(frame), *camera);
        }
        path
    }

    #[test]
    fn what_is_known_is_told_as_it_is_and_no_more() {
        assert_eq!(Trajectory::default().at(FrameIndex(0)), None);
        let cameras = [0.0, 1.0, 3.0, 4.0].map(|x| look([x, 0.0, 0.0], [9.0, 1.0, 0.0]));
        let mut path = path(&cameras);
        assert_eq!(path.at(FrameIndex(0)), None);
        for frame in 1..4 {
            assert_eq!(path.at(FrameIndex(frame)), Some(cameras[frame as usize]));
        }
        // A jump in time says nothing about the way.
        path.note(FrameIndex(9), cameras[0]);
        assert_eq!(path.at(FrameIndex(8)), None);
        assert_eq!(path.at(FrameIndex(30)), Some(cameras[0]));
    }

    #[test]
    fn a_steady_camera_is_predicted() {
        let at = |frame: u32| {
            let frame = f64::from(frame);
            let (sin, cos) = (0.3 + 0.04 * frame).sin_cos();
            let eye = [1e7 + 2.0 * frame, -frame, 3.0];
            look(eye, [eye[0] + cos, eye[1] + sin, eye[2]])
        };
        for noted in [2, 3, 5] {
            let path = path(&(0..noted).map(at).collect::<Vec<_>>());
            for frame in noted..noted + 8 {
                let (found, truth) = (path.at(FrameIndex(frame)).unwrap(), at(frame));
                assert!((0..3).all(|k| (found.eye[k] - truth.eye[k]).abs() < 1e-6));
                assert!(apart(found.forward, truth.forward) < 1e-5);
                assert!(apart(found.up, truth.up) < 1e-5);
            }
        }
    }

    #[test]
    fn an_eye_on_an_arc_is_predicted_to_the_third_order() {
        let at = |frame: i32| {
            let (sin, cos) = (0.05 * f64::from(frame)).sin_cos();
            look([10.0 * cos, 10.0 * sin, 0.0], [0.0; 3])
        };
        let off = |from: i32| {
            let path = path(&(from..=1).map(at).collect::<Vec<_>>());
            let found = path.at(FrameIndex((4 - from) as u32)).unwrap().eye;
            let truth = at(4).eye;
            (0..3).map(|k| (found[k] - truth[k]).powi(2)).sum::<f64>().sqrt()
        };
        let (straight, bent) = (off(0), off(-1));
        assert!(straight > 0.1 && bent < 0.02, "{straight} {bent}");
    }

    #[test]
    fn a_camera_that_stands_or_turns_back_stays_a_camera() {
        let still = look([1.0, 2.0, 3.0], [4.0, 2.0, 3.0]);
        let found = path(&[still, still]).at(FrameIndex(9)).unwrap();
        assert_eq!(found.eye, still.eye);
        assert!(apart(found.forward, still.forward) < 1e-6);
        let back = look([1.0, 2.0, 3.0], [-4.0, 2.0, 3.0]);
        let found = path(&[still, back]).at(FrameIndex(4)).unwrap();
        let length = found.forward.iter().map(|c| c * c).sum::<f32>();
        assert!((length - 1.0).abs() < 1e-5, "{found:?}");
    }
}
