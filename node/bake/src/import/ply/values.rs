//! The numbers after the header of a PLY file, one after the other.

use std::io::{self, BufRead, ErrorKind};

use super::header::{Encoding, Property, Scalar};
use crate::import::text::{LineError, any_number, excerpt};

/// Why the next number cannot be had.
#[derive(Debug)]
pub(super) enum ValueError {
    /// The system's reason.
    Io(io::Error),
    /// What is wrong with the file.
    Broken(String),
    /// Why a line of the header cannot be had.
    Import(LineError),
}

/// The longest word that is taken for a number, in bytes.
const LONGEST_WORD: usize = 400;

/// Numbers as they follow each other.
pub(super) struct Values<R> {
    reader: R,
    encoding: Encoding,
    word: Vec<u8>,
    /// Each element begins a line.
    by_line: bool,
    /// Something of the present line has been read, and its end has not.
    is_in_line: bool,
    leftover: u64,
}

impl<R: BufRead> Values<R> {
    /// `reader` stands behind the header; `by_line` says that each element begins a line.
    pub(super) fn new(reader: R, encoding: Encoding, by_line: bool) -> Self {
        Self { reader, encoding, word: Vec::new(), by_line, is_in_line: false, leftover: 0 }
    }

    /// Lines that went on behind their element.
    pub(super) fn leftover_lines(&self) -> u64 {
        self.leftover
    }

    /// Goes on to the next element: what is left of a line is not read.
    pub(super) fn begin(&mut self) -> Result<(), ValueError> {
        if !self.by_line || !std::mem::take(&mut self.is_in_line) {
            return Ok(());
        }
        let mut is_more = false;
        loop {
            let bytes = self.reader.fill_buf().map_err(ValueError::Io)?;
            let end = bytes.iter().position(is_line_end);
            let rest = &bytes[..end.unwrap_or(bytes.len())];
            is_more |= rest.iter().any(|byte| !byte.is_ascii_whitespace());
            let (read, is_end) = (rest.len(), end.is_some() || bytes.is_empty());
            self.reader.consume(read);
            if is_end {
                self.leftover += u64::from(is_more);
                return Ok(());
            }
        }
    }

    /// The next number, of this type; it may be none, or infinite.
    pub(super) fn scalar(&mut self, scalar: Scalar) -> Result<f64, ValueError> {
        if self.encoding == Encoding::Text {
            self.next_word()?;
            return any_number(&self.word).ok_or_else(|| {
                ValueError::Broken(format!("\"{}\" is no number", excerpt(&self.word)))
            });
        }
        let mut bytes = [0; 8];
        let bytes = &mut bytes[..scalar.bytes()];
        self.reader.read_exact(bytes).map_err(|source| match source.kind() {
            ErrorKind::UnexpectedEof => ended(),
            _ => ValueError::Io(source),
        })?;
        if self.encoding == Encoding::BigEndian {
            bytes.reverse();
        }
        let mut raw = [0; 8];
        raw[..bytes.len()].copy_from_slice(bytes);
        let raw = u64::from_le_bytes(raw);
        Ok(match scalar {
            Scalar::I8 => f64::from(raw as i8),
            Scalar::U8 => f64::from(raw as u8),
            Scalar::I16 => f64::from(raw as i16),
            Scalar::U16 => f64::from(raw as u16),
            Scalar::I32 => f64::from(raw as i32),
            Scalar::U32 => f64::from(raw as u32),
            Scalar::F32 => f64::from(f32::from_bits(raw as u32)),
            Scalar::F64 => f64::from_bits(raw),
        })
    }

    /// The length of a list, written as this type.
    pub(super) fn length(&mut self, scalar: Scalar) -> Result<u32, ValueError> {
        let value = self.scalar(scalar)?;
        let length = value as u32;
        if f64::from(length) == value {
            return Ok(length);
        }
        Err(ValueError::Broken(format!("its list has the length {value}")))
    }

    /// Reads past a property.
    pub(super) fn skip(&mut self, property: &Property) -> Result<(), ValueError> {
        let count = match property.list {
            Some(length) => self.length(length)?,
            None => 1,
        };
        (0..count).try_for_each(|_| match self.encoding {
            Encoding::Text => self.next_word(),
            _ => self.scalar(property.scalar).map(drop),
        })
    }

    fn next_word(&mut self) -> Result<(), ValueError> {
        self.word.clear();
        loop {
            let bytes = self.reader.fill_buf().map_err(ValueError::Io)?;
            if bytes.is_empty() {
                return if self.word.is_empty() { Err(ended()) } else { Ok(()) };
            }
            let blank = |byte: &u8| byte.is_ascii_whitespace();
            if self.word.is_empty() {
                let blanks = bytes.iter().take_while(|byte| blank(byte)).count();
                if blanks > 0 {
                    self.reader.consume(blanks);
                    continue;
                }
            }
            let length = bytes.iter().position(blank);
            let taken = length.unwrap_or(bytes.len());
            self.word.extend_from_slice(&bytes[..taken]);
            self.is_in_line = true;
            self.reader.consume(taken);
            if self.word.len() > LONGEST_WORD {
                let what = format!("\"{}\" is no number", excerpt(&self.word));
                return Err(ValueError::Broken(what));
            }
            if length.is_some() {
                return Ok(());
            }
        }
    }
}

fn is_line_end(byte: &u8) -> bool {
    matches!(byte, b'\n' | b'\r')
}

fn ended() -> ValueError {
    ValueError::Broken("the file ends inside it".into())
}
