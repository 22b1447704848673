//! Waiting for a file descriptor, for no longer than was said.
//!
//! No clock is read: Linux's `ppoll` leaves in its argument what is left of the time, after a signal too.

use std::os::fd::{AsRawFd, BorrowedFd};
use std::time::Duration;

use rustix::io::Errno;

/// What is left of a time limit.
pub(crate) struct Remaining(libc::timespec);

impl Remaining {
    pub(crate) fn new(limit: Duration) -> Self {
        Self(libc::timespec {
            tv_sec: libc::time_t::try_from(limit.as_secs()).unwrap_or(libc::time_t::MAX),
            tv_nsec: libc::c_long::from(limit.subsec_nanos()),
        })
    }
}

/// What a file descriptor has to say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ready {
    pub(crate) readable: bool,
    /// It cannot be waited for any more.
    pub(crate) error: bool,
    /// What it stood for is gone.
    pub(crate) hang_up: bool,
}

/// Waits until there is something to read or something is wrong; none when the time is over.
pub(crate) fn readable(
    fd: BorrowedFd<'_>,
    remaining: &mut Remaining,
) -> Result<Option<Ready>, Errno> {
    let mut polled = libc::pollfd {
        fd: fd.as_raw_fd(),
        events: libc::POLLIN,
        revents: 0,
    };
    loop {
        // The wrapper of the C library works on a copy of the time, hence the bare call.
        // SAFETY: one `pollfd` and one `timespec` that are ours alone; no signal mask, of length 0.
        let count = unsafe {
            libc::syscall(
                libc::SYS_ppoll,
                &raw mut polled,
                1_usize,
                &raw mut remaining.0,
                std::ptr::null::<libc::sigset_t>(),
                0_usize,
            )
        };
        match count {
            0 => return Ok(None),
            1.. => {
                return Ok(Some(Ready {
                    readable: polled.revents & libc::POLLIN != 0,
                    error: polled.revents & (libc::POLLERR | libc::POLLNVAL) != 0,
                    hang_up: polled.revents & libc::POLLHUP != 0,
                }));
            }
            _ => {
                let error = std::io::Error::last_os_error();
                let errno = Errno::from_io_error(&error).unwrap_or(Errno::IO);
                if errno != Errno::INTR {
                    return Err(errno);
                }
            }
        }
    }
}
