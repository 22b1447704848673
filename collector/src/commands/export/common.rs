//! What all exports share: names of files, and what was left out.

use anyhow::Result;
use console_output::{Console, Outcome, text};
use session_archive::index::Index;

/// Reports how much the index had to leave out.
pub(super) fn damage(index: &Index, console: &mut Console<'_>) -> Result<Outcome> {
    if index.damaged == 0 {
        return Ok(Outcome::Fine);
    }
    console.line(left_out(index.damaged))?;
    Ok(Outcome::Loss)
}

pub(super) fn left_out(damaged: u64) -> String {
    let places = text::count(damaged, "damaged place");
    format!("{places} left out; `paws validate` reports what is missing")
}

/// A stream's name as part of a file name: `feet/imu` as `feet_imu`.
pub(super) fn file_name(stream: &str) -> String {
    stream.replace('/', "_")
}
