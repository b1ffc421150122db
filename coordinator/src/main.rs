//! The executable: its verbs, nothing else.

mod verbs;

use std::process::ExitCode;

fn main() -> ExitCode {
    verbs::main()
}
