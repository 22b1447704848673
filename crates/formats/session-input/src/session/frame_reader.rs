//! Frames of one camera: decoded from access units, one GOP at a time, and split into left and
//! right.
//!
//! A [`FrameReader`] holds the GOP that it decoded last, and nothing else that grows. The old one
//! is released before a new one is decoded, so memory is one decoded GOP and its access units.

use std::ops::Range;
use std::sync::Arc;

use session_archive::time::HostTime;
use video::raw_image::without_padding;
use video::{Decoder, RawImage};

use super::content::Content;
use crate::error::{FrameFault, ReadError};
use crate::gop;
use crate::image::{Color, Image};

/// One frame of one camera.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// The camera's name.
    pub camera: Arc<str>,
    /// Number in the camera's stream.
    pub number: u64,
    /// Middle of the exposure, host clock.
    pub time: HostTime,
    /// One standard deviation of it, ns.
    pub sigma_ns: u64,
    /// Whether the time is unreliable: its sigma may not hold.
    pub time_unreliable: bool,
    /// Exposure where the device reports it, ns.
    pub exposure_ns: Option<u32>,
    /// Left image.
    pub left: Image,
    /// Right image.
    pub right: Image,
}

/// A stereo frame as decoded: both eyes side by side, with the camera's chroma.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoFrame {
    /// Position of its camera in the index.
    pub(crate) camera: usize,
    /// Its position in the camera's index.
    pub(crate) position: usize,
    pub(crate) image: RawImage,
}

/// Decodes frames of one camera in any order; fast in the order of their numbers.
#[derive(Debug)]
pub(crate) struct FrameReader {
    content: Arc<Content>,
    camera: usize,
    color: Color,
    decoder: Decoder,
    gop: Option<Gop>,
}

/// A decoded GOP.
#[derive(Debug)]
struct Gop {
    /// Positions in the camera's index.
    positions: Range<usize>,
    /// One for each position.
    images: Vec<Result<RawImage, FrameFault>>,
}

impl FrameReader {
    /// A reader of a camera's images as it delivers them.
    pub(crate) fn new(content: Arc<Content>, camera: usize) -> Self {
        let codec = content.cameras[camera].codec;
        let decoder = Decoder::with_threads(codec, content.threads_per_camera);
        Self {
            color: content.cameras[camera].color,
            content,
            camera,
            decoder,
            gop: None,
        }
    }

    /// The same with luma images, whatever the camera delivers.
    pub(crate) fn luma(mut self) -> Self {
        self.color = Color::Grey;
        self
    }

    /// The frame at a position of the camera's index; the position must exist.
    pub(crate) fn view(&mut self, position: usize) -> Result<View, ReadError> {
        self.frame_and_view(position).map(|(_, view)| view)
    }

    /// The same, with the frame that it was split from.
    pub(crate) fn frame_and_view(
        &mut self,
        position: usize,
    ) -> Result<(StereoFrame, View), ReadError> {
        let entry = self.content.index.cameras[self.camera].frames[position];
        let name = self.content.cameras[self.camera].name.clone();
        let image = self.image(position);
        let split = image.and_then(|image| {
            let eyes = Image::halves(&image, self.color).map_err(FrameFault::Image)?;
            Ok((image, eyes))
        });
        match split {
            Ok((image, (left, right))) => {
                let frame = StereoFrame {
                    camera: self.camera,
                    position,
                    image,
                };
                let view = View {
                    camera: name,
                    number: entry.number,
                    time: HostTime(entry.time_ns),
                    sigma_ns: entry.sigma_ns,
                    time_unreliable: entry.time_unreliable,
                    exposure_ns: entry.exposure_ns,
                    left,
                    right,
                };
                Ok((frame, view))
            }
            Err(fault) => Err(ReadError::Frame {
                camera: name,
                number: entry.number,
                fault,
            }),
        }
    }

    /// A stereo frame of the size in the manifest: kept, or else decoded.
    fn image(&mut self, position: usize) -> Result<RawImage, FrameFault> {
        if let Some(image) = self.content.kept_frames.read(self.camera, position) {
            return Ok(image);
        }
        let decoded = self.decoded(position)?;
        let camera = &self.content.cameras[self.camera];
        without_padding(&decoded, camera.width, camera.height).ok_or(FrameFault::Size {
            found_width: decoded.width,
            found_height: decoded.height,
            width: camera.width,
            height: camera.height,
        })
    }

    fn decoded(&mut self, position: usize) -> Result<RawImage, FrameFault> {
        let known = self
            .gop
            .take()
            .filter(|gop| gop.positions.contains(&position));
        let gop = known.unwrap_or_else(|| {
            let index = &self.content.index.cameras[self.camera];
            let positions = index.gop(position);
            let run = &index.frames[positions.clone()];
            Gop {
                images: gop::decode(&mut self.decoder, &self.content.access, run),
                positions,
            }
        });
        let image = gop.images[position - gop.positions.start].clone();
        self.gop = Some(gop);
        image
    }
}
