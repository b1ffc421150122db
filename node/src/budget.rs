//! How a node's memory is shared out: buffers on their way, and what the backend holds.

use crate::machine_memory;
use protocol::format::Skeleton;
use protocol::id::BlobId;
use scene::asset::Asset;
use scene::backend::texture_room;
use scene::front::FrontEntry;
use std::collections::BTreeSet;
use std::path::Path;

/// Beside room for one, buffers take this share of the memory that is not needed otherwise.
const HOST_SHARE: u64 = 8;
/// Buffers take no more than this: they only pass through.
const MOST_HOST_BYTES: u64 = 32 << 20;
/// Least bytes of a buffer in device memory, and what ranges in it are rounded up to.
const DEVICE_GRAIN: u64 = 1 << 10;

/// What a node may take, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Budget {
    /// What the skeleton takes (Manocha, section 5.4).
    pub(crate) skeleton: u64,
    /// For buffers.
    pub(crate) host: u64,
    /// Of that, what must be left for one that is waited for: the largest mesh or texture of the file.
    pub(crate) reserve: u64,
    /// For the backend.
    pub(crate) device: u64,
    /// Of that, for textures.
    pub(crate) textures: u64,
}

/// Less memory than a scene can be shown with (exit code 78).
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "--memory allows {allowed} bytes a node, and this scene needs at least {needed}: its skeleton takes \
     {skeleton}, a buffer for its largest mesh or texture {buffer}, the largest mesh itself {mesh}, textures of \
     one mesh {textures}, its coarsest form {coarsest}"
)]
pub struct TooSmall {
    allowed: u64,
    needed: u64,
    skeleton: u64,
    buffer: u64,
    mesh: u64,
    textures: u64,
    coarsest: u64,
}

/// Shares `memory` out for a scene of which `drawable` may be drawn and `always` is to stay.
///
/// Textures have room of their own, so that what one kind leaves free in pieces is never needed by the
/// other: what those of one mesh need, and of the rest their share of all that may be drawn.
pub(crate) fn share_out(
    memory: u64,
    skeleton: &Skeleton,
    drawable: &[BlobId],
    always: &[FrontEntry],
) -> Result<Budget, TooSmall> {
    let bytes_of = |blob: BlobId| skeleton.blob(blob).bytes;
    let mesh = drawable.iter().map(|&blob| bytes_of(blob)).max().unwrap_or(0);
    let in_file = skeleton.textures.iter().map(|texture| texture.bytes).max().unwrap_or(0);
    let buffer = mesh.max(in_file);
    let stays: BTreeSet<BlobId> =
        always.iter().flat_map(|entry| skeleton.blobs_of(entry.level)).collect();
    let coarsest = stays.iter().map(|&blob| bytes_of(blob) + DEVICE_GRAIN).sum::<u64>();
    let textures = least_textures(skeleton, drawable, &stays);

    let skeleton_bytes = skeleton.resident_bytes();
    // One mesh at a time can be drawn, with its textures.
    let least = coarsest + mesh + DEVICE_GRAIN;
    let needed = skeleton_bytes + buffer + textures + least;
    if needed > memory {
        let skeleton = skeleton_bytes;
        let allowed = memory;
        return Err(TooSmall { allowed, needed, skeleton, buffer, mesh, textures, coarsest });
    }

    let meshes: u64 = drawable.iter().map(|&blob| bytes_of(blob) + DEVICE_GRAIN).sum();
    let all = room_for(skeleton, &(0..skeleton.textures.len() as u32).collect());
    let host = (buffer + (memory - needed) / HOST_SHARE).min(MOST_HOST_BYTES).max(buffer);
    let rest = memory - needed - (host - buffer);
    let wished = [all.saturating_sub(textures), meshes.saturating_sub(least)].map(u128::from);
    let share = u128::from(rest) * wished[0] / (wished[0] + wished[1]).max(1);
    let textures = (textures + share as u64).min(all);
    let device = memory - skeleton_bytes - host;
    Ok(Budget { skeleton: skeleton_bytes, host, reserve: buffer, device, textures })
}

/// Room for the textures of `stays` and, beside them, of any one mesh.
fn least_textures(skeleton: &Skeleton, drawable: &[BlobId], stays: &BTreeSet<BlobId>) -> u64 {
    let of = |blob: BlobId| skeleton.textures_of(blob).iter().copied();
    let kept: BTreeSet<u32> = stays.iter().flat_map(|&blob| of(blob)).collect();
    let with = |blob: BlobId| {
        let beside: BTreeSet<u32> = of(blob).filter(|texture| !kept.contains(texture)).collect();
        stored(skeleton, &beside)
    };
    let most = drawable.iter().map(|&blob| with(blob)).max().unwrap_or(0);
    texture_room(&skeleton.textures, stored(skeleton, &kept) + most)
}

fn room_for(skeleton: &Skeleton, textures: &BTreeSet<u32>) -> u64 {
    texture_room(&skeleton.textures, stored(skeleton, textures))
}

fn stored(skeleton: &Skeleton, textures: &BTreeSet<u32>) -> u64 {
    textures.iter().map(|&texture| Asset::Texture(texture).stored_bytes(skeleton)).sum()
}

/// What a node takes where it is told nothing: an eighth of what the machine or its control groups let
/// it have, since three nodes may share it with whoever asks for pictures; 1 GiB where the system does not
/// tell.
pub(crate) fn by_itself() -> u64 {
    machine_memory::limit(Path::new("/")).map_or(1 << 30, |total| total / 8)
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
        let large = share_out(1 << 30, skeleton, &blobs, &[]).unwrap();
        let all = |budget: &Budget| budget.skeleton + budget.host + budget.device;
        assert!(large.host == MOST_HOST_BYTES && all(&large) == 1 << 30);
        assert_eq!(large.textures, texture_room(&skeleton.textures, skeleton.textures[0].bytes));
        let error = share_out(skeleton.blobs[0].bytes, skeleton, &blobs, &[]).unwrap_err();
        assert!(error.to_string().contains(&error.needed.to_string()));
        assert!(error.to_string().contains(&skeleton.resident_bytes().to_string()));
        let least = share_out(error.needed, skeleton, &blobs, &[]).unwrap();
        assert!(least.host >= skeleton.blobs[0].bytes && least.skeleton > 0);
        assert_eq!(all(&least), error.needed, "the skeleton counts");
        assert!(share_out(error.needed - 1, skeleton, &blobs, &[]).is_err());
    }

    #[test]
    fn the_machine_tells_its_memory() {
        assert!(by_itself() > 0);
    }
}
