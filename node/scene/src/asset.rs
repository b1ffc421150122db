//! What is loaded and evicted as one: a blob or a texture.

use crate::backend::stored_bytes;
use protocol::format::Skeleton;
use protocol::id::BlobId;

/// A blob or a texture of a scene. Blobs come before textures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Asset {
    /// A mesh, or a patch of a scan cube.
    Blob(BlobId),
    /// Index into [`Skeleton::textures`].
    Texture(u32),
}

impl Asset {
    /// Its bytes in the file.
    pub fn file_bytes(self, skeleton: &Skeleton) -> u64 {
        match self {
            Self::Blob(id) => skeleton.blob(id).bytes,
            Self::Texture(index) => skeleton.textures[index as usize].bytes,
        }
    }

    /// Bytes that a backend stores of it: textures may lose their largest mips.
    pub fn stored_bytes(self, skeleton: &Skeleton) -> u64 {
        match self {
            Self::Blob(id) => skeleton.blob(id).bytes,
            Self::Texture(index) => stored_bytes(&skeleton.textures[index as usize]),
        }
    }

    /// Whether it is a texture: these have room of their own.
    pub fn is_texture(self) -> bool {
        matches!(self, Self::Texture(_))
    }

    /// Its place in a table of `blobs` blobs and all textures behind them.
    pub fn index(self, blobs: usize) -> usize {
        match self {
            Self::Blob(id) => id.index(),
            Self::Texture(index) => blobs + index as usize,
        }
    }
}

impl std::fmt::Display for Asset {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Blob(id) => write!(f, "blob {id}"),
            Self::Texture(index) => write!(f, "texture {index}"),
        }
    }
}

/// What a blob needs to be drawn: itself, and with `textures` those that it names.
pub fn needs(skeleton: &Skeleton, blob: BlobId, textures: bool) -> impl Iterator<Item = Asset> {
    let named = if textures { skeleton.textures_of(blob) } else { &[] };
    std::iter::once(Asset::Blob(blob)).chain(named.iter().copied().map(Asset::Texture))
}
