//! What an import leaves beside its folder in `.incoming/`.

use std::path::Path;

use super::error::ImportError;
use super::{journal, recheck};

/// Removes the journal of the folder `incoming` and other files beside it, after its session was
/// published.
pub(super) fn remove_remains(incoming: &Path) -> Result<(), ImportError> {
    recheck::clear(incoming)?;
    journal::remove(incoming)
}
