//! Video files, image by image: whatever container and codec this machine's GStreamer reads.
//!
//! Contract. *Normally*: [`VideoFile::next`] gives every image of the file's first video track in
//! order, as I420 with full-range values, with the time that the container gives it. Nothing is
//! skipped, repeated or moved to a rate. *Times* are passed on unchanged: an absent one is `None`,
//! and the caller decides about one that does not rise. *Damage*: an image that its decoder calls
//! damaged says so. *When it fails*, also in the middle: an error, and then the same one again. *At
//! the end* it gives `None`. A few images are decoded ahead of the caller; then the decoder waits.
//!
//! ```no_run
//! # fn main() -> Result<(), video::file::FileError> {
//! let mut file = video::file::VideoFile::open("walk.mp4".as_ref())?;
//! println!("{}x{}", file.info().width, file.info().height);
//! while let Some(frame) = file.next()? {
//!     println!("{:?}", frame.time_ns);
//! }
//! # Ok(())
//! # }
//! ```

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app as gst_app;
use gstreamer_video as gst_video;
use thiserror::Error;

use crate::decoder::STALL;
use crate::pipeline::{self, InitError, News, Running, lock};
use crate::{RawImage, layout};

/// Decoded images that wait to be taken.
const AHEAD: u32 = 2;
/// Largest image, pixels: no camera has more, and a damaged file can state any size.
const MAX_PIXELS: u64 = 1 << 26;
/// How often a failure is looked for while an image is waited for.
const SLICE_MS: u64 = 50;
/// Full range BT.601, as GStreamer writes it: what a [`RawImage`] holds.
const COLOURS: &str = "1:4:0:0";

/// Why a video file cannot be read.
#[derive(Debug, Clone, Error)]
pub enum FileError {
    /// GStreamer itself is unusable.
    #[error(transparent)]
    Init(#[from] InitError),
    /// It cannot be opened: check the path and its permissions.
    #[error("opening a video file: {reason}: {}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        reason: String,
    },
    /// It is no video, damaged, or in a codec that this machine cannot decode.
    #[error("reading a video file: {reason}: {}", path.display())]
    Unusable {
        /// The file.
        path: PathBuf,
        /// What an element said.
        reason: String,
    },
    /// Nothing has come for [`STALL`].
    #[error("reading a video file: the decoder gave nothing for {} s: {}", STALL.as_secs(), path.display())]
    Stalled {
        /// The file.
        path: PathBuf,
    },
}

/// What is known of a file from its first images.
#[derive(Debug, Clone, PartialEq)]
pub struct FileInfo {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Images per second as the container says, else from the first two times; `None` where neither
    /// is known.
    pub rate_hz: Option<f64>,
    /// Whether there is chroma.
    pub colour: bool,
}

/// One image.
#[derive(Debug, Clone, PartialEq)]
pub struct FileFrame {
    /// Its time in the container, ns.
    pub time_ns: Option<i64>,
    /// The decoder says that it is damaged.
    pub damaged: bool,
    /// I420.
    pub image: RawImage,
}

/// An open file.
#[derive(Debug)]
pub struct VideoFile {
    // Dropped first: no callback runs once the pipeline has stopped.
    _running: Running,
    sink: gst_app::AppSink,
    failure: Arc<Mutex<Option<String>>>,
    path: PathBuf,
    info: FileInfo,
    /// The first images, which were needed for `info`.
    first: VecDeque<FileFrame>,
}

impl VideoFile {
    /// Opens a file and decodes its first two images.
    ///
    /// # Errors
    /// See [`FileError`].
    pub fn open(path: &Path) -> Result<Self, FileError> {
        pipeline::init()?;
        let open = |reason: String| FileError::Open {
            path: path.to_owned(),
            reason,
        };
        // GStreamer opens it once more by its name, and would wait for the other end of a pipe.
        plain_file::open(path).map_err(|e| open(e.to_string()))?;
        let unusable = |reason: String| FileError::Unusable {
            path: path.to_owned(),
            reason,
        };
        let failure: Arc<Mutex<Option<String>>> = Arc::default();
        let (running, sink) = build(path, &failure).map_err(unusable)?;
        let mut file = Self {
            _running: running,
            sink,
            failure,
            path: path.to_owned(),
            info: FileInfo {
                width: 0,
                height: 0,
                rate_hz: None,
                colour: true,
            },
            first: VecDeque::new(),
        };
        let Some((first, told_hz)) = file.decode()? else {
            return Err(unusable("it has no images".to_owned()));
        };
        let second = file.decode()?.map(|(frame, _)| frame);
        let step_ns = second
            .as_ref()
            .and_then(|second| second.time_ns?.checked_sub(first.time_ns?));
        let measured_hz = step_ns.filter(|ns| *ns > 0).map(|ns| 1e9 / ns as f64);
        file.info = FileInfo {
            width: first.image.width,
            height: first.image.height,
            rate_hz: told_hz.or(measured_hz),
            colour: file.has_chroma(),
        };
        file.first.push_back(first);
        file.first.extend(second);
        Ok(file)
    }

    /// What is known of it.
    pub fn info(&self) -> &FileInfo {
        &self.info
    }

    /// Time of its first image, ns, before any was taken.
    pub fn first_time_ns(&self) -> Option<i64> {
        self.first.front()?.time_ns
    }

    /// The next image; none at the end.
    ///
    /// # Errors
    /// See [`FileError`]. What came before is good.
    #[expect(
        clippy::should_implement_trait,
        reason = "an iterator of results would go on behind an error"
    )]
    pub fn next(&mut self) -> Result<Option<FileFrame>, FileError> {
        if let Some(frame) = self.first.pop_front() {
            return Ok(Some(frame));
        }
        Ok(self.decode()?.map(|(frame, _)| frame))
    }

    /// The next image from the decoder, and the rate that goes with it.
    fn decode(&mut self) -> Result<Option<(FileFrame, Option<f64>)>, FileError> {
        let slice = gst::ClockTime::from_mseconds(SLICE_MS);
        for _ in 0..STALL.as_millis() as u64 / SLICE_MS {
            let sample = self.sink.try_pull_sample(slice);
            if let Some(sample) = sample {
                return frame(&sample).map(Some).map_err(|r| self.unusable(r));
            }
            if let Some(reason) = lock(&self.failure).clone() {
                return Err(self.unusable(reason));
            }
            if self.sink.is_eos() {
                return Ok(None);
            }
        }
        Err(FileError::Stalled {
            path: self.path.clone(),
        })
    }

    /// Whether what the decoder gives has chroma: the converter behind it would add neutral chroma.
    fn has_chroma(&self) -> bool {
        let before = self.sink.static_pad("sink").and_then(|pad| pad.peer());
        let converter = before.and_then(|pad| pad.parent_element());
        let decoded = converter
            .and_then(|bin| bin.downcast::<gst::Bin>().ok())
            .and_then(|bin| bin.by_name(CONVERTER))
            .and_then(|converter| converter.static_pad("sink"))
            .and_then(|pad| pad.current_caps());
        let info = decoded.and_then(|caps| gst_video::VideoInfo::from_caps(&caps).ok());
        info.is_none_or(|info| !info.is_gray())
    }

    fn unusable(&self, reason: String) -> FileError {
        FileError::Unusable {
            path: self.path.clone(),
            reason,
        }
    }
}

const CONVERTER: &str = "to-i420";

/// The pipeline, playing, and its end.
fn build(
    path: &Path,
    failure: &Arc<Mutex<Option<String>>>,
) -> Result<(Running, gst_app::AppSink), String> {
    let described = format!(
        "filesrc name=from ! decodebin ! videoconvert name={CONVERTER} ! \
         video/x-raw,format=I420,colorimetry=(string){COLOURS} ! identity name=to"
    );
    // The parser would make an input of what decodebin is to be linked to as soon as it knows what
    // is in the file.
    let chain = gst::parse::bin_from_description(&described, false)
        .map_err(|error| error.message().to_owned())?;
    let end = chain.by_name("to").and_then(|end| end.static_pad("src"));
    let end = end.ok_or("no end")?;
    let output = gst::GhostPad::with_target(&end).map_err(|error| error.to_string())?;
    chain.add_pad(&output).map_err(|error| error.to_string())?;
    let source = chain.by_name("from").ok_or("no source")?;
    source.set_property("location", path);
    let sink = gst_app::AppSink::builder()
        .sync(false)
        .max_buffers(AHEAD)
        .build();
    let elements = [chain.upcast(), sink.clone().upcast()];
    let failing = failure.clone();
    let running = Running::start(&elements, move |news| {
        if let News::Failed(failure) = news {
            lock(&failing).get_or_insert_with(|| failure.to_string());
        }
    })?;
    Ok((running, sink))
}

fn check_size(width: u32, height: u32) -> Result<(), String> {
    match u64::from(width) * u64::from(height) {
        0..=MAX_PIXELS => Ok(()),
        _ => Err(format!(
            "found images of {width}x{height}, expected at most {MAX_PIXELS} pixels"
        )),
    }
}

/// A sample as an image, and the rate that the container gives.
fn frame(sample: &gst::Sample) -> Result<(FileFrame, Option<f64>), String> {
    let buffer = sample.buffer().ok_or("an image without data")?;
    let caps = sample.caps().ok_or("an image without caps")?;
    let info = gst_video::VideoInfo::from_caps(caps).map_err(|error| error.to_string())?;
    check_size(info.width(), info.height())?;
    let rate = info.fps();
    let rate_hz = f64::from(rate.numer()) / f64::from(rate.denom().max(1));
    let segment = sample.segment();
    let segment = segment.and_then(|segment| segment.downcast_ref::<gst::ClockTime>());
    let time = buffer.pts().and_then(|pts| match segment {
        Some(segment) => segment.to_stream_time(pts),
        None => Some(pts),
    });
    let frame = FileFrame {
        time_ns: time.and_then(|time| i64::try_from(time.nseconds()).ok()),
        damaged: buffer.flags().contains(gst::BufferFlags::CORRUPTED),
        image: layout::to_image(buffer, &info)?,
    };
    Ok((frame, (rate_hz > 0.0).then_some(rate_hz)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_of_any_size_that_a_camera_has_are_taken() {
        assert_eq!(check_size(15_360, 4_320), Ok(()));
        assert_eq!(check_size(1 << 13, 1 << 13), Ok(()));
        let refused = check_size(1 << 13, (1 << 13) + 2).expect_err("too large");
        assert!(refused.contains("8192x8194"), "{refused}");
        assert!(check_size(u32::MAX, u32::MAX).is_err());
    }
}
