//! A bit in the reports of a USB HID device, for buttons that the kernel does not make a key of.
//!
//! The device is found by vendor and product through hidapi; its reports are read from its hidraw
//! node, whose file descriptor one can wait on together with other things. A report carries no
//! time: an edge has the time at which its report was read. A report that is too short or has
//! another number says nothing.

use std::fs::File;
use std::io;
use std::os::fd::AsFd;
use std::time::Duration;

use hidapi::HidApi;

use super::{Button, Edge, Next};
use crate::error::is_gone;
use crate::spec::HidButton;
use crate::wait::{Waker, Woke, wait};
use crate::{Clock, DeviceError};

/// Who may use hidraw devices.
const MEND: &str =
    "the daemon's user needs a udev rule for its /dev/hidraw*, see the udev rules in deploy/";
/// Longest report, bytes: the kernel's `HID_MAX_BUFFER_SIZE` of linux/hid.h.
const MAX_REPORT: usize = 16384;

/// An open device.
pub(crate) struct HidBit {
    node: File,
    what: String,
    clock: Clock,
    reader: Reader,
    buffer: Vec<u8>,
}

/// Edges out of reports. Pure.
#[derive(Debug)]
struct Reader {
    spec: HidButton,
    /// Unknown until the first report.
    pressed: Option<bool>,
}

impl Reader {
    fn take(&mut self, report: &[u8], at_ns: i64) -> Option<Edge> {
        if self.spec.report.is_some_and(|n| report.first() != Some(&n)) {
            return None;
        }
        let pressed = report.get(self.spec.byte)? & self.spec.mask != 0;
        let before = self.pressed.replace(pressed);
        // A first report of a button that is up is no release.
        (before.unwrap_or(false) != pressed).then_some(Edge { at_ns, pressed })
    }
}

impl HidBit {
    /// Opens the first device of that vendor and product.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub(crate) fn open(spec: HidButton, clock: Clock) -> Result<Self, DeviceError> {
        let what = format!("HID device {:04x}:{:04x}", spec.vendor, spec.product);
        let failed = |error| DeviceError::Io {
            doing: "listing HID devices for",
            what: what.clone(),
            source: io::Error::other(error),
        };
        let api = HidApi::new().map_err(failed)?;
        let path = api
            .device_list()
            .filter(|found| (found.vendor_id(), found.product_id()) == (spec.vendor, spec.product))
            .find_map(|found| Some(found.path().to_str().ok()?.to_owned()))
            .ok_or_else(|| DeviceError::NotFound {
                what: what.clone(),
                expected: "it among /dev/hidraw*; `lsusb` lists what is plugged in".into(),
            })?;
        let what = format!("{what} at {path}");
        let node =
            File::open(&path).map_err(|e| DeviceError::from_io("opening", &what, MEND, e))?;
        Ok(Self {
            node,
            what,
            clock,
            reader: Reader {
                spec,
                pressed: None,
            },
            buffer: vec![0; MAX_REPORT],
        })
    }

    fn failed(&self, doing: &'static str, error: io::Error) -> DeviceError {
        if is_gone(&error) {
            let what = self.what.clone();
            return DeviceError::Gone { what };
        }
        DeviceError::from_io(doing, &self.what, MEND, error)
    }
}

impl Button for HidBit {
    fn next(&mut self, timeout: Option<Duration>, waker: &Waker) -> Result<Next, DeviceError> {
        let woke = wait(&[self.node.as_fd()], waker, timeout)
            .map_err(|e| self.failed("waiting for", e))?;
        match woke {
            Woke::Called => return Ok(Next::Called),
            Woke::Time => return Ok(Next::Time),
            Woke::Ready(_) => {}
        }
        // One read is one report.
        let n = io::Read::read(&mut &self.node, &mut self.buffer)
            .map_err(|e| self.failed("reading", e))?;
        let edge = self.reader.take(&self.buffer[..n], (self.clock)());
        Ok(edge.map_or(Next::Time, Next::Edge))
    }

    fn is_debounced(&self) -> bool {
        false
    }

    fn describe(&self) -> &str {
        &self.what
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reader(report: Option<u8>) -> Reader {
        Reader {
            spec: HidButton {
                vendor: 1,
                product: 2,
                report,
                byte: 1,
                mask: 0x06,
            },
            pressed: None,
        }
    }

    fn edge(at_ns: i64, pressed: bool) -> Option<Edge> {
        Some(Edge { at_ns, pressed })
    }

    #[test]
    fn any_bit_of_the_mask_presses_and_the_last_one_releases() {
        let mut reader = reader(None);
        assert_eq!(reader.take(&[9, 0x00], 1), None);
        assert_eq!(reader.take(&[9, 0x02], 2), edge(2, true));
        assert_eq!(reader.take(&[9, 0x06], 3), None);
        assert_eq!(reader.take(&[9, 0x04], 4), None);
        assert_eq!(reader.take(&[9, 0x01], 5), edge(5, false));
    }

    #[test]
    fn a_first_report_of_a_pressed_button_is_a_press() {
        assert_eq!(reader(None).take(&[0, 0x02], 7), edge(7, true));
    }

    #[test]
    fn other_and_short_reports_say_nothing() {
        let mut reader = reader(Some(3));
        assert_eq!(reader.take(&[3, 0x02], 1), edge(1, true));
        assert_eq!(reader.take(&[4, 0x00], 2), None);
        assert_eq!(reader.take(&[3], 3), None);
        assert_eq!(reader.take(&[], 4), None);
        assert_eq!(reader.take(&[3, 0x00], 5), edge(5, false));
    }
}
