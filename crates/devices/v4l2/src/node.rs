//! The video nodes of the machine, and which of them was meant.
//!
//! The list is what sysfs says at the moment; whether a node captures is queried from the node
//! itself, which disturbs no one. A node that goes while it is looked at is left out.

use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::device::{Camera, CameraError};
use crate::usb::{self, UsbDevice};

/// A video node.
#[derive(Debug)]
pub struct Node {
    /// `/dev/video0`.
    pub path: PathBuf,
    /// The driver's name of it: `ZED-M: ZED-M`.
    pub card: String,
    /// `uvcvideo`; none for devices without a parent.
    pub driver: Option<String>,
    /// Its number among the nodes of its device. A USB camera has frames in 0 and metadata in 1.
    pub index: u32,
    /// Whether it captures frames that this crate can take, or why the query failed.
    pub captures: Result<bool, CameraError>,
    /// What it is on USB.
    pub usb: Option<UsbDevice>,
}

/// Lists the video nodes, in the order of their numbers. `sys` is `/sys` and `dev` is `/dev`,
/// outside of tests.
///
/// # Errors
/// The folder of the nodes cannot be read. That it is not there is an empty list.
pub fn list(sys: &Path, dev: &Path) -> io::Result<Vec<Node>> {
    list_with(sys, dev, |path| {
        let camera = Camera::open_any(path)?;
        let capability = camera.capability();
        Ok(capability.captures && capability.streams)
    })
}

/// [`list`] with another way to find out whether a node captures, for tests.
///
/// # Errors
/// As [`list`].
pub(crate) fn list_with(
    sys: &Path,
    dev: &Path,
    captures: impl Fn(&Path) -> Result<bool, CameraError>,
) -> io::Result<Vec<Node>> {
    let class = sys.join("class/video4linux");
    let entries = match fs::read_dir(&class) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut names = Vec::new();
    for entry in entries {
        let name = entry?.file_name();
        // Others are v4l-subdev, vbi, radio, swradio.
        let number = name.to_str().and_then(|n| n.strip_prefix("video"));
        if let Some(number) = number.and_then(|n| n.parse::<u32>().ok()) {
            names.push((number, name));
        }
    }
    names.sort();
    let mut nodes = Vec::new();
    for (_, name) in names {
        let folder = class.join(&name);
        let device = folder.join("device");
        let Some(card) = usb::read(&folder, "name") else {
            continue;
        };
        let path = dev.join(&name);
        nodes.push(Node {
            card,
            driver: fs::canonicalize(device.join("driver"))
                .ok()
                .and_then(|p| Some(p.file_name()?.to_str()?.to_owned())),
            index: usb::read(&folder, "index")
                .and_then(|n| n.parse().ok())
                .unwrap_or(0),
            captures: captures(&path),
            usb: UsbDevice::of(&device),
            path,
        });
    }
    Ok(nodes)
}

/// Which camera is meant. As text: `/dev/video0`, `/dev/v4l/by-path/…`, `usb:2b03:f682` or
/// `usb:2b03:f682:SERIAL`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NodeSelector {
    /// The one with this USB identity.
    Usb {
        /// Vendor.
        vendor: u16,
        /// Product.
        product: u16,
        /// Serial number in the USB descriptor, where there are several.
        serial: Option<String>,
    },
    /// The node at this path, which may be a link.
    Path(PathBuf),
}

/// Why a camera was not found.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum FindError {
    /// Plug it in, or wait for it.
    #[error("no camera {wanted}; there {there}")]
    NotThere {
        /// What was looked for.
        wanted: NodeSelector,
        /// What there is.
        there: String,
    },
    /// Say which, by serial number or by path.
    #[error(
        "more than one camera {wanted}; give a serial number or a path under /dev/v4l/by-path: there {there}"
    )]
    Several {
        /// What was looked for.
        wanted: NodeSelector,
        /// Those that fit.
        there: String,
    },
}

/// Finds the node that captures the frames of a camera. One that may not be opened counts: opening
/// it says what to do.
///
/// # Errors
/// See [`FindError`].
pub fn find<'a>(nodes: &'a [Node], wanted: &NodeSelector) -> Result<&'a Node, FindError> {
    let mut fitting: Vec<&Node> = nodes
        .iter()
        .filter(|n| !matches!(n.captures, Ok(false)) && wanted.fits(n))
        .collect();
    // Where one may be opened, the others of the same camera are not it.
    if fitting.iter().any(|n| n.captures.is_ok()) {
        fitting.retain(|n| n.captures.is_ok());
    } else if fitting.iter().any(|n| n.index == 0) {
        fitting.retain(|n| n.index == 0);
    }
    let there = |nodes: &[&Node]| match nodes {
        [] => "is none".to_owned(),
        some => format!(
            "is {}",
            some.iter()
                .map(ToString::to_string)
                .collect::<Vec<_>>()
                .join(", ")
        ),
    };
    match fitting.as_slice() {
        [node] => Ok(node),
        [] => {
            let cameras: Vec<&Node> = nodes
                .iter()
                .filter(|n| !matches!(n.captures, Ok(false)))
                .collect();
            Err(FindError::NotThere {
                wanted: wanted.clone(),
                there: there(&cameras),
            })
        }
        several => Err(FindError::Several {
            wanted: wanted.clone(),
            there: there(several),
        }),
    }
}

impl NodeSelector {
    fn fits(&self, node: &Node) -> bool {
        match self {
            Self::Path(path) => {
                path == &node.path
                    || matches!(
                        (fs::canonicalize(path), fs::canonicalize(&node.path)),
                        (Ok(a), Ok(b)) if a == b
                    )
            }
            Self::Usb {
                vendor,
                product,
                serial,
            } => node.usb.as_ref().is_some_and(|usb| {
                (usb.vendor, usb.product) == (*vendor, *product)
                    && (serial.is_none() || *serial == usb.serial)
            }),
        }
    }
}

impl fmt::Display for Node {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}", self.path.display(), self.card)?;
        if let Some(usb) = &self.usb {
            write!(
                f,
                ", usb:{:04x}:{:04x} in port {}",
                usb.vendor, usb.product, usb.port
            )?;
            if let Some(serial) = &usb.serial {
                write!(f, ", serial {serial}")?;
            }
        }
        write!(f, ")")
    }
}

impl fmt::Display for NodeSelector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Path(path) => path.display().fmt(f),
            Self::Usb {
                vendor,
                product,
                serial,
            } => {
                write!(f, "usb:{vendor:04x}:{product:04x}")?;
                serial.iter().try_for_each(|s| write!(f, ":{s}"))
            }
        }
    }
}

/// A text that names no camera.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error(
    "a camera is named by a path like /dev/video0 or as usb:2b03:f682[:SERIAL]; found {found:?}"
)]
pub struct NoCamera {
    found: String,
}

impl FromStr for NodeSelector {
    type Err = NoCamera;

    fn from_str(text: &str) -> Result<Self, NoCamera> {
        let usb = |numbers: &str| {
            let mut parts = numbers.splitn(3, ':');
            let mut number = || {
                let text = parts
                    .next()
                    .filter(|t| t.len() == 4 && !t.starts_with('+'))?;
                u16::from_str_radix(text, 16).ok()
            };
            let (vendor, product) = (number()?, number()?);
            let serial = parts.next().map(str::to_owned);
            (serial.as_deref() != Some("")).then_some(Self::Usb {
                vendor,
                product,
                serial,
            })
        };
        let wanted = match text.strip_prefix("usb:") {
            Some(numbers) => usb(numbers),
            None => text.starts_with('/').then(|| Self::Path(text.into())),
        };
        wanted.ok_or_else(|| NoCamera { found: text.into() })
    }
}

#[cfg(test)]
mod tests;
