//! Notifications to systemd (`sd_notify(3)`, `sd_watchdog_enabled(3)`).
//!
//! Contract: outside systemd, or with a socket that this program cannot reach, every call does
//! nothing. A message that cannot be delivered is logged once and never disturbs a recording; a
//! call waits at most [`SEND_LIMIT`]. The watchdog belongs to the caller: it has to call
//! [`Notify::watchdog`] from the loop whose stall is to be detected, at least every
//! [`Notify::watchdog_interval`].

use std::env;
use std::ffi::OsString;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Maximum time that one message may wait for the service manager.
pub(crate) const SEND_LIMIT: Duration = Duration::from_secs(1);

/// Connection to the service manager, if there is one.
#[derive(Debug)]
pub(crate) struct Notify {
    manager: Option<(UnixDatagram, SocketAddr)>,
    watchdog_interval: Option<Duration>,
    failed: AtomicBool,
}

impl Notify {
    /// Configured by the environment of this process: `NOTIFY_SOCKET`, `WATCHDOG_USEC`,
    /// `WATCHDOG_PID`.
    pub(crate) fn from_env() -> Self {
        Self::new(|key| env::var_os(key), process::id())
    }

    fn new(variable: impl Fn(&str) -> Option<OsString>, pid: u32) -> Self {
        let number = |key| variable(key)?.to_str()?.parse::<u64>().ok();
        let is_for_us = number("WATCHDOG_PID").is_none_or(|watched| watched == u64::from(pid));
        // Half the time that the manager waits, as sd_watchdog_enabled(3) advises.
        let watchdog_interval = number("WATCHDOG_USEC")
            .filter(|limit_us| *limit_us > 0 && is_for_us)
            .map(|limit_us| Duration::from_micros(limit_us / 2));
        let manager = variable("NOTIFY_SOCKET")
            .filter(|name| !name.is_empty())
            .and_then(|name| {
                connect(&name)
                    .inspect_err(|error| {
                        log::warn!(
                            "not telling the service manager anything: {error}: {}",
                            name.display()
                        )
                    })
                    .ok()
            });
        Self {
            watchdog_interval: watchdog_interval.filter(|_| manager.is_some()),
            manager,
            failed: AtomicBool::new(false),
        }
    }

    /// The daemon is up: sources are open and encoders work.
    pub(crate) fn ready(&self) {
        self.send("READY=1");
    }

    /// One line for `systemctl status`.
    pub(crate) fn status(&self, text: &str) {
        // A line break would begin another message.
        self.send(&format!("STATUS={}", text.replace(['\n', '\r'], " ")));
    }

    /// The daemon is alive.
    pub(crate) fn watchdog(&self) {
        if self.watchdog_interval.is_some() {
            self.send("WATCHDOG=1");
        }
    }

    /// The daemon is about to end.
    pub(crate) fn stopping(&self) {
        self.send("STOPPING=1");
    }

    /// Interval at which [`Notify::watchdog`] has to be called: half of the manager's timeout.
    /// `None` without a watchdog.
    pub(crate) fn watchdog_interval(&self) -> Option<Duration> {
        self.watchdog_interval
    }

    fn send(&self, message: &str) {
        let Some((socket, manager)) = &self.manager else {
            return;
        };
        if let Err(error) = socket.send_to_addr(message.as_bytes(), manager)
            && !self.failed.swap(true, Ordering::Relaxed)
        {
            log::warn!(
                "telling the service manager {message:?}: {error}; further failures are not reported"
            );
        }
    }
}

/// `name` is a path, or an abstract name after an `@`.
fn connect(name: &OsString) -> io::Result<(UnixDatagram, SocketAddr)> {
    let address = match name.as_bytes().strip_prefix(b"@") {
        Some(name) => SocketAddr::from_abstract_name(name)?,
        None if name.as_bytes().starts_with(b"/") => SocketAddr::from_pathname(name)?,
        None => {
            return Err(io::Error::other(
                "NOTIFY_SOCKET is neither an absolute path nor an abstract name",
            ));
        }
    };
    let socket = UnixDatagram::unbound()?;
    socket.set_write_timeout(Some(SEND_LIMIT))?;
    Ok((socket, address))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PID: u32 = 77;

    fn notify(variables: &[(&str, &str)]) -> Notify {
        let find = |key: &str| {
            variables
                .iter()
                .find(|(k, _)| *k == key)
                .map(|(_, value)| OsString::from(value))
        };
        Notify::new(find, PID)
    }

    fn received(socket: &UnixDatagram) -> String {
        let mut buffer = [0; 256];
        let length = socket.recv(&mut buffer).unwrap();
        String::from_utf8(buffer[..length].to_vec()).unwrap()
    }

    fn sends_every_message(manager: &UnixDatagram, name: &str) {
        manager
            .set_read_timeout(Some(Duration::from_secs(600)))
            .unwrap();
        let notify = notify(&[
            ("NOTIFY_SOCKET", name),
            ("WATCHDOG_USEC", "10000000"),
            ("WATCHDOG_PID", "77"),
        ]);
        notify.ready();
        notify.status("armed,\n3 cameras");
        notify.watchdog();
        notify.stopping();
        for expected in [
            "READY=1",
            "STATUS=armed, 3 cameras",
            "WATCHDOG=1",
            "STOPPING=1",
        ] {
            assert_eq!(received(manager), expected);
        }
        assert_eq!(notify.watchdog_interval(), Some(Duration::from_secs(5)));
    }

    #[test]
    fn reaches_a_manager_at_a_path() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let manager = UnixDatagram::bind(&path).unwrap();
        sends_every_message(&manager, path.to_str().unwrap());
    }

    #[test]
    fn reaches_a_manager_at_an_abstract_name() {
        let name = format!("pawsd-notify-test-{}", process::id());
        let manager =
            UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name).unwrap()).unwrap();
        sends_every_message(&manager, &format!("@{name}"));
    }

    #[test]
    fn sends_nothing_without_a_manager() {
        let quiet = notify(&[]);
        quiet.ready();
        quiet.watchdog();
        assert_eq!(quiet.watchdog_interval(), None);
        for unusable in ["", "vsock:2:1234", "/no/such/socket", "relative"] {
            let notify = notify(&[("NOTIFY_SOCKET", unusable)]);
            notify.ready();
            notify.status("nobody listens");
            notify.stopping();
        }
    }

    #[test]
    fn watchdog_is_used_only_when_configured() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let manager = UnixDatagram::bind(&path).unwrap();
        manager.set_nonblocking(true).unwrap();
        let check = |variables: &[(&str, &str)], expected: Option<Duration>| {
            let mut all = vec![("NOTIFY_SOCKET", path.to_str().unwrap())];
            all.extend(variables);
            let notify = notify(&all);
            assert_eq!(notify.watchdog_interval(), expected, "{variables:?}");
            notify.watchdog();
            assert_eq!(
                manager.recv(&mut [0; 64]).is_ok(),
                expected.is_some(),
                "{variables:?}"
            );
        };
        check(&[], None);
        check(
            &[("WATCHDOG_USEC", "3000000")],
            Some(Duration::from_millis(1500)),
        );
        check(
            &[("WATCHDOG_USEC", "3000000"), ("WATCHDOG_PID", "77")],
            Some(Duration::from_millis(1500)),
        );
        check(
            &[("WATCHDOG_USEC", "3000000"), ("WATCHDOG_PID", "78")],
            None,
        );
        check(&[("WATCHDOG_USEC", "0")], None);
        check(&[("WATCHDOG_USEC", "soon")], None);
        let nobody = notify(&[("WATCHDOG_USEC", "3000000")]);
        assert_eq!(
            nobody.watchdog_interval(),
            None,
            "no socket, nobody to tell"
        );
    }
}
