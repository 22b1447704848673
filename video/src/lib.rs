//! Pictures to compressed access units and back, through GStreamer.
pub mod annexb;
mod codec;
pub mod picture;

pub use codec::Codec;
pub use picture::{Picture, PictureError, PixelFormat};
