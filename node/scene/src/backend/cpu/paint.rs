//! One pass over a list of draws: which triangle owns each pixel, its colour, and what blends over it.

use super::mesh::Mesh;
use super::project::{Placed, Projection, apply};
use super::raster::{Span, Turns};
use super::shade::{Pixel, Placement, Surface};
use super::target::{Depth, pixel_count};
use super::texture::Textures;
use crate::backend::{Draw, NO_ITEM, far_to_near, light};
use protocol::format::Class;
use protocol::id::BlobId;
use std::collections::HashMap;
use std::ops::ControlFlow;

/// Stands where no triangle owns a pixel.
const NO_OWNER: u64 = u64::MAX;

const OPAQUE: [Class; 2] = [Class::OpaqueSingle, Class::OpaqueDouble];
const MASK: [Class; 2] = [Class::MaskSingle, Class::MaskDouble];
const BLEND: [Class; 2] = [Class::BlendSingle, Class::BlendDouble];

/// Draws with all they need.
pub(super) struct Painter<'a> {
    projection: Projection,
    draws: &'a [Draw],
    meshes: Vec<&'a Mesh>,
    textures: &'a Textures,
    /// Equal depths pass.
    inclusive: bool,
}

/// A triangle of a draw: `draw << 32 | triangle`, and itself, made when it is first asked for.
struct Latest(Option<(u64, Surface)>);

impl<'a> Painter<'a> {
    pub(super) fn new(
        projection: Projection,
        draws: &'a [Draw],
        meshes: &'a HashMap<BlobId, Mesh>,
        textures: &'a Textures,
        inclusive: bool,
    ) -> Self {
        let mesh = |draw: &Draw| {
            let found = meshes.get(&draw.blob);
            found.unwrap_or_else(|| panic!("mesh {} is drawn but not uploaded", draw.blob))
        };
        let meshes = draws.iter().map(mesh).collect();
        Self { projection, draws, meshes, textures, inclusive }
    }

    /// The depth of what is opaque.
    pub(super) fn occluders(&self) -> Depth {
        let mut depth = Depth::new(self.projection.size, self.inclusive);
        self.rasterise(self.class_by_class(OPAQUE), |_, span| depth.write(&span));
        depth
    }

    /// Linear colours and depth.
    pub(super) fn picture(&self) -> (Vec<[f32; 3]>, Depth) {
        let (depth, owners) = self.owners();
        let placements = self.placements();
        let eye_from_clip = self.projection.eye_from_clip();
        let mut latest = Latest(None);
        let mut color = |owner: u64, x: u32, y: u32| {
            let pixel = self.pixel(x, y);
            let [ndc_x, ndc_y] = pixel.center;
            let ray = eye_from_clip.map(|[a, b, c]| a * ndc_x + b * ndc_y + c);
            latest.of(owner, self, &placements).color(self.textures, pixel, ray)
        };
        let width = self.projection.size.width as usize;
        let mut colors = Vec::with_capacity(owners.len());
        for (row, y) in owners.chunks_exact(width).zip(0..) {
            for (&owner, x) in row.iter().zip(0..) {
                colors.push(match owner {
                    NO_OWNER => light::SKY,
                    _ => {
                        let [r, g, b, _] = color(owner, x, y);
                        [r, g, b]
                    }
                });
            }
        }
        self.rasterise(self.blended(), |owner, span| {
            depth.visit_passing(&span, |at, x| {
                let [r, g, b, alpha] = color(owner, x, span.y);
                for (under, over) in colors[at].iter_mut().zip([r, g, b]) {
                    *under += (over - *under) * alpha;
                }
            });
        });
        (colors, depth)
    }

    /// Items that do not blend, and those that do.
    pub(super) fn items(&self) -> (Vec<u32>, Vec<u32>) {
        let (depth, owners) = self.owners();
        let item = |owner: u64| self.draws[(owner >> 32) as usize].item.0;
        let mut blended = vec![NO_ITEM; owners.len()];
        self.rasterise(self.blended(), |owner, span| {
            depth.visit_passing(&span, |at, _| blended[at] = item(owner));
        });
        let items = owners.into_iter().map(|o| if o == NO_OWNER { NO_ITEM } else { item(o) });
        (items.collect(), blended)
    }

    /// Depth, and for each pixel `draw << 32 | triangle` of its owner, which does not blend.
    fn owners(&self) -> (Depth, Vec<u64>) {
        let size = self.projection.size;
        let mut depth = Depth::new(size, self.inclusive);
        let mut owners = vec![NO_OWNER; pixel_count(size)];
        self.rasterise(self.class_by_class(OPAQUE), |owner, span| {
            depth.write_owned(&span, owner, &mut owners);
        });
        let placements = self.placements();
        let mut latest = Latest(None);
        self.rasterise(self.class_by_class(MASK), |owner, span| {
            let surface = latest.of(owner, self, &placements);
            depth.write_owned_where(&span, owner, &mut owners, |x| {
                surface.is_there(self.textures, self.pixel(x, span.y))
            });
        });
        (depth, owners)
    }

    fn placements(&self) -> Vec<Placement> {
        self.draws.iter().map(|draw| Placement::new(&self.projection, draw)).collect()
    }

    fn pixel(&self, x: u32, y: u32) -> Pixel {
        let center = |x, y| self.projection.pixel_center(x, y);
        let [left, upper] = center(x & !1, y & !1);
        let [right, lower] = center(x | 1, y | 1);
        Pixel { center: center(x, y), block: [[left, right], [upper, lower]] }
    }

    /// Indices of draws with classes: all of one class before any of the next, so that the order of what
    /// is left of a list does not depend on what is left out.
    fn class_by_class(&self, classes: [Class; 2]) -> impl Iterator<Item = (usize, Class)> + use<> {
        let count = self.draws.len();
        classes.into_iter().flat_map(move |class| (0..count).map(move |draw| (draw, class)))
    }

    /// The same for what blends.
    fn blended(&self) -> impl Iterator<Item = (usize, Class)> + use<> {
        let blends: Vec<bool> = self.meshes.iter().map(|mesh| mesh.blends()).collect();
        let order = far_to_near(self.draws, |index| blends[index]);
        order.into_iter().flat_map(|draw| BLEND.map(|class| (draw, class)))
    }

    /// Hands every span to `span`, with `draw << 32 | triangle`.
    fn rasterise(
        &self,
        order: impl Iterator<Item = (usize, Class)>,
        mut span: impl FnMut(u64, Span),
    ) {
        let mut placed: Vec<Placed> = Vec::new();
        for (index, class) in order {
            let (draw, mesh) = (&self.draws[index], self.meshes[index]);
            let triangles = mesh.triangles_of(class);
            if triangles.is_empty() {
                continue;
            }
            let rows = self.projection.clip_from_grid(draw);
            let clip = |vertex: usize| apply(&rows, mesh.vertices[vertex].grid().map(f64::from));
            placed.clear();
            placed
                .extend((0..mesh.vertices.len()).map(|vertex| self.projection.place(clip(vertex))));
            let drawn = match (class.is_single_sided(), draw.is_mirrored()) {
                (false, _) => Turns::Either,
                (true, false) => Turns::CounterClockwise,
                (true, true) => Turns::Clockwise,
            };
            for number in triangles {
                let corners = mesh.triangles[number].map(usize::from);
                let _ = self.projection.triangle(
                    corners.map(|vertex| placed[vertex]),
                    drawn,
                    |k| clip(corners[k]),
                    |part| {
                        span((index as u64) << 32 | number as u64, part);
                        ControlFlow::Continue(())
                    },
                );
            }
        }
    }
}

impl Latest {
    fn of(&mut self, owner: u64, painter: &Painter<'_>, placements: &[Placement]) -> &Surface {
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
