//! Which pixels a triangle covers, and at what depth.
//!
//! Vertices lie on a grid of 1/256 pixel; edge functions are exact in i64; the top-left rule gives a
//! pixel centre on a shared edge to exactly one triangle (Pineda 1988).

use protocol::settings::PictureSize;
use std::ops::ControlFlow;

/// Grid steps in a pixel.
pub(super) const SUBPIXELS: i64 = 256;
/// Largest magnitude of a grid coordinate: edge functions then stay below 2^53, exact in f64 too.
pub(super) const GRID_MAX: i64 = 1 << 24;

/// A vertex on the screen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ScreenVertex {
    /// Column, 1/256 pixel from the left edge.
    pub(super) x: i32,
    /// Row, 1/256 pixel from the top edge.
    pub(super) y: i32,
    /// Depth, near distance / view depth.
    pub(super) z: f64,
}

/// Which triangles are drawn, by how their corners turn on the screen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turns {
    Either,
    CounterClockwise,
    Clockwise,
}

/// Adjacent pixels of one row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    /// Row.
    pub(super) y: u32,
    /// First column.
    pub(super) x: u32,
    /// Number of pixels, at least 1.
    pub(super) len: u32,
    /// Depth at the first.
    pub(super) z: f64,
    /// Its change from pixel to pixel.
    pub(super) dz: f64,
}

/// An edge function along the rows: inside is `value + step_x * column >= 0`.
struct Edge {
    /// At the first column of the current row.
    value: i64,
    step_x: i64,
    step_y: i64,
    /// `1 / |step_x|`.
    inverse: f64,
}

impl Edge {
    /// From `a` to `b`, the inside on its right on a screen with y down, at pixel `first`.
    fn new(a: ScreenVertex, b: ScreenVertex, first: [i64; 2]) -> Self {
        let (dx, dy) = (i64::from(b.x) - i64::from(a.x), i64::from(b.y) - i64::from(a.y));
        let [px, py] = first.map(|pixel| pixel * SUBPIXELS + SUBPIXELS / 2);
        let is_top_left = dy < 0 || (dy == 0 && dx > 0);
        let value = dx * (py - i64::from(a.y)) - dy * (px - i64::from(a.x));
        let step_x = -dy * SUBPIXELS;
        Self {
            value: value - i64::from(!is_top_left),
            step_x,
            step_y: dx * SUBPIXELS,
            inverse: 1.0 / step_x.abs() as f64,
        }
    }

    /// Narrows the columns `from..=to` to those inside.
    fn clip(&self, from: &mut i64, to: &mut i64) {
        if self.step_x > 0 {
            if self.value + self.step_x * *from < 0 {
                // All numbers are exact in f64, so the quotient is off by less than 1.
                let mut x = (-self.value as f64 * self.inverse) as i64;
                x += i64::from(self.value + self.step_x * x < 0);
                x -= i64::from(self.value + self.step_x * (x - 1) >= 0);
                *from = x;
            }
        } else if self.value + self.step_x * *to < 0 {
            if self.value < 0 {
                *to = -1;
            } else {
                let mut x = (self.value as f64 * self.inverse) as i64;
                x -= i64::from(self.value + self.step_x * x < 0);
                x += i64::from(self.value + self.step_x * (x + 1) >= 0);
                *to = x;
            }
        }
    }
}

/// Hands every span of the triangle within a picture of `size` to `draw`, top row first, until it breaks.
/// Coordinates must not exceed [`GRID_MAX`] in magnitude.
pub(super) fn triangle(
    size: PictureSize,
    [a, mut b, mut c]: [ScreenVertex; 3],
    drawn: Turns,
    mut draw: impl FnMut(Span) -> ControlFlow<()>,
) -> ControlFlow<()> {
    // Smallest and largest pixel whose centre lies in the bounds.
    let first = |least: i32| (i64::from(least) + SUBPIXELS / 2 - 1).div_euclid(SUBPIXELS).max(0);
    let last = |greatest: i32, pixels: u32| {
        (i64::from(greatest) - SUBPIXELS / 2).div_euclid(SUBPIXELS).min(i64::from(pixels) - 1)
    };
    let x0 = first(a.x.min(b.x).min(c.x));
    let y0 = first(a.y.min(b.y).min(c.y));
    let x1 = last(a.x.max(b.x).max(c.x), size.width);
    let y1 = last(a.y.max(b.y).max(c.y), size.height);
    if x0 > x1 || y0 > y1 {
        return ControlFlow::Continue(());
    }
    let side = |p: ScreenVertex| [i64::from(p.x) - i64::from(a.x), i64::from(p.y) - i64::from(a.y)];
    let ([bx, by], [cx, cy]) = (side(b), side(c));
    let mut area = bx * cy - by * cx;
    // Rows count downwards: what turns counter-clockwise to the eye has a negative area.
    let left_out = match drawn {
        Turns::Either => false,
        Turns::CounterClockwise => area > 0,
        Turns::Clockwise => area < 0,
    };
    if area == 0 || left_out {
        return ControlFlow::Continue(());
    }
    let (zb, zc) = (b.z - a.z, c.z - a.z);
    let per_pixel = SUBPIXELS as f64 / area as f64;
    let dz_dx = (zb * cy as f64 - zc * by as f64) * per_pixel;
    let dz_dy = (zc * bx as f64 - zb * cx as f64) * per_pixel;
    if area < 0 {
        area = -area;
        std::mem::swap(&mut b, &mut c);
    }
    debug_assert!(area < 1 << 53);
    let mut edges = [(a, b), (b, c), (c, a)].map(|(from, to)| Edge::new(from, to, [x0, y0]));
    let from_a = |pixel: i64, a: i32| {
        (pixel * SUBPIXELS + SUBPIXELS / 2 - i64::from(a)) as f64 / SUBPIXELS as f64
    };
    let z_corner = a.z + dz_dx * from_a(x0, a.x);
    for y in y0..=y1 {
        let (mut from, mut to) = (0, x1 - x0);
        for edge in &edges {
            edge.clip(&mut from, &mut to);
        }
        if from <= to {
            draw(Span {
                y: y as u32,
                x: (x0 + from) as u32,
                len: (to - from + 1) as u32,
                z: z_corner + dz_dy * from_a(y, a.y) + dz_dx * from as f64,
                dz: dz_dx,
            })?;
        }
        for edge in &mut edges {
            edge.value += edge.step_y;
        }
    }
    ControlFlow::Continue(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    fn vertex(x: i32, y: i32, z: f64) -> ScreenVertex {
        ScreenVertex { x, y, z }
    }

    /// How often each pixel is covered, and the depth last written there.
    fn coverage(size: PictureSize, triangles: &[[ScreenVertex; 3]]) -> Vec<(u32, f64)> {
        let mut pixels = vec![(0, 0.0); (size.width * size.height) as usize];
        for &corners in triangles {
            let _ = triangle(size, corners, Turns::Either, |span| {
                assert!(span.len > 0);
                for i in 0..span.len {
                    let pixel = &mut pixels[(span.y * size.width + span.x + i) as usize];
                    *pixel = (pixel.0 + 1, span.z + span.dz * f64::from(i));
                }
                ControlFlow::Continue(())
            });
        }
        pixels
    }

    /// The same by brute force: edge functions at every centre.
    fn inside(corners: &[ScreenVertex; 3], x: u32, y: u32) -> bool {
        let [a, mut b, mut c] = *corners;
        let cross = |o: ScreenVertex, p: ScreenVertex, x: i64, y: i64| {
            i64::from(p.x - o.x) * (y - i64::from(o.y))
                - i64::from(p.y - o.y) * (x - i64::from(o.x))
        };
        if cross(a, b, i64::from(c.x), i64::from(c.y)) < 0 {
            std::mem::swap(&mut b, &mut c);
        }
        let (px, py) = (i64::from(x) * 256 + 128, i64::from(y) * 256 + 128);
        cross(a, b, i64::from(c.x), i64::from(c.y)) != 0
            && [(a, b), (b, c), (c, a)].iter().all(|&(from, to)| {
                let top_left = to.y < from.y || (to.y == from.y && to.x > from.x);
                let value = cross(from, to, px, py);
                value > 0 || (value == 0 && top_left)
            })
    }

    #[test]
    fn degenerate_triangles_cover_nothing() {
        let size = PictureSize { width: 7, height: 5 };
        let p = |x, y| vertex(x, y, 0.5);
        let far = GRID_MAX as i32;
        for corners in [
            [p(128, 128); 3],
            [p(0, 0), p(512, 512), p(1024, 1024)],
            [p(129, 129), p(383, 129), p(129, 383)],
            [p(-far, -far), p(-far, far), p(-1, 0)],
        ] {
            assert!(coverage(size, &[corners]).iter().all(|&(n, _)| n == 0), "{corners:?}");
        }
        let all = [p(-far, -far), p(far, -far), p(0, far)];
        assert!(coverage(size, &[all]).iter().all(|&(n, _)| n == 1));
    }

    #[test]
    fn agrees_with_brute_force() {
        let mut rng = StdRng::seed_from_u64(1);
        let mut covered = 0;
        for round in 0..6000 {
            let size = [(1, 1), (9, 31), (40, 13)][round % 3];
            let size = PictureSize { width: size.0, height: size.1 };
            let reach = [300, 3000, 12_000, GRID_MAX as i32][round % 4];
            // Centres and edges of pixels are where the rule decides.
            let grid = [1, 64, 128][round / 4 % 3];
            let corners = std::array::from_fn(|_| {
                let mut c = || (rng.random_range(-reach / 4..=reach) / grid) * grid;
                vertex(c(), c(), 0.5)
            });
            for (i, &(n, _)) in coverage(size, &[corners]).iter().enumerate() {
                let (x, y) = (i as u32 % size.width, i as u32 / size.width);
                assert_eq!(n == 1, inside(&corners, x, y), "{corners:?} {x} {y}");
                covered += n;
            }
        }
        assert!(covered > 10_000);
    }

    #[test]
    fn a_turn_is_drawn_or_not() {
        let size = PictureSize { width: 4, height: 4 };
        // Up is towards smaller rows: right, then up, then back is counter-clockwise.
        let [a, b, c] = [vertex(0, 1024, 0.5), vertex(1024, 1024, 0.5), vertex(1024, 0, 0.5)];
        let pixels = |corners, drawn| {
            let mut count = 0;
            let _ = triangle(size, corners, drawn, |span| {
                count += span.len;
                ControlFlow::Continue(())
            });
            count
        };
        let counts = |corners| {
            [Turns::Either, Turns::CounterClockwise, Turns::Clockwise].map(|t| pixels(corners, t))
        };
        let [either, left, right] = counts([a, b, c]);
        assert!(either > 0 && (left, right) == (either, 0), "{either} {left} {right}");
        assert_eq!(counts([c, b, a]), [either, 0, either]);
        assert_eq!(counts([a, b, b]), [0, 0, 0]);
    }

    #[test]
    fn a_fan_covers_each_pixel_once() {
        let mut rng = StdRng::seed_from_u64(2);
        let size = PictureSize { width: 24, height: 17 };
        for _ in 0..300 {
            let mut random = |w: i32, h: i32| (rng.random_range(0..=w), rng.random_range(0..=h));
            let (x, y) = random(24 * 256, 17 * 256);
            let middle = vertex(x / 128 * 128, y / 128 * 128, 0.25);
            let ring = [(0, 0), (24 * 256, 0), (24 * 256, 17 * 256), (0, 17 * 256)]
                .map(|(x, y)| vertex(x, y, 0.75));
            let fan: Vec<_> = (0..4).map(|i| [middle, ring[i], ring[(i + 1) % 4]]).collect();
            assert!(coverage(size, &fan).iter().all(|&(n, z)| n == 1 && z > 0.24 && z < 0.76));
        }
    }

    #[test]
    fn depth_is_the_plane_through_the_vertices() {
        let size = PictureSize { width: 30, height: 30 };
        let plane = |x: i32, y: i32| 0.1 + f64::from(x) * 1e-5 + f64::from(y) * 3e-5;
        let at = |x, y| vertex(x, y, plane(x, y));
        for corners in
            [[at(10, 20), at(7000, 300), at(900, 7600)], [at(10, 20), at(900, 7600), at(7000, 300)]]
        {
            let pixels = coverage(size, &[corners]);
            let mut seen = 0;
            for (i, &(n, z)) in pixels.iter().enumerate() {
                let (x, y) = (i as i32 % 30 * 256 + 128, i as i32 / 30 * 256 + 128);
                assert!(n == 0 || (z - plane(x, y)).abs() < 1e-12);
                seen += n;
            }
            assert!(seen > 300);
        }
    }
}
