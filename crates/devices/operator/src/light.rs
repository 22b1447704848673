//! Where light goes: GPIO lines, LEDs of the kernel.
//!
//! Contract of a [`Light`]: it shows the last commanded state until the next command, and goes dark
//! when it is dropped. Showing takes no longer than the system call. An error leaves the light
//! usable: the next call tries again. The [`panel`](crate::panel) reports errors, each once.

use std::io;

use crate::DeviceError;
use crate::pattern::LightState;
use crate::spec::LightSpec;

#[cfg(test)]
pub(crate) mod fake;
pub(crate) mod gpio;
pub(crate) mod sysfs;

/// A light.
pub trait Light: Send {
    /// Shows this from now on.
    ///
    /// # Errors
    /// The error of the operating system.
    fn show(&mut self, state: LightState) -> io::Result<()>;

    /// Which light it is, in words.
    fn describe(&self) -> &str;
}

/// Opens a light of this machine; it is dark.
///
/// # Errors
/// See [`DeviceError`].
pub fn open(spec: &LightSpec) -> Result<Box<dyn Light>, DeviceError> {
    Ok(match spec {
        LightSpec::Gpio { lines, active_low } => {
            Box::new(gpio::GpioLight::open(lines, *active_low)?)
        }
        LightSpec::Sysfs(names) => Box::new(sysfs::SysfsLight::open(names)?),
    })
}
