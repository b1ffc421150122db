//! A list of draws: which of them owns each pixel, its colour, and what blends over it.

use super::mesh::Mesh;
use super::project::{Placed, Projection, apply};
use super::raster::{Span, Turns};
use super::relight::Sunlight;
use super::shade::{Pixel, Placement, Surface};
use super::target::{Depth, TileMinima, pixel_count};
use super::texture::Textures;
use crate::backend::{Draw, normal};
use protocol::format::Class;
use protocol::id::BlobId;
use std::collections::HashMap;
use std::ops::ControlFlow;

/// Stands where no triangle owns a pixel.
const NO_OWNER: u64 = u64::MAX;

const OPAQUE: [Class; 2] = [Class::OpaqueSingle, Class::OpaqueDouble];
const SOLID: [Class; 4] =
    [Class::OpaqueSingle, Class::OpaqueDouble, Class::MaskSingle, Class::MaskDouble];
const BLEND: [Class; 2] = [Class::BlendSingle, Class::BlendDouble];

/// Draws with all they need.
pub(super) struct Painter<'a> {
    projection: &'a Projection,
    eye_from_clip: [[f64; 3]; 3],
    draws: &'a [Draw],
    meshes: Vec<&'a Mesh>,
    textures: &'a Textures,
}

/// A triangle of a draw: `draw << 32 | triangle`, and itself, made when it is first asked for.
struct Latest<'a>(Option<(u64, Surface<'a>)>);

impl<'a> Painter<'a> {
    pub(super) fn new(
        projection: &'a Projection,
        draws: &'a [Draw],
        meshes: &'a HashMap<BlobId, Mesh>,
        textures: &'a Textures,
    ) -> Self {
        let mesh = |draw: &Draw| {
            let found = meshes.get(&draw.blob);
            found.unwrap_or_else(|| panic!("mesh {} is drawn but not uploaded", draw.blob))
        };
        let meshes = draws.iter().map(mesh).collect();
        let eye_from_clip = projection.eye_from_clip();
        Self { projection, eye_from_clip, draws, meshes, textures }
    }

    /// Writes the depth of what is opaque.
    pub(super) fn occlude(&self, depth: &mut Depth) {
        let _ = self.rasterise(self.blob_by_blob(&OPAQUE), |_, _, span| {
            depth.write(&span);
            ControlFlow::Continue(())
        });
    }

    /// Whether a pixel of any class passes.
    pub(super) fn any_passes(&self, depth: &Depth, tiles: &TileMinima) -> bool {
        let order = self.draw_by_draw(&Class::ALL);
        let found = self.rasterise(order, |_, _, span| match depth.any_passes(&span, tiles) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        });
        found.is_break()
    }

    /// Writes depth and linear colours of what is solid.
    pub(super) fn paint(&self, depth: &mut Depth, colors: &mut [[f32; 3]], sunlight: Sunlight) {
        self.shade(depth, colors, |surface, pixel| {
            let ray = || self.ray(pixel);
            let [r, g, b, _] = surface.color(self.textures, sunlight, pixel, ray);
            [r, g, b]
        });
    }

    /// Writes depth and codes of normals of what is solid.
    pub(super) fn paint_normals(&self, depth: &mut Depth, normals: &mut [[u8; 3]]) {
        self.shade(depth, normals, |surface, pixel| {
            normal::encode(surface.normal(pixel, || self.ray(pixel)))
        });
    }

    /// Writes depth of what is solid, and what `look` sees of it.
    fn shade<T>(
        &self,
        depth: &mut Depth,
        pixels: &mut [T],
        look: impl Fn(&Surface<'a>, Pixel<'_>) -> T,
    ) {
        if self.draws.is_empty() {
            return;
        }
        // Each pixel is worked out once, when all that could hide it has been drawn.
        let mut owners = vec![NO_OWNER; pixel_count(self.projection.size)];
        self.own(depth, &mut owners, |owner| owner);
        let placements = self.placements();
        let mut latest = Latest(None);
        let width = self.projection.size.width as usize;
        let rows = owners.chunks_exact(width).zip(pixels.chunks_exact_mut(width));
        for ((owners, pixels), y) in rows.zip(0..) {
            for ((&owner, seen), x) in owners.iter().zip(pixels).zip(0..) {
                if owner != NO_OWNER {
                    *seen = look(latest.of(owner, self, &placements), self.pixel(x, y));
                }
            }
        }
    }

    /// Lays the colours of what blends over `colors`.
    pub(super) fn blend(&self, depth: &Depth, colors: &mut [[f32; 3]], sunlight: Sunlight) {
        let placements = self.placements();
        let mut latest = Latest(None);
        let _ = self.rasterise(self.draw_by_draw(&BLEND), |owner, _, span| {
            depth.visit_passing(&span, |at, x| {
                let pixel = self.pixel(x, span.y);
                let surface = latest.of(owner, self, &placements);
                let [r, g, b, alpha] =
                    surface.color(self.textures, sunlight, pixel, || self.ray(pixel));
                for (under, over) in colors[at].iter_mut().zip([r, g, b]) {
                    *under += (over - *under) * alpha;
                }
            });
            ControlFlow::Continue(())
        });
    }

    /// Writes depth and items of what is solid.
    pub(super) fn mark(&self, depth: &mut Depth, items: &mut [u32]) {
        self.own(depth, items, |owner| self.item(owner));
    }

    /// Writes items of what blends.
    pub(super) fn mark_blending(&self, depth: &Depth, blended: &mut [u32]) {
        let _ = self.rasterise(self.draw_by_draw(&BLEND), |owner, _, span| {
            depth.visit_passing(&span, |at, _| blended[at] = self.item(owner));
            ControlFlow::Continue(())
        });
    }

    /// Writes depth of what is solid, and `mark` of its owner, `draw << 32 | triangle`, wherever it passes.
    fn own<T: Copy>(&self, depth: &mut Depth, marks: &mut [T], mark: impl Fn(u64) -> T) {
        let placements = self.placements();
        let mut latest = Latest(None);
        let _ = self.rasterise(self.blob_by_blob(&SOLID), |owner, class, span| {
            if class.is_opaque() {
                depth.write_owned(&span, mark(owner), marks);
            } else {
                let surface = latest.of(owner, self, &placements);
                depth.write_owned_where(&span, mark(owner), marks, |x| {
                    surface.is_there(self.textures, self.pixel(x, span.y))
                });
            }
            ControlFlow::Continue(())
        });
    }

    fn item(&self, owner: u64) -> u32 {
        self.draws[(owner >> 32) as usize].item.0
    }

    /// Direction in which a pixel's centre lies from the eye, of any length.
    fn ray(&self, pixel: Pixel<'_>) -> [f64; 3] {
        let [x, y] = pixel.center;
        self.eye_from_clip.map(|[a, b, c]| a * x + b * y + c)
    }

    fn placements(&self) -> Vec<Placement> {
        let placed = self.draws.iter().zip(&self.meshes);
        placed
            .map(|(draw, mesh)| Placement::new(self.projection, draw, mesh.patch.is_some()))
            .collect()
    }

    fn pixel(&self, x: u32, y: u32) -> Pixel<'_> {
        Pixel::new(self.projection, [x, y])
    }

    /// Indices of draws with classes: the instances of a blob that follow each other class by class.
    fn blob_by_blob<'c>(
        &self,
        classes: &'c [Class],
    ) -> impl Iterator<Item = (usize, Class)> + use<'_, 'c, 'a> {
        let mut begin = 0;
        self.draws.chunk_by(|a, b| a.blob == b.blob).flat_map(move |instances| {
            let indices = begin..begin + instances.len();
            begin = indices.end;
            classes.iter().flat_map(move |&class| indices.clone().map(move |draw| (draw, class)))
        })
    }

    /// Indices of draws with classes, one draw after the other.
    fn draw_by_draw<'c>(
        &self,
        classes: &'c [Class],
    ) -> impl Iterator<Item = (usize, Class)> + use<'c> {
        let draws = 0..self.draws.len();
        draws.flat_map(move |draw| classes.iter().map(move |&class| (draw, class)))
    }

    /// Hands every span to `span`, with `draw << 32 | triangle` and its class, until that breaks.
    fn rasterise(
        &self,
        order: impl Iterator<Item = (usize, Class)>,
        mut span: impl FnMut(u64, Class, Span) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let mut placed: Vec<Placed> = Vec::new();
        for (index, class) in order {
            let (draw, mesh) = (&self.draws[index], self.meshes[index]);
            let triangles = mesh.triangles_of(class);
            if triangles.is_empty() {
                continue;
            }
            let rows = self.projection.clip_from_grid(draw, mesh.patch.is_some());
            let clip = |vertex: usize| apply(&rows, mesh.grid(vertex));
            placed.clear();
            placed.extend((0..mesh.count()).map(|vertex| self.projection.place(clip(vertex))));
            let drawn = match (class.is_single_sided(), draw.is_mirrored()) {
                (false, _) => Turns::Either,
                (true, false) => Turns::CounterClockwise,
                (true, true) => Turns::Clockwise,
            };
            for number in triangles {
                let corners = mesh.triangles[number].map(usize::from);
                self.projection.triangle(
                    corners.map(|vertex| placed[vertex]),
                    drawn,
                    |k| clip(corners[k]),
                    |part| span((index as u64) << 32 | number as u64, class, part),
                )?;
            }
        }
        ControlFlow::Continue(())
    }
}

impl<'a> Latest<'a> {
    fn of(&mut self, owner: u64, painter: &Painter<'a>, placements: &[Placement]) -> &Surface<'a> {
        let surface = match self.0.take() {
            Some((same, surface)) if same == owner => surface,
            _ => {
                let draw = (owner >> 32) as usize;
                Surface::new(&placements[draw], painter.meshes[draw], owner as u32 as usize)
            }
        };
        &self.0.insert((owner, surface)).1
    }
}
