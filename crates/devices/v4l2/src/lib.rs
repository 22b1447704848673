//! V4L2 cameras by the kernel's own interface, and what USB allows.
//!
//! - [`node`] lists the video nodes of the machine and finds the one that was meant.
//! - [`device`] opens a camera: what it can do, format and rate, controls, extension units.
//! - [`stream`] takes frames out of it, as the driver wrote them.
//! - [`hotplug`] waits until a node appears or changes.
//! - [`usb`] knows the port of a device, and whether the cameras of a controller fit on it.
//!
//! ```no_run
//! use std::{path::Path, time::Duration};
//! use v4l2::{Camera, Mode, Next, Stream};
//!
//! let camera = Camera::open(Path::new("/dev/video0"))?;
//! camera.set_mode(&Mode { fourcc: "YUYV".parse()?, width: 2560, height: 720, interval: v4l2::Interval::of_rate(30) })?;
//! let mut stream = Stream::start(&camera, 8)?;
//! if let Next::Frame(buffer) = stream.next(Duration::from_millis(200))? {
//!     println!("{} bytes of frame {}", buffer.bytes().len(), buffer.info().sequence);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! `cargo run -p v4l2 --example v4l2_check` lists the cameras of a machine; with `capture` it
//! checks their frames.
//!
//! The crate knows nothing of sessions, of GStreamer, or of what the frames are for. Single-planar
//! capture with mapped buffers only; that is what USB cameras offer. It was run on the kernel's
//! `vivid` cameras; on a USB camera, extension units included, it was never run.

#[cfg(not(all(
    target_os = "linux",
    target_pointer_width = "64",
    target_endian = "little"
)))]
compile_error!("the layouts of src/sys.rs hold on 64-bit little-endian Linux only");

pub mod device;
pub mod hotplug;
pub mod node;
pub mod stream;
pub mod usb;

mod mode;
mod sys;
mod wait;

pub use device::{Camera, CameraError};
pub use mode::{Format, Fourcc, Interval, Intervals, Mode, Modes, SizeModes, Sizes};
pub use stream::{Buffer, FrameInfo, Next, Stream, StreamError};
