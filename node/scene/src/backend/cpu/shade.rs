//! Colours of pixels, from the triangle that owns each.
//!
//! Attributes are interpolated with perspective from barycentric coordinates of the pixel's ray in clip
//! space (Olano and Greer 1997), so no clipped triangle needs attributes of its own.

use super::mesh::{Mesh, Texturing};
use super::patch::Patch;
use super::project::{Projection, Rows, apply, cross, dot, unit};
use super::relight::{FaceAxes, Relight, Sunlight};
use super::texture::{Footprint, Textures};
use crate::backend::{Draw, light};
use protocol::format::Vertex;
use protocol::format::projected::SUBPIXELS;

/// sRGB encoding of linear values to 8 bits, rounded to nearest.
pub(super) struct SrgbEncoder {
    /// `thresholds[k]`: the least linear value that is encoded as more than `k`.
    thresholds: Vec<f32>,
    /// Code of the least value of each of [`SrgbEncoder::CELLS`] cells.
    first: Vec<u8>,
}

impl SrgbEncoder {
    /// Cells of [0, 1]: at most one threshold in each.
    const CELLS: usize = 4096;

    pub(super) fn new() -> Self {
        let decode = |s: f64| {
            if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
        };
        let thresholds: Vec<f32> =
            (0..255).map(|k| decode((f64::from(k) + 0.5) / 255.0) as f32).collect();
        let code = |linear: f32| thresholds.partition_point(|&t| t <= linear) as u8;
        let first = (0..Self::CELLS).map(|i| code(i as f32 / Self::CELLS as f32)).collect();
        Self { thresholds, first }
    }

    /// The code of a linear value; values outside [0, 1] are clamped, NaN is 0.
    pub(super) fn encode(&self, linear: f32) -> u8 {
        let cell = (linear * Self::CELLS as f32) as usize;
        let Some(&first) = self.first.get(cell) else {
            return u8::MAX;
        };
        let next = self.thresholds.get(usize::from(first));
        first + u8::from(next.is_some_and(|&threshold| linear >= threshold))
    }

    /// An opaque pixel.
    pub(super) fn encode_rgba(&self, linear: [f32; 3]) -> [u8; 4] {
        let [r, g, b] = linear.map(|c| self.encode(c));
        [r, g, b, u8::MAX]
    }
}

/// What the triangles of one draw share.
pub(super) struct Placement {
    clip_from_grid: Rows,
    /// Columns of the linear part's inverse transpose, up to a factor.
    normal_from_mesh: [[f64; 3]; 3],
    /// Of a projected one.
    face: FaceAxes,
}

impl Placement {
    pub(super) fn new(projection: &Projection, draw: &Draw, is_projected: bool) -> Self {
        let [x, y, z] = draw.linear.map(|column| column.map(f64::from));
        Self {
            clip_from_grid: projection.clip_from_grid(draw, is_projected),
            normal_from_mesh: [cross(y, z), cross(z, x), cross(x, y)],
            face: FaceAxes::of(draw),
        }
    }
}

/// A triangle, ready to be shaded at any pixel.
pub(super) struct Surface<'a> {
    edges: Edges,
    look: Look<'a>,
}

/// Normals of the planes through the eye and an edge, in clip space: their products with a ray are in
/// proportion to the barycentric coordinates.
struct Edges([[f64; 3]; 3]);

/// What a triangle's corners carry.
enum Look<'a> {
    /// Colours that wait for light.
    Lit(Lit),
    /// A picture that has light.
    Projected(Places, &'a Patch, FaceAxes),
}

/// Places in a picture over the screen, pixels: `u / w` and `v / w`, where all three are linear in normalised device
/// coordinates.
struct Places {
    uv: [[f64; 3]; 2],
    w: [f64; 3],
}

impl Places {
    /// Of a triangle with these edges and places of its corners.
    fn new(edges: &Edges, corners: [[f64; 2]; 3]) -> Self {
        let sum = |weights: [f64; 3]| {
            std::array::from_fn(|k| (0..3).map(|i| edges.0[i][k] * weights[i]).sum())
        };
        Self { uv: [0, 1].map(|axis| sum(corners.map(|corner| corner[axis]))), w: sum([1.0; 3]) }
    }

    /// At a pixel's centre. A snapped pixel may lie a little outside, where the plane of the triangle goes on.
    fn at(&self, [x, y]: [f64; 2]) -> [f32; 2] {
        let share = 1.0 / dot(self.w, [x, y, 1.0]);
        self.uv.map(|of| (dot(of, [x, y, 1.0]) * share) as f32)
    }
}

struct Lit {
    normals: [[f32; 3]; 3],
    /// With alpha.
    colors: [[f32; 4]; 3],
    /// Of textured meshes.
    texturing: Option<[Texturing; 3]>,
}

/// A pixel as surfaces see it.
#[derive(Clone, Copy)]
pub(super) struct Pixel<'a> {
    projection: &'a Projection,
    at: [u32; 2],
    /// Normalised device coordinates of its centre.
    pub(super) center: [f64; 2],
}

impl<'a> Pixel<'a> {
    pub(super) fn new(projection: &'a Projection, at: [u32; 2]) -> Self {
        Self { projection, at, center: projection.pixel_center(at[0], at[1]) }
    }

    /// Columns and rows of its block of two by two, left and upper first, in the same coordinates.
    fn block(&self) -> [[f64; 2]; 2] {
        let [x, y] = self.at;
        let [left, upper] = self.projection.pixel_center(x & !1, y & !1);
        let [right, lower] = self.projection.pixel_center(x | 1, y | 1);
        [[left, right], [upper, lower]]
    }
}

impl<'a> Surface<'a> {
    pub(super) fn new(placement: &Placement, mesh: &'a Mesh, triangle: usize) -> Self {
        let indices = mesh.triangles[triangle].map(usize::from);
        let grid = indices.map(|i| mesh.grid(i));
        let [a, b, c] = grid.map(|grid| {
            let [x, y, w, _] = apply(&placement.clip_from_grid, grid);
            [x, y, w]
        });
        let edges = Edges([cross(b, c), cross(c, a), cross(a, b)]);
        let look = match &mesh.patch {
            None => Look::Lit(Lit::new(placement, mesh, indices)),
            Some(patch) => {
                let pixels = |c: f64| c / f64::from(SUBPIXELS);
                let places = grid.map(|[u, v, _]| [pixels(u), pixels(v)]);
                Look::Projected(Places::new(&edges, places), patch, placement.face)
            }
        };
        Self { edges, look }
    }

    /// Whether a masked triangle is there.
    pub(super) fn is_there(&self, textures: &Textures, pixel: Pixel<'_>) -> bool {
        let Look::Lit(lit) = &self.look else { return true };
        let cutoff = lit.texturing.as_ref().map_or(0.0, |corners| corners[0].cutoff);
        lit.base(&self.edges, textures, pixel)[3] >= cutoff
    }

    /// Linear colour, lit, and alpha, seen along `ray` (eye-relative, any length).
    pub(super) fn color(
        &self,
        textures: &Textures,
        sunlight: Sunlight,
        pixel: Pixel<'_>,
        ray: impl FnOnce() -> [f64; 3],
    ) -> [f32; 4] {
        match &self.look {
            Look::Lit(lit) => {
                let normal = lit.normal(&self.edges, pixel, ray());
                let light = light::intensity(normal, sunlight.sun);
                let [r, g, b, alpha] = lit.base(&self.edges, textures, pixel);
                [r * light, g * light, b * light, alpha]
            }
            Look::Projected(places, patch, axes) => {
                let place = places.at(pixel.center);
                let relight = Relight::new(sunlight, axes);
                let [r, g, b] = patch.sample(textures, place, relight.as_ref());
                [r, g, b, 1.0]
            }
        }
    }

    /// Unit normal that faces the viewer along `ray`; zero where there is none.
    pub(super) fn normal(&self, pixel: Pixel<'_>, ray: impl FnOnce() -> [f64; 3]) -> [f32; 3] {
        match &self.look {
            Look::Lit(lit) => lit.normal(&self.edges, pixel, ray()),
            Look::Projected(..) => [0.0; 3],
        }
    }
}

impl Edges {
    fn products(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        self.0.map(|edge| dot(edge, [x, y, 1.0]))
    }
}

impl Lit {
    fn new(placement: &Placement, mesh: &Mesh, indices: [usize; 3]) -> Self {
        let corners = indices.map(|i| mesh.vertices[i]);
        let [x, y, z] = placement.normal_from_mesh;
        let normal = |vertex: Vertex| {
            let n = Vertex::unpack_normal(vertex.normal).map(f64::from);
            let turned = std::array::from_fn(|k| x[k] * n[0] + y[k] * n[1] + z[k] * n[2]);
            unit(turned).map(|c| c as f32)
        };
        let texturing = || indices.map(|i| mesh.texturing[i]);
        Self {
            normals: corners.map(normal),
            colors: corners.map(|vertex| vertex.color.to_le_bytes().map(|c| f32::from(c) / 255.0)),
            texturing: (!mesh.texturing.is_empty()).then(texturing),
        }
    }

    /// Linear colour and alpha before any light.
    fn base(&self, edges: &Edges, textures: &Textures, pixel: Pixel<'_>) -> [f32; 4] {
        let color = blend(&self.colors, barycentric(edges.products(pixel.center)));
        let Some(corners) = &self.texturing else { return color };
        // Off the triangle too: its plane goes on, where the nearest corner would shorten the step.
        let tex_coord = |center: [f64; 2]| -> [f64; 2] {
            let products = edges.products(center);
            let sum: f64 = products.iter().sum();
            std::array::from_fn(|k| {
                (0..3).map(|i| products[i] / sum * f64::from(corners[i].tex_coord[k])).sum()
            })
        };
        let ([x, y], [columns, rows]) = (pixel.center, pixel.block());
        // Both pixels of a pair have the step between them, as they have with graphics drivers.
        let step = |from: [f64; 2], to: [f64; 2]| {
            let (from, to) = (tex_coord(from), tex_coord(to));
            std::array::from_fn(|k| (to[k] - from[k]) as f32)
        };
        let footprint = Footprint {
            at: tex_coord(pixel.center).map(|c| c as f32),
            across: step([columns[0], y], [columns[1], y]),
            down: step([x, rows[0]], [x, rows[1]]),
        };
        let texture = textures.sample(corners[0].texture, &footprint);
        std::array::from_fn(|k| color[k] * texture[k])
    }

    /// Unit normal that faces the viewer, zero where corners have none.
    fn normal(&self, edges: &Edges, pixel: Pixel<'_>, ray: [f64; 3]) -> [f32; 3] {
        let weights = barycentric(edges.products(pixel.center));
        let mut normal = unit(blend(&self.normals, weights).map(f64::from));
        if dot(normal, ray) > 0.0 {
            normal = normal.map(|c| -c);
        }
        normal.map(|c| c as f32)
    }
}

fn blend<const N: usize>(of: &[[f32; N]; 3], weights: [f32; 3]) -> [f32; N] {
    std::array::from_fn(|k| of[0][k] * weights[0] + of[1][k] * weights[1] + of[2][k] * weights[2])
}

/// Shares of the corners; a snapped pixel may lie a little outside, where the nearest are taken.
fn barycentric(products: [f64; 3]) -> [f32; 3] {
    let sum: f64 = products.iter().sum();
    let inside = products.map(|p| (p / sum).max(0.0));
    let sum: f64 = inside.iter().sum();
    if sum.is_finite() && sum > 0.0 { inside.map(|p| (p / sum) as f32) } else { [1.0 / 3.0; 3] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_is_rounded_to_nearest() {
        let encoder = SrgbEncoder::new();
        for (value, code) in [(-1.0, 0), (f32::NAN, 0), (0.0, 0), (1.0, 255), (7.0, 255)] {
            assert_eq!(encoder.encode(value), code, "{value}");
        }
        for i in 0..=100_000 {
            let linear = i as f32 / 100_000.0;
            let l = f64::from(linear);
            let s = if l <= 0.0031308 { 12.92 * l } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
            let off = (f64::from(encoder.encode(linear)) - s * 255.0).abs();
            assert!(off < 0.5 + 1e-3, "{linear} {off}");
        }
    }

    #[test]
    fn degenerate_shares_are_even() {
        assert_eq!(barycentric([0.0; 3]), [1.0 / 3.0; 3]);
        assert_eq!(barycentric([f64::NAN, 1.0, 1.0]), [1.0 / 3.0; 3]);
        assert_eq!(barycentric([-1.0, -1.0, -2.0]), [0.25, 0.25, 0.5]);
        assert_eq!(barycentric([-1e-9, 1.0, 0.0]), [0.0, 1.0, 0.0]);
    }
}
