//! Pictures to compressed access units and back, through GStreamer.
//!
//! A leaf: it knows pictures, times in integer nanoseconds and compressed bytes, and nothing of
//! sessions, devices or configuration files.
//!
//! - [`picture`]: uncompressed pictures, colour layouts, PSNR.
//! - [`annexb`]: looking at compressed bytes without decoding them.
//! - [`references`]: whether a compressed picture's references are there, without decoding.
//! - [`encoder`]: pictures in, access units out, with exact times and key frames on demand.
//! - [`discover`]: which encoder works on this machine.
//! - [`decoder`]: access units in, pictures out.
//! - [`mp4`]: access units into a file that players open.
//!
//! Everything here reports failure as a value: no plugin, stream or device makes it panic or hang.

pub mod annexb;
mod codec;
pub mod decoder;
pub mod discover;
pub mod encoder;
mod layout;
pub mod mp4;
pub mod picture;
mod pipeline;
pub mod references;

pub use codec::Codec;
pub use decoder::{DecodeError, Decoder};
pub use encoder::{AccessUnit, EncodeError, Encoder, EncoderEvent, EncoderSettings};
pub use picture::{Picture, PictureError, PixelFormat};
pub use pipeline::{InitError, init};
