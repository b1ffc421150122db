//! What an hlod's box must be, so that a box found hidden proves the hlod hidden.
//!
//! # What is to be shown
//!
//! At every pixel an hlod covers, its box must cover the pixel too, at a depth no farther than the one
//! the hlod writes, as *computed*. Then at the pixel's nearest hlod the box passes its own test
//! (GreaterEqual), and whatever is culled is hidden everywhere (Manocha, section 4.2).
//!
//! # The part in the picture
//!
//! Let `B` be the hlod's box and `P` the pyramid from the eye through the picture's border. A pixel's
//! centre lies half a pixel within that border. So the point `q` of the geometry that a fragment stems from,
//! which the errors below move onto the ray through a pixel's centre, lies in `P` or no farther
//! outside than they move it: snapping moves by less than half a pixel, and for the rest all sides of `P`
//! are moved outwards by as much ([`Pyramid`]). What is asked is the box `B'` around what `B` and this `P` have in
//! common, grown. Where they have nothing in common no pixel shows the hlod.
//!
//! A point of the picture at distance `r` from the eye has a view depth of at least `r / s`, `s` being the
//! length at depth 1 of the ray to the picture's corner. So of a box `b` outside of which the eye lies nothing
//! that the picture shows is nearer than `distance(b) / s`, wherever its corners are: `B` may run past the eye
//! and `B'`, which has the scene's axes, may have corners behind it.
//!
//! # Errors of a rasteriser, as displacements in the scene
//!
//! Let `w` be the view depth, at most `w1` over `B'`, `d` the distance of the farthest corner of `B` from the eye,
//! `e` the diagonal of `B`, `near` the near distance, and `pixel` the world size of a pixel at depth 1. Depth is
//! `z = near / w`, linear on the screen; `m` is the larger of `|dz/dx|` and `|dz/dy|` over a triangle, a
//! pixel. `u = 2^-24` is half an ulp of 1 in f32. A point between corners moves no farther than the worst
//! corner, so the first two are errors of corners.
//!
//! 1. *Snapping.* Corners are rounded to at least 1/256 pixel, after viewport arithmetic that errs by
//!    at most 1/256 more at 16384 pixels: below 1/128 pixel an axis, for geometry and again for the
//!    box. Both together: 1/64 pixel, taken as 1/32. At fixed `w` that is `pixel * w1 / 32`.
//! 2. *Transforms.* `linear * grid + offset` in f32 errs by `6 u` of its terms. The grid's origin is a
//!    corner of the mesh's own box, which a placement can turn `4 e` away from the scene's box, so the
//!    terms are below `r = d + 4 e`. The clip matrix adds `5 u`, the division `4 u`, clipping as
//!    much again: `30 u r` with room, twice for the two of them: `64 u r = 2^-18 r`. f64 differences of
//!    coordinates of size `c` add `2^-50 c` each. Corners that clipping makes, at the near plane or at the
//!    border of what can be rasterised, lie on edges and so in `B`, and outside `P` but for rounding: what they
//!    are displaced by is counted here, and no more of them is needed.
//! 3. *Depth.* What a backend adds to `z` ([`Precision`]): a share `a` of `z` itself, a share `b` of the greatest `z`
//!    of the triangle, and a share `c` of the range of `z` over it for each pixel that it may reach over. With `w >= w0` and
//!    `w <= W1` over the triangle, and `n` pixels, that is at most `near (b / w0 + c n (1 / w0 - 1 / W1))`
//!    beside `a z`. As `dw / w = w / near dz`, a point of `B'` is moved along its ray, towards the eye, by no more than
//!    the share `a + w1 (b / w0 + c n (1 / w0 - 1 / W1))` of its distance; for geometry, and again for the box.
//!
//! What is the least depth `w0` of a *whole* triangle that covers a pixel? It lies in `B`. What is rasterised of it lies
//! before the near plane, and within `k` pictures from the middle of the picture, where a driver clips it
//! (`k` is [`Precision::guard_band`]): so with `s_k` for the ray to the corner of that, no nearer than
//! `distance(B) / s_k`. And it has a point in `B'`, so no point of it is nearer than
//! `distance(B') / s - l`, `l` being the longest edge of the hlod's levels, which the scene file holds. The greatest of
//! these bounds counts. For the triangles of the box it is the first two, of the box itself. `n` is the
//! picture's width and height together, times `k` where `B` reaches beyond `P`; and of a box no more than what its corners
//! span, and of a triangle than what its edges can: two of its points, one of which lies in the picture, are seen
//! `l / w0 (1 + t)` apart at depth 1 at most, `t` being the tangent of the other, which exceeds the picture's by no more than that.
//!
//! # Steep triangles
//!
//! What is left grows with `m`, which no size of the box bounds: seen edge-on, a triangle has any. So a
//! driver moves all geometry away from the eye, by `m` times [`MESH_BIAS_PX`], in every pass alike.
//!
//! - A driver may decide by the snapped corners which pixels a triangle covers, and take depth from the
//!   plane through the corners before that (Mesa's software driver does). A covered pixel lies within
//!   1/128 pixel an axis of a point of the triangle, the one that has the same shares of the corners, and the
//!   plane changes by at most `2 m / 128 = m / 64` between the two. Half of the bias makes up for it: the
//!   fragment is no nearer than that point, which 1. displaces.
//! - Gradients in f32 are quotients. With `L` the longest side in pixels and `t` the height over it, the
//!   area, as a difference of products, errs by the share `4 u L / t`, and so does the depth between
//!   corners. What changes across the height is at most `t m`, which errs by `4 u L m`. Extrapolation
//!   adds `4 u x m`, `x` being the largest coordinate. Drivers clip at `2^15` pixels at most, so `L` and `x`
//!   are below that: `8 u 2^15 m = m / 64`, the other half.
//! - What changes along the longest side by `dz` errs by `4 u (L / t) dz`, which 3. holds down to
//!   `t = 1/2`: its `c` is `8 u` for geometry, and `L <= n`. **Not proven**: thinner needles that lead away from
//!   the eye, and only where their plane is not steep across; there the bias is larger than this. Millions in
//!   a test of the GPU backend kept to their boxes. In f64 the same holds down to `t = 2^-10`.
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
//! The box that is asked is the one around `B'` and `B'` shrunk towards the eye by the share `f` of item 3., grown by the sum
//! `g` of 1. and 2. on every side. It holds the ball of radius `g` around each point of `B'`, and such a point
//! moved towards the eye. Let `q` be a point of the displaced geometry on the ray through a pixel's centre.
//! Displacing the box's faces by less than `q`'s distance to them leaves `q` enclosed, so the ray from the eye, which is
//! outside, meets a front face before `q`, still by the share that stands for the depth error. The faces
//! turned to the eye are rasterised, which cover the box's whole outline, watertight by the fill rule; so
//! the pixel is covered. That a face is clipped at the near plane takes nothing of it out of the picture where
//! `distance / s` of the box exceeds the near distance.
//!
//! The bound is taken over the *grown* box: some `f` and `g` are assumed, at first twice those of `B'` itself, and those of the
//! box grown by them are found. If they are not more, the box grown by what was found lies within the one it was found
//! for, and bears it. If they are, twice that is assumed, a few times. Where that does not end, and
//! wherever the grown box holds the eye or reaches as near to it as the near plane does in the picture's corner,
//! the hlod counts as visible.

use crate::backend::BoxQuery;
use crate::front::box_from_eye;
use crate::view::{basis, pixel_at_unit_depth, ray_at_unit_depth, tan_half};
use geometry::bounds::Aabb;
use geometry::pyramid::Pyramid;
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
/// Relative margin of the near rule, beyond the transform error.
const NEAR: f64 = 1.0 / (1u64 << 10) as f64;
/// Most that a box may be shrunk towards the eye by, a share of its distance, so that something is left to ask.
const MOST_SHRUNK: f64 = 0.5;
/// Times that a displacement is assumed and held against what it makes of the box.
const MOST_ROUNDS: usize = 4;
/// A box this many near distances from the eye, in the picture's corner, counts as being at the eye.
const NEAR_DISTANCES_AT_EYE: f64 = 4.0;

/// What a backend's depths may err by, and what it rasterises: the terms of the derivation that are its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Precision {
    /// Triangles are clipped no farther from the middle of the picture than this, in halves of its width and
    /// of its height.
    pub guard_band: f64,
    /// Share of a depth that it errs by.
    pub of_depth: f64,
    /// Share of the greatest depth of its triangle that it errs by.
    pub of_greatest: f64,
    /// Share of the range of depth over its triangle that it errs by, for each pixel the triangle may reach over.
    pub of_range_a_pixel: f64,
}

impl Precision {
    /// Depth is interpolated in f32 and stored so: `8 u` of the greatest depth, and of the range a pixel.
    pub const fn f32(guard_band: f64) -> Self {
        let share = 1.0 / (1u64 << 21) as f64;
        Self { guard_band, of_depth: 0.0, of_greatest: share, of_range_a_pixel: share }
    }

    /// Depth is interpolated in f64 and stored in f32: `2 u` of itself, and next to nothing of the range.
    pub const fn f64(guard_band: f64) -> Self {
        Self {
            guard_band,
            of_depth: 1.0 / (1u64 << 23) as f64,
            of_greatest: 0.0,
            of_range_a_pixel: 1.0 / (1u64 << 41) as f64,
        }
    }
}

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
pub enum BoxTest {
    /// It counts as visible: its box holds the eye, or lies within [`NEAR_DISTANCES_AT_EYE`] of it.
    AtEye,
    /// It counts as visible: rounding spoils its box.
    Unproven,
    /// It is visible if this box is.
    Query(BoxQuery),
    /// No pixel shows any of it.
    Outside,
}

/// The boxes of one camera.
pub struct BoxTests {
    eye: [f64; 3],
    forward: DVec3,
    near: f64,
    pixel: f64,
    basis: geometry::frustum::Basis,
    tan_half: [f64; 2],
    /// Length at depth 1 of the ray to the picture's corner.
    corner_ray: f64,
    /// The same to the corner of all that is rasterised.
    guard_ray: f64,
    /// Width and height of the picture together, pixels.
    picture_px: f64,
    precision: Precision,
    rules: Rules,
}

/// Where geometry of an hlod may be displaced to.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Displacement {
    /// In any direction, scene units.
    anyhow: f64,
    /// Towards the eye, a share of the distance.
    towards_eye: f64,
}

impl Displacement {
    const NONE: Self = Self { anyhow: 0.0, towards_eye: 0.0 };

    fn doubled(self) -> Self {
        Self { anyhow: 2.0 * self.anyhow, towards_eye: 2.0 * self.towards_eye }
    }

    fn is_within(self, other: Self) -> bool {
        self.anyhow <= other.anyhow && self.towards_eye <= other.towards_eye
    }

    /// The box around all that points of `b` can be displaced to; the eye is the origin.
    fn of(self, b: &Aabb) -> Aabb {
        let left = 1.0 - self.towards_eye;
        b.union(Aabb { min: b.min * left, max: b.max * left }).grown(self.anyhow)
    }
}

impl BoxTests {
    /// The tests of a frame: pictures of `size` by `camera` on a backend of this precision.
    pub fn new(camera: &Camera, size: PictureSize, precision: Precision, rules: Rules) -> Self {
        let [tx, ty] = tan_half(camera, size);
        let guard = precision.guard_band.max(1.0);
        Self {
            eye: camera.eye,
            forward: DVec3::from_array(camera.forward.map(f64::from)),
            near: f64::from(camera.near),
            pixel: pixel_at_unit_depth(camera, size),
            basis: basis(camera),
            tan_half: [tx, ty],
            corner_ray: ray_at_unit_depth([tx, ty]),
            guard_ray: ray_at_unit_depth([guard * tx, guard * ty]),
            picture_px: f64::from(size.width) + f64::from(size.height),
            precision,
            rules,
        }
    }

    /// The test for `hlod`, no level of which has an edge longer than `longest_edge`, scene units.
    pub fn test(&self, hlod: &Hlod, longest_edge: f64) -> BoxTest {
        let whole = box_from_eye(hlod, self.eye);
        let is_finite = whole.min.is_finite() && whole.max.is_finite();
        if !is_finite || farthest(&whole) > f64::from(f32::MAX) {
            return BoxTest::Unproven;
        }
        let transform = self.transform(hlod, &whole);

        let pyramid = Pyramid::new(self.basis, self.tan_half, transform);
        let part = match pyramid.bounds_within(&whole) {
            Some(part) if part.is_empty() => return BoxTest::Outside,
            Some(part) => part,
            None if self.rules.near_rule => return self.untested(&whole),
            None => whole,
        };

        let displaced = match self.rules {
            Rules { grow: false, .. } => Some(Displacement::NONE),
            Rules { near_rule: false, .. } if part.distance(DVec3::ZERO) == 0.0 => {
                Some(Displacement::NONE)
            }
            _ => self.displacement(&whole, &part, transform, longest_edge),
        };
        let Some(grown) = displaced.map(|displaced| displaced.of(&part)) else {
            return self.untested(&whole);
        };
        if self.rules.near_rule && !self.clears_near_plane(&grown) {
            return self.untested(&whole);
        }

        let query = BoxQuery {
            min: grown.min.to_array().map(|c| c as f32),
            max: grown.max.to_array().map(|c| c as f32),
        };
        if query.min.iter().chain(&query.max).all(|c| c.is_finite()) {
            BoxTest::Query(query)
        } else {
            BoxTest::Unproven
        }
    }

    fn untested(&self, whole: &Aabb) -> BoxTest {
        let at_eye = NEAR_DISTANCES_AT_EYE * self.near * self.corner_ray;
        match whole.distance(DVec3::ZERO) <= at_eye {
            true => BoxTest::AtEye,
            false => BoxTest::Unproven,
        }
    }

    /// Least and greatest view depth.
    fn depths(&self, b: &Aabb) -> (f64, f64) {
        let (at_min, at_max) = (self.forward * b.min, self.forward * b.max);
        (at_min.min(at_max).element_sum(), at_min.max(at_max).element_sum())
    }

    /// Item 2: displacement of all corners of triangles in a box, scene units.
    fn transform(&self, hlod: &Hlod, whole: &Aabb) -> f64 {
        let coordinates = self.eye.iter().chain(&hlod.min).chain(&hlod.max);
        let difference = DIFFERENCE * coordinates.map(|c| c.abs()).sum::<f64>();
        TRANSFORM * (farthest(whole) + 4.0 * whole.diagonal()) + difference
    }

    /// What geometry in `part` of the box `whole` is displaced by against a box around it; `None` where growing by
    /// it spoils the bound. `transform` is item 2.
    fn displacement(
        &self,
        whole: &Aabb,
        part: &Aabb,
        transform: f64,
        longest_edge: f64,
    ) -> Option<Displacement> {
        let by_edge = part.distance(DVec3::ZERO) / self.corner_ray - longest_edge;
        let reach_px = match part == whole {
            true => self.picture_px,
            false => self.edge_px(longest_edge, by_edge).min(self.guarded_px()),
        };
        let w0 = self.least_depth(whole).max(by_edge);
        let of_geometry = self.depth_error(w0, self.depths(whole).1, reach_px);

        let of = |asked: &Aabb| {
            let (_, w1) = self.depths(asked);
            let of_box = self.depth_error(self.least_depth(asked), w1, self.box_px(asked));
            Displacement {
                anyhow: SNAPPING_PX * self.pixel * w1 + transform,
                towards_eye: 2.0 * self.precision.of_depth + w1 * (of_geometry + of_box),
            }
        };

        let mut assumed = of(part).doubled();
        for _ in 0..MOST_ROUNDS {
            if assumed.towards_eye > MOST_SHRUNK {
                return None;
            }
            let found = of(&assumed.of(part));
            if found.is_within(assumed) {
                return Some(found);
            }
            assumed = found.doubled();
        }
        None
    }

    /// Most pixels, across and down together, that anything reaches over which is rasterised.
    fn guarded_px(&self) -> f64 {
        self.picture_px * self.precision.guard_band
    }

    /// The same of a triangle with a point in the picture, no edge longer than `edge`, and no point nearer than `w0`.
    fn edge_px(&self, edge: f64, w0: f64) -> f64 {
        if w0 <= self.near {
            return f64::INFINITY;
        }
        let spread = edge / w0;
        2.0 * spread * (1.0 + self.corner_ray) * (1.0 + spread) / self.pixel
    }

    /// The same of the faces of a box.
    fn box_px(&self, b: &Aabb) -> f64 {
        if self.depths(b).0 <= self.near {
            return self.guarded_px();
        }
        let corners = (0..8).map(|bits| {
            let corner = |k: usize| if bits >> k & 1 == 0 { b.min[k] } else { b.max[k] };
            DVec3::new(corner(0), corner(1), corner(2))
        });
        let seen = Aabb::of(corners.map(|corner| {
            let place = DVec3::new(self.basis.right.dot(corner), self.basis.up.dot(corner), 0.0);
            place / self.forward.dot(corner)
        }));
        (seen.extent().element_sum() / self.pixel).min(self.guarded_px())
    }

    /// Least depth of what is rasterised of triangles in `b`.
    fn least_depth(&self, b: &Aabb) -> f64 {
        let by_guard_band = b.distance(DVec3::ZERO) / self.guard_ray;
        self.depths(b).0.max(by_guard_band).max(self.near)
    }

    /// Item 3: what triangles from depth `w0` to `w1` that reach over `reach_px` pixels add to a depth at most,
    /// in units of the near distance.
    fn depth_error(&self, w0: f64, w1: f64, reach_px: f64) -> f64 {
        let range = (1.0 / w0 - 1.0 / w1).max(0.0);
        self.precision.of_greatest / w0 + self.precision.of_range_a_pixel * reach_px * range
    }

    /// The eye is outside, and no rounding brings a point of `b` that the picture shows before the near plane.
    fn clears_near_plane(&self, b: &Aabb) -> bool {
        let least_shown = b.distance(DVec3::ZERO) / self.corner_ray;
        least_shown > self.near * (1.0 + NEAR) + TRANSFORM * farthest(b)
    }
}

/// Distance of the farthest corner from the eye.
fn farthest(b: &Aabb) -> f64 {
    b.min.abs().max(b.max.abs()).length()
}

#[cfg(test)]
mod tests;
