//! Access units into an MP4 file, without encoding them again.
//!
//! Contract: the file appears under its name only when it is complete and on disk (it is written
//! beside it as `NAME.part` and renamed); on any error the part file is removed. An existing file
//! of that name is replaced.
//!
//! Times: an MP4 file counts from zero, so times are relative to the first access unit, whose own
//! time the summary gives. They are stored in units of 1/[`TIMESCALE`] s, each rounded by itself
//! (errors do not add up), so their error is at most 5.6 µs. Exact times are in the session, not
//! here: the muxer of GStreamer 1.22 writes durations in 32 bits of that unit, so a finer one
//! would shorten the longest video ([`LONGEST_NS`], 13 hours; with microseconds it would be 71
//! minutes).

use std::ffi::OsString;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app as gst_app;
use thiserror::Error;

use crate::pipeline::{self, InitError, News, Running, lock, wait_while};
use crate::{AccessUnit, Codec, annexb};

/// Units of time per second in the file: what video files commonly count in.
pub const TIMESCALE: u32 = 90_000;

/// From the first access unit to the last, at most this many ns.
pub const LONGEST_NS: i64 = (u32::MAX as i64 - TIMESCALE as i64) / TIMESCALE as i64 * 1_000_000_000;

/// How long the only image of a video lasts. (The last of several lasts as long as the first.)
const SINGLE_NS: i64 = 33_333_333;

/// Compressed bytes that may wait inside.
const QUEUE_BYTES: u64 = 8 << 20;

/// How long the muxer or the disk may stand still.
const STALL: Duration = Duration::from_secs(60);

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mp4Summary {
    /// Access units in the file.
    pub units: u64,
    /// The time of the first one, ns: what the file calls 0.
    pub origin_ns: i64,
}

/// Why there is no file.
#[derive(Debug, Error)]
pub enum Mp4Error {
    /// GStreamer itself is unusable.
    #[error(transparent)]
    Init(#[from] InitError),
    /// Begin with a key frame.
    #[error("writing MP4: the first access unit is no key frame: {}", .0.display())]
    NotKey(PathBuf),
    /// A video has at least one image.
    #[error("writing MP4: there are no access units: {}", .0.display())]
    Empty(PathBuf),
    /// Times must rise and not be negative.
    #[error("writing MP4: access unit at {found} ns after one at {previous:?} ns, expected rising times: {}", .path.display())]
    Time {
        /// The time found.
        found: i64,
        /// The one before, if any.
        previous: Option<i64>,
        /// The file.
        path: PathBuf,
    },
    /// Write several files.
    #[error("writing MP4: the video is longer than {} s: {}", LONGEST_NS / 1_000_000_000, .0.display())]
    TooLong(PathBuf),
    /// A plugin is missing, or the muxer refused the stream, or the disk is full.
    #[error("writing MP4: {reason}: {}", .path.display())]
    Mux {
        /// What GStreamer says.
        reason: String,
        /// The file.
        path: PathBuf,
    },
    /// The file system refused.
    #[error("finishing MP4: {}", .path.display())]
    Io {
        /// Why.
        source: io::Error,
        /// The file.
        path: PathBuf,
    },
}

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    full: bool,
    ended: bool,
    failure: Option<String>,
}

/// Writes `units`, which begin with a key frame and have rising times, to `path`. Memory: the
/// units that wait, about 8 MB, and the muxer's sample table (some tens of bytes per unit).
///
/// # Errors
/// See [`Mp4Error`]; then there is no file.
pub fn write_mp4(
    path: &Path,
    codec: Codec,
    width: u32,
    height: u32,
    units: impl IntoIterator<Item = AccessUnit>,
) -> Result<Mp4Summary, Mp4Error> {
    pipeline::init()?;
    let mut part = OsString::from(path);
    part.push(".part");
    let part = PathBuf::from(part);
    let written = write_part(path, &part, codec, (width, height), units).and_then(|summary| {
        File::open(&part)
            .and_then(|file| file.sync_all())
            .and_then(|()| fs::rename(&part, path))
            .map_err(|source| Mp4Error::Io {
                source,
                path: path.into(),
            })?;
        Ok(summary)
    });
    if written.is_err() {
        // It may not exist; what matters is the first error.
        let _ = fs::remove_file(&part);
    }
    written
}

fn write_part(
    path: &Path,
    part: &Path,
    codec: Codec,
    size: (u32, u32),
    units: impl IntoIterator<Item = AccessUnit>,
) -> Result<Mp4Summary, Mp4Error> {
    let mux = |reason: String| Mp4Error::Mux {
        reason,
        path: path.into(),
    };
    let mut units = units.into_iter();
    let first = units.next().ok_or_else(|| Mp4Error::Empty(path.into()))?;
    let origin_ns = first.pts_ns;
    let second = units.next();
    let step_ns = second
        .as_ref()
        .map(|second| second.pts_ns.saturating_sub(origin_ns));
    let shared = Arc::new(Shared::default());
    let source = source(codec, size, step_ns.unwrap_or(SINGLE_NS), &shared);
    let elements = elements(codec, &source, part).map_err(mux)?;
    let listening = shared.clone();
    let mut running = Running::start(&elements, move |news| {
        let mut state = lock(&listening.state);
        match news {
            News::Failed(failure) => {
                state.failure.get_or_insert_with(|| failure.to_string());
            }
            News::Ended => state.ended = true,
        }
        drop(state);
        listening.changed.notify_all();
    })
    .map_err(mux)?;
    let mut previous = None;
    let mut count = 0;
    for unit in [Some(first), second].into_iter().flatten().chain(units) {
        if count == 0 && !annexb::is_key(codec, &unit.data) {
            return Err(Mp4Error::NotKey(path.into()));
        }
        if unit.pts_ns < 0 || previous.is_some_and(|previous| unit.pts_ns <= previous) {
            return Err(Mp4Error::Time {
                found: unit.pts_ns,
                previous,
                path: path.into(),
            });
        }
        previous = Some(unit.pts_ns);
        if unit.pts_ns - origin_ns > LONGEST_NS {
            return Err(Mp4Error::TooLong(path.into()));
        }
        shared.wait(|state| state.full).map_err(mux)?;
        let mut buffer = gst::Buffer::from_slice(unit.data);
        if let Some(buffer) = buffer.get_mut() {
            let time = gst::ClockTime::from_nseconds((unit.pts_ns - origin_ns) as u64);
            buffer.set_pts(time);
            buffer.set_dts(time);
        }
        if source.push_buffer(buffer).is_err() {
            break;
        }
        count += 1;
    }
    // As with the pushes: it fails only after a failure, which is found next.
    let _ = source.end_of_stream();
    shared.wait(|state| !state.ended).map_err(mux)?;
    if !running.stop() {
        return Err(mux("the muxer does not stop".into()));
    }
    Ok(Mp4Summary {
        units: count,
        origin_ns,
    })
}

fn source(
    codec: Codec,
    (width, height): (u32, u32),
    step_ns: i64,
    shared: &Arc<Shared>,
) -> gst_app::AppSrc {
    let step_us = i32::try_from(step_ns / 1_000).unwrap_or(i32::MAX).max(1);
    let (filling, emptying) = (shared.clone(), shared.clone());
    gst_app::AppSrc::builder()
        .caps(
            &gst::Caps::builder(codec.media_type())
                .field("stream-format", "byte-stream")
                .field("alignment", "au")
                .field("width", width as i32)
                .field("height", height as i32)
                // Only for the last image: without a rate it would last no time at all, and
                // players leave it out.
                .field("framerate", gst::Fraction::new(1_000_000, step_us))
                .build(),
        )
        .format(gst::Format::Time)
        .max_bytes(QUEUE_BYTES)
        .max_buffers(0)
        .callbacks(
            gst_app::AppSrcCallbacks::builder()
                .enough_data(move |_| lock(&filling.state).full = true)
                .need_data(move |_, _| {
                    lock(&emptying.state).full = false;
                    emptying.changed.notify_all();
                })
                .build(),
        )
        .build()
}

fn elements(
    codec: Codec,
    source: &gst_app::AppSrc,
    part: &Path,
) -> Result<Vec<gst::Element>, String> {
    let muxer = pipeline::make("mp4mux")?;
    for name in ["trak-timescale", "movie-timescale"] {
        if !pipeline::set_property(&muxer, name, &TIMESCALE.to_string())? {
            return Err(format!("mp4mux has no property {name}"));
        }
    }
    let sink = pipeline::make("filesink")?;
    sink.set_property(
        "location",
        part.as_os_str().to_str().ok_or("the path is not UTF-8")?,
    );
    Ok(vec![
        source.clone().upcast(),
        pipeline::make(codec.parser())?,
        muxer,
        sink,
    ])
}

impl Shared {
    /// Waits while `holds`; a failure or standing still ends it with the reason.
    fn wait(&self, mut holds: impl FnMut(&State) -> bool) -> Result<(), String> {
        let state = lock(&self.state);
        let (state, stalled) = wait_while(&self.changed, state, STALL, |state| {
            state.failure.is_none() && holds(state)
        });
        match &state.failure {
            Some(reason) => Err(reason.clone()),
            None if stalled => Err(format!("nothing moved for {} s", STALL.as_secs())),
            None => Ok(()),
        }
    }
}
