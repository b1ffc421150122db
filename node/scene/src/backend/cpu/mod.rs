//! A z-buffer rasteriser in plain scalar Rust: the oracle for visibility, and what runs where a machine
//! has no graphics driver.
//!
//! Passes are carried out as they are submitted, on one thread.

mod boxes;
mod canvas;
mod mesh;
mod paint;
mod patch;
mod project;
mod raster;
mod relight;
mod shade;
mod target;
mod texture;

use super::{
    Backend, BackendError, BoxQuery, Completion, Draw, Part, Pass, Picture, Ticket, UNLIMITED,
    UnderWay, Upload, View, stored_bytes, stored_shape, texture_room,
};
use crate::occludee::{Precision, Rules};
use canvas::{Canvas, Layer};
use mesh::Mesh;
use paint::Painter;
use project::Projection;
use protocol::format::{Blob, Texture};
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
    /// Of all meshes.
    mesh_bytes: u64,
    /// Most bytes of meshes and textures.
    budget: u64,
    /// The occlusion depth, once there is one.
    occlusion: Option<(Depth, TileMinima)>,
    textures: Textures,
    srgb: SrgbEncoder,
    under_way: UnderWay,
    /// What the parts of the pass under way have drawn.
    canvas: Option<Canvas>,
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
            mesh_bytes: 0,
            budget: UNLIMITED,
            occlusion: None,
            textures: Textures::new(),
            srgb: SrgbEncoder::new(),
            under_way: UnderWay::default(),
            canvas: None,
            next_ticket: 0,
            done: VecDeque::new(),
        }
    }

    /// This one, whose meshes and textures take at most so many bytes ([`Backend::held_bytes`]). On top
    /// come what passes draw on and, for each draw of a part, some 300 bytes.
    pub fn with_budget(self, budget: u64) -> Self {
        Self { budget, ..self }
    }

    fn projection(&self, view: &View) -> Projection {
        assert_eq!(view.size, self.size, "a backend draws pictures of one size");
        Projection::new(view)
    }

    /// Draws a part of a pass. The canvas, once the pass is drawn to its end.
    fn draw(
        &mut self,
        pass: &Pass,
        view: &View,
        [solid, blending]: [&[Draw]; 2],
        part: Part,
    ) -> Option<Canvas> {
        let left = self.canvas.take().or_else(|| match pass {
            Pass::Occluders { adds: true, .. } => {
                let (depth, _) = self.occlusion.take().expect("occluders are added to others");
                Some(Canvas::onto(depth))
            }
            _ => None,
        });
        let mut canvas = left.unwrap_or_else(|| Canvas::new(pass, self.size, self.inclusive));
        let projection = self.projection(view);
        let painter = |draws| Painter::new(&projection, draws, &self.meshes, &self.textures);
        canvas.draw(&painter(solid), &painter(blending));
        if part.closes {
            return Some(canvas);
        }
        self.canvas = Some(canvas);
        None
    }

    /// What comes of a pass that was drawn to its end.
    fn answer(
        &mut self,
        ticket: Ticket,
        Canvas { depth, layer }: Canvas,
        with_depth: bool,
    ) -> Completion {
        let picture = |rgba, depth: Depth| {
            let depth = with_depth.then(|| depth.into_pixels());
            Completion::Picture { ticket, picture: Picture { rgba, depth } }
        };
        match layer {
            Layer::Bare => {
                let tiles = depth.tile_minima();
                self.occlusion = Some((depth, tiles));
                Completion::Occluders { ticket }
            }
            Layer::Colors { colors, sunlight: _ } => {
                let rgba =
                    colors.into_iter().flat_map(|linear| self.srgb.encode_rgba(linear)).collect();
                picture(rgba, depth)
            }
            Layer::Normals(normals) => picture(
                normals.into_iter().flat_map(|[x, y, z]| [x, y, z, u8::MAX]).collect(),
                depth,
            ),
            Layer::Items { items, blended } => Completion::Items { ticket, items, blended },
        }
    }

    fn occlusion(&self) -> &(Depth, TileMinima) {
        self.occlusion.as_ref().expect("something is tested before any occluders")
    }

    fn query_meshes(&self, view: &View, draws: &[Draw]) -> Vec<bool> {
        let projection = self.projection(view);
        let (depth, tiles) = self.occlusion();
        let items = draws.chunk_by(|a, b| a.item == b.item);
        items
            .map(|draws| {
                let painter = Painter::new(&projection, draws, &self.meshes, &self.textures);
                painter.any_passes(depth, tiles)
            })
            .collect()
    }

    fn query_boxes(&self, view: &View, boxes: &[BoxQuery]) -> Vec<bool> {
        let projection = self.projection(view);
        let (depth, tiles) = self.occlusion();
        boxes.iter().map(|query| boxes::is_visible(&projection, query, depth, tiles)).collect()
    }
}

impl Backend for CpuBackend {
    fn info(&self) -> BackendInfo {
        BackendInfo { name: "cpu".into(), driver: "embedded z-buffer rasteriser".into() }
    }

    fn precision(&self) -> Precision {
        Precision::f64(project::guard_band(self.size))
    }

    fn held_bytes(&self) -> u64 {
        self.mesh_bytes + self.textures.held_bytes()
    }

    fn declare_textures(
        &mut self,
        textures: &[Texture],
        room: u64,
    ) -> Result<Upload, BackendError> {
        textures.iter().try_for_each(|texture| stored_shape(texture).map(drop))?;
        let all = texture_room(textures, textures.iter().map(stored_bytes).sum());
        let room = room.min(all);
        if self.mesh_bytes.saturating_add(room) > self.budget {
            return Ok(Upload::Full);
        }
        self.textures.declare(textures, room);
        Ok(Upload::Done)
    }

    fn upload_texture(&mut self, index: u32, bytes: &[u8]) -> Result<Upload, BackendError> {
        self.textures.upload(index, bytes)
    }

    fn evict_texture(&mut self, index: u32) {
        self.textures.evict(index);
    }

    fn settle(&mut self) -> Result<(), BackendError> {
        // What was uploaded was copied.
        Ok(())
    }

    fn upload(&mut self, id: BlobId, blob: &Blob, bytes: &[u8]) -> Result<Upload, BackendError> {
        let needed = mesh::bytes_of(id, blob, bytes)?;
        let taken = self.mesh_bytes.saturating_add(self.textures.room());
        if taken.saturating_add(needed) > self.budget {
            return Ok(Upload::Full);
        }
        let mesh = Mesh::read(id, blob, bytes)?;
        self.evict(id);
        self.mesh_bytes += mesh.held_bytes();
        self.meshes.insert(id, mesh);
        Ok(Upload::Done)
    }

    fn evict(&mut self, blob: BlobId) {
        if let Some(mesh) = self.meshes.remove(&blob) {
            self.mesh_bytes -= mesh.held_bytes();
        }
    }

    fn submit(&mut self, pass: Pass) -> Result<Ticket, BackendError> {
        let ticket = Ticket(self.next_ticket);
        self.next_ticket += 1;
        self.under_way.take(&pass);
        let (view, lists, part, with_depth) = match &pass {
            Pass::QueryBoxes { view, boxes, method: _ } => {
                let visible = self.query_boxes(view, boxes);
                self.done.push_back(Completion::Boxes { ticket, first: 0, visible, last: true });
                return Ok(ticket);
            }
            Pass::QueryMeshes { view, draws } => {
                let visible = self.query_meshes(view, draws);
                self.done.push_back(Completion::Boxes { ticket, first: 0, visible, last: true });
                return Ok(ticket);
            }
            Pass::Occluders { view, draws, part, .. } => (view, [&draws[..], &[]], *part, false),
            Pass::Shade { view, draws, with_depth, part, .. } => {
                (view, [&draws.solid[..], &draws.blending], *part, *with_depth)
            }
            Pass::Items { view, draws, part } => {
                (view, [&draws.solid[..], &draws.blending], *part, false)
            }
        };
        if let Some(canvas) = self.draw(&pass, view, lists, part) {
            let completion = self.answer(ticket, canvas, with_depth);
            self.done.push_back(completion);
        }
        Ok(ticket)
    }

    fn poll(&mut self, completions: &mut Vec<Completion>) -> Result<(), BackendError> {
        completions.extend(self.done.drain(..));
        Ok(())
    }
}

#[cfg(test)]
mod tests;
