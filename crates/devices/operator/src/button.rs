//! Where presses come from: GPIO lines, keys of input devices, bits of HID reports.
//!
//! Contract of a [`Button`]: edges come in the order in which they happened, with the kernel's time
//! where it gives one (GPIO and keys; a HID report has the time at which it was read). A key that
//! repeats by itself gives no edges. Lost edges are compensated: the level is read again and a
//! change is an edge. A button that is held when it is opened gives no press, only its release.
//! When the device is unplugged, waiting ends with [`DeviceError::Gone`] and the button is of no
//! more use; open it again when it is back, which [`Port::wait`] waits for. Bouncing is left in
//! unless [`Button::is_debounced`].

use std::io;
use std::path::Path;
use std::time::Duration;

use rustix::fs::inotify;

use crate::spec::ButtonSpec;
use crate::wait::{Waker, Woke, wait};
use crate::{Clock, DeviceError};

pub(crate) mod evdev;
#[cfg(test)]
pub(crate) mod fake;
mod gpio;
mod hid;

/// The button went down or up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// When, CLOCK_MONOTONIC.
    pub at_ns: i64,
    /// Down, or up.
    pub pressed: bool,
}

/// What ended a wait for an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// An edge.
    Edge(Edge),
    /// The time may be over: look at the clock.
    Time,
    /// The waker was called.
    Called,
}

/// An open button.
pub trait Button: Send {
    /// Waits for the next edge, at most for `timeout` (for ever if none) or until `waker` is
    /// called.
    ///
    /// # Errors
    /// [`DeviceError::Gone`] when it was unplugged, [`DeviceError::Io`] when the system refuses to
    /// read.
    fn next(&mut self, timeout: Option<Duration>, waker: &Waker) -> Result<Next, DeviceError>;

    /// Whether edges come without bouncing.
    fn is_debounced(&self) -> bool;

    /// Which device it is, in words.
    fn describe(&self) -> &str;
}

/// Opens a button, and waits for it to be plugged in.
pub trait Port: Send {
    /// Opens the button.
    ///
    /// # Errors
    /// See [`DeviceError`].
    fn open(&mut self) -> Result<Box<dyn Button>, DeviceError>;

    /// Waits until it is worth opening again, at most for `timeout` or until `waker` is called. A
    /// device that came between the last [`Port::open`] and this call ends the wait immediately.
    ///
    /// # Errors
    /// The error of the operating system.
    fn wait(&mut self, timeout: Duration, waker: &Waker) -> io::Result<Next>;
}

/// Opens a button of this machine.
///
/// # Errors
/// See [`DeviceError`].
pub fn open(spec: &ButtonSpec, clock: &Clock) -> Result<Box<dyn Button>, DeviceError> {
    Ok(match spec {
        ButtonSpec::Gpio(spec) => Box::new(gpio::GpioLine::open(spec)?),
        ButtonSpec::Key(spec) => Box::new(evdev::Key::open(spec)?),
        ButtonSpec::Hid(spec) => Box::new(hid::HidBit::open(*spec, clock.clone())?),
    })
}

/// The port of a button of this machine.
pub struct DevPort {
    spec: ButtonSpec,
    clock: Clock,
    /// Device nodes that come, or whose permissions change.
    arrivals: std::os::fd::OwnedFd,
}

impl DevPort {
    /// Nothing is opened yet.
    ///
    /// # Errors
    /// The system has no more inotify instances.
    pub fn new(spec: ButtonSpec, clock: Clock) -> io::Result<Self> {
        let flags = inotify::CreateFlags::CLOEXEC | inotify::CreateFlags::NONBLOCK;
        Ok(Self {
            spec,
            clock,
            arrivals: inotify::init(flags)?,
        })
    }

    /// Forgets what came, and looks out from now on. The folder of input devices comes with the
    /// first of them.
    fn look_out(&self) -> io::Result<()> {
        let flags = inotify::WatchFlags::CREATE | inotify::WatchFlags::ATTRIB;
        inotify::add_watch(&self.arrivals, "/dev", flags)?;
        if Path::new("/dev/input").is_dir() {
            inotify::add_watch(&self.arrivals, "/dev/input", flags)?;
        }
        while rustix::io::read(&self.arrivals, &mut [0u8; 4096]).is_ok_and(|n| n > 0) {}
        Ok(())
    }
}

impl Port for DevPort {
    fn open(&mut self) -> Result<Box<dyn Button>, DeviceError> {
        // Before opening, so that nothing comes unseen between the two.
        if let Err(error) = self.look_out() {
            log::debug!("watching /dev for {}: {error}", self.spec);
        }
        open(&self.spec, &self.clock)
    }

    fn wait(&mut self, timeout: Duration, waker: &Waker) -> io::Result<Next> {
        use std::os::fd::AsFd;
        Ok(
            match wait(&[self.arrivals.as_fd()], waker, Some(timeout))? {
                Woke::Called => Next::Called,
                Woke::Ready(_) | Woke::Time => Next::Time,
            },
        )
    }
}
