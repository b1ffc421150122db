//! From a camera to what backends and culling need. Only `+ - * / sqrt`, in f64.

use crate::backend::View;
use geometry::frustum::{Basis, Frustum};
use glam::DVec3;
use protocol::camera::Camera;
use protocol::settings::PictureSize;

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
    use geometry::bounds::Aabb;
    use geometry::frustum::Containment;

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
    fn a_pixel_spans_the_picture_height_times() {
        let size = PictureSize { width: 10, height: 500 };
        let height = pixel_at_unit_depth(&camera(), size) * 500.0;
        assert!((height - 2.0 * f64::from(camera().tan_half_fov_y)).abs() < 1e-12);
    }
}
