//! Waiting for devices, for a time, or to be called, whichever is first. No sleeping, no polling.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::time::Duration;

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};

/// Ends somebody's waiting from another thread. A call that comes before the wait ends it
/// immediately.
#[derive(Clone, Debug)]
pub struct Waker(Arc<OwnedFd>);

/// Why a wait ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Woke {
    /// The first of the devices that has something to read, or an error to report.
    Ready(usize),
    /// The time may be over: look at the clock.
    Time,
    /// Somebody called.
    Called,
}

impl Waker {
    /// One that nobody has called yet.
    ///
    /// # Errors
    /// The system has no file descriptor left.
    pub fn new() -> io::Result<Self> {
        let fd = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        Ok(Self(Arc::new(fd)))
    }

    /// Ends the present waiting, or else the next.
    pub fn call(&self) {
        // Fails only when the counter is full, and then the call is standing already.
        let _ = rustix::io::write(&*self.0, &1u64.to_ne_bytes());
    }

    fn clear(&self) {
        let _ = rustix::io::read(&*self.0, &mut [0u8; 8]);
    }
}

/// Waits for `devices`, for `timeout` (for ever if none) or for `waker`. A signal to the process
/// ends it early as [`Woke::Time`].
pub(crate) fn wait(
    devices: &[BorrowedFd<'_>],
    waker: &Waker,
    timeout: Option<Duration>,
) -> io::Result<Woke> {
    let timeout = timeout.map(|t| Timespec {
        tv_sec: t.as_secs().try_into().unwrap_or(i64::MAX),
        tv_nsec: t.subsec_nanos().into(),
    });
    let mut fds: Vec<PollFd<'_>> = [waker.0.as_fd()]
        .iter()
        .chain(devices)
        .map(|fd| PollFd::from_borrowed_fd(*fd, PollFlags::IN))
        .collect();
    match poll(&mut fds, timeout.as_ref()) {
        Ok(0) | Err(rustix::io::Errno::INTR) => Ok(Woke::Time),
        Ok(_) if !fds[0].revents().is_empty() => {
            waker.clear();
            Ok(Woke::Called)
        }
        Ok(_) => {
            let ready = fds[1..].iter().position(|fd| !fd.revents().is_empty());
            Ok(ready.map_or(Woke::Time, Woke::Ready))
        }
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_before_the_waiting_ends_it_once() {
        let waker = Waker::new().unwrap();
        waker.call();
        waker.call();
        assert_eq!(wait(&[], &waker, None).unwrap(), Woke::Called);
        let none = Some(Duration::ZERO);
        assert_eq!(wait(&[], &waker, none).unwrap(), Woke::Time);
    }

    #[test]
    fn a_device_with_something_to_read_ends_it() {
        let waker = Waker::new().unwrap();
        let (reader, mut writer) = io::pipe().unwrap();
        let none = Some(Duration::ZERO);
        assert_eq!(wait(&[reader.as_fd()], &waker, none).unwrap(), Woke::Time);
        io::Write::write_all(&mut writer, b"x").unwrap();
        assert_eq!(
            wait(&[reader.as_fd()], &waker, None).unwrap(),
            Woke::Ready(0)
        );
        drop((writer, reader));
    }
}
