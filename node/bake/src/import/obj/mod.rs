//! Wavefront OBJ with MTL materials (Wavefront, *Advanced Visualizer Manual*, appendix B1): polygons
//! only.
//!
//! Each object or group makes one mesh. Vertices are numbered through the whole file, so all of them
//! are in memory; faces are so only until their object ends. Colours are taken as sRGB-encoded. Keywords may be written
//! in any case. What only serves looks (normals, texture coordinates, colours) and is missing or no number is left out.

mod library;
mod map;
mod mesh;
mod names;

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use glam::DVec3;

use self::library::Library;
use self::map::Map;
use self::mesh::{Corner, Faces};
use self::names::{may_join, name, statement};
use super::emit::Emitter;
use super::error::ImportError;
use super::open::open;
use super::picture::linear_of;
use super::place;
use super::polygon::triangulate;
use super::text::{Lines, any_number, data, excerpt, number};
use crate::source::{Imported, SourceObject};

/// What modellers write; the format itself does not say.
const UP: [f64; 3] = [0.0, 1.0, 0.0];

/// Reads the scene file at `path`, and the material libraries and textures it refers to.
pub(super) fn import(path: &Path, out: Emitter<'_>) -> Result<Imported, ImportError> {
    let file = open(path).map_err(|source| ImportError::unreadable(path, source))?;
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
    while let Some((number, line)) = lines.next(may_join).map_err(|error| error.of(file))? {
        scene.line(number, line).map_err(|fault| match fault {
            Fault::Import(error) => error,
            Fault::Line(why) => {
                scene.broken(format!("line {number}"), format!("\"{}\": {why}", excerpt(line)))
            }
        })?;
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
    /// Of points that stand nowhere, the line.
    nowhere: BTreeMap<u32, u64>,
}

/// What was left out or mended.
#[derive(Default)]
struct Counts {
    degenerate: u64,
    mended_normals: u64,
    mended_tex_coords: u64,
    missing: u64,
    guessed: u64,
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
        let Some((word, rest)) = statement(line) else { return Ok(()) };
        let words = data(rest);
        match &word[..] {
            b"v" => self.vertex(at, words)?,
            b"vt" => {
                let [u, v] = for_looks(words, [0.0; 2]).unwrap_or([f64::NAN; 2]);
                self.pool.tex_coords.push([u as f32, v as f32]);
            }
            b"vn" => {
                let normal = for_looks(words, [f64::NAN; 3]).unwrap_or_default();
                self.pool.normals.push(normal.map(|lane| lane as f32));
            }
            b"f" | b"fo" => self.face(words)?,
            b"o" | b"g" => {
                self.end_object()?;
                self.name = Some(name(rest)).filter(|name| !name.is_empty());
            }
            b"usemtl" => {
                let material = self.library.used(&name(rest), &mut self.out)?;
                self.faces.paint(material);
            }
            b"mtllib" => self.library.read(at, &name(rest))?,
            b"p" | b"l" => self.counts.points_and_lines += 1,
            b"curv" | b"curv2" | b"surf" => self.counts.curves += 1,
            // Smoothing groups, display attributes, parts of curves: nothing that shows here.
            _ if word.is_ascii() && word[0].is_ascii_alphabetic() || word[0] == b'#' => {}
            _ => return Err(Fault::Line("no line starts like this".into())),
        }
        Ok(())
    }

    fn vertex<'w>(
        &mut self,
        line: u64,
        words: impl Iterator<Item = &'w [u8]>,
    ) -> Result<(), String> {
        let all: Vec<f64> = words.map(coordinate).collect::<Result<_, _>>()?;
        let (point, color) = match all[..] {
            [x, y, z] | [x, y, z, _] => ([x, y, z], None),
            [x, y, z, r, g, b] | [x, y, z, _, r, g, b] => ([x, y, z], Some([r, g, b])),
            _ => return Err(format!("{} numbers make no vertex", all.len())),
        };
        if let Some(color) = color.filter(|color| color.iter().all(|lane| lane.is_finite())) {
            self.pool.colors.resize(self.pool.points.len(), [1.0; 3]);
            self.pool.colors.push(color.map(|lane| linear_of(lane.clamp(0.0, 1.0)) as f32));
        }
        if point.iter().any(|lane| !lane.is_finite()) {
            self.pool.nowhere.insert(self.pool.points.len() as u32, line);
        }
        self.pool.points.push(DVec3::from(point));
        Ok(())
    }

    fn face<'w>(&mut self, words: impl Iterator<Item = &'w [u8]>) -> Result<(), String> {
        let corners: Vec<Corner> = words.map(|word| self.corner(word)).collect::<Result<_, _>>()?;
        self.counts.too_few += u64::from(corners.len() < 3);
        let points: Vec<DVec3> =
            corners.iter().map(|corner| self.pool.points[corner.point as usize]).collect();
        let division = triangulate(&points);
        self.counts.guessed += u64::from(division.is_guess);
        for triangle in division.triangles {
            self.faces.push(triangle.map(|place| corners[place]))?;
        }
        Ok(())
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`. What is not there to be referred to, and no place, is left out.
    fn corner(&mut self, word: &[u8]) -> Result<Corner, String> {
        let mut parts = word.split(|&byte| byte == b'/');
        let mut part = |what: &str, count: usize| match parts.next() {
            None | Some(b"") => Ok(None),
            Some(digits) => resolve(digits, what, count).map(Some),
        };
        let point = part("vertex", self.pool.points.len())?;
        let tex_coord = part("texture coordinate", self.pool.tex_coords.len())?;
        let normal = part("normal", self.pool.normals.len())?;
        let (Some(point), None) = (point, parts.next()) else {
            return Err(format!("\"{}\" is no corner", excerpt(word)));
        };
        let point = point?;
        if let Some(line) = self.pool.nowhere.get(&point) {
            return Err(format!("it refers to a vertex that stands nowhere (line {line})"));
        }
        let mut there = |found: Option<Result<u32, String>>| {
            self.counts.missing += u64::from(matches!(found, Some(Err(_))));
            found.and_then(Result::ok)
        };
        Ok(Corner { point, tex_coord: there(tex_coord), normal: there(normal) })
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
        self.counts.mended_tex_coords += made.mended_tex_coords;
        let mesh = self.out.mesh(made.draft)?;
        self.objects.push(place::placed(name, mesh, made.origin));
        Ok(())
    }

    fn finish(self) -> Result<Imported, ImportError> {
        let mut notes = self.library.into_notes();
        let Counts { degenerate, mended_normals, mended_tex_coords, .. } = self.counts;
        let Counts { missing, guessed, too_few, points_and_lines, curves, .. } = self.counts;
        for (count, what) in [
            (degenerate, "degenerate triangles left out"),
            (mended_normals, "normals without a direction replaced by those of faces"),
            (mended_tex_coords, "texture coordinates that are no numbers replaced by zero"),
            (missing, "references to normals or texture coordinates that are not there left out"),
            (guessed, "polygons that cross themselves divided by guess"),
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

/// A number, also one that is none.
fn coordinate(word: &[u8]) -> Result<f64, String> {
    any_number(word).ok_or_else(|| format!("\"{}\" is no number", excerpt(word)))
}

/// As many numbers as `missing`, which gives those that may be left out; none where one is no number or too few are
/// there.
fn for_looks<'w, const N: usize>(
    words: impl Iterator<Item = &'w [u8]>,
    missing: [f64; N],
) -> Option<[f64; N]> {
    let mut all = missing;
    let mut count = 0;
    for (slot, word) in all.iter_mut().zip(words) {
        *slot = number(word)?;
        count += 1;
    }
    (count > 0 && all.iter().all(|value| value.is_finite())).then_some(all)
}

/// A number from 1 on, or from -1 backwards, as a place among `count`; the inner error says that there is no such place.
fn resolve(digits: &[u8], what: &str, count: usize) -> Result<Result<u32, String>, String> {
    let text = std::str::from_utf8(digits).ok();
    let Some(index) = text.and_then(|text| text.parse::<i64>().ok()) else {
        return Err(format!("\"{}\" is no number of a {what}", excerpt(digits)));
    };
    let place = if index < 0 { index.checked_add(count as i64) } else { index.checked_sub(1) };
    Ok(place
        .and_then(|place| u32::try_from(place).ok())
        .filter(|&place| (place as usize) < count)
        .ok_or_else(|| format!("it refers to {what} {index} of the {count} before it")))
}

/// The files that the scene file at `path` refers to, whatever its importer makes of them: libraries, and the
/// pictures of their materials.
pub(super) fn references(path: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let mut found = Vec::new();
    let mut known = BTreeSet::new();
    for names in named_after(path, b"mtllib")? {
        for (_, library) in names::libraries(path, "", &names) {
            let Ok(library) = library else { continue };
            if !known.insert(library.clone()) {
                continue;
            }
            // One that cannot be read is the importer's to judge.
            let maps = named_after(&library, b"map_kd").unwrap_or_default();
            let maps = maps.iter().filter_map(|line| Map::of(line));
            let pictures = maps.filter_map(|map| names::locate(path, &library, "", &map.file).ok());
            let pictures: Vec<PathBuf> = pictures.collect();
            found.push(library);
            found.extend(pictures.into_iter().filter(|picture| known.insert(picture.clone())));
        }
    }
    Ok(found)
}

/// The names behind a keyword, line by line.
fn named_after(path: &Path, keyword: &[u8]) -> Result<Vec<String>, ImportError> {
    let file = open(path).map_err(|source| ImportError::unreadable(path, source))?;
    let mut lines = Lines::new(BufReader::new(file));
    let mut found = Vec::new();
    while let Some((_, line)) = lines.next(may_join).map_err(|error| error.of(path))? {
        // Most lines are no such statement.
        let begins = line.get(..keyword.len()).is_some_and(|w| w.eq_ignore_ascii_case(keyword));
        if let Some((word, rest)) = begins.then(|| statement(line)).flatten()
            && word == keyword
        {
            found.push(name(rest));
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests;
