//! How fast blobs come out of a scene file: `cargo run --release -p scene --example page_in SCENE.occ`.
//!
//! Reads every blob in file order, a few times over, and prints the best rate of each way: guarded
//! and checked as `Store::read_blob` does it, by plain reads of the file with the same check, and by
//! plain reads alone.

use protocol::format::mesh::check_blob;
use protocol::format::read_skeleton;
use protocol::id::BlobId;
use scene::store::Store;
use std::error::Error;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Times each way is tried; the first fills the system's cache.
const ROUNDS: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    let path = PathBuf::from(std::env::args_os().nth(1).ok_or("name a scene file")?);
    let (store, scene, file) = (Store::open(&path)?, read_skeleton(&path)?, File::open(&path)?);
    let blobs = &scene.skeleton.blobs;
    let bytes: u64 = blobs.iter().map(|blob| blob.bytes).sum();
    println!("{} blobs, {} MB", blobs.len(), bytes / 1_000_000);

    let read_at = |id, out: &mut [u8]| {
        let mut file = &file;
        file.seek(SeekFrom::Start(scene.blob_range(id).start))?;
        file.read_exact(out)
    };
    measure("read_blob", &store, bytes, |id, out| Ok(store.read_blob(id, out)?))?;
    measure("plain reads, checked", &store, bytes, |id, out| {
        read_at(id, out)?;
        Ok(check_blob(&blobs[id.index()], out, scene.skeleton.textures_of(id))?)
    })?;
    measure("plain reads alone", &store, bytes, |id, out| Ok(read_at(id, out)?))
}

/// Prints the best rate of reading all blobs into one buffer.
fn measure(
    name: &str,
    store: &Store,
    bytes: u64,
    mut read: impl FnMut(BlobId, &mut [u8]) -> Result<(), Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    let blobs = &store.skeleton().blobs;
    let mut buffer = vec![0; blobs.iter().map(|blob| blob.bytes as usize).max().unwrap_or(0)];
    let mut best = Duration::MAX;
    for _ in 0..ROUNDS {
        let began = Instant::now();
        for (id, blob) in (0..).map(BlobId).zip(blobs) {
            read(id, &mut buffer[..blob.bytes as usize])?;
        }
        best = best.min(began.elapsed());
    }
    println!("{:>8.0} MB/s  {name}", bytes as f64 / 1e6 / best.as_secs_f64());
    Ok(())
}
