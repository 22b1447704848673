//! The steps of an import.

use std::io;

/// Steps of an import. Tests stop it at each of them in turn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// The folder under `.incoming/` is about to be made.
    Begin,
    /// A block of a file is about to be written.
    Write(String),
    /// A file is about to be synced.
    Sync(String),
    /// A file is about to be recorded in the journal.
    Note(String),
    /// The folders are about to be synced.
    SyncFolders,
    /// The import record is about to be written.
    Record,
    /// The folder is about to be renamed into the library.
    Publish,
    /// The rename is about to be made durable.
    SyncPublished,
    /// The session is about to be put into the catalogue.
    List,
}

/// Callback before each step; an error stops the import as if it had been killed.
pub type Hook<'a> = &'a (dyn Fn(&Step) -> io::Result<()> + Sync);

/// The hook without effect.
pub fn no_hook(_: &Step) -> io::Result<()> {
    Ok(())
}
