//! The command line of `paws-sim`, which `paws sim` starts.
//!
//! Results go to standard output, the last line being a summary; progress, notes and losses go to
//! standard error. Exit codes: 0 fine, 1 failed, 2 bad arguments, 3 finished with loss.

use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use command_line::output;
use command_line::{Papers, Verbosity};
use log::LevelFilter;

mod commands;
mod examples;

/// Simulates agents in a scene bundle.
#[derive(Parser)]
#[command(name = "paws-sim", version, after_help = AFTER)]
struct Arguments {
    #[command(flatten)]
    verbosity: Verbosity,
    #[command(subcommand)]
    command: Command,
}

const AFTER: &str = "\
`paws sim` starts this program too. The Python package paws-sim trains agents in the same scenes.
Exit codes: 0 fine, 1 failed, 2 bad arguments, 3 finished with loss.";

#[derive(Subcommand)]
enum Command {
    /// Show what a scene has for simulators, and what it lacks.
    Info(commands::info::Arguments),
    /// Let an agent walk to goals in a scene and store the film beside the bundle.
    Film(commands::film::Arguments),
    /// Drive an agent through a scene in a browser on this machine.
    View(commands::view::Arguments),
    /// Write a folder of Beogym as a scene that all other verbs open.
    Import(commands::import::Arguments),
    #[command(flatten)]
    Papers(Papers),
}

fn main() -> ExitCode {
    // Bad arguments end here, with 2.
    let arguments = Arguments::from_arg_matches(&command().get_matches());
    let arguments = arguments.unwrap_or_else(|error| error.exit());
    arguments.verbosity.logger(LevelFilter::Warn).init();
    let result = match arguments.command {
        Command::Info(arguments) => commands::info::run(&arguments),
        Command::Film(arguments) => commands::film::run(&arguments),
        Command::View(arguments) => commands::view::run(&arguments),
        Command::Import(arguments) => commands::import::run(&arguments),
        Command::Papers(papers) => papers
            .write(command(), &mut std::io::stdout())
            .map(|()| ExitCode::SUCCESS),
    };
    output::finish(result)
}

/// The command line with its examples.
fn command() -> clap::Command {
    command_line::examples::add(Arguments::command(), examples::EXAMPLES)
}

#[cfg(test)]
mod tests {
    use super::command;

    #[test]
    fn the_command_line_is_consistent() {
        command().debug_assert();
        let wrong = command_line::examples::check(&command());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }

    #[test]
    fn every_help_lists_words_and_names_units() {
        let wrong = command_line::help::check(&command());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }
}
