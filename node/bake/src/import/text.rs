//! Reading text that may be anything: lines and numbers.

use std::io::{self, BufRead, Read};

/// The longest line that is read, in bytes: a polygon of a million corners.
const LONGEST_LINE: u64 = 32 << 20;

/// Why a line cannot be had.
#[derive(Debug)]
pub(super) enum LineError {
    /// The system's reason.
    Io(io::Error),
    /// It is too long for any scene.
    TooLong {
        /// Its number.
        line: u64,
    },
}

/// Lines of a file, counted from 1.
pub(super) struct Lines<R> {
    reader: R,
    line: Vec<u8>,
    /// The line that was read last.
    number: u64,
}

impl<R: BufRead> Lines<R> {
    /// Before the first line.
    pub(super) fn new(reader: R) -> Self {
        Self { reader, line: Vec::new(), number: 0 }
    }

    /// The next line and its number, blanks around it taken off, or `None` at the end. A backslash at its end joins
    /// the next one to it where `joins`.
    pub(super) fn next(&mut self, joins: bool) -> Result<Option<(u64, &[u8])>, LineError> {
        self.line.clear();
        loop {
            let before = self.line.len() as u64;
            let left = LONGEST_LINE - before;
            let read = self.reader.by_ref().take(left).read_until(b'\n', &mut self.line);
            let read = read.map_err(LineError::Io)? as u64;
            if read == 0 {
                return Ok((before > 0).then(|| (self.number, self.line.trim_ascii())));
            }
            if read == left {
                return Err(LineError::TooLong { line: self.number + 1 });
            }
            self.number += 1;
            let end = self.line.trim_ascii_end().len();
            if !joins || end == 0 || self.line[end - 1] != b'\\' {
                return Ok(Some((self.number, self.line.trim_ascii())));
            }
            self.line.truncate(end - 1);
            self.line.push(b' ');
        }
    }
}

/// The words of a line.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(|byte| byte.is_ascii_whitespace()).filter(|word| !word.is_empty())
}

/// A word as a number; NaN and infinity are none.
pub(super) fn number(word: &[u8]) -> Option<f64> {
    let value: f64 = std::str::from_utf8(word).ok()?.parse().ok()?;
    value.is_finite().then_some(value)
}

/// A line for a message: its start, if it is long.
pub(super) fn excerpt(line: &[u8]) -> String {
    const LONGEST: usize = 60;
    let cut = &line[..line.len().min(LONGEST)];
    let more = if line.len() > LONGEST { "..." } else { "" };
    format!("{}{more}", String::from_utf8_lossy(cut).escape_debug())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_counted_trimmed_and_joined() {
        let mut lines = Lines::new(&b"a \\\r\n b\n\n  c\\"[..]);
        let (number, line) = lines.next(true).unwrap().unwrap();
        assert_eq!((number, words(line).count()), (2, 2));
        assert_eq!(lines.next(true).unwrap().unwrap(), (3, &b""[..]));
        assert_eq!(lines.next(true).unwrap().unwrap(), (4, &b"c"[..]));
        assert!(lines.next(true).unwrap().is_none());
        let mut lines = Lines::new(&b"a\\\nb"[..]);
        assert_eq!(lines.next(false).unwrap().unwrap(), (1, &b"a\\"[..]));
    }

    #[test]
    fn an_endless_line_is_refused() {
        let mut lines = Lines::new(io::BufReader::new(io::repeat(b'x')));
        assert!(matches!(lines.next(true), Err(LineError::TooLong { line: 1 })));
    }

    #[test]
    fn only_finite_numbers_are_numbers() {
        assert_eq!(number(b"-1.5e3"), Some(-1500.0));
        for bad in ["", "x", "nan", "inf", "1e999", "1,5"] {
            assert_eq!(number(bad.as_bytes()), None, "{bad}");
        }
    }
}
