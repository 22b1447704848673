//! Opening and reading files that others made.
//!
//! Contract: what is opened is a regular file, and opening it never waits. A FIFO, a device, a
//! socket, a folder and, where links are refused, a symbolic link is an immediate error that names
//! what was found ([`NotPlain`]); it is looked at before it is opened, because opening alone may
//! rewind a tape or wake the other end of a pipe, and again afterwards, in case it was exchanged
//! meanwhile. What is read is at most as long as the caller says: a longer file is [`TooLong`]
//! before anything is allocated, and memory that is not there is an error of kind
//! [`io::ErrorKind::OutOfMemory`], never an abort.
//!
//! Both refusals come as the source of an [`io::Error`], so that callers keep their own error
//! types; [`is_refusal`] tells them from what a disk says.

use std::fmt;
use std::fs::{self, File};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;

mod below;

pub use below::{check_folder_below, open_below, read_below};

/// Most that is read of a file that people write: configurations, rig files, calibrations, maps. 1
/// MiB.
pub const TEXT_LIMIT: u64 = 1 << 20;

/// Most that is read of a document that programs write for each other (JSON). 64 MiB.
pub const DOCUMENT_LIMIT: u64 = 64 << 20;

/// What stands in the place of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Kind {
    /// A folder.
    Folder,
    /// A symbolic link, where none is followed.
    Link,
    /// A named pipe.
    Fifo,
    /// A socket.
    Socket,
    /// A character device, as a terminal or `/dev/zero`.
    CharacterDevice,
    /// A block device, as a disk.
    BlockDevice,
    /// Something that this system calls otherwise.
    Other,
}

impl Kind {
    /// What something is; none if it is a regular file.
    pub fn of(kind: fs::FileType) -> Option<Self> {
        let found = match kind {
            k if k.is_file() => return None,
            k if k.is_dir() => Self::Folder,
            k if k.is_symlink() => Self::Link,
            k if k.is_fifo() => Self::Fifo,
            k if k.is_socket() => Self::Socket,
            k if k.is_char_device() => Self::CharacterDevice,
            k if k.is_block_device() => Self::BlockDevice,
            _ => Self::Other,
        };
        Some(found)
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Folder => "a folder",
            Self::Link => "a symbolic link",
            Self::Fifo => "a FIFO (named pipe)",
            Self::Socket => "a socket",
            Self::CharacterDevice => "a character device",
            Self::BlockDevice => "a block device",
            Self::Other => "something else",
        })
    }
}

/// Something stands where a regular file belongs: put the file there, or name another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("found {0}, expected a regular file")]
pub struct NotPlain(pub Kind);

/// A link or another thing stands where a folder belongs, below a folder in which links are not
/// followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("found {0}, expected a folder")]
pub struct NotFolder(pub Kind);

/// A file is longer than anything of its kind: it is another file, or forged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("found {found} bytes, expected at most {limit}")]
pub struct TooLong {
    /// Its length, or as much of it as was seen.
    pub found: u64,
    /// The most that is read of such a file.
    pub limit: u64,
}

/// Whether an error says that something else than a file was found, or a file too long to be what
/// it claims; the disk itself is fine then.
pub fn is_refusal(error: &io::Error) -> bool {
    let inner = error.get_ref();
    inner.is_some_and(|e| e.is::<NotPlain>() || e.is::<NotFolder>() || e.is::<TooLong>())
}

/// Whether an error says that something else than a regular file, or than a folder above it, was
/// found.
pub fn is_not_plain(error: &io::Error) -> bool {
    let inner = error.get_ref();
    inner.is_some_and(|e| e.is::<NotPlain>() || e.is::<NotFolder>())
}

pub(crate) fn not_plain(kind: Kind) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, NotPlain(kind))
}

/// Opens a regular file. Links are followed: for a path that a user gave.
///
/// # Errors
/// [`NotPlain`], or what the disk says.
pub fn open(path: &Path) -> io::Result<File> {
    checked(fs::metadata(path)?.file_type())?;
    open_checked(path, OFlags::empty())
}

/// Opens a regular file that is no link itself; the folders above it may be reached through links.
///
/// # Errors
/// [`NotPlain`], or what the disk says.
pub fn open_no_link(path: &Path) -> io::Result<File> {
    checked(fs::symlink_metadata(path)?.file_type())?;
    open_checked(path, OFlags::NOFOLLOW)
}

fn checked(kind: fs::FileType) -> io::Result<()> {
    Kind::of(kind).map_or(Ok(()), |found| Err(not_plain(found)))
}

fn open_checked(path: &Path, more: OFlags) -> io::Result<File> {
    // Without waiting: a pipe that took the file's place meanwhile must not hold us up.
    let flags = OFlags::NONBLOCK | OFlags::NOCTTY | more;
    let opened = fs::OpenOptions::new()
        .read(true)
        .custom_flags(flags.bits() as i32)
        .open(path);
    let file = match opened {
        Err(e) if e.raw_os_error() == Some(rustix::io::Errno::LOOP.raw_os_error()) => {
            return Err(not_plain(Kind::Link));
        }
        other => other?,
    };
    checked(file.metadata()?.file_type())?;
    Ok(file)
}

/// Everything in a file of at most `limit` bytes. Links are followed.
///
/// # Errors
/// [`NotPlain`], [`TooLong`], or what the disk says.
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    read_file(&open(path)?, limit)
}

/// The text in a file of at most `limit` bytes. Links are followed.
///
/// # Errors
/// [`NotPlain`], [`TooLong`], not UTF-8 (`InvalidData`), or what the disk says.
pub fn read_to_string(path: &Path, limit: u64) -> io::Result<String> {
    text(read(path, limit)?)
}

/// Bytes as text.
///
/// # Errors
/// They are not UTF-8 (`InvalidData`).
pub fn text(bytes: Vec<u8>) -> io::Result<String> {
    String::from_utf8(bytes).map_err(|e| {
        let at = e.utf8_error().valid_up_to();
        let what = format!("found bytes that are no UTF-8 at byte {at}, expected text");
        io::Error::new(io::ErrorKind::InvalidData, what)
    })
}

/// Everything in an open file from where it is, at most `limit` bytes.
///
/// # Errors
/// [`TooLong`], or what the disk says.
pub fn read_file(file: &File, limit: u64) -> io::Result<Vec<u8>> {
    read_known(file, file.metadata()?.len(), limit)
}

/// Everything in a reader that is said to hold `length` bytes, at most `limit`. It may hold more or
/// fewer: files of `/proc` are said to be empty, and others grow.
///
/// # Errors
/// [`TooLong`], or what the reader says.
pub fn read_known(mut from: impl Read, length: u64, limit: u64) -> io::Result<Vec<u8>> {
    if length > limit {
        return Err(too_long(length, limit));
    }
    let mut bytes = reserve(length)?;
    from.by_ref().take(length).read_to_end(&mut bytes)?;
    // What came after its length was looked at; mostly nothing.
    let more = limit.saturating_sub(bytes.len() as u64).saturating_add(1);
    from.take(more).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        return Err(too_long(bytes.len() as u64, limit));
    }
    Ok(bytes)
}

/// An empty vector with room for `length` bytes.
///
/// # Errors
/// There is not so much memory (`OutOfMemory`).
pub fn reserve(length: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    usize::try_from(length)
        .ok()
        .and_then(|n| bytes.try_reserve_exact(n).ok())
        .ok_or_else(|| {
            let what = format!("{length} bytes of memory are not to be had");
            io::Error::new(io::ErrorKind::OutOfMemory, what)
        })?;
    Ok(bytes)
}

pub(crate) fn too_long(found: u64, limit: u64) -> io::Error {
    io::Error::new(io::ErrorKind::FileTooLarge, TooLong { found, limit })
}

#[cfg(test)]
mod tests;
