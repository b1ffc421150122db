//! A z-buffer rasteriser in plain scalar Rust: the oracle for visibility, and what runs where a machine
//! has no graphics driver.
//!
//! Passes are carried out as they are submitted, on one thread.

mod boxes;
mod mesh;
mod project;
mod raster;
mod shade;
mod target;

use super::{
    Backend, BackendError, BoxQuery, Completion, Draw, NO_ITEM, Pass, Picture, Ticket, View, light,
};
use crate::occludee::Rules;
use mesh::Mesh;
use project::{Placed, Projection, apply};
use protocol::id::BlobId;
use protocol::settings::PictureSize;
use protocol::telemetry::BackendInfo;
use raster::Span;
use shade::{Placement, SrgbEncoder, Surface};
use std::collections::{HashMap, VecDeque};
use std::ops::ControlFlow;
use target::{Depth, TileMinima, pixel_count};

/// Stands where no triangle owns a pixel.
const NO_OWNER: u64 = u64::MAX;

/// The embedded renderer.
pub struct CpuBackend {
    size: PictureSize,
    inclusive: bool,
    meshes: HashMap<BlobId, Mesh>,
    /// The occlusion depth, once there is one.
    occlusion: Option<(Depth, TileMinima)>,
    /// Vertices of the mesh being drawn.
    placed: Vec<Placed>,
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
            placed: Vec::new(),
            srgb: SrgbEncoder::new(),
            next_ticket: 0,
            done: VecDeque::new(),
        }
    }

    fn projection(&self, view: &View) -> Projection {
        assert_eq!(view.size, self.size, "a backend draws pictures of one size");
        Projection::new(view)
    }

    /// The mesh of a draw.
    fn mesh(&self, blob: BlobId) -> &Mesh {
        self.meshes.get(&blob).unwrap_or_else(|| panic!("mesh {blob} is drawn but not uploaded"))
    }

    /// Hands every span of `draws` to `span`, with the indices of draw and triangle.
    fn rasterise(
        &mut self,
        projection: &Projection,
        draws: &[Draw],
        mut span: impl FnMut(usize, usize, Span),
    ) {
        let mut placed = std::mem::take(&mut self.placed);
        for (index, draw) in draws.iter().enumerate() {
            let mesh = self.mesh(draw.blob);
            let rows = projection.clip_from_grid(draw);
            let clip = |vertex: usize| apply(&rows, mesh.vertices[vertex].grid().map(f64::from));
            placed.clear();
            placed.extend((0..mesh.vertices.len()).map(|vertex| projection.place(clip(vertex))));
            for (number, triangle) in mesh.triangles.iter().enumerate() {
                let corners = triangle.map(usize::from);
                let _ = projection.triangle(
                    corners.map(|vertex| placed[vertex]),
                    |k| clip(corners[k]),
                    |part| {
                        span(index, number, part);
                        ControlFlow::Continue(())
                    },
                );
            }
        }
        self.placed = placed;
    }

    fn draw_occluders(&mut self, view: &View, draws: &[Draw]) {
        let projection = self.projection(view);
        let mut depth = Depth::new(self.size, self.inclusive);
        self.rasterise(&projection, draws, |_, _, span| depth.write(&span));
        let tiles = depth.tile_minima();
        self.occlusion = Some((depth, tiles));
    }

    fn query(&self, view: &View, boxes: &[BoxQuery]) -> Vec<bool> {
        let projection = self.projection(view);
        let Some((depth, tiles)) = &self.occlusion else {
            panic!("boxes are tested before any occluders");
        };
        boxes.iter().map(|query| boxes::is_visible(&projection, query, depth, tiles)).collect()
    }

    /// Depth, and for each pixel `draw << 32 | triangle` of its owner.
    fn draw_owners(&mut self, projection: &Projection, draws: &[Draw]) -> (Depth, Vec<u64>) {
        let mut depth = Depth::new(self.size, self.inclusive);
        let mut owners = vec![NO_OWNER; pixel_count(self.size)];
        self.rasterise(projection, draws, |draw, triangle, span| {
            depth.write_owned(&span, (draw as u64) << 32 | triangle as u64, &mut owners);
        });
        (depth, owners)
    }

    fn shade(&mut self, view: &View, draws: &[Draw], with_depth: bool) -> Picture {
        let projection = self.projection(view);
        let (depth, owners) = self.draw_owners(&projection, draws);
        let eye_from_clip = projection.eye_from_clip();
        let placements: Vec<Placement> =
            draws.iter().map(|draw| Placement::new(&projection, draw)).collect();
        let sky = self.srgb.encode_rgba(light::SKY);
        let mut rgba = Vec::with_capacity(owners.len() * 4);
        let mut latest: Option<(u64, Surface)> = None;
        for (row, y) in owners.chunks_exact(self.size.width as usize).zip(0..) {
            for (&owner, x) in row.iter().zip(0..) {
                if owner == NO_OWNER {
                    rgba.extend_from_slice(&sky);
                    continue;
                }
                let surface = match latest.take() {
                    Some((same, surface)) if same == owner => surface,
                    _ => {
                        let index = (owner >> 32) as usize;
                        Surface::new(&placements[index], self.mesh(draws[index].blob), owner as u32)
                    }
                };
                let center = projection.pixel_center(x, y);
                let [ndc_x, ndc_y] = center;
                let ray = eye_from_clip.map(|[a, b, c]| a * ndc_x + b * ndc_y + c);
                rgba.extend_from_slice(&self.srgb.encode_rgba(surface.color(center, ray)));
                latest = Some((owner, surface));
            }
        }
        Picture { rgba, depth: with_depth.then(|| depth.into_pixels()) }
    }

    fn items(&mut self, view: &View, draws: &[Draw]) -> Vec<u32> {
        let projection = self.projection(view);
        let (_, owners) = self.draw_owners(&projection, draws);
        let item = |owner: u64| match owner {
            NO_OWNER => NO_ITEM,
            owner => draws[(owner >> 32) as usize].item.0,
        };
        owners.into_iter().map(item).collect()
    }
}

impl Backend for CpuBackend {
    fn info(&self) -> BackendInfo {
        BackendInfo { name: "cpu".into(), driver: "embedded z-buffer rasteriser".into() }
    }

    fn upload(
        &mut self,
        blob: BlobId,
        vertices: u32,
        triangles: u32,
        bytes: &[u8],
    ) -> Result<(), BackendError> {
        self.meshes.insert(blob, Mesh::read(blob, vertices, triangles, bytes)?);
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
                self.draw_occluders(&view, &draws);
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
                Completion::Items { ticket, items: self.items(&view, &draws) }
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
