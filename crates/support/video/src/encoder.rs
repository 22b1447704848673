//! Frames in, access units out.
//!
//! Contract. *Normally*: for every frame that [`Encoder::push`] accepts, exactly one access
//! unit comes out, in the same order, with the frame's time to the nanosecond; no B-frames; a
//! key frame exactly where it was requested, at the first frame, and after
//! [`EncoderSettings::max_key_interval_frames`] frames without one; every key frame is an IDR
//! frame (closed group) with its parameter sets in front. The same settings and frames give
//! the same bytes with a software encoder. *When it is too slow*: at most [`MAX_IN_FLIGHT`]
//! frames are inside, then `push` waits and `try_push` returns [`EncodeError::Full`]. *When it
//! fails*: one [`EncoderEvent::Failed`], then nothing more; every later `push` fails. An encoder
//! that skips a frame or invents a time has failed too. *When it stalls*: `push` gives up after
//! [`STALL`]; `try_push` remains full. *At the end*: [`Encoder::finish`] drains within a time
//! limit. Dropping an encoder abandons what is inside and returns within seconds even if the
//! encoder is stuck.
//!
//! Quality is a PSNR target and becomes a constant quantiser by quantiser theory and a measured
//! correction per encoder (`encoder/quality.rs`).

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app as gst_app;
use gstreamer_video as gst_video;
use thiserror::Error;

use crate::pipeline::{self, InitError, News, Running, lock, wait_while};
use crate::raw_image::coded_size;
use crate::{Codec, NativeFormat, PixelFormat, RawImageError};
use delivery::{Inside, Shared};
use kinds::{Force, Kind};

mod chain;
mod delivery;
mod input;
pub(crate) mod kinds;
mod preset;
mod quality;

pub use input::Input;
pub use preset::Preset;

/// Maximum number of frames inside an encoder: waiting, being encoded, or not yet delivered.
/// With I420 that is `12 * width * height` bytes, 22 MB for 2560x720.
pub const MAX_IN_FLIGHT: usize = 8;

/// As [`MAX_IN_FLIGHT`], of native frames: they are their camera's buffers, which it needs back
/// (nvarguscamerasrc has eight, and stands still when they are all out).
pub const MAX_NATIVE_IN_FLIGHT: usize = 4;

/// How long a full encoder may give nothing before [`Encoder::push`] calls it stalled.
pub const STALL: Duration = Duration::from_secs(10);

/// What to encode and how well.
#[derive(Debug, Clone, PartialEq)]
pub struct EncoderSettings {
    /// GStreamer element, one of [`known_elements`].
    pub element: String,
    /// Columns. An odd last one is coded twice, see [`crate::raw_image::coded_size`].
    pub width: u32,
    /// Rows, likewise.
    pub height: u32,
    /// Nominal frame rate, more than 0 and at most 1000. Only tells players and hardware what to
    /// expect; the times of the frames are free.
    pub rate_hz: f64,
    /// Luma PSNR, 20 to 60 dB, that real and detailed frames shall reach. Easy frames get more,
    /// noise gets less (at 42 dB it was never below 40).
    pub quality_db: f64,
    /// Threads of a software encoder, at least 1. Part of what determines the bytes. Several
    /// cameras side by side use the cores better with one thread each.
    pub threads: u32,
    /// A key frame comes at the latest after this many frames; at least 1.
    pub max_key_interval_frames: u32,
    /// How hard x264enc works; the other encoders have no such setting here.
    pub preset: Preset,
}

/// One compressed frame: Annex B, complete.
#[derive(Clone, PartialEq, Eq)]
pub struct AccessUnit {
    /// The time given with the frame, ns.
    pub pts_ns: i64,
    /// NAL units with start codes.
    pub data: Bytes,
    /// Whether decoding can start here (IDR or IRAP frame).
    pub key: bool,
}

impl fmt::Debug for AccessUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let AccessUnit { pts_ns, data, key } = self;
        write!(
            f,
            "AccessUnit({pts_ns} ns, {} bytes{})",
            data.len(),
            if *key { ", key" } else { "" }
        )
    }
}

/// An event of an encoder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum EncoderEvent {
    /// The next access unit.
    AccessUnit(AccessUnit),
    /// The encoder is finished for good, for this reason. Start a new one.
    Failed(String),
}

/// Why an encoder did not start or did not take a frame.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum EncodeError {
    /// GStreamer itself is unusable.
    #[error(transparent)]
    Init(#[from] InitError),
    /// Change the settings.
    #[error("encoder settings: {0}")]
    Settings(String),
    /// This machine has no such encoder, or it cannot be driven as needed. Choose another.
    #[error("starting {element}: {reason}")]
    Start {
        /// The requested element.
        element: String,
        /// The cause.
        reason: String,
    },
    /// The frame itself is malformed.
    #[error(transparent)]
    RawImage(#[from] RawImageError),
    /// The frame does not fit the settings.
    #[error("frame is {found_width}x{found_height}, expected {width}x{height}")]
    WrongSize {
        /// Columns found.
        found_width: u32,
        /// Rows found.
        found_height: u32,
        /// Columns of the settings.
        width: u32,
        /// Rows of the settings.
        height: u32,
    },
    /// The frame is not what the encoder was started for. Start another one.
    #[error("the encoder was given {found}, expected {expected}")]
    WrongInput {
        /// What was given.
        found: String,
        /// What it was started for.
        expected: String,
    },
    /// A native frame's own time is not after the one before: the capture was restarted, or its
    /// source repeats itself. [`Encoder::finish`] this encoder and start another one.
    #[error(
        "native frame with own time {found} ns after one at {previous} ns, expected rising times"
    )]
    Discontinuity {
        /// The time found.
        found: i64,
        /// The one before.
        previous: i64,
    },
    /// Times must rise from frame to frame and not be negative.
    #[error("frame time {found} ns, expected one that is not negative and after {previous:?} ns")]
    Time {
        /// The time given.
        found: i64,
        /// The one before, if any.
        previous: Option<i64>,
    },
    /// Try again later, or drop the frame.
    #[error("encoder is full: {images} frames are inside")]
    Full {
        /// Frames inside.
        images: usize,
    },
    /// Start a new encoder.
    #[error("encoder gave nothing for {} s with {images} frames inside", .after.as_secs_f64())]
    Stalled {
        /// How long was waited.
        after: Duration,
        /// Frames inside.
        images: usize,
    },
    /// Start a new encoder.
    #[error("encoder failed: {0}")]
    Failed(String),
}

/// The elements that [`EncoderSettings::element`] may name, best first. Which of them this machine
/// has, and which work, is another question: see [`crate::discover`].
pub fn known_elements() -> impl Iterator<Item = &'static str> {
    kinds::KINDS.iter().map(|kind| kind.element)
}

/// The codec that an element produces; `None` if it is not one of [`known_elements`].
pub fn element_codec(element: &str) -> Option<Codec> {
    kinds::find(element).map(|kind| kind.codec)
}

/// Receives what comes out, on a thread of the encoder. It must return: while it blocks the
/// encoder stands still, and it must not touch the [`Encoder`].
pub type OnOutput = Box<dyn FnMut(EncoderEvent) + Send>;

/// A running encoder for the frames of one camera.
#[derive(Debug)]
pub struct Encoder {
    // Dropped first: no callback runs once the pipeline has stopped.
    _running: Running,
    source: gst_app::AppSrc,
    shared: Arc<Shared>,
    kind: &'static Kind,
    element: gst::Element,
    preset: Preset,
    quantiser: u32,
    expected: InputFormat,
    max_in_flight: usize,
    frame_bytes: usize,
    previous_ns: Option<i64>,
    previous_stamp_ns: Option<i64>,
    keys_forced: u32,
}

/// What an encoder was started for.
#[derive(Debug)]
enum InputFormat {
    /// I420 frames, columns and rows.
    Images(u32, u32),
    Native(NativeFormat),
}

impl Encoder {
    /// Starts an encoder. `on_output` is called for every event, see [`OnOutput`]. An encoder may
    /// fail only with the first frame, which sets the device's format; that comes as
    /// [`EncoderEvent::Failed`]. (An error returned here may have been reported to `on_output` as
    /// well.)
    ///
    /// # Errors
    /// [`EncodeError::Settings`], [`EncodeError::RawImage`] for an impossible size,
    /// [`EncodeError::Start`], [`EncodeError::Init`].
    pub fn start(settings: &EncoderSettings, on_output: OnOutput) -> Result<Encoder, EncodeError> {
        Encoder::start_for(settings, None, on_output)
    }

    /// As [`Encoder::start`], for native frames of one format. They go into the encoder as they
    /// are, without a copy, where it takes their layout and memory (NV12 in NVMM into the nvv4l2
    /// encoders, NV12 in system memory into x264enc); else through a converter.
    ///
    /// # Errors
    /// As [`Encoder::start`], and [`EncodeError::WrongSize`] if format and settings differ.
    pub fn start_native(
        settings: &EncoderSettings,
        format: &NativeFormat,
        on_output: OnOutput,
    ) -> Result<Encoder, EncodeError> {
        Encoder::start_for(settings, Some(format), on_output)
    }

    fn start_for(
        settings: &EncoderSettings,
        native: Option<&NativeFormat>,
        on_output: OnOutput,
    ) -> Result<Encoder, EncodeError> {
        check(settings)?;
        let (width, height) = (settings.width, settings.height);
        if native.is_some() && coded_size(width, height) != (width, height) {
            return Err(EncodeError::Settings(format!(
                "native frames of {width}x{height}, expected an even width and height"
            )));
        }
        if let Some(format) = native
            && (format.width(), format.height()) != (width, height)
        {
            return Err(EncodeError::WrongSize {
                found_width: format.width(),
                found_height: format.height(),
                width,
                height,
            });
        }
        pipeline::init()?;
        let element = settings.element.clone();
        let started = |reason| EncodeError::Start {
            element: element.clone(),
            reason,
        };
        let kind = kinds::find(&settings.element)
            .ok_or_else(|| started("not an encoder that this program can drive".into()))?;
        let quantiser = quality::quantiser(kind, settings.preset, settings.quality_db);
        let shared = Arc::new(Shared::new(kind.codec, on_output));
        let source = gst_app::AppSrc::builder()
            .caps(&chain::input_caps(settings, native))
            .format(gst::Format::Time)
            // The bound is ours (MAX_IN_FLIGHT): it counts what is inside the encoder as well.
            .max_bytes(0)
            .max_buffers(0)
            .build();
        let chain::Chain { elements, encoder } =
            chain::chain(settings, kind, quantiser, native, &source, &shared).map_err(&started)?;
        let failing = Arc::downgrade(&shared);
        let running = Running::start(&elements, move |news| {
            if let (News::Failed(failure), Some(shared)) = (news, failing.upgrade()) {
                shared.fail(failure.to_string());
            }
        })
        .map_err(&started)?;
        let (expected, max_in_flight, frame_bytes) = match native {
            Some(format) => (
                InputFormat::Native(format.clone()),
                MAX_NATIVE_IN_FLIGHT,
                format.bytes(),
            ),
            None => (
                InputFormat::Images(width, height),
                MAX_IN_FLIGHT,
                PixelFormat::I420.bytes(width, height)?,
            ),
        };
        Ok(Encoder {
            _running: running,
            source,
            shared,
            kind,
            element: encoder,
            preset: settings.preset,
            quantiser,
            expected,
            max_in_flight,
            frame_bytes,
            previous_ns: None,
            previous_stamp_ns: None,
            keys_forced: 0,
        })
    }

    /// What comes out.
    pub fn codec(&self) -> Codec {
        self.kind.codec
    }

    /// The constant quantiser (QP) that follows from the quality.
    pub fn quantiser(&self) -> u32 {
        self.quantiser
    }

    /// Changes the quality of the frames that follow, immediately and without a key frame.
    /// Whether that is possible depends on the element: with a constant quantiser, x264enc,
    /// x265enc, openh264enc and the nvv4l2 encoders read it only at the start. `false`: nothing has
    /// changed; finish this encoder where the next key frame is due anyway and start another one.
    ///
    /// (A lower *rate* needs nothing: push fewer frames.)
    ///
    /// # Errors
    /// [`EncodeError::Settings`] for a quality that no encoder can have; [`EncodeError::Failed`] if
    /// the element refuses a change that it declares possible.
    pub fn set_quality(&mut self, quality_db: f64) -> Result<bool, EncodeError> {
        check_quality(quality_db)?;
        let quantiser = quality::quantiser(self.kind, self.preset, quality_db);
        let changed =
            chain::adjust(&self.element, self.kind, quantiser).map_err(EncodeError::Failed)?;
        if changed {
            self.quantiser = quantiser;
        }
        Ok(quantiser == self.quantiser)
    }

    /// Hands in a frame, waiting while the encoder is full. `pts_ns` must rise from call to
    /// call. With `force_key` exactly this frame becomes a key frame.
    ///
    /// The frame is shared, not copied, where its rows need no padding (width a multiple of
    /// eight), and is released when its access unit comes out. A native frame is never copied; what
    /// its own time is does not matter, as long as it rises.
    ///
    /// # Errors
    /// All but `Full`. A refused frame (`RawImage`, `WrongSize`, `WrongInput`, `Time`,
    /// `Discontinuity`) leaves the encoder as it was; after `Stalled` or `Failed` start a new one.
    pub fn push<'a>(
        &mut self,
        pts_ns: i64,
        input: impl Into<Input<'a>>,
        force_key: bool,
    ) -> Result<(), EncodeError> {
        let input = input.into();
        self.check_input(pts_ns, input)?;
        let mut state = lock(&self.shared.state);
        while state.failure.is_none() && state.in_flight.len() >= self.max_in_flight {
            let delivered = state.delivered;
            let (after, stalled) = wait_while(&self.shared.changed, state, STALL, |state| {
                state.failure.is_none() && state.delivered == delivered
            });
            state = after;
            if stalled {
                let images = state.in_flight.len();
                return Err(EncodeError::Stalled {
                    after: STALL,
                    images,
                });
            }
        }
        drop(state);
        self.submit(pts_ns, input, force_key)
    }

    /// As [`Encoder::push`], but never waits.
    ///
    /// # Errors
    /// [`EncodeError::Full`] instead of waiting or `Stalled`; the frame was not taken.
    pub fn try_push<'a>(
        &mut self,
        pts_ns: i64,
        input: impl Into<Input<'a>>,
        force_key: bool,
    ) -> Result<(), EncodeError> {
        let input = input.into();
        self.check_input(pts_ns, input)?;
        let state = lock(&self.shared.state);
        if state.failure.is_none() && state.in_flight.len() >= self.max_in_flight {
            return Err(EncodeError::Full {
                images: state.in_flight.len(),
            });
        }
        drop(state);
        self.submit(pts_ns, input, force_key)
    }

    /// Bytes of the frames inside: at most [`MAX_IN_FLIGHT`] frames' worth, or
    /// [`MAX_NATIVE_IN_FLIGHT`].
    pub fn queued_bytes(&self) -> usize {
        lock(&self.shared.state).in_flight.len() * self.frame_bytes
    }

    /// Drains the encoder: returns when the access unit of every accepted frame has been
    /// delivered, at the latest after `timeout` (plus 2 s to stop a stuck encoder).
    ///
    /// # Errors
    /// `Stalled` if the time did not suffice, `Failed` if the encoder failed or did not deliver all
    /// frames. What was delivered until then is good.
    pub fn finish(self, timeout: Duration) -> Result<(), EncodeError> {
        // Fails only if the pipeline has stopped, and then there is a failure to be found below.
        let _ = self.source.end_of_stream();
        let state = lock(&self.shared.state);
        let (state, late) = wait_while(&self.shared.changed, state, timeout, |state| {
            state.failure.is_none() && !state.ended
        });
        let images = state.in_flight.len();
        match state.failure.clone() {
            Some(reason) => Err(EncodeError::Failed(reason)),
            None if late => Err(EncodeError::Stalled {
                after: timeout,
                images,
            }),
            None if images > 0 => Err(EncodeError::Failed(format!(
                "it ended without access units for its last {images} frames"
            ))),
            None => Ok(()),
        }
    }

    fn check_input(&self, pts_ns: i64, input: Input<'_>) -> Result<(), EncodeError> {
        input.check(&self.expected)?;
        if pts_ns < 0 || self.previous_ns.is_some_and(|previous| pts_ns <= previous) {
            return Err(EncodeError::Time {
                found: pts_ns,
                previous: self.previous_ns,
            });
        }
        let found = input.stamp_ns(pts_ns);
        if let Some(previous) = self.previous_stamp_ns
            && found <= previous
        {
            return Err(EncodeError::Discontinuity { found, previous });
        }
        Ok(())
    }

    fn submit(&mut self, pts_ns: i64, input: Input<'_>, key: bool) -> Result<(), EncodeError> {
        let buffer = input.to_buffer(pts_ns).map_err(EncodeError::Failed)?;
        let stamp_ns = input.stamp_ns(pts_ns);
        let time = gst::ClockTime::from_nseconds(stamp_ns as u64);
        let mut state = lock(&self.shared.state);
        if let Some(reason) = &state.failure {
            return Err(EncodeError::Failed(reason.clone()));
        }
        // Before the buffer goes in: its access unit may come out immediately.
        state.in_flight.push_back(Inside { stamp_ns, pts_ns });
        // The first frame is a key frame anyway. An event in front of it would overtake the
        // segment, and GStreamer 1.22 would then take the first frame's time to be 1000 h and
        // ignore every later request as too soon.
        let key = key && self.previous_ns.is_some();
        self.previous_ns = Some(pts_ns);
        self.previous_stamp_ns = Some(stamp_ns);
        if key && matches!(self.kind.force, Force::Signal(_)) {
            state.to_force.insert(stamp_ns);
        }
        drop(state);
        if key && self.kind.force == Force::Event {
            self.keys_forced += 1;
            // The encoder compares the running time with each frame's, so the event may overtake
            // frames that still wait without hitting one of them.
            let event = gst_video::DownstreamForceKeyUnitEvent::builder()
                .timestamp(time)
                .stream_time(time)
                .running_time(time)
                .all_headers(true)
                .count(self.keys_forced)
                .build();
            self.source.send_event(event);
        }
        match self.source.push_buffer(buffer) {
            Ok(_) => Ok(()),
            Err(error) => {
                let reason = lock(&self.shared.state).failure.clone();
                Err(EncodeError::Failed(reason.unwrap_or_else(|| {
                    format!("it takes no more frames: {error}")
                })))
            }
        }
    }
}

/// Refuses settings that no encoder can follow.
fn check(settings: &EncoderSettings) -> Result<(), EncodeError> {
    let refuse = |reason: String| Err(EncodeError::Settings(reason));
    PixelFormat::I420.bytes(settings.width, settings.height)?;
    if settings.width > 16384 || settings.height > 16384 {
        let (width, height) = (settings.width, settings.height);
        return refuse(format!("{width}x{height}, expected at most 16384 each way"));
    }
    // x265enc hangs for ever on a rate of 0.
    if !(settings.rate_hz > 0.0 && settings.rate_hz <= 1000.0) {
        return refuse(format!(
            "rate {} Hz, expected more than 0 and at most 1000",
            settings.rate_hz
        ));
    }
    check_quality(settings.quality_db)?;
    if !(1..=64).contains(&settings.threads) {
        return refuse(format!("{} threads, expected 1 to 64", settings.threads));
    }
    if !(1..=100_000).contains(&settings.max_key_interval_frames) {
        let found = settings.max_key_interval_frames;
        return refuse(format!(
            "a key frame every {found} frames, expected 1 to 100000"
        ));
    }
    Ok(())
}

fn check_quality(quality_db: f64) -> Result<(), EncodeError> {
    if (20.0..=60.0).contains(&quality_db) {
        return Ok(());
    }
    Err(EncodeError::Settings(format!(
        "quality {quality_db} dB, expected 20 to 60"
    )))
}

#[cfg(test)]
mod tests;
