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
//! Depth is `z = near / w`, linear on the screen; `m` is the larger of `|dz/dx|` and `|dz/dy|` over a
//! triangle, a pixel. `u = 2^-24` is half an ulp of 1 in f32. A point between corners moves no farther
//! than the worst corner, so the first two are errors of corners.
//!
//! 1. *Snapping.* Corners are rounded to at least 1/256 pixel, after viewport arithmetic that errs by
//!    at most 1/256 more at 16384 pixels: below `s` = 1/128 pixel an axis, for geometry and again for the
//!    box. Both together: 1/64 pixel, taken as 1/32. At fixed `w` that is `pixel * w1 / 32`.
//! 2. *Transforms.* `linear * grid + offset` in f32 errs by `6 u` of its terms. The grid's origin is a
//!    corner of the mesh's own box, which a placement can turn `4 e` away from the scene's box, so the
//!    terms are below `r = d + 4 e`. The clip matrix adds `5 u`, the division `4 u`, clipping as
//!    much again: `30 u r` with room, twice for the two of them: `64 u r = 2^-18 r`. f64 differences of
//!    coordinates of size `c` add `2^-50 c` each.
//! 3. *Depth.* Storing and interpolating `z` errs by some ulps of the greatest `z = near / w0`, and,
//!    where a driver extrapolates from the picture's corner, by some ulps of the range of `z` times the
//!    `n = width + height` pixels it reaches over: `k u (near / w0 + n (near / w0 - near / w1))`, with
//!    `k = 8` for geometry and 8 for the box. Since `dw = w^2 / near dz`, that is a depth of at most
//!    `16 u (w1^2 / w0 + n (w1 - w0) w1 / w0)`, and along a ray to the picture's corner `s` times that,
//!    `s` being the ray's length at depth 1.
//!
//! # Steep triangles
//!
//! What is left grows with `m`, which no size of the box bounds: seen edge-on, a triangle has any. So a
//! driver moves all geometry away from the eye, by `m` times [`MESH_BIAS_PX`], in every pass alike.
//!
//! - A driver may decide by the snapped corners which pixels a triangle covers, and take depth from the
//!   plane through the corners before that (Mesa's software driver does). A covered pixel lies within
//!   `s` an axis of a point of the triangle, the one that has the same shares of the corners, and the
//!   plane changes by at most `2 s m = m / 64` between the two. Half of the bias makes up for it: the
//!   fragment is no nearer than that point, which 1. displaces.
//! - Gradients in f32 are quotients. With `L` the longest side in pixels and `t` the height over it, the
//!   area, as a difference of products, errs by the share `4 u L / t`, and so does the depth between
//!   corners. What changes across the height is at most `t m`, which errs by `4 u L m`. Extrapolation
//!   adds `4 u x m`, `x` being the largest coordinate. Drivers clip at twice the picture, so `L` and `x`
//!   are below `2^15` pixels: `8 u 2^15 m = m / 64`, the other half.
//! - What changes along the longest side by `dz` errs by `4 u (L / t) dz`, which 3. holds down to
//!   `t = 1/2`. **Not proven**: thinner needles that lead away from the eye, and only where their plane
//!   is not steep across; there the bias is larger than this. Millions in a test of the GPU backend kept
//!   to their boxes.
//! - Where the area before snapping is 0 there is no plane, and the result is no number, which Mesa's
//!   driver takes for depth 1. The GPU backend drops such fragments, in every pass alike.
//!
//! Boxes need the second of these alone. Snapping is no harm to their depth: a ray to a point of the box
//! enters the half space behind the plane of every face turned to the eye before it enters the box, so
//! wherever such a plane is evaluated on the outline it lies in front of the box. A driver moves them
//! towards the eye by `m` times [`BOX_BIAS_PX`]. A box that brings no number is visible.
//!
//! A fragment that a bias moves beyond 0 or 1 is dropped or held there, in every pass alike. The CPU backend
//! takes coverage and depth from the same snapped corners in f64, and so needs neither bias nor guard.
//! Projected blobs are guarded but not moved: no box stands for them, and none is to be hidden by them.
//!
//! # Growing pays for the rest
//!
//! A box grown by the sum `g` on every side holds the ball of radius `g` around each of its points. Let
//! `q` be a point of the displaced geometry. Displacing the grown box's faces by less than `q`'s distance
//! to them leaves `q` enclosed, so the ray from the eye, which is outside, meets a front face before
//! `q`, still by the share of `g` that stands for the depth error. The faces turned to the eye
//! are rasterised, which cover the box's whole outline, watertight by the fill rule; so the pixel is covered.
//!
//! The bound is taken over the *grown* box: with `g1` from the box itself, and `g2` from the box
//! grown by `2 g1`, the box grown by `g2` lies within that if `g2 <= 2 g1`. Else, and wherever the
//! grown box holds the eye or may be clipped by the near plane, the hlod counts as visible: what
//! near clipping makes of its triangles need not lie in its box.

use crate::backend::BoxQuery;
use crate::front::box_from_eye;
use crate::view::{corner_ray, pixel_at_unit_depth};
use geometry::bounds::Aabb;
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::Hlod;
use protocol::settings::PictureSize;

/// What a driver moves the depth of geometry by, towards the eye: pixels, to be multiplied by what depth
/// changes by from one pixel to the next.
pub const MESH_BIAS_PX: f64 = -1.0 / 32.0;
/// The same for boxes.
pub const BOX_BIAS_PX: f64 = 1.0 / 64.0;

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
    /// Depth is moved by the biases where a backend needs it.
    pub bias: bool,
    /// Fragments without a depth are dropped where a driver makes them.
    pub guard: bool,
}

impl Default for Rules {
    fn default() -> Self {
        Self { grow: true, near_rule: true, depth_test_inclusive: true, bias: true, guard: true }
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
mod tests;
