//! Wavefront OBJ with MTL materials (Wavefront, *Advanced Visualizer Manual*, appendix B1): polygons
//! only.
//!
//! Each object or group makes one mesh. Vertices are numbered through the whole file, so all of them
//! are in memory; faces are so only until their object ends. Colours are taken as sRGB-encoded.

mod library;
mod map;
mod mesh;

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use glam::DVec3;

use self::library::Library;
use self::mesh::{Corner, Faces};
use super::emit::Emitter;
use super::error::ImportError;
use super::picture::linear_of;
use super::place;
use super::polygon::triangulate;
use super::text::{LineError, Lines, excerpt, number, words};
use crate::source::{Imported, SourceObject};

/// What modellers write; the format itself does not say.
const UP: [f64; 3] = [0.0, 1.0, 0.0];

/// Reads the scene file at `path`, and the material libraries and textures it refers to.
pub(super) fn import(path: &Path, out: Emitter<'_>) -> Result<Imported, ImportError> {
    let file = File::open(path).map_err(|source| ImportError::unreadable(path, source))?;
    read(path, BufReader::new(file), out)
}

fn read(file: &Path, reader: impl BufRead, out: Emitter<'_>) -> Result<Imported, ImportError> {
    let mut scene = Scene {
        file,
        out,
        pool: Pool::default(),
        library: Library::new(file),
        name: None,
        faces: Faces::default(),
        objects: Vec::new(),
        counts: Counts::default(),
    };
    let mut lines = Lines::new(reader);
    loop {
        let at = |line: u64| format!("line {line}");
        match lines.next(true) {
            Ok(Some((number, line))) => {
                scene.line(number, line).map_err(|fault| match fault {
                    Fault::Import(error) => error,
                    Fault::Line(why) => {
                        scene.broken(at(number), format!("\"{}\": {why}", excerpt(line)))
                    }
                })?;
            }
            Ok(None) => break,
            Err(LineError::Io(source)) => return Err(ImportError::unreadable(file, source)),
            Err(LineError::TooLong { line }) => {
                return Err(scene.broken(at(line), "it is too long".into()));
            }
        }
    }
    scene.end_object()?;
    scene.finish()
}

/// Why a line cannot be taken.
enum Fault {
    /// Said in full.
    Import(ImportError),
    /// What is wrong with the line.
    Line(String),
}

impl From<ImportError> for Fault {
    fn from(error: ImportError) -> Self {
        Self::Import(error)
    }
}

impl From<String> for Fault {
    fn from(why: String) -> Self {
        Self::Line(why)
    }
}

/// Numbered from the start of the file.
#[derive(Default)]
pub(super) struct Pool {
    points: Vec<DVec3>,
    /// Linear; as many as `points`, or fewer where the last ones have none.
    colors: Vec<[f32; 3]>,
    /// With (0, 0) in the bottom left corner.
    tex_coords: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
}

/// What was left out or mended.
#[derive(Default)]
struct Counts {
    degenerate: u64,
    mended_normals: u64,
    too_few: u64,
    points_and_lines: u64,
    curves: u64,
}

/// The file as far as it has been read.
struct Scene<'a, 's> {
    file: &'a Path,
    out: Emitter<'s>,
    pool: Pool,
    library: Library<'a>,
    /// Of the present object.
    name: Option<String>,
    faces: Faces,
    objects: Vec<SourceObject>,
    counts: Counts,
}

impl Scene<'_, '_> {
    fn line(&mut self, at: u64, line: &[u8]) -> Result<(), Fault> {
        let mut words = words(line);
        let Some(word) = words.next() else { return Ok(()) };
        let rest = || String::from_utf8_lossy(line[word.len()..].trim_ascii()).into_owned();
        match word {
            b"v" => self.vertex(words)?,
            b"vt" => {
                let [u, v] = numbers(words, [0.0; 2])?;
                self.pool.tex_coords.push([u as f32, v as f32]);
            }
            b"vn" => {
                let normal = numbers(words, [f64::NAN; 3])?;
                self.pool.normals.push(normal.map(|lane| lane as f32));
            }
            b"f" | b"fo" => self.face(words)?,
            b"o" | b"g" => {
                self.end_object()?;
                self.name = Some(rest()).filter(|name| !name.is_empty());
            }
            b"usemtl" => {
                let material = self.library.used(&rest(), &mut self.out)?;
                self.faces.paint(material);
            }
            b"mtllib" => self.library.read(at, &rest())?,
            b"p" | b"l" => self.counts.points_and_lines += 1,
            b"curv" | b"curv2" | b"surf" => self.counts.curves += 1,
            // Smoothing groups, display attributes, parts of curves: nothing that shows here.
            _ if word.is_ascii() && word[0].is_ascii_alphabetic() || word[0] == b'#' => {}
            _ => return Err(Fault::Line("no line starts like this".into())),
        }
        Ok(())
    }

    fn vertex<'w>(&mut self, words: impl Iterator<Item = &'w [u8]>) -> Result<(), String> {
        let all: Vec<f64> = words.map(finite).collect::<Result<_, _>>()?;
        let (point, color) = match all[..] {
            [x, y, z] | [x, y, z, _] => ([x, y, z], None),
            [x, y, z, r, g, b] | [x, y, z, _, r, g, b] => ([x, y, z], Some([r, g, b])),
            _ => return Err(format!("{} numbers make no vertex", all.len())),
        };
        if let Some(color) = color {
            self.pool.colors.resize(self.pool.points.len(), [1.0; 3]);
            self.pool.colors.push(color.map(|lane| linear_of(lane.clamp(0.0, 1.0)) as f32));
        }
        self.pool.points.push(DVec3::from(point));
        Ok(())
    }

    fn face<'w>(&mut self, words: impl Iterator<Item = &'w [u8]>) -> Result<(), String> {
        let corners: Vec<Corner> = words.map(|word| self.corner(word)).collect::<Result<_, _>>()?;
        self.counts.too_few += u64::from(corners.len() < 3);
        let points: Vec<DVec3> =
            corners.iter().map(|corner| self.pool.points[corner.point as usize]).collect();
        for triangle in triangulate(&points) {
            self.faces.push(triangle.map(|place| corners[place]))?;
        }
        Ok(())
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`.
    fn corner(&self, word: &[u8]) -> Result<Corner, String> {
        let mut parts = word.split(|&byte| byte == b'/');
        let mut part = |what: &str, count: usize| match parts.next() {
            None | Some(b"") => Ok(None),
            Some(digits) => resolve(digits, what, count).map(Some),
        };
        let point = part("vertex", self.pool.points.len())?;
        let tex_coord = part("texture coordinate", self.pool.tex_coords.len())?;
        let normal = part("normal", self.pool.normals.len())?;
        match (point, parts.next()) {
            (Some(point), None) => Ok(Corner { point, tex_coord, normal }),
            _ => Err(format!("\"{}\" is no corner", excerpt(word))),
        }
    }

    /// Hands out the present object, if it has faces.
    fn end_object(&mut self) -> Result<(), ImportError> {
        if self.faces.is_empty() {
            return Ok(());
        }
        let name = self.name.clone().unwrap_or_else(|| format!("object {}", self.objects.len()));
        let made = self.faces.take(name.clone(), &self.pool, &self.library).map_err(|fault| {
            let (what, fix) = fault.explain();
            let at = format!("object {name:?}");
            ImportError::Invalid { file: self.file.into(), at, what, fix }
        })?;
        self.counts.degenerate += made.draft.mesh.dropped_degenerate;
        self.counts.mended_normals += made.mended_normals;
        let mesh = self.out.mesh(made.draft)?;
        self.objects.push(place::placed(name, mesh, made.origin));
        Ok(())
    }

    fn finish(self) -> Result<Imported, ImportError> {
        let mut notes = self.library.notes;
        let Counts { degenerate, mended_normals, too_few, points_and_lines, curves } = self.counts;
        for (count, what) in [
            (degenerate, "degenerate triangles left out"),
            (mended_normals, "normals without a direction replaced by those of faces"),
            (too_few, "faces of fewer than three corners skipped"),
            (points_and_lines, "point and line elements skipped"),
            (curves, "curves and curved surfaces skipped"),
        ] {
            if count > 0 {
                notes.push(format!("{count} {what}"));
            }
        }
        self.out.finish(self.objects, UP, notes)
    }

    fn broken(&self, at: String, what: String) -> ImportError {
        let fix = "export or copy the file again";
        ImportError::Invalid { file: self.file.into(), at, what, fix }
    }
}

fn finite(word: &[u8]) -> Result<f64, String> {
    number(word).ok_or_else(|| format!("\"{}\" is no finite number", excerpt(word)))
}

/// As many numbers as `missing`, which gives those that may be left out; NaN may not.
fn numbers<'w, const N: usize>(
    words: impl Iterator<Item = &'w [u8]>,
    missing: [f64; N],
) -> Result<[f64; N], String> {
    let mut all = missing;
    let mut count = 0;
    for (slot, word) in all.iter_mut().zip(words) {
        *slot = finite(word)?;
        count += 1;
    }
    match count == 0 || all.iter().any(|value| value.is_nan()) {
        true => Err(format!("{count} numbers are too few")),
        false => Ok(all),
    }
}

/// A number from 1 on, or from -1 backwards, as a place among `count`.
fn resolve(digits: &[u8], what: &str, count: usize) -> Result<u32, String> {
    let text = std::str::from_utf8(digits).ok();
    let Some(index) = text.and_then(|text| text.parse::<i64>().ok()) else {
        return Err(format!("\"{}\" is no number of a {what}", excerpt(digits)));
    };
    let place = if index < 0 { index.checked_add(count as i64) } else { index.checked_sub(1) };
    place
        .and_then(|place| u32::try_from(place).ok())
        .filter(|&place| (place as usize) < count)
        .ok_or_else(|| format!("it refers to {what} {index} of the {count} before it"))
}

#[cfg(test)]
mod tests;
