//! What the driver needs of a HID device, behind a small trait, so that every failure of one can be
//! scripted.

use std::time::Duration;

/// An open device.
pub trait Link {
    /// Waits for an input report for at most `timeout` and puts it into `report`. 0 bytes: none
    /// came in that time, or a signal ended the wait.
    ///
    /// # Errors
    /// The device is disconnected or fails; the link is of no more use.
    fn read(&mut self, report: &mut [u8], timeout: Duration) -> Result<usize, LinkError>;

    /// Sends a feature report; its first byte is its number.
    ///
    /// # Errors
    /// The device refused or did not answer. That alone does not mean that it is disconnected.
    fn set_feature(&mut self, report: &[u8]) -> Result<(), LinkError>;

    /// Asks for the feature report whose number is the first byte of `report`, and puts it there;
    /// how long it is.
    ///
    /// # Errors
    /// Like [`Link::set_feature`].
    fn get_feature(&mut self, report: &mut [u8]) -> Result<usize, LinkError>;
}

/// Where a device can be opened, and opened again after it was away.
pub trait Port {
    /// The device when it is open.
    type Link: Link;

    /// Opens it.
    ///
    /// # Errors
    /// See [`OpenError`].
    fn open(&mut self) -> Result<Self::Link, OpenError>;
}

/// Why a device did not carry out a command.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{doing}: {reason}")]
pub struct LinkError {
    /// The attempted operation.
    pub doing: String,
    /// The error of the operating system.
    pub reason: String,
}

/// Why there is no open device.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OpenError {
    /// Plug it in, or ask for one that is there.
    #[error("looking for {wanted}: found {found}")]
    NotFound {
        /// What was looked for.
        wanted: String,
        /// What is there.
        found: String,
    },
    /// Say which one is meant, by its serial number.
    #[error("looking for {wanted}: found {found}, expected one; name it by its serial number")]
    Ambiguous {
        /// What was looked for.
        wanted: String,
        /// What is there.
        found: String,
    },
    /// Install the udev rules, then plug the camera in again.
    #[error(
        "opening the camera's IMU: no permission to read and write, which a udev rule gives: {path}"
    )]
    NotAllowed {
        /// The device node.
        path: String,
    },
    /// The system refused, or the device went meanwhile.
    #[error("opening the camera's IMU: {reason}: {path}")]
    Io {
        /// The error of the operating system.
        reason: String,
        /// The device node, or where it was looked for.
        path: String,
    },
    /// It is there but does not take the command to start.
    #[error("starting the camera's IMU")]
    Start(#[source] LinkError),
}
