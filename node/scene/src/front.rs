//! The front: the cut through the tree that meets the pixel error at a camera (paper 004, section 5).
//!
//! Every process computes it for itself, so its arithmetic is `+ - * / sqrt` in f64 alone and every
//! coordinate is made relative to the eye first: the same bits everywhere.

use crate::near_field::{NearField, Reach};
use crate::view::{frustum, pixel_at_unit_depth};
use geometry::bounds::Aabb;
use geometry::frustum::Containment;
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::{Hlod, Skeleton};
use protocol::id::HlodId;
use protocol::settings::PictureSize;

/// One hlod of the front.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrontEntry {
    /// The hlod.
    pub hlod: HlodId,
    /// Its level: index into [`Skeleton::levels`].
    pub level: u32,
}

/// The front of one camera.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Front {
    /// What lies in the frustum, sorted by hlod.
    pub entries: Vec<FrontEntry>,
    /// Size of the whole front, inside the frustum or not.
    pub total: u32,
    /// Triangles of the source below `entries`.
    pub source_triangles_in_frustum: u64,
}

/// The box of `hlod` relative to `eye`.
pub fn box_from_eye(hlod: &Hlod, eye: [f64; 3]) -> Aabb {
    let eye = DVec3::from_array(eye);
    Aabb { min: DVec3::from_array(hlod.min) - eye, max: DVec3::from_array(hlod.max) - eye }
}

/// Which part of the scene a front is made of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Field<'a> {
    /// All of it.
    Whole,
    /// The leaves of near fields.
    Near(Vec<&'a NearField>),
    /// All but them.
    Far(&'a NearField),
}

/// What a field does to an hlod.
enum Choice {
    /// It may be drawn.
    Take,
    /// Only what is below it may.
    Descend,
    /// Nothing of it is drawn.
    Leave,
}

impl Field<'_> {
    fn choice(&self, id: HlodId) -> Choice {
        match self {
            Field::Whole => Choice::Take,
            Field::Near(near) => {
                let mut choice = Choice::Leave;
                for near in near {
                    match near.reach_of(id) {
                        Reach::Leaf => return Choice::Take,
                        Reach::Below => choice = Choice::Descend,
                        Reach::None => {}
                    }
                }
                choice
            }
            Field::Far(near) => match near.reach_of(id) {
                Reach::Leaf => Choice::Leave,
                Reach::Below => Choice::Descend,
                Reach::None => Choice::Take,
            },
        }
    }
}

/// How the traversal came to an hlod.
#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    /// Not at all: it lies below the front.
    Unreached,
    /// The frustum is yet to be asked.
    Reached,
    /// An ancestor lies wholly inside.
    Inside,
    /// An ancestor lies wholly outside.
    Outside,
}

/// The cut for `camera`: of each branch the highest hlod with a level whose error projects to at most
/// `lod_px` pixels, at the coarsest such level; a leaf that has none is drawn at its level 0.
///
/// `projected = error / distance(eye, box) * height / (2 tan(fov/2))`. With `lod_px` 0 it is the
/// leaves' level 0, the original geometry.
pub fn front(skeleton: &Skeleton, camera: &Camera, size: PictureSize, lod_px: f64) -> Front {
    front_of(skeleton, camera, size, lod_px, &Field::Whole)
}

/// The same of a part of the scene: an hlod is refined where only some of what is below it belongs to it.
pub fn front_of(
    skeleton: &Skeleton,
    camera: &Camera,
    size: PictureSize,
    lod_px: f64,
    field: &Field<'_>,
) -> Front {
    let frustum = frustum(camera, size);
    let allowed_at_unit_distance = lod_px * pixel_at_unit_depth(camera, size);
    let mut front = Front::default();
    // Children follow their parent, so one pass in id order is a traversal that needs no stack and
    // yields a sorted front.
    let mut states = vec![State::Unreached; skeleton.hlods.len()];
    if let Some(root) = states.first_mut() {
        *root = State::Reached;
    }
    for id in 0..states.len() {
        let mut state = states[id];
        if state == State::Unreached {
            continue;
        }
        let hlod = &skeleton.hlods[id];
        let choice = field.choice(HlodId(id as u32));
        if matches!(choice, Choice::Leave) {
            continue;
        }
        let seen_from_eye = box_from_eye(hlod, camera.eye);
        if state == State::Reached {
            state = match frustum.contains(&seen_from_eye) {
                Containment::Outside => State::Outside,
                Containment::Inside => State::Inside,
                Containment::Crossing => State::Reached,
            };
        }
        let level = if lod_px > 0.0 && matches!(choice, Choice::Take) {
            let allowed = allowed_at_unit_distance * seen_from_eye.distance(DVec3::ZERO);
            skeleton.levels_of(hlod).iter().rposition(|level| level.error <= allowed)
        } else {
            None
        };
        let is_leaf = hlod.child_count == 0;
        match level.or(is_leaf.then_some(0)) {
            Some(level) => {
                front.total += 1;
                if state != State::Outside {
                    let level = hlod.first_level + level as u32;
                    front.entries.push(FrontEntry { hlod: HlodId(id as u32), level });
                    front.source_triangles_in_frustum += hlod.source_triangles;
                }
            }
            None => {
                let first = hlod.first_child as usize;
                states[first..first + hlod.child_count as usize].fill(state);
            }
        }
    }
    front
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random_scene::RandomScene;
    use rand::Rng;

    const SIZE: PictureSize = PictureSize { width: 320, height: 200 };

    fn meets(level: f64, hlod: &Hlod, camera: &Camera, lod_px: f64) -> bool {
        let distance = box_from_eye(hlod, camera.eye).distance(DVec3::ZERO);
        level == 0.0
            || level / distance * 200.0 / (2.0 * f64::from(camera.tan_half_fov_y))
                <= lod_px * (1.0 + 1e-12)
    }

    fn cases() -> impl Iterator<Item = (RandomScene, Camera)> {
        (0..40).map(|seed| {
            let mut scene = RandomScene::new(seed, 4, 64.0);
            let camera = scene.camera();
            (scene, camera)
        })
    }

    #[test]
    fn near_and_far_are_the_whole_without_overlap() {
        let mut both = 0;
        for (mut scene, camera) in cases() {
            let eye = camera.eye;
            let reach: f64 = scene.rng.random_range(0.1..20.0);
            let near =
                NearField::new(&scene.skeleton, eye.map(|c| c - reach), eye.map(|c| c + reach));
            let skeleton = &scene.skeleton;
            let of = |field| front_of(skeleton, &camera, SIZE, 2.0, &field).entries;
            let leaves = |entries: &[FrontEntry]| -> Vec<HlodId> {
                let mut waiting: Vec<HlodId> = entries.iter().map(|entry| entry.hlod).collect();
                let mut leaves = Vec::new();
                while let Some(id) = waiting.pop() {
                    let hlod = skeleton.hlod(id);
                    waiting.extend(skeleton.children_of(hlod));
                    leaves.extend((hlod.child_count == 0).then_some(id));
                }
                leaves.sort();
                leaves
            };
            let (here, there) = (of(Field::Near(vec![&near])), of(Field::Far(&near)));
            assert!(here.iter().all(|entry| near.leaves().contains(&entry.hlod)));
            let far_leaves = leaves(&there);
            assert!(far_leaves.iter().all(|leaf| !near.leaves().contains(leaf)));
            let frustum = frustum(&camera, SIZE);
            let whole = leaves(&of(Field::Whole));
            let apart = [leaves(&here), far_leaves].concat();
            for leaf in whole {
                let seen = box_from_eye(skeleton.hlod(leaf), camera.eye);
                let is_out = frustum.contains(&seen) == Containment::Outside;
                assert!(is_out || apart.iter().filter(|other| **other == leaf).count() == 1);
            }
            both += usize::from(!here.is_empty() && !there.is_empty());
        }
        assert!(both > 10, "{both}");
    }

    #[test]
    fn nothing_has_an_empty_front() {
        let (mut scene, camera) = cases().next().unwrap();
        scene.skeleton.hlods.clear();
        assert_eq!(front(&scene.skeleton, &camera, SIZE, 1.0), Front::default());
    }

    #[test]
    fn every_leaf_in_the_frustum_is_covered_once() {
        let mut inner = 0;
        for (scene, camera) in cases() {
            let skeleton = &scene.skeleton;
            for lod_px in [0.0, 0.5, 3.0, 50.0] {
                let front = front(skeleton, &camera, SIZE, lod_px);
                assert!(front.entries.is_sorted_by(|a, b| a.hlod < b.hlod));
                let chosen = |id: &HlodId| front.entries.iter().any(|entry| entry.hlod == *id);
                for (id, hlod) in skeleton.hlods.iter().enumerate() {
                    let id = HlodId(id as u32);
                    if hlod.child_count > 0 {
                        inner += u32::from(chosen(&id));
                        continue;
                    }
                    let covered =
                        std::iter::once(id).chain(skeleton.ancestors(id)).filter(chosen).count();
                    let seen_from_eye = box_from_eye(hlod, camera.eye);
                    let outside =
                        frustum(&camera, SIZE).contains(&seen_from_eye) == Containment::Outside;
                    assert!(covered == 1 || (covered == 0 && outside), "{id} {covered}");
                    if lod_px == 0.0 {
                        assert_eq!(covered == 0, outside);
                    }
                }
            }
        }
        assert!(inner > 300, "{inner}");
    }

    #[test]
    fn it_is_the_coarsest_cut_within_the_error() {
        for (scene, camera) in cases() {
            let skeleton = &scene.skeleton;
            for lod_px in [0.5, 3.0, 50.0] {
                for entry in front(skeleton, &camera, SIZE, lod_px).entries {
                    let hlod = skeleton.hlod(entry.hlod);
                    let levels = skeleton.levels_of(hlod);
                    let chosen = (entry.level - hlod.first_level) as usize;
                    let within = meets(levels[chosen].error, hlod, &camera, lod_px);
                    assert!(within || (hlod.child_count == 0 && chosen == 0));
                    for coarser in &levels[chosen + 1..] {
                        assert!(!meets(coarser.error, hlod, &camera, lod_px));
                    }
                    for above in skeleton.ancestors(entry.hlod) {
                        let hlod = skeleton.hlod(above);
                        let fits = |l: &protocol::format::Level| {
                            meets(l.error, hlod, &camera, lod_px * 0.999_999)
                        };
                        assert!(!skeleton.levels_of(hlod).iter().any(fits));
                    }
                }
            }
        }
    }

    #[test]
    fn more_error_is_a_smaller_front() {
        for (scene, camera) in cases() {
            let totals: Vec<u32> = [0.0, 0.1, 0.5, 1.0, 3.0, 20.0, 1e9]
                .iter()
                .map(|&lod_px| front(&scene.skeleton, &camera, SIZE, lod_px).total)
                .collect();
            assert!(totals.is_sorted_by(|a, b| a >= b), "{totals:?}");
            assert_eq!(totals[0], 256);
        }
    }

    #[test]
    fn a_scene_moved_far_away_has_the_same_front() {
        for (mut scene, mut camera) in cases() {
            // On the grid of the scene, so that moving is exact.
            camera.eye = camera.eye.map(|c| (c * 1024.0).floor() / 1024.0);
            let here = front(&scene.skeleton, &camera, SIZE, 2.0);
            let away = |c: f64| c + 1e7;
            for hlod in &mut scene.skeleton.hlods {
                (hlod.min, hlod.max) = (hlod.min.map(away), hlod.max.map(away));
            }
            let mut rounded = scene.skeleton.clone();
            for hlod in &mut rounded.hlods {
                let back = |c: f64| c - 1e7;
                (hlod.min, hlod.max) = (hlod.min.map(back), hlod.max.map(back));
            }
            assert_eq!(front(&rounded, &camera, SIZE, 2.0), here, "moving was not exact enough");
            camera.eye = camera.eye.map(away);
            assert_eq!(front(&scene.skeleton, &camera, SIZE, 2.0), here);
        }
    }
}
