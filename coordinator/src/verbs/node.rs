//! `node`: one render process.

use super::exit::{Failure, NOT_ALLOWED, OrExit, code_of};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The coordinator
    #[arg(long, value_name = "HOST:PORT")]
    join: String,
    /// Where this node's peers reach it; port 0 takes a free one
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:0")]
    listen: String,
    /// Read the run's token from standard input (64 hex digits and a newline), and leave when it closes
    #[arg(long, required = true)]
    token_stdin: bool,
}

pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { join, listen, token_stdin: _ } = args;
    let token = ::node::orphan::read_token(&mut std::io::stdin().lock()).or_exit(NOT_ALLOWED)?;
    ::node::orphan::exit_with_parent();
    let failed = |error: ::node::NodeError| match error.told {
        true => Failure { code: code_of(error.kind), error: None },
        false => Failure { code: code_of(error.kind), error: Some(error.into()) },
    };
    ::node::run(::node::NodeOptions { join, listen, token }).map_err(failed)
}
