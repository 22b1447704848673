//! USB devices: identity, port, and the bandwidth there.

use std::fs;
use std::path::Path;

pub mod budget;

pub use budget::{Demand, Load, Place, check};

/// A USB device, as sysfs describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UsbDevice {
    /// Vendor, 0x2b03 is Stereolabs.
    pub vendor: u16,
    /// Product.
    pub product: u16,
    /// Release of the device, which is how some vendors report their firmware: major in the high
    /// byte.
    pub release: u16,
    /// Serial number, where its USB descriptor has one.
    pub serial: Option<String>,
    /// Where it is plugged in: `1-2.3` is port 3 of the hub in port 2 of bus 1.
    pub port: String,
    /// Speed of its link, Mbit/s: 480 is USB 2, 5000 and more USB 3. 1 for 1.5.
    pub speed_mbit: u32,
    /// Its host controller: `0000:00:14.0` on PCI, `3610000.usb` in a Jetson. The USB 2 and the USB
    /// 3 bus of one controller have the same.
    pub controller: String,
}

impl UsbDevice {
    /// The USB device that something of the kernel's belongs to; `device` is the `device` link in
    /// its class folder: `/sys/class/video4linux/video0/device`,
    /// `/sys/class/hidraw/hidraw0/device`. None for what is not on USB, or is disconnected.
    pub fn of(device: &Path) -> Option<Self> {
        let device = fs::canonicalize(device).ok()?;
        let own = device.ancestors().find(|p| p.join("idVendor").is_file())?;
        let controller = own
            .ancestors()
            .find(|p| name(p).is_some_and(is_root_hub))?
            .parent()
            .and_then(name)?;
        let hexadecimal = |attribute| u16::from_str_radix(&read(own, attribute)?, 16).ok();
        Some(Self {
            vendor: hexadecimal("idVendor")?,
            product: hexadecimal("idProduct")?,
            release: hexadecimal("bcdDevice").unwrap_or(0),
            serial: read(own, "serial").filter(|s| !s.is_empty()),
            port: name(own)?.to_owned(),
            speed_mbit: read(own, "speed")?.split('.').next()?.parse().ok()?,
            controller: controller.to_owned(),
        })
    }

    /// The port of the controller itself through which it is reached: `1-2` of `1-2.3`.
    pub(crate) fn root_port(&self) -> &str {
        self.port.split('.').next().unwrap_or(&self.port)
    }
}

fn is_root_hub(name: &str) -> bool {
    name.strip_prefix("usb")
        .is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
}

fn name(path: &Path) -> Option<&str> {
    path.file_name()?.to_str()
}

/// An attribute without its line break.
pub(crate) fn read(folder: &Path, attribute: &str) -> Option<String> {
    let bytes = fs::read(folder.join(attribute)).ok()?;
    Some(String::from_utf8_lossy(&bytes).trim().to_owned())
}
