//! What an encoder takes: a frame of ours, or a camera's own buffer.

use gstreamer as gst;

use super::{EncodeError, InputFormat};
use crate::{NativeFrame, PixelFormat, RawImage, RawImageError, layout};

/// One frame for [`super::Encoder::push`].
#[derive(Debug, Clone, Copy)]
pub enum Input<'a> {
    /// An I420 frame, for an encoder started with [`super::Encoder::start`].
    RawImage(&'a RawImage),
    /// A camera's buffer, for an encoder started with [`super::Encoder::start_native`].
    Native(&'a NativeFrame),
}

impl<'a> From<&'a RawImage> for Input<'a> {
    fn from(image: &'a RawImage) -> Self {
        Input::RawImage(image)
    }
}

impl<'a> From<&'a NativeFrame> for Input<'a> {
    fn from(frame: &'a NativeFrame) -> Self {
        Input::Native(frame)
    }
}

impl Input<'_> {
    /// Whether this is what the encoder was started for.
    pub(super) fn check(self, expected: &InputFormat) -> Result<(), EncodeError> {
        match (self, expected) {
            (Input::RawImage(image), &InputFormat::Images(width, height)) => {
                if (image.width, image.height) != (width, height) {
                    return Err(EncodeError::WrongSize {
                        found_width: image.width,
                        found_height: image.height,
                        width,
                        height,
                    });
                }
                if image.format != PixelFormat::I420 {
                    let (found, expected) = (image.format, PixelFormat::I420);
                    return Err(RawImageError::WrongFormat { found, expected }.into());
                }
                Ok(image.check()?)
            }
            (Input::Native(frame), InputFormat::Native(format)) if frame.format() == format => {
                Ok(())
            }
            (found, expected) => Err(EncodeError::WrongInput {
                found: match found {
                    Input::RawImage(image) => format!("{image:?}"),
                    Input::Native(frame) => format!("a native frame of {}", frame.format()),
                },
                expected: match expected {
                    InputFormat::Images(width, height) => format!("{width}x{height} frames"),
                    InputFormat::Native(format) => format!("native frames of {format}"),
                },
            }),
        }
    }

    /// The time that the buffer carries through the encoder, ns. A camera's buffer keeps its own:
    /// it may be shared, and some memory (NVIDIA's cameras mark theirs so) would be copied to give
    /// a shared buffer another time.
    pub(super) fn stamp_ns(self, pts_ns: i64) -> i64 {
        match self {
            Input::RawImage(_) => pts_ns,
            Input::Native(frame) => frame.stamp_ns(),
        }
    }

    pub(super) fn to_buffer(self, pts_ns: i64) -> Result<gst::Buffer, String> {
        match self {
            Input::RawImage(image) => {
                let mut buffer = layout::to_buffer(image)?;
                if let Some(buffer) = buffer.get_mut() {
                    buffer.set_pts(gst::ClockTime::from_nseconds(pts_ns as u64));
                }
                Ok(buffer)
            }
            Input::Native(frame) => Ok(frame.buffer().clone()),
        }
    }
}
