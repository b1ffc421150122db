//! What a URI in a scene file refers to: bytes in the URI itself, or a file in the scene's folder.

use std::io::ErrorKind;
use std::path::{Component, Path, PathBuf};

use super::error::ImportError;
use super::store::Store;

/// Where a scene file stands, and so what its relative URIs mean.
pub(super) struct Folder<'a> {
    /// The scene file: what stands beside it and below may be read.
    pub(super) file: &'a Path,
    /// The file that names others, which are looked for beside it: the scene, or what belongs to it.
    pub(super) by: &'a Path,
}

impl Folder<'_> {
    /// The bytes a URI refers to; `at` names the object that holds it.
    ///
    /// Only data URIs and files inside the scene's own folder are read: a scheme, an absolute
    /// path, a `..` or a symbolic link that leads out is refused.
    pub(super) fn read(&self, at: &str, uri: &str) -> Result<Vec<u8>, ImportError> {
        if let Some(data) = data(uri) {
            return decode_data(data).map_err(|what| ImportError::DataUri {
                file: self.file.into(),
                at: at.into(),
                what,
            });
        }
        let path = self.locate(at, uri)?;
        std::fs::read(&path).map_err(|source| ImportError::Read { file: path, source })
    }

    /// The same bytes, not yet in memory unless they stand in the URI.
    pub(super) fn open(&self, at: &str, uri: &str) -> Result<Store, ImportError> {
        if data(uri).is_some() {
            return self.read(at, uri).map(Store::memory);
        }
        let path = self.locate(at, uri)?;
        Store::open(&path).map_err(|source| ImportError::Read { file: path, source })
    }

    /// The file a URI refers to, if it may be read and is there.
    pub(super) fn find(&self, uri: &str) -> Option<PathBuf> {
        self.locate("", uri).ok()
    }

    /// The file of a name that is no URI, but stands in the scene as it is.
    pub(super) fn named(&self, at: &str, name: &str) -> Result<PathBuf, ImportError> {
        self.inside(at, name, name)
    }

    fn locate(&self, at: &str, uri: &str) -> Result<PathBuf, ImportError> {
        let refused = |why| ImportError::OutsideFolder {
            file: self.file.into(),
            at: at.into(),
            uri: shorten(uri),
            why,
        };
        if uri.split_once(':').is_some_and(|(before, _)| !before.contains(['/', '\\'])) {
            return Err(refused("names a scheme or a drive"));
        }
        let name = String::from_utf8(percent_decode(uri))
            .map_err(|_| refused("is not UTF-8 once decoded"))?;
        self.inside(at, uri, &name)
    }

    /// How many folders below the scene's the file lies that names others.
    fn depth(&self) -> usize {
        let below = parent(self.by).canonicalize().ok().and_then(|beside| {
            let folder = parent(self.file).canonicalize().ok()?;
            Some(beside.strip_prefix(folder).ok()?.components().count())
        });
        below.unwrap_or(0)
    }

    /// The file of this name; `uri` is how the scene spells it.
    fn inside(&self, at: &str, uri: &str, name: &str) -> Result<PathBuf, ImportError> {
        let outside = |why| ImportError::OutsideFolder {
            file: self.file.into(),
            at: at.into(),
            uri: shorten(uri),
            why,
        };
        let missing = || ImportError::MissingResource {
            file: self.file.into(),
            at: at.into(),
            uri: shorten(uri),
        };
        // Both separators count on every system, so that a file means the same everywhere.
        if name.starts_with(['/', '\\']) {
            return Err(outside("is an absolute path"));
        }
        if climbs_out(name, self.depth()) {
            return Err(outside("climbs out by \"..\""));
        }
        let is_relative =
            |part| matches!(part, Component::Normal(_) | Component::CurDir | Component::ParentDir);
        if !Path::new(name).components().all(is_relative) || name.contains('\0') {
            return Err(outside("is no relative path"));
        }
        let (folder, beside) = (parent(self.file), parent(self.by));
        // Some tools unpack such a path into a name that has backslashes in it.
        let target = beside.join(name.replace('\\', "/")).canonicalize();
        let target = target.or_else(|_| beside.join(name).canonicalize());
        let target = target.map_err(|source| match source.kind() {
            ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::InvalidFilename => {
                missing()
            }
            _ => ImportError::Read { file: beside.join(name), source },
        })?;
        let folder = folder
            .canonicalize()
            .map_err(|source| ImportError::Read { file: folder.to_path_buf(), source })?;
        if !target.starts_with(&folder) {
            return Err(outside("is a symbolic link that leads out of it"));
        }
        // A pipe or a device inside the folder could be read for ever.
        if target.is_file() { Ok(target) } else { Err(missing()) }
    }
}

/// The folder that a file stands in.
fn parent(file: &Path) -> &Path {
    match file.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Whether a path from a folder that lies so deep leads above what the depth is counted from.
fn climbs_out(name: &str, depth: usize) -> bool {
    let step = |depth: usize, part| match part {
        "" | "." => Some(depth),
        ".." => depth.checked_sub(1),
        _ => Some(depth + 1),
    };
    name.split(['/', '\\']).try_fold(depth, step).is_none()
}

/// A URI for a message: whole, unless it is absurdly long.
fn shorten(uri: &str) -> String {
    const LONGEST: usize = 200;
    if uri.chars().count() <= LONGEST {
        uri.to_owned()
    } else {
        uri.chars().take(LONGEST).chain("...".chars()).collect()
    }
}

/// What stands behind the scheme of a data URI.
fn data(uri: &str) -> Option<&str> {
    let (scheme, data) = uri.split_at_checked(5)?;
    scheme.eq_ignore_ascii_case("data:").then_some(data)
}

/// The body of `data:[media type][;base64],body` (RFC 2397). In base64, blanks and line ends count for
/// nothing, and any letter may be escaped.
fn decode_data(data: &str) -> Result<Vec<u8>, &'static str> {
    let (head, body) = data.split_once(',').ok_or("has no comma")?;
    let mut bytes = percent_decode(body);
    let last = head.rsplit_once(';').map(|(_, last)| last.trim());
    if !last.is_some_and(|last| last.eq_ignore_ascii_case("base64")) {
        return Ok(bytes);
    }
    bytes.retain(|byte| !byte.is_ascii_whitespace());
    std::str::from_utf8(&bytes).ok().and_then(decode_base64).ok_or("is not base64")
}

/// RFC 3986, section 2.1. A `%` that starts no pair of hex digits stands for itself: exporters
/// leave file names raw.
fn percent_decode(text: &str) -> Vec<u8> {
    let hex = |byte: Option<&u8>| byte.and_then(|b| (*b as char).to_digit(16));
    let bytes = text.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        match (bytes[at], hex(bytes.get(at + 1)), hex(bytes.get(at + 2))) {
            (b'%', Some(high), Some(low)) => {
                out.push((high * 16 + low) as u8);
                at += 3;
            }
            (byte, ..) => {
                out.push(byte);
                at += 1;
            }
        }
    }
    out
}

/// RFC 4648, sections 4 and 5, padding optional; `None` for any other character.
fn decode_base64(text: &str) -> Option<Vec<u8>> {
    let digits = text.trim_end_matches('=').as_bytes();
    if digits.len() % 4 == 1 || text.len() - digits.len() > 2 {
        return None;
    }
    let mut out = Vec::with_capacity(digits.len() / 4 * 3 + 2);
    for group in digits.chunks(4) {
        let mut bits = 0u32;
        for &digit in group {
            let value = match digit {
                b'A'..=b'Z' => digit - b'A',
                b'a'..=b'z' => digit - b'a' + 26,
                b'0'..=b'9' => digit - b'0' + 52,
                b'+' | b'-' => 62,
                b'/' | b'_' => 63,
                _ => return None,
            };
            bits = bits << 6 | u32::from(value);
        }
        bits <<= 6 * (4 - group.len());
        out.extend_from_slice(&bits.to_be_bytes()[1..group.len()]);
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_decodes_what_the_rfc_lists() {
        for (text, bytes) in [
            ("", ""),
            ("Zg==", "f"),
            ("Zm8=", "fo"),
            ("Zm9v", "foo"),
            ("Zm9vYg", "foob"),
            ("Zm9vYmFy", "foobar"),
        ] {
            assert_eq!(decode_base64(text).unwrap(), bytes.as_bytes());
        }
        assert_eq!(decode_base64("+/+/").unwrap(), [0xFB, 0xFF, 0xBF]);
        for bad in ["Z", "Zm9vY", "Zm9v====", "Z g=", "Zm\u{e9}v"] {
            assert_eq!(decode_base64(bad), None, "{bad}");
        }
    }

    #[test]
    fn percent_pairs_decode_and_stray_percents_stay() {
        assert_eq!(percent_decode("a%20b%2e%"), b"a b.%");
        assert_eq!(decode_data("text/plain,a%00b").unwrap(), b"a\0b");
        assert!(decode_data("no comma").is_err());
    }

    #[test]
    fn base64_is_read_escaped_broken_into_lines_and_with_letters_for_urls() {
        for body in ["+/+/Zg==", "-_-_Zg==", "%2B%2F%2b/Zg%3D%3D", " +/+/\r\n\tZg = =\n", "+/+/Zg"]
        {
            for head in ["image/png;base64", ";BASE64", "a/b;charset=x; base64 "] {
                let bytes = decode_data(&format!("{head},{body}"));
                assert_eq!(bytes.as_deref(), Ok(&[0xFB, 0xFF, 0xBF, b'f'][..]), "{head},{body}");
            }
        }
        assert_eq!(decode_data("base64,Zg=="), Ok(b"Zg==".to_vec()));
        assert_eq!(decode_data(";base64,Z%C3%A9"), Err("is not base64"));
        assert_eq!((data("DATA:,x"), data("dat\u{e9}:")), (Some(",x"), None));
    }

    #[test]
    fn only_the_scenes_own_folder_is_read() {
        let root = tempfile::tempdir().unwrap();
        let inside = root.path().join("scene");
        std::fs::create_dir_all(inside.join("deep")).unwrap();
        std::fs::write(root.path().join("secret.bin"), b"secret").unwrap();
        std::fs::write(inside.join("deep/my part.bin"), b"part").unwrap();
        let file = inside.join("a.gltf");
        let folder = Folder { file: &file, by: &file };
        assert_eq!(folder.read("buffer 0", "deep/my%20part.bin").unwrap(), b"part");
        assert_eq!(
            folder.read("buffer 0", "data:application/octet-stream;base64,Zm9v").unwrap(),
            b"foo"
        );
        for uri in ["deep\\my part.bin", "deep%5Cmy%20part.bin", ".\\deep/my part.bin"] {
            assert_eq!(folder.read("buffer 0", uri).unwrap(), b"part", "{uri}");
        }
        let secret = root.path().join("secret.bin");
        for uri in [
            "../secret.bin",
            "deep/../../secret.bin",
            "%2e%2e/secret.bin",
            "..\\secret.bin",
            secret.to_str().unwrap(),
            "file:///etc/passwd",
            "https://example.org/a.bin",
            "C:\\a.bin",
            "\\\\host\\a.bin",
            "a%00b",
        ] {
            let error = folder.read("buffer 0", uri).unwrap_err();
            assert!(matches!(error, ImportError::OutsideFolder { .. }), "{uri}: {error}");
            assert!(error.to_string().contains(&format!("{uri:?}")), "{error}");
        }
        for uri in ["none.bin", "deep", ""] {
            let error = folder.read("buffer 0", uri).unwrap_err();
            assert!(error.is_missing_input(), "{uri}: {error}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_link_may_point_inside_the_folder_but_not_out_of_it() {
        let root = tempfile::tempdir().unwrap();
        let inside = root.path().join("scene");
        std::fs::create_dir(&inside).unwrap();
        std::fs::write(root.path().join("secret.bin"), b"secret").unwrap();
        std::fs::write(inside.join("real.bin"), b"real").unwrap();
        std::os::unix::fs::symlink(inside.join("real.bin"), inside.join("near.bin")).unwrap();
        std::os::unix::fs::symlink(root.path().join("secret.bin"), inside.join("far.bin")).unwrap();
        let file = inside.join("a.gltf");
        let folder = Folder { file: &file, by: &file };
        assert_eq!(folder.read("buffer 0", "near.bin").unwrap(), b"real");
        assert!(matches!(
            folder.read("buffer 0", "far.bin"),
            Err(ImportError::OutsideFolder { .. })
        ));
    }
}
