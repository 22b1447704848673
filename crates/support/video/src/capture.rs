//! Cameras that come through GStreamer: any chain of elements that ends in raw video.
//!
//! Contract. *Normally*: [`Capture::next`] gives every frame of the chain in order, with its PTS on
//! CLOCK_MONOTONIC by exact integer arithmetic, the time at which it arrived, and a number in which
//! a hole is a frame that was lost. *When the taker is late*: a few frames wait (four, or two
//! native ones), then new ones are dropped, counted, and reported as [`CaptureEvent::Lost`]; the
//! camera never waits. *When the camera is late or silent*: `next` gives nothing and returns after
//! its time-out. *When it fails*: what was queued, then one of [`CaptureEvent::Gone`] (reported by
//! the device; it may reconnect), [`CaptureEvent::Failed`] and [`CaptureEvent::Ended`], again at
//! every further call; whether and when to restart is the caller's business. *At the end*: dropping
//! a capture stops it within seconds, even if the driver is stuck.
//!
//! What a PTS *means* is another question for every element: [`policy`].
//!
//! Two chains, one for each eye, are joined into frames with the eyes side by side, in system
//! memory. (Frames in a Jetson's device memory are joined by an element of the chain: nvcompositor,
//! or zedsrc itself.) The chains for cameras on a Jetson have never been run on hardware by this
//! project; docs/guides/gstreamer-sources.md says how to write one.
//!
//! ```
//! use std::sync::Arc;
//! use std::time::Duration;
//! use video::capture::{Capture, CaptureEvent, CaptureSettings, Content};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let settings = CaptureSettings::new("videotestsrc is-live=true num-buffers=3", 64, 32, 30.0);
//! let start = std::time::Instant::now();
//! let clock = Arc::new(move || start.elapsed().as_nanos() as i64);
//! let mut capture = Capture::start(&settings, clock)?;
//! let mut images = 0;
//! loop {
//!     match capture.next(Duration::from_secs(10)) {
//!         Some(CaptureEvent::Frame(frame)) => {
//!             assert!(matches!(frame.content, Content::RawImage(image) if image.width == 64));
//!             images += 1;
//!         }
//!         Some(CaptureEvent::Ended) => break,
//!         other => panic!("{other:?}"),
//!     }
//! }
//! assert_eq!(images, 3);
//! # Ok(())
//! # }
//! ```

use std::sync::{Arc, Mutex};
use std::time::Duration;

use gstreamer as gst;
use thiserror::Error;

use crate::encoder::MAX_NATIVE_IN_FLIGHT;
use crate::native::{NVMM, NativeFrame};
use crate::pipeline::{self, InitError};
use crate::raw_image::coded_size;
use crate::{PixelFormat, RawImage, RawImageError, layout};
use feed::{Feed, OutputRequest};
use intake::{ArrivedFrame, Intake, Item, Port};
use number::Numbering;
use policy::Policy;

mod feed;
mod intake;
mod number;
mod pair;
pub mod policy;

pub use pair::Eye;

/// Frames that may wait to be taken.
pub const QUEUE: usize = 4;

/// As [`QUEUE`], of native frames: they are their camera's buffers, which it needs back.
const NATIVE_QUEUE: usize = 2;

/// What should lie between the starts of two cameras of a Jetson: with less, a rig of eleven Argus
/// cameras had surfaces mixed up between them (docs/guides/gstreamer-sources.md).
pub const STAGGER: Duration = Duration::from_secs(1);

/// The host's clock, CLOCK_MONOTONIC in ns. It is read when a frame arrives, on the camera's
/// thread.
pub type HostClock = Arc<dyn Fn() -> i64 + Send + Sync>;

/// The form in which frames are delivered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// As I420 frames, whatever the chain's layout (I420, NV12, YUY2, UYVY or GRAY8). The chain
    /// has to end in system memory.
    Images,
    /// In the camera's own buffers, for an encoder that takes them as they are.
    Native,
}

/// What to capture.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureSettings {
    /// Elements in the notation of `gst-launch-1.0`, without a sink; of the left eye if there is
    /// another chain for the right one.
    pub chain: String,
    /// Elements of the right eye, if it comes separately.
    pub right_chain: Option<String>,
    /// Columns of a delivered frame: of both eyes if they are joined here. Even; a multiple of four
    /// for two chains.
    pub width: u32,
    /// Rows; even.
    pub height: u32,
    /// Nominal rate: for numbering by time and for pairing. More than 0, at most 1000.
    pub rate_hz: f64,
    /// Frames, or buffers as they are.
    pub delivery: Delivery,
    /// Meaning and accuracy of the times, to replace those of the table.
    pub policy: Option<Policy>,
    /// How long to wait before the camera is started. Several Argus cameras must not be started at
    /// the same moment.
    pub start_delay: Duration,
    /// How much later the right eye's chain is started; [`STAGGER`] unless said otherwise.
    pub eye_delay: Duration,
}

impl CaptureSettings {
    /// One chain, frames, the table's policy, no delay.
    pub fn new(chain: &str, width: u32, height: u32, rate_hz: f64) -> CaptureSettings {
        CaptureSettings {
            chain: chain.to_owned(),
            right_chain: None,
            width,
            height,
            rate_hz,
            delivery: Delivery::Images,
            policy: None,
            start_delay: Duration::ZERO,
            eye_delay: STAGGER,
        }
    }

    fn check(&self) -> Result<(), CaptureError> {
        let refuse = |reason: String| Err(CaptureError::Settings(reason));
        PixelFormat::I420.bytes(self.width, self.height)?;
        // The layouts of cameras share chroma between two pixels each way.
        if coded_size(self.width, self.height) != (self.width, self.height) {
            return refuse(format!(
                "{}x{}, expected an even width and height",
                self.width, self.height
            ));
        }
        if !(self.rate_hz > 0.0 && self.rate_hz <= 1000.0) {
            return refuse(format!(
                "rate {} Hz, expected more than 0 and at most 1000",
                self.rate_hz
            ));
        }
        if self.width > 16384 || self.height > 16384 {
            let (width, height) = (self.width, self.height);
            return refuse(format!("{width}x{height}, expected at most 16384 each way"));
        }
        if self.right_chain.is_some() {
            if !self.width.is_multiple_of(4) {
                return refuse(format!(
                    "{} columns of two eyes, expected a multiple of four",
                    self.width
                ));
            }
            if self.delivery == Delivery::Native {
                return refuse(
                    "two chains cannot be joined without a copy; join them in one chain \
                     (nvcompositor), or take frames"
                        .into(),
                );
            }
        }
        Ok(())
    }

    /// The output requested of each chain.
    fn wanted(&self) -> OutputRequest {
        let native = self.delivery == Delivery::Native;
        let eyes = 1 + u32::from(self.right_chain.is_some());
        let raw = |formats: &[&str]| {
            gst::Structure::builder("video/x-raw")
                .field("format", gst::List::new(formats.iter().copied()))
                .field("width", (self.width / eyes) as i32)
                .field("height", self.height as i32)
                .build()
        };
        let mut caps = gst::Caps::builder_full().structure(raw(&layout::READABLE));
        if native {
            // An encoder in a Jetson takes both of these.
            let features = gst::CapsFeatures::new([NVMM]);
            caps = caps.structure_with_features(raw(&["NV12", "I420"]), features);
        }
        let held = if native {
            NATIVE_QUEUE + MAX_NATIVE_IN_FLIGHT
        } else {
            QUEUE
        };
        OutputRequest {
            caps: caps.build(),
            native,
            // And one in the taker's hands, one that is being filled.
            held: held as u32 + 2,
        }
    }
}

/// Why a capture was not started. What a camera does later comes as a [`CaptureEvent`].
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum CaptureError {
    /// GStreamer itself is unusable.
    #[error(transparent)]
    Init(#[from] InitError),
    /// Change the settings.
    #[error("capture settings: {0}")]
    Settings(String),
    /// No frame can have this size.
    #[error(transparent)]
    Size(#[from] RawImageError),
    /// Change the chain, or install what it needs.
    #[error("{reason}: {chain}")]
    Chain {
        /// What is wrong with it.
        reason: String,
        /// The chain.
        chain: String,
    },
    /// The machine has no thread to spare.
    #[error("starting a camera's thread: {0}")]
    Thread(String),
}

/// A time of another clock that came with a frame (GstReferenceTimestampMeta).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reference {
    /// GStreamer's name of the clock: `timestamp/x-unix`, `timestamp/x-ptp, …`.
    pub clock: String,
    /// The time, ns on that clock.
    pub time_ns: u64,
}

/// The pixels of a frame.
#[derive(Debug, Clone)]
pub enum Content {
    /// As I420.
    RawImage(RawImage),
    /// As the camera gave them.
    Native(NativeFrame),
}

/// One frame.
#[derive(Debug, Clone)]
pub struct CapturedFrame {
    /// Its number, see [`policy::Numbers`]; of two eyes, the left one's.
    pub number: u64,
    /// The buffer's PTS as running time of its pipeline, ns.
    pub pts_running_ns: i64,
    /// The same instant on CLOCK_MONOTONIC, ns. [`Capture::policy`] states its meaning.
    pub clock_time_ns: i64,
    /// When it arrived, by the caller's clock, ns; of two eyes, the later one.
    pub host_time_ns: i64,
    /// Its time is not after the one before: its source repeats itself, or its time is wrong.
    pub repeated: bool,
    /// How much later the right eye's time is than the left's, ns, where they came separately.
    pub eyes_apart_ns: Option<i64>,
    /// Times of other clocks.
    pub references: Vec<Reference>,
    /// The pixels.
    pub content: Content,
}

/// Why frames that were there are not delivered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// Frames were not taken fast enough.
    Overrun,
    /// The other eye's frame, of this eye, did not come.
    NoPartner(Eye),
}

/// Frames that are not delivered, though their camera gave them (or one eye of them). Those that
/// never came are holes in the numbers only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LostFrames {
    /// The first number.
    pub first: u64,
    /// The last number.
    pub last: u64,
    /// Why.
    pub cause: Cause,
}

/// Counts of frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames that were taken.
    pub delivered: u64,
    /// Frames missing in the numbers: lost before they reached us. Of two eyes, of both.
    pub missing: u64,
    /// Frames whose time was not after the one before.
    pub repeated: u64,
    /// Frames dropped because the queue was full.
    pub overrun: u64,
    /// Frames of one eye without the other.
    pub unpaired: u64,
}

/// An event of a capture.
#[derive(Debug, Clone)]
pub enum CaptureEvent {
    /// The next frame.
    Frame(CapturedFrame),
    /// Frames that will not come. They belong in front of the next one.
    Lost(LostFrames),
    /// The device is disconnected, busy, or refuses: start a new capture when it may be back.
    Gone {
        /// The element that said so.
        element: String,
        /// Its words.
        reason: String,
    },
    /// The chain does not work, or an element failed otherwise. (Some elements say only this when
    /// their camera is unplugged.)
    Failed {
        /// The element that said so.
        element: String,
        /// Its words.
        reason: String,
    },
    /// The chain has come to its end by itself.
    Ended,
}

impl CaptureEvent {
    fn failed(element: &str, reason: String) -> CaptureEvent {
        CaptureEvent::Failed {
            element: element.to_owned(),
            reason,
        }
    }
}

/// Whether a capture of these settings could be built: its elements are there and fit together.
/// Starts nothing.
///
/// # Errors
/// See [`CaptureError`].
pub fn check(settings: &CaptureSettings) -> Result<(), CaptureError> {
    build(settings, Arc::new(|| 0)).map(drop)
}

/// The chains of `settings` in front of one intake, with their delays; nothing runs yet.
fn build(settings: &CaptureSettings, clock: HostClock) -> Result<CaptureParts, CaptureError> {
    settings.check()?;
    pipeline::init()?;
    let limit = match settings.delivery {
        Delivery::Images => QUEUE,
        Delivery::Native => NATIVE_QUEUE,
    };
    let intake = Arc::new(Intake::new(clock, limit, settings.rate_hz));
    let two = settings.right_chain.is_some();
    let feed = |eye, chain: &str| {
        let port = |element: &str| Port {
            eye: two.then_some(eye),
            numbering: Mutex::new(Numbering::new(
                feed::policy(element, settings.policy).numbers,
                settings.rate_hz,
            )),
        };
        Feed::build(chain, settings.wanted(), &intake, port).map_err(|reason| CaptureError::Chain {
            reason,
            chain: chain.to_owned(),
        })
    };
    let mut feeds = vec![(feed(Eye::Left, &settings.chain)?, settings.start_delay)];
    if let Some(chain) = &settings.right_chain {
        let delay = settings.start_delay.saturating_add(settings.eye_delay);
        feeds.push((feed(Eye::Right, chain)?, delay));
    }
    Ok(CaptureParts { intake, feeds })
}

struct CaptureParts {
    intake: Arc<Intake>,
    feeds: Vec<(Feed, Duration)>,
}

/// A running camera.
#[derive(Debug)]
pub struct Capture {
    intake: Arc<Intake>,
    policy: Policy,
    native: bool,
    // Dropped last: stops the pipelines.
    feeds: Vec<Feed>,
}

impl Capture {
    /// Builds the chain and has it started, after [`CaptureSettings::start_delay`], on a thread of
    /// its own. `clock` returns the time at which each frame arrives.
    ///
    /// # Errors
    /// See [`CaptureError`]: errors that can be detected without the device. The rest comes as an
    /// event.
    pub fn start(settings: &CaptureSettings, clock: HostClock) -> Result<Capture, CaptureError> {
        Capture::start_with(settings, clock, |_| ())
    }

    /// As [`Capture::start`], with `look` called for each chain before it is started.
    pub(crate) fn start_with(
        settings: &CaptureSettings,
        clock: HostClock,
        mut look: impl FnMut(&gst::Bin),
    ) -> Result<Capture, CaptureError> {
        let CaptureParts { intake, feeds } = build(settings, clock)?;
        for (feed, delay) in &feeds {
            look(feed.pipeline());
            if let Err(reason) = feed.start(*delay, &intake) {
                intake.abandon();
                return Err(CaptureError::Thread(reason));
            }
        }
        let feeds: Vec<Feed> = feeds.into_iter().map(|(feed, _)| feed).collect();
        let element = feeds.first().map_or("", |feed| &feed.element);
        Ok(Capture {
            policy: feed::policy(element, settings.policy),
            native: settings.delivery == Delivery::Native,
            intake,
            feeds,
        })
    }

    /// The next event, waiting at most `timeout` for it. After [`CaptureEvent::Gone`],
    /// [`CaptureEvent::Failed`] or [`CaptureEvent::Ended`] every further call returns it again
    /// immediately.
    pub fn next(&mut self, timeout: Duration) -> Option<CaptureEvent> {
        let converted = match self.intake.take(timeout)? {
            Item::Frame(arrived) => self.one(arrived),
            Item::Eyes(left, right) => both(left, right),
            Item::Lost(lost) => return Some(CaptureEvent::Lost(lost)),
            Item::End(event) => return Some(event),
        };
        Some(match converted {
            Ok(frame) => CaptureEvent::Frame(frame),
            // These caps were requested, so the element violates them.
            Err(reason) => CaptureEvent::failed("the chain", reason),
        })
    }

    /// Meaning and accuracy of the frames' times.
    pub fn policy(&self) -> Policy {
        self.policy
    }

    /// Factory of the element that the (left eye's) frames come from: `nvarguscamerasrc`.
    pub fn element(&self) -> &str {
        self.feeds.first().map_or("", |feed| &feed.element)
    }

    /// Counts of frames so far.
    pub fn counts(&self) -> Counts {
        self.intake.counts()
    }

    fn one(&self, arrived: ArrivedFrame) -> Result<CapturedFrame, String> {
        let ArrivedFrame {
            number,
            repeated,
            host_time_ns,
            arrival,
        } = arrived;
        let content = if self.native {
            Content::Native(arrival.frame)
        } else {
            let image = arrival.frame.to_image();
            Content::RawImage(image.map_err(|error| error.to_string())?)
        };
        Ok(CapturedFrame {
            number,
            pts_running_ns: arrival.pts_running_ns,
            clock_time_ns: arrival.clock_time_ns,
            host_time_ns,
            repeated,
            eyes_apart_ns: None,
            references: arrival.references,
            content,
        })
    }
}

impl Drop for Capture {
    fn drop(&mut self) {
        // Before the pipelines: one that is about to be started is not started then.
        self.intake.abandon();
    }
}

/// Left and right as one frame.
fn both(left: ArrivedFrame, right: ArrivedFrame) -> Result<CapturedFrame, String> {
    let (one, other) = (&left.arrival.frame, &right.arrival.frame);
    let image = layout::to_side_by_side(
        (one.buffer(), one.format().info()),
        (other.buffer(), other.format().info()),
    )?;
    Ok(CapturedFrame {
        number: left.number,
        pts_running_ns: left.arrival.pts_running_ns,
        clock_time_ns: left.arrival.clock_time_ns,
        host_time_ns: left.host_time_ns.max(right.host_time_ns),
        repeated: left.repeated || right.repeated,
        eyes_apart_ns: Some(right.arrival.clock_time_ns - left.arrival.clock_time_ns),
        references: left.arrival.references,
        content: Content::RawImage(image),
    })
}

#[cfg(test)]
mod tests;
