//! Small JPEGs of native frames, for people who want to see what the camera sees.
//!
//! Contract: the recording never waits for a preview. [`Preview::offer`] takes a frame at the
//! requested rate at most and only if nothing is inside, so a preview holds one of the camera's
//! buffers at a time; every other frame is ignored. It has a pipeline of its own, so that what
//! fails in it (no `jpegenc`, a converter that gives up) ends the preview and nothing else. Of
//! frames that nobody takes only the newest is kept. Equal frames give equal files, so a frozen
//! camera shows here even where its frames cannot be looked at (and so does a scene in which less
//! moves than the JPEG keeps). The path from a Jetson's device memory (`nvvidconv`) has never been
//! run on hardware by this project.

use std::sync::{Arc, Mutex};

use bytes::Bytes;
use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app as gst_app;
use thiserror::Error;

use crate::native::NVMM;
use crate::pipeline::{self, InitError, News, Running, lock};
use crate::raw_image::coded_size;
use crate::{NativeFormat, NativeFrame, PixelFormat, RawImageError};

/// How small, how often, how good.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PreviewSettings {
    /// Columns of a JPEG; even.
    pub width: u32,
    /// Rows; even.
    pub height: u32,
    /// Maximum rate per second; more than 0.
    pub rate_hz: f64,
    /// JPEG quality, 1 to 100.
    pub quality: u8,
}

/// Why there is no preview.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum PreviewError {
    /// GStreamer itself is unusable.
    #[error(transparent)]
    Init(#[from] InitError),
    /// Change the settings.
    #[error("preview settings: {0}")]
    Settings(String),
    /// No frame can have this size.
    #[error(transparent)]
    Size(#[from] RawImageError),
    /// This machine cannot make one of these frames.
    #[error("starting a preview: {0}")]
    Start(String),
}

/// One JPEG.
#[derive(Clone, PartialEq, Eq)]
pub struct Jpeg {
    /// The time given with the frame, ns.
    pub time_ns: i64,
    /// The file.
    pub data: Bytes,
}

impl std::fmt::Debug for Jpeg {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Jpeg({} ns, {} bytes)", self.time_ns, self.data.len())
    }
}

/// A running preview of one camera.
#[derive(Debug)]
pub struct Preview {
    // Dropped first: no callback runs once the pipeline has stopped.
    _running: Running,
    source: gst_app::AppSrc,
    format: NativeFormat,
    interval_ns: i64,
    shared: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    /// Time of the frame inside.
    inside: Option<i64>,
    /// Time of the last frame that was taken.
    taken: Option<i64>,
    newest: Option<Jpeg>,
    failure: Option<String>,
}

impl Preview {
    /// Starts a preview of frames of `format`.
    ///
    /// # Errors
    /// See [`PreviewError`].
    pub fn start(
        settings: &PreviewSettings,
        format: &NativeFormat,
    ) -> Result<Preview, PreviewError> {
        PixelFormat::I420.bytes(settings.width, settings.height)?;
        let refuse = |reason| Err(PreviewError::Settings(reason));
        let (width, height) = (settings.width, settings.height);
        if coded_size(width, height) != (width, height) {
            return refuse(format!(
                "{width}x{height}, expected an even width and height"
            ));
        }
        if !(settings.rate_hz > 0.0 && settings.rate_hz <= 1000.0) {
            return refuse(format!("rate {} Hz, expected 0 to 1000", settings.rate_hz));
        }
        if !(1..=100).contains(&settings.quality) {
            return refuse(format!("quality {}, expected 1 to 100", settings.quality));
        }
        pipeline::init()?;
        let shared = Arc::new(Mutex::new(State::default()));
        let source = gst_app::AppSrc::builder()
            .caps(format.caps())
            .format(gst::Format::Time)
            // The bound is ours: one frame.
            .max_bytes(0)
            .max_buffers(0)
            .build();
        let elements = elements(settings, format, &source, &shared).map_err(PreviewError::Start)?;
        let failing = Arc::downgrade(&shared);
        let running = Running::start(&elements, move |news| {
            if let (News::Failed(failure), Some(shared)) = (news, failing.upgrade()) {
                let mut state = lock(&shared);
                state.failure.get_or_insert_with(|| failure.to_string());
            }
        })
        .map_err(PreviewError::Start)?;
        Ok(Preview {
            _running: running,
            source,
            format: format.clone(),
            interval_ns: (1e9 / settings.rate_hz).round() as i64,
            shared,
        })
    }

    /// Offers a frame of time `time_ns`, which is taken if one is due and nothing is inside. Never
    /// waits. Frames of another format are not taken.
    pub fn offer(&self, time_ns: i64, frame: &NativeFrame) -> bool {
        let mut state = lock(&self.shared);
        // A little early counts: times jitter.
        let due = state.taken.is_none_or(|taken| {
            let since = time_ns.saturating_sub(taken);
            since < 0 || since >= self.interval_ns - self.interval_ns / 16
        });
        if !due
            || state.inside.is_some()
            || state.failure.is_some()
            || *frame.format() != self.format
        {
            return false;
        }
        (state.inside, state.taken) = (Some(time_ns), Some(time_ns));
        drop(state);
        // Fails only if the pipeline has stopped, and then it has said why.
        self.source.push_buffer(frame.buffer().clone()).is_ok()
    }

    /// The newest JPEG, once.
    pub fn take(&self) -> Option<Jpeg> {
        lock(&self.shared).newest.take()
    }

    /// Why nothing more will come, if so. Start a new one, or do without.
    pub fn failure(&self) -> Option<String> {
        lock(&self.shared).failure.clone()
    }
}

fn elements(
    settings: &PreviewSettings,
    format: &NativeFormat,
    source: &gst_app::AppSrc,
    shared: &Arc<Mutex<State>>,
) -> Result<Vec<gst::Element>, String> {
    let scaler = match format.device_memory().as_deref() {
        None => "videoscale",
        Some(NVMM) => "nvvidconv",
        Some(other) => return Err(format!("frames are in {other}, expected {NVMM}")),
    };
    let small = gst::Caps::builder("video/x-raw")
        .field("width", settings.width as i32)
        .field("height", settings.height as i32)
        // The shape is ours to choose, also if it is not the frame's.
        .field("pixel-aspect-ratio", gst::Fraction::new(1, 1));
    // Out of device memory, into what jpegenc takes.
    let small = match scaler {
        "nvvidconv" => small.field("format", "I420"),
        _ => small,
    };
    let jpeg = pipeline::make("jpegenc")?;
    pipeline::set_property(&jpeg, "quality", &settings.quality.to_string())?;
    let delivering = shared.clone();
    let sink = gst_app::AppSink::builder()
        .sync(false)
        .async_(false)
        .max_buffers(1)
        .callbacks(
            gst_app::AppSinkCallbacks::builder()
                .new_sample(move |sink| {
                    let sample = sink.pull_sample().map_err(|_| gst::FlowError::Eos)?;
                    let map = sample
                        .buffer()
                        .and_then(|buffer| buffer.map_readable().ok());
                    let mut state = lock(&delivering);
                    if let (Some(time_ns), Some(map)) = (state.inside.take(), map) {
                        let data = Bytes::copy_from_slice(&map);
                        state.newest = Some(Jpeg { time_ns, data });
                    }
                    Ok(gst::FlowSuccess::Ok)
                })
                .build(),
        )
        .build();
    Ok(vec![
        source.clone().upcast(),
        pipeline::make(scaler)?,
        pipeline::caps_filter(&small.build())?,
        jpeg,
        sink.upcast(),
    ])
}

#[cfg(test)]
mod tests;
