//! Which other files a scene file refers to: a quick look, before anything is imported.

use serde::Deserialize;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::error::ImportError;
use super::format::Format;
use super::open::open;
use super::text::BYTE_ORDER_MARK;
use super::uri::Folder;
use super::{obj, ply};

/// What names other files in a glTF document.
#[derive(Deserialize)]
struct Names {
    #[serde(default)]
    buffers: Vec<Name>,
    #[serde(default)]
    images: Vec<Name>,
}

#[derive(Deserialize)]
struct Name {
    uri: Option<String>,
}

/// The files that `path` refers to and that its importer may read, in the order they are named; those
/// that its importer would refuse are left out, as is everything in a file that cannot be understood.
///
/// # Errors
///
/// Where the file itself cannot be read.
pub fn references(path: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let unreadable = |source| ImportError::unreadable(path, source);
    match Format::of(path)? {
        Format::Obj => obj::references(path),
        Format::Ply => ply::references(path),
        Format::Stl => Ok(Vec::new()),
        Format::Gltf => in_gltf(path).map_err(unreadable),
    }
}

fn in_gltf(path: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut file = open(path)?;
    let mut head = Vec::new();
    file.by_ref().take(20).read_to_end(&mut head)?;
    let (start, length) = match head.first_chunk::<20>() {
        // The length of a GLB's first chunk (glTF 2.0, section 4.4.3).
        Some([b'g', b'l', b'T', b'F', .., a, b, c, d, _, _, _, _]) => {
            (20, u64::from(u32::from_le_bytes([*a, *b, *c, *d])))
        }
        _ if head.starts_with(BYTE_ORDER_MARK) => (BYTE_ORDER_MARK.len() as u64, u64::MAX),
        _ => (0, u64::MAX),
    };
    file.seek(SeekFrom::Start(start))?;
    // Most files name no other, and parsing a large one takes as long as all of its import.
    if !may_name_files(&mut file.by_ref().take(length))? {
        return Ok(Vec::new());
    }
    file.seek(SeekFrom::Start(start))?;
    let json = serde_json::from_reader(BufReader::new(file.take(length)));
    let Ok(Names { buffers, images }) = json else { return Ok(Vec::new()) };
    let names = buffers.into_iter().chain(images).filter_map(|name| name.uri);
    let external = names.filter(|uri| !uri.starts_with("data:"));
    Ok(external.filter_map(|uri| Folder { file: path, by: path }.find(&uri)).collect())
}

/// Whether a JSON text can have a member "uri": the word stands there, or letters are escaped.
fn may_name_files(json: &mut impl Read) -> std::io::Result<bool> {
    const WORD: &[u8] = b"\"uri\"";
    let mut block = vec![0; 1 << 16];
    // The end of what was read before, lest the word be cut in two.
    let mut kept = 0;
    loop {
        let read = json.read(&mut block[kept..])?;
        if read == 0 {
            return Ok(false);
        }
        let text = &block[..kept + read];
        let is_escape = |two: &[u8]| two == b"\\u";
        if text.windows(WORD.len()).any(|word| word == WORD) || text.windows(2).any(is_escape) {
            return Ok(true);
        }
        let end = text.len();
        kept = end.min(WORD.len() - 1);
        block.copy_within(end - kept..end, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_names_its_files() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        write("a b.png", b"");
        write("m.mtl", b"newmtl x\nmap_Kd -clamp on k.png\nmap_Kd C:\\\\x\\\\a b.png\n");
        write("k.png", b"");
        let names = |path: &Path| -> Vec<String> {
            let all = references(path).unwrap();
            all.iter().map(|p| p.file_name().unwrap().to_string_lossy().into_owned()).collect()
        };
        let json = br#"{"images":[{"uri":"a%20b.png"},{"uri":"data:,x"},{"uri":"../up.png"}]}"#;
        assert_eq!(names(&write("s.gltf", json)), ["a b.png"]);
        let escaped = br#"{"images":[{"\u0075ri":"k.png"}]}"#;
        assert_eq!(names(&write("t.gltf", escaped)), ["k.png"]);
        // The word may lie on the border of two blocks.
        for pad in 65_515..65_535 {
            let long = format!("{}{}", " ".repeat(pad), r#"{"images":[{"uri":"k.png"}]}"#);
            assert_eq!(names(&write("u.gltf", long.as_bytes())), ["k.png"], "{pad}");
        }
        let mut glb = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        glb.extend((json.len() as u32).to_le_bytes());
        glb.extend(b"JSON");
        glb.extend(json);
        glb.extend(b"more");
        assert_eq!(names(&write("s.glb", &glb)), ["a b.png"]);
        assert_eq!(
            names(&write("s.obj", b"mtllib m.mtl\nv 0 0 0\n")),
            ["m.mtl", "k.png", "a b.png"]
        );
        assert!(names(&write("s.ply", b"ply\n")).is_empty());
        assert!(names(&write("broken.gltf", b"{\"images\":[{")).is_empty());
        assert!(references(&folder.path().join("none.glb")).is_err());
    }
}
