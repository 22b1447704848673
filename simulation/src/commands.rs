//! The verbs of `paws-sim`, one module each.

pub(crate) mod film;
pub(crate) mod import;
pub(crate) mod info;
pub(crate) mod view;
mod walk;

use anyhow::{Context, Result};
use command_line::output::is_quiet;
use indicatif::{ProgressBar, ProgressStyle};

/// Shown only where standard error is a terminal, and not with `-q`.
fn progress_bar(length: u64, label: &'static str) -> Result<ProgressBar> {
    if is_quiet() {
        return Ok(ProgressBar::hidden());
    }
    let style = ProgressStyle::with_template("{prefix} {wide_bar} {pos}/{len}, {eta} left");
    let style = style.context("laying out the progress bar")?;
    Ok(ProgressBar::new(length)
        .with_style(style)
        .with_prefix(label))
}
