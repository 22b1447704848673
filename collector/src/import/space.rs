//! Free space on the library's disk.

use std::io;
use std::path::Path;

use rustix::fs::statvfs;

use super::error::{ImportError, failed};

/// Free space to leave on the library's disk, bytes.
const RESERVED_BYTES: u64 = 64 << 20;

/// Checks that `bytes` more fit onto the disk of `path`.
pub(crate) fn check_space(path: &Path, bytes: u64) -> Result<(), ImportError> {
    let disk = statvfs(path)
        .map_err(io::Error::from)
        .map_err(failed("asking for free space", path))?;
    let (needed, free) = (
        bytes.saturating_add(RESERVED_BYTES),
        disk.f_bavail.saturating_mul(disk.f_frsize),
    );
    if needed > free {
        return Err(ImportError::NoSpace {
            needed,
            free,
            path: path.to_owned(),
        });
    }
    Ok(())
}
