//! Files below a folder in which no link is followed: a session's, a bundle's. The author of such a
//! folder must not be able to name a file outside of it.

use std::ffi::OsStr;
use std::fs::File;
use std::io;
use std::os::fd::OwnedFd;
use std::path::{Component, Path};

use rustix::fs::{AtFlags, CWD, FileType, Mode, OFlags, openat, statat};

use crate::{Kind, NotFolder, checked, not_plain, read_file};

/// Opens the regular file at the relative `path` below `root`. `root` itself may be or lie behind a
/// link; below it none is followed, and `..` is refused.
///
/// # Errors
/// [`crate::NotPlain`], [`NotFolder`], or what the disk says.
pub fn open_below(root: &Path, path: &Path) -> io::Result<File> {
    let names = names(path)?;
    let Some((name, folders)) = names.split_last() else {
        return Err(not_plain(Kind::Folder));
    };
    let folder = enter(root, folders)?;
    // Looked at before it is opened; see the crate's documentation.
    let found = statat(&folder, *name, AtFlags::SYMLINK_NOFOLLOW)?;
    if let Some(kind) = kind_of(FileType::from_raw_mode(found.st_mode)) {
        return Err(not_plain(kind));
    }
    let flags =
        OFlags::RDONLY | OFlags::NONBLOCK | OFlags::NOFOLLOW | OFlags::NOCTTY | OFlags::CLOEXEC;
    let file = match openat(&folder, *name, flags, Mode::empty()) {
        Err(rustix::io::Errno::LOOP) => return Err(not_plain(Kind::Link)),
        other => File::from(other?),
    };
    checked(file.metadata()?.file_type())?;
    Ok(file)
}

/// Everything in the file at the relative `path` below `root`, at most `limit` bytes.
///
/// # Errors
/// As [`open_below`], and [`crate::TooLong`].
pub fn read_below(root: &Path, path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    read_file(&open_below(root, path)?, limit)
}

/// Makes sure that the relative `path` below `root` is a folder that is reached through no link.
///
/// # Errors
/// [`NotFolder`], or what the disk says, as that it is not there.
pub fn check_folder_below(root: &Path, path: &Path) -> io::Result<()> {
    enter(root, &names(path)?).map(drop)
}

/// The names in a relative path.
fn names(path: &Path) -> io::Result<Vec<&OsStr>> {
    let name = |part| match part {
        Component::Normal(name) => Some(Ok(name)),
        Component::CurDir => None,
        _ => Some(Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "found a path that leads out of its folder, expected one below it",
        ))),
    };
    path.components().filter_map(name).collect()
}

fn enter(root: &Path, folders: &[&OsStr]) -> io::Result<OwnedFd> {
    let flags = OFlags::PATH | OFlags::DIRECTORY | OFlags::CLOEXEC;
    let root = if root.as_os_str().is_empty() {
        Path::new(".")
    } else {
        root
    };
    let mut at = openat(CWD, root, flags, Mode::empty())?;
    for name in folders {
        let found = statat(&at, *name, AtFlags::SYMLINK_NOFOLLOW)?;
        match kind_of(FileType::from_raw_mode(found.st_mode)) {
            Some(Kind::Folder) => {}
            // A file has nothing below it: that is simply not there.
            None => return Err(io::ErrorKind::NotADirectory.into()),
            Some(kind) => {
                return Err(io::Error::new(io::ErrorKind::InvalidInput, NotFolder(kind)));
            }
        }
        at = openat(&at, *name, flags | OFlags::NOFOLLOW, Mode::empty())?;
    }
    Ok(at)
}

fn kind_of(kind: FileType) -> Option<Kind> {
    match kind {
        FileType::RegularFile => None,
        FileType::Directory => Some(Kind::Folder),
        FileType::Symlink => Some(Kind::Link),
        FileType::Fifo => Some(Kind::Fifo),
        FileType::Socket => Some(Kind::Socket),
        FileType::CharacterDevice => Some(Kind::CharacterDevice),
        FileType::BlockDevice => Some(Kind::BlockDevice),
        _ => Some(Kind::Other),
    }
}
