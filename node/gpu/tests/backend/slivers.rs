//! Triangles seen edge-on, thinner than the raster that corners are snapped to: none may come out in front
//! of its hlod's box.

use crate::support::{
    Mesh, NEAR, backend_with, draw, items, occluders, plain_blob, vertex, visible,
};
use protocol::camera::Camera;
use protocol::format::{Hlod, Vertex};
use protocol::id::BlobId;
use protocol::settings::{Cull, PictureSize};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use scene::backend::{Backend, Draw, NO_ITEM, Upload, View};
use scene::occludee::{BoxTest, BoxTests, Rules};

const SIZE: PictureSize = PictureSize { width: 96, height: 64 };
/// Hlods of a picture; the wall has the number behind the last.
const HLODS: u32 = 64;
/// Triangles of an hlod.
const TRIANGLES: usize = 12;
/// Grid steps to a scene unit.
const STEPS: f64 = 65536.0;
/// View depth of the nearest corners.
const DEPTH: f64 = 4.0;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    /// One side at [`DEPTH`], the corner beside it far behind: a plane that almost holds the eye.
    Steep,
    /// Corners in one line, a part of a pixel apart: the area is lost in rounding.
    Dust,
    /// Long and thin, and leading away.
    Needle,
}

/// The corners of a triangle near the middle of a pixel, relative to the eye.
fn corners(kind: Kind, random: &mut StdRng) -> [[f64; 3]; 3] {
    let pixel = 2.0 / f64::from(SIZE.height);
    let mut at = |limit: u32| f64::from(random.random_range(8..limit - 8)) + 0.5;
    let center = [at(SIZE.width), at(SIZE.height)];
    let angle = random.random_range(0.0..std::f64::consts::TAU);
    let (along, across) = ([angle.cos(), angle.sin()], [-angle.sin(), angle.cos()]);
    // Pixels: how far both ends lie from the middle, how thin it is, how far off its line is.
    let (reach, thick, off): (f64, f64, f64) = match kind {
        Kind::Steep => (3.0, 10f64.powf(random.random_range(-4.0..-1.0)), 1.0 / 256.0),
        Kind::Dust => (0.1, 0.0, 1.0 / 256.0),
        Kind::Needle => (7.0, 10f64.powf(random.random_range(-4.0..-1.0)), 1.0 / 256.0),
    };
    let off = random.random_range(-off..off);
    let [a, b] = [(); 2].map(|()| random.random_range(0.1..1.0) * reach);
    let depths = match kind {
        Kind::Steep => [1.0, 1.0, random.random_range(1.0..2.0)],
        Kind::Dust => [1.0, 1.0 + 1e-3, 1.0 + 5e-4],
        Kind::Needle => [1.0, 2.0, 1.5],
    };
    let places = [[-a, off], [b, off], [(b - a) / 2.0, off + thick]];
    std::array::from_fn(|i| {
        let [s, t] = places[i];
        let px: [f64; 2] = std::array::from_fn(|k| center[k] + along[k] * s + across[k] * t);
        let w = DEPTH * depths[i];
        let x = (px[0] - f64::from(SIZE.width) / 2.0) * pixel * w;
        [x, (f64::from(SIZE.height) / 2.0 - px[1]) * pixel * w, -w]
    })
}

/// An hlod's mesh, uploaded, and its box.
fn hlod(backend: &mut impl Backend, id: u32, kind: Kind, random: &mut StdRng) -> (Draw, Hlod) {
    let mut vertices: Vec<Vertex> = Vec::new();
    let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for _ in 0..TRIANGLES {
        let mut grid = corners(kind, random).map(|p| p.map(|c| ((c + 16.0) * STEPS).round()));
        if kind == Kind::Dust {
            grid[1] = std::array::from_fn(|k| 2.0 * grid[2][k] - grid[0][k]);
        }
        for p in grid {
            for k in 0..3 {
                min[k] = min[k].min(p[k] / STEPS - 16.0);
                max[k] = max[k].max(p[k] / STEPS - 16.0);
            }
            vertices.push(vertex(p.map(|c| c as u32), [0.0, 0.0, 1.0], u32::MAX));
        }
    }
    let mesh = Mesh { indices: (0..vertices.len() as u16).collect(), vertices };
    let record = plain_blob(mesh.vertices.len() as u32, TRIANGLES as u32);
    let uploaded = backend.upload(BlobId(id), &record, &mesh.bytes()).expect("a sound blob");
    assert_eq!(uploaded, Upload::Done);
    let bounds = Hlod { min, max, ..bytemuck::Zeroable::zeroed() };
    (draw(id, id, [(1.0 / STEPS) as f32; 3], [-16.0; 3]), bounds)
}

#[derive(Debug, Default)]
struct Outcome {
    /// Hlods whose boxes a wall hides.
    hidden: usize,
    /// Those of them that come out in front of it.
    lost: usize,
    /// Those seen without the wall.
    seen: usize,
}

/// Slivers behind a wall that stands as close before their boxes as it can.
fn slivers(kind: Kind, rules: &Rules, pictures: u64) -> Option<Outcome> {
    let mut backend = backend_with(SIZE.width, SIZE.height, rules)?;
    let ahead = [0.0, 0.0, -1.0];
    let camera = Camera::look_at([0.0; 3], ahead, [0.0, 1.0, 0.0], 90.0, f64::from(NEAR));
    let camera = camera.expect("a sound camera");
    let view = View::new(&camera, SIZE);
    Mesh::square([0.0, 0.0, 1.0], 0).upload(&mut backend, HLODS);
    let mut sum = Outcome::default();
    for seed in 0..pictures {
        let mut random = StdRng::seed_from_u64(seed);
        let (draws, boxes): (Vec<_>, Vec<_>) = (0..HLODS)
            .map(|id| {
                let (draw, bounds) = hlod(&mut backend, id, kind, &mut random);
                let tests = BoxTests::new(&camera, SIZE, backend.precision(), *rules);
                let BoxTest::Query(query) = tests.test(&bounds, 32.0) else {
                    panic!("a box well ahead");
                };
                (draw, query)
            })
            .unzip();
        let nearest = boxes.iter().fold(f32::MAX, |w, b| w.min(-b.max[2]));
        let depth = nearest * (1.0 - 1e-5);
        let wall = draw(HLODS, HLODS, [32.0; 3], [-16.0, -16.0, -depth]);
        occluders(&mut backend, view, &[wall]);
        let visible = visible(&mut backend, view, &boxes, Cull::Queries);
        let shown = |draws: &[Draw], backend: &mut gpu::WgpuBackend| {
            let mut items = items(backend, view, draws);
            items.retain(|&item| item < HLODS && item != NO_ITEM);
            items.sort_unstable();
            items.dedup();
            items
        };
        sum.seen += shown(&draws, &mut backend).len();
        let all: Vec<Draw> = draws.into_iter().chain([wall]).collect();
        let out = shown(&all, &mut backend);
        sum.hidden += visible.iter().filter(|&&visible| !visible).count();
        sum.lost += out.iter().filter(|&&item| !visible[item as usize]).count();
    }
    Some(sum)
}

/// 76,800 triangles each.
const PICTURES: u64 = 100;

#[test]
fn none_comes_out_in_front_of_its_box() {
    for kind in [Kind::Steep, Kind::Dust, Kind::Needle] {
        let Some(sum) = slivers(kind, &Rules::default(), PICTURES) else { return };
        assert!(sum.lost == 0, "{kind:?} {sum:?}");
        let all = PICTURES as usize * HLODS as usize;
        assert!(sum.hidden == all && sum.seen > all / 2, "{kind:?} {sum:?} proves little");
    }
}

/// What would be lost shows that the test above has teeth; of a driver that needs neither, nothing is.
#[test]
fn without_the_bias_or_the_guard_some_do_on_a_driver_that_needs_them() {
    let software = gpu::adapters().first().is_some_and(|adapter| adapter.kind == "software");
    let right = Rules::default();
    let broken = [
        (Kind::Steep, Rules { bias: false, ..right }),
        (Kind::Needle, Rules { bias: false, ..right }),
        (Kind::Dust, Rules { guard: false, ..right }),
    ];
    for (kind, rules) in broken {
        let Some(sum) = slivers(kind, &rules, PICTURES) else { return };
        assert!(!software || sum.lost > 0, "{kind:?} {rules:?} {sum:?}");
    }
}
