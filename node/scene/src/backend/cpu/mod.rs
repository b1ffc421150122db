//! A z-buffer rasteriser in plain scalar Rust: the oracle for visibility, and what runs where a machine
//! has no graphics driver.
//!
//! Passes are carried out as they are submitted, on one thread.

mod boxes;
mod mesh;
mod paint;
mod project;
mod raster;
mod shade;
mod target;
mod texture;

use super::{
    Backend, BackendError, BoxQuery, Completion, Draw, Pass, Picture, TextureUpload, Ticket, View,
};
use crate::occludee::Rules;
use mesh::Mesh;
use paint::Painter;
use project::Projection;
use protocol::format::Blob;
use protocol::id::BlobId;
use protocol::settings::PictureSize;
use protocol::telemetry::BackendInfo;
use shade::SrgbEncoder;
use std::collections::{HashMap, VecDeque};
use target::{Depth, TileMinima};
use texture::Textures;

/// The embedded renderer.
pub struct CpuBackend {
    size: PictureSize,
    inclusive: bool,
    meshes: HashMap<BlobId, Mesh>,
    /// The occlusion depth, once there is one.
    occlusion: Option<(Depth, TileMinima)>,
    textures: Textures,
    srgb: SrgbEncoder,
    next_ticket: u64,
    done: VecDeque<Completion>,
}

impl CpuBackend {
    /// A backend for pictures of one size.
    pub fn new(size: PictureSize) -> Self {
        Self::with_rules(size, &Rules::default())
    }

    /// One whose depth test may be spoilt, to show that tests see it.
    pub fn with_rules(size: PictureSize, rules: &Rules) -> Self {
        Self {
            size,
            inclusive: rules.depth_test_inclusive,
            meshes: HashMap::new(),
            occlusion: None,
            textures: Textures::new(),
            srgb: SrgbEncoder::new(),
            next_ticket: 0,
            done: VecDeque::new(),
        }
    }

    fn projection(&self, view: &View) -> Projection {
        assert_eq!(view.size, self.size, "a backend draws pictures of one size");
        Projection::new(view)
    }

    fn painter<'a>(&'a self, view: &View, draws: &'a [Draw]) -> Painter<'a> {
        let projection = self.projection(view);
        Painter::new(projection, draws, &self.meshes, &self.textures, self.inclusive)
    }

    fn query(&self, view: &View, boxes: &[BoxQuery]) -> Vec<bool> {
        let projection = self.projection(view);
        let Some((depth, tiles)) = &self.occlusion else {
            panic!("boxes are tested before any occluders");
        };
        boxes.iter().map(|query| boxes::is_visible(&projection, query, depth, tiles)).collect()
    }

    fn shade(&self, view: &View, draws: &[Draw], with_depth: bool) -> Picture {
        let (colors, depth) = self.painter(view, draws).picture();
        let rgba = colors.into_iter().flat_map(|linear| self.srgb.encode_rgba(linear)).collect();
        Picture { rgba, depth: with_depth.then(|| depth.into_pixels()) }
    }
}

impl Backend for CpuBackend {
    fn info(&self) -> BackendInfo {
        BackendInfo { name: "cpu".into(), driver: "embedded z-buffer rasteriser".into() }
    }

    fn upload_textures(&mut self, textures: &[TextureUpload<'_>]) -> Result<(), BackendError> {
        self.textures.set(textures)
    }

    fn upload(&mut self, id: BlobId, blob: &Blob, bytes: &[u8]) -> Result<(), BackendError> {
        self.meshes.insert(id, Mesh::read(id, blob, bytes)?);
        Ok(())
    }

    fn evict(&mut self, blob: BlobId) {
        self.meshes.remove(&blob);
    }

    fn submit(&mut self, pass: Pass) -> Result<Ticket, BackendError> {
        let ticket = Ticket(self.next_ticket);
        self.next_ticket += 1;
        let completion = match pass {
            Pass::Occluders { view, draws } => {
                let depth = self.painter(&view, &draws).occluders();
                let tiles = depth.tile_minima();
                self.occlusion = Some((depth, tiles));
                Completion::Occluders { ticket }
            }
            Pass::QueryBoxes { view, boxes, method: _ } => {
                let visible = self.query(&view, &boxes);
                Completion::Boxes { ticket, first: 0, visible, last: true }
            }
            Pass::Shade { view, draws, with_depth } => {
                let picture = self.shade(&view, &draws, with_depth);
                Completion::Picture { ticket, picture }
            }
            Pass::Items { view, draws } => {
                let (items, blended) = self.painter(&view, &draws).items();
                Completion::Items { ticket, items, blended }
            }
        };
        self.done.push_back(completion);
        Ok(ticket)
    }

    fn poll(&mut self, completions: &mut Vec<Completion>) -> Result<(), BackendError> {
        completions.extend(self.done.drain(..));
        Ok(())
    }
}

#[cfg(test)]
mod tests;
