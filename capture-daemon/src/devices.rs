//! Connected devices with their capabilities and problems: for `pawsd devices`.
//!
//! Contract: the inventory starts nothing and changes nothing, so it may be taken during a
//! recording. A device that cannot be queried is listed with the reason and a remedy; a machine
//! without devices gives an empty list.

use std::fmt;
use std::path::Path;

use operator::inventory::Use;
use serde::Serialize;
use v4l2::node::Node;
use v4l2::{Camera, node};
use zed::camera::Identity;

use crate::error_chain::with_causes;
use crate::sources::device::camera::key;

/// Minimum speed that a USB 3 device reports, Mbit/s.
const MIN_USB3_MBIT: u32 = 5000;

/// All devices found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Inventory {
    /// Video nodes that deliver images, or that could not be queried.
    pub cameras: Vec<FoundCamera>,
    /// IMUs of ZED cameras.
    pub imus: Vec<FoundImu>,
    /// Candidates for a button, a light or a beeper.
    pub operator: Vec<FoundOperator>,
    /// Kinds of devices that could not be listed.
    pub problems: Vec<String>,
}

/// A camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FoundCamera {
    /// Its node.
    pub path: String,
    /// Name reported by the camera.
    pub name: String,
    /// Its driver.
    pub driver: String,
    /// Vendor, product and serial number on USB.
    pub usb: Option<String>,
    /// Speed on USB, Mbit/s.
    pub speed_mbit: Option<u32>,
    /// Format, sizes and rates, a line each.
    pub modes: Vec<String>,
    /// Controls as the configuration names them, with their ranges.
    pub controls: Vec<String>,
    /// Problems, each with a remedy.
    pub problems: Vec<String>,
}

/// An IMU.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FoundImu {
    /// Its node.
    pub path: String,
    /// Model of its camera.
    pub model: String,
    /// The camera's serial number.
    pub serial: Option<String>,
    /// Firmware.
    pub firmware: Option<String>,
    /// Problems, each with a remedy.
    pub problems: Vec<String>,
}

/// A device for the operator.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FoundOperator {
    /// `button`, `light`, `beeper` or `lines`.
    pub kind: String,
    /// Its value in `[operator]`.
    pub spec: String,
    /// Name reported by the device.
    pub name: String,
    /// A problem, with a remedy.
    pub problem: Option<String>,
}

/// Lists all devices.
pub fn inventory() -> Inventory {
    let mut inventory = Inventory::default();
    match node::list(Path::new("/sys"), Path::new("/dev")) {
        Ok(nodes) => {
            // Metadata and other nodes that deliver no images are skipped.
            let cameras = nodes.iter().filter(|n| !matches!(n.captures, Ok(false)));
            inventory.cameras = cameras.map(camera).collect();
        }
        Err(error) => inventory
            .problems
            .push(format!("looking for cameras: {error}")),
    }
    match zed::imu::list() {
        Ok(found) => inventory.imus = found.iter().map(imu).collect(),
        Err(error) => inventory.problems.push(with_causes(&error)),
    }
    inventory.operator = operator::inventory::all()
        .into_iter()
        .map(|found| FoundOperator {
            kind: match found.as_what {
                Use::Button => "button",
                Use::Light => "light",
                Use::Beeper => "beeper",
                Use::Lines => "lines",
            }
            .to_owned(),
            spec: found.spec,
            name: found.name,
            problem: found.problem,
        })
        .collect();
    inventory
}

fn camera(node: &Node) -> FoundCamera {
    let usb = node.usb.as_ref();
    let mut found = FoundCamera {
        path: node.path.display().to_string(),
        name: node.card.clone(),
        driver: node.driver.clone().unwrap_or_default(),
        usb: usb.map(|usb| {
            let serial = usb.serial.as_ref().map(|s| format!(" serial {s}"));
            format!(
                "{:04x}:{:04x}{}",
                usb.vendor,
                usb.product,
                serial.unwrap_or_default()
            )
        }),
        speed_mbit: usb.map(|usb| usb.speed_mbit),
        modes: Vec::new(),
        controls: Vec::new(),
        problems: Vec::new(),
    };
    let zed = usb.and_then(|usb| Identity::of(usb.vendor, usb.product));
    if zed.is_some_and(|zed| zed.old_firmware) {
        found
            .problems
            .push("its firmware is too old to be used: update it with the maker's tool".to_owned());
    }
    if let (Some(_), Some(speed)) = (zed, found.speed_mbit)
        && speed < MIN_USB3_MBIT
    {
        found.problems.push(format!(
            "it is at {speed} Mbit/s, expected {MIN_USB3_MBIT}: use a USB 3 port and a USB 3 cable"
        ));
    }
    if let Err(problem) = query(&node.path, &mut found) {
        found.problems.push(problem);
    }
    found
}

fn query(path: &Path, found: &mut FoundCamera) -> Result<(), String> {
    let camera = Camera::open(path).map_err(|error| with_causes(&error))?;
    let modes = camera.modes().map_err(|error| with_causes(&error))?;
    for mode in &modes {
        let note = if mode.emulated {
            " (converted by software)"
        } else {
            ""
        };
        if mode.sizes.is_empty() {
            found.modes.push(format!(
                "{}{note}: any size that the driver takes",
                mode.fourcc
            ));
        }
        for size in &mode.sizes {
            let rates: Vec<String> = size.intervals.iter().map(ToString::to_string).collect();
            found.modes.push(format!(
                "{}{note} {} at {}",
                mode.fourcc,
                size.sizes,
                rates.join(", ")
            ));
        }
    }
    let controls = camera.controls().map_err(|error| with_causes(&error))?;
    let usable = controls
        .iter()
        .filter(|c| !c.read_only && c.minimum < c.maximum);
    found.controls = usable
        .map(|c| {
            format!(
                "{} {} to {}, usually {}",
                key(&c.name),
                c.minimum,
                c.maximum,
                c.default
            )
        })
        .collect();
    Ok(())
}

fn imu(found: &zed::imu::ImuDevice) -> FoundImu {
    let mut problems = Vec::new();
    if let Err(error) = std::fs::OpenOptions::new()
        .read(true)
        .write(true)
        .open(&found.path)
    {
        problems.push(format!(
            "it cannot be opened: {error}; install the udev rules 70-paws.rules, and be in the group `paws`"
        ));
    }
    FoundImu {
        path: found.path.clone(),
        model: found.model.name().to_owned(),
        serial: found.serial.clone(),
        firmware: found
            .firmware
            .map(|(major, minor)| format!("{major}.{minor}")),
        problems,
    }
}

impl Inventory {
    /// Whether there is any problem.
    pub fn has_problems(&self) -> bool {
        !self.problems.is_empty()
            || self.cameras.iter().any(|c| !c.problems.is_empty())
            || self.imus.iter().any(|i| !i.problems.is_empty())
    }
}

/// Maximum number of sizes shown per camera; the JSON contains all.
const MAX_SHOWN_SIZES: usize = 12;

impl fmt::Display for Inventory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for problem in &self.problems {
            writeln!(f, "! {problem}")?;
        }
        writeln!(f, "Cameras{}", none(self.cameras.is_empty()))?;
        for camera in &self.cameras {
            write!(f, "  {}  {}", camera.path, camera.name)?;
            if let Some(usb) = &camera.usb {
                write!(f, ", usb {usb}")?;
            }
            if let Some(speed) = camera.speed_mbit {
                write!(f, " at {speed} Mbit/s")?;
            }
            writeln!(f)?;
            for mode in camera.modes.iter().take(MAX_SHOWN_SIZES) {
                writeln!(f, "      {mode}")?;
            }
            if camera.modes.len() > MAX_SHOWN_SIZES {
                writeln!(
                    f,
                    "      and {} more (--json)",
                    camera.modes.len() - MAX_SHOWN_SIZES
                )?;
            }
            for problem in &camera.problems {
                writeln!(f, "    ! {problem}")?;
            }
        }
        writeln!(f, "\nIMUs{}", none(self.imus.is_empty()))?;
        for imu in &self.imus {
            write!(f, "  {}  {}", imu.path, imu.model)?;
            if let Some(serial) = &imu.serial {
                write!(f, ", serial {serial}")?;
            }
            if let Some(firmware) = &imu.firmware {
                write!(f, ", firmware {firmware}")?;
            }
            writeln!(f)?;
            for problem in &imu.problems {
                writeln!(f, "    ! {problem}")?;
            }
        }
        writeln!(
            f,
            "\nButtons, lights, beepers{}",
            none(self.operator.is_empty())
        )?;
        for found in &self.operator {
            writeln!(
                f,
                "  {:<7} {:<40} {}",
                found.kind,
                format!("{:?}", found.spec),
                found.name
            )?;
            if let Some(problem) = &found.problem {
                writeln!(f, "    ! {problem}")?;
            }
        }
        Ok(())
    }
}

fn none(is_empty: bool) -> &'static str {
    if is_empty { ": none" } else { "" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn problems_are_marked_in_the_text() {
        let camera = FoundCamera {
            path: "/dev/video0".to_owned(),
            name: "ZED-M".to_owned(),
            driver: "uvcvideo".to_owned(),
            usb: Some("2b03:f682".to_owned()),
            speed_mbit: Some(480),
            modes: (0..14).map(|i| format!("YUYV {i}x2 at 30 fps")).collect(),
            controls: Vec::new(),
            problems: vec!["it is at 480 Mbit/s".to_owned()],
        };
        let mut inventory = Inventory::default();
        assert!(!inventory.has_problems());
        let text = inventory.to_string();
        assert!(text.starts_with("Cameras: none\n\nIMUs: none\n"), "{text}");
        inventory.cameras.push(camera);
        assert!(inventory.has_problems());
        let text = inventory.to_string();
        for line in [
            "  /dev/video0  ZED-M, usb 2b03:f682 at 480 Mbit/s",
            "      and 2 more (--json)",
            "    ! it is at 480 Mbit/s",
        ] {
            assert!(
                text.lines().any(|found| found == line),
                "{line:?} in {text}"
            );
        }
    }

    #[test]
    fn inventory_of_this_machine_terminates() {
        let inventory = inventory();
        let json = serde_json::to_string(&inventory).unwrap();
        assert!(json.contains("\"cameras\""));
    }
}
