//! The rename that makes a finished folder a session of the library.

use session_access::{INCOMING, SESSIONS};

use super::error::{ImportError, failed};
use super::step::{Hook, Step, no_hook};
use crate::folders::{rename_new, sync_folder, sync_tree};
use crate::library::Library;

/// Updates the catalogue with a new session of the library, and with the one that it replaced.
pub(crate) fn list(
    library: &mut Library,
    key: &str,
    replaced: Option<&str>,
) -> Result<(), ImportError> {
    for key in [Some(key), replaced].into_iter().flatten() {
        library.refresh(key).map_err(|e| ImportError::Catalogue {
            key: key.to_owned(),
            reason: format!("{e:#}"),
        })?;
    }
    Ok(())
}

/// Syncs a finished folder under `.incoming/` and publishes it as a session of the library.
///
/// # Errors
/// See [`ImportError`]; the folder is then where it was.
pub(crate) fn publish_folder(library: &Library, key: &str) -> Result<(), ImportError> {
    let incoming = library.incoming(key);
    sync_tree(&incoming).map_err(failed("syncing", &incoming))?;
    publish_incoming(library, key, &no_hook)
}

/// Renames a finished folder from `.incoming/` to `sessions/`, and syncs the rename.
pub(super) fn publish_incoming(
    library: &Library,
    key: &str,
    hook: Hook<'_>,
) -> Result<(), ImportError> {
    let (from, to) = (library.incoming(key), library.folder(key));
    hook(&Step::Publish).map_err(failed("publishing", &to))?;
    rename_new(&from, &to).map_err(failed("publishing", &to))?;
    hook(&Step::SyncPublished).map_err(failed("publishing", &to))?;
    sync_published(library, key)
}

/// Syncs the rename into the library.
pub(super) fn sync_published(library: &Library, key: &str) -> Result<(), ImportError> {
    for folder in [SESSIONS, INCOMING] {
        sync_folder(&library.root().join(folder))
            .map_err(failed("publishing", &library.folder(key)))?;
    }
    Ok(())
}
