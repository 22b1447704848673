//! The lock for changes of a library.
//!
//! Two objects are locked: the library's folder, which needs no space and can be locked on a
//! read-only file system, and the file `.lock` in it, because network file systems lock only files
//! that are open for writing, and earlier versions lock only that. One of them is sufficient;
//! without either the library is not changed.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;

/// Name of the lock file.
const LOCK: &str = ".lock";

/// While it exists no other program changes the library. Released when it is dropped, and by the
/// system when the program dies.
pub struct Lock {
    _folder: Option<File>,
    _file: Option<File>,
}

/// Takes the lock of the library in the folder `root`; `None` if another program has it and `wait`
/// is false.
///
/// # Errors
/// Neither the folder nor the file can be locked.
pub(super) fn take(root: &Path, wait: bool) -> io::Result<Option<Lock>> {
    let folder = File::open(root)?;
    let folder = match locked(folder, wait) {
        Err(Errno::WOULDBLOCK) => return Ok(None),
        other => other.ok(),
    };
    // Non-blocking: the file may be a FIFO.
    let flags = OFlags::NONBLOCK | OFlags::NOFOLLOW;
    let file = OpenOptions::new()
        .write(true)
        .create(true)
        .truncate(false)
        .custom_flags(flags.bits() as i32)
        .open(root.join(LOCK));
    let file = match file {
        Err(_) if folder.is_some() => None,
        Err(e) => return Err(e),
        Ok(file) => match locked(file, wait) {
            Err(Errno::WOULDBLOCK) => return Ok(None),
            Err(_) if folder.is_some() => None,
            Err(e) => return Err(e.into()),
            Ok(file) => Some(file),
        },
    };
    Ok(Some(Lock {
        _folder: folder,
        _file: file,
    }))
}

fn locked(file: File, wait: bool) -> Result<File, Errno> {
    let operation = if wait {
        FlockOperation::LockExclusive
    } else {
        FlockOperation::NonBlockingLockExclusive
    };
    loop {
        match flock(&file, operation) {
            Ok(()) => return Ok(file),
            Err(Errno::INTR) => {}
            Err(e) => return Err(e),
        }
    }
}
