//! How far the picture of a point moves when the point does: what a level's error is in pixels, at
//! the picture's rim as in its middle.
//!
//! # One point
//!
//! Let `p` be a point that the picture shows, `w` its view depth, `t` the tangent of the angle between
//! its ray and the axis: it is seen at a distance `t` from the middle, at view depth 1. Which points are
//! seen within `a` of `p`? Those of a cone around `p`'s ray, which is where all half spaces
//! `q . (-cos k, -sin k, a + t cos k) >= 0` meet, for every angle `k`: first axis away from the
//! picture's middle, third axis forward. `p` is `a w / sqrt(1 + (a + t cos k)^2)` from the border of
//! each, least at `k = 0`. So the ball of radius `e` around `p` is seen within `a` if and only if
//!
//! ```text
//! e <= a w / sqrt(1 + (t + a)^2)                                                              (1)
//! ```
//!
//! and its picture reaches from `p`'s to `tan(angle + asin(e / |p|))`, that is as far as
//!
//! ```text
//! a = (1 + t^2) e / (sqrt(w^2 (1 + t^2) - e^2) - t e)                                         (2)
//! ```
//!
//! or without end where the root or the difference is not positive. The right side of (1) grows with
//! `w` and `a`, and falls with `t`.
//!
//! # A box
//!
//! All points of an hlod's levels lie in its box. Those that the picture shows have a view depth of at
//! least `W`, the larger of the box's least view depth and `d / s`, where `d` is the box's distance from
//! the eye and `s` the length of the ray to the picture's corner at view depth 1. They are seen at most
//! `T` from the middle: an axis at a time no farther than the picture reaches, nor than `X / W`, `X` being
//! the box's greatest coordinate on that axis.
//!
//! # A level
//!
//! For each point of a level there is a point of the original within its error `e`, and the other way
//! round. Either of the two may be the one that is seen. If it is the level's, it lies in the box. If it
//! is the original's, it is taken to lie within `e` of the box, for the source's own triangles may have
//! been rounded out of it. Then `w >= W - e`, and (1) asks for `e <= a (W - e) / K`, or
//!
//! ```text
//! e <= a W / (K + a),   K = sqrt(1 + (T + a)^2)                                               (3)
//! ```
//!
//! which implies (1) for points in the box, too. As `K >= 1`, no such `e` is more than `a W / (1 + a)`, so
//! an axis of `T` is at most `(X + e) / (W - e) <= (1 + a) X / W + a`. More pixels never allow less
//! error: with `a`, `T + a` grows in a smaller proportion than `a` itself.
//!
//! A camera's axes are f32, so that their lengths and right angles are off by less than 2e-7: the
//! picture is that of a scene which is stretched by as little. [`ROUNDING`] makes up for it.
//!
//! Only `+ - * / sqrt`, in f64.

use crate::view::{basis, corner_ray, pixel_at_unit_depth, tan_half};
use geometry::bounds::Aabb;
use geometry::frustum::Basis;
use glam::DVec3;
use protocol::camera::Camera;
use protocol::settings::PictureSize;

/// Relative margin for a camera's axes, which are f32, and for arithmetic in f64.
const ROUNDING: f64 = 1e-6;

/// A camera and its picture. All coordinates are relative to the eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    axes: Basis,
    /// How far the picture reaches from its middle, across and up, at view depth 1.
    tan_half: [f64; 2],
    /// Length of the ray to its corner, at view depth 1.
    corner_ray: f64,
    /// World size of a pixel at view depth 1.
    pixel: f64,
    /// Least view depth of what is seen.
    near: f64,
    /// The picture's diagonal, pixels.
    diagonal_px: f64,
}

/// Bounds of what the picture shows of a box.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Shown {
    /// `W`, scene units; 0 where the box holds the eye.
    depth: f64,
    /// `T`, at view depth 1.
    off_axis: f64,
}

impl Projection {
    /// Of `camera` in a picture of `size`.
    pub fn new(camera: &Camera, size: PictureSize) -> Self {
        let [width, height] = [size.width, size.height].map(f64::from);
        Self {
            axes: basis(camera),
            tan_half: tan_half(camera, size),
            corner_ray: corner_ray(camera, size),
            pixel: pixel_at_unit_depth(camera, size),
            near: f64::from(camera.near),
            diagonal_px: (width * width + height * height).sqrt(),
        }
    }

    /// The greatest error, scene units, of a level in `bounds` no point of which is seen more than
    /// `lod_px` pixels from where the original has it, nor the other way round (3). 0 where the box holds
    /// the eye.
    pub fn allowed_error(&self, bounds: &Aabb, lod_px: f64) -> f64 {
        let a = lod_px * self.pixel;
        let Shown { depth, off_axis } = self.shown(bounds, a);
        let reach = off_axis + a;
        (1.0 - ROUNDING) * a * depth / ((1.0 + reach * reach).sqrt() + a)
    }

    /// Pixels, at most, between where a point of `bounds` is seen, which is not before the near plane, and
    /// where one within `error` scene units of it is; no more than the picture's diagonal.
    pub fn moved_px(&self, bounds: &Aabb, error: f64) -> f64 {
        let Shown { depth, off_axis } = self.shown(bounds, 0.0);
        self.moved_at_px(depth.max(self.near), off_axis, error)
    }

    /// The same of a point at a view depth, scene units, that is seen at a distance from the picture's
    /// middle, at view depth 1 (2).
    pub fn moved_at_px(&self, depth: f64, off_axis: f64, error: f64) -> f64 {
        if error == 0.0 {
            return 0.0;
        }
        let square = 1.0 + off_axis * off_axis;
        let tangent = depth * depth * square - error * error;
        let ahead = tangent.max(0.0).sqrt() - off_axis * error;
        if ahead > 0.0 {
            let moved = (1.0 + ROUNDING) * square * error / (ahead * self.pixel);
            moved.min(self.diagonal_px)
        } else {
            self.diagonal_px
        }
    }

    /// Of what lies in `bounds`, or so near that it may be held against it at `a`.
    fn shown(&self, bounds: &Aabb, a: f64) -> Shown {
        let (least, _) = span(self.axes.forward, bounds);
        let depth = least.max(bounds.distance(DVec3::ZERO) / self.corner_ray);

        let off = |axis: DVec3, tan_half: f64| {
            let (least, most) = span(axis, bounds);
            // Without a depth this is infinite or no number, and the picture's border counts.
            tan_half.min((1.0 + a) * least.abs().max(most.abs()) / depth + a)
        };
        let [tan_x, tan_y] = self.tan_half;
        let (x, y) = (off(self.axes.right, tan_x), off(self.axes.up, tan_y));
        Shown { depth, off_axis: (x * x + y * y).sqrt() }
    }
}

/// Least and greatest coordinate of a box along `axis`.
fn span(axis: DVec3, b: &Aabb) -> (f64, f64) {
    let (at_min, at_max) = (axis * b.min, axis * b.max);
    (at_min.min(at_max).element_sum(), at_min.max(at_max).element_sum())
}

#[cfg(test)]
mod tests;
