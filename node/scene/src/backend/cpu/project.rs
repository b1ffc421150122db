//! From eye-relative coordinates to the screen, clipping what the rasteriser's grid cannot hold.

use super::raster::{GRID_MAX, SUBPIXELS, ScreenVertex, Span, Turns, triangle};
use crate::backend::{Draw, View};
use protocol::settings::PictureSize;
use std::ops::ControlFlow;

/// Homogeneous screen coordinates: clip x, y and w (the view depth), and clip z (the near distance), all
/// times the weight of the point, which is 1 but for [`protocol::format::projected`] blobs.
pub(super) type Clip = [f64; 4];

/// An affine map from some coordinates to [`Clip`]: rows of three factors and a constant.
pub(super) type Rows = [[f64; 4]; 4];

/// The frustum's planes a vertex lies outside of, and two bits that ask for clipping.
const LEFT: u8 = 1;
const RIGHT: u8 = 2;
const BOTTOM: u8 = 4;
const TOP: u8 = 8;
const NEAR: u8 = 16;
const GUARD: u8 = 32;
/// A triangle with all vertices outside one of these is not seen.
const FRUSTUM: u8 = LEFT | RIGHT | BOTTOM | TOP | NEAR;
/// A triangle with a vertex outside one of these has no place on the grid.
const UNPLACED: u8 = NEAR | GUARD;

/// A vertex, transformed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placed {
    /// Meaningless unless [`Placed::on_grid`].
    pub(super) screen: ScreenVertex,
    code: u8,
}

impl Placed {
    /// It has a place on the rasteriser's grid.
    pub(super) fn on_grid(self) -> bool {
        self.code & UNPLACED == 0
    }
}

/// How far from the middle of the picture triangles are clipped at most, in halves of its sides.
pub(super) fn guard_band(size: PictureSize) -> f64 {
    let least_half = f64::from(size.width.min(size.height)) * 0.5;
    (GRID_MAX / SUBPIXELS) as f64 / least_half
}

/// The projection of one view, in f64.
pub(super) struct Projection {
    pub(super) size: PictureSize,
    clip_from_eye: Rows,
    /// Half the picture, pixels.
    half: [f64; 2],
    /// Largest |x / w| and |y / w| within the grid.
    guard: [f64; 2],
}

impl Projection {
    pub(super) fn new(view: &View) -> Self {
        let m = view.clip_from_eye.map(|column| column.map(f64::from));
        let row = |r: usize| [m[0][r], m[1][r], m[2][r], m[3][r]];
        let half = [view.size.width, view.size.height].map(|pixels| f64::from(pixels) * 0.5);
        // A little less than the grid holds, so that rounding stays inside.
        let grid_px = (GRID_MAX / SUBPIXELS) as f64 * 0.99;
        Self {
            size: view.size,
            clip_from_eye: [row(0), row(1), row(3), row(2)],
            half,
            guard: half.map(|half| grid_px / half - 1.0),
        }
    }

    /// Clip coordinates of an eye-relative point.
    pub(super) fn clip(&self, p: [f64; 3]) -> Clip {
        apply(&self.clip_from_eye, p)
    }

    /// The map from a draw's vertex grid. The weight of a point of a projected one is its disparity.
    pub(super) fn clip_from_grid(&self, draw: &Draw, is_projected: bool) -> Rows {
        let columns = [draw.linear[0], draw.linear[1], draw.linear[2], draw.offset];
        let (carrier, weight) =
            if is_projected { (2, f64::from(draw.disparity_step)) } else { (3, 1.0) };
        self.clip_from_eye.map(|row| {
            let mut combined =
                columns.map(|column| (0..3).map(|k| row[k] * f64::from(column[k])).sum::<f64>());
            combined[carrier] += row[3] * weight;
            combined
        })
    }

    /// Normalised device coordinates of a pixel's centre.
    pub(super) fn pixel_center(&self, x: u32, y: u32) -> [f64; 2] {
        let [half_width, half_height] = self.half;
        [(f64::from(x) + 0.5) / half_width - 1.0, 1.0 - (f64::from(y) + 0.5) / half_height]
    }

    /// Rows of the inverse of clip (x, y, w) from eye; all zero where there is none.
    pub(super) fn eye_from_clip(&self) -> [[f64; 3]; 3] {
        let [x, y, w, _] = self.clip_from_eye.map(|[a, b, c, _]| [a, b, c]);
        let columns = [cross(y, w), cross(w, x), cross(x, y)];
        let determinant = dot(x, columns[0]);
        let scale = if determinant == 0.0 { 0.0 } else { 1.0 / determinant };
        std::array::from_fn(|r| std::array::from_fn(|c| columns[c][r] * scale))
    }

    pub(super) fn place(&self, [x, y, w, z]: Clip) -> Placed {
        let bit = |condition: bool, bit: u8| if condition { bit } else { 0 };
        // NaN fails every comparison and so lands outside the near plane.
        let in_guard = x.abs() <= self.guard[0] * w && y.abs() <= self.guard[1] * w;
        let code = bit(x < -w, LEFT)
            | bit(x > w, RIGHT)
            | bit(y < -w, BOTTOM)
            | bit(y > w, TOP)
            | bit(w.is_nan() || w < z, NEAR)
            | bit(!in_guard, GUARD);
        let reciprocal = 1.0 / w;
        let screen = ScreenVertex {
            x: on_grid(self.half[0] * (1.0 + x * reciprocal)),
            y: on_grid(self.half[1] * (1.0 - y * reciprocal)),
            z: z * reciprocal,
        };
        Placed { screen, code }
    }

    /// Rasterises a triangle; `clip` gives the clip coordinates of its corner again, for the few
    /// that are to be clipped.
    pub(super) fn triangle(
        &self,
        corners: [Placed; 3],
        drawn: Turns,
        clip: impl Fn(usize) -> Clip,
        mut draw: impl FnMut(Span) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let [a, b, c] = corners;
        if a.code & b.code & c.code & FRUSTUM != 0 {
            return ControlFlow::Continue(());
        }
        if (a.code | b.code | c.code) & UNPLACED == 0 {
            return triangle(self.size, corners.map(|corner| corner.screen), drawn, draw);
        }
        let polygon = self.clip_polygon([clip(0), clip(1), clip(2)]);
        let screen: Vec<ScreenVertex> =
            polygon.into_iter().map(|corner| self.place(corner).screen).collect();
        for i in 2..screen.len() {
            triangle(self.size, [screen[0], screen[i - 1], screen[i]], drawn, &mut draw)?;
        }
        ControlFlow::Continue(())
    }

    /// Sutherland and Hodgman 1974, against the near plane and the grid's borders.
    fn clip_polygon(&self, corners: [Clip; 3]) -> Vec<Clip> {
        let [gx, gy] = self.guard;
        let planes: [Clip; 5] = [
            [0.0, 0.0, 1.0, -1.0],
            [1.0, 0.0, gx, 0.0],
            [-1.0, 0.0, gx, 0.0],
            [0.0, 1.0, gy, 0.0],
            [0.0, -1.0, gy, 0.0],
        ];
        let mut polygon = corners.to_vec();
        if !corners.as_flattened().iter().all(|c| c.is_finite()) {
            polygon.clear();
        }
        for [nx, ny, nw, nz] in planes {
            let side = |[x, y, w, z]: Clip| nx * x + ny * y + nw * w + nz * z;
            let mut kept = Vec::with_capacity(polygon.len() + 1);
            for (i, &here) in polygon.iter().enumerate() {
                let next = polygon[(i + 1) % polygon.len()];
                let (at_here, at_next) = (side(here), side(next));
                if at_here >= 0.0 {
                    kept.push(here);
                }
                if (at_here >= 0.0) != (at_next >= 0.0) {
                    // Always from the inside out, so that neighbours meet in the same point.
                    let (inside, outside, t) = if at_here >= 0.0 {
                        (here, next, at_here / (at_here - at_next))
                    } else {
                        (next, here, at_next / (at_next - at_here))
                    };
                    kept.push(std::array::from_fn(|k| inside[k] + (outside[k] - inside[k]) * t));
                }
            }
            polygon = kept;
        }
        polygon
    }
}

/// `rows * (p, 1)`.
pub(super) fn apply(rows: &Rows, p: [f64; 3]) -> Clip {
    rows.map(|[a, b, c, d]| a * p[0] + b * p[1] + c * p[2] + d)
}

pub(super) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The unit vector along `v`; zero for zero.
pub(super) fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    if length > 0.0 { v.map(|c| c / length) } else { [0.0; 3] }
}

/// Nearest grid coordinate of a pixel coordinate.
fn on_grid(pixels: f64) -> i32 {
    // The cast truncates; the shift makes every coordinate of the grid positive.
    let limit = GRID_MAX as f64;
    let grid = (pixels * SUBPIXELS as f64).clamp(-limit, limit);
    (grid + (limit + 0.5)) as i32 - GRID_MAX as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn projection() -> Projection {
        // Looks along +z; both half angles 45 degrees.
        let clip_from_eye = [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [0.0, 0.0, 0.5, 0.0],
        ];
        Projection::new(&View { size: PictureSize { width: 20, height: 10 }, clip_from_eye })
    }

    fn pixels(corners: [[f64; 3]; 3]) -> Vec<(u32, u32, f64)> {
        let projection = projection();
        let clip = corners.map(|p| projection.clip(p));
        let mut seen = Vec::new();
        let _ = projection.triangle(
            clip.map(|c| projection.place(c)),
            Turns::Either,
            |k| clip[k],
            |span| {
                for i in 0..span.len {
                    seen.push((span.x + i, span.y, span.z + span.dz * f64::from(i)));
                }
                ControlFlow::Continue(())
            },
        );
        seen
    }

    #[test]
    fn nothing_comes_of_nonsense() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(pixels([[bad, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]).is_empty());
            assert!(pixels([[0.0, 0.0, bad], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]).is_empty());
        }
        assert!(pixels([[-1.0, -1.0, -1.0], [1.0, -1.0, -1.0], [0.0, 1.0, -1.0]]).is_empty());
        assert!(pixels([[-9.0, -9.0, 0.4], [9.0, -9.0, 0.4], [0.0, 9.0, 0.4]]).is_empty());
        assert!(pixels([[0.0; 3]; 3]).is_empty());
    }

    #[test]
    fn the_grid_is_rounded_to() {
        assert_eq!(on_grid(0.0), 0);
        assert_eq!(on_grid(1.0 / 512.0), 1);
        assert_eq!(on_grid(-1.9 / 512.0), -1);
        assert_eq!(on_grid(1e300), GRID_MAX as i32);
        assert_eq!(on_grid(f64::NEG_INFINITY), -GRID_MAX as i32);
    }

    #[test]
    fn a_floor_is_cut_at_the_near_plane_and_reaches_the_horizon() {
        // y = -1, from behind the eye to far away, wider than the guard band.
        let far = 1e9;
        let seen = pixels([[-far, -1.0, -1.0], [far, -1.0, -1.0], [0.0, -1.0, far]]);
        assert_eq!(seen.len(), 20 * 5);
        for (x, y, z) in seen {
            let ndc_y = 1.0 - (f64::from(y) + 0.5) / 5.0;
            // The ray through the pixel meets y = -1 at depth -1 / ndc_y.
            let expected = 0.5 * -ndc_y;
            // Snapping moves the far edge of a plane by up to 1/256 pixel.
            assert!((z - expected).abs() < 0.5 / 5.0 / 256.0, "{x} {y} {z} {expected}");
        }
    }

    #[test]
    fn maps_are_composed() {
        let draw = Draw {
            blob: protocol::id::BlobId(0),
            item: protocol::id::HlodId(0),
            linear: [[2.0, 0.0, 0.0], [0.0, 3.0, 1.0], [0.0, 0.0, 4.0]],
            offset: [10.0, 20.0, 30.0],
            distance: 0.0,
            disparity_step: 0.0,
        };
        let projection = projection();
        let direct = projection.clip([12.0, 23.0, 35.0]);
        assert_eq!(apply(&projection.clip_from_grid(&draw, false), [1.0, 1.0, 1.0]), direct);
        let [x, y, w, z] = direct;
        let back = projection.eye_from_clip().map(|row| dot(row, [x, y, w]));
        assert_eq!((back, z), ([12.0, 23.0, 35.0], 0.5));
        // The same coordinates of a projected one are those of a point at 1/8 of the distance.
        let draw = Draw { disparity_step: 8.0, ..draw };
        let weighted = apply(&projection.clip_from_grid(&draw, true), [1.0, 1.0, 1.0]);
        assert_eq!(weighted, [x, y, w, 8.0 * 0.5]);
    }

    #[test]
    fn a_corner_at_infinity_has_a_place_and_no_depth() {
        let projection = projection();
        let placed = projection.place([1.0, 0.5, 2.0, 0.0]);
        let near = projection.place([0.5, 0.25, 1.0, 0.5]);
        assert!(
            placed.on_grid()
                && (placed.screen.x, placed.screen.y) == (near.screen.x, near.screen.y)
        );
        assert_eq!((placed.screen.z, near.screen.z), (0.0, 0.5));
        let nearer = [0.0, 0.0, 0.4, 0.5];
        for nowhere in [nearer, [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [f64::NAN; 4]] {
            assert!(!projection.place(nowhere).on_grid(), "{nowhere:?}");
        }
    }
}
