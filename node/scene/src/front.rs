//! The front: the cut through the tree no point of which is seen farther from its place than the pixel
//! error allows ([`crate::displacement`]; Manocha, section 5).
//!
//! Every process computes it for itself, so its arithmetic is `+ - * / sqrt` in f64 alone and every
//! coordinate is made relative to the eye first: the same bits everywhere.

use crate::displacement::Projection;
use crate::near_field::{NearField, Reach};
use crate::view::frustum;
use geometry::bounds::Aabb;
use geometry::frustum::{Containment, Frustum};
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
    /// Triangles of the source below `entries`.
    pub source_triangles_in_frustum: u64,
}

/// The box of `hlod` relative to `eye`.
pub fn box_from_eye(hlod: &Hlod, eye: [f64; 3]) -> Aabb {
    let eye = DVec3::from_array(eye);
    Aabb { min: DVec3::from_array(hlod.min) - eye, max: DVec3::from_array(hlod.max) - eye }
}

/// Distance from `eye` to the box of `hlod`, scene units; 0 within.
pub fn distance_from_eye(hlod: &Hlod, eye: [f64; 3]) -> f64 {
    box_from_eye(hlod, eye).distance(DVec3::ZERO)
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
    /// Whether a leaf belongs to it.
    pub(crate) fn has_leaf(&self, leaf: HlodId) -> bool {
        match self {
            Field::Whole => true,
            Field::Near(near) => near.iter().any(|near| near.reach_of(leaf) == Reach::Leaf),
            Field::Far(near) => near.reach_of(leaf) != Reach::Leaf,
        }
    }

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
    /// Not at all: it lies below the front, or outside the frustum.
    Unreached,
    /// The frustum is yet to be asked.
    Reached,
    /// An ancestor lies wholly inside.
    Inside,
}

/// The front for `camera`: of each branch in the frustum the highest hlod with a level whose error is
/// seen as at most `lod_px` pixels, at the coarsest such level; a leaf that has none is drawn at its
/// level 0.
///
/// What is seen as how much: [`Projection::allowed_error`]. With `lod_px` 0 it is the leaves' level 0, the
/// original geometry.
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
    let entries = traverse(skeleton, camera, size, lod_px, field, Some(&frustum));
    let source = entries.iter().map(|entry| skeleton.hlod(entry.hlod).source_triangles);
    Front { source_triangles_in_frustum: source.sum(), entries }
}

/// The whole cut that a front is the part of which lies in the frustum, sorted by hlod: every leaf of
/// `field` is on it or below it.
pub fn whole_cut(
    skeleton: &Skeleton,
    camera: &Camera,
    size: PictureSize,
    lod_px: f64,
    field: &Field<'_>,
) -> Vec<FrontEntry> {
    traverse(skeleton, camera, size, lod_px, field, None)
}

/// Without a `frustum` nothing is outside it.
fn traverse(
    skeleton: &Skeleton,
    camera: &Camera,
    size: PictureSize,
    lod_px: f64,
    field: &Field<'_>,
    frustum: Option<&Frustum>,
) -> Vec<FrontEntry> {
    let projection = Projection::new(camera, size);
    let mut entries = Vec::new();
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
        if let (State::Reached, Some(frustum)) = (state, frustum) {
            state = match frustum.contains(&seen_from_eye) {
                Containment::Outside => continue,
                Containment::Inside => State::Inside,
                Containment::Crossing => State::Reached,
            };
        }

        let level = if lod_px > 0.0 && matches!(choice, Choice::Take) {
            let allowed = projection.allowed_error(&seen_from_eye, lod_px);
            skeleton.levels_of(hlod).iter().rposition(|level| level.error <= allowed)
        } else {
            None
        };
        let is_leaf = hlod.child_count == 0;
        match level.or(is_leaf.then_some(0)) {
            Some(level) => {
                let level = hlod.first_level + level as u32;
                entries.push(FrontEntry { hlod: HlodId(id as u32), level });
            }
            None => {
                let first = hlod.first_child as usize;
                states[first..first + hlod.child_count as usize].fill(state);
            }
        }
    }
    entries
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random_scene::RandomScene;
    use rand::Rng;

    const SIZE: PictureSize = PictureSize { width: 320, height: 200 };

    fn meets(error: f64, hlod: &Hlod, camera: &Camera, lod_px: f64) -> bool {
        let seen = box_from_eye(hlod, camera.eye);
        error <= Projection::new(camera, SIZE).allowed_error(&seen, lod_px)
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
            let size = |lod_px: f64| {
                whole_cut(&scene.skeleton, &camera, SIZE, lod_px, &Field::Whole).len()
            };
            let totals = [0.0, 0.1, 0.5, 1.0, 3.0, 20.0, 1e9].map(size);
            assert!(totals.is_sorted_by(|a, b| a >= b), "{totals:?}");
            assert_eq!(totals[0], 256);
        }
    }

    #[test]
    fn a_front_is_what_the_frustum_holds_of_the_whole_cut_and_looks_at_nothing_else() {
        let mut left_out = 0;
        for (mut scene, camera) in cases() {
            for lod_px in [0.0, 2.0] {
                let cut = whole_cut(&scene.skeleton, &camera, SIZE, lod_px, &Field::Whole);
                let held = front(&scene.skeleton, &camera, SIZE, lod_px);
                let is_outside = |id: HlodId| {
                    let seen = box_from_eye(scene.skeleton.hlod(id), camera.eye);
                    frustum(&camera, SIZE).contains(&seen) == Containment::Outside
                };
                let expected = cut.iter().filter(|entry| {
                    let up = scene.skeleton.ancestors(entry.hlod);
                    !std::iter::once(entry.hlod).chain(up).any(is_outside)
                });
                assert_eq!(held.entries, expected.copied().collect::<Vec<_>>());
                left_out += cut.len() - held.entries.len();

                // What is outside is not refined: its children are not looked for.
                let whole = scene.skeleton.hlods.clone();
                let inner = (0..whole.len()).filter(|&at| whole[at].child_count > 0);
                for at in inner.filter(|&at| is_outside(HlodId(at as u32))).collect::<Vec<_>>() {
                    scene.skeleton.hlods[at].first_child = u32::MAX / 2;
                }
                assert_eq!(front(&scene.skeleton, &camera, SIZE, lod_px), held);
                scene.skeleton.hlods = whole;
            }
        }
        assert!(left_out > 1000, "{left_out}");
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
