//! Access units in, frames out.
//!
//! Contract. A call to [`Decoder::decode`] takes a run of access units that begins with a key
//! frame (a group of frames, or several) and gives its frames in order, each with its time to
//! the nanosecond. *Complete or an error*: if a frame is missing, the error holds those that
//! came and the times of those that did not. Bytes that are not video give an error, never a
//! panic. *Nothing carries over* from one call to the next, so calls may jump about in a
//! recording. *Time*: a call gives up when nothing has come for [`STALL`].
//!
//! A lost access unit makes decoders go on with the wrong reference and say nothing; so access
//! units whose references are missing ([`crate::references`]) are not decoded and count as missing.
//! Not detectable here: decoders conceal damage inside a frame, and report only part of it. Bytes
//! that may be damaged are for checksums to find.
//!
//! Decoders are taken from what the machine has, hardware first; the first that decodes something
//! is kept. Every call builds its pipeline again, 2 to 3 ms with libav: decode whole groups, not
//! single frames. (Keeping the pipeline saved 0.6 ms of that when measured, and a source of
//! GStreamer 1.22 does not forget its end in a flush.) **The hardware decoders have never been
//! run by this project.** A conforming stream decodes to the same frames with each of them.

use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app as gst_app;
use thiserror::Error;

use crate::pipeline::{self, InitError, News, Running, lock, wait_while};
use crate::references::{Continuity, Step};
use crate::{AccessUnit, Codec, RawImage, annexb, layout};

/// How long a decoder may give nothing before [`Decoder::decode`] gives up.
pub const STALL: Duration = Duration::from_secs(10);

/// Elements that decode, best first: name, and what has to follow to get frames into
/// system memory.
fn candidates(codec: Codec) -> &'static [(&'static str, Option<&'static str>)] {
    match codec {
        Codec::H264 => &[
            ("nvv4l2decoder", Some("nvvidconv")),
            ("nvh264dec", None),
            ("avdec_h264", None),
            ("openh264dec", None),
        ],
        Codec::H265 => &[
            ("nvv4l2decoder", Some("nvvidconv")),
            ("nvh265dec", None),
            ("avdec_h265", None),
            ("libde265dec", None),
        ],
    }
}

/// Why frames are missing.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum DecodeError {
    /// GStreamer itself is unusable.
    #[error(transparent)]
    Init(#[from] InitError),
    /// Install a decoder: none of those we know is there and works.
    #[error("no {codec} decoder works on this machine: {reasons}")]
    NoDecoder {
        /// What was to be decoded.
        codec: Codec,
        /// Every decoder tried, with its reason.
        reasons: String,
    },
    /// Begin earlier.
    #[error("the access unit at {0} ns is no key frame, expected one to begin with")]
    NotKey(i64),
    /// Times must rise and not be negative.
    #[error("access unit at {found} ns after one at {previous:?} ns, expected rising times")]
    Time {
        /// The time found.
        found: i64,
        /// The one before, if any.
        previous: Option<i64>,
    },
    /// Part of the stream cannot be decoded. The rest is good.
    #[error("{} of {} frames did not come out, the first at {} ns", .missing.len(),
        .missing.len() + .images.len(), .missing.first().copied().unwrap_or_default())]
    Incomplete {
        /// What came out, in order.
        images: Vec<(i64, RawImage)>,
        /// The times of what did not, in order, ns.
        missing: Vec<i64>,
    },
    /// The decoder refused the stream.
    #[error("decoder failed: {0}")]
    Failed(String),
    /// The decoder is stuck. A new call starts a new one.
    #[error("decoder gave nothing for {} s", STALL.as_secs())]
    Stalled,
}

/// A decoder for one codec. Sizes may change from call to call.
#[derive(Debug)]
pub struct Decoder {
    codec: Codec,
    threads: u32,
    /// The element that has been seen to work.
    proven: Option<&'static str>,
}

/// A running pipeline.
#[derive(Debug)]
struct Session {
    // Dropped first: no callback runs once the pipeline has stopped.
    _running: Running,
    source: gst_app::AppSrc,
    shared: Arc<Shared>,
    element: &'static str,
}

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    images: Vec<(i64, RawImage)>,
    ended: bool,
    failure: Option<String>,
}

impl Decoder {
    /// A decoder that uses one thread. The element is chosen by the first [`Decoder::decode`].
    pub fn new(codec: Codec) -> Decoder {
        Decoder::with_threads(codec, 1)
    }

    /// A decoder that may use up to `threads` threads; 0 leaves the number to the element. The
    /// frames are the same.
    pub fn with_threads(codec: Codec, threads: u32) -> Decoder {
        Decoder {
            codec,
            threads,
            proven: None,
        }
    }

    /// What is decoded.
    pub fn codec(&self) -> Codec {
        self.codec
    }

    /// The GStreamer element in use, once something has been decoded.
    pub fn element(&self) -> Option<&'static str> {
        self.proven
    }

    /// Decodes a run of access units that begins with a key frame and has rising times. Frames
    /// are I420, in order of time, one per access unit. All of them are in memory simultaneously:
    /// `1.5 * width * height` bytes each.
    ///
    /// # Errors
    /// See [`DecodeError`]. After any error the next call starts afresh.
    pub fn decode(&mut self, units: &[AccessUnit]) -> Result<Vec<(i64, RawImage)>, DecodeError> {
        let Some(first) = units.first() else {
            return Ok(Vec::new());
        };
        if !annexb::is_key(self.codec, &first.data) {
            return Err(DecodeError::NotKey(first.pts_ns));
        }
        let mut previous = None;
        for found in units.iter().map(|unit| unit.pts_ns) {
            if found < 0 || previous.is_some_and(|previous| found <= previous) {
                return Err(DecodeError::Time { found, previous });
            }
            previous = Some(found);
        }
        let mut stream = Continuity::new(self.codec);
        let sound: Vec<&AccessUnit> = units
            .iter()
            .filter(|unit| stream.next(&unit.data) != Step::Broken)
            .collect();
        pipeline::init()?;
        let mut reasons = Vec::new();
        let mut last = None;
        for &(element, converter) in candidates(self.codec) {
            if self.proven.is_some_and(|proven| proven != element) {
                continue;
            }
            let session = match Session::start(self.codec, element, converter, self.threads) {
                Ok(session) => session,
                Err(reason) => {
                    reasons.push(format!("{element}: {reason}"));
                    continue;
                }
            };
            match session.run(&sound) {
                Ok(images) if self.proven.is_some() || !images.is_empty() => {
                    self.proven = Some(element);
                    return complete(units, images);
                }
                Ok(_) => last = Some(complete(units, Vec::new())),
                Err(error) => last = Some(Err(error)),
            }
        }
        // If a decoder started but gave nothing, the stream is as likely to blame.
        last.unwrap_or_else(|| {
            let reasons = reasons.join("; ");
            Err(DecodeError::NoDecoder {
                codec: self.codec,
                reasons,
            })
        })
    }
}

/// The frames, if there is one for every access unit.
fn complete(
    units: &[AccessUnit],
    images: Vec<(i64, RawImage)>,
) -> Result<Vec<(i64, RawImage)>, DecodeError> {
    let came = |time| images.binary_search_by_key(&time, |image| image.0).is_ok();
    let missing: Vec<i64> = units
        .iter()
        .map(|unit| unit.pts_ns)
        .filter(|&time| !came(time))
        .collect();
    match (missing.is_empty(), images.len() == units.len()) {
        (true, true) => Ok(images),
        (true, false) => Err(DecodeError::Failed(
            "it gave more frames than there are".into(),
        )),
        (false, _) => Err(DecodeError::Incomplete { images, missing }),
    }
}

impl Session {
    fn start(
        codec: Codec,
        element: &'static str,
        converter: Option<&str>,
        threads: u32,
    ) -> Result<Session, String> {
        let source = gst_app::AppSrc::builder()
            .caps(
                &gst::Caps::builder(codec.media_type())
                    .field("stream-format", "byte-stream")
                    .field("alignment", "au")
                    .build(),
            )
            .format(gst::Format::Time)
            // Everything is pushed in one step: the caller holds it in memory anyway.
            .max_bytes(0)
            .max_buffers(0)
            .build();
        let decoder = pipeline::make(element)?;
        // Of libav: no frames concealed around missing references, and threads as requested.
        pipeline::set_property(&decoder, "output-corrupt", "false")?;
        pipeline::set_property(&decoder, "max-threads", &threads.to_string())?;
        let mut elements = vec![
            source.clone().upcast(),
            pipeline::make(codec.parser())?,
            decoder,
        ];
        if let Some(converter) = converter {
            elements.push(pipeline::make(converter)?);
        }
        let shared = Arc::new(Shared::default());
        let (delivering, ending) = (shared.clone(), shared.clone());
        let sink = gst_app::AppSink::builder()
            .caps(
                &gst::Caps::builder("video/x-raw")
                    .field("format", gst::List::new(["I420", "NV12", "GRAY8"]))
                    .build(),
            )
            .sync(false)
            .async_(false)
            .max_buffers(1)
            .callbacks(
                gst_app::AppSinkCallbacks::builder()
                    .new_sample(move |sink| {
                        let sample = sink.pull_sample().map_err(|_| gst::FlowError::Eos)?;
                        delivering.deliver(&sample);
                        Ok(gst::FlowSuccess::Ok)
                    })
                    .eos(move |_| {
                        lock(&ending.state).ended = true;
                        ending.changed.notify_all();
                    })
                    .build(),
            )
            .build();
        elements.push(sink.upcast());
        let failing = Arc::downgrade(&shared);
        let running = Running::start(&elements, move |news| {
            if let (News::Failed(failure), Some(shared)) = (news, failing.upgrade()) {
                let mut state = lock(&shared.state);
                state.failure.get_or_insert_with(|| failure.to_string());
                drop(state);
                shared.changed.notify_all();
            }
        })?;
        Ok(Session {
            _running: running,
            source,
            shared,
            element,
        })
    }

    /// Sends everything through and collects what comes out, in order of time.
    fn run(&self, units: &[&AccessUnit]) -> Result<Vec<(i64, RawImage)>, DecodeError> {
        for unit in units {
            let mut buffer = gst::Buffer::from_slice(unit.data.clone());
            if let Some(buffer) = buffer.get_mut() {
                let time = gst::ClockTime::from_nseconds(unit.pts_ns as u64);
                buffer.set_pts(time);
                buffer.set_dts(time);
            }
            if self.source.push_buffer(buffer).is_err() {
                break;
            }
        }
        // As with the pushes: it fails only after a failure, which is found below.
        let _ = self.source.end_of_stream();
        let mut state = lock(&self.shared.state);
        while state.failure.is_none() && !state.ended {
            let before = state.images.len();
            let (after, stalled) = wait_while(&self.shared.changed, state, STALL, |state| {
                state.failure.is_none() && !state.ended && state.images.len() == before
            });
            state = after;
            if stalled {
                return Err(DecodeError::Stalled);
            }
        }
        if let Some(reason) = &state.failure {
            return Err(DecodeError::Failed(format!("{}: {reason}", self.element)));
        }
        let mut images = std::mem::take(&mut state.images);
        images.sort_by_key(|image| image.0);
        images.dedup_by_key(|image| image.0);
        Ok(images)
    }
}

impl Shared {
    fn deliver(&self, sample: &gst::Sample) {
        let image = image(sample);
        let mut state = lock(&self.state);
        match image {
            Ok(Some(image)) => state.images.push(image),
            Ok(None) => {}
            Err(reason) => {
                state.failure.get_or_insert(reason);
            }
        }
        drop(state);
        self.changed.notify_all();
    }
}

/// A sample as frame and time; `None` if the decoder itself calls it damaged.
fn image(sample: &gst::Sample) -> Result<Option<(i64, RawImage)>, String> {
    let buffer = sample.buffer().ok_or("decoded frame without data")?;
    if buffer.flags().contains(gst::BufferFlags::CORRUPTED) {
        return Ok(None);
    }
    let time = sample
        .segment()
        .and_then(|segment| segment.downcast_ref::<gst::ClockTime>())
        .and_then(|segment| segment.to_running_time(buffer.pts()?))
        .ok_or("decoded frame without a time")?;
    Ok(Some((time.nseconds() as i64, layout::from_sample(sample)?)))
}
