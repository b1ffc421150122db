//! From a file's bytes to the glTF document and its binary chunk (glTF 2.0, section 4).

use std::ops::Range;
use std::path::Path;

use super::document::{Document, Header};
use crate::import::error::ImportError;
use crate::import::store::Store;

const MAGIC: &[u8; 4] = b"glTF";
const HEADER_BYTES: u64 = 12;
const CHUNK_HEADER_BYTES: u64 = 8;
/// Bytes at the start of a file that tell what it is.
const HEAD_BYTES: u64 = 4096;
const CHUNK_JSON: u32 = 0x4E4F_534A;
const CHUNK_BIN: u32 = 0x004E_4942;

/// Extensions a file may require. An entry that ends in `*` stands for a family: materials change
/// how a surface shines, not where it is.
const SUPPORTED: &[&str] = &[
    "KHR_materials_*",
    "KHR_texture_transform",
    "KHR_mesh_quantization",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_xmp_json_ld",
];

/// Where the parts of a scene file stand in its bytes.
#[derive(Debug, PartialEq)]
pub(super) struct Parts {
    pub(super) json: Range<u64>,
    pub(super) bin: Option<Range<u64>>,
}

/// Finds the JSON and the binary chunk in a `.glb` or `.gltf`, told apart by content.
pub(super) fn split(file: &Path, store: &Store) -> Result<Parts, ImportError> {
    let unreadable = |source| ImportError::unreadable(file, source);
    let head = store.read(0, store.length().min(HEAD_BYTES) as usize).map_err(unreadable)?;
    if head.starts_with(MAGIC) {
        return match split_glb(store).map_err(unreadable)? {
            Ok(parts) => Ok(parts),
            Err(what) => Err(ImportError::Container { file: file.into(), what }),
        };
    }
    let text = if head.starts_with(b"\xEF\xBB\xBF") { 3 } else { 0 };
    if head[text..].trim_ascii_start().first() == Some(&b'{') {
        return Ok(Parts { json: text as u64..store.length(), bin: None });
    }
    let what = match head.len() {
        0 => "the file is empty".to_owned(),
        _ => format!(
            "this is neither GLB nor glTF JSON (it starts with {:?})",
            head[..head.len().min(8)].escape_ascii().to_string()
        ),
    };
    Err(ImportError::UnknownFormat { file: file.into(), what })
}

/// The inner error says what is wrong with the framing.
fn split_glb(store: &Store) -> std::io::Result<Result<Parts, String>> {
    let has = store.length();
    if has < HEADER_BYTES {
        return Ok(Err(format!("its header wants {HEADER_BYTES} bytes and the file has {has}")));
    }
    let [version, length] = words(store, 4)?;
    if version != 2 {
        return Ok(Err(format!("container version {version}, only version 2 can be read")));
    }
    if u64::from(length) != has {
        return Ok(Err(format!("its header claims {length} bytes and the file has {has}")));
    }
    let mut at = HEADER_BYTES;
    let (mut json, mut bin) = (None, None);
    while at < has {
        if has - at < CHUNK_HEADER_BYTES {
            return Ok(Err(format!("the file ends inside the chunk header at byte {at}")));
        }
        let [size, kind] = words(store, at)?;
        let start = at + CHUNK_HEADER_BYTES;
        let left = has - start;
        if u64::from(size) > left {
            let what = format!("the chunk at byte {at} claims {size} bytes and {left} are left");
            return Ok(Err(what));
        }
        let body = start..start + u64::from(size);
        at = body.end;
        match kind {
            CHUNK_JSON if json.is_none() => json = Some(body),
            CHUNK_BIN if json.is_some() && bin.is_none() => bin = Some(body),
            _ if json.is_none() => return Ok(Err("its first chunk is not JSON".to_owned())),
            // Section 4.4.1: chunks of unknown type are to be ignored.
            _ => {}
        }
    }
    let parts = json.map(|json| Parts { json, bin });
    Ok(parts.ok_or_else(|| "it has no JSON chunk".to_owned()))
}

/// Two little-endian words.
fn words(store: &Store, at: u64) -> std::io::Result<[u32; 2]> {
    let bytes = store.read(at, 8)?;
    let words = bytes.as_chunks::<4>().0;
    Ok([0, 1].map(|place| u32::from_le_bytes(words[place])))
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
            fix: without(unsupported[0]),
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

/// How to be rid of an extension.
fn without(extension: &str) -> &'static str {
    match extension {
        "KHR_draco_mesh_compression" => {
            "decompress it: npx @gltf-transform/cli copy IN.glb OUT.glb"
        }
        "KHR_texture_basisu" => {
            "convert its textures: npx @gltf-transform/cli ktxdecompress IN.glb OUT.glb"
        }
        "EXT_texture_webp" | "EXT_texture_avif" | "MSFT_texture_dds" => {
            "convert its textures: npx @gltf-transform/cli png IN.glb OUT.glb"
        }
        _ => "export without it",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::gltf::testing::glb;

    fn parts(bytes: &[u8]) -> Result<Parts, ImportError> {
        split(Path::new("a.glb"), &Store::memory(bytes.to_vec()))
    }

    fn split_error(bytes: &[u8]) -> String {
        parts(bytes).unwrap_err().to_string()
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
        assert!(parts(&whole).is_ok());
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
        assert_eq!(parts(&bytes).unwrap(), Parts { json: 20..24, bin: Some(32..40) });
        assert_eq!(parts(b"\xEF\xBB\xBF {}").unwrap(), Parts { json: 3..6, bin: None });
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
                && message.contains("cli copy ")
                && message.contains("KHR_mesh_quantization"),
            "{message}"
        );
        for (name, command) in [
            ("KHR_texture_basisu", "cli ktxdecompress "),
            ("EXT_texture_webp", "cli png "),
            ("EXT_texture_avif", "cli png "),
            ("EXT_else", "without it"),
        ] {
            let json =
                format!(r#"{{"asset":{{"version":"2.0"}},"extensionsRequired":["{name}"]}}"#);
            let message = parse_error(&json);
            assert!(message.contains(name) && message.contains(command), "{message}");
        }
        let json = r#"{"asset":{"version":"2.0"},"extensionsRequired":["KHR_materials_unlit","KHR_texture_transform"]}"#;
        assert!(parse(Path::new("a.gltf"), json.as_bytes()).is_ok());
    }
}
