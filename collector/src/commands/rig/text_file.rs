//! Reading of text files.

use std::path::Path;

use anyhow::{Context, Result};

/// The text of a file.
pub(super) fn text_of(path: &Path) -> Result<String> {
    plain_file::read_to_string(path, plain_file::TEXT_LIMIT)
        .with_context(|| format!("reading {}", path.display()))
}
