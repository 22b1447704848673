//! `paws index`: the derived index that gives random access to every frame.

use std::path::Path;

use anyhow::{Context, Result};
use console_output::{Console, Outcome, text};
use session_access::{build, open};
use session_archive::index::Index;
use session_archive::layout;
use session_archive::storage;

use crate::target::Target;

/// Hint for a session that is in no library.
pub(crate) const IMPORT_FIRST: &str = "`paws import` copies it to one";

/// Returns the index of the session in a folder, and whether it is new; writes it if necessary. An
/// index with omissions is built again, because the damage may have been repaired meanwhile.
///
/// # Errors
/// An I/O error occurs.
pub fn ensure(folder: &Path, console: &Console<'_>) -> Result<(Index, bool)> {
    let context = || format!("indexing the session: {}", folder.display());
    let reader = open(folder)?;
    if let Ok(index) = Index::read(&reader)
        && index.damaged == 0
    {
        return Ok((index, false));
    }
    let index = build(&reader, console).with_context(context)?;
    index
        .to_bytes()
        .and_then(|bytes| storage::replace(&**reader.storage(), layout::INDEX, &bytes))
        .with_context(context)?;
    Ok((index, true))
}

/// Indexes sessions.
///
/// # Errors
/// A session cannot be read, or its index cannot be written.
pub fn run(targets: &[Target], console: &mut Console<'_>) -> Result<Outcome> {
    for target in targets {
        target.derived(layout::INDEX, IMPORT_FIRST)?;
        let (index, new) = ensure(&target.folder, console)?;
        let frames: usize = index.cameras.iter().map(|c| c.frames.len()).sum();
        let undecodable: u64 = index.cameras.iter().map(|c| c.undecodable).sum();
        let mut line = format!(
            "{}: {} of {}, {}, {}",
            target.name(),
            text::count(frames as u64, "frame"),
            text::count(index.cameras.len() as u64, "camera"),
            text::count(index.sets.len() as u64, "frame set"),
            if new { "indexed" } else { "indexed already" },
        );
        if undecodable > 0 {
            line.push_str(&format!(", {undecodable} frames without their key frame"));
        }
        console.line(line)?;
    }
    Ok(Outcome::Fine)
}
