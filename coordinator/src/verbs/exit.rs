//! Exit codes, after sysexits.h.

use protocol::file::OutputError;
use protocol::message::FailureKind;

/// Everything not named below.
pub(crate) const OTHER: u8 = 1;
/// The command line is wrong.
pub(crate) const USAGE: u8 = 2;
/// An input is damaged, foreign or senseless.
pub(crate) const BAD_DATA: u8 = 65;
/// An input is not there.
pub(crate) const NO_INPUT: u8 = 66;
/// A port, an adapter or a peer is not to be had.
pub(crate) const UNAVAILABLE: u8 = 69;
/// Our bug.
pub(crate) const INTERNAL: u8 = 70;
/// Reading or writing failed.
pub(crate) const IO: u8 = 74;
/// Another process is at it.
pub(crate) const TRY_AGAIN: u8 = 75;
/// A peer broke the protocol.
pub(crate) const PROTOCOL: u8 = 76;
/// A peer without the right, or with another scene.
pub(crate) const NOT_ALLOWED: u8 = 77;
/// A configuration file, or a setting for this scene, is wrong.
pub(crate) const CONFIG: u8 = 78;

/// The code the program leaves with, and what a person is told, unless another process tells it.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) code: u8,
    pub(crate) error: Option<anyhow::Error>,
}

/// Puts a code on an error.
pub(crate) trait OrExit<T> {
    fn or_exit(self, code: u8) -> Result<T, Failure>;
}

impl<T, E: Into<anyhow::Error>> OrExit<T> for Result<T, E> {
    fn or_exit(self, code: u8) -> Result<T, Failure> {
        self.map_err(|error| Failure { code, error: Some(error.into()) })
    }
}

impl Failure {
    /// A place that is not written to: the command line names an input twice, or what is no file.
    pub(crate) fn of_output(error: OutputError) -> Self {
        let code = match &error {
            OutputError::Input { .. } => USAGE,
            OutputError::NoFile { .. } => IO,
        };
        Self { code, error: Some(error.into()) }
    }

    /// What a person is told, with the code of its class.
    pub(crate) fn of(kind: FailureKind, error: impl Into<anyhow::Error>) -> Self {
        Self { code: code_of(kind), error: Some(error.into()) }
    }
}

/// The code of a run's failure.
pub(crate) fn code_of(kind: FailureKind) -> u8 {
    match kind {
        FailureKind::BadData => BAD_DATA,
        FailureKind::NoInput => NO_INPUT,
        FailureKind::Unavailable => UNAVAILABLE,
        FailureKind::Internal => INTERNAL,
        FailureKind::Io => IO,
        FailureKind::Protocol => PROTOCOL,
        FailureKind::NotAllowed => NOT_ALLOWED,
        FailureKind::Config => CONFIG,
    }
}
