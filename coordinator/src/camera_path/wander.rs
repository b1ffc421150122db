//! A path that goes through everything, walls included, and looks all around: not what a person does, but
//! what a renderer must bear. It begins and ends within things, comes out of walls in one frame, and turns faster
//! than occluders follow.

use super::{FOV_Y_DEG, Pose};
use protocol::format::{Hlod, Skeleton};
use rand::{Rng, SeedableRng, rngs::StdRng};

/// Frames from one place to the next.
const LEG: u32 = 24;
/// Frames of a whole turn.
const TURN: f64 = 48.0;
/// Frames from looking up to looking up again.
const NOD: f64 = 112.0;
/// Highest and lowest look, radians: 25 degrees.
const HIGHEST: f64 = 0.436;

/// The first `frames` poses of the way of `seed`, with `up` and two `level` directions in a right-handed
/// frame. A way of more frames goes on where one of fewer ends.
///
/// Each place is a point in the box of a leaf, all leaves being equally likely: so it is where things are, and
/// what lies astray is visited no more often than anything else. There is at least one hlod.
pub(super) fn wander(
    skeleton: &Skeleton,
    up: [f64; 3],
    level: [[f64; 3]; 2],
    frames: u32,
    seed: u64,
) -> Vec<Pose> {
    let leaves: Vec<&Hlod> = skeleton.hlods.iter().filter(|hlod| hlod.child_count == 0).collect();
    let mut random = StdRng::seed_from_u64(seed);
    let mut place = || -> [f64; 3] {
        let leaf = leaves[random.random_range(0..leaves.len())];
        std::array::from_fn(|k| leaf.min[k] + (leaf.max[k] - leaf.min[k]) * random.random::<f64>())
    };
    let places: Vec<[f64; 3]> = (0..frames.div_ceil(LEG) + 1).map(|_| place()).collect();

    let pose = |frame: u32| {
        let (leg, done) = ((frame / LEG) as usize, f64::from(frame % LEG) / f64::from(LEG));
        // It leaves slowly and arrives slowly.
        let done = done * done * (3.0 - 2.0 * done);
        let (from, to) = (places[leg], places[leg + 1]);
        let eye: [f64; 3] = std::array::from_fn(|k| from[k] + (to[k] - from[k]) * done);

        let (sin, cos) = (std::f64::consts::TAU * f64::from(frame) / TURN).sin_cos();
        let nod = HIGHEST * (std::f64::consts::TAU * f64::from(frame) / NOD).sin();
        let (rise, run) = nod.sin_cos();
        // Far enough that a place kilometres from the origin keeps its direction.
        let far = from.iter().chain(&to).fold(1.0f64, |far, c| far.max(c.abs()));
        let target = std::array::from_fn(|k| {
            eye[k] + far * (run * (cos * level[0][k] + sin * level[1][k]) + rise * up[k])
        });
        Pose { eye, target, up, fov_y_deg: FOV_Y_DEG, near: None }
    };
    (0..frames).map(pose).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::format::{NONE, SceneInfo};

    const UP: [f64; 3] = [0.0, 0.0, 1.0];
    const LEVEL: [[f64; 3]; 2] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

    /// A root over 63 leaves of side 1 along x, and one far away.
    fn row(stray: f64) -> Skeleton {
        let leaf = |x: f64| Hlod {
            min: [x, 0.0, 0.0],
            max: [x + 1.0, 1.0, 1.0],
            parent: 0,
            first_child: 1,
            child_count: 0,
            first_level: 0,
            level_count: 0,
            object: NONE,
            source_triangles: 1,
        };
        let root = Hlod { child_count: 64, ..leaf(0.0) };
        let leaves = (0..63).map(|i| leaf(f64::from(i) * 2.0)).chain([leaf(stray)]);
        Skeleton {
            info: SceneInfo::default(),
            hlods: std::iter::once(root).chain(leaves).collect(),
            levels: vec![],
            parts: vec![],
            blobs: vec![],
            transforms: vec![],
            texture_lists: vec![],
            textures: vec![],
            view_cells: vec![],
            cubes: vec![],
        }
    }

    fn of(skeleton: &Skeleton, frames: u32, seed: u64) -> Vec<Pose> {
        wander(skeleton, UP, LEVEL, frames, seed)
    }

    #[test]
    fn of_no_frames_there_is_no_pose_and_one_leaf_is_enough() {
        let mut one = row(0.0);
        one.hlods.truncate(1);
        one.hlods[0].child_count = 0;
        assert!(of(&one, 0, 1).is_empty());
        let poses = of(&one, 60, 1);
        assert!(poses.iter().all(|pose| pose.eye.iter().all(|c| (0.0..=1.0).contains(c))));
    }

    #[test]
    fn a_seed_fixes_the_way_and_more_frames_go_on() {
        let scene = row(0.0);
        assert_eq!(of(&scene, 200, 11)[..70], of(&scene, 70, 11));
        assert_ne!(of(&scene, 70, 12), of(&scene, 70, 11));
    }

    #[test]
    fn legs_begin_within_leaves_and_the_look_goes_around_up_and_down() {
        let scene = row(0.0);
        let poses = of(&scene, 240, 11);
        for pose in poses.iter().step_by(LEG as usize) {
            let within =
                |leaf: &Hlod| (0..3).all(|k| (leaf.min[k]..=leaf.max[k]).contains(&pose.eye[k]));
            assert!(scene.hlods[1..].iter().any(within), "{:?}", pose.eye);
        }
        let looks: Vec<[f64; 3]> = poses
            .iter()
            .map(|pose| {
                let look: [f64; 3] = std::array::from_fn(|k| pose.target[k] - pose.eye[k]);
                let length = look.iter().map(|c| c * c).sum::<f64>().sqrt();
                look.map(|c| c / length)
            })
            .collect();
        for axis in 0..3 {
            let reach = if axis == 2 { 0.4 } else { 0.9 };
            assert!(looks.iter().any(|look| look[axis] > reach), "axis {axis}");
            assert!(looks.iter().any(|look| look[axis] < -reach), "axis {axis}");
        }
    }

    #[test]
    fn a_stray_takes_no_more_than_its_share() {
        let scene = row(5e6);
        let poses = of(&scene, 2400, 11);
        let far = poses.iter().step_by(LEG as usize).filter(|pose| pose.eye[0] > 1e3).count();
        assert!(far <= 6, "{far} of 100 places");
    }
}
