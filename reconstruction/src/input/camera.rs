//! Frames of one camera: decoded from access units, one GOP at a time, and split into left and
//! right.
//!
//! A [`GopReader`] holds the GOP that it decoded last, and nothing else that grows. The old one is
//! released before a new one is decoded, so memory is one decoded GOP and its access units.

use std::ops::Range;
use std::sync::Arc;

use session_archive::manifest;
use session_archive::time::HostTime;
use video::{AccessUnit, Codec, DecodeError, Decoder};

use super::Shared;
use super::error::{FrameFault, InputError, ReadError};
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
    /// Left image.
    pub left: Image,
    /// Right image.
    pub right: Image,
}

/// Image format of a camera.
#[derive(Debug)]
pub(super) struct Camera {
    pub(super) name: Arc<str>,
    codec: Codec,
    color: Color,
    width: u32,
    height: u32,
}

impl Camera {
    pub(super) fn new(
        camera: &manifest::Camera,
        path: &std::path::Path,
    ) -> Result<Self, InputError> {
        let unknown = |what, found: &str, expected| InputError::Unknown {
            camera: camera.name.clone(),
            what,
            found: found.to_owned(),
            expected,
            path: path.to_owned(),
        };
        let color = match camera.colour.as_str() {
            "grey" => Color::Grey,
            "yuv420" => Color::Rgb,
            other => return Err(unknown("colour", other, "grey or yuv420")),
        };
        let codec = Codec::from_foxglove_format(&camera.codec)
            .ok_or_else(|| unknown("codec", &camera.codec, "h264 or h265"))?;
        Ok(Self {
            name: camera.name.as_str().into(),
            codec,
            color,
            width: camera.width,
            height: camera.height,
        })
    }
}

/// Decodes frames of one camera in any order; fast in the order of their numbers.
#[derive(Debug)]
pub(super) struct GopReader {
    shared: Arc<Shared>,
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
    pictures: Vec<Result<video::Picture, FrameFault>>,
}

impl GopReader {
    pub(super) fn new(shared: Arc<Shared>, camera: usize) -> Self {
        let codec = shared.cameras[camera].codec;
        let decoder = Decoder::with_threads(codec, shared.threads_per_camera);
        Self {
            color: shared.cameras[camera].color,
            shared,
            camera,
            decoder,
            gop: None,
        }
    }

    /// The same with luma images, whatever the camera delivers.
    pub(super) fn luma(mut self) -> Self {
        self.color = Color::Grey;
        self
    }

    /// The frame at a position of the camera's index; the position must exist.
    pub(super) fn view(&mut self, position: usize) -> Result<View, ReadError> {
        let camera = &self.shared.cameras[self.camera];
        let entry = self.shared.index.cameras[self.camera].frames[position];
        let name = camera.name.clone();
        let (width, height, color) = (camera.width, camera.height, self.color);
        let halves = self.picture(position).and_then(|both| {
            if (both.width, both.height) != (width, height) {
                return Err(FrameFault::Size {
                    found_width: both.width,
                    found_height: both.height,
                    width,
                    height,
                });
            }
            Image::halves(&both, color).map_err(FrameFault::Image)
        });
        match halves {
            Ok((left, right)) => Ok(View {
                camera: name,
                number: entry.number,
                time: HostTime(entry.time_ns),
                sigma_ns: entry.sigma_ns,
                time_unreliable: entry.time_unreliable,
                left,
                right,
            }),
            Err(fault) => Err(ReadError::Frame {
                camera: name,
                number: entry.number,
                fault,
            }),
        }
    }

    fn picture(&mut self, position: usize) -> Result<video::Picture, FrameFault> {
        let known = self
            .gop
            .take()
            .filter(|gop| gop.positions.contains(&position));
        let gop = known.unwrap_or_else(|| self.decode(position));
        let picture = gop.pictures[position - gop.positions.start].clone();
        self.gop = Some(gop);
        picture
    }

    /// Decodes the GOP that contains `position`.
    fn decode(&mut self, position: usize) -> Gop {
        let index = &self.shared.index.cameras[self.camera];
        let positions = index.gop(position);
        let mut units = Vec::with_capacity(positions.len());
        let mut unread = None;
        for (place, entry) in index.frames[positions.clone()].iter().enumerate() {
            match self.shared.access.unit(entry) {
                Ok(data) => units.push(AccessUnit {
                    pts_ns: place_to_pts(place),
                    data,
                    key: place == 0,
                }),
                Err(error) => {
                    // Later frames depend on this one.
                    unread = Some(FrameFault::Bytes(Arc::new(error)));
                    break;
                }
            }
        }
        let (decoded, fault) = match self.decoder.decode(&units) {
            Ok(pictures) => (pictures, FrameFault::NoImage),
            Err(DecodeError::Incomplete { pictures, .. }) => (pictures, FrameFault::NoImage),
            Err(error) => (Vec::new(), FrameFault::Decoder(error)),
        };
        let mut decoded = decoded.into_iter().peekable();
        let pictures = (0..positions.len()).map(|place| {
            match decoded.next_if(|(pts_ns, _)| *pts_ns == place_to_pts(place)) {
                Some((_, picture)) => Ok(picture),
                None if place >= units.len() => Err(unread.clone().unwrap_or(FrameFault::NoImage)),
                None => Err(fault.clone()),
            }
        });
        Gop {
            pictures: pictures.collect(),
            positions,
        }
    }
}

/// The decoder gets positions in the GOP instead of times: they identify the images as well, and
/// increase even where mapped times do not.
fn place_to_pts(place: usize) -> i64 {
    place as i64 * 1_000_000
}
