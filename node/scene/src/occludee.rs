//! What an hlod's box must be, so that a box found hidden proves the hlod hidden.
//!
//! # What is to be shown
//!
//! At every pixel an hlod covers, its box must cover the pixel too, at a depth no farther than the one
//! the hlod writes, as *computed*. Then at the pixel's nearest hlod the box passes its own test
//! (GreaterEqual), and whatever is culled is hidden everywhere (paper 004, section 4.2).
//!
//! # Errors of a rasteriser, as displacements in the scene
//!
//! Let `w` be the view depth, `w0 <= w <= w1` over the box, `d` the distance of its farthest corner from
//! the eye, `e` its diagonal, `near` the near distance, and `pixel` the world size of a pixel at depth 1.
//! Depth is `z = near / w`, linear on the screen. `u = 2^-24` is half an ulp of 1 in f32. An
//! interpolated point moves no farther than the worst vertex, so the first two are errors of vertices.
//!
//! 1. *Snapping.* Vertices are rounded to at least 1/256 pixel, after viewport arithmetic that errs by
//!    at most 1/256 more at 16384 pixels: below 1/128 pixel a vertex, for geometry and again for the
//!    box. Both together: 1/64 pixel, taken as 1/32. At fixed `w` that is `pixel * w1 / 32`.
//! 2. *Transforms.* `linear * grid + offset` in f32 errs by `6 u` of its terms. The grid's origin is a
//!    corner of the mesh's own box, which a placement can turn `4 e` away from the scene's box, so the
//!    terms are below `r = d + 4 e`. The clip matrix adds `5 u`, the division `4 u`, near clipping as
//!    much again: `30 u r` with room, twice for the two of them: `64 u r = 2^-18 r`. f64 differences of
//!    coordinates of size `c` add `2^-50 c` each.
//! 3. *Depth.* Storing and interpolating `z` errs by some ulps of the greatest `z = near / w0`, and,
//!    where a driver extrapolates from the picture's corner, by some ulps of the range of `z` times the
//!    `n = width + height` pixels it reaches over: `k u (near / w0 + n (near / w0 - near / w1))`, with
//!    `k = 8` for geometry and 8 for the box. (A driver's extrapolation in f32 errs more in triangles
//!    thinner than half a pixel, in proportion to their thinness. The CPU backend interpolates in f64
//!    and has only the first term.) Since `dw = w^2 / near dz`, that is a depth of at most
//!    `16 u (w1^2 / w0 + n (w1 - w0) w1 / w0)`, and along a ray to the picture's corner `s` times that,
//!    `s` being the ray's length at depth 1.
//!
//! # Growing pays for all of them
//!
//! A box grown by the sum `g` on every side holds the ball of radius `g` around each of its points. Let
//! `q` be a point of the displaced geometry. Displacing the grown box's faces by less than `q`'s distance
//! to them leaves `q` enclosed, so the ray from the eye, which is outside, meets a front face before
//! `q`, still by the share of `g` that stands for the depth error. The faces turned to the eye
//! are rasterised, which cover the box's whole outline, watertight by the fill rule; so the pixel is covered.
//!
//! The bound is taken over the *grown* box: with `g1` from the box itself, and `g2` from the box
//! grown by `2 g1`, the box grown by `g2` lies within that if `g2 <= 2 g1`. Else, and wherever the
//! grown box holds the eye or may be clipped by the near plane, the hlod counts as visible.

use crate::backend::BoxQuery;
use crate::front::box_from_eye;
use crate::view::{corner_ray, pixel_at_unit_depth};
use geometry::bounds::Aabb;
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::Hlod;
use protocol::settings::PictureSize;

/// Displacement by snapping, pixels.
const SNAPPING_PX: f64 = 1.0 / 32.0;
/// Relative displacement by f32 transforms.
const TRANSFORM: f64 = 1.0 / (1u64 << 18) as f64;
/// Relative displacement by f64 differences.
const DIFFERENCE: f64 = 1.0 / (1u64 << 50) as f64;
/// Relative depth error, `16 u`.
const DEPTH: f64 = 1.0 / (1u64 << 20) as f64;
/// Relative margin of the near rule, beyond the transform error.
const NEAR: f64 = 1.0 / (1u64 << 10) as f64;

/// What conservative culling rests on. Anything but the default loses pixels: it is there so that tests
/// can show that the audit sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rules {
    /// Boxes are grown by the rounding bound.
    pub grow: bool,
    /// Boxes that come nearer than the near plane count as visible.
    pub near_rule: bool,
    /// The depth test is GreaterEqual, not Greater.
    pub depth_test_inclusive: bool,
}

impl Default for Rules {
    fn default() -> Self {
        Self { grow: true, near_rule: true, depth_test_inclusive: true }
    }
}

/// How to find out whether an hlod may be visible.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Test {
    /// It counts as visible.
    Visible,
    /// It is visible if this box is.
    Query(BoxQuery),
}

/// The test for `hlod`, which lies in the frustum of `camera`, in a picture of `size`.
pub fn test_for(hlod: &Hlod, camera: &Camera, size: PictureSize, rules: &Rules) -> Test {
    let bounds = box_from_eye(hlod, camera.eye);
    let view = Rounding::new(hlod, camera, size);
    let margin = if rules.grow { view.growth(&bounds) } else { Some(0.0) };
    let Some(grown) = margin.map(|margin| bounds.grown(margin)) else {
        return Test::Visible;
    };
    if rules.near_rule && !view.clears_near_plane(&grown) {
        return Test::Visible;
    }
    let query = BoxQuery {
        min: grown.min.to_array().map(|c| c as f32),
        max: grown.max.to_array().map(|c| c as f32),
    };
    if query.min.iter().chain(&query.max).all(|c| c.is_finite()) {
        Test::Query(query)
    } else {
        Test::Visible
    }
}

/// The quantities of the derivation that belong to a camera and an hlod.
struct Rounding {
    forward: DVec3,
    near: f64,
    pixel: f64,
    corner_ray: f64,
    /// `n`, pixels.
    reach_px: f64,
    /// Displacement by f64 differences, scene units.
    difference: f64,
}

impl Rounding {
    fn new(hlod: &Hlod, camera: &Camera, size: PictureSize) -> Self {
        let coordinates = camera.eye.iter().chain(&hlod.min).chain(&hlod.max);
        Self {
            forward: DVec3::from_array(camera.forward.map(f64::from)),
            near: f64::from(camera.near),
            pixel: pixel_at_unit_depth(camera, size),
            corner_ray: corner_ray(camera, size),
            reach_px: f64::from(size.width) + f64::from(size.height),
            difference: DIFFERENCE * coordinates.map(|c| c.abs()).sum::<f64>(),
        }
    }

    /// Least and greatest view depth.
    fn depths(&self, b: &Aabb) -> (f64, f64) {
        let (at_min, at_max) = (self.forward * b.min, self.forward * b.max);
        (at_min.min(at_max).element_sum(), at_min.max(at_max).element_sum())
    }

    /// Distance of the farthest corner.
    fn farthest(b: &Aabb) -> f64 {
        b.min.abs().max(b.max.abs()).length()
    }

    /// The sum of the three errors for geometry within `b`.
    fn displacement(&self, b: &Aabb) -> f64 {
        let (w0, w1) = self.depths(b);
        // Nothing is rasterised nearer than the near plane.
        let (w0, w1) = (w0.max(self.near), w1.max(self.near));
        let snapping = SNAPPING_PX * self.pixel * w1;
        let transform = TRANSFORM * (Self::farthest(b) + 4.0 * b.diagonal()) + self.difference;
        let depth = DEPTH * w1 * (w1 + self.reach_px * (w1 - w0)) / w0;
        snapping + transform + depth * self.corner_ray
    }

    /// How far `b` is to be grown; none where its own growth spoils the bound.
    fn growth(&self, b: &Aabb) -> Option<f64> {
        let first = self.displacement(b);
        let second = self.displacement(&b.grown(2.0 * first));
        (second <= 2.0 * first).then_some(second)
    }

    /// No rounding brings a vertex of `b` in front of the near plane.
    fn clears_near_plane(&self, b: &Aabb) -> bool {
        self.depths(b).0 > self.near * (1.0 + NEAR) + TRANSFORM * Self::farthest(b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::{Backend, Completion, Draws, NO_ITEM, Part, Pass, Picture, View};
    use crate::draw_list::draw_list;
    use crate::front::{FrontEntry, front};
    use crate::random_scene::RandomScene;
    use protocol::settings::Cull;
    use rand::Rng;
    use std::collections::BTreeSet;

    fn run(backend: &mut impl Backend, pass: Pass) -> Completion {
        backend.submit(pass).unwrap();
        let mut completions = Vec::new();
        backend.poll(&mut completions).unwrap();
        completions.pop().unwrap()
    }

    fn picture(backend: &mut impl Backend, view: View, draws: Draws) -> Picture {
        match run(backend, Pass::Shade { view, draws, with_depth: true, part: Part::WHOLE }) {
            Completion::Picture { picture, .. } => picture,
            other => panic!("{other:?}"),
        }
    }

    #[derive(Debug, Default)]
    struct Outcome {
        /// Hlods that own a pixel and were culled.
        lost: usize,
        /// Pixels of the culled picture that differ in colour or depth.
        differing_pixels: usize,
        tested: usize,
        culled: usize,
    }

    /// Culls one camera's front with some of it as occluders, and compares with everything drawn.
    fn cull(scene: &mut RandomScene, size: PictureSize, rules: &Rules, sum: &mut Outcome) {
        let camera = scene.camera();
        let lod_px = [0.0, 2.0, 20.0][scene.rng.random_range(0..3)];
        let entries = front(&scene.skeleton, &camera, size, lod_px).entries;
        let share = [1.0, 0.5, 0.1, 0.0][scene.rng.random_range(0..4)];
        let occluders: Vec<FrontEntry> =
            entries.iter().filter(|_| scene.rng.random_bool(share)).copied().collect();
        let mut backend = scene.backend(size, rules);
        let view = View::new(&camera, size);
        let draws = |entries: &[FrontEntry]| draw_list(&scene.skeleton, entries, camera.eye);
        let occluders = draws(&occluders).solid;
        run(&mut backend, Pass::Occluders { view, draws: occluders, part: Part::WHOLE });

        let mut visible = Vec::new();
        let (mut asked, mut boxes) = (Vec::new(), Vec::new());
        for entry in &entries {
            match test_for(scene.skeleton.hlod(entry.hlod), &camera, size, rules) {
                Test::Visible => visible.push(*entry),
                Test::Query(query) => {
                    asked.push(*entry);
                    boxes.push(query);
                }
            }
        }
        sum.tested += asked.len();
        let Completion::Boxes { visible: answers, .. } =
            run(&mut backend, Pass::QueryBoxes { view, boxes, method: Cull::Queries })
        else {
            panic!("no answers");
        };
        sum.culled += answers.iter().filter(|&&answer| !answer).count();
        visible.extend(asked.iter().zip(&answers).filter(|(_, answer)| **answer).map(|(e, _)| *e));

        let all = draws(&entries);
        let Completion::Items { mut items, blended, .. } =
            run(&mut backend, Pass::Items { view, draws: all.clone(), part: Part::WHOLE })
        else {
            panic!("no items");
        };
        items.extend(blended);
        let owners: BTreeSet<u32> = items.into_iter().filter(|&item| item != NO_ITEM).collect();
        let kept: BTreeSet<u32> = visible.iter().map(|entry| entry.hlod.0).collect();
        sum.lost += owners.difference(&kept).count();
        let whole = picture(&mut backend, view, all);
        let culled = picture(&mut backend, view, draws(&visible));
        let same_color = whole.rgba.chunks(4).zip(culled.rgba.chunks(4)).map(|(a, b)| a == b);
        let same_depth = whole.depth.unwrap().into_iter().zip(culled.depth.unwrap());
        sum.differing_pixels +=
            same_color.zip(same_depth).filter(|&(color, (a, b))| !color || a != b).count();
    }

    fn cull_many(rules: &Rules) -> Outcome {
        let sizes = [(1, 1), (7, 333), (64, 48), (129, 31)];
        let mut sum = Outcome::default();
        for seed in 0..240 {
            let scale = [1.0 / 1024.0, 1.0, 64.0, 8192.0][seed as usize % 4];
            let mut scene = RandomScene::new(seed, 3, scale);
            let (width, height) = sizes[seed as usize / 4 % 4];
            cull(&mut scene, PictureSize { width, height }, rules, &mut sum);
        }
        sum
    }

    #[test]
    fn no_visible_pixel_is_lost() {
        let sum = cull_many(&Rules::default());
        assert_eq!((sum.lost, sum.differing_pixels), (0, 0), "{sum:?}");
        assert!(sum.culled > 1000 && sum.tested > 2 * sum.culled, "{sum:?}");
    }

    #[test]
    fn each_broken_rule_is_caught() {
        let right = Rules::default();
        let not_grown = cull_many(&Rules { grow: false, ..right });
        let not_near = cull_many(&Rules { near_rule: false, ..right });
        // A grown box is strictly nearer than what it holds, so that Greater shows only without growth.
        let greater = cull_many(&Rules { grow: false, depth_test_inclusive: false, ..right });
        for outcome in [&not_grown, &not_near, &greater] {
            assert!(outcome.lost > 0 && outcome.differing_pixels > 0, "{outcome:?}");
        }
        assert!(greater.lost > 2 * not_grown.lost, "{greater:?} {not_grown:?}");
    }

    #[test]
    fn boxes_that_prove_nothing_are_visible() {
        let size = PictureSize { width: 64, height: 48 };
        let camera =
            Camera::look_at([0.0; 3], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], 60.0, 0.5).unwrap();
        let test = |min: [f64; 3], max: [f64; 3]| {
            let hlod = Hlod { min, max, ..bytemuck::Zeroable::zeroed() };
            test_for(&hlod, &camera, size, &Rules::default())
        };
        assert_eq!(test([-1.0; 3], [1.0; 3]), Test::Visible, "holds the eye");
        assert_eq!(test([1.0, 1.0, 0.4], [2.0, 2.0, 9.0]), Test::Visible, "crosses near");
        assert_eq!(test([0.0, 0.0, 0.5001], [1.0; 3]), Test::Visible, "almost crosses near");
        assert_eq!(test([0.0, 0.0, 1.0], [1e300; 3]), Test::Visible, "beyond f32");
        assert_eq!(test([0.0, 0.0, 1.0], [f64::INFINITY; 3]), Test::Visible);
        assert_eq!(test([0.0, 0.0, f64::NAN], [1.0; 3]), Test::Visible);
        assert_eq!(test([0.0, 0.0, 0.6], [0.1, 0.1, 1e6]), Test::Visible, "spoils its bound");
        let Test::Query(query) = test([-1.0, -1.0, 10.0], [1.0, 1.0, 11.0]) else {
            panic!("a plain box ahead");
        };
        let grown_px = f64::from(10.0 - query.min[2]) / (10.0 * pixel_at_unit_depth(&camera, size));
        assert!(grown_px > 1.0 / 64.0 && grown_px < 0.1, "{grown_px}");
    }

    #[test]
    fn a_point_far_from_the_origin_is_grown_by_its_rounding() {
        let size = PictureSize { width: 16384, height: 16384 };
        let eye = [1e9, -1e9, 1e9];
        let target = [1e9, -1e9, 1e9 + 1.0];
        let camera = Camera::look_at(eye, target, [0.0, 1.0, 0.0], 1.0, 1e-6).unwrap();
        let min = [1e9, -1e9, 1e9 + 1e-4];
        let hlod = Hlod { min, max: min, ..bytemuck::Zeroable::zeroed() };
        let Test::Query(query) = test_for(&hlod, &camera, size, &Rules::default()) else {
            panic!("a point well ahead");
        };
        assert!(f64::from(query.max[0]) > 1e9 * f64::EPSILON);
    }
}
