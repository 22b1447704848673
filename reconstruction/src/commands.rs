//! Implementation of the commands.

use std::fmt::Display;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result};
use command_line::complain;
use command_line::output::{is_quiet, print};
use indicatif::{ProgressBar, ProgressStyle};
use reconstruction::export::{self, Selection};
use reconstruction::input::{Check, Input};

pub(crate) mod evaluate;
pub(crate) mod evaluate_depth;
pub(crate) mod report;
pub(crate) mod run;

/// Maximum number of losses that are printed one by one.
const MAX_SHOWN_LOSSES: usize = 20;

pub(crate) fn print_info(handoff: &Path) -> Result<ExitCode> {
    print(crate::info::text(&open(handoff)?).trim_end())?;
    Ok(ExitCode::SUCCESS)
}

pub(crate) fn frames(handoff: &Path, out: &Path, selection: &Selection) -> Result<ExitCode> {
    let input = open(handoff)?;
    let bar = progress_bar(
        export::count(&input, selection),
        "writing  {wide_bar} {pos}/{len} frames, {per_sec}, {eta} left",
    )?;
    let summary = export::export(&input, out, selection, &|| bar.inc(1))
        .with_context(|| format!("writing the images to {}", out.display()))?;
    bar.finish_and_clear();

    for (name, count) in &summary.cameras {
        print(format_args!("{name}: {count} stereo frames"))?;
    }
    for (name, count) in &summary.imus {
        print(format_args!("{name}: {count} samples"))?;
    }
    print_losses(&summary.lost);
    let frames: u64 = summary.cameras.iter().map(|(_, count)| count).sum();
    let samples: u64 = summary.imus.iter().map(|(_, count)| count).sum();
    let loss = loss(summary.lost.len(), &input);
    print(format_args!(
        "{frames} stereo frames in {} sets, {samples} IMU samples, {loss}: {}",
        summary.sets,
        out.display()
    ))?;
    Ok(code(summary.lost.len(), &input))
}

/// Losses for the summary line; a failed session is marked as such.
fn loss(losses: usize, input: &Input) -> String {
    let loss = match losses {
        0 => "nothing lost".to_owned(),
        count => format!("{count} losses"),
    };
    match input.is_failed() {
        true => format!(
            "{loss}, of a session accepted as {}",
            input.handoff().verdict
        ),
        false => loss,
    }
}

/// The exit code: a session that failed its validation counts as loss, whatever part of it was
/// used.
fn code(losses: usize, input: &Input) -> ExitCode {
    let is_fine = losses == 0 && !input.is_failed();
    ExitCode::from(if is_fine { 0 } else { 3 })
}

fn open(handoff: &Path) -> Result<Input> {
    let bar = progress_bar(
        0,
        "checking {wide_bar} {decimal_bytes}/{decimal_total_bytes}, {decimal_bytes_per_sec}, {eta} left",
    )?;
    let input = Input::open_with(handoff, Check::Content, |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    })?;
    bar.finish_and_clear();
    if !is_quiet() {
        for note in input.notes() {
            complain!("note: {note}");
        }
    }
    Ok(input)
}

/// Shown only where standard error is a terminal, and not with `-q`.
fn progress_bar(length: u64, template: &str) -> Result<ProgressBar> {
    if is_quiet() {
        return Ok(ProgressBar::hidden());
    }
    let style = ProgressStyle::with_template(template).context("laying out the progress bar")?;
    Ok(ProgressBar::new(length).with_style(style))
}

fn print_losses(losses: &[impl Display]) {
    for lost in losses.iter().take(MAX_SHOWN_LOSSES) {
        complain!("lost: {lost}");
    }
    if losses.len() > MAX_SHOWN_LOSSES {
        complain!("lost: {} more", losses.len() - MAX_SHOWN_LOSSES);
    }
}
