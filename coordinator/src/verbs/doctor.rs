//! `doctor`: what this machine can render with, or what models hold and what looks wrong in them.

use super::bake::refused;
use super::exit::Failure;
use super::say::say;
use ::bake::import::ImportLimits;
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
        // What cannot be looked at cannot be baked, and for the same reason.
        say(survey.map_err(|error| refused(error.into()))?)
    })
}
