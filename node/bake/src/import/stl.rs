//! STL, binary or text: triangles, in binary files with colours as VisCAM, SolidView or Materialise write them. Normals
//! are worked out anew, as files are often wrong about them.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use glam::DVec3;

use super::builder::{Builder, Paint, Vertices};
use super::emit::Emitter;
use super::error::ImportError;
use super::open::open;
use super::picture::linear_of;
use super::place;
use super::text::{BYTE_ORDER_MARK, Lines, excerpt, is_utf16, never, number, words};
use crate::source::{Imported, SourceObject};

/// Makers of parts take z for up; the format itself does not say.
const UP: [f64; 3] = [0.0, 0.0, 1.0];
const HEADER_BYTES: u64 = 84;
const TRIANGLE_BYTES: u64 = 50;
/// Bytes at the start that show whether a file is text.
const TEXT_BYTES: usize = 1024;

/// Reads the scene file at `path`. Each solid becomes one object.
pub(super) fn import(path: &Path, out: Emitter<'_>) -> Result<Imported, ImportError> {
    let unreadable = |source| ImportError::unreadable(path, source);
    let file = open(path).map_err(unreadable)?;
    let length = file.metadata().map_err(unreadable)?.len();
    read(path, &mut BufReader::new(file), length, out)
}

fn read(
    file: &Path,
    reader: &mut impl BufRead,
    length: u64,
    out: Emitter<'_>,
) -> Result<Imported, ImportError> {
    let unreadable = |source| ImportError::unreadable(file, source);
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut solids =
        Solids { file, stem, out, objects: Vec::new(), dropped: 0, points: vec![], colors: vec![] };
    let is_text = is_text(reader.fill_buf().map_err(unreadable)?);
    let mut head = Vec::new();
    reader.by_ref().take(HEADER_BYTES).read_to_end(&mut head).map_err(unreadable)?;
    let claimed = head.last_chunk::<4>().filter(|_| head.len() as u64 == HEADER_BYTES);
    let claimed = claimed.map(|count| u64::from(u32::from_le_bytes(*count)));
    let needed = claimed.map(|count| HEADER_BYTES + count * TRIANGLE_BYTES);
    // Binary files may start with "solid" all the same, so their length decides first.
    let mut notes = Vec::new();
    match (claimed, needed) {
        (Some(count), Some(needed)) if needed == length || (!is_text && needed < length) => {
            if needed < length {
                notes.push(format!("{} bytes after the last triangle ignored", length - needed));
            }
            solids.binary(&Colors::of(&head), reader, count)?;
        }
        _ if is_text => solids.text(&mut Lines::new((&head[..]).chain(reader)))?,
        (Some(count), _) => {
            let what = format!("it claims {count} triangles and the file has {length} bytes");
            return Err(solids.broken("header".into(), what));
        }
        (None, _) => {
            let what = format!(
                "it neither starts with \"solid\" nor has the {HEADER_BYTES} bytes of a binary header"
            );
            return Err(solids.broken("header".into(), what));
        }
    }
    let Solids { out, objects, dropped, .. } = solids;
    if dropped > 0 {
        notes.push(format!("{dropped} degenerate triangles left out"));
    }
    out.finish(objects, UP, notes)
}

/// Whether a file that starts like this is text: binary ones may start with "solid", too, but hold zeros.
fn is_text(start: &[u8]) -> bool {
    let start = &start[..start.len().min(TEXT_BYTES)];
    let text = start.strip_prefix(BYTE_ORDER_MARK).unwrap_or(start).trim_ascii_start();
    let is_solid = text.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    is_solid && !start.contains(&0) || is_utf16(start)
}

/// What the last two bytes of a triangle mean.
enum Colors {
    /// VisCAM and SolidView: blue, green, red, each five bits from the lowest, where the highest is set.
    Flagged,
    /// Materialise: red, green, blue where the highest bit is not set; else that of the header, sRGB-encoded.
    Header([f64; 3]),
}

impl Colors {
    fn of(header: &[u8]) -> Self {
        const WORD: &[u8] = b"COLOR=";
        let place = header.windows(WORD.len()).position(|word| word == WORD);
        match place.and_then(|at| header[at + WORD.len()..].first_chunk::<4>()) {
            Some([r, g, b, _]) => Self::Header([r, g, b].map(|&lane| f64::from(lane) / 255.0)),
            None => Self::Flagged,
        }
    }

    /// The colour of a triangle, sRGB-encoded, if it has one.
    fn color(&self, attribute: u16) -> Option<[f64; 3]> {
        let is_flagged = attribute & 1 << 15 != 0;
        let lanes = [0, 5, 10].map(|shift| f64::from(attribute >> shift & 31) / 31.0);
        match self {
            Self::Flagged => is_flagged.then_some([lanes[2], lanes[1], lanes[0]]),
            Self::Header(whole) => Some(if is_flagged { *whole } else { lanes }),
        }
    }
}

/// Solids on their way out.
struct Solids<'a, 's> {
    file: &'a Path,
    /// The file's name, for solids without one.
    stem: String,
    out: Emitter<'s>,
    objects: Vec<SourceObject>,
    dropped: u64,
    /// Corners of the present solid, three a triangle.
    points: Vec<DVec3>,
    /// Linear, one a triangle, or fewer where the last have none.
    colors: Vec<[f32; 3]>,
}

impl Solids<'_, '_> {
    fn binary(
        &mut self,
        colors: &Colors,
        reader: &mut impl Read,
        count: u64,
    ) -> Result<(), ImportError> {
        for triangle in 0..count {
            let mut bytes = [0; TRIANGLE_BYTES as usize];
            reader
                .read_exact(&mut bytes)
                .map_err(|source| ImportError::unreadable(self.file, source))?;
            if let Some(color) = colors.color(u16::from_le_bytes([bytes[48], bytes[49]])) {
                self.colors.resize(self.points.len() / 3, [1.0; 3]);
                self.colors.push(color.map(|lane| linear_of(lane) as f32));
            }
            // The first three numbers are the normal.
            let lanes = bytes[12..48].as_chunks::<4>().0;
            for corner in lanes.as_chunks::<3>().0 {
                let point = DVec3::from(corner.map(|lane| f64::from(f32::from_le_bytes(lane))));
                if !point.is_finite() {
                    let at = format!("triangle {triangle}");
                    return Err(self.broken(at, format!("it has the corner {point}")));
                }
                self.points.push(point);
            }
        }
        self.end(String::new())
    }

    fn text(&mut self, lines: &mut Lines<impl BufRead>) -> Result<(), ImportError> {
        let mut name = String::new();
        let mut is_open = false;
        let mut corners = 0;
        let mut last = 0;
        loop {
            let next = lines.next(never).map_err(|error| error.of(self.file))?;
            let Some((at, line)) = next else { break };
            last = at;
            let mut words = words(line);
            let Some(word) = words.next() else { continue };
            let mut word = word.to_ascii_lowercase();
            // Some write "end loop".
            if matches!(&word[..], b"end" | b"outer") {
                word.extend(words.next().unwrap_or_default().to_ascii_lowercase());
            }
            let mut wrong = None;
            match &word[..] {
                b"solid" if !is_open => {
                    is_open = true;
                    name = String::from_utf8_lossy(line[5..].trim_ascii()).into_owned();
                }
                b"facet" | b"facetnormal" | b"outerloop" | b"endloop" if is_open => {}
                b"vertex" if is_open => {
                    let lanes: Vec<f64> = words.map_while(number).take(3).collect();
                    match lanes[..] {
                        [x, y, z] => self.points.push(DVec3::new(x, y, z)),
                        _ => wrong = Some("three finite numbers are missing"),
                    }
                    corners += 1;
                }
                b"endfacet" if is_open => {
                    if corners != 3 {
                        wrong = Some("its facet has not three corners");
                    }
                    corners = 0;
                }
                b"endsolid" if is_open && corners == 0 => {
                    is_open = false;
                    self.end(std::mem::take(&mut name))?;
                }
                _ => wrong = Some("it has no place here"),
            }
            if let Some(why) = wrong {
                let what = format!("\"{}\": {why}", excerpt(line));
                return Err(self.broken(format!("line {at}"), what));
            }
        }
        if is_open {
            let at = format!("line {last}");
            return Err(self.broken(at, "the file ends inside a solid".into()));
        }
        Ok(())
    }

    /// Hands out the present solid.
    fn end(&mut self, name: String) -> Result<(), ImportError> {
        let points = std::mem::take(&mut self.points);
        let colors = std::mem::take(&mut self.colors);
        if points.is_empty() {
            return Ok(());
        }
        let name = if name.is_empty() { self.stem.clone() } else { name };
        let mut builder = Builder::new(name.clone());
        let origin = place::origin(points.iter().copied());
        let triangles = (0..points.len() / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]);
        let soup = Soup { points: &points, colors: &colors, origin };
        builder.append(&Paint::PLAIN, &soup, triangles).map_err(|fault| {
            let (what, fix) = fault.explain();
            let at = format!("solid {name:?}");
            ImportError::Invalid { file: self.file.into(), at, what, fix }
        })?;
        drop(points);
        self.dropped += builder.dropped_degenerate();
        let mesh = self.out.mesh(builder.finish())?;
        self.objects.push(place::placed(name, mesh, origin));
        Ok(())
    }

    fn broken(&self, at: String, what: String) -> ImportError {
        let fix = "export or copy the file again";
        ImportError::Invalid { file: self.file.into(), at, what, fix }
    }
}

/// Corners of flat triangles.
struct Soup<'a> {
    points: &'a [DVec3],
    /// Of triangles; white where there is none.
    colors: &'a [[f32; 3]],
    origin: DVec3,
}

impl Vertices for Soup<'_> {
    fn count(&self) -> usize {
        self.points.len()
    }

    fn position(&self, vertex: usize) -> [f64; 3] {
        place::relative(self.points[vertex], self.origin)
    }

    fn normal(&self, _: usize) -> Option<[f32; 3]> {
        None
    }

    fn color(&self, vertex: usize) -> [f32; 4] {
        let [r, g, b] = self.colors.get(vertex / 3).copied().unwrap_or([1.0; 3]);
        [r, g, b, 1.0]
    }

    fn tex_coord(&self, _: usize) -> [f32; 2] {
        [0.0; 2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::testing::{TEXTURE_SIDE, check, collect};
    use crate::source::{Source, Surface};
    use proptest::prelude::*;

    const TEXT: &str = "solid wedge\n facet normal 0 0 0\n outer loop\n vertex 0 0 0\n vertex 1 0 0\n \
        vertex 0 1 0\n endloop\n endfacet\nendsolid wedge\nsolid\nendsolid\nSOLID\nfacet normal 0 0 1\n\
        outer loop\nvertex 1e7 0 0\nvertex 10000001 0 0\nvertex 1e7 0.25 0\nendloop\nendfacet\nendsolid\n";

    fn parse(bytes: &[u8]) -> Result<Source, ImportError> {
        collect("part.stl", |out| {
            read(Path::new("part.stl"), &mut &bytes[..], bytes.len() as u64, out)
        })
    }

    fn error(bytes: &[u8]) -> String {
        let message = parse(bytes).unwrap_err().to_string();
        assert!(message.starts_with("part.stl: "), "{message}");
        message
    }

    /// A binary file of two triangles, one of them degenerate, whose header says "solid".
    fn binary() -> Vec<u8> {
        let mut bytes = b"solid binary".to_vec();
        bytes.resize(80, b' ');
        bytes.extend(2u32.to_le_bytes());
        for corners in [[0f32, 0., 0., 2., 0., 0., 0., 2., 0.], [5.0; 9]] {
            bytes.extend([9f32; 3].iter().chain(&corners).flat_map(|lane| lane.to_le_bytes()));
            bytes.extend([7, 7]);
        }
        bytes
    }

    #[test]
    fn nothing_and_something_else_are_refused() {
        assert!(error(b"").contains("neither"));
        assert!(error(b"solid\nendsolid\n").contains("no triangles"));
        assert!(error(&[b'x'; 200]).contains("claims 2021161080 triangles"));
    }

    #[test]
    fn text_makes_an_object_a_solid() {
        let source = parse(TEXT.as_bytes()).unwrap();
        let names: Vec<&str> = source.objects.iter().map(|object| object.name.as_str()).collect();
        assert_eq!((names, source.up), (vec!["wedge", "part"], [0.0, 0.0, 1.0]));
        assert_eq!(source.meshes[0].normals, [[0.0, 0.0, 1.0]; 3]);
        assert_eq!(source.surfaces, [Surface::PLAIN]);
        // 1e7 and a quarter is not lost.
        let far = &source.objects[1].world_from_mesh;
        let corner = DVec3::from(source.meshes[1].positions[2].map(f64::from));
        assert_eq!(far.transform_point3(corner), DVec3::new(1e7, 0.25, 0.0));
    }

    #[test]
    fn a_binary_file_may_start_like_text() {
        let source = parse(&binary()).unwrap();
        assert_eq!(source.meshes[0].positions[1], [2.0, 0.0, 0.0]);
        assert_eq!((source.meshes[0].indices.len(), source.meshes[0].dropped_degenerate), (1, 1));
        assert!(source.notes[0].contains("1 degenerate"), "{:?}", source.notes);
        let mut longer = binary();
        longer[..5].fill(b' ');
        longer.extend([1, 2, 3]);
        assert!(parse(&longer).unwrap().notes[0].starts_with("3 bytes"));
    }

    #[test]
    fn a_binary_file_may_start_like_text_and_have_bytes_behind() {
        let mut longer = binary();
        longer.extend([1, 2, 3]);
        let source = parse(&longer).unwrap();
        assert_eq!(source.meshes[0].indices.len(), 1);
        assert!(source.notes[0].starts_with("3 bytes"), "{:?}", source.notes);
    }

    #[test]
    fn words_may_be_written_apart_and_in_any_case() {
        let apart = TEXT
            .replace("endloop", "End Loop")
            .replace("endfacet", "END FACET")
            .replace("endsolid", "end solid")
            .replace("outer loop", "outerloop");
        assert_eq!(parse(apart.as_bytes()).unwrap(), parse(TEXT.as_bytes()).unwrap());
    }

    #[test]
    fn text_has_many_encodings() {
        let whole = parse(TEXT.as_bytes()).unwrap();
        let marked = [BYTE_ORDER_MARK, TEXT.as_bytes()].concat();
        assert_eq!(parse(&marked).unwrap(), whole);
        assert_eq!(parse(TEXT.replace('\n', "\r").as_bytes()).unwrap(), whole);
        let wide: Vec<u8> = TEXT.encode_utf16().flat_map(u16::to_le_bytes).collect();
        assert!(error(&wide).contains("UTF-16"));
    }

    /// The colours of two triangles with these attributes, behind this header.
    fn colors(header: &[u8], attributes: [u16; 2]) -> Vec<[u8; 4]> {
        let mut bytes = header.to_vec();
        bytes.resize(80, b' ');
        bytes.extend(2u32.to_le_bytes());
        for (attribute, z) in attributes.into_iter().zip([0.0, 1.0]) {
            let corners = [0f32, 0.0, 0.0, 0.0, 0.0, z, 1.0, 0.0, z, 0.0, 1.0, z];
            bytes.extend(corners.iter().flat_map(|lane| lane.to_le_bytes()));
            bytes.extend(attribute.to_le_bytes());
        }
        let mesh = &parse(&bytes).unwrap().meshes[0];
        mesh.indices.iter().map(|triangle| mesh.colors[triangle[0] as usize]).collect()
    }

    #[test]
    fn triangles_have_the_colours_of_their_writers() {
        let (white, red, blue) = ([255; 4], [255, 0, 0, 255], [0, 0, 255, 255]);
        assert_eq!(colors(b"VisCAM", [0x8000 | 31 << 10, 0x8000 | 31]), [red, blue]);
        assert_eq!(colors(b"no colour", [31, 0x8000 | 31]), [white, blue]);
        assert_eq!(colors(b"no colour", [0x8000 | 31, 31]), [blue, white]);
        let materialise = b"Magics COLOR=\xFF\x00\x00\xFF,MATERIAL=";
        assert_eq!(colors(materialise, [0x8000, 31 << 10]), [red, blue]);
        assert_eq!(colors(materialise, [31, 0xFFFF]), [red, red]);
    }

    #[test]
    fn faults_name_the_line_or_the_triangle() {
        for (from, to, words) in [
            ("vertex 1 0 0", "vertex 1 0", "line 5: \"vertex 1 0\": three"),
            ("vertex 1 0 0", "vertex 1 nan 0", "line 5"),
            ("vertex 1 0 0\n", "\n", "line 8: \"endfacet\": its facet"),
            ("outer loop", "inner loop", "line 3: \"inner loop\": it has no place"),
        ] {
            let message = error(TEXT.replacen(from, to, 1).as_bytes());
            assert!(message.contains(words), "{message}");
        }
        let mut nan = binary();
        nan[100..104].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(error(&nan).contains("triangle 0: it has the corner"));
    }

    #[test]
    fn no_truncation_is_taken_for_a_whole() {
        for end in 0..binary().len() {
            assert!(parse(&binary()[..end]).is_err(), "cut at {end}");
        }
        let first = TEXT.find("endsolid").unwrap();
        for end in 0..first {
            assert!(parse(&TEXT.as_bytes()[..end]).is_err(), "cut at {end}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn no_mutation_panics(edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6), text: bool) {
            let mut bytes = if text { TEXT.as_bytes().to_vec() } else { binary() };
            for (place, value) in edits {
                let place = place.index(bytes.len());
                bytes[place] = value;
            }
            if let Ok(source) = parse(&bytes) {
                check(&source, TEXTURE_SIDE)?;
            }
        }
    }
}
