//! Results on stdout, messages on stderr. A reader of results that has gone away ends the program, quietly.

use super::exit::{Failure, IO, OTHER, OrExit};
use serde::Serialize;
use std::fmt::Display;
use std::io::{ErrorKind, Write};

/// Writes `text`, ended by one line end.
pub(super) fn say(text: impl Display) -> Result<(), Failure> {
    let text = text.to_string();
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", text.trim_end_matches('\n')).and_then(|()| out.flush()).map_err(|error| {
        Failure {
            code: IO,
            error: (error.kind() != ErrorKind::BrokenPipe)
                .then(|| anyhow::Error::from(error).context("cannot write to standard output")),
        }
    })
}

/// Says `text` on stderr. One that is closed, full or gone changes nothing.
pub(super) fn tell(text: impl Display) {
    // One write: a message comes whole.
    let text = text.to_string();
    let _ = std::io::stderr().write_all(text.as_bytes());
}

/// Writes `value` as JSON.
pub(super) fn say_json(value: &impl Serialize) -> Result<(), Failure> {
    say(serde_json::to_string_pretty(value).or_exit(OTHER)?)
}
