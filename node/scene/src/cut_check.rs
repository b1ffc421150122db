//! Holds a cut against what it promises, by other means than it was made by: every leaf is drawn once,
//! and nothing that the picture shows is seen farther from its place than the pixel error allows.
//!
//! [`crate::displacement`] bounds that for all points of a box at once. Here single points of the box are
//! moved by the level's error, projected and compared. So what is found is a fault for certain, and a
//! bound that is wrong by more than a little is found.

use crate::front::{Field, FrontEntry, box_from_eye};
use crate::view::{basis, pixel_at_unit_depth, tan_half};
use geometry::bounds::Aabb;
use geometry::frustum::Basis;
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::Skeleton;
use protocol::id::HlodId;
use protocol::settings::PictureSize;

/// Rays of the picture along each side of it, the first and the last at its borders.
const RAYS: u32 = 9;
/// Relative rounding of a projection.
const ROUNDING: f64 = 1e-9;

/// Hlods with which a cut breaks its promise at a camera, in a picture of `size`, at `lod_px`: leaves that
/// are not drawn once if they belong to `field`, and not at all else; and entries of a level that is not
/// their own, or too coarse.
pub fn faults(
    skeleton: &Skeleton,
    camera: &Camera,
    size: PictureSize,
    lod_px: f64,
    field: &Field<'_>,
    cut: &[FrontEntry],
) -> Vec<HlodId> {
    let mut faults = wrong_leaves(skeleton, field, cut);
    let picture = Picture::new(camera, size);
    let is_wrong = |entry: &&FrontEntry| {
        let hlod = skeleton.hlod(entry.hlod);
        let own = hlod.first_level..hlod.first_level + hlod.level_count;
        let is_original = hlod.child_count == 0 && entry.level == hlod.first_level;
        if !own.contains(&entry.level) || is_original || lod_px == 0.0 {
            return !is_original;
        }
        let error = skeleton.levels[entry.level as usize].error;
        picture.shows_beyond(&box_from_eye(hlod, camera.eye), error, lod_px)
    };
    faults.extend(cut.iter().filter(is_wrong).map(|entry| entry.hlod));
    faults
}

/// Leaves that the cut does not draw as often as `field` has them.
fn wrong_leaves(skeleton: &Skeleton, field: &Field<'_>, cut: &[FrontEntry]) -> Vec<HlodId> {
    let mut drawn = vec![0u32; skeleton.hlods.len()];
    for entry in cut {
        drawn[entry.hlod.index()] += 1;
    }
    let mut wrong = Vec::new();
    // Parents come first.
    for (at, hlod) in skeleton.hlods.iter().enumerate() {
        let id = HlodId(at as u32);
        for child in skeleton.children_of(hlod) {
            drawn[child.index()] += drawn[at];
        }
        if hlod.child_count == 0 && drawn[at] != u32::from(field.has_leaf(id)) {
            wrong.push(id);
        }
    }
    wrong
}

/// A picture, of which single points are asked.
struct Picture {
    axes: Basis,
    tan_half: [f64; 2],
    near: f64,
    pixel: f64,
}

impl Picture {
    fn new(camera: &Camera, size: PictureSize) -> Self {
        Self {
            axes: basis(camera),
            tan_half: tan_half(camera, size),
            near: f64::from(camera.near),
            pixel: pixel_at_unit_depth(camera, size),
        }
    }

    /// Where a point is seen, at view depth 1; none behind the eye.
    fn project(&self, p: DVec3) -> Option<[f64; 2]> {
        let depth = self.axes.forward.dot(p);
        (depth > 0.0).then(|| [self.axes.right.dot(p) / depth, self.axes.up.dot(p) / depth])
    }

    /// Whether a point in `bounds` is seen, and one within `error` of it is seen more than `lod_px` pixels
    /// from there.
    fn shows_beyond(&self, bounds: &Aabb, error: f64, lod_px: f64) -> bool {
        self.points(bounds).any(|p| {
            let Some(at) = self.project(p) else { return false };
            // Away from the picture's middle, square to the ray; and straight to the side.
            let ray = p.normalize_or_zero();
            let side = ray.cross(self.axes.forward).normalize_or(self.axes.right);
            [side.cross(ray), ray.cross(side), side].into_iter().any(|direction| {
                let apart = self.project(p + direction * error).map_or(f64::INFINITY, |moved| {
                    let [x, y] = [moved[0] - at[0], moved[1] - at[1]];
                    (x * x + y * y).sqrt() / self.pixel
                });
                apart > lod_px * (1.0 + ROUNDING)
            })
        })
    }

    /// Some points of a box that are seen: those of its own that are in the picture, and where rays of the
    /// picture come to it.
    fn points(&self, bounds: &Aabb) -> impl Iterator<Item = DVec3> {
        let corner = |bits: u32| {
            DVec3::from_array(std::array::from_fn(|k| {
                if bits >> k & 1 == 1 { bounds.max[k] } else { bounds.min[k] }
            }))
        };
        let nearest = DVec3::ZERO.clamp(bounds.min, bounds.max);
        let own = (0..8).map(corner).chain([nearest, bounds.center()]).filter(|&p| {
            let is_within = |at: [f64; 2]| (0..2).all(|k| at[k].abs() <= self.tan_half[k]);
            self.axes.forward.dot(p) >= self.near && self.project(p).is_some_and(is_within)
        });

        let place = |number: u32| f64::from(number) * 2.0 / f64::from(RAYS - 1) - 1.0;
        let rays = (0..RAYS * RAYS).map(move |number| {
            let [x, y] = [place(number % RAYS), place(number / RAYS)];
            let Basis { right, up, forward } = self.axes;
            forward + right * (x * self.tan_half[0]) + up * (y * self.tan_half[1])
        });
        own.chain(rays.filter_map(|ray| enters(ray, bounds, self.near)))
    }
}

/// Where a ray from the eye, as long as it is deep, comes to a box behind the near plane.
fn enters(ray: DVec3, bounds: &Aabb, near: f64) -> Option<DVec3> {
    let (at_min, at_max) = (bounds.min / ray, bounds.max / ray);
    let (first, last) = (at_min.min(at_max).max_element(), at_min.max(at_max).min_element());
    let depth = first.max(near);
    (depth <= last).then(|| ray * depth)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::front::whole_cut;
    use crate::near_field::NearField;
    use crate::random_scene::RandomScene;
    use rand::Rng;

    const SIZE: PictureSize = PictureSize { width: 320, height: 200 };

    fn cut_of(scene: &RandomScene, camera: &Camera, lod_px: f64) -> Vec<FrontEntry> {
        whole_cut(&scene.skeleton, camera, SIZE, lod_px, &Field::Whole)
    }

    fn faults_of(
        scene: &RandomScene,
        camera: &Camera,
        lod_px: f64,
        cut: &[FrontEntry],
    ) -> Vec<HlodId> {
        faults(&scene.skeleton, camera, SIZE, lod_px, &Field::Whole, cut)
    }

    #[test]
    fn a_cut_keeps_its_promise_at_any_camera_and_in_any_field() {
        for seed in 0..60 {
            let mut scene = RandomScene::new(seed, 4, 64.0);
            let camera = scene.camera();
            let reach: f64 = scene.rng.random_range(0.1..30.0);
            let [least, most] = [-1.0, 1.0].map(|sign| camera.eye.map(|c| c + sign * reach));
            let near = NearField::new(&scene.skeleton, least, most);
            for field in [Field::Whole, Field::Near(vec![&near]), Field::Far(&near)] {
                for lod_px in [0.0, 0.3, 2.0, 30.0] {
                    let cut = whole_cut(&scene.skeleton, &camera, SIZE, lod_px, &field);
                    let found = faults(&scene.skeleton, &camera, SIZE, lod_px, &field, &cut);
                    assert_eq!(found, [], "seed {seed} {lod_px}");
                }
            }
        }
    }

    #[test]
    fn leaves_left_out_or_drawn_twice_are_named() {
        let mut scene = RandomScene::new(2, 3, 64.0);
        let camera = scene.camera();
        let cut = cut_of(&scene, &camera, 0.0);
        for at in 0..cut.len() {
            let mut less = cut.clone();
            let gone = less.remove(at);
            assert_eq!(faults_of(&scene, &camera, 0.0, &less), [gone.hlod]);
            let twice = [&cut[..], &[gone]].concat();
            assert_eq!(faults_of(&scene, &camera, 0.0, &twice), [gone.hlod]);
        }
        let near = NearField::new(&scene.skeleton, [-5.0; 3], [5.0; 3]);
        let (here, all) = (near.leaves().len(), cut.len());
        assert!(here > 0 && here < all);
        let found =
            faults(&scene.skeleton, &camera, SIZE, 0.0, &Field::Near(vec![&near]), &cut).len();
        assert_eq!(found, all - here);
    }

    #[test]
    fn a_level_that_is_not_its_own_or_not_the_original_is_named() {
        let mut scene = RandomScene::new(4, 3, 64.0);
        let camera = scene.camera();
        let cut = cut_of(&scene, &camera, 0.0);
        for (lod_px, wrong) in [(0.0, cut[3].level + 1), (1e9, cut[5].level)] {
            let mut cut = cut.clone();
            cut[3].level = wrong;
            assert_eq!(faults_of(&scene, &camera, lod_px, &cut), [cut[3].hlod]);
        }
    }

    #[test]
    fn an_error_seen_as_half_as_much_again_is_named_where_the_box_is_in_the_middle() {
        let mut named = [0, 0];
        for seed in 0..200 {
            let mut scene = RandomScene::new(seed, 4, 64.0);
            let camera = scene.camera();
            let mut cut = cut_of(&scene, &camera, 2.0);
            let looks_at = |entry: &&mut FrontEntry| {
                let bounds = box_from_eye(scene.skeleton.hlod(entry.hlod), camera.eye);
                let seen = Picture::new(&camera, SIZE).points(&bounds).count() > 0;
                let hlod = scene.skeleton.hlod(entry.hlod);
                seen && (hlod.child_count > 0 || entry.level > hlod.first_level)
            };
            let Some(entry) = cut.iter_mut().find(looks_at).copied() else { continue };
            let bounds = box_from_eye(scene.skeleton.hlod(entry.hlod), camera.eye);
            let projection = crate::displacement::Projection::new(&camera, SIZE);
            for (times, named) in [1.0, 1.5].into_iter().zip(&mut named) {
                let error = times * projection.allowed_error(&bounds, 2.0);
                scene.skeleton.levels[entry.level as usize].error = error;
                let found = faults_of(&scene, &camera, 2.0, &cut);
                assert!(found.iter().all(|id| *id == entry.hlod));
                *named += found.len();
            }
        }
        assert!(named[0] == 0 && named[1] > 60, "{named:?}");
    }
}
