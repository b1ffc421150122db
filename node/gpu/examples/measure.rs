//! Rates of the first adapter, by hand: `cargo run --release -p gpu --example measure [SIDE]`.

use gpu::{Adapter, WgpuBackend, adapters};
use protocol::format::{Blob, Class, Vertex};
use protocol::id::{BlobId, HlodId};
use protocol::settings::{Cull, PictureSize};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use scene::backend::{
    Backend, BackendError, BoxQuery, Completion, Draw, Draws, Part, Pass, Shading, UNLIMITED,
    Upload, View,
};
use scene::occludee::Rules;
use std::time::Instant;

const ROUNDS: usize = 7;
const MESHES: u32 = 32;
/// Cells of a mesh across and down: 20,000 triangles a mesh.
const CELLS: u32 = 100;
const BOXES: usize = 20_000;

fn main() -> Result<(), BackendError> {
    let side = std::env::args().nth(1).and_then(|side| side.parse().ok()).unwrap_or(512);
    let size = PictureSize { width: side, height: side };
    println!("{:#?}", adapters());
    let start = Instant::now();
    let mut backend = WgpuBackend::new(size, Adapter::Any, &Rules::default(), UNLIMITED)?;
    println!("{}: started in {:?}", backend.info().driver, start.elapsed());

    let bytes = sheet();
    let (vertices, triangles) = ((CELLS + 1) * (CELLS + 1), 2 * CELLS * CELLS);
    let start = Instant::now();
    for blob in 0..MESHES {
        let classes = Class::OpaqueDouble.all(triangles);
        let record = Blob { vertices, triangles, classes, ..Blob::default() };
        assert_eq!(backend.upload(BlobId(blob), &record, &bytes)?, Upload::Done);
    }
    println!("upload: {:.0} MB/s", bytes.len() as f64 * 32e-6 / start.elapsed().as_secs_f64());

    let clip_from_eye =
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0], [0.0, 0.0, 0.1, 0.0]];
    let view = View { size, clip_from_eye };
    let mut random = StdRng::seed_from_u64(1);
    let draws = |random: &mut StdRng| -> Vec<Draw> {
        (0..MESHES).map(|blob| small_sheet(random, blob)).collect()
    };
    let draws = draws(&mut random);
    let total = f64::from(MESHES * triangles);
    let part = Part::WHOLE;
    let occluders = Pass::Occluders { view, draws: draws.clone(), adds: false, part };
    let draws = Draws { solid: draws, blending: Vec::new() };
    let shade = Pass::Shade {
        view,
        shading: Shading::default(),
        draws: draws.clone(),
        with_depth: false,
        part,
    };
    let items = Pass::Items { view, draws, part };
    for (name, pass) in [("occluders", &occluders), ("shade", &shade), ("items", &items)] {
        let seconds = median(&mut backend, pass)?;
        let rate = total / seconds * 1e-6;
        println!("{name}: {:.1} ms for {total} triangles, {rate:.1} Mtri/s", seconds * 1e3);
    }
    let nothing = Pass::Shade {
        view,
        shading: Shading::default(),
        draws: Draws::default(),
        with_depth: false,
        part,
    };
    println!("empty picture: {:.2} ms", median(&mut backend, &nothing)? * 1e3);

    median(&mut backend, &occluders)?;
    let boxes: Vec<BoxQuery> = (0..BOXES).map(|_| small_box(&mut random)).collect();
    for method in [Cull::Queries, Cull::Boxes] {
        let pass = Pass::QueryBoxes { view, boxes: boxes.clone(), method };
        let seconds = median(&mut backend, &pass)?;
        let rate = BOXES as f64 / seconds * 1e-3;
        println!("{method:?}: {:.1} ms for {BOXES} boxes, {rate:.0} thousand/s", seconds * 1e3);
    }
    Ok(())
}

/// Median seconds from submission to the last completion.
fn median(backend: &mut WgpuBackend, pass: &Pass) -> Result<f64, BackendError> {
    let mut seconds = Vec::new();
    for _ in 0..ROUNDS {
        let start = Instant::now();
        backend.submit(pass.clone())?;
        let mut completions = Vec::new();
        loop {
            backend.poll(&mut completions)?;
            if !matches!(completions.last(), Some(Completion::Boxes { last: false, .. })) {
                break;
            }
        }
        seconds.push(start.elapsed().as_secs_f64());
    }
    seconds.sort_by(f64::total_cmp);
    Ok(seconds[ROUNDS / 2])
}

/// A wavy square of [`CELLS`] by [`CELLS`] cells, as blob bytes.
fn sheet() -> Vec<u8> {
    let mut vertices = Vec::new();
    let mut indices: Vec<u16> = Vec::new();
    for y in 0..=CELLS {
        for x in 0..=CELLS {
            let position = Vertex::pack_position([x, y, (x * 7 + y * 3) % 5]);
            let normal = Vertex::pack_normal([0.1, 0.2, 0.97]);
            vertices.push(Vertex { position, normal, color: 0xff60_a0d0 });
            if x < CELLS && y < CELLS {
                let a = (y * (CELLS + 1) + x) as u16;
                let b = a + CELLS as u16 + 1;
                indices.extend([a, a + 1, b, b, a + 1, b + 1]);
            }
        }
    }
    let mut bytes = bytemuck::cast_slice(&vertices).to_vec();
    bytes.extend_from_slice(bytemuck::cast_slice(&indices));
    bytes
}

/// A sheet over a tenth of the picture, somewhere in it.
fn small_sheet(random: &mut StdRng, blob: u32) -> Draw {
    let distance = random.random_range(4.0..20.0f32);
    let step = 0.65 * distance / CELLS as f32;
    let mut along = || random.random_range(-1.0..0.35f32) * distance;
    Draw {
        blob: BlobId(blob),
        item: HlodId(blob),
        linear: [[step, 0.0, 0.0], [0.0, step, 0.0], [0.0, 0.0, step]],
        offset: [along(), along(), -distance],
        distance,
        disparity_step: 0.0,
    }
}

fn small_box(random: &mut StdRng) -> BoxQuery {
    let distance = random.random_range(3.0..40.0f32);
    let mut along = || random.random_range(-1.0..1.0f32) * distance;
    let min = [along(), along(), -distance - 1.0];
    BoxQuery { min, max: min.map(|c| c + 0.02 * distance) }
}
