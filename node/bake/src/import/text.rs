//! Reading text that may be anything: lines and numbers.

use std::io::{self, BufRead};
use std::path::Path;

use super::error::ImportError;

/// The longest line that is read, in bytes: a polygon of a million corners.
const LONGEST_LINE: usize = 32 << 20;
/// What some editors put before UTF-8.
pub(super) const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

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
    /// The file is text of two bytes a letter.
    Utf16,
}

impl LineError {
    /// The same of the file that was read.
    pub(super) fn of(self, file: &Path) -> ImportError {
        let invalid = |at: String, what: &str, fix| ImportError::Invalid {
            file: file.into(),
            at,
            what: what.into(),
            fix,
        };
        match self {
            Self::Io(source) => ImportError::unreadable(file, source),
            Self::TooLong { line } => {
                invalid(format!("line {line}"), "it is too long", "export or copy the file again")
            }
            Self::Utf16 => invalid("encoding".into(), "it is UTF-16 text", "save it as UTF-8"),
        }
    }
}

/// Whether text begins as UTF-16 does, with a mark or without.
pub(super) fn is_utf16(head: &[u8]) -> bool {
    let is_wide = |[a, b, c, d]: [u8; 4]| {
        (a == 0) == (c == 0) && (b == 0) == (d == 0) && (a == 0) != (b == 0)
    };
    head.starts_with(b"\xFF\xFE")
        || head.starts_with(b"\xFE\xFF")
        || head.first_chunk::<4>().is_some_and(|first| is_wide(*first))
}

/// Lines of a file, counted from 1. They end in a line feed, a carriage return, or both.
pub(super) struct Lines<R> {
    reader: R,
    line: Vec<u8>,
    /// The line that was read last.
    number: u64,
    /// A lone carriage return has ended one: a line feed behind another begins what follows.
    has_lone_returns: bool,
}

impl<R: BufRead> Lines<R> {
    /// Before the first line.
    pub(super) fn new(reader: R) -> Self {
        Self { reader, line: Vec::new(), number: 0, has_lone_returns: false }
    }

    /// The next line and its number, blanks around it taken off, or `None` at the end. A backslash at its end joins
    /// the next one to it where it `may_join`.
    pub(super) fn next(
        &mut self,
        may_join: impl Fn(&[u8]) -> bool,
    ) -> Result<Option<(u64, &[u8])>, LineError> {
        self.line.clear();
        let mut is_joined = false;
        loop {
            let start = self.line.len();
            if !self.read_line()? {
                return Ok(is_joined.then(|| (self.number, self.line.trim_ascii())));
            }
            if self.number == 1 {
                if is_utf16(&self.line) {
                    return Err(LineError::Utf16);
                }
                if self.line.starts_with(BYTE_ORDER_MARK) {
                    self.line.drain(..BYTE_ORDER_MARK.len());
                }
            }
            let end = self.line.trim_ascii_end().len();
            let goes_on = end > start && self.line[end - 1] == b'\\';
            if !goes_on || !may_join(self.line.trim_ascii()) {
                return Ok(Some((self.number, self.line.trim_ascii())));
            }
            self.line.truncate(end - 1);
            self.line.push(b' ');
            is_joined = true;
        }
    }

    /// Appends the next line without its end; whether there is one.
    fn read_line(&mut self) -> Result<bool, LineError> {
        let mut has_begun = false;
        loop {
            let bytes = self.reader.fill_buf().map_err(LineError::Io)?;
            if bytes.is_empty() {
                self.number += u64::from(has_begun);
                return Ok(has_begun);
            }
            has_begun = true;
            let end = bytes.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
            let taken = end.unwrap_or(bytes.len());
            self.line.extend_from_slice(&bytes[..taken]);
            if self.line.len() >= LONGEST_LINE {
                return Err(LineError::TooLong { line: self.number + 1 });
            }
            let is_return = end.is_some_and(|at| bytes[at] == b'\r');
            self.reader.consume(taken + usize::from(end.is_some()));
            if end.is_some() {
                self.number += 1;
                if is_return && !self.has_lone_returns {
                    self.take_line_feed()?;
                }
                return Ok(true);
            }
        }
    }

    /// The second half of an end of two.
    fn take_line_feed(&mut self) -> Result<(), LineError> {
        let is_there = self.reader.fill_buf().map_err(LineError::Io)?.first() == Some(&b'\n');
        self.reader.consume(usize::from(is_there));
        self.has_lone_returns = !is_there;
        Ok(())
    }
}

/// Where no line goes on in the next.
pub(super) fn never(_: &[u8]) -> bool {
    false
}

/// The words of a line.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(|byte| byte.is_ascii_whitespace()).filter(|word| !word.is_empty())
}

/// What stands before a comment: a number sign that begins a word and is followed by a blank, or that ends the line. A
/// sign that is followed by something may be part of a name.
pub(super) fn before_comment(text: &[u8]) -> &[u8] {
    let begins = |at: usize| at == 0 || text[at - 1].is_ascii_whitespace();
    let ends = |at: usize| text.get(at + 1).is_none_or(u8::is_ascii_whitespace);
    let comment = (0..text.len()).find(|&at| text[at] == b'#' && begins(at) && ends(at));
    comment.map_or(text, |at| &text[..at]).trim_ascii()
}

/// The words before a comment, where no word has a reason to begin with a number sign.
pub(super) fn data(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    words(line).take_while(|word| !word.starts_with(b"#"))
}

/// A word as a number; NaN and infinity are none.
pub(super) fn number(word: &[u8]) -> Option<f64> {
    let value: f64 = std::str::from_utf8(word).ok()?.parse().ok()?;
    value.is_finite().then_some(value)
}

/// A word as a number, also one that is none or infinite, in whatever way that is written; no other word.
pub(super) fn any_number(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    // What the C library of one system writes: 1.#IND, -1.#QNAN, 1.#INF.
    let written = |ways: [&str; 4]| {
        let end = text.split_once('#').map(|(_, end)| end.to_ascii_uppercase());
        end.is_some_and(|end| ways.iter().any(|way| end.starts_with(way)))
    };
    text.parse().ok().or_else(|| written(["IND", "QNAN", "SNAN", "INF"]).then_some(f64::NAN))
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

    fn all(text: &[u8], may_join: fn(&[u8]) -> bool) -> Vec<(u64, String)> {
        let mut lines = Lines::new(io::BufReader::with_capacity(3, text));
        let mut found = Vec::new();
        while let Some((number, line)) = lines.next(may_join).unwrap() {
            found.push((number, String::from_utf8_lossy(line).into_owned()));
        }
        found
    }

    fn joined(text: &str) -> Vec<(u64, String)> {
        all(text.as_bytes(), |line| !line.starts_with(b"#"))
    }

    #[test]
    fn lines_are_counted_trimmed_and_joined() {
        let line = |number, text: &str| (number, text.to_owned());
        let found = joined("a \\\r\n b\n\n  c\\");
        assert_eq!(found, [line(2, "a   b"), line(3, ""), line(4, "c")]);
        assert_eq!(all(b"a\\\nb", never), [line(1, "a\\"), line(2, "b")]);
        assert_eq!(joined("# a\\\nb \\\n\\\nc"), [line(1, "# a\\"), line(4, "b   c")]);
    }

    #[test]
    fn every_end_of_a_line_ends_it() {
        let line = |number, text: &str| (number, text.to_owned());
        for text in ["a\nb\n\nc", "a\r\nb\r\n\r\nc\r\n", "a\rb\r\rc\r"] {
            let expected = [line(1, "a"), line(2, "b"), line(3, ""), line(4, "c")];
            assert_eq!(all(text.as_bytes(), never), expected, "{text:?}");
        }
        // A line feed that begins what follows lines ended by returns is no part of them.
        let mut bytes = &b"a\rb\r\nrest"[..];
        let mut lines = Lines::new(&mut bytes);
        assert_eq!(lines.next(never).unwrap().unwrap().1, b"a");
        assert_eq!(lines.next(never).unwrap().unwrap().1, b"b");
        assert_eq!(bytes, b"\nrest");
    }

    #[test]
    fn marks_of_encodings_are_understood() {
        assert_eq!(all(b"\xEF\xBB\xBFv 1\n\xEF", never)[0], (1, "v 1".to_owned()));
        for text in [&b"\xFF\xFEv\0"[..], b"\xFE\xFF\0v", b"v\0 \x001\0", b"\0v\0 \x001"] {
            assert!(matches!(Lines::new(text).next(never), Err(LineError::Utf16)));
        }
        let message = LineError::Utf16.of(Path::new("a.obj")).to_string();
        assert!(message.starts_with("a.obj: ") && message.contains("UTF-8"), "{message}");
    }

    #[test]
    fn comments_begin_where_no_name_can() {
        for (text, expected) in
            [("red # dark", "red"), ("part #3", "part #3"), ("a#b #", "a#b"), ("# x", ""), ("", "")]
        {
            assert_eq!(before_comment(text.as_bytes()), expected.as_bytes(), "{text}");
        }
        assert_eq!(data(b"v 1 2#3 #4 5").collect::<Vec<_>>(), [&b"v"[..], b"1", b"2#3"]);
    }

    #[test]
    fn an_endless_line_is_refused() {
        let mut lines = Lines::new(io::BufReader::new(io::repeat(b'x')));
        assert!(matches!(lines.next(never), Err(LineError::TooLong { line: 1 })));
    }

    #[test]
    fn what_is_no_number_is_written_in_many_ways() {
        for word in ["nan", "-NaN", "1.#IND", "-1.#IND00", "1.#QNAN", "inf", "-Infinity", "1.#INF"]
        {
            assert!(!any_number(word.as_bytes()).unwrap().is_finite(), "{word}");
        }
        assert_eq!(any_number(b"-1.5e3"), Some(-1500.0));
        for bad in ["", "x", "1,5", "#", "1.#"] {
            assert_eq!(any_number(bad.as_bytes()), None, "{bad}");
        }
    }

    #[test]
    fn only_finite_numbers_are_numbers() {
        assert_eq!(number(b"-1.5e3"), Some(-1500.0));
        for bad in ["", "x", "nan", "inf", "1e999", "1,5"] {
            assert_eq!(number(bad.as_bytes()), None, "{bad}");
        }
    }
}
