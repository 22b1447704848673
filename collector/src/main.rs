//! `paws`: see [`collector`].

use std::process::ExitCode;

fn main() -> ExitCode {
    collector::cli::run(std::env::args_os().collect())
}
