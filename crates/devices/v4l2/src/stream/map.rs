//! One mapped buffer.

use std::ffi::c_void;
use std::os::fd::BorrowedFd;
use std::ptr::NonNull;

use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

/// Memory of the driver's, readable here until this is dropped.
#[derive(Debug)]
pub(super) struct Map {
    start: NonNull<c_void>,
    len: usize,
}

// SAFETY: the memory belongs to the process and is only read through `&self`.
unsafe impl Send for Map {}
// SAFETY: as above.
unsafe impl Sync for Map {}

impl Map {
    pub(super) fn new(fd: BorrowedFd<'_>, offset: u32, len: u32) -> Result<Self, Errno> {
        let len = len as usize;
        // SAFETY: a new mapping at a place of the kernel's choice touches nothing that is in use.
        let start = unsafe {
            mmap(
                std::ptr::null_mut(),
                len,
                ProtFlags::READ,
                MapFlags::SHARED,
                fd,
                offset.into(),
            )
        }?;
        let start = NonNull::new(start).ok_or(Errno::NOMEM)?;
        Ok(Self { start, len })
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// To be read only while the buffer is not queued: then the driver does not write to it.
    pub(super) fn bytes(&self) -> &[u8] {
        // SAFETY: mapped for `len` bytes until `self` is dropped. Only a `Buffer` hands it out, and
        // a buffer is out of the driver's queue for as long as its `Buffer` lives.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr().cast(), self.len) }
    }
}

impl Drop for Map {
    fn drop(&mut self) {
        // SAFETY: our own mapping, and no slice of it outlives `self`.
        if let Err(error) = unsafe { munmap(self.start.as_ptr(), self.len) } {
            log::warn!("unmapping a buffer of {} bytes: {error}", self.len);
        }
    }
}
