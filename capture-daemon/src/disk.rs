//! Free space.
//!
//! Contract: every call reads the current value, takes microseconds on a local disk and caches
//! nothing. Free space is the space that an ordinary user may still write, without the blocks
//! reserved for root.

use std::io;
use std::path::Path;

/// Minimum free space above the reserve at the start of a recording, bytes. With less, the
/// recording would end immediately.
pub(crate) const START_MARGIN_BYTES: u64 = 256 << 20;

/// Free space on the file system that holds `path`, bytes.
///
/// # Errors
/// `path` does not exist or cannot be reached.
pub(crate) fn free_bytes(path: &Path) -> io::Result<u64> {
    let stat = rustix::fs::statvfs(path)?;
    Ok(stat.f_bavail.saturating_mul(stat.f_frsize))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn free_space_is_that_of_the_file_system() {
        let folder = tempfile::tempdir().unwrap();
        let free = free_bytes(folder.path()).unwrap();
        let stat = rustix::fs::statvfs(folder.path()).unwrap();
        let size = stat.f_blocks * stat.f_frsize;
        assert!(0 < free && free <= size, "{free} of {size}");
        let absent = free_bytes(&folder.path().join("absent")).unwrap_err();
        assert_eq!(absent.kind(), io::ErrorKind::NotFound);
    }
}
