//! PLY, as text or binary of either byte order (Turk 1994, *The PLY Polygon File Format*): one mesh.
//!
//! Vertices may have normals, colours and texture coordinates; faces are polygons of any size or strips of triangles,
//! and may have colours and texture coordinates of their own. Colours are taken as sRGB-encoded, as scanners and
//! modellers write them. Everything else is read past. In text an element stands in a line, and what is left of that
//! is not read; where there are fewer lines than elements, numbers follow each other as they come.

mod cloud;
mod header;
mod values;

use std::io::{self, BufRead, BufReader};
use std::path::{Path, PathBuf};

use self::cloud::{Cloud, FaceSlots, VertexSlots};
use self::header::{Encoding, Kind};
use self::values::{ValueError, Values};
use super::emit::Emitter;
use super::error::ImportError;
use super::text::words;
use super::uri::Folder;
use crate::source::Imported;

/// Scanners and modellers take z for up; the format itself does not say.
const UP: [f64; 3] = [0.0, 0.0, 1.0];

/// Reads the scene file at `path`.
pub(super) fn import(path: &Path, out: Emitter<'_>) -> Result<Imported, ImportError> {
    read(path, || Ok(BufReader::new(super::open::open(path)?)), out)
}

/// The pictures that the scene file at `path` refers to, whatever its importer makes of them.
pub(super) fn references(path: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let unreadable = |source| ImportError::unreadable(path, source);
    let reader = BufReader::new(super::open::open(path).map_err(unreadable)?);
    match header::read(reader) {
        Ok(header) => {
            Ok(header.textures.iter().filter_map(|name| picture(path, name).ok()).collect())
        }
        Err(ValueError::Io(source)) => Err(unreadable(source)),
        // The importer's to judge.
        Err(ValueError::Broken(_) | ValueError::Import(_)) => Ok(Vec::new()),
    }
}

/// The file of a texture's name.
fn picture(scene: &Path, name: &str) -> Result<PathBuf, ImportError> {
    Folder { file: scene, by: scene }.named("header", &name.replace('\\', "/"))
}

/// `open` opens the file at its beginning.
fn read<R: BufRead>(
    file: &Path,
    open: impl Fn() -> io::Result<R>,
    mut out: Emitter<'_>,
) -> Result<Imported, ImportError> {
    let invalid =
        |at: String, what: String, fix| ImportError::Invalid { file: file.into(), at, what, fix };
    let broken = |at: String, what: String| invalid(at, what, "export or copy the file again");
    let unreadable = |source| ImportError::unreadable(file, source);
    let fault = |at: &str, error: ValueError| match error {
        ValueError::Io(source) => unreadable(source),
        ValueError::Broken(what) => broken(at.to_owned(), what),
        ValueError::Import(error) => error.of(file),
    };
    let mut reader = open().map_err(unreadable)?;
    let header = header::read(&mut reader).map_err(|error| fault("header", error))?;
    if header.has_no_faces() {
        return Err(invalid(
            "header".into(),
            "it has vertices and no faces: it is a point cloud".into(),
            "make a surface of it first, for example with MeshLab or CloudCompare",
        ));
    }
    let by_line = header.encoding == Encoding::Text
        && lines(&mut reader).map_err(unreadable)? >= header.lines();
    if header.encoding == Encoding::Text {
        // Its lines have been counted.
        reader = open().map_err(unreadable)?;
        header::read(&mut reader).map_err(|error| fault("header", error))?;
    }

    let mut values = Values::new(reader, header.encoding, by_line);
    let mut cloud = Cloud::new(&header);
    for element in &header.elements {
        let at = |place: u64| format!("{} {place}", element.name);
        // An element without properties takes no bytes, however many there are.
        let count = if element.properties.is_empty() { 0 } else { element.count };
        let vertex = VertexSlots::of(element);
        let face = FaceSlots::of(element);
        if element.kind() == Kind::Vertex {
            vertex.check().map_err(|what| broken("header".into(), what))?;
        }
        for place in 0..count {
            let read = values.begin().and_then(|()| match element.kind() {
                Kind::Vertex => cloud.vertex(&vertex, element, &mut values),
                Kind::Face => cloud.face(&face, element, &mut values),
                Kind::Strips => cloud.strips(element, &mut values),
                Kind::Other => element.properties.iter().try_for_each(|p| values.skip(p)),
            });
            read.map_err(|error| fault(&at(place), error))?;
        }
    }
    // What follows the last element.
    values.begin().map_err(|error| fault("end", error))?;
    let leftover = values.leftover_lines();
    let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let made = cloud.finish(file, &name, &header.textures, &mut out)?;
    let mut notes = made.notes;
    if leftover > 0 {
        notes.push(format!(
            "{leftover} lines longer than the header says, the rest of them ignored"
        ));
    }
    let mesh = out.mesh(made.draft)?;
    out.finish(vec![super::place::placed(name, mesh, made.origin)], UP, notes)
}

/// Lines with something in them, to the end.
fn lines(reader: &mut impl BufRead) -> io::Result<u64> {
    let (mut count, mut is_blank) = (0, true);
    loop {
        let bytes = reader.fill_buf()?;
        if bytes.is_empty() {
            return Ok(count);
        }
        for byte in bytes {
            match byte {
                b'\n' | b'\r' => is_blank = true,
                byte if is_blank && !byte.is_ascii_whitespace() => {
                    is_blank = false;
                    count += 1;
                }
                _ => {}
            }
        }
        let read = bytes.len();
        reader.consume(read);
    }
}

/// The name behind the words that name a texture, if these words do.
fn texture_name(comment: &[u8]) -> Option<String> {
    let word = words(comment).next()?;
    let name = &comment[word.len()..].trim_ascii();
    let is_texture = word.eq_ignore_ascii_case(b"TextureFile") && !name.is_empty();
    is_texture.then(|| String::from_utf8_lossy(name).into_owned())
}

#[cfg(test)]
mod tests;
