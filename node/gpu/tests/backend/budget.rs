//! Uploads under a budget.

use crate::support::{Mesh, backend_within, plain_blob, view};
use protocol::format::Texture;
use protocol::format::texture::mips;
use protocol::id::BlobId;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use scene::backend::cpu::CpuBackend;
use scene::backend::{Backend, UNLIMITED, Upload, texture_room, upload_textures};

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

/// Room is set apart for textures, which come and go in it; meshes have the rest of `budget`.
fn textures_count(backend: &mut impl Backend, budget: u64) {
    let made: Vec<_> = [16, 64, 64].map(texture).into();
    let uploads: Vec<_> = made.iter().map(|(texture, bytes)| (*texture, &bytes[..])).collect();
    assert_eq!(upload_textures(backend, &uploads).expect("sound textures"), Upload::Done);
    let held = backend.held_bytes();
    let bytes: u64 = made.iter().map(|(_, bytes)| bytes.len() as u64).sum();
    assert!(held >= bytes && held <= budget, "{held}");
    // In place of the first, not beside them.
    assert_eq!(upload_textures(backend, &uploads).expect("sound textures"), Upload::Done);
    assert_eq!(backend.held_bytes(), held);

    // Room for one of the large ones with the small one: the other takes the place of one that goes.
    let records: Vec<Texture> = made.iter().map(|(texture, _)| *texture).collect();
    let room = texture_room(&records, made[0].0.bytes + made[1].0.bytes);
    assert_eq!(backend.declare_textures(&records, room).expect("sound"), Upload::Done);
    let mut take = |index: u32| {
        let bytes = &made[index as usize].1;
        backend.upload_texture(index, bytes).expect("a sound texture")
    };
    assert_eq!([0, 1].map(&mut take), [Upload::Done; 2]);
    assert_eq!([2, 1, 0].map(&mut take), [Upload::Full, Upload::Done, Upload::Done]);
    backend.evict_texture(1);
    backend.evict_texture(1);
    let bytes = &made[2].1;
    assert_eq!(backend.upload_texture(2, bytes).expect("a sound texture"), Upload::Done);
    assert!(backend.upload_texture(1, &bytes[1..]).is_err(), "no texture is that short");

    let rest = budget - room;
    assert_eq!(upload(backend, 0, budget / 54), Upload::Full);
    assert_eq!(upload(backend, 0, (rest - GRAIN) / 54), Upload::Done);
    let more = [&records[..], &records[..]].concat();
    let before = backend.held_bytes();
    assert_eq!(backend.declare_textures(&more, UNLIMITED).expect("sound"), Upload::Full);
    assert_eq!(backend.held_bytes(), before);
    backend.evict(BlobId(0));
    assert_eq!(backend.declare_textures(&[], 0).expect("none"), Upload::Done);
    assert_eq!(upload(backend, 0, (budget - GRAIN) / 54), Upload::Done, "all of it is for meshes");
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
