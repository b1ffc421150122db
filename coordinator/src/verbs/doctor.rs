//! `doctor`: what this machine can render with, or what models hold and what looks wrong in them.

use super::exit::{BAD_DATA, Failure, IO, NO_INPUT};
use super::say::say;
use ::bake::import::{ImportError, ImportErrorKind, ImportLimits};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Models that may be baked, to be looked at instead of the machine
    #[arg(value_name = "MODEL")]
    models: Vec<PathBuf>,
}

pub(crate) fn run(Args { models }: Args) -> Result<(), Failure> {
    if models.is_empty() {
        return say(::node::doctor::report());
    }
    models.iter().try_for_each(|model| {
        let survey = ::bake::survey::survey(model, &ImportLimits::default());
        say(survey.map_err(of_import)?)
    })
}

fn of_import(error: ImportError) -> Failure {
    let code = match error.kind() {
        ImportErrorKind::NotFound => NO_INPUT,
        ImportErrorKind::Io => IO,
        ImportErrorKind::BadData => BAD_DATA,
    };
    Failure { code, error: Some(error.into()) }
}
