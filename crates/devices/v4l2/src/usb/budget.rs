//! Whether the cameras of a USB controller fit on it. Pure.
//!
//! A camera that gets too little does not slow down: frames come torn or green, or it disconnects.
//! So the demand of all cameras is held against what each part of the bus carries, before any
//! starts. The figures are limits of design and experience, not of a given cable: what fits here
//! may still fail there.

use std::fmt;

use super::UsbDevice;
use crate::mode::{Format, Interval};

/// All USB 3 cameras of a controller of 5 Gbit/s, bytes/s: the figure that Stereolabs gives in
/// "Multi-Camera" (stereolabs.com/docs/video/multi-camera).
const USB3_CONTROLLER: u64 = 620_000_000;
/// All USB 2 cameras of a controller, bytes/s. USB 2.0, 5.6.4: four fifths of 60 MB/s may be
/// periodic; what is left of that after headers, stuffed bits and gaps is about this in practice.
const USB2_CONTROLLER: u64 = 40_000_000;
/// One USB 2 camera, bytes/s. USB 2.0, 5.9.2: three packets of 1024 bytes in each 125 us, of which
/// the video class takes 12 bytes of each packet (UVC 1.5, 2.4.3.3).
const USB2_CAMERA: u64 = 3 * (1024 - 12) * 8000;
/// One camera of USB 1, bytes/s. USB 2.0, 5.6.3: one packet of 1023 bytes in each 1 ms.
const USB1_CAMERA: u64 = 1_023_000;

/// What one camera needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Demand {
    /// The camera's name.
    pub camera: String,
    /// What it is to do, for people: `2560x720 YUYV at 30 fps`.
    pub mode: String,
    /// Bytes/s.
    pub needs: u64,
    /// Where it is.
    pub device: UsbDevice,
}

impl Demand {
    /// What a camera needs in this mode; none where frames are compressed or the rate is unknown,
    /// for which the need is unknown.
    pub fn of(camera: &str, device: &UsbDevice, format: &Format) -> Option<Self> {
        Some(Self {
            camera: camera.to_owned(),
            mode: format.to_string(),
            needs: bytes_per_second(format.image_bytes()? as u64, format.interval?)?,
            device: device.clone(),
        })
    }
}

/// Bytes/s of frames of this many bytes, rounded up; `None` for an undefined interval.
pub fn bytes_per_second(image_bytes: u64, interval: Interval) -> Option<u64> {
    let bytes = u128::from(image_bytes) * u128::from(interval.denominator);
    if interval.numerator == 0 || interval.denominator == 0 {
        return None;
    }
    u64::try_from(bytes.div_ceil(interval.numerator.into())).ok()
}

/// A part of a bus that carries one camera or several.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Place {
    /// The port that one camera is plugged into.
    Port(String),
    /// A port of the controller, behind which a hub serves several cameras.
    Hub {
        /// The controller.
        controller: String,
        /// The controller's port.
        port: String,
    },
    /// All ports of one speed of a controller.
    Controller(String),
}

/// How a part of a bus is loaded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Load {
    /// Which part.
    pub place: Place,
    /// Its speed, Mbit/s.
    pub speed_mbit: u32,
    /// What it carries, bytes/s.
    pub available: u64,
    /// Who is on it.
    pub demands: Vec<Demand>,
}

impl Load {
    /// What all need together, bytes/s.
    pub fn needs(&self) -> u64 {
        self.demands
            .iter()
            .fold(0, |sum, d| sum.saturating_add(d.needs))
    }

    /// Whether that is available.
    pub fn fits(&self) -> bool {
        self.needs() <= self.available
    }
}

/// Holds all demands against all parts of all buses: each camera's port, each hub with several
/// cameras, each controller. What does not fit must not be started: the loads that do not
/// [`fit`](Load::fits) say, as texts, who needs how much where, and what there is.
pub fn check(demands: &[Demand]) -> Vec<Load> {
    let mut loads: Vec<Load> = Vec::new();
    for demand in demands {
        let device = &demand.device;
        let (speed_mbit, controller) = (device.speed_mbit, &device.controller);
        let places = [
            (Place::Port(device.port.clone()), one_camera(speed_mbit)),
            (
                Place::Hub {
                    controller: controller.clone(),
                    port: device.root_port().to_owned(),
                },
                link(speed_mbit),
            ),
            (
                Place::Controller(controller.clone()),
                all_cameras(speed_mbit),
            ),
        ];
        for (place, available) in places {
            let same = |l: &&mut Load| l.place == place && l.speed_mbit == speed_mbit;
            match loads.iter_mut().find(same) {
                // Ports of two controllers may have the same name only if these have one bus
                // number: never.
                Some(load) => load.demands.push(demand.clone()),
                None => loads.push(Load {
                    place,
                    speed_mbit,
                    available,
                    demands: vec![demand.clone()],
                }),
            }
        }
    }
    // A hub with one camera has the limit of the camera's port.
    loads.retain(|l| !matches!(l.place, Place::Hub { .. }) || l.demands.len() > 1);
    loads.sort_by(|a, b| (&a.place, a.speed_mbit).cmp(&(&b.place, b.speed_mbit)));
    loads
}

/// What a link carries of periodic transfers, bytes/s: 8 of 10 bits up to 5 Gbit/s and 128 of 132
/// above (USB 3.2, 6.3 and 6.4.1), of which nine tenths may be periodic (as Linux' xHCI driver
/// counts).
fn link(speed_mbit: u32) -> u64 {
    let bytes = u64::from(speed_mbit) * 1_000_000 / 8;
    match speed_mbit {
        ..5000 => all_cameras(speed_mbit),
        5000..10_000 => bytes * 8 / 10 * 9 / 10,
        _ => bytes * 128 / 132 * 9 / 10,
    }
}

fn one_camera(speed_mbit: u32) -> u64 {
    match speed_mbit {
        ..480 => USB1_CAMERA,
        480..5000 => USB2_CAMERA,
        _ => link(speed_mbit),
    }
}

fn all_cameras(speed_mbit: u32) -> u64 {
    match speed_mbit {
        ..480 => USB1_CAMERA,
        480..5000 => USB2_CONTROLLER,
        5000..10_000 => USB3_CONTROLLER,
        _ => link(speed_mbit),
    }
}

impl fmt::Display for Load {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let speed = self.speed_mbit;
        let name = match speed {
            ..480 => "USB 1",
            480..5000 => "USB 2",
            _ => "USB 3",
        };
        let available = Megabytes(self.available);
        match (&self.place, self.demands.as_slice()) {
            (Place::Port(port), [demand]) => {
                let Demand {
                    camera,
                    mode,
                    needs,
                    ..
                } = demand;
                let needs = Megabytes(*needs);
                write!(
                    f,
                    "{camera} in port {port} ({name}, {speed} Mbit/s): {mode} needs {needs}, the port \
                     carries {available}"
                )?;
                if !self.fits() && speed < 5000 {
                    write!(f, "; use a USB 3 port and a USB 3 cable")?;
                }
                return Ok(());
            }
            (Place::Port(port), _) => write!(f, "port {port}")?,
            (Place::Hub { controller, port }, _) => {
                write!(f, "hub in port {port} of controller {controller}")?;
            }
            (Place::Controller(controller), _) => write!(f, "controller {controller}")?,
        }
        write!(f, " ({name}, {speed} Mbit/s): ")?;
        for (i, demand) in self.demands.iter().enumerate() {
            let comma = if i == 0 { "" } else { ", " };
            write!(
                f,
                "{comma}{} needs {}",
                demand.camera,
                Megabytes(demand.needs)
            )?;
        }
        let together = Megabytes(self.needs());
        write!(f, ", together {together}; it carries {available}")?;
        if !self.fits() {
            write!(f, "; lower a rate or a size, or ")?;
            match self.place {
                Place::Controller(_) => write!(f, "move a camera to another controller")?,
                _ => write!(f, "plug a camera in elsewhere")?,
            }
        }
        Ok(())
    }
}

struct Megabytes(u64);

impl fmt::Display for Megabytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tenths = self.0.div_ceil(100_000);
        write!(f, "{}.{} MB/s", tenths / 10, tenths % 10)
    }
}

#[cfg(test)]
mod tests;
