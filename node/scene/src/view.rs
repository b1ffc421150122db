//! From a camera to what backends and culling need. Only `+ - * / sqrt`, in f64.

use crate::backend::View;
use geometry::bounds::Aabb;
use geometry::frustum::{Basis, Frustum};
use glam::DVec3;
use protocol::camera::Camera;
use protocol::settings::PictureSize;
use std::ops::Range;

/// More than a renderer's f32 displaces a box by, as a share of its size and distance (item 2 of
/// [`crate::occludee`]).
const TRANSFORM: f64 = 1.0 / (1u64 << 16) as f64;

/// Tangents of half the horizontal and vertical angle. Pixels are square.
pub(crate) fn tan_half(camera: &Camera, size: PictureSize) -> [f64; 2] {
    let y = f64::from(camera.tan_half_fov_y);
    [y * f64::from(size.width) / f64::from(size.height), y]
}

/// World size of a pixel, across or down, at view depth 1.
pub fn pixel_at_unit_depth(camera: &Camera, size: PictureSize) -> f64 {
    2.0 * f64::from(camera.tan_half_fov_y) / f64::from(size.height)
}

/// Length of the longest view ray, to a corner of the picture, at view depth 1.
pub fn corner_ray(camera: &Camera, size: PictureSize) -> f64 {
    ray_at_unit_depth(tan_half(camera, size))
}

/// Length at view depth 1 of the ray with these tangents to the axis.
pub(crate) fn ray_at_unit_depth([x, y]: [f64; 2]) -> f64 {
    (1.0 + x * x + y * y).sqrt()
}

/// The axes of a camera: unit length and perpendicular to f32 rounding.
pub(crate) fn basis(camera: &Camera) -> Basis {
    let wide = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
    Basis {
        right: DVec3::from_array(camera.right()),
        up: wide(camera.up),
        forward: wide(camera.forward),
    }
}

/// The region `camera` sees in a picture of `size`, relative to the eye.
pub fn frustum(camera: &Camera, size: PictureSize) -> Frustum {
    Frustum::new(basis(camera), tan_half(camera, size), f64::from(camera.near))
}

/// Columns and rows of all pixels that can show something of `bounds`, relative to the eye, whatever a
/// renderer rounds: all of the picture's where a part of it may lie before the near plane.
pub fn pixels_of(bounds: &Aabb, camera: &Camera, size: PictureSize) -> [Range<u32>; 2] {
    let farthest = bounds.min.abs().max(bounds.max.abs()).length();
    let grown = bounds.grown(TRANSFORM * (farthest + 4.0 * bounds.diagonal()));
    let Basis { right, up, forward } = basis(camera);
    let tan_half = tan_half(camera, size);
    let sides = [size.width, size.height];

    let mut reach = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
    for corner in 0..8u32 {
        let p = DVec3::from_array(std::array::from_fn(|k| {
            if corner >> k & 1 == 1 { grown.max[k] } else { grown.min[k] }
        }));
        let depth = forward.dot(p);
        if depth <= f64::from(camera.near) {
            return sides.map(|side| 0..side);
        }
        // Rows go down.
        for (axis, at) in [right.dot(p), -up.dot(p)].into_iter().enumerate() {
            let px = (at / (depth * tan_half[axis]) + 1.0) * 0.5 * f64::from(sides[axis]);
            reach[axis] = [reach[axis][0].min(px), reach[axis][1].max(px)];
        }
    }
    // A pixel wider, for snapping.
    std::array::from_fn(|axis| {
        let [first, end] = [reach[axis][0] - 1.0, reach[axis][1].ceil() + 1.0];
        (first as u32).min(sides[axis])..(end as u32).min(sides[axis])
    })
}

impl View {
    /// The view of `camera` in a picture of `size`: infinite reversed-Z,
    /// `clip = (right.p / tan_x, up.p / tan_y, near, forward.p)` for `p` relative to the eye.
    pub fn new(camera: &Camera, size: PictureSize) -> Self {
        let Basis { right, up, forward } = basis(camera);
        let [tan_x, tan_y] = tan_half(camera, size);
        let (x, y) = (right / tan_x, up / tan_y);
        let column = |k: usize| [x[k] as f32, y[k] as f32, 0.0, forward[k] as f32];
        let clip_from_eye = [column(0), column(1), column(2), [0.0, 0.0, camera.near, 0.0]];
        Self { size, clip_from_eye }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::{Backend, Completion, NO_ITEM, Part, Pass};
    use crate::draw_list::draw_list;
    use crate::front::{box_from_eye, front};
    use crate::occludee::Rules;
    use crate::random_scene::RandomScene;
    use geometry::frustum::Containment;
    use protocol::id::HlodId;

    fn camera() -> Camera {
        Camera::look_at([1e7, 2.0, 3.0], [1e7 + 1.0, 2.5, 1.0], [0.0, 1.0, 0.0], 50.0, 0.25)
            .unwrap()
    }

    fn clip(view: &View, p: DVec3) -> [f64; 4] {
        let m = view.clip_from_eye.map(|c| c.map(f64::from));
        std::array::from_fn(|r| m[0][r] * p.x + m[1][r] * p.y + m[2][r] * p.z + m[3][r])
    }

    #[test]
    fn corners_of_the_picture_are_corners_of_clip_space() {
        for (width, height) in [(1, 1), (7, 333), (640, 360)] {
            let (camera, size) = (camera(), PictureSize { width, height });
            let view = View::new(&camera, size);
            let Basis { right, up, forward } = basis(&camera);
            let [tx, ty] = tan_half(&camera, size);
            for (sx, sy) in [(-1.0, -1.0), (1.0, 1.0), (0.0, 1.0)] {
                let depth = 8.0;
                let p = (forward + right * (sx * tx) + up * (sy * ty)) * depth;
                let c = clip(&view, p);
                let expected = [sx * depth, sy * depth, 0.25, depth];
                let off = (0..4).map(|k| (c[k] - expected[k]).abs()).fold(0.0, f64::max);
                assert!(off < 1e-5, "{c:?} {expected:?}");
                assert!(p.length() <= depth * corner_ray(&camera, size) * (1.0 + 1e-6));
            }
        }
    }

    #[test]
    fn frustum_and_matrix_agree() {
        let (camera, size) = (camera(), PictureSize { width: 64, height: 48 });
        let (view, frustum) = (View::new(&camera, size), frustum(&camera, size));
        let mut seen = 0;
        for i in 0..20_000u32 {
            let p = DVec3::new(
                f64::from(i % 29) - 14.0,
                f64::from(i / 29 % 29) - 14.0,
                f64::from(i / 841 % 29) - 14.0,
            );
            let [x, y, _, w] = clip(&view, p);
            let inside = x.abs() < 0.999 * w && y.abs() < 0.999 * w && w > 0.25;
            let outside = x.abs() > 1.001 * w || y.abs() > 1.001 * w || w < 0.249;
            let answer = frustum.contains(&Aabb { min: p, max: p });
            assert!(!inside || answer == Containment::Inside, "{p}");
            assert!(!outside || answer == Containment::Outside, "{p}");
            seen += u32::from(inside);
        }
        assert!(seen > 500);
    }

    #[test]
    fn all_pixels_that_show_a_box_are_among_its_own() {
        let size = PictureSize { width: 90, height: 50 };
        let mut fewer = 0;
        for seed in 0..200 {
            let mut scene = RandomScene::new(seed, 2, 16.0);
            let camera = scene.camera();
            let front = front(&scene.skeleton, &camera, size, 0.0).entries;
            let mut backend = scene.backend(size, &Rules::default());
            let draws = draw_list(&scene.skeleton, &front, camera.eye);
            let view = View::new(&camera, size);
            backend.submit(Pass::Items { view, draws, part: Part::WHOLE }).unwrap();
            let mut completions = Vec::new();
            backend.poll(&mut completions).unwrap();
            let Completion::Items { items, .. } = &completions[0] else { panic!("items") };
            for (at, &item) in (0u32..).zip(items).filter(|(_, item)| **item != NO_ITEM) {
                let seen = box_from_eye(scene.skeleton.hlod(HlodId(item)), camera.eye);
                let [columns, rows] = pixels_of(&seen, &camera, size);
                assert!(columns.contains(&(at % 90)) && rows.contains(&(at / 90)), "{seed} {at}");
                fewer += u32::from(columns.len() * rows.len() < 90 * 50 / 4);
            }
        }
        assert!(fewer > 1000, "{fewer}");
        let beside = Aabb { min: DVec3::splat(-2e7), max: DVec3::splat(-1e7) };
        let camera = Camera { forward: [0.0, 0.0, -1.0], up: [0.0, 1.0, 0.0], ..camera() };
        let narrow = Camera { tan_half_fov_y: 0.1, ..camera };
        let [columns, rows] = pixels_of(&beside, &narrow, size);
        assert!(columns.is_empty() && rows.is_empty(), "{columns:?} {rows:?}");
    }

    #[test]
    fn a_pixel_spans_the_picture_height_times() {
        let size = PictureSize { width: 10, height: 500 };
        let height = pixel_at_unit_depth(&camera(), size) * 500.0;
        assert!((height - 2.0 * f64::from(camera().tan_half_fov_y)).abs() < 1e-12);
    }
}
