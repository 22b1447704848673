//! Listing of a session's files.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;

use crate::link::{DERIVED, MAX_DEPTH, is_file_path};

/// Stamp that changes if a file changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// Length.
    pub bytes: u64,
    /// Modification time (mtime), ns since 1970.
    pub modified_ns: i64,
    /// Status change time (ctime), ns since 1970; cannot be set by a program.
    changed_ns: i64,
    /// Device and inode.
    inode: (u64, u64),
}

impl Stamp {
    fn of(data: &Metadata) -> Self {
        let ns = |s: i64, ns: i64| s.saturating_mul(1_000_000_000).saturating_add(ns);
        Self {
            bytes: data.len(),
            modified_ns: ns(data.mtime(), data.mtime_nsec()),
            changed_ns: ns(data.ctime(), data.ctime_nsec()),
            inode: (data.dev(), data.ino()),
        }
    }

    /// As an HTTP entity tag.
    pub fn tag(&self) -> String {
        format!(
            "\"{:x}-{:x}-{:x}\"",
            self.bytes, self.changed_ns, self.inode.1
        )
    }
}

/// One file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListedFile {
    /// Path below the session's folder, `/` between names.
    pub path: String,
    /// Its stamp.
    pub stamp: Stamp,
}

/// Content of a session's folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Listing {
    /// Its files, by path. Derived files are in neither list.
    pub files: Vec<ListedFile>,
    /// Entries that are not files, or have a name that cannot be in an address.
    pub unlistable: Vec<String>,
}

/// Lists a session's folder.
pub(super) fn list(folder: &Path) -> io::Result<Listing> {
    let mut listing = Listing::default();
    walk(folder, "", MAX_DEPTH, &mut listing)?;
    listing.files.sort_by(|a, b| a.path.cmp(&b.path));
    listing.unlistable.sort();
    Ok(listing)
}

fn walk(root: &Path, below: &str, depth: usize, listing: &mut Listing) -> io::Result<()> {
    for entry in fs::read_dir(root.join(below))? {
        let entry = entry?;
        let kind = entry.file_type()?;
        let name = entry.file_name();
        let path = format!("{below}{}", name.to_string_lossy());
        let plain = name.to_str().is_some();
        if kind.is_dir() && plain && depth > 0 {
            walk(root, &format!("{path}/"), depth - 1, listing)?;
        } else if kind.is_file() && plain && is_file_path(&path) {
            let stamp = Stamp::of(&entry.metadata()?);
            listing.files.push(ListedFile { path, stamp });
        } else if !(kind.is_file() && DERIVED.contains(&path.as_str())) {
            listing.unlistable.push(path);
        }
    }
    Ok(())
}

/// Opens a listed file, and returns its current stamp. Never follows a link.
pub(super) fn open(folder: &Path, path: &str) -> io::Result<(File, Stamp)> {
    // Non-blocking: a FIFO in place of the file must not block.
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(flags.bits() as i32)
        .open(folder.join(path))?;
    let data = file.metadata()?;
    if !data.is_file() {
        return Err(io::Error::other("it is no longer a file"));
    }
    Ok((file, Stamp::of(&data)))
}
