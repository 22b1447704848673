//! The command line of `paws-reconstruct`.
//!
//! Results go to standard output, the last line being a summary; progress and losses go to standard
//! error. Exit codes: 0 fine, 1 failed, 2 bad arguments, 3 finished with loss.

use std::num::NonZeroU64;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use command_line::{Papers, Verbosity, output};
use log::LevelFilter;
use reconstruction::export::Selection;

mod commands;
mod examples;
mod info;
mod machine;

/// Reads and reconstructs a session that was handed over by `paws handoff`.
#[derive(Parser)]
#[command(name = "paws-reconstruct", version, after_help = AFTER)]
struct Arguments {
    #[command(flatten)]
    verbosity: Verbosity,
    #[command(subcommand)]
    command: Command,
}

const AFTER: &str = "\
`paws reconstruct` starts this program too; there HANDOFF may be a session of the library, as in
`paws reconstruct run latest --out scene`.
Exit codes: 0 fine, 1 failed, 2 bad arguments, 3 finished with loss.";

#[derive(Subcommand)]
enum Command {
    /// Show the content of a hand-off, after checking every byte of it.
    Info {
        /// The session's folder, or the handoff.json in it.
        handoff: PathBuf,
    },
    /// Write every frame as PNG, with times, frame sets, IMU samples and calibration beside them.
    Frames {
        /// The session's folder, or the handoff.json in it.
        handoff: PathBuf,
        /// Folder to write; must be new or empty.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// Images of every N-th frame set only. Frames in no set count by their own numbers.
        #[arg(long, value_name = "N", default_value = "1")]
        every: NonZeroU64,
        /// Seconds after the start of recording to begin with; negative for the pre-roll.
        #[arg(long, value_name = "SECONDS", value_parser = nanoseconds, allow_negative_numbers = true)]
        from: Option<i64>,
        /// Seconds after the start of recording to end at.
        #[arg(long, value_name = "SECONDS", value_parser = nanoseconds, allow_negative_numbers = true)]
        to: Option<i64>,
    },
    /// Reconstruct a hand-off: write a scene bundle, stage by stage, or resume one.
    Run(commands::run::Arguments),
    /// Evaluate trajectories against ground truth.
    Evaluate(commands::evaluate::Arguments),
    /// Evaluate depth against the ground truth of a simulated walk.
    EvaluateDepth(commands::evaluate_depth::Arguments),
    /// Write an HTML report: trajectory, point cloud, time and memory of the stages.
    Report(commands::report::Arguments),
    #[command(flatten)]
    Papers(Papers),
}

fn main() -> ExitCode {
    // Bad arguments end here, with 2.
    let arguments = Arguments::from_arg_matches(&command().get_matches());
    let arguments = arguments.unwrap_or_else(|error| error.exit());
    arguments.verbosity.logger(LevelFilter::Warn).init();
    let result = match arguments.command {
        Command::Info { handoff } => commands::print_info(&handoff),
        Command::Frames {
            handoff,
            out,
            every,
            from,
            to,
        } => {
            if let (Some(from), Some(to)) = (from, to)
                && from >= to
            {
                let message = "--from has to be before --to";
                let kind = clap::error::ErrorKind::ValueValidation;
                Arguments::command().error(kind, message).exit();
            }
            let selection = Selection {
                every,
                from_ns: from,
                to_ns: to,
            };
            commands::frames(&handoff, &out, &selection)
        }
        Command::Run(arguments) => commands::run::run(&arguments),
        Command::Evaluate(arguments) => commands::evaluate::run(&arguments),
        Command::EvaluateDepth(arguments) => commands::evaluate_depth::run(&arguments),
        Command::Report(arguments) => commands::report::run(&arguments),
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

/// Decimal seconds as integer nanoseconds, exactly.
fn nanoseconds(text: &str) -> Result<i64, String> {
    let wrong = || "expected seconds with at most nine decimals, as in 12.5".to_owned();
    let (negative, digits) = text
        .strip_prefix('-')
        .map_or((false, text), |rest| (true, rest));
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, "0"));
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    if !is_number(whole) || !is_number(fraction) || fraction.len() > 9 {
        return Err(wrong());
    }
    let ns = format!("{whole}{fraction:0<9}")
        .parse::<i64>()
        .map_err(|_| wrong())?;
    Ok(if negative { -ns } else { ns })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_are_exact() {
        for (text, ns) in [
            ("0", 0),
            ("12.5", 12_500_000_000),
            ("-1.000000001", -1_000_000_001),
            ("-0.25", -250_000_000),
            ("9223372036.854775807", i64::MAX),
        ] {
            assert_eq!(nanoseconds(text), Ok(ns), "{text}");
        }
        for text in [
            "",
            ".",
            "1.",
            ".5",
            "1e3",
            "+1",
            "1.0000000001",
            "--1",
            "9223372037",
            "nan",
        ] {
            assert!(nanoseconds(text).is_err(), "{text}");
        }
    }

    /// `paws reconstruct` finds the hand-off among the words by that (flags of
    /// `RECONSTRUCT` in `collector/src/forwarding.rs`).
    #[test]
    fn all_options_but_these_take_a_value() {
        let flags = ["cpu-fallback", "force", "help", "json", "quiet", "verbose"];
        let mut command = command();
        command.build();
        for verb in ["info", "frames", "run"] {
            let verb = command.find_subcommand(verb).unwrap();
            for argument in verb.get_arguments() {
                let Some(long) = argument.get_long() else {
                    continue;
                };
                let takes_value = argument.get_action().takes_values();
                assert_eq!(takes_value, !flags.contains(&long), "--{long}");
                assert!(!takes_value || argument.get_short().is_none(), "--{long}");
            }
        }
    }

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
