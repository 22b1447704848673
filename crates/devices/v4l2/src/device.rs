//! A camera that is open: what it can do and what it is set to.
//!
//! Opening disturbs no one: it neither takes the camera nor changes it. Setting a mode refuses
//! whatever the camera made of the request, unless it is the request; nothing is taken silently.
//! Settings outlive the program, in the camera: write them and
//! [`write_and_check`](Camera::write_and_check) at every start. A camera that was unplugged answers
//! everything with [`CameraError::Gone`], from then on for good; one that returns has to be opened
//! again.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustix::io::Errno;

use crate::sys;

pub mod controls;
mod extension;
mod modes;

pub use controls::{Control, ControlKind, MenuItem, RejectedValue};

/// An open camera. Clones are the same camera; it is closed with the last one and its last stream.
#[derive(Clone, Debug)]
pub struct Camera {
    file: Arc<File>,
    path: Arc<PathBuf>,
    capability: Arc<Capability>,
}

/// A driver's description of its device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Capability {
    /// Name of the driver: `uvcvideo`.
    pub driver: String,
    /// Name of the device: `ZED-M: ZED-M`.
    pub card: String,
    /// Its bus address: `usb-0000:00:14.0-2`.
    pub bus_info: String,
    /// Version of the kernel.
    pub version: (u8, u8, u8),
    /// Captures frames in single-planar buffers.
    pub captures: bool,
    /// Captures frames in multi-planar buffers, which this crate does not know.
    pub captures_planes: bool,
    /// Buffers can be mapped.
    pub streams: bool,
}

/// Why a camera cannot carry out a request.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// Become a member of the group, or install the udev rules.
    #[error(
        "not allowed to open the camera; add the user to the group `video` and log in again, or \
         install the udev rules (a systemd service also needs DeviceAllow=char-video4linux rw): {}",
        path.display()
    )]
    NoPermission {
        /// The node.
        path: PathBuf,
    },
    /// Stop the other program.
    #[error("{doing}: the camera is in use; find by whom with `fuser -v {}`", path.display())]
    Busy {
        /// The attempted operation.
        doing: &'static str,
        /// The node.
        path: PathBuf,
    },
    /// Wait for its return (see [`hotplug`](crate::hotplug)), then open it again.
    #[error("the camera is not there, or not any more: {}", path.display())]
    Gone {
        /// The node.
        path: PathBuf,
    },
    /// Name another node.
    #[error("this is no camera that can be used: {why}: {}", path.display())]
    NotACamera {
        /// What it is instead.
        why: String,
        /// The node.
        path: PathBuf,
    },
    /// Ask for one of [`Camera::modes`].
    #[error("requested {asked}, the camera gives {given}: {}", path.display())]
    Refused {
        /// The requested value.
        asked: String,
        /// What the camera made of it.
        given: String,
        /// The node.
        path: PathBuf,
    },
    /// Lower size or rate, or use another controller (see [`usb::budget`](crate::usb::budget)).
    #[error(
        "the USB bus has no bandwidth left for this camera in this mode; lower its size or rate, or \
         plug it in at another controller: {}",
        path.display()
    )]
    NoBandwidth {
        /// The node.
        path: PathBuf,
    },
    /// The driver failed.
    #[error("{doing}: {}", path.display())]
    Io {
        /// The attempted operation.
        doing: String,
        /// The node.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

impl CameraError {
    /// Whether the device is not there.
    pub fn is_gone(&self) -> bool {
        matches!(self, Self::Gone { .. })
    }

    pub(crate) fn of(doing: &'static str, errno: Errno, path: &Path) -> Self {
        let path = path.to_owned();
        match errno {
            Errno::NODEV | Errno::NXIO => Self::Gone { path },
            Errno::BUSY => Self::Busy { doing, path },
            _ => Self::Io {
                doing: doing.into(),
                path,
                source: errno.into(),
            },
        }
    }
}

impl Camera {
    /// Opens a node that captures.
    ///
    /// # Errors
    /// [`NoPermission`](CameraError::NoPermission), [`Gone`](CameraError::Gone),
    /// [`NotACamera`](CameraError::NotACamera), or [`Io`](CameraError::Io). A camera that another
    /// program streams from can be opened; taking its stream is [`Busy`](CameraError::Busy) then.
    pub fn open(path: &Path) -> Result<Self, CameraError> {
        let camera = Self::open_any(path)?;
        let not_a_camera = |why: &str| CameraError::NotACamera {
            why: format!("{} ({why})", camera.capability.card),
            path: path.to_owned(),
        };
        match *camera.capability {
            Capability {
                captures: false,
                captures_planes: true,
                ..
            } => Err(not_a_camera(
                "it offers multi-planar buffers only; use a GStreamer source for it",
            )),
            Capability {
                captures: false, ..
            } => Err(not_a_camera(
                "it captures no frames; a USB camera has a second node for metadata",
            )),
            Capability { streams: false, .. } => Err(not_a_camera("its buffers cannot be mapped")),
            _ => Ok(camera),
        }
    }

    /// Opens any V4L2 node and asks what it is.
    pub(crate) fn open_any(path: &Path) -> Result<Self, CameraError> {
        const DOING: &str = "opening the camera";
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NONBLOCK)
            .open(path)
            .map_err(|source| {
                let path = path.to_owned();
                match Errno::from_io_error(&source) {
                    Some(Errno::ACCESS | Errno::PERM) => CameraError::NoPermission { path },
                    Some(Errno::NOENT) => CameraError::Gone { path },
                    Some(errno) => CameraError::of(DOING, errno, &path),
                    None => CameraError::Io {
                        doing: DOING.into(),
                        path,
                        source,
                    },
                }
            })?;
        let mut raw = sys::Capability::default();
        sys::query_capability(file.as_fd(), &mut raw).map_err(|errno| match errno {
            Errno::NOTTY | Errno::INVAL => CameraError::NotACamera {
                why: "it does not speak V4L2".into(),
                path: path.to_owned(),
            },
            _ => CameraError::of("asking the camera what it is", errno, path),
        })?;
        Ok(Self {
            file: Arc::new(file),
            path: Arc::new(path.to_owned()),
            capability: Arc::new(Capability::of(&raw)),
        })
    }

    /// The driver's description of it.
    pub fn capability(&self) -> &Capability {
        &self.capability
    }

    /// The node that was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }

    fn failed(&self, doing: &'static str) -> impl Fn(Errno) -> CameraError + '_ {
        move |errno| CameraError::of(doing, errno, &self.path)
    }
}

impl Capability {
    fn of(raw: &sys::Capability) -> Self {
        // What this node can do; `capabilities` is of the whole device.
        let can = if raw.capabilities & sys::CAP_DEVICE_CAPS != 0 {
            raw.device_caps
        } else {
            raw.capabilities
        };
        let [patch, minor, major, _] = raw.version.to_le_bytes();
        Self {
            driver: sys::text(&raw.driver),
            card: sys::text(&raw.card),
            bus_info: sys::text(&raw.bus_info),
            version: (major, minor, patch),
            captures: can & sys::CAP_CAPTURE != 0,
            captures_planes: can & sys::CAP_CAPTURE_MPLANE != 0,
            streams: can & sys::CAP_STREAMING != 0,
        }
    }
}

#[cfg(test)]
mod tests;
