//! The header of a PLY file: which elements follow, with which properties, in which encoding.

use std::io::BufRead;

use super::texture_name;
use super::values::ValueError;
use crate::import::text::{LineError, Lines, excerpt, never, words};

/// What lines of a header begin with, but for comments.
const KEYWORDS: [&[u8]; 4] = [b"format", b"element", b"property", b"end_header"];
/// Lines of the longest header that is read.
const MOST_LINES: u64 = 10_000;
/// The longest of them, in bytes.
const LONGEST_LINE: usize = 1 << 16;

/// How values are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// As words.
    Text,
    /// Lowest byte first.
    LittleEndian,
    /// Highest byte first.
    BigEndian,
}

/// The type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn of(word: &[u8]) -> Option<Self> {
        Some(match word {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of one in a binary file.
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// What stands for a colour's full intensity.
    pub(super) fn full(self) -> f64 {
        match self {
            Self::I8 => 127.0,
            Self::U8 => 255.0,
            Self::I16 => 32_767.0,
            Self::U16 => 65_535.0,
            Self::I32 => f64::from(i32::MAX),
            Self::U32 => f64::from(u32::MAX),
            Self::F32 | Self::F64 => 1.0,
        }
    }
}

/// One property of an element.
#[derive(Debug, PartialEq)]
pub(super) struct Property {
    pub(super) name: String,
    /// The type of its number, or of each number in its list.
    pub(super) scalar: Scalar,
    /// The type of its list's length.
    pub(super) list: Option<Scalar>,
}

impl Property {
    /// Whether it lists the vertices of a face.
    pub(super) fn is_indices(&self) -> bool {
        self.list.is_some() && matches!(self.name.as_str(), "vertex_indices" | "vertex_index")
    }

    /// Whether it lists two coordinates for each of them.
    pub(super) fn is_tex_coords(&self) -> bool {
        self.list.is_some() && self.name == "texcoord"
    }
}

/// What an element is read for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Vertex,
    Face,
    Strips,
    Other,
}

/// Things of one kind.
#[derive(Debug, PartialEq)]
pub(super) struct Element {
    pub(super) name: String,
    /// How many it claims there are.
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    pub(super) fn kind(&self) -> Kind {
        match self.name.as_str() {
            "vertex" => Kind::Vertex,
            "face" if self.properties.iter().any(Property::is_indices) => Kind::Face,
            "tristrips" if self.properties.iter().any(Property::is_indices) => Kind::Strips,
            _ => Kind::Other,
        }
    }
}

/// What follows in the file.
#[derive(Debug, PartialEq)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// The files that comments name as textures.
    pub(super) textures: Vec<String>,
}

impl Header {
    /// Whether there can be no triangles.
    pub(super) fn has_no_faces(&self) -> bool {
        let is_face = |element: &Element| matches!(element.kind(), Kind::Face | Kind::Strips);
        !self.elements.iter().any(|element| is_face(element) && element.count > 0)
    }

    /// Lines that follow where each element stands in one.
    pub(super) fn lines(&self) -> u64 {
        let with_properties = self.elements.iter().filter(|element| !element.properties.is_empty());
        with_properties.fold(0, |sum, element| sum.saturating_add(element.count))
    }
}

/// Reads up to the line `end_header`.
pub(super) fn read(reader: impl BufRead) -> Result<Header, ValueError> {
    let mut lines = Lines::new(reader);
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut textures = Vec::new();
    // The next line may belong to a comment without saying so.
    let mut is_comment = false;
    loop {
        let (at, line) = match lines.next(never) {
            Ok(Some((at, line))) if line.len() <= LONGEST_LINE => (at, line.to_vec()),
            Ok(Some(_)) | Err(LineError::TooLong { .. }) => {
                return Err(ValueError::Broken("a line of it is too long".into()));
            }
            Ok(None) => {
                return Err(ValueError::Broken("the file ends before end_header".into()));
            }
            Err(error) => return Err(ValueError::Import(error)),
        };
        let wrong = |why: &str| {
            Err(ValueError::Broken(format!("line {at}, \"{}\", {why}", excerpt(&line))))
        };
        if at > MOST_LINES {
            return wrong("comes after too many others");
        }
        let all: Vec<&[u8]> = words(&line).collect();
        let is_keyword = |word: &&[u8]| KEYWORDS.contains(word);
        let is_keyword = all.first().is_some_and(is_keyword);
        is_comment &= !is_keyword;
        match (at, &all[..]) {
            (1, [b"ply"]) => {}
            (1, _) => return wrong("is not \"ply\""),
            (_, [b"format", kind, b"1.0"]) => {
                encoding = Some(match *kind {
                    b"ascii" => Encoding::Text,
                    b"binary_little_endian" => Encoding::LittleEndian,
                    b"binary_big_endian" => Encoding::BigEndian,
                    _ => return wrong("names an unknown format"),
                });
                is_comment = true;
            }
            (_, [word @ (b"comment" | b"obj_info"), ..]) => {
                textures.extend(texture_name(line[word.len()..].trim_ascii()));
                is_comment = true;
            }
            (_, []) => {}
            (_, [b"element", name, count]) => {
                let count = std::str::from_utf8(count).ok().and_then(|count| count.parse().ok());
                let Some(count) = count else { return wrong("has no count") };
                let name = String::from_utf8_lossy(name).into_owned();
                if matches!(name.as_str(), "vertex" | "face" | "tristrips")
                    && elements.iter().any(|element| element.name == name)
                {
                    return wrong("comes twice");
                }
                elements.push(Element { name, count, properties: Vec::new() });
            }
            (_, [b"property", b"list", length, scalar, name]) => {
                let list = Scalar::of(length).filter(|s| !matches!(s, Scalar::F32 | Scalar::F64));
                let (Some(list), Some(scalar)) = (list, Scalar::of(scalar)) else {
                    return wrong("names an unknown type");
                };
                let Some(element) = elements.last_mut() else {
                    return wrong("comes before any element");
                };
                let name = String::from_utf8_lossy(name).into_owned();
                element.properties.push(Property { name, scalar, list: Some(list) });
            }
            (_, [b"property", scalar, name]) => {
                let Some(scalar) = Scalar::of(scalar) else {
                    return wrong("names an unknown type");
                };
                let Some(element) = elements.last_mut() else {
                    return wrong("comes before any element");
                };
                let name = String::from_utf8_lossy(name).into_owned();
                element.properties.push(Property { name, scalar, list: None });
            }
            (_, [b"end_header"]) => break,
            // Some writers break the text of a comment, or leave its first word out.
            _ if is_comment => continue,
            _ => return wrong("is not understood"),
        }
    }
    match encoding {
        Some(encoding) => Ok(Header { encoding, elements, textures }),
        None => Err(ValueError::Broken("it has no line \"format\"".into())),
    }
}
