//! How a node's memory is shared out: buffers on their way, and what the backend holds.

use protocol::format::Skeleton;
use protocol::id::BlobId;
use scene::front::FrontEntry;

/// Buffers take this share of the memory, unless one mesh needs more.
const HOST_SHARE: u64 = 8;
/// Buffers take no more than this: they only pass through.
const MOST_HOST_BYTES: u64 = 32 << 20;
/// A page of textures holds no more than this share of all, or one texture.
const PAGES_SHARE: u64 = 64;
/// Least bytes of a buffer in device memory, and what ranges in it are rounded up to.
const DEVICE_GRAIN: u64 = 1 << 10;

/// What a node may take, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Budget {
    /// For buffers.
    pub(crate) host: u64,
    /// For the backend.
    pub(crate) device: u64,
    /// All of the scene fits the backend.
    pub(crate) fits: bool,
}

/// Less memory than a scene can be shown with (exit code 78).
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "--memory allows {allowed} bytes a node, and this scene needs at least {needed}: its largest mesh \
     takes {mesh}, its textures {textures}, its coarsest form {coarsest}"
)]
pub struct TooSmall {
    allowed: u64,
    needed: u64,
    mesh: u64,
    textures: u64,
    coarsest: u64,
}

/// Shares `memory` out for a scene of which `drawable` may be drawn and `always` is to stay.
pub(crate) fn share_out(
    memory: u64,
    skeleton: &Skeleton,
    drawable: &[BlobId],
    always: &[FrontEntry],
) -> Result<Budget, TooSmall> {
    let sizes = || drawable.iter().map(|&blob| skeleton.blob(blob).bytes);
    let mesh = sizes().max().unwrap_or(0);
    let geometry: u64 = sizes().map(|bytes| bytes + DEVICE_GRAIN).sum();
    // Ranges in device buffers leave gaps.
    let geometry = geometry.saturating_add(geometry / HOST_SHARE);
    let textures: u64 = skeleton.textures.iter().map(|texture| texture.bytes).sum();
    // They lie on pages, of which the last may be empty but for a little: a page is as large as the
    // largest texture or holds a share of all.
    let largest = skeleton.textures.iter().map(|texture| texture.bytes).max().unwrap_or(0);
    let textures = textures + largest + textures / PAGES_SHARE;
    let coarsest = always.iter().map(|entry| level_bytes(skeleton, entry.level)).sum::<u64>();
    let host = (memory / HOST_SHARE).min(MOST_HOST_BYTES).max(mesh);
    // Textures stay; of the rest one mesh at a time can be drawn.
    let needed = host + textures + coarsest + mesh + DEVICE_GRAIN;
    if needed > memory {
        return Err(TooSmall { allowed: memory, needed, mesh, textures, coarsest });
    }
    let device = memory - host;
    Ok(Budget { host, device, fits: geometry.saturating_add(textures) <= device })
}

/// Bytes of a level's meshes; one that several parts share counts for each.
fn level_bytes(skeleton: &Skeleton, level: u32) -> u64 {
    skeleton.blobs_of(level).map(|blob| skeleton.blob(blob).bytes).sum()
}

/// What a node takes where it is told nothing: an eighth of the machine's memory, since three nodes
/// may share it with whoever asks for pictures; 1 GiB where the system does not tell.
pub(crate) fn by_itself() -> u64 {
    let meminfo = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    total_memory(&meminfo).map_or(1 << 30, |total| total / 8)
}

/// `MemTotal` of a Linux `/proc/meminfo`, bytes.
fn total_memory(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{street, write};
    use scene::store::Store;

    #[test]
    fn memory_is_shared_out_or_refused_with_what_is_needed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.occ");
        write(&path, &street(), true);
        let store = Store::open(&path).unwrap();
        let skeleton = store.skeleton();
        let blobs: Vec<BlobId> = (0..skeleton.blobs.len() as u32).map(BlobId).collect();
        let all = skeleton.blobs[0].bytes + skeleton.textures[0].bytes;
        let large = share_out(1 << 30, skeleton, &blobs, &[]).unwrap();
        assert!(
            large.fits && large.host == MOST_HOST_BYTES && large.host + large.device == 1 << 30
        );
        let error = share_out(all, skeleton, &blobs, &[]).unwrap_err();
        assert!(error.to_string().contains(&error.needed.to_string()));
        let least = share_out(error.needed, skeleton, &blobs, &[]).unwrap();
        assert!(least.host >= skeleton.blobs[0].bytes);
        assert_eq!(least.host + least.device, error.needed);
        assert!(share_out(error.needed - 1, skeleton, &blobs, &[]).is_err());
    }

    #[test]
    fn the_machine_tells_its_memory_or_does_not() {
        assert_eq!(total_memory("MemTotal:       24 kB\nMemFree: 1 kB\n"), Some(24 << 10));
        assert_eq!(total_memory(""), None);
        assert_eq!(total_memory("MemTotal: x kB\n"), None);
        assert!(by_itself() > 0);
    }
}
