//! Uploads under a budget.

use crate::support::{Mesh, backend_within, plain_blob, view};
use protocol::format::Texture;
use protocol::format::texture::mips;
use protocol::id::BlobId;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use scene::backend::cpu::CpuBackend;
use scene::backend::{Backend, TextureUpload, Upload};

/// Bytes of which ranges are multiples. A triangle of a soup takes 54 bytes.
const GRAIN: u64 = 32;

fn upload(backend: &mut impl Backend, id: u32, triangles: u64) -> Upload {
    let mesh = Mesh::soup(&mut StdRng::seed_from_u64(u64::from(id)), triangles as usize);
    let record = plain_blob(3 * triangles as u32, triangles as u32);
    backend.upload(BlobId(id), &record, &mesh.bytes()).expect("a sound blob")
}

/// Random uploads and evictions under `budget`; then the largest mesh that it has room for.
fn keeps_within(backend: &mut impl Backend, budget: u64, seed: u64) {
    let mut random = StdRng::seed_from_u64(seed);
    let most = budget / 54;
    let mut held: Vec<(u32, u64)> = Vec::new();
    let (mut full, mut done) = (0, 0);
    for id in 0..400 {
        if random.random_bool(0.4) && !held.is_empty() {
            let (id, _) = held.swap_remove(random.random_range(0..held.len()));
            backend.evict(BlobId(id));
        }
        let triangles = match random.random_range(0..20) {
            // 16-bit indices count no more.
            0 => random.random_range(0..=2 * most).min(21_845),
            1..5 => random.random_range(0..=most / 4),
            _ => random.random_range(0..=most / 40),
        };
        let before = backend.held_bytes();
        match upload(backend, id, triangles) {
            Upload::Done => {
                held.push((id, triangles));
                done += 1;
            }
            Upload::Full => {
                assert_eq!(backend.held_bytes(), before, "full, and nothing changed");
                full += 1;
            }
        }
        let least: u64 = held.iter().map(|&(_, triangles)| triangles * 54).sum();
        assert!(backend.held_bytes() >= least && backend.held_bytes() <= budget);
    }
    assert!(full > 20 && done > 100, "{full} {done}");
    held.into_iter().for_each(|(id, _)| backend.evict(BlobId(id)));
    let largest = (budget - GRAIN) / 54;
    assert_eq!(upload(backend, 1000, largest), Upload::Done, "all of it, once all is evicted");
    assert!(backend.held_bytes() <= budget && backend.held_bytes() >= largest * 54);
    assert_eq!(upload(backend, 1001, 2), Upload::Full);
    // Nor in place of what is there.
    assert_eq!(upload(backend, 1000, 2), Upload::Full);
    backend.evict(BlobId(1000));
    assert_eq!(upload(backend, 1001, most + 1), Upload::Full, "more than there may ever be");
}

/// A texture of a side with its mips.
fn texture(side: u32) -> (Texture, Vec<u8>) {
    let bytes = mips(side, &vec![200; 4 * (side * side) as usize]);
    let length = bytes.len() as u64;
    (Texture { offset: 0, bytes: length, side, wrap: 0, crc: 0, reserved: 0 }, bytes)
}

fn all(backend: &mut impl Backend, textures: &[TextureUpload<'_>]) -> Upload {
    backend.upload_textures(textures).expect("sound textures")
}

/// Textures and meshes share `budget`.
fn textures_count(backend: &mut impl Backend, budget: u64) {
    let made: Vec<_> = [16, 64, 64].map(texture).into();
    let uploads: Vec<_> = made.iter().map(|(texture, bytes)| (*texture, &bytes[..])).collect();
    let meshes = backend.held_bytes();
    assert_eq!(all(backend, &uploads), Upload::Done);
    let held = backend.held_bytes();
    let bytes: u64 = made.iter().map(|(_, bytes)| bytes.len() as u64).sum();
    assert!(held >= meshes + bytes && held <= budget, "{held}");
    // In place of the first, not beside them.
    assert_eq!(all(backend, &uploads), Upload::Done);
    assert_eq!(backend.held_bytes(), held);
    let rest = budget - held;
    assert_eq!(upload(backend, 0, rest / 54 + 2), Upload::Full);
    assert_eq!(upload(backend, 0, (rest - GRAIN) / 54), Upload::Done);
    let more = [&uploads[..], &uploads[..]].concat();
    let before = backend.held_bytes();
    assert_eq!(all(backend, &more), Upload::Full);
    assert_eq!(backend.held_bytes(), before);
    backend.evict(BlobId(0));
    assert_eq!(all(backend, &more), Upload::Done);
    assert!(backend.held_bytes() <= budget);
    assert_eq!(all(backend, &[]), Upload::Done);
    assert!(backend.held_bytes() < held);
}

const BUDGETS: [u64; 3] = [20_000, 300_000, 1_000_000];

#[test]
fn the_driver_s_memory_stays_within_its_budget() {
    for budget in BUDGETS {
        let Some(mut backend) = backend_within(8, 8, budget) else { return };
        keeps_within(&mut backend, budget, budget);
    }
    let Some(mut backend) = backend_within(8, 8, 100_000) else { return };
    textures_count(&mut backend, 100_000);
}

#[test]
fn the_rasteriser_s_memory_stays_within_its_budget() {
    let backend = |budget| CpuBackend::new(view(8, 8).size).with_budget(budget);
    for budget in BUDGETS {
        keeps_within(&mut backend(budget), budget, budget);
    }
    textures_count(&mut backend(100_000), 100_000);
}
