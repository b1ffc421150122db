//! Results on stdout. A reader that has gone away ends the program, quietly.

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

/// Writes `value` as JSON.
pub(super) fn say_json(value: &impl Serialize) -> Result<(), Failure> {
    say(serde_json::to_string_pretty(value).or_exit(OTHER)?)
}
