//! Requirements of a ZED over USB beyond those of any camera: its serial number, its settings, its
//! frame sync.
//!
//! Never run on a real camera: the protocol of the video chip is known from the vendor's own
//! library only, so every failure here is reported and nothing ends because of it.

use std::path::{Path, PathBuf};
use std::time::Duration;

use v4l2::node::Node;
use v4l2::{Camera, CameraError, node};
use zed::camera::extension::{Time, activate_frame_sync, serial, set_auto_exposure};
use zed::camera::{Identity, SETTINGS};

use crate::sources::Sink;

/// Time that a newly connected camera may take until it knows its serial number, ns.
const SERIAL_TIMEOUT_NS: i64 = 500_000_000;

/// Clock for exchanges with the video chip.
struct Waiting<'a>(&'a dyn Sink);

impl Time for Waiting<'_> {
    fn now_ns(&mut self) -> i64 {
        self.0.now().0
    }

    fn wait(&mut self, time: Duration) {
        #[expect(
            clippy::disallowed_methods,
            reason = "the chip's answer is there two milliseconds after the request, and nothing tells of it"
        )]
        std::thread::sleep(time);
    }
}

/// Error of finding a ZED.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FindZedError {
    /// Connect it.
    #[error("no ZED camera is there")]
    None,
    /// Configure a serial number.
    #[error("there are {0} ZED cameras, expected serial in the configuration to say which")]
    Several(usize),
    /// Another one is connected.
    #[error("no ZED camera with serial number {configured} is there, found {found}")]
    Other {
        /// The configured number.
        configured: String,
        /// The numbers present.
        found: String,
    },
}

/// The node of the ZED with this serial number, or of the only one.
///
/// # Errors
/// There is no such ZED, or several.
pub(super) fn find(
    nodes: &[Node],
    configured: Option<&str>,
    number_of: impl Fn(&Path) -> Result<u32, String>,
) -> Result<PathBuf, FindZedError> {
    let is_zed = |node: &&Node| {
        let usb = node.usb.as_ref();
        let identity = usb.and_then(|usb| Identity::of(usb.vendor, usb.product));
        identity.is_some_and(|zed| !zed.old_firmware) && !matches!(node.captures, Ok(false))
    };
    let zeds: Vec<&Node> = nodes.iter().filter(is_zed).collect();
    match (zeds.as_slice(), configured) {
        ([], _) => Err(FindZedError::None),
        ([only], None) => Ok(only.path.clone()),
        (several, None) => Err(FindZedError::Several(several.len())),
        (several, Some(configured)) => {
            let mut found = Vec::new();
            for node in several {
                match number_of(&node.path) {
                    Ok(number) if number.to_string() == configured => return Ok(node.path.clone()),
                    Ok(number) => found.push(number.to_string()),
                    Err(error) => found.push(format!("{} ({error})", node.path.display())),
                }
            }
            Err(FindZedError::Other {
                configured: configured.to_owned(),
                found: found.join(", "),
            })
        }
    }
}

/// Finds it among the connected devices.
///
/// # Errors
/// As [`find`], or the system cannot list the devices.
pub(super) fn find_plugged(
    configured: Option<&str>,
    sink: Option<&dyn Sink>,
) -> Result<PathBuf, super::camera::StartError> {
    let nodes = node::list(Path::new("/sys"), Path::new("/dev"))?;
    let number_of = |path: &Path| {
        let Some(sink) = sink else {
            return Err("its number is read when it is started".to_owned());
        };
        let mut camera = Camera::open(path).map_err(|error| error.to_string())?;
        let until = sink.now().0 + SERIAL_TIMEOUT_NS;
        serial(&mut camera, &mut Waiting(sink), until).map_err(|error| error.to_string())
    };
    Ok(find(&nodes, configured, number_of)?)
}

/// Writes the settings that a ZED needs at every start, because it keeps those of an earlier
/// program; returns the failures.
///
/// # Errors
/// The camera is disconnected.
pub(super) fn prepare(camera: &Camera, sink: &dyn Sink) -> Result<Vec<String>, CameraError> {
    let mut failures = Vec::new();
    let known = camera.controls()?;
    let mut values = Vec::new();
    for setting in SETTINGS {
        if let Some(control) = known.iter().find(|control| control.id == setting.id) {
            values.push((setting.id, setting.value.map_or(control.default, i64::from)));
        }
    }
    for refused in camera.write_and_check(&values)? {
        failures.push(refused.to_string());
    }
    let (mut unit, mut time) = (camera.clone(), Waiting(sink));
    if let Err(error) = set_auto_exposure(&mut unit, &mut time, true) {
        failures.push(format!("setting automatic exposure: {error}"));
    }
    Ok(failures)
}

/// Lets the camera signal each frame to its microcontroller; to be called when it streams. Returns
/// the failure, if there is one.
pub(super) fn enable_frame_sync(camera: &Camera, sink: &dyn Sink) -> Option<String> {
    let mut unit = camera.clone();
    let error = activate_frame_sync(&mut unit, &mut Waiting(sink)).err()?;
    Some(format!(
        "frame sync was not switched on, so IMU and frames are tied by their arrival alone: {error}"
    ))
}

#[cfg(test)]
mod tests {
    use v4l2::usb::UsbDevice;

    use super::*;

    fn node(number: u32, product: u16) -> Node {
        Node {
            path: format!("/dev/video{number}").into(),
            card: "ZED-M".to_owned(),
            driver: Some("uvcvideo".to_owned()),
            index: 0,
            captures: Ok(true),
            usb: Some(UsbDevice {
                vendor: 0x2b03,
                product,
                release: 0,
                serial: None,
                port: format!("2-{number}"),
                speed_mbit: 5000,
                controller: "0000:00:14.0".to_owned(),
            }),
        }
    }

    #[test]
    fn configured_camera_is_found() {
        let numbers = |path: &Path| match path.to_str() {
            Some("/dev/video0") => Ok(111),
            Some("/dev/video2") => Ok(222),
            _ => Err("it does not answer".to_owned()),
        };
        let check = |nodes: &[Node], configured: Option<&str>, expected: &str| {
            let found = match find(nodes, configured, numbers) {
                Ok(path) => path.display().to_string(),
                Err(error) => error.to_string(),
            };
            assert_eq!(found, expected);
        };
        let (one, two) = (node(0, 0xf682), node(2, 0xf682));
        let other = node(1, 0xc270);
        check(&[], None, "no ZED camera is there");
        // With firmware that is too old, or not a ZED.
        check(&[node(4, 0xf680), other], None, "no ZED camera is there");
        let nodes = [one, node(1, 0xc270), two];
        check(&nodes[..2], None, "/dev/video0");
        check(&nodes, Some("222"), "/dev/video2");
        check(
            &nodes,
            None,
            "there are 2 ZED cameras, expected serial in the configuration to say which",
        );
        check(
            &nodes,
            Some("333"),
            "no ZED camera with serial number 333 is there, found 111, 222",
        );
    }
}
