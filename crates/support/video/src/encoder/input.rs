//! What an encoder takes: a frame of ours, or a camera's own buffer.

use gstreamer as gst;

use super::{EncodeError, Expected};
use crate::{NativeFrame, Picture, PictureError, PixelFormat, layout};

/// One frame for [`super::Encoder::push`].
#[derive(Debug, Clone, Copy)]
pub enum Input<'a> {
    /// An I420 frame, for an encoder started with [`super::Encoder::start`].
    Picture(&'a Picture),
    /// A camera's buffer, for an encoder started with [`super::Encoder::start_native`].
    Native(&'a NativeFrame),
}

impl<'a> From<&'a Picture> for Input<'a> {
    fn from(picture: &'a Picture) -> Self {
        Input::Picture(picture)
    }
}

impl<'a> From<&'a NativeFrame> for Input<'a> {
    fn from(frame: &'a NativeFrame) -> Self {
        Input::Native(frame)
    }
}

impl Input<'_> {
    /// Whether this is what the encoder was started for.
    pub(super) fn check(self, expected: &Expected) -> Result<(), EncodeError> {
        match (self, expected) {
            (Input::Picture(picture), &Expected::Pictures(width, height)) => {
                if (picture.width, picture.height) != (width, height) {
                    return Err(EncodeError::WrongSize {
                        found_width: picture.width,
                        found_height: picture.height,
                        width,
                        height,
                    });
                }
                if picture.format != PixelFormat::I420 {
                    let (found, expected) = (picture.format, PixelFormat::I420);
                    return Err(PictureError::WrongFormat { found, expected }.into());
                }
                Ok(picture.check()?)
            }
            (Input::Native(frame), Expected::Native(format)) if frame.format() == format => Ok(()),
            (found, expected) => Err(EncodeError::WrongInput {
                found: match found {
                    Input::Picture(picture) => format!("{picture:?}"),
                    Input::Native(frame) => format!("a native frame of {}", frame.format()),
                },
                expected: match expected {
                    Expected::Pictures(width, height) => format!("{width}x{height} frames"),
                    Expected::Native(format) => format!("native frames of {format}"),
                },
            }),
        }
    }

    /// The time that the buffer carries through the encoder, ns. A camera's buffer keeps its own:
    /// it may be shared, and some memory (NVIDIA's cameras mark theirs so) would be copied to give
    /// a shared buffer another time.
    pub(super) fn stamp_ns(self, pts_ns: i64) -> i64 {
        match self {
            Input::Picture(_) => pts_ns,
            Input::Native(frame) => frame.stamp_ns(),
        }
    }

    pub(super) fn to_buffer(self, pts_ns: i64) -> Result<gst::Buffer, String> {
        match self {
            Input::Picture(picture) => {
                let mut buffer = layout::to_buffer(picture)?;
                if let Some(buffer) = buffer.get_mut() {
                    buffer.set_pts(gst::ClockTime::from_nseconds(pts_ns as u64));
                }
                Ok(buffer)
            }
            Input::Native(frame) => Ok(frame.buffer().clone()),
        }
    }
}
