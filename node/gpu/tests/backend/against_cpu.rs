//! The driver against the rasteriser in Rust: the same scene, all but border pixels alike.

use crate::support::{
    Mesh, backend, cube_over, items, occluders, picture, random_box, shade, view, visible,
};
use protocol::settings::Cull;
use rand::SeedableRng;
use rand::rngs::StdRng;
use scene::backend::cpu::CpuBackend;
use scene::backend::{Backend, Draw, Shading};
use scene::occludee::MESH_BIAS_PX;

const WIDTH: u32 = 203;
const HEIGHT: u32 = 151;
const PIXELS: usize = (WIDTH * HEIGHT) as usize;

/// Cubes and tetrahedron soups, near and far, some across the near plane.
fn crowd() -> Vec<Draw> {
    let mut random = StdRng::seed_from_u64(17);
    let mut draws: Vec<Draw> =
        (0..250).map(|i| cube_over(0, i, &random_box(&mut random, 0..900, 100))).collect();
    let step = 1.0 / (1 << 20) as f32;
    draws.extend((250..260).map(|i| {
        let mut soup = cube_over(1, i, &random_box(&mut random, 64..400, 200));
        soup.linear = soup.linear.map(|column| column.map(|c| c * step * 3.0));
        soup
    }));
    draws
}

fn meshes(backend: &mut impl Backend) {
    Mesh::cube(0xffc0_8040).upload(backend, 0);
    Mesh::soup(&mut StdRng::seed_from_u64(1), 400).upload(backend, 1);
}

fn both() -> Option<(gpu::WgpuBackend, CpuBackend)> {
    let mut gpu = backend(WIDTH, HEIGHT)?;
    let mut cpu = CpuBackend::new(view(WIDTH, HEIGHT).size);
    meshes(&mut gpu);
    meshes(&mut cpu);
    Some((gpu, cpu))
}

#[test]
fn item_buffers_agree() {
    let Some((mut gpu, mut cpu)) = both() else { return };
    let view = view(WIDTH, HEIGHT);
    let (a, b) = (items(&mut gpu, view, &crowd()), items(&mut cpu, view, &crowd()));
    let different = a.iter().zip(&b).filter(|(a, b)| a != b).count();
    eprintln!("{different} of {PIXELS} pixels show another item");
    assert!(different * 500 <= PIXELS, "{different} of {PIXELS} pixels show another item");
    let mut distinct = a;
    distinct.sort_unstable();
    distinct.dedup();
    assert!(distinct.len() > 50, "{} items prove little", distinct.len());
}

#[test]
fn pictures_and_depth_agree() {
    let Some((mut gpu, mut cpu)) = both() else { return };
    let view = view(WIDTH, HEIGHT);
    let (a, b) = (shade(&mut gpu, view, &crowd()), shade(&mut cpu, view, &crowd()));
    let pairs = a.rgba.chunks_exact(4).zip(b.rgba.chunks_exact(4));
    let colors = pairs.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 2)).count();
    let (a, b) = (a.depth.unwrap(), b.depth.unwrap());
    let depths = (0..PIXELS).filter(|&i| (a[i] - b[i]).abs() > tolerance(&b, i)).count();
    eprintln!("{colors} colours and {depths} depths of {PIXELS} differ");
    assert!(colors * 200 <= PIXELS, "{colors} of {PIXELS} colours differ");
    assert!(depths * 200 <= PIXELS, "{depths} of {PIXELS} depths differ");
}

#[test]
fn normals_agree_to_a_step() {
    let Some((mut gpu, mut cpu)) = both() else { return };
    let view = view(WIDTH, HEIGHT);
    let a = picture(&mut gpu, view, Shading::Normals, &crowd()).rgba;
    let b = picture(&mut cpu, view, Shading::Normals, &crowd()).rgba;
    let pairs = a.chunks_exact(4).zip(b.chunks_exact(4));
    let other = pairs.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 1)).count();
    eprintln!("{other} normals of {PIXELS} differ");
    assert!(other * 200 <= PIXELS, "{other} of {PIXELS} normals differ");
    let sky = a.chunks_exact(4).filter(|pixel| *pixel == [128, 128, 128, 255]).count();
    let up = a.chunks_exact(4).filter(|pixel| *pixel == [128, 128, 255, 255]).count();
    assert!(sky > PIXELS / 20 && up > PIXELS / 20 && sky + up < PIXELS, "{sky} {up}");
}

/// Drivers move vertices to a raster of 1/256 pixel, so depth may be off by a part of what it changes
/// from one pixel to the next. The bias is another part.
fn tolerance(depth: &[f32], pixel: usize) -> f32 {
    let neighbours = [1, WIDTH as usize]
        .into_iter()
        .flat_map(|step| [pixel.checked_sub(step), Some(pixel + step).filter(|&at| at < PIXELS)]);
    let step = |at: usize| (depth[at] - depth[pixel]).abs();
    1e-6 + neighbours.flatten().map(step).fold(0.0, f32::max) * (1.0 / 64.0 - MESH_BIAS_PX as f32)
}

#[test]
fn box_tests_agree() {
    let Some((mut gpu, mut cpu)) = both() else { return };
    let view = view(WIDTH, HEIGHT);
    let mut random = StdRng::seed_from_u64(23);
    let boxes: Vec<_> = (0..4000).map(|_| random_box(&mut random, 64..2000, 60)).collect();
    occluders(&mut gpu, view, &crowd());
    occluders(&mut cpu, view, &crowd());
    let a = visible(&mut gpu, view, &boxes, Cull::Queries);
    let b = visible(&mut cpu, view, &boxes, Cull::Queries);
    let different = a.iter().zip(&b).filter(|(a, b)| a != b).count();
    eprintln!("{different} of {} answers differ", boxes.len());
    assert!(different * 200 <= boxes.len(), "{different} of {} answers differ", boxes.len());
}
