//! The command line of `paws-reconstruct`.
//!
//! Results go to standard output, the last line being a summary; progress and what was lost go to
//! standard error. Exit codes: 0 fine, 1 failed, 2 bad arguments, 3 finished with loss.

use std::num::NonZeroU64;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{CommandFactory, Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use reconstruction::export::{self, Selection};
use reconstruction::input::{Check, Input};

mod info;

/// Reads a session that was handed over by `paws handoff`.
#[derive(Parser)]
#[command(name = "paws-reconstruct", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Say what a hand-off holds, after checking every byte of it.
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
        /// Pictures of every N-th frame set only. Frames in no set count by their own numbers.
        #[arg(long, value_name = "N", default_value = "1")]
        every: NonZeroU64,
        /// Seconds after the start of recording to begin with; negative for the pre-roll.
        #[arg(long, value_name = "SECONDS", value_parser = nanoseconds, allow_negative_numbers = true)]
        from: Option<i64>,
        /// Seconds after the start of recording to end before.
        #[arg(long, value_name = "SECONDS", value_parser = nanoseconds, allow_negative_numbers = true)]
        to: Option<i64>,
    },
}

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    // Bad arguments end here, with 2.
    let result = match Arguments::parse().command {
        Command::Info { handoff } => print_info(&handoff),
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
            frames(&handoff, &out, &selection)
        }
    };
    result.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::FAILURE
    })
}

fn print_info(handoff: &Path) -> Result<ExitCode> {
    print!("{}", info::text(&open(handoff)?));
    Ok(ExitCode::SUCCESS)
}

fn frames(handoff: &Path, out: &Path, selection: &Selection) -> Result<ExitCode> {
    let input = open(handoff)?;
    let bar = progress_bar(
        export::count(&input, selection),
        "writing  {wide_bar} {pos}/{len} frames, {per_sec}, {eta} left",
    )?;
    let summary = export::export(&input, out, selection, &|| bar.inc(1))
        .with_context(|| format!("writing the pictures to {}", out.display()))?;
    bar.finish_and_clear();

    for (name, count) in &summary.cameras {
        println!("{name}: {count} stereo frames");
    }
    for (name, count) in &summary.imus {
        println!("{name}: {count} samples");
    }
    const SHOWN: usize = 20;
    for lost in summary.lost.iter().take(SHOWN) {
        eprintln!("lost: {lost}");
    }
    if summary.lost.len() > SHOWN {
        eprintln!("lost: {} more", summary.lost.len() - SHOWN);
    }
    let frames: u64 = summary.cameras.iter().map(|(_, count)| count).sum();
    let samples: u64 = summary.imus.iter().map(|(_, count)| count).sum();
    let loss = match summary.lost.len() {
        0 => "nothing lost".to_owned(),
        count => format!("{count} losses"),
    };
    println!(
        "{frames} stereo frames in {} sets, {samples} IMU samples, {loss}: {}",
        summary.sets,
        out.display()
    );
    Ok(ExitCode::from(if summary.lost.is_empty() { 0 } else { 3 }))
}

fn open(handoff: &Path) -> Result<Input> {
    let bar = progress_bar(
        0,
        "checking {wide_bar} {bytes}/{total_bytes}, {bytes_per_sec}, {eta} left",
    )?;
    let input = Input::open_with(handoff, Check::Content, |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    })?;
    bar.finish_and_clear();
    Ok(input)
}

/// Shown only where standard error is a terminal.
fn progress_bar(length: u64, template: &str) -> Result<ProgressBar> {
    let style = ProgressStyle::with_template(template).context("laying out the progress bar")?;
    Ok(ProgressBar::new(length).with_style(style))
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

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }
}
