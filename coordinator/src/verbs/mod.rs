//! What a user types. One file a verb; each turns arguments into calls and errors into exit codes.

mod bake;
mod demo;
mod doctor;
mod driver;
mod exit;
mod inspect;
mod interrupt;
mod live;
mod node;
mod path;
mod replay;
mod say;
mod scene_file;
mod synth;
mod verify;

use clap::{ArgAction, Parser, Subcommand};
use exit::Failure;
use std::io::IsTerminal;
use std::process::ExitCode;

/// A distributed renderer for massive static scenes.
#[derive(Debug, Parser)]
#[command(name = "occluster", version, about, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    verb: Verb,
    /// Say more on stderr (twice: everything)
    #[arg(short, long, global = true, action = ArgAction::Count)]
    verbose: u8,
    /// Say only errors on stderr
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// The main job with nothing to prepare: a plant, baked, three processes, a replayed walk, a report
    Demo(demo::Args),
    /// Write a generated scene as GLB
    Synth(synth::Args),
    /// Turn glTF, OBJ, PLY or STL files into a scene file
    Bake(bake::Args),
    /// Say what is in a scene file
    Inspect(inspect::Args),
    /// Check every checksum and every invariant of a scene file
    Verify(verify::Args),
    /// Make a camera path through a scene
    Path(path::Args),
    /// Show a scene along a camera path with three processes and log latency and bandwidth
    Replay(replay::Args),
    /// One render process; started by replay
    Node(node::Args),
    /// Say what this machine can render with and what is missing
    Doctor(doctor::Args),
}

pub(crate) fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            let code = if error.use_stderr() { exit::USAGE } else { 0 };
            // A closed pipe is no reason to fail while saying how the program is used.
            drop(error.print());
            return ExitCode::from(code);
        }
    };
    if !matches!(cli.verb, Verb::Inspect(_) | Verb::Verify(_) | Verb::Path(_) | Verb::Synth(_)) {
        driver::hush();
    }
    start_log(cli.verbose, cli.quiet);
    interrupt::survive_size_limit();
    // A node's end is its coordinator's to tell.
    if !matches!(cli.verb, Verb::Node(_)) {
        interrupt::listen();
    }
    let done = std::panic::catch_unwind(|| run(cli.verb));
    // What broke has been said.
    match done.unwrap_or(Err(Failure { code: exit::INTERNAL, error: None })) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure { code, error }) => {
            if let Some(error) = error {
                say::tell(format_args!("occluster: {}\n", sentence(&error)));
            }
            ExitCode::from(code)
        }
    }
}

fn run(verb: Verb) -> Result<(), Failure> {
    match verb {
        Verb::Demo(args) => demo::run(args),
        Verb::Synth(args) => synth::run(args),
        Verb::Bake(args) => bake::run(args),
        Verb::Inspect(args) => inspect::run(args),
        Verb::Verify(args) => verify::run(args),
        Verb::Path(args) => path::run(args),
        Verb::Replay(args) => replay::run(args),
        Verb::Node(args) => node::run(args),
        Verb::Doctor(args) => doctor::run(args),
    }
}

/// The error and those of its causes that it does not name itself.
fn sentence(error: &anyhow::Error) -> String {
    error.chain().map(ToString::to_string).fold(String::new(), |said, cause| match said {
        said if said.is_empty() => cause,
        said if said.contains(&cause) => said,
        said => format!("{said}: {cause}"),
    })
}

/// Logs go to stderr; `RUST_LOG` goes before `-v` and `-q`, `NO_COLOR` is honoured.
fn start_log(verbose: u8, quiet: bool) {
    let level = match (quiet, verbose) {
        (true, _) => "error",
        (false, 0) => "warn",
        (false, 1) => "info,wgpu_core=warn,wgpu_hal=warn,naga=warn",
        (false, _) => "debug",
    };
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(level));
    let color = std::io::stderr().is_terminal()
        && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        // They would be said on stderr, and there is nothing else that cannot be written to.
        .log_internal_errors(false)
        .with_ansi(color)
        .with_target(false)
        .init();
}
