//! A triangle of each kind before the first frame: drivers compile at the first use, and a frame is not to wait
//! for that.

use super::{
    Backend, BackendError, BoxQuery, Completion, Draw, Draws, Part, Pass, Shading, Upload, View,
};
use bytemuck::{Zeroable, bytes_of};
use protocol::format::projected::{NewPatch, SUBPIXELS, TILE, TILE_BYTES};
use protocol::format::vertex::{Layout, TexturedVertex};
use protocol::format::{Blob, Class, NONE, Vertex};
use protocol::id::{BlobId, HlodId};
use protocol::settings::{Cull, PictureSize};
use std::collections::BTreeMap;

/// Grid units along the triangle's sides: a picture of one tile, for those that have one.
const SIDE: u32 = TILE * SUBPIXELS;
/// Its corners, counter-clockwise; the third coordinate is the disparity of those that have one.
const CORNERS: [[u32; 3]; 3] = [[0, 0, 1], [SIDE, 0, 1], [0, SIDE, 1]];

/// The near distance; the triangle lies at 1.
const NEAR: f32 = 0.25;

/// Draws and tests a triangle of each layout and class that `blobs` have, as a run will. Nothing of it stays, and
/// the occlusion depth is empty. For a backend on which no blob is; where not even a triangle has room, nothing is
/// done.
pub fn warm_up<'a>(
    backend: &mut dyn Backend,
    blobs: impl IntoIterator<Item = &'a Blob>,
    size: PictureSize,
    shading: Shading,
    cull: Cull,
) -> Result<(), BackendError> {
    let mut kinds = BTreeMap::<Layout, [u32; Class::COUNT]>::new();
    for blob in blobs {
        let kind = kinds.entry(blob.vertex_layout()).or_default();
        for (has, &triangles) in kind.iter_mut().zip(&blob.classes) {
            *has |= u32::from(triangles > 0);
        }
    }
    let mut draws = Draws::default();
    let mut room = Upload::Done;
    for ((layout, classes), id) in kinds.into_iter().zip((0..u32::MAX).rev()) {
        let (blob, bytes) = triangles(layout, classes);
        room = backend.upload(BlobId(id), &blob, &bytes)?;
        if room == Upload::Full {
            break;
        }
        let draw = before_the_eye(BlobId(id), layout);
        let blends = |class: &Class| class.is_blend() && classes[*class as usize] > 0;
        if Class::ALL.iter().any(blends) {
            draws.blending.push(draw);
        }
        draws.solid.push(draw);
    }
    if room == Upload::Done {
        draw_all(backend, &draws, size, shading, cull)?;
    }
    draws.solid.iter().for_each(|draw| backend.evict(draw.blob));
    Ok(())
}

fn draw_all(
    backend: &mut dyn Backend,
    draws: &Draws,
    size: PictureSize,
    shading: Shading,
    cull: Cull,
) -> Result<(), BackendError> {
    // From the origin along -z, 90 degrees both ways.
    let clip_from_eye =
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0], [0.0, 0.0, NEAR, 0.0]];
    let view = View { size, clip_from_eye };
    let occluders = |draws: &[Draw]| Pass::Occluders {
        view,
        draws: draws.to_vec(),
        adds: false,
        part: Part::WHOLE,
    };
    let (shown, part) = (draws.clone(), Part::WHOLE);
    let mut passes = vec![
        Pass::Shade { view, shading, draws: shown.clone(), with_depth: false, part },
        Pass::Items { view, draws: shown, part },
    ];
    if cull != Cull::Off {
        let boxes = vec![BoxQuery { min: [-0.5, -0.5, -1.5], max: [0.5, 0.5, -1.0] }];
        let meshes =
            draws.solid.iter().filter(|draw| draw.disparity_step == 0.0).copied().collect();
        passes.extend([
            occluders(&draws.solid),
            Pass::QueryBoxes { view, boxes, method: cull },
            Pass::QueryMeshes { view, draws: meshes },
            occluders(&[]),
        ]);
    }
    for pass in passes {
        backend.submit(pass)?;
        let mut completions = Vec::new();
        while !completions.last().is_some_and(is_last) {
            backend.poll(&mut completions)?;
        }
    }
    Ok(())
}

fn is_last(completion: &Completion) -> bool {
    !matches!(completion, Completion::Boxes { last: false, .. })
}

/// Half a unit to the left, right, up and down, one unit away.
fn before_the_eye(blob: BlobId, layout: Layout) -> Draw {
    let unit = 1.0 / SIDE as f32;
    Draw {
        blob,
        item: HlodId(blob.0),
        linear: [[unit, 0.0, 0.0], [0.0, unit, 0.0], [0.0; 3]],
        offset: [-0.5, -0.5, -1.0],
        distance: 1.0,
        disparity_step: if layout.is_projected() { 1.0 } else { 0.0 },
    }
}

/// As many triangles as said of each class, all alike.
fn triangles(layout: Layout, classes: [u32; Class::COUNT]) -> (Blob, Vec<u8>) {
    let corners = CORNERS.map(Vertex::pack_position);
    if layout.is_projected() {
        let tile = [[0; TILE_BYTES]];
        return NewPatch {
            step: 1.0,
            at: [0; 2],
            side: TILE,
            vertices: &corners,
            indices: &[0, 1, 2],
            table: &[1],
            tiles: &tile,
            normals: (layout == Layout::ProjectedNormals).then_some(&tile),
        }
        .encode();
    }
    let mut bytes = Vec::new();
    for position in corners {
        let plain = Vertex { position, normal: 0, color: !0 };
        match layout {
            Layout::Textured => {
                let textured = TexturedVertex { plain, texture: NONE, ..TexturedVertex::zeroed() };
                bytes.extend_from_slice(bytes_of(&textured));
            }
            _ => bytes.extend_from_slice(bytes_of(&plain)),
        }
    }
    let triangles = classes.iter().sum();
    for _ in 0..triangles {
        bytes.extend_from_slice(bytes_of(&[0u16, 1, 2]));
    }
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    let blob = Blob {
        vertices: corners.len() as u32,
        triangles,
        bytes: bytes.len() as u64,
        layout: layout as u32,
        classes,
        ..Blob::default()
    };
    (blob, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::cpu::CpuBackend;
    use crate::occludee::Precision;
    use protocol::format::Texture;
    use protocol::telemetry::BackendInfo;

    const SIZE: PictureSize = PictureSize { width: 32, height: 32 };

    /// A backend, what it was given, and what of that was drawn and tested.
    struct Seen {
        backend: CpuBackend,
        blobs: BTreeMap<BlobId, Blob>,
        there: usize,
        passes: Vec<Pass>,
        answers: Vec<Completion>,
    }

    impl Seen {
        fn new(budget: u64) -> Self {
            let backend = CpuBackend::new(SIZE).with_budget(budget);
            Self { backend, blobs: BTreeMap::new(), there: 0, passes: vec![], answers: vec![] }
        }

        fn warm_up(&mut self, blobs: &[Blob], cull: Cull) {
            warm_up(self, blobs, SIZE, Shading::default(), cull).unwrap();
        }
    }

    impl Backend for Seen {
        fn info(&self) -> BackendInfo {
            self.backend.info()
        }
        fn precision(&self) -> Precision {
            self.backend.precision()
        }
        fn held_bytes(&self) -> u64 {
            self.backend.held_bytes()
        }
        fn declare_textures(&mut self, t: &[Texture], room: u64) -> Result<Upload, BackendError> {
            self.backend.declare_textures(t, room)
        }
        fn upload_texture(&mut self, index: u32, bytes: &[u8]) -> Result<Upload, BackendError> {
            self.backend.upload_texture(index, bytes)
        }
        fn evict_texture(&mut self, index: u32) {
            self.backend.evict_texture(index);
        }
        fn settle(&mut self) -> Result<(), BackendError> {
            self.backend.settle()
        }
        fn upload(&mut self, id: BlobId, of: &Blob, b: &[u8]) -> Result<Upload, BackendError> {
            let upload = self.backend.upload(id, of, b)?;
            if upload == Upload::Done {
                self.blobs.insert(id, *of);
                self.there += 1;
            }
            Ok(upload)
        }
        fn evict(&mut self, blob: BlobId) {
            self.there -= 1;
            self.backend.evict(blob);
        }
        fn submit(&mut self, pass: Pass) -> Result<crate::backend::Ticket, BackendError> {
            self.passes.push(pass.clone());
            self.backend.submit(pass)
        }
        fn poll(&mut self, completions: &mut Vec<Completion>) -> Result<(), BackendError> {
            self.backend.poll(completions)?;
            self.answers.extend(completions.iter().cloned());
            Ok(())
        }
    }

    fn blob(layout: Layout, classes: [u32; Class::COUNT]) -> Blob {
        Blob { layout: layout as u32, classes, ..Blob::default() }
    }

    /// All layouts, and of meshes all classes, in several blobs.
    fn all_kinds() -> Vec<Blob> {
        let meshes = [Layout::Plain, Layout::Textured]
            .into_iter()
            .flat_map(|layout| Class::ALL.map(|class| blob(layout, class.all(7))));
        let faces = [Layout::Projected, Layout::ProjectedNormals]
            .map(|layout| blob(layout, Class::OpaqueDouble.all(9)));
        meshes.chain(faces).collect()
    }

    #[test]
    fn every_kind_is_drawn_and_tested_and_is_seen() {
        let mut seen = Seen::new(1 << 20);
        seen.warm_up(&all_kinds(), Cull::Queries);
        let ids: Vec<BlobId> = seen.blobs.keys().copied().collect();
        assert_eq!(ids.len(), 4, "one of each layout");
        for of in seen.blobs.values() {
            let expected = if of.is_projected() { Class::OpaqueDouble.all(1) } else { [1; 6] };
            assert_eq!(of.classes, expected);
        }
        let drawn = |draws: &[Draw]| draws.iter().map(|draw| draw.blob).collect::<Vec<_>>();
        let sorted = |mut ids: Vec<BlobId>| {
            ids.sort_unstable();
            ids
        };
        for pass in &seen.passes {
            match pass {
                Pass::Shade { draws, .. } | Pass::Items { draws, .. } => {
                    assert_eq!(sorted(drawn(&draws.solid)), ids);
                    assert_eq!(draws.blending.len(), 2, "meshes alone blend");
                }
                Pass::Occluders { draws, .. } if !draws.is_empty() => {
                    assert_eq!(sorted(drawn(draws)), ids);
                }
                Pass::QueryMeshes { draws, .. } => assert_eq!(draws.len(), 2),
                Pass::Occluders { .. } | Pass::QueryBoxes { .. } => {}
            }
        }
        assert_eq!(seen.passes.len(), 6);
        for answer in &seen.answers {
            match answer {
                Completion::Items { items, .. } => {
                    let hidden = items.iter().filter(|&&item| item == crate::backend::NO_ITEM);
                    assert!(hidden.count() < items.len() * 9 / 10, "it lies before the eye");
                }
                Completion::Boxes { visible, .. } => assert!(visible.iter().all(|&v| v)),
                _ => {}
            }
        }
    }

    #[test]
    fn nothing_of_it_stays() {
        for cull in [Cull::Queries, Cull::Off] {
            let mut seen = Seen::new(1 << 20);
            seen.warm_up(&all_kinds(), cull);
            assert_eq!((seen.there, seen.held_bytes()), (0, 0));
            let tested = seen.passes.iter().any(|pass| matches!(pass, Pass::QueryBoxes { .. }));
            assert_eq!(tested, cull != Cull::Off);
            if let Some(Pass::Occluders { draws, adds, .. }) = seen.passes.last() {
                assert!(draws.is_empty() && !adds, "the depth stays full");
            } else {
                assert_eq!(cull, Cull::Off);
            }
        }
    }

    #[test]
    fn without_room_or_blobs_nothing_is_drawn_and_nothing_stays() {
        for budget in [0, 200] {
            let mut seen = Seen::new(budget);
            seen.warm_up(&all_kinds(), Cull::Queries);
            assert_eq!((seen.there, seen.passes.len()), (0, 0));
        }
        let mut seen = Seen::new(1 << 20);
        seen.warm_up(&[], Cull::Queries);
        assert!(seen.blobs.is_empty());
    }
}
