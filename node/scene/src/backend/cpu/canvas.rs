//! What a pass is drawn on, kept from one of its parts to the next.

use super::paint::Painter;
use super::relight::Sunlight;
use super::target::{Depth, pixel_count};
use crate::backend::{NO_ITEM, Pass, Shading, light, normal};
use protocol::settings::PictureSize;

/// Depth, and what goes with it.
pub(super) struct Canvas {
    pub(super) depth: Depth,
    pub(super) layer: Layer,
}

/// What a pass draws beside depth.
pub(super) enum Layer {
    /// Nothing.
    Bare,
    /// Linear colours under a sun.
    Colors { colors: Vec<[f32; 3]>, sunlight: Sunlight },
    /// Codes of normals.
    Normals(Vec<[u8; 3]>),
    /// Items of what is solid, and of what blends.
    Items { items: Vec<u32>, blended: Vec<u32> },
}

impl Canvas {
    /// An empty one for `pass`.
    pub(super) fn new(pass: &Pass, size: PictureSize, inclusive: bool) -> Self {
        let pixels = pixel_count(size);
        let layer = match pass {
            Pass::Occluders { .. } | Pass::QueryBoxes { .. } | Pass::QueryMeshes { .. } => {
                Layer::Bare
            }
            Pass::Shade { shading: Shading::Lit { sun }, .. } => {
                Layer::Colors { colors: vec![light::SKY; pixels], sunlight: Sunlight::new(*sun) }
            }
            Pass::Shade { shading: Shading::Normals, .. } => {
                Layer::Normals(vec![normal::encode([0.0; 3]); pixels])
            }
            Pass::Items { .. } => {
                Layer::Items { items: vec![NO_ITEM; pixels], blended: vec![NO_ITEM; pixels] }
            }
        };
        Self { depth: Depth::new(size, inclusive), layer }
    }

    /// One that goes on with a depth.
    pub(super) fn onto(depth: Depth) -> Self {
        Self { depth, layer: Layer::Bare }
    }

    /// Draws what is solid of one list and then what blends of another; of what is solid, a bare one
    /// takes what is opaque.
    pub(super) fn draw(&mut self, solid: &Painter<'_>, blending: &Painter<'_>) {
        let Self { depth, layer } = self;
        match layer {
            Layer::Bare => solid.occlude(depth),
            Layer::Colors { colors, sunlight } => {
                solid.paint(depth, colors, *sunlight);
                blending.blend(depth, colors, *sunlight);
            }
            Layer::Normals(normals) => solid.paint_normals(depth, normals),
            Layer::Items { items, blended } => {
                solid.mark(depth, items);
                blending.mark_blending(depth, blended);
            }
        }
    }
}
