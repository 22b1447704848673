//! Search for sessions in a folder or on a mounted disk.
//!
//! A session is a folder with `segments/` and either a manifest in it or a segment in that. Other
//! folders are searched, a few levels deep; names that begin with a dot and links are left out, and
//! so is the library that the sessions go to. Unreadable folders are reported.

use std::io;
use std::path::{Path, PathBuf};

use session_access::is_session;

/// Maximum search depth below a source: `disk/user/rig/day/session` and one more.
const DEPTH: usize = 6;

/// Result of a search.
#[derive(Debug, Default)]
pub(crate) struct SearchResult {
    /// The sessions, by path.
    pub(crate) sessions: Vec<PathBuf>,
    /// Folders that could not be read.
    pub(crate) unreadable: Vec<(PathBuf, io::Error)>,
}

/// The sessions in `source`, or `source` itself if it is one. Folders below `except` are left out.
pub(crate) fn sessions(source: &Path, except: Option<&Path>) -> SearchResult {
    let mut found = SearchResult::default();
    let except = except.and_then(|path| path.canonicalize().ok());
    search(source, except.as_deref(), DEPTH, &mut found);
    found.sessions.sort();
    found
}

fn search(folder: &Path, except: Option<&Path>, depth: usize, found: &mut SearchResult) {
    if except.is_some() && folder.canonicalize().ok().as_deref() == except {
        return;
    }
    if is_session(folder) {
        found.sessions.push(folder.to_owned());
        return;
    }
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) if depth > 0 => entries,
        Ok(_) => return,
        Err(e) => return found.unreadable.push((folder.to_owned(), e)),
    };
    for entry in entries {
        let entry = match entry {
            Ok(entry) => entry,
            Err(e) => {
                found.unreadable.push((folder.to_owned(), e));
                break;
            }
        };
        let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
        if !hidden && entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            search(&entry.path(), except, depth - 1, found);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn search_finds_only_sessions() {
        let disk = tempfile::tempdir().unwrap();
        let make = |path: &str| {
            let path = disk.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, b"x").unwrap();
        };
        make("rig/a/session.json");
        make("rig/a/segments/notes.txt");
        make("rig/b/segments/000000.mcap");
        make("rig/c/segments/other.mcap");
        make("rig/d/session.json");
        make(".trash/e/segments/000000.mcap");
        make("library/sessions/f/segments/000000.mcap");
        make("1/2/3/4/5/6/7/segments/000000.mcap");
        let library = disk.path().join("library");
        let found = sessions(disk.path(), Some(&library));
        let names: Vec<_> = found
            .sessions
            .iter()
            .map(|p| p.strip_prefix(disk.path()).unwrap().to_str().unwrap())
            .collect();
        assert_eq!(names, ["rig/a", "rig/b"]);
        assert!(found.unreadable.is_empty());
        let itself = sessions(&disk.path().join("rig/b"), None);
        assert_eq!(itself.sessions.len(), 1);
        assert_eq!(
            sessions(&disk.path().join("none"), None).unreadable.len(),
            1
        );
    }
}
