//! The run of one command in a program.

use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;

use anyhow::Result;
use command_line::output::{harmless, is_broken_pipe};
use command_line::{Verbosity, complain};
use log::LevelFilter;

use crate::clock::Clock;
use crate::console::Console;
use crate::outcome::Outcome;
use crate::progress::Show;

/// An error of the command line that only the command itself can find: exit code 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct BadArguments(pub String);

/// Starts the logger: warnings on standard error, one line each, or what `verbosity` says. A second
/// call has no effect.
pub fn start_logger(verbosity: Verbosity) {
    let mut logger = verbosity.logger(LevelFilter::Warn);
    logger.format(|out, record| {
        let level = record.level().as_str().to_lowercase();
        writeln!(out, "{level}: {}", harmless(&record.args().to_string()))
    });
    let _ = logger.try_init();
}

/// Runs a command with the machine's console and returns the exit code. An error is printed with
/// the name of the program; a reader that closes the pipe is no error.
pub fn run_command(
    program: &str,
    verbosity: Verbosity,
    command: impl FnOnce(&mut Console<'_>) -> Result<Outcome>,
) -> ExitCode {
    let show = match (verbosity.is_quiet(), io::stderr().is_terminal()) {
        (true, _) => Show::Nothing,
        (false, true) => Show::Bar,
        (false, false) => Show::Lines,
    };
    let mut out = io::stdout().lock();
    let mut console = Console {
        out: &mut out,
        show,
        clock: Clock::MACHINE,
    };
    match command(&mut console) {
        Ok(outcome) => outcome.into(),
        Err(e) if is_broken_pipe(&e) => ExitCode::SUCCESS,
        Err(e) => {
            complain!("{program}: {e:#}");
            match e.downcast_ref::<BadArguments>() {
                Some(_) => ExitCode::from(2),
                None => Outcome::Failed.into(),
            }
        }
    }
}
