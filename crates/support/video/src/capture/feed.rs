//! One chain of elements from a camera into a [`super::intake::Intake`].
//!
//! The pipeline runs on CLOCK_MONOTONIC, so a buffer's running time and the pipeline's base time
//! add up to the host's clock in integers. Buffers are taken off in front of the last element, so
//! that only their receiver refers to them and the camera gets them back as early as possible.

use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_video as gst_video;

use super::intake::{Intake, Port};
use super::policy::Policy;
use crate::NativeFormat;
use crate::native::NativeFrame;
use crate::pipeline::{self, News, Running, lock};

/// Name of the filter behind a chain.
const WANTED: &str = "wanted-by-capture";

/// The requested output of a chain.
pub(super) struct OutputRequest {
    pub(super) caps: gst::Caps,
    /// Frames leave in their own buffers.
    pub(super) native: bool,
    /// Frames that are held here and in an encoder: the camera gets more buffers than that.
    pub(super) held: u32,
}

/// A chain with its end.
#[derive(Debug)]
pub(super) struct Feed {
    running: Running,
    /// Factory of the element that the frames come from.
    pub(super) element: String,
}

impl Feed {
    /// Builds the pipeline; nothing runs yet.
    pub(super) fn build(
        chain: &str,
        wanted: OutputRequest,
        intake: &Arc<Intake>,
        port: impl FnOnce(&str) -> Port,
    ) -> Result<Feed, String> {
        if chain.trim().is_empty() {
            return Err("it is empty, expected elements as for gst-launch-1.0".into());
        }
        // The description may end in caps, so something has to stand behind them.
        let described = format!("{chain} ! capsfilter name={WANTED}");
        let camera = gst::parse::bin_from_description(&described, true)
            .map_err(|error| error.message().to_owned())?;
        let filter = camera.by_name(WANTED).ok_or("it has no open output")?;
        filter.set_property("caps", &wanted.caps);
        let output = camera.static_pad("src").ok_or("it has no open output")?;
        if output.query_caps(None).is_empty() {
            return Err(format!("it cannot give {}", wanted.caps));
        }
        let element = camera
            .iterate_sources()
            .into_iter()
            .flatten()
            .find_map(|source| Some(source.factory()?.name().to_string()))
            .ok_or("it has no source element")?;
        let sink = pipeline::make("fakesink")?;
        for (name, value) in [("sync", "false"), ("async", "false"), ("qos", "false")] {
            pipeline::set_property(&sink, name, value)?;
        }
        pipeline::set_property(&sink, "enable-last-sample", "false")?;
        let pad = sink.static_pad("sink").ok_or("the sink has no input")?;
        take_off(&pad, port(&element), &wanted, intake);
        let elements = [camera.upcast(), sink];
        let ending = Arc::downgrade(intake);
        let expected = wanted.caps.to_string();
        let running = Running::prepare(&elements, move |news| {
            if let Some(intake) = ending.upgrade() {
                match news {
                    News::Failed(failure) => intake.failed(&failure, &expected),
                    News::Ended => intake.ended(),
                }
            }
        })?;
        let clock = gst::SystemClock::new(None, gst::ClockType::Monotonic);
        running.pipeline().use_clock(Some(&clock));
        Ok(Feed { running, element })
    }

    pub(super) fn pipeline(&self) -> &gst::Bin {
        self.running.pipeline().upcast_ref()
    }

    /// Starts the camera after `delay`, on a thread of its own: some take seconds, and one may be
    /// stuck in its driver. What goes wrong is reported to the intake.
    pub(super) fn start(&self, delay: Duration, intake: &Arc<Intake>) -> Result<(), String> {
        let (pipeline, intake) = (self.running.pipeline().clone(), intake.clone());
        let starting = thread::Builder::new()
            .name("capture-start".into())
            .spawn(move || {
                if !intake.wait_to_start(delay) {
                    return;
                }
                if let Err(reason) = play(&pipeline) {
                    intake.not_started(reason);
                }
                // The owner may have stopped the pipeline before it was started.
                if intake.is_abandoned() {
                    let _ = pipeline.set_state(gst::State::Null);
                }
            });
        starting.map(drop).map_err(|error| error.to_string())
    }
}

fn play(pipeline: &gst::Pipeline) -> Result<(), &'static str> {
    const NOT_STARTED: &str = "it would not start";
    // A live source gives nothing while paused, and says so.
    match pipeline.set_state(gst::State::Paused) {
        Ok(gst::StateChangeSuccess::NoPreroll) => {}
        Ok(_) => {
            return Err(
                "it has no live source, whose times would mean something (videotestsrc: is-live=true)",
            );
        }
        Err(_) => return Err(NOT_STARTED),
    }
    let playing = pipeline.set_state(gst::State::Playing);
    playing.map(drop).map_err(|_| NOT_STARTED)
}

/// Diverts everything that arrives at `pad`.
fn take_off(pad: &gst::Pad, port: Port, wanted: &OutputRequest, intake: &Arc<Intake>) {
    let (intake, native) = (Arc::downgrade(intake), wanted.native);
    let held = wanted.held;
    let newest = Mutex::new(Newest::default());
    let mask = gst::PadProbeType::BUFFER
        | gst::PadProbeType::BUFFER_LIST
        | gst::PadProbeType::QUERY_DOWNSTREAM;
    pad.add_probe(mask, move |pad, info| {
        if let Some(query) = info.query_mut() {
            return answer(query, held);
        }
        let buffers = match info.data.take() {
            Some(gst::PadProbeData::Buffer(buffer)) => vec![buffer],
            Some(gst::PadProbeData::BufferList(list)) => list.iter_owned().collect(),
            _ => return gst::PadProbeReturn::Ok,
        };
        let Some(intake) = intake.upgrade() else {
            return gst::PadProbeReturn::Handled;
        };
        for buffer in buffers {
            let host_ns = intake.now();
            let arrival = arrival(pad, buffer, native, &mut lock(&newest));
            intake.arrived(&port, host_ns, arrival);
        }
        gst::PadProbeReturn::Handled
    });
}

/// Tells a source that padded rows are welcome, and the number of frames held simultaneously, so
/// that it need not copy.
fn answer(query: &mut gst::QueryRef, held: u32) -> gst::PadProbeReturn {
    let gst::QueryViewMut::Allocation(query) = query.view_mut() else {
        return gst::PadProbeReturn::Ok;
    };
    query.add_allocation_meta::<gst_video::VideoMeta>(None);
    let info = query
        .get_owned()
        .0
        .and_then(|caps| gst_video::VideoInfo::from_caps(&caps).ok());
    if let Some(size) = info.and_then(|info| u32::try_from(info.size()).ok()) {
        query.add_allocation_pool(gst::BufferPool::NONE, size, held, 0);
    }
    gst::PadProbeReturn::Handled
}

/// A buffer with what the pipeline knows of it.
#[derive(Debug)]
pub(super) struct Arrival {
    /// The buffer's offset.
    pub(super) offset: Option<u64>,
    pub(super) pts_running_ns: i64,
    pub(super) clock_time_ns: i64,
    pub(super) references: Vec<super::Reference>,
    /// In native delivery, its own time is `clock_time_ns`, or a little more if that did not rise.
    pub(super) frame: NativeFrame,
}

/// What is known of the frame before.
#[derive(Default)]
struct Newest {
    format: Option<NativeFormat>,
    stamp: gst::ClockTime,
}

fn arrival(
    pad: &gst::Pad,
    buffer: gst::Buffer,
    native: bool,
    newest: &mut Newest,
) -> Result<Arrival, String> {
    let caps = pad.current_caps().ok_or("a frame without caps")?;
    let known = newest.format.take().filter(|known| *known.caps() == caps);
    let known = known.map_or_else(|| NativeFormat::new(&caps), Ok)?;
    let format = newest.format.insert(known).clone();
    let pts = buffer
        .pts()
        .ok_or("a frame without a time (if the source gives none, do-timestamp=true may help)")?;
    let running = pad
        .sticky_event::<gst::event::Segment>(0)
        .and_then(|event| {
            let segment = event.segment().downcast_ref::<gst::ClockTime>()?;
            segment.to_running_time(pts)
        })
        .ok_or_else(|| format!("a frame at {pts}, outside of what its source announced"))?;
    let base = pad
        .parent_element()
        .and_then(|sink| sink.base_time())
        .ok_or("a frame before the pipeline had a clock")?;
    let clock = running + base;
    let references = buffer
        .iter_meta::<gst::ReferenceTimestampMeta>()
        .map(|meta| super::Reference {
            clock: meta.reference().to_string(),
            time_ns: meta.timestamp().nseconds(),
        })
        .collect();
    // All ones is GStreamer's "none".
    let offset = Some(buffer.offset()).filter(|&offset| offset != u64::MAX);
    let buffer = if native {
        // An encoder needs times that rise, also where the source repeats itself.
        let next = newest.stamp + gst::ClockTime::from_nseconds(1);
        newest.stamp = clock.max(next);
        restamp(buffer, newest.stamp)?
    } else {
        buffer
    };
    Ok(Arrival {
        offset,
        pts_running_ns: running.nseconds() as i64,
        clock_time_ns: clock.nseconds() as i64,
        references,
        frame: NativeFrame::new(buffer, format)?,
    })
}

/// Gives a buffer the host's time, which rises over restarts of the camera too. Nothing is copied:
/// a buffer that somebody else refers to shares its memory, and if that must not be shared, it is
/// an error.
fn restamp(mut buffer: gst::Buffer, clock: gst::ClockTime) -> Result<gst::Buffer, String> {
    let shared = buffer.get_mut().is_none();
    let must_not = |memory: &gst::MemoryRef| memory.flags().contains(gst::MemoryFlags::NO_SHARE);
    if shared && buffer.iter_memories().any(must_not) {
        return Err(
            "an element of the chain keeps its frames, whose memory must not be shared: leave \
             videorate and tee out, or put a converter behind them"
                .into(),
        );
    }
    let writable = buffer.make_mut();
    writable.set_pts(clock);
    writable.set_dts(gst::ClockTime::NONE);
    Ok(buffer)
}

/// How to number and count what a source gives.
pub(super) fn policy(element: &str, configured: Option<Policy>) -> Policy {
    configured.unwrap_or_else(|| Policy::of(element))
}
