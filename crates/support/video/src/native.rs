//! Frames that stay where GStreamer put them: a camera's own buffer on its way to an encoder.
//!
//! Contract: cloning shares the buffer; nothing here copies pixels but [`NativeFrame::to_image`].
//! The buffer goes back to its camera when the last clone is dropped, and cameras have few of them
//! (nvarguscamerasrc: eight), so hold few frames, and briefly. *In device
//! memory* (NVMM on a Jetson) pixels cannot be read: [`NativeFrame::digest`] returns `None`, and
//! [`NativeFrame::to_image`] fails. The paths through NVMM have never been run on hardware by
//! this project.

use std::fmt;
use std::sync::Arc;

use gstreamer as gst;
use gstreamer_video as gst_video;
use gstreamer_video::prelude::*;
use thiserror::Error;

use crate::{RawImage, layout};

/// Device memory of a Jetson, as GStreamer's caps call it.
pub(crate) const NVMM: &str = "memory:NVMM";

/// A frame cannot be had from a native frame.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum NativeError {
    /// Put `nvvidconv` behind the camera, or leave the frame as it is.
    #[error("the frame is in device memory ({0}), expected system memory")]
    DeviceMemory(String),
    /// The layout cannot be converted, or the buffer is not what its caps say.
    #[error("reading a native frame: {0}")]
    Unreadable(String),
}

/// Size, layout and memory of native frames; the same for all frames of a capture. Cloning is
/// cheap.
#[derive(Clone, PartialEq)]
pub struct NativeFormat {
    caps: gst::Caps,
    info: Arc<gst_video::VideoInfo>,
}

impl fmt::Debug for NativeFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "NativeFormat({self})")
    }
}

impl fmt::Display for NativeFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (layout, info) = (self.info.format(), &self.info);
        write!(f, "{}x{} {layout}", info.width(), info.height())?;
        match self.device_memory() {
            Some(memory) => write!(f, " in {memory}"),
            None => Ok(()),
        }
    }
}

impl NativeFormat {
    pub(crate) fn new(caps: &gst::Caps) -> Result<NativeFormat, String> {
        let info = gst_video::VideoInfo::from_caps(caps)
            .ok()
            .filter(|info| info.format() != gst_video::VideoFormat::Encoded)
            .ok_or_else(|| format!("frames are {caps}, expected raw video"))?;
        Ok(NativeFormat {
            caps: caps.clone(),
            info: Arc::new(info),
        })
    }

    /// Columns.
    pub fn width(&self) -> u32 {
        self.info.width()
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.info.height()
    }

    /// GStreamer's name of the layout: `NV12`.
    pub fn layout(&self) -> &'static str {
        self.info.format().to_str().as_str()
    }

    /// The name of the memory, if it is not the system's: `memory:NVMM`.
    pub(crate) fn device_memory(&self) -> Option<String> {
        let features = self.caps.features(0)?;
        let mut other = features
            .iter()
            .filter(|&name| name != gst::CAPS_FEATURE_MEMORY_SYSTEM_MEMORY.as_str());
        other.next().map(|name| name.to_string())
    }

    /// Bytes of the pixels of one frame. (In device memory the buffer itself is a handle.)
    pub fn bytes(&self) -> usize {
        self.info.size()
    }

    pub(crate) fn caps(&self) -> &gst::Caps {
        &self.caps
    }

    pub(crate) fn info(&self) -> &gst_video::VideoInfo {
        &self.info
    }
}

/// One frame in its camera's own buffer. Cloning is cheap: the buffer is shared.
#[derive(Clone)]
pub struct NativeFrame {
    buffer: gst::Buffer,
    stamp_ns: i64,
    format: NativeFormat,
}

impl fmt::Debug for NativeFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "NativeFrame({} at {} ns)", self.format, self.stamp_ns)
    }
}

impl NativeFrame {
    /// A buffer whose own time says where it belongs among its siblings.
    pub(crate) fn new(buffer: gst::Buffer, format: NativeFormat) -> Result<NativeFrame, String> {
        let stamp = buffer.pts().ok_or("a frame without a time")?;
        Ok(NativeFrame {
            stamp_ns: i64::try_from(stamp.nseconds()).map_err(|_| "a frame without a time")?,
            buffer,
            format,
        })
    }

    /// Size, layout and memory.
    pub fn format(&self) -> &NativeFormat {
        &self.format
    }

    /// Bytes of the pixels, for bounding queues.
    pub fn bytes(&self) -> usize {
        self.format.bytes()
    }

    /// A number that differs for two frames of a camera that differ, as good as surely; for telling
    /// that a camera gives the same frame again and again. It looks at every fourth row of the
    /// first plane, so it is cheap (0.3 ms for 3840x1200) and a difference somewhere else goes
    /// unseen: the noise of a real camera is everywhere. `None` in device memory, where nothing can
    /// be looked at.
    pub fn digest(&self) -> Option<u64> {
        if self.format.device_memory().is_some() {
            return None;
        }
        let frame =
            gst_video::VideoFrameRef::from_buffer_ref_readable(&self.buffer, &self.format.info)
                .ok()?;
        let stride = usize::try_from(*frame.plane_stride().first()?).ok()?;
        // The whole row: of packed layouts, chroma too; padding is left out.
        let bytes = stride.min(self.format.width() as usize * frame.comp_pstride(0) as usize);
        let rows = frame.plane_data(0).ok()?.chunks(stride.max(1));
        let rows = rows.take(self.format.height() as usize).step_by(4);
        Some(rows.fold(0, |digest, row| fold(digest, &row[..bytes.min(row.len())])))
    }

    /// The frame as an I420 frame: one copy, converted as it is made.
    ///
    /// # Errors
    /// See [`NativeError`].
    pub fn to_image(&self) -> Result<RawImage, NativeError> {
        if let Some(memory) = self.format.device_memory() {
            return Err(NativeError::DeviceMemory(memory));
        }
        layout::to_image(&self.buffer, &self.format.info).map_err(NativeError::Unreadable)
    }

    pub(crate) fn buffer(&self) -> &gst::Buffer {
        &self.buffer
    }

    /// The buffer's own time, ns: rises from frame to frame of a capture.
    pub(crate) fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }
}

/// Multiply and rotate, eight bytes at a time: not for keeping secrets.
fn fold(digest: u64, row: &[u8]) -> u64 {
    let words = row.chunks(8).map(|bytes| {
        let mut word = [0; 8];
        word[..bytes.len()].copy_from_slice(bytes);
        u64::from_le_bytes(word)
    });
    words.fold(digest, |digest, word| {
        (digest ^ word)
            .wrapping_mul(0x9e37_79b9_7f4a_7c15)
            .rotate_left(29)
    })
}

#[cfg(test)]
mod tests;
