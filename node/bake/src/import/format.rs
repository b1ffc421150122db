//! Which format a scene file is in.

use std::io::Read;
use std::path::Path;

use super::error::ImportError;
use super::open::open;
use super::text::{BYTE_ORDER_MARK, is_utf16, words};

/// A format this program reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    /// glTF 2.0, as JSON or as a GLB container.
    Gltf,
    /// Wavefront OBJ.
    Obj,
    /// PLY.
    Ply,
    /// STL.
    Stl,
}

/// Bytes at the start of a file that are looked at.
const HEAD_BYTES: u64 = 4096;

impl Format {
    /// The format of the file at `path`: what its name ends in, else what it begins with.
    pub(super) fn of(path: &Path) -> Result<Self, ImportError> {
        let unreadable = |source| ImportError::unreadable(path, source);
        let file = open(path).map_err(unreadable)?;
        let length = file.metadata().map_err(unreadable)?.len();
        let mut head = Vec::new();
        file.take(HEAD_BYTES).read_to_end(&mut head).map_err(unreadable)?;
        if let Some(what) = stands_for(&head) {
            return Err(ImportError::UnknownFormat { file: path.into(), what });
        }
        if let Some(format) = Self::by_name(path) {
            return Ok(format);
        }
        Self::by_content(&head, length)
            .ok_or_else(|| ImportError::UnknownFormat { file: path.into(), what: describe(&head) })
    }

    fn by_name(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "glb" | "gltf" => Some(Self::Gltf),
            "obj" => Some(Self::Obj),
            "ply" => Some(Self::Ply),
            "stl" => Some(Self::Stl),
            _ => None,
        }
    }

    fn by_content(head: &[u8], length: u64) -> Option<Self> {
        let text = head.strip_prefix(BYTE_ORDER_MARK).unwrap_or(head).trim_ascii_start();
        let triangles = head.get(80..84).and_then(|count| count.first_chunk::<4>());
        let binary_stl = triangles
            .is_some_and(|count| 84 + 50 * u64::from(u32::from_le_bytes(*count)) == length);
        let first = |words: &[&[u8]]| Self::first_words(text).any(|word| words.contains(&word));
        if head.starts_with(b"glTF") || text.starts_with(b"{") {
            Some(Self::Gltf)
        } else if head.starts_with(b"ply\n") || head.starts_with(b"ply\r") {
            Some(Self::Ply)
        } else if binary_stl || text.get(..6).is_some_and(|w| w.eq_ignore_ascii_case(b"solid ")) {
            Some(Self::Stl)
        } else if first(&[b"v", b"mtllib", b"o", b"g", b"usemtl"]) {
            Some(Self::Obj)
        } else {
            None
        }
    }

    /// The first word of the first line that is no comment.
    fn first_words(text: &[u8]) -> impl Iterator<Item = &[u8]> {
        let lines = text.split(|byte| matches!(byte, b'\n' | b'\r'));
        lines.filter_map(|line| words(line).next()).filter(|word| !word.starts_with(b"#")).take(1)
    }
}

/// What a file is that stands for a model, or holds it, whatever its name ends in.
fn stands_for(head: &[u8]) -> Option<String> {
    let text = head.strip_prefix(BYTE_ORDER_MARK).unwrap_or(head).trim_ascii_start();
    let begins = |with: &[u8]| text.get(..with.len()).is_some_and(|b| b.eq_ignore_ascii_case(with));
    let what = if begins(b"version https://git-lfs") {
        "this is a Git LFS pointer and not the model itself (fetch that with `git lfs pull`)"
    } else if head.starts_with(b"\x1F\x8B") {
        "this is a gzip file (unpack it first)"
    } else if head.starts_with(b"PK\x03\x04") {
        "this is a zip file (unpack it first)"
    } else if begins(b"<!doctype html") || begins(b"<html") {
        "this is a web page and not a model (download the file itself)"
    } else if is_utf16(head) {
        "this is UTF-16 text (save it as UTF-8)"
    } else {
        return None;
    };
    Some(what.to_owned())
}

/// What stands at the start of a file in no known format.
fn describe(head: &[u8]) -> String {
    match head.len() {
        0 => "the file is empty".to_owned(),
        _ => format!(
            "its format is unknown (it starts with {:?})",
            head[..head.len().min(8)].escape_ascii().to_string()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_decide_and_content_where_they_do_not() {
        let folder = tempfile::tempdir().unwrap();
        let of = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            Format::of(&path)
        };
        assert_eq!(of("a.OBJ", b"").unwrap(), Format::Obj);
        assert_eq!(of("a.ply", b"glTF").unwrap(), Format::Ply);
        let mut stl = vec![b'x'; 84 + 50];
        stl[80..84].copy_from_slice(&1u32.to_le_bytes());
        for (bytes, format) in [
            (&b"glTF\x02\0\0\0"[..], Format::Gltf),
            (b"\xEF\xBB\xBF {}", Format::Gltf),
            (b"ply\r\nformat", Format::Ply),
            (b"solid part\n", Format::Stl),
            (&stl, Format::Stl),
            (b"# by hand\n\nv 0 0 0\n", Format::Obj),
        ] {
            assert_eq!(of("a.dat", bytes).unwrap(), format);
        }
        for bytes in [&b""[..], b"# v 1\nhello v\n", b"PK\x03\x04"] {
            let message = of("a", bytes).unwrap_err().to_string();
            for word in ["glTF", "OBJ", "PLY", "STL"] {
                assert!(message.contains(word), "{message}");
            }
        }
        assert!(Format::of(&folder.path().join("none.obj")).unwrap_err().is_missing_input());
        for (name, bytes, word) in [
            (
                "a.glb",
                &b"version https://git-lfs.github.com/spec/v1\noid sha256:0"[..],
                "git lfs pull",
            ),
            ("a.obj", b"\x1F\x8B\x08\0", "gzip"),
            ("a.stl", b"PK\x03\x04\x14", "zip"),
            ("a.gltf", b"\n<!DOCTYPE HTML><html>", "web page"),
            ("a.ply", b"\xEF\xBB\xBF<html>", "web page"),
            ("a.gltf", b"{\0 \0\"\0", "UTF-16"),
        ] {
            let message = of(name, bytes).unwrap_err().to_string();
            assert!(message.contains(word), "{name}: {message}");
        }
    }
}
