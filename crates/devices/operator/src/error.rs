//! Why a button, a light or a beeper cannot be used.

use std::io;

/// What is wrong with a device. Each variant asks for something else.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// It is not there. Plug it in, or mend its name; it may come later.
    #[error("looking for {what}: there is none; expected {expected}")]
    NotFound {
        /// What was looked for.
        what: String,
        /// Where it should be.
        expected: String,
    },
    /// It was there and went. Wait for its return.
    #[error("{what} is disconnected")]
    Gone {
        /// What went.
        what: String,
    },
    /// It is there, but this user may not use it.
    #[error("not allowed to use {what}; {mend}")]
    NotAllowed {
        /// What was opened.
        what: String,
        /// The rule or group that mends it.
        mend: &'static str,
    },
    /// Somebody else uses it.
    #[error("{what} is in use by another program or driver")]
    Busy {
        /// What was opened.
        what: String,
    },
    /// It is there but is not what it was said to be.
    #[error("{what} is unfit: found {found}, expected {expected}")]
    Unfit {
        /// What was opened.
        what: String,
        /// What was found.
        found: String,
        /// What it should be.
        expected: String,
    },
    /// The system refused.
    #[error("{doing} {what}")]
    Io {
        /// The attempted operation.
        doing: &'static str,
        /// With which device.
        what: String,
        /// The error of the operating system.
        source: io::Error,
    },
}

impl DeviceError {
    /// Sorts what the system said by what is to be done about it. `what` names the device, `mend`
    /// says who may use it.
    pub(crate) fn from_io(
        doing: &'static str,
        what: &str,
        mend: &'static str,
        source: io::Error,
    ) -> Self {
        let what = what.to_owned();
        match source.kind() {
            io::ErrorKind::NotFound => Self::NotFound {
                expected: "it to be plugged in and its name to be right".into(),
                what,
            },
            io::ErrorKind::PermissionDenied => Self::NotAllowed { what, mend },
            io::ErrorKind::ResourceBusy => Self::Busy { what },
            _ if is_gone(&source) => Self::Gone { what },
            _ => Self::Io {
                doing,
                what,
                source,
            },
        }
    }
}

/// Whether the system says that the device behind an open file has been unplugged.
pub(crate) fn is_gone(error: &io::Error) -> bool {
    // evdev and GPIO say ENODEV, hidraw EIO, a device node without a driver ENXIO.
    [
        rustix::io::Errno::NODEV,
        rustix::io::Errno::IO,
        rustix::io::Errno::NXIO,
    ]
    .iter()
    .any(|errno| error.raw_os_error() == Some(errno.raw_os_error()))
}
