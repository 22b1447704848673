//! `paws rebuild`: rebuilds the catalogue from the sessions' folders alone.

use std::path::Path;

use anyhow::Result;
use console_output::{Console, Outcome, text};

use crate::library::Library;

/// Rebuilds the catalogue of the library in the folder `root`. A folder without a readable session
/// is reported and makes the outcome a failure; the others are listed.
///
/// # Errors
/// There is no library, another program is changing it, or an I/O error occurs.
pub fn run(root: &Path, console: &mut Console<'_>) -> Result<Outcome> {
    let mut library = Library::open(root)?;
    let _lock = library.lock()?;
    let (listed, failed) = library.rebuild()?;
    for (key, reason) in &failed {
        console.line(format!("{key}: not listed: {reason}"))?;
    }
    console.line(format!(
        "{} listed: {}",
        text::count(listed as u64, "session"),
        library.root().display()
    ))?;
    Ok(if failed.is_empty() {
        Outcome::Fine
    } else {
        Outcome::Failed
    })
}
