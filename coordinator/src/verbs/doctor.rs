//! `doctor`: what this machine can render with.

use super::exit::Failure;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(Args {}: Args) -> Result<(), Failure> {
    print!("{}", ::node::doctor::report());
    Ok(())
}
