//! The microcontroller through the kernel's hidraw, by the crate hidapi.
//!
//! hidraw keeps 64 reports for a reader that is late, 80 ms at 800 Hz; what comes then is lost, and
//! shows as a hole in the ticks. Reports that lie there when the device goes are lost too.

use std::ffi::CString;
use std::fs::OpenOptions;
use std::io;
use std::time::Duration;

use hidapi::{HidApi, HidDevice, HidError};

use super::link::{Link, LinkError, OpenError, Port};
use crate::camera::{Model, VENDOR};

/// A microcontroller that is plugged in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImuDevice {
    /// Of which camera.
    pub model: Model,
    /// The camera's serial number, where the device tells one.
    pub serial: Option<String>,
    /// Firmware, major and minor (2.5 is the last that is known of a ZED Mini), where the bus tells
    /// it.
    pub firmware: Option<(u8, u8)>,
    /// The device node.
    pub path: String,
}

/// The microcontroller to open.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HidPort {
    /// Only of this camera.
    pub model: Option<Model>,
    /// Only with this serial number. Without one, a device without a number matches too.
    pub serial: Option<String>,
}

/// An open hidraw device.
#[derive(Debug)]
pub struct HidLink {
    device: HidDevice,
    path: String,
}

/// All microcontrollers that are plugged in, in the order of their nodes' names.
///
/// # Errors
/// The system does not tell.
pub fn list() -> Result<Vec<ImuDevice>, OpenError> {
    let failed = |error: HidError| OpenError::Io {
        reason: error.to_string(),
        path: "/sys/class/hidraw".into(),
    };
    let mut api = HidApi::new().map_err(failed)?;
    // The process may have looked before the device came.
    api.refresh_devices().map_err(failed)?;
    let found = |info: &hidapi::DeviceInfo| {
        if info.vendor_id() != VENDOR {
            return None;
        }
        let release = info.release_number();
        Some(ImuDevice {
            model: Model::of_imu(info.product_id())?,
            serial: info
                .serial_number()
                .filter(|s| !s.is_empty())
                .map(str::to_owned),
            firmware: (release != 0).then(|| release.to_be_bytes().into()),
            path: info.path().to_string_lossy().into_owned(),
        })
    };
    let mut all: Vec<ImuDevice> = api.device_list().filter_map(found).collect();
    // A device appears once for each collection in its descriptor.
    all.sort_by(|a, b| a.path.cmp(&b.path));
    all.dedup_by(|a, b| a.path == b.path);
    Ok(all)
}

impl HidPort {
    /// The one that is meant, among those that are there.
    fn choose(&self, there: &[ImuDevice]) -> Result<ImuDevice, OpenError> {
        let fits = |f: &&ImuDevice| {
            self.model.is_none_or(|model| f.model == model)
                && (self.serial.is_none() || f.serial == self.serial)
        };
        let fitting: Vec<&ImuDevice> = there.iter().filter(fits).collect();
        match fitting[..] {
            [one] => Ok(one.clone()),
            [] => Err(OpenError::NotFound {
                wanted: self.wanted(),
                found: describe(&there.iter().collect::<Vec<_>>()),
            }),
            _ => Err(OpenError::Ambiguous {
                wanted: self.wanted(),
                found: describe(&fitting),
            }),
        }
    }

    fn wanted(&self) -> String {
        let model = self.model.map_or("camera", Model::name);
        match &self.serial {
            Some(serial) => format!("the IMU of the {model} with serial number {serial}"),
            None => format!("the IMU of a {model}"),
        }
    }
}

fn describe(found: &[&ImuDevice]) -> String {
    let one = |f: &&ImuDevice| {
        let serial = f.serial.as_deref().unwrap_or("without a serial number");
        format!("{} {serial} at {}", f.model.name(), f.path)
    };
    match found {
        [] => "none".into(),
        some => some.iter().map(one).collect::<Vec<_>>().join(", "),
    }
}

impl Port for HidPort {
    type Link = HidLink;

    fn open(&mut self) -> Result<HidLink, OpenError> {
        let path = self.choose(&list()?)?.path;
        let failed = |reason: String| OpenError::Io {
            reason,
            path: path.clone(),
        };
        // hidapi says in words what went wrong; whether it is the permission is worth knowing.
        if let Err(error) = OpenOptions::new().read(true).write(true).open(&path) {
            return Err(match error.kind() {
                io::ErrorKind::PermissionDenied => OpenError::NotAllowed { path },
                _ => failed(error.to_string()),
            });
        }
        let name = CString::new(path.clone()).map_err(|e| failed(e.to_string()))?;
        let device = HidApi::new()
            .and_then(|api| api.open_path(&name))
            .map_err(|e| failed(e.to_string()))?;
        Ok(HidLink { device, path })
    }
}

impl HidLink {
    fn failed(&self, doing: &str, error: &HidError) -> LinkError {
        LinkError {
            doing: format!("{doing} {}", self.path),
            reason: error.to_string(),
        }
    }
}

impl Link for HidLink {
    fn read(&mut self, report: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        // Rounded up: a wait of nothing would be polling.
        let ms = timeout.as_nanos().div_ceil(1_000_000).min(60_000) as i32;
        match self.device.read_timeout(report, ms) {
            Ok(read) => Ok(read),
            Err(HidError::IoError { error }) if error.kind() == io::ErrorKind::Interrupted => Ok(0),
            Err(error) => Err(self.failed("reading from", &error)),
        }
    }

    fn set_feature(&mut self, report: &[u8]) -> Result<(), LinkError> {
        self.device
            .send_feature_report(report)
            .map_err(|e| self.failed(&format!("sending feature report {report:02x?} to"), &e))
    }

    fn get_feature(&mut self, report: &mut [u8]) -> Result<usize, LinkError> {
        let doing = format!("asking for feature report {:02x?} of", report.first());
        self.device
            .get_feature_report(report)
            .map_err(|e| self.failed(&doing, &e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(model: Model, serial: Option<&str>, path: &str) -> ImuDevice {
        ImuDevice {
            model,
            serial: serial.map(str::to_owned),
            firmware: None,
            path: path.into(),
        }
    }

    fn port(model: Option<Model>, serial: Option<&str>) -> HidPort {
        HidPort {
            model,
            serial: serial.map(str::to_owned),
        }
    }

    #[test]
    fn the_one_that_is_meant_is_chosen() {
        let mini = found(Model::ZedMini, Some("15"), "/dev/hidraw0");
        let nameless = found(Model::ZedMini, None, "/dev/hidraw1");
        let two = found(Model::Zed2, Some("16"), "/dev/hidraw2");
        let all = [mini.clone(), nameless.clone(), two.clone()];
        assert_eq!(port(None, Some("15")).choose(&all), Ok(mini));
        assert_eq!(port(Some(Model::Zed2), None).choose(&all), Ok(two));
        assert_eq!(port(None, None).choose(&all[1..2]), Ok(nameless));
        let several = port(Some(Model::ZedMini), None)
            .choose(&all)
            .expect_err("two");
        assert_eq!(
            several.to_string(),
            "looking for the IMU of a ZED Mini: found ZED Mini 15 at /dev/hidraw0, ZED Mini without a serial number at \
             /dev/hidraw1, expected one; name it by its serial number"
        );
        let none = port(None, Some("99")).choose(&all[..1]).expect_err("none");
        assert_eq!(
            none.to_string(),
            "looking for the IMU of the camera with serial number 99: found ZED Mini 15 at /dev/hidraw0"
        );
    }
}
