//! `doctor`: what this machine can render with.

use super::exit::Failure;
use super::say::say;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(Args {}: Args) -> Result<(), Failure> {
    say(::node::doctor::report())
}
