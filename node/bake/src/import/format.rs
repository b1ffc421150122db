//! Which format a scene file is in.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::error::ImportError;

/// A format this program reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    /// glTF 2.0, as JSON or as a GLB container.
    Gltf,
}

/// Bytes at the start of a file that are looked at.
const HEAD_BYTES: u64 = 4096;

impl Format {
    /// The format of the file at `path`: what its name ends in, else what it begins with.
    pub(super) fn of(path: &Path) -> Result<Self, ImportError> {
        let unreadable = |source| ImportError::unreadable(path, source);
        let file = File::open(path).map_err(unreadable)?;
        let length = file.metadata().map_err(unreadable)?.len();
        let mut head = Vec::new();
        file.take(HEAD_BYTES).read_to_end(&mut head).map_err(unreadable)?;
        if let Some(format) = Self::by_name(path) {
            return Ok(format);
        }
        Self::by_content(&head, length)
            .ok_or_else(|| ImportError::UnknownFormat { file: path.into(), what: describe(&head) })
    }

    fn by_name(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "glb" | "gltf" => Some(Self::Gltf),
            _ => None,
        }
    }

    fn by_content(head: &[u8], _length: u64) -> Option<Self> {
        let text = head.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(head).trim_ascii_start();
        if head.starts_with(b"glTF") || text.starts_with(b"{") { Some(Self::Gltf) } else { None }
    }
}

/// What stands at the start of a file in no known format.
pub(super) fn describe(head: &[u8]) -> String {
    match head.len() {
        0 => "the file is empty".to_owned(),
        _ => format!(
            "its format is unknown (it starts with {:?})",
            head[..head.len().min(8)].escape_ascii().to_string()
        ),
    }
}
