//! Waiting for a file descriptor, no longer than a time limit.
//!
//! No clock is read: Linux's `ppoll` leaves in its argument what is left of the time, after a
//! signal too.

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

/// State of a file descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ready {
    pub(crate) readable: bool,
    /// It cannot be waited for any more.
    pub(crate) error: bool,
    /// Its device is disconnected.
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

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "what is tested is real time")]
mod tests {
    use std::io::Write;
    use std::os::fd::AsFd;
    use std::os::unix::net::UnixStream;
    use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
    use std::thread;
    use std::time::Instant;

    use super::*;

    const LIMIT: Duration = Duration::from_millis(300);

    #[test]
    fn what_a_descriptor_says() {
        let (mut ours, theirs) = UnixStream::pair().unwrap();
        let wait = |limit| readable(theirs.as_fd(), &mut Remaining::new(limit)).unwrap();
        assert_eq!(wait(Duration::ZERO), None);
        ours.write_all(b"x").unwrap();
        let ready = wait(Duration::MAX).unwrap();
        assert!(ready.readable && !ready.error && !ready.hang_up);
        drop(ours);
        assert!(wait(Duration::MAX).unwrap().hang_up);
    }

    static SIGNALS: AtomicU32 = AtomicU32::new(0);

    extern "C" fn count(_: libc::c_int) {
        SIGNALS.fetch_add(1, Ordering::Relaxed);
    }

    #[test]
    fn signals_do_not_make_it_longer_or_shorter() {
        // SAFETY: all fields of `sigaction` may be zero, and the handler only counts. No one else
        // in this program uses the signal.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = count as *const () as usize;
            let set = libc::sigaction(libc::SIGUSR2, &raw const action, std::ptr::null_mut());
            assert_eq!(set, 0);
        }
        let (_ours, theirs) = UnixStream::pair().unwrap();
        // SAFETY: no more than a number.
        let waiting = unsafe { libc::pthread_self() };
        let over = AtomicBool::new(false);
        let (ready, waited) = thread::scope(|scope| {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    // SAFETY: the thread outlives this scope.
                    unsafe { libc::pthread_kill(waiting, libc::SIGUSR2) };
                    thread::sleep(Duration::from_millis(20));
                }
            });
            // On a busy machine the other thread may send nothing for a while. A wait that each
            // signal made longer would never end.
            let found = loop {
                let before = SIGNALS.load(Ordering::Relaxed);
                let mut remaining = Remaining::new(LIMIT);
                let begun = Instant::now();
                let ready = readable(theirs.as_fd(), &mut remaining);
                let waited = begun.elapsed();
                if ready != Ok(None) || SIGNALS.load(Ordering::Relaxed) > before {
                    break (ready, waited);
                }
            };
            over.store(true, Ordering::Relaxed);
            found
        });
        assert_eq!(ready, Ok(None));
        assert!(waited >= LIMIT, "{waited:?}");
    }
}
