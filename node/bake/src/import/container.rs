//! From a file's bytes to the glTF document and its binary chunk (glTF 2.0, section 4).

use std::ops::Range;
use std::path::Path;

use super::document::{Document, Header};
use super::error::ImportError;

const MAGIC: &[u8; 4] = b"glTF";
const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;
const CHUNK_JSON: u32 = 0x4E4F_534A;
const CHUNK_BIN: u32 = 0x004E_4942;

/// Extensions a file may require. An entry that ends in `*` stands for a family: materials change
/// how a surface shines, not where it is.
const SUPPORTED: &[&str] = &[
    "KHR_materials_*",
    "KHR_texture_transform",
    "KHR_mesh_quantization",
    "KHR_lights_punctual",
    "KHR_xmp_json_ld",
];

/// Where the parts of a scene file stand in its bytes.
#[derive(Debug, PartialEq)]
pub(super) struct Parts {
    pub(super) json: Range<usize>,
    pub(super) bin: Option<Range<usize>>,
}

/// Finds the JSON and the binary chunk in a `.glb` or `.gltf`, told apart by content.
pub(super) fn split(file: &Path, bytes: &[u8]) -> Result<Parts, ImportError> {
    if bytes.starts_with(MAGIC) {
        return split_glb(bytes).map_err(|what| ImportError::Container { file: file.into(), what });
    }
    let text = if bytes.starts_with(b"\xEF\xBB\xBF") { 3 } else { 0 };
    if bytes[text..].trim_ascii_start().first() == Some(&b'{') {
        return Ok(Parts { json: text..bytes.len(), bin: None });
    }
    let what = match bytes.len() {
        0 => "the file is empty".to_owned(),
        _ => format!(
            "this is neither GLB nor glTF JSON (it starts with {:?})",
            bytes[..bytes.len().min(8)].escape_ascii().to_string()
        ),
    };
    Err(ImportError::UnknownFormat { file: file.into(), what })
}

fn split_glb(bytes: &[u8]) -> Result<Parts, String> {
    let (Some(version), Some(length)) = (word(bytes, 4), word(bytes, 8)) else {
        return Err(format!(
            "its header wants {HEADER_BYTES} bytes and the file has {}",
            bytes.len()
        ));
    };
    if version != 2 {
        return Err(format!("container version {version}, only version 2 can be read"));
    }
    if length as usize != bytes.len() {
        return Err(format!("its header claims {length} bytes and the file has {}", bytes.len()));
    }
    let mut at = HEADER_BYTES;
    let (mut json, mut bin) = (None, None);
    while at < bytes.len() {
        let (Some(size), Some(kind)) = (word(bytes, at), word(bytes, at + 4)) else {
            return Err(format!("the file ends inside the chunk header at byte {at}"));
        };
        let start = at + CHUNK_HEADER_BYTES;
        let left = bytes.len() - start;
        if size as usize > left {
            return Err(format!("the chunk at byte {at} claims {size} bytes and {left} are left"));
        }
        let body = start..start + size as usize;
        at = body.end;
        match kind {
            CHUNK_JSON if json.is_none() => json = Some(body),
            CHUNK_BIN if json.is_some() && bin.is_none() => bin = Some(body),
            _ if json.is_none() => return Err("its first chunk is not JSON".to_owned()),
            // Section 4.4.1: chunks of unknown type are to be ignored.
            _ => {}
        }
    }
    json.map(|json| Parts { json, bin }).ok_or_else(|| "it has no JSON chunk".to_owned())
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk::<4>().map(|four| u32::from_le_bytes(*four))
}

/// Parses the JSON, once it is known that its version and extensions can be understood.
pub(super) fn parse(file: &Path, json: &[u8]) -> Result<Document, ImportError> {
    let malformed = |source| ImportError::Json { file: file.into(), source };
    let header: Header = serde_json::from_slice(json).map_err(malformed)?;
    let wanted = header.asset.min_version.as_ref().unwrap_or(&header.asset.version);
    let readable = match &header.asset.min_version {
        Some(least) => least == "2.0",
        None => header.asset.version.starts_with("2."),
    };
    if !readable {
        return Err(ImportError::Invalid {
            file: file.into(),
            at: "asset".into(),
            what: format!("glTF version {wanted:?} is needed and only 2.0 is supported"),
            fix: "export as glTF 2.0",
        });
    }
    let unsupported: Vec<&str> = header
        .extensions_required
        .iter()
        .map(String::as_str)
        .filter(|name| !is_supported(name))
        .collect();
    if !unsupported.is_empty() {
        return Err(ImportError::RequiredExtension {
            file: file.into(),
            names: unsupported.join(", "),
            supported: SUPPORTED.join(", "),
        });
    }
    serde_json::from_slice(json).map_err(malformed)
}

/// Whether an extension may be required by a file, because its meaning is honoured or does not
/// touch geometry and base colour.
pub(super) fn is_supported(extension: &str) -> bool {
    SUPPORTED.iter().any(|known| match known.strip_suffix('*') {
        Some(family) => extension.starts_with(family),
        None => extension == *known,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::testing::glb;

    fn split_error(bytes: &[u8]) -> String {
        split(Path::new("a.glb"), bytes).unwrap_err().to_string()
    }

    fn parse_error(json: &str) -> String {
        parse(Path::new("a.gltf"), json.as_bytes()).err().unwrap().to_string()
    }

    #[test]
    fn what_is_no_scene_is_refused() {
        assert!(split_error(b"").contains("empty"));
        assert!(split_error(b"ply\nformat").contains("neither GLB nor glTF"));
        assert!(split_error(b"glTF\x02\0").contains("header wants 12 bytes"));
    }

    #[test]
    fn every_truncation_and_every_false_length_is_refused() {
        let whole = glb("{}", b"12345678");
        assert!(split(Path::new("a.glb"), &whole).is_ok());
        for end in 4..whole.len() {
            assert!(split_error(&whole[..end]).contains("broken GLB"), "cut at {end}");
        }
        let mut longer = whole.clone();
        longer.push(0);
        assert!(split_error(&longer).contains("claims"));
        let mut chunk = whole.clone();
        chunk[12] = 0xFF;
        assert!(split_error(&chunk).contains("chunk at byte 12 claims"));
        let mut version = whole;
        version[4] = 1;
        assert!(split_error(&version).contains("version 1"));
    }

    #[test]
    fn chunks_are_found() {
        let bytes = glb("{}", b"12345678");
        let parts = split(Path::new("a.glb"), &bytes).unwrap();
        assert_eq!(&bytes[parts.json], b"{}  ");
        assert_eq!(&bytes[parts.bin.unwrap()], b"12345678");
        assert_eq!(
            split(Path::new("a.gltf"), b"\xEF\xBB\xBF {}").unwrap(),
            Parts { json: 3..6, bin: None }
        );
    }

    #[test]
    fn versions_and_required_extensions_gate_the_rest() {
        assert!(parse_error("{").contains("malformed"));
        assert!(parse_error(r#"{"asset":{"version":"1.0"},"nodes":{}}"#).contains("\"1.0\""));
        assert!(
            parse_error(r#"{"asset":{"version":"2.0","minVersion":"2.1"}}"#).contains("\"2.1\"")
        );
        let message = parse_error(
            r#"{"asset":{"version":"2.0"},"extensionsRequired":["KHR_draco_mesh_compression"],"nodes":{}}"#,
        );
        assert!(
            message.contains("KHR_draco_mesh_compression")
                && message.contains("KHR_mesh_quantization"),
            "{message}"
        );
        let json = r#"{"asset":{"version":"2.0"},"extensionsRequired":["KHR_materials_unlit","KHR_texture_transform"]}"#;
        assert!(parse(Path::new("a.gltf"), json.as_bytes()).is_ok());
    }
}
