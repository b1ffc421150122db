//! Buffer views compressed by meshoptimizer (EXT_meshopt_compression, and KHR_meshopt_compression,
//! which adds a newer vertex codec and a filter for colours).
//!
//! Exporters put the vertices of a whole scene into a few such views, so each is decoded once, and
//! what comes out is held in memory only while it is small.

use std::io::{Seek, Write};

use geometry::codec::{self, Filter};

use super::buffers::Resources;
use super::document::Compression;
use crate::import::error::ImportError;
use crate::import::store::Store;

/// Decoded bytes that are held in memory; more go to a file that has no name.
const MEMORY_BYTES: usize = 32 << 20;

/// By number of a view, where it stands in the store: start and length.
type Places = Vec<Option<(u64, u64)>>;

/// Decodes every compressed view of the document; `None` if there is none.
pub(super) fn decode_all(
    resources: &Resources<'_>,
) -> Result<Option<(Store, Places)>, ImportError> {
    let views = &resources.document.buffer_views;
    if views.iter().all(|view| view.extensions.compression().is_none()) {
        return Ok(None);
    }
    let unwritten = |source| ImportError::Sink { file: resources.file.into(), source };
    let mut out = tempfile::spooled_tempfile(MEMORY_BYTES);
    let mut places = Vec::with_capacity(views.len());
    for (number, view) in views.iter().enumerate() {
        let Some(meshopt) = view.extensions.compression() else {
            places.push(None);
            continue;
        };
        let bytes = decode(resources, number, meshopt)?;
        let start = out.stream_position().map_err(unwritten)?;
        out.write_all(&bytes).map_err(unwritten)?;
        places.push(Some((start, bytes.len() as u64)));
    }
    Ok(Some((Store::new(out).map_err(unwritten)?, places)))
}

fn decode(
    resources: &Resources<'_>,
    number: usize,
    meshopt: &Compression,
) -> Result<Vec<u8>, ImportError> {
    let at = format!("buffer view {number}");
    let Compression { buffer, byte_offset, byte_length, byte_stride, count, .. } = *meshopt;
    let span = resources.part(&at, number, buffer, byte_offset, byte_length)?;
    let encoded = resources.bytes(span)?;
    let unknown = |what: &str, name: &str| {
        let what = format!("its compression has the unknown {what} {name:?}");
        let fix = "decompress it: npx @gltf-transform/cli copy IN.glb OUT.glb";
        resources.invalid(at.clone(), what, fix)
    };
    let filter = match meshopt.filter.as_deref() {
        None | Some("NONE") => None,
        Some("OCTAHEDRAL") => Some(Filter::Octahedral),
        Some("QUATERNION") => Some(Filter::Quaternion),
        Some("EXPONENTIAL") => Some(Filter::Exponential),
        Some("COLOR") => Some(Filter::Color),
        Some(other) => return Err(unknown("filter", other)),
    };
    let decoded = match meshopt.mode.as_str() {
        "ATTRIBUTES" => codec::decode_vertices(&encoded, count, byte_stride, filter),
        "TRIANGLES" => codec::decode_triangles(&encoded, count, byte_stride),
        "INDICES" => codec::decode_indices(&encoded, count, byte_stride),
        other => return Err(unknown("mode", other)),
    };
    decoded.map_err(|error| resources.broken(&at, error.to_string()))
}
