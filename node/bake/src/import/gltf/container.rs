//! From a file's bytes to the glTF document and its binary chunk (glTF 2.0, section 4).

use std::borrow::Cow;
use std::ops::Range;
use std::path::Path;

use super::document::{Document, FirstVersion, Header};
use crate::import::error::ImportError;
use crate::import::store::Store;

const MAGIC: &[u8; 4] = b"glTF";
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";
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
    "EXT_texture_webp",
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
pub(super) fn split(
    file: &Path,
    store: &Store,
    notes: &mut Vec<String>,
) -> Result<Parts, ImportError> {
    let unreadable = |source| ImportError::unreadable(file, source);
    let head = store.read(0, store.length().min(HEAD_BYTES) as usize).map_err(unreadable)?;
    if head.starts_with(MAGIC) {
        return match split_glb(store, notes).map_err(unreadable)? {
            Ok(parts) => Ok(parts),
            Err(what) => Err(ImportError::Container { file: file.into(), what }),
        };
    }
    let text = if head.starts_with(BYTE_ORDER_MARK) { 3 } else { 0 };
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

/// The most bytes that padding adds to a chunk (section 4.4.3).
const MOST_PADDING: u64 = 3;

/// The inner error says what is wrong with the framing.
///
/// The chunks decide what there is, and the length in the header only tells what is no chunk any
/// more: writers forget to count padding in it, and others append bytes of their own.
fn split_glb(store: &Store, notes: &mut Vec<String>) -> std::io::Result<Result<Parts, String>> {
    let has = store.length();
    if has < HEADER_BYTES {
        return Ok(Err(format!("its header wants {HEADER_BYTES} bytes and the file has {has}")));
    }
    let [version, length] = words(store, 4)?;
    if version == 1 {
        return Ok(
            Err("it holds glTF 1.0 (container version 1), only glTF 2.0 can be read".into()),
        );
    }
    if version != 2 {
        return Ok(Err(format!("container version {version}, only version 2 can be read")));
    }
    let length = u64::from(length);
    let mut at = HEADER_BYTES;
    let (mut json, mut bin) = (None, None);
    while at < has {
        let chunk = chunk(store, at, bin.is_none())?;
        let is_behind = at >= length && json.is_some();
        let (body, kind) = match chunk {
            // Another file may stand there, or what a tool appends.
            Ok((_, kind)) if is_behind && (kind != CHUNK_BIN || bin.is_some()) => break,
            Ok(chunk) => chunk,
            Err(_) if is_behind => break,
            Err(what) => return Ok(Err(what)),
        };
        at = body.end;
        match kind {
            CHUNK_JSON if json.is_none() => json = Some(body),
            CHUNK_BIN if json.is_some() && bin.is_none() => bin = Some(body),
            _ if json.is_none() => return Ok(Err("its first chunk is not JSON".to_owned())),
            // Section 4.4.1: chunks of unknown type are to be ignored.
            _ => {}
        }
    }
    if length > has + MOST_PADDING {
        return Ok(Err(format!("its header claims {length} bytes and the file has {has}")));
    }
    if at < has {
        notes.push(format!("{} bytes behind the scene ignored", has - at));
    } else if length != has {
        notes
            .push(format!("its header claims {length} bytes and the file has {has}: all are read"));
    }
    let parts = json.map(|json| Parts { json, bin });
    Ok(parts.ok_or_else(|| "it has no JSON chunk".to_owned()))
}

/// Where the body of the chunk at a byte stands, and its kind. While a binary chunk is `awaited` it
/// may also stand behind padding that the chunk before does not count.
fn chunk(
    store: &Store,
    at: u64,
    awaited: bool,
) -> std::io::Result<Result<(Range<u64>, u32), String>> {
    let has = store.length();
    let mut start = at;
    let aligned = at.next_multiple_of(MOST_PADDING + 1);
    let stands = |at: u64, kind: u32| -> std::io::Result<bool> {
        Ok(has - at >= CHUNK_HEADER_BYTES && words(store, at)?[1] == kind)
    };
    if awaited
        && at != aligned
        && aligned < has
        && !stands(at, CHUNK_BIN)?
        && stands(aligned, CHUNK_BIN)?
    {
        start = aligned;
    }
    if has - start < CHUNK_HEADER_BYTES {
        return Ok(Err(format!("the file ends inside the chunk header at byte {start}")));
    }
    let [size, kind] = words(store, start)?;
    let body = start + CHUNK_HEADER_BYTES;
    let left = has - body;
    if u64::from(size) > left {
        let what = format!("the chunk at byte {start} claims {size} bytes and {left} are left");
        return Ok(Err(what));
    }
    Ok(Ok((body..body + u64::from(size), kind)))
}

/// Two little-endian words.
fn words(store: &Store, at: u64) -> std::io::Result<[u32; 2]> {
    let bytes = store.read(at, 8)?;
    let words = bytes.as_chunks::<4>().0;
    Ok([0, 1].map(|place| u32::from_le_bytes(words[place])))
}

/// Parses the JSON, once it is known that its version and extensions can be understood.
pub(super) fn parse(
    file: &Path,
    json: &[u8],
    notes: &mut Vec<String>,
) -> Result<Document, ImportError> {
    let malformed = |source| ImportError::Json { file: file.into(), source };
    // Some writers fill a chunk up with zeros.
    let json = json.strip_prefix(BYTE_ORDER_MARK).unwrap_or(json);
    let zeros = json.iter().rev().take_while(|&&byte| byte == 0).count();
    let json = String::from_utf8_lossy(&json[..json.len() - zeros]);
    if let Cow::Owned(_) = json {
        notes.push("its JSON holds bytes that are no UTF-8, they are replaced".into());
    }
    let header: Header = match serde_json::from_str(&json) {
        Ok(header) => header,
        Err(_) if is_first_version(&json) => return Err(other_version(file, "1.0")),
        Err(source) => return Err(malformed(source)),
    };
    let version = match (&header.asset.min_version, &header.asset.version) {
        (Some(least), _) => least,
        (None, Some(version)) => version,
        (None, None) if is_first_version(&json) => return Err(other_version(file, "1.0")),
        (None, None) => {
            return Err(invalid(file, "it names no version", "export the file again"));
        }
    };
    let readable = match &header.asset.min_version {
        Some(least) => least == "2.0",
        None => version == "2" || version.starts_with("2."),
    };
    if !readable {
        return Err(other_version(file, version));
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
    serde_json::from_str(&json).map_err(malformed)
}

fn is_first_version(json: &str) -> bool {
    serde_json::from_str(json).is_ok_and(|document: FirstVersion| document.has_tables())
}

fn other_version(file: &Path, version: &str) -> ImportError {
    let what = format!("glTF version {version:?} is needed and only 2.0 is supported");
    invalid(file, &what, "export as glTF 2.0")
}

fn invalid(file: &Path, what: &str, fix: &'static str) -> ImportError {
    ImportError::Invalid { file: file.into(), at: "asset".into(), what: what.into(), fix }
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
        "EXT_texture_avif" | "MSFT_texture_dds" => {
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
        split(Path::new("a.glb"), &Store::memory(bytes.to_vec()), &mut Vec::new())
    }

    fn split_error(bytes: &[u8]) -> String {
        parts(bytes).unwrap_err().to_string()
    }

    fn parse_error(json: &str) -> String {
        parse(Path::new("a.gltf"), json.as_bytes(), &mut Vec::new()).err().unwrap().to_string()
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
        longer[8..12].copy_from_slice(&(whole.len() as u32 + 4).to_le_bytes());
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
    fn the_chunks_decide_where_a_length_is_off() {
        let split = |bytes: &[u8]| {
            let mut notes = Vec::new();
            let parts = split(Path::new("a.glb"), &Store::memory(bytes.to_vec()), &mut notes);
            (parts.unwrap(), notes.join("; "))
        };
        let whole = glb("{}", b"12345678");
        let parts = Parts { json: 20..24, bin: Some(32..40) };
        for behind in [&b"\0"[..], &[0; 64], b"1234567", b"\x04\0\0\0JUNK1234", &whole] {
            let (found, notes) = split(&[&whole, behind].concat());
            assert_eq!(found, parts);
            assert_eq!(notes, format!("{} bytes behind the scene ignored", behind.len()));
        }
        for claimed in [0, 24, 37, 39, 41, 43u32] {
            let mut other = whole.clone();
            other[8..12].copy_from_slice(&claimed.to_le_bytes());
            let (found, notes) = split(&other);
            assert_eq!(found, parts, "{claimed}");
            assert!(notes.contains("its header claims"), "{notes}");
        }
        // The last chunk without its padding.
        let mut bare = whole.clone();
        bare.truncate(38);
        bare[24] = 6;
        assert_eq!(split(&bare).0, Parts { json: 20..24, bin: Some(32..38) });
        // The padding of the first chunk is there and not counted.
        let mut uncounted = whole.clone();
        uncounted[12] = 2;
        let (found, notes) = split(&uncounted);
        assert_eq!((found, notes.as_str()), (Parts { json: 20..22, bin: Some(32..40) }, ""));
    }

    #[test]
    fn text_may_be_marked_padded_with_zeros_and_broken() {
        let mut notes = Vec::new();
        let json = b"\xEF\xBB\xBF{\"asset\":{\"version\":2},\"nodes\":[{\"name\":\"T\xFCr\"}]}\0\0";
        let document = parse(Path::new("a.gltf"), json, &mut notes).unwrap();
        assert_eq!(document.nodes[0].name.as_deref(), Some("T\u{fffd}r"));
        assert!(notes.len() == 1 && notes[0].contains("no UTF-8"), "{notes:?}");
    }

    #[test]
    fn the_first_version_is_named_whatever_its_spelling() {
        for json in [
            r#"{"asset":{"version":1},"nodes":{"a":{}}}"#,
            r#"{"asset":{"version":1.0},"meshes":{}}"#,
            r#"{"asset":{"generator":"x"},"nodes":{"a":{}}}"#,
            r#"{"nodes":{"a":{}},"meshes":{},"scene":"s"}"#,
        ] {
            let message = parse_error(json);
            assert!(message.contains("glTF version \"1.0\" is needed"), "{message}");
        }
        let first = b"glTF\x01\0\0\0\x14\0\0\0\0\0\0\0\0\0\0\0";
        assert!(split_error(first).contains("glTF 1.0"));
        assert!(parse_error(r#"{"asset":{},"nodes":[]}"#).contains("names no version"));
        assert!(parse_error(r#"{"nodes":[]}"#).contains("malformed"));
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
            ("EXT_texture_avif", "cli png "),
            ("EXT_else", "without it"),
        ] {
            let json =
                format!(r#"{{"asset":{{"version":"2.0"}},"extensionsRequired":["{name}"]}}"#);
            let message = parse_error(&json);
            assert!(message.contains(name) && message.contains(command), "{message}");
        }
        let json = r#"{"asset":{"version":"2.0"},"extensionsRequired":["KHR_materials_unlit","KHR_texture_transform"]}"#;
        assert!(parse(Path::new("a.gltf"), json.as_bytes(), &mut Vec::new()).is_ok());
    }
}
