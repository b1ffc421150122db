//! Paths as text, without loss: on Unix a name is any bytes, and a message holds UTF-8.

use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Stands before each byte that is no UTF-8, written as two hexadecimal digits. No path holds it itself.
const ESCAPE: char = '\0';

/// `path` as text; a path in UTF-8 is its own text.
pub fn to_text(path: &Path) -> String {
    let mut text = String::new();
    for chunk in path.as_os_str().as_encoded_bytes().utf8_chunks() {
        text.push_str(chunk.valid());
        for byte in chunk.invalid() {
            write!(text, "{ESCAPE}{byte:02x}").expect("a string takes everything");
        }
    }
    text
}

/// The path that [`to_text`] wrote. Text that it did not write becomes some path, which is not there.
pub fn from_text(text: &str) -> PathBuf {
    let mut pieces = text.split(ESCAPE);
    let mut bytes = pieces.next().unwrap_or_default().as_bytes().to_vec();
    for piece in pieces {
        let escaped = piece.split_at_checked(2);
        let byte = escaped.and_then(|(digits, _)| u8::from_str_radix(digits, 16).ok());
        bytes.push(byte.unwrap_or_default());
        bytes.extend_from_slice(byte.and(escaped).map_or(piece, |(_, rest)| rest).as_bytes());
    }
    path_of(bytes)
}

#[cfg(unix)]
fn path_of(bytes: Vec<u8>) -> PathBuf {
    use std::os::unix::ffi::OsStringExt;
    std::ffi::OsString::from_vec(bytes).into()
}

/// Elsewhere names are Unicode, but for halves of characters, which are lost.
#[cfg(not(unix))]
fn path_of(bytes: Vec<u8>) -> PathBuf {
    String::from_utf8_lossy(&bytes).into_owned().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_in_utf8_is_its_own_text() {
        for path in ["", "/tmp/plant.occ", "geb\u{e4}ude \u{1f3e0}.occ", "a\\x00ff%41"] {
            assert_eq!(to_text(Path::new(path)), path);
            assert_eq!(from_text(path), Path::new(path));
        }
    }

    #[test]
    #[cfg(unix)]
    fn any_bytes_come_back() {
        use std::os::unix::ffi::OsStrExt;
        let every: Vec<u8> = (1..=255).collect();
        for bytes in [&b"/a/geb\xe4ude.occ"[..], b"\xff", b"\xffab", b"\xc3\x28\xf0\x9f", &every] {
            let path = Path::new(std::ffi::OsStr::from_bytes(bytes));
            assert_eq!(from_text(&to_text(path)), path);
        }
        // Whatever a peer sends is a path.
        for text in ["\0", "\0f", "\0zz", "a\0\0ff", "\0\u{e4}b"] {
            assert!(from_text(text) != Path::new(""));
        }
    }
}
