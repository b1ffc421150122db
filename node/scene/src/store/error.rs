//! Why bytes of a scene file cannot be had.

use protocol::format::mesh::BlobDamage;
use protocol::id::BlobId;
use protocol::message::FailureKind;
use std::path::PathBuf;

/// Why a blob or a texture cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// The bytes of a blob are wrong.
    #[error("{}: blob {blob} is damaged: {source}; copy or bake the file again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The blob.
        blob: BlobId,
        /// What is wrong.
        source: BlobDamage,
    },
    /// The bytes of a texture are wrong.
    #[error("{}: texture {texture} is damaged; copy or bake the file again", path.display())]
    DamagedTexture {
        /// The file.
        path: PathBuf,
        /// The texture, index into [`protocol::format::Skeleton::textures`].
        texture: u32,
    },
    /// The bytes are no longer there.
    #[error(
        "{}: {content} is gone: the file was cut short while it was open; copy or bake the file again",
        path.display()
    )]
    Gone {
        /// The file.
        path: PathBuf,
        /// What was asked for.
        content: Content,
    },
    /// The system cannot read the bytes.
    #[error("{}: cannot read {content}: {reason}; check the disk and its connection", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was asked for.
        content: Content,
        /// The system's reason.
        reason: String,
    },
    /// No such blob: the skeleton was checked, so the asker made it up.
    #[error("{}: there is no blob {blob}", path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
        /// The blob.
        blob: BlobId,
    },
}

/// What of a scene file was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
    /// A blob.
    Blob(BlobId),
    /// A texture, index into [`protocol::format::Skeleton::textures`].
    Texture(u32),
    /// The file from its first byte to its last.
    Whole,
}

impl std::fmt::Display for Content {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Blob(id) => write!(f, "blob {id}"),
            Self::Texture(index) => write!(f, "texture {index}"),
            Self::Whole => f.write_str("part of it"),
        }
    }
}

impl StoreError {
    /// The class, which decides the exit code.
    pub fn kind(&self) -> FailureKind {
        match self {
            Self::Damaged { .. } | Self::DamagedTexture { .. } | Self::Gone { .. } => {
                FailureKind::BadData
            }
            Self::Io { .. } => FailureKind::Io,
            Self::Unknown { .. } => FailureKind::Internal,
        }
    }
}
