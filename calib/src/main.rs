//! `paws-calib`: calibration of cameras, IMUs and the rig from recordings, one verb for each kind.
//!
//! `paws calib` starts this program. It reads sessions and calibration files and writes results;
//! the library and its catalogue are unknown here: `paws` replaces a session of the library by its
//! folder. The estimators are those of the crate `calib`, for which this program reads the
//! sessions.
//!
//! Results go to standard output, progress and warnings to standard error. Exit codes: 0 fine, 1
//! failed, 2 bad arguments.

mod camera_imu;
mod cameras;
mod convert;
mod examples;
mod imu;
mod nominal_rig;
mod results;
mod rig_file;
mod rig_poses;
mod software;
mod target_detections;
mod targets;
mod verify;

use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use command_line::{Papers, Verbosity};
use console_output::{Console, Outcome, run_command, start_logger};
use session_access::SessionFolder;

use crate::results::Output;

/// Calibrate from a session.
#[derive(Debug, Parser)]
#[command(name = "paws-calib", version, arg_required_else_help = true, after_help = AFTER)]
struct Arguments {
    #[command(flatten)]
    verbosity: Verbosity,
    #[command(subcommand)]
    command: Command,
}

const AFTER: &str = "\
`paws calib` starts this program too; there SESSION may be a session of the library, as in
`paws calib cameras latest`.
Exit codes: 0 fine, 1 failed, 2 bad arguments.";

/// What to calibrate.
#[derive(Debug, Subcommand)]
enum Command {
    /// Extrinsics and time offsets of the IMUs against their cameras, from a recording of a board
    CameraImu {
        /// The session's folder, or a file in it
        session: String,
        /// Options
        #[command(flatten)]
        options: camera_imu::Options,
        /// Output
        #[command(flatten)]
        output: Output,
    },
    /// Intrinsics, stereo extrinsics and the rig, from a session in which targets were shown
    Cameras {
        /// The session's folder, or a file in it
        session: String,
        /// Options
        #[command(flatten)]
        options: cameras::Options,
        /// Output
        #[command(flatten)]
        output: Output,
    },
    /// Write a calibration file in another format
    Convert(convert::Options),
    /// Check that the calibration still holds, from an ordinary recording
    Verify {
        /// The session's folder, or a file in it
        session: String,
        /// Options
        #[command(flatten)]
        options: verify::Options,
    },
    /// Noise of the IMUs, from a recording at rest
    Imu {
        /// The session's folder, or a file in it
        session: String,
        /// Options
        #[command(flatten)]
        options: imu::Options,
        /// Output
        #[command(flatten)]
        output: Output,
    },
    /// Calibration boards to print: a PDF at true size, and the board's file
    Targets(targets::Options),
    /// Measure what `verify` measures, as JSON for `paws validate --deep`
    #[command(hide = true)]
    Measure {
        /// The session's folder, or a file in it
        session: String,
    },
    #[command(flatten)]
    Papers(Papers),
}

fn main() -> ExitCode {
    // Bad arguments end here, with 2.
    let arguments = Arguments::from_arg_matches(&command_line().get_matches());
    let arguments = arguments.unwrap_or_else(|error| error.exit());
    start_logger(arguments.verbosity);
    run_command("paws-calib", arguments.verbosity, |console| {
        run(arguments.command, console)
    })
}

/// The command line with its examples.
fn command_line() -> clap::Command {
    command_line::examples::add(Arguments::command(), examples::EXAMPLES)
}

fn run(command: Command, console: &mut Console<'_>) -> Result<Outcome> {
    match command {
        Command::CameraImu {
            session,
            options,
            output,
        } => camera_imu::run(&find(&session)?, &options, &output, console),
        Command::Cameras {
            session,
            options,
            output,
        } => cameras::run(&find(&session)?, &options, &output, console),
        Command::Convert(options) => convert::run(&options, console),
        Command::Verify { session, options } => verify::run(&find(&session)?, &options, console),
        Command::Imu {
            session,
            options,
            output,
        } => imu::run(&find(&session)?, &options, &output, console),
        Command::Targets(options) => targets::run(&options, console),
        Command::Measure { session } => verify::measure(&find(&session)?, console),
        Command::Papers(papers) => {
            papers.write(command_line(), console.out)?;
            Ok(Outcome::Fine)
        }
    }
}

/// The session that `text` names.
fn find(text: &str) -> Result<SessionFolder> {
    SessionFolder::at(text)?.with_context(|| {
        format!(
            "{text:?} is not the folder of a session; `paws calib` also finds sessions of a library"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `paws calib` finds the session among the arguments by that (flags of `CALIB` in
    /// `collector/src/forwarding.rs`).
    #[test]
    fn all_options_but_these_take_a_value() {
        let flags = ["force", "help", "keep-model", "quiet", "verbose"];
        let mut command = command_line();
        command.build();
        for verb in ["camera-imu", "cameras", "imu", "verify"] {
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
    fn every_command_has_valid_examples() {
        command_line().debug_assert();
        let wrong = command_line::examples::check(&command_line());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }

    #[test]
    fn every_help_lists_values_and_names_units() {
        let wrong = command_line::help::check(&command_line());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }
}
