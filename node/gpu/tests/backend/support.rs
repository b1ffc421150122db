//! A camera, a few meshes, and a way to run one pass.

use gpu::{Adapter, WgpuBackend};
use protocol::format::{Blob, Class, Vertex};
use protocol::id::{BlobId, HlodId};
use protocol::settings::{Cull, PictureSize};
use rand::Rng;
use rand::rngs::StdRng;
use scene::backend::{
    Backend, BackendError, BoxQuery, Completion, Draw, Draws, Part, Pass, Picture, Shading,
    UNLIMITED, Upload, View,
};
use scene::occludee::Rules;

pub(crate) const NEAR: f32 = 0.125;

/// A mesh before it is a blob.
pub(crate) struct Mesh {
    pub(crate) vertices: Vec<Vertex>,
    pub(crate) indices: Vec<u16>,
}

impl Mesh {
    /// The blob's bytes: vertices, indices, padding.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        let mut bytes = bytemuck::cast_slice(&self.vertices).to_vec();
        bytes.extend_from_slice(bytemuck::cast_slice(&self.indices));
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes
    }

    pub(crate) fn upload(&self, backend: &mut impl Backend, blob: u32) {
        let triangles = self.indices.len() as u32 / 3;
        let record = plain_blob(self.vertices.len() as u32, triangles);
        let upload = backend.upload(BlobId(blob), &record, &self.bytes()).expect("a sound blob");
        assert_eq!(upload, Upload::Done);
    }

    /// Corners at 0 and 1; outward faces, one normal for all.
    pub(crate) fn cube(color: u32) -> Self {
        let corner = |i: u32| [i & 1, i >> 1 & 1, i >> 2];
        let vertices = (0..8).map(|i| vertex(corner(i), [0.0, 0.0, 1.0], color)).collect();
        let indices = [
            [0, 2, 1],
            [1, 2, 3],
            [4, 5, 6],
            [5, 7, 6],
            [0, 1, 4],
            [1, 5, 4],
            [2, 6, 3],
            [3, 6, 7],
            [0, 4, 2],
            [2, 4, 6],
            [1, 3, 5],
            [3, 7, 5],
        ];
        Self { vertices, indices: indices.concat() }
    }

    /// The unit square at z = 0.
    pub(crate) fn square(normal: [f32; 3], color: u32) -> Self {
        let corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]];
        let vertices = corners.map(|c| vertex(c, normal, color)).to_vec();
        Self { vertices, indices: vec![0, 1, 2, 1, 3, 2] }
    }

    /// Triangles anywhere in a cube of 2^20 grid steps.
    pub(crate) fn soup(random: &mut StdRng, triangles: usize) -> Self {
        let mut vertices = Vec::new();
        for _ in 0..triangles {
            let middle: [u32; 3] = std::array::from_fn(|_| random.random_range(0..1 << 20));
            for _ in 0..3 {
                let grid = middle.map(|c| c + random.random_range(0..1 << 17));
                let normal = std::array::from_fn(|_| random.random_range(-1.0..1.0f32));
                vertices.push(vertex(grid, normal, random.random()));
            }
        }
        let indices = (0..vertices.len() as u16).collect();
        Self { vertices, indices }
    }
}

/// The record of a plain, opaque, double-sided mesh.
pub(crate) fn plain_blob(vertices: u32, triangles: u32) -> Blob {
    Blob { vertices, triangles, classes: Class::OpaqueDouble.all(triangles), ..Blob::default() }
}

pub(crate) fn vertex(grid: [u32; 3], normal: [f32; 3], color: u32) -> Vertex {
    let (position, normal) = (Vertex::pack_position(grid), Vertex::pack_normal(normal));
    Vertex { position, normal, color }
}

/// A backend, or none where tests are to skip.
pub(crate) fn backend(width: u32, height: u32) -> Option<WgpuBackend> {
    backend_with(width, height, &Rules::default())
}

/// One that holds at most `budget` bytes.
pub(crate) fn backend_within(width: u32, height: u32, budget: u64) -> Option<WgpuBackend> {
    opened(width, height, &Rules::default(), budget)
}

pub(crate) fn backend_with(width: u32, height: u32, rules: &Rules) -> Option<WgpuBackend> {
    opened(width, height, rules, UNLIMITED)
}

fn opened(width: u32, height: u32, rules: &Rules, budget: u64) -> Option<WgpuBackend> {
    let wish = std::env::var("GPU_TESTS").unwrap_or_else(|_| "auto".into());
    if wish == "off" {
        return None;
    }
    match WgpuBackend::new(PictureSize { width, height }, Adapter::Any, rules, budget) {
        Ok(backend) => Some(backend),
        Err(BackendError::NoAdapter(why)) if wish != "require" => {
            eprintln!("skipped: no graphics adapter: {why}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// From the origin along -z, 90 degrees high.
pub(crate) fn view(width: u32, height: u32) -> View {
    let mut clip_from_eye = [[0.0; 4]; 4];
    clip_from_eye[0][0] = height as f32 / width as f32;
    clip_from_eye[1][1] = 1.0;
    clip_from_eye[2][3] = -1.0;
    clip_from_eye[3][2] = NEAR;
    View { size: PictureSize { width, height }, clip_from_eye }
}

pub(crate) fn draw(blob: u32, item: u32, scale: [f32; 3], offset: [f32; 3]) -> Draw {
    let linear = [[scale[0], 0.0, 0.0], [0.0, scale[1], 0.0], [0.0, 0.0, scale[2]]];
    let distance = offset.map(|c| c * c).iter().sum::<f32>().sqrt();
    Draw { blob: BlobId(blob), item: HlodId(item), linear, offset, distance, disparity_step: 0.0 }
}

/// A box in front of the camera on a grid of 1/64, so that its corners as a scaled cube are exact.
pub(crate) fn random_box(random: &mut StdRng, depth: std::ops::Range<i32>, size: i32) -> BoxQuery {
    let z = -random.random_range(depth);
    let least = [random.random_range(z..-z), random.random_range(z..-z), z - size];
    let extent: [i32; 3] = std::array::from_fn(|_| random.random_range(1..=size));
    let scaled = |v: i32| v as f32 / 64.0;
    BoxQuery { min: least.map(scaled), max: std::array::from_fn(|k| scaled(least[k] + extent[k])) }
}

/// The unit cube of blob `blob` over a box of [`random_box`].
pub(crate) fn cube_over(blob: u32, item: u32, b: &BoxQuery) -> Draw {
    draw(blob, item, std::array::from_fn(|k| b.max[k] - b.min[k]), b.min)
}

/// Everything that comes of one pass.
pub(crate) fn run(backend: &mut impl Backend, pass: Pass) -> Vec<Completion> {
    backend.submit(pass).expect("a sound pass");
    let mut completions = Vec::new();
    loop {
        backend.poll(&mut completions).expect("a working device");
        match completions.last().expect("something came") {
            Completion::Boxes { last: false, .. } => {}
            _ => return completions,
        }
    }
}

/// All of them in both lists, of which a backend draws what belongs there: in the order given, and far
/// to near.
pub(crate) fn lists(draws: &[Draw]) -> Draws {
    let mut blending = draws.to_vec();
    blending.sort_by(|a, b| b.distance.total_cmp(&a.distance));
    Draws { solid: draws.to_vec(), blending }
}

pub(crate) fn occluders(backend: &mut impl Backend, view: View, draws: &[Draw]) {
    run(backend, Pass::Occluders { view, draws: draws.to_vec(), adds: false, part: Part::WHOLE });
}

pub(crate) fn visible(
    backend: &mut impl Backend,
    view: View,
    boxes: &[BoxQuery],
    method: Cull,
) -> Vec<bool> {
    let mut answers = Vec::new();
    for completion in run(backend, Pass::QueryBoxes { view, boxes: boxes.to_vec(), method }) {
        let Completion::Boxes { first, visible, .. } = completion else { panic!("boxes expected") };
        assert_eq!(first, answers.len(), "parts come in order");
        answers.extend(visible);
    }
    answers
}

pub(crate) fn items(backend: &mut impl Backend, view: View, draws: &[Draw]) -> Vec<u32> {
    match run(backend, Pass::Items { view, draws: lists(draws), part: Part::WHOLE }).pop() {
        Some(Completion::Items { items, .. }) => items,
        other => panic!("items expected, not {other:?}"),
    }
}

pub(crate) fn shade(backend: &mut impl Backend, view: View, draws: &[Draw]) -> Picture {
    picture(backend, view, Shading::default(), draws)
}

pub(crate) fn picture(
    backend: &mut impl Backend,
    view: View,
    shading: Shading,
    draws: &[Draw],
) -> Picture {
    let (draws, part) = (lists(draws), Part::WHOLE);
    match run(backend, Pass::Shade { view, shading, draws, with_depth: true, part }).pop() {
        Some(Completion::Picture { picture, .. }) => picture,
        other => panic!("a picture expected, not {other:?}"),
    }
}

/// A part of a picture under the default sun, and its depth.
pub(crate) fn lit_with_depth(view: View, draws: Draws, part: Part) -> Pass {
    Pass::Shade { view, shading: Shading::default(), draws, with_depth: true, part }
}
