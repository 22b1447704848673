//! Frames to compressed access units and back, through GStreamer.
//!
//! A leaf: it knows frames, times in integer nanoseconds and compressed bytes, and nothing of
//! sessions, devices or configuration files.
//!
//! - [`raw_image`]: uncompressed frames, colour layouts, PSNR.
//! - [`annexb`]: looking at compressed bytes without decoding them.
//! - [`references`]: whether a compressed frame's references are there, without decoding.
//! - [`capture`]: cameras that come through GStreamer, with times on the clock of the host.
//! - [`native`]: their frames in their own buffers, for encoding without a copy.
//! - [`preview`]: small JPEGs of those.
//! - [`encoder`]: frames in, access units out, with exact times and key frames on demand.
//! - [`discover`]: which encoder works on this machine.
//! - [`decoder`]: access units in, frames out.
//! - [`still`]: a few small images of a recording.
//! - [`mp4`]: access units into a file that players open.
//! - [`file`](mod@file): the images of such files, and of others.
//!
//! ```
//! use std::sync::{Arc, Mutex};
//! use std::time::Duration;
//! use video::{Decoder, Encoder, EncoderEvent, EncoderSettings, RawImage, PixelFormat};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let settings = EncoderSettings {
//!     element: "x264enc".into(),
//!     width: 64,
//!     height: 32,
//!     rate_hz: 30.0,
//!     quality_db: 42.0,
//!     threads: 1,
//!     max_key_interval_frames: 300,
//!     preset: video::encoder::Preset::default(),
//! };
//! let units = Arc::new(Mutex::new(Vec::new()));
//! let collect = units.clone();
//! let mut encoder = Encoder::start(
//!     &settings,
//!     Box::new(move |event| match event {
//!         EncoderEvent::AccessUnit(unit) => collect.lock().unwrap().push(unit),
//!         EncoderEvent::Failed(reason) => eprintln!("{reason}"),
//!     }),
//! )?;
//! let grey = RawImage::new(64, 32, PixelFormat::I420, vec![128; 64 * 32 * 3 / 2])?;
//! for number in 0..10 {
//!     // Every fifth image begins a group that can be decoded alone.
//!     encoder.push(1_000_000_007 + number * 33_333_333, &grey, number % 5 == 0)?;
//! }
//! let codec = encoder.codec();
//! encoder.finish(Duration::from_secs(10))?;
//!
//! let units = units.lock().unwrap();
//! let images = Decoder::new(codec).decode(&units[5..])?;
//! assert_eq!(images.len(), 5);
//! assert_eq!(images[0].0, 1_000_000_007 + 5 * 33_333_333);
//! # Ok(())
//! # }
//! ```
//!
//! Everything here reports failure as a value: no plugin, stream or device makes it panic or hang.

pub mod annexb;
pub mod capture;
mod codec;
pub mod decoder;
pub mod discover;
pub mod encoder;
pub mod file;
mod layout;
pub mod mp4;
pub mod native;
mod pipeline;
pub mod preview;
pub mod raw_image;
pub mod references;
pub mod still;

pub use capture::{Capture, CaptureEvent, CaptureSettings, CapturedFrame};
pub use codec::Codec;
pub use decoder::{DecodeError, Decoder};
pub use encoder::{AccessUnit, EncodeError, Encoder, EncoderEvent, EncoderSettings, Input};
pub use native::{NativeError, NativeFormat, NativeFrame};
pub use pipeline::{InitError, init, version};
pub use raw_image::{PixelFormat, RawImage, RawImageError};
