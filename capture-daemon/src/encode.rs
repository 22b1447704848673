//! Encoding of one camera's frames, including recovery from failures.
//!
//! A [`CameraEncoder`] takes frames and delivers access units with their companion records, in
//! order. Key frames are forced at the chunk boundaries of the archive. An encoder that fails, or
//! delivers nothing for [`STALL_NS`], is replaced: immediately after the first failure, with
//! exponential backoff after repeated ones. Frames that were inside it are reported as dropped,
//! never forgotten. The number of abandoned encoders that do not terminate is bounded too: at
//! `MAX_ENDING_ENCODERS` no other encoder is started ([`CameraEncoder::is_failing`] is true).
//!
//! Frames wait for the encoder in a queue bounded in bytes ([`CameraEncoder::take_fill`]), also
//! while the encoder is being restarted. When the queue is full, the new frame is dropped whole,
//! before the encoder, so that no other frame depends on it. Frames in their cameras' own buffers
//! do not wait, because the camera needs its buffers back: a full encoder rejects them, which
//! counts as a full queue.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use bytes::Bytes;
use session_archive::record::Frame;
use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;
use video::encoder::{Input, Preset};
use video::{EncodeError, Encoder, EncoderEvent, EncoderSettings, Picture};

/// Maximum time without output from an encoder that holds frames. After it the encoder is
/// considered stuck.
pub const STALL_NS: i64 = 2_000_000_000;
/// Delay before the restart after the second failure in a row; doubled after each further one.
const RETRY_NS: i64 = 1_000_000_000;
/// Maximum delay between two restarts.
const MAX_RETRY_NS: i64 = 32 * RETRY_NS;
/// Running time after which a failure counts as the first one again.
const FAILURE_RESET_NS: i64 = 10_000_000_000;
/// Maximum number of abandoned encoders that are terminating at the same time. Each holds its
/// frames until it has terminated, and an encoder that is stuck in its driver never does.
const MAX_ENDING_ENCODERS: usize = 3;
/// Virtual time waits for every frame; an encoder that takes longer than this in real time is
/// stuck.
const VIRTUAL_TIMEOUT: Duration = Duration::from_secs(60);

/// Reduction of the encoding quality under load, dB: about half of the bits.
const DEGRADED_QUALITY_DROP_DB: f64 = 4.0;
/// Minimum quality under load, dB.
const MIN_QUALITY_DB: f64 = 30.0;
/// Maximum time for an encoder to deliver its frames when it is replaced for another setting.
const CHANGE_TIMEOUT: Duration = Duration::from_secs(5);

/// Cause detail of frames that arrived while no encoder was running.
const NOT_RUNNING: &str = "no encoder is running";
/// Cause detail of frames that an encoder accepted and never delivered.
const ENDED_EARLY: &str = "the encoder ended without giving them";

/// Output of a [`CameraEncoder`].
#[derive(Debug)]
pub enum Encoded {
    /// An access unit and its companion.
    Frame {
        /// The record without the fields that the archive writer fills in.
        frame: Frame,
        /// Annex B.
        unit: Bytes,
        /// Whether the frame can be decoded on its own.
        key: bool,
    },
    /// Frames that will not be delivered.
    Dropped {
        /// Time of the first frame.
        at: HostTime,
        /// First number.
        first: u64,
        /// Last number.
        last: u64,
        /// Cause.
        cause: Cause,
        /// Details, for people.
        detail: String,
    },
}

/// Receiver of the output; called from the encoder's threads.
pub type Sink = Arc<dyn Fn(Encoded) + Send + Sync>;

/// State shared by the pushing thread and the encoder's threads. Each encoder has its own, so that
/// a late event of a replaced encoder has no effect.
struct EncoderShared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    frames: VecDeque<(i64, Frame)>,
    /// Number of access units delivered.
    delivered: u64,
    failure: Option<String>,
    abandoned: bool,
    /// The encoder that this one replaces; it may not have delivered everything yet.
    before: Option<Arc<EncoderShared>>,
}

impl EncoderShared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct Running {
    encoder: Encoder,
    shared: Arc<EncoderShared>,
    /// Settings last applied to it.
    effort: Effort,
}

/// Settings that may change from one chunk to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Effort {
    quality_db: f64,
    preset: Preset,
}

/// A frame that waits for room in the encoder.
struct Waiting {
    frame: Frame,
    image: Picture,
}

/// Reductions of the encoder's effort or output under load.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EffortReduction {
    /// Use the fastest preset, if there are several: larger files of the same quality.
    pub preset: bool,
    /// Use fewer bits: coarser images.
    pub quality: bool,
}

/// Treatment by [`CameraEncoder::finish`] of frames that still wait for the encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RemainingFrames {
    /// They are encoded.
    Encode,
    /// They are reported as dropped, because nobody stores them any more.
    Drop,
}

/// Encoding of one camera, with its queue and its restarts.
pub struct CameraEncoder {
    settings: EncoderSettings,
    chunk_ns: i64,
    sink: Sink,
    running: Option<Running>,
    /// Epoch of the newest key frame.
    epoch: Option<i64>,
    previous_pts: i64,
    /// Number of access units that the running encoder had delivered at the last check, and the
    /// time of the last one.
    delivered: u64,
    last_progress: HostTime,
    /// Time of the last encoder start, and the number of failures in a row since.
    started: HostTime,
    failures: u32,
    retry_at: HostTime,
    /// Threads that end abandoned encoders.
    ending: Vec<JoinHandle<()>>,
    key_frame_requested: bool,
    reduction: EffortReduction,
    waiting: VecDeque<Waiting>,
    waiting_bytes: usize,
    /// Maximum number of bytes in the queue.
    capacity: usize,
    /// A frame that cannot wait was rejected since the fill was last taken.
    refused: bool,
}

impl CameraEncoder {
    /// Creates it; the encoder starts with the first frame. The queue holds frames of up to
    /// `capacity` bytes, and always at least one frame.
    pub fn new(settings: EncoderSettings, chunk_ns: i64, capacity: usize, sink: Sink) -> Self {
        Self {
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            capacity: capacity.max(1),
            refused: false,
            settings,
            chunk_ns,
            sink,
            running: None,
            epoch: None,
            previous_pts: i64::MIN,
            delivered: 0,
            last_progress: HostTime::MIN,
            started: HostTime::MIN,
            failures: 0,
            retry_at: HostTime::MIN,
            ending: Vec::new(),
            key_frame_requested: false,
            reduction: EffortReduction::default(),
        }
    }

    /// Whether the encoder has failed and none has run successfully for a while since. Updated in
    /// [`Self::tick`].
    pub fn is_failing(&self) -> bool {
        self.failures > 0
    }

    /// Bytes of the frames in front of the encoder and inside.
    pub fn queued_bytes(&self) -> usize {
        let shared = self.running.as_ref();
        self.waiting_bytes + shared.map_or(0, |r| r.encoder.queued_bytes())
    }

    /// Fill of the queue, 0 to 1; 1 if a frame that cannot wait was rejected since the last call. 0
    /// while no encoder is running: frames that wait for a restart are no measure of load.
    pub fn take_fill(&mut self) -> f64 {
        if std::mem::take(&mut self.refused) {
            return 1.0;
        }
        if self.running.is_none() {
            return 0.0;
        }
        (self.waiting_bytes as f64 / self.capacity as f64).min(1.0)
    }

    /// Whether an encoder is running.
    pub fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Reduces the encoder's effort or output from the next chunk on, or restores the configured
    /// settings.
    pub fn reduce_effort(&mut self, reduction: EffortReduction) {
        self.reduction = reduction;
    }

    /// Makes the next frame a key frame.
    pub fn request_key(&mut self) {
        self.key_frame_requested = true;
    }

    /// Takes a frame; never blocks. A frame that cannot be encoded is reported as dropped.
    pub fn push<'a>(&mut self, frame: Frame, image: impl Into<Input<'a>>, now: HostTime) {
        let image = match image.into() {
            Input::Picture(image) => image,
            native => {
                if let Err((frame, images)) = self.submit(frame, native, now, false) {
                    self.refused = true;
                    self.drop_full(&frame, &format!("{images} frames in the encoder"));
                }
                return;
            }
        };
        let bytes = image.data.len();
        if !self.waiting.is_empty() && self.waiting_bytes + bytes > self.capacity {
            let detail = format!("{} MB wait for the encoder", self.waiting_bytes >> 20);
            match self.why_not_started(now, false) {
                Some(why) => {
                    let detail = format!("{why}, {detail}");
                    self.drop_frame(&frame, Cause::EncoderRestart, detail);
                }
                None => self.drop_full(&frame, &detail),
            }
        } else {
            let image = image.clone();
            self.waiting_bytes += bytes;
            self.waiting.push_back(Waiting { frame, image });
        }
        self.feed(now);
    }

    /// Passes queued frames to the encoder as long as it has room; to be called often. They stay
    /// queued while no encoder may be started.
    pub fn feed(&mut self, now: HostTime) {
        while self.why_not_started(now, false).is_none()
            && let Some(Waiting { frame, image }) = self.waiting.pop_front()
        {
            if let Err((frame, _)) = self.submit(frame, (&image).into(), now, false) {
                self.waiting.push_front(Waiting { frame, image });
                break;
            }
            self.waiting_bytes -= image.data.len();
        }
    }

    /// For the end, when no frame is taken any more; never blocks. Passes queued frames on as
    /// [`Self::feed`] does, and reports them as dropped if there is no encoder for them. Returns
    /// whether the queue is empty: then [`Self::finish`] only drains the encoder.
    pub fn drain(&mut self, now: HostTime) -> bool {
        self.feed(now);
        if self.running.is_none() {
            self.drop_waiting(Cause::EncoderRestart, NOT_RUNNING);
        }
        self.waiting.is_empty()
    }

    /// Reports all queued frames as dropped.
    pub fn drop_waiting(&mut self, cause: Cause, why: &str) {
        for Waiting { frame, .. } in std::mem::take(&mut self.waiting) {
            self.drop_frame(&frame, cause, why.to_owned());
        }
        self.waiting_bytes = 0;
    }

    /// Reason why no encoder is running and none may be started now, if there is one. With `wait`,
    /// the number of stuck encoders is ignored.
    fn why_not_started(&self, now: HostTime, wait: bool) -> Option<String> {
        if self.running.is_some() {
            None
        } else if now < self.retry_at {
            Some(NOT_RUNNING.to_owned())
        } else if !wait && self.ending.len() >= MAX_ENDING_ENCODERS {
            Some(format!(
                "{MAX_ENDING_ENCODERS} encoders are stuck and have not ended"
            ))
        } else {
            None
        }
    }

    fn drop_full(&self, frame: &Frame, detail: &str) {
        self.drop_frame(frame, Cause::EncoderOverload, detail.to_owned());
    }

    fn drop_frame(&self, frame: &Frame, cause: Cause, detail: String) {
        (self.sink)(Encoded::Dropped {
            at: HostTime(frame.time),
            first: frame.number,
            last: frame.number,
            cause,
            detail,
        });
    }

    /// Takes a frame and waits until it is delivered: virtual time drops nothing, and the order of
    /// all output is the order of the calls.
    pub fn push_and_wait<'a>(&mut self, frame: Frame, image: impl Into<Input<'a>>, now: HostTime) {
        if let Err((frame, _)) = self.submit(frame, image.into(), now, true) {
            self.drop_full(&frame, "the encoder is full");
        }
        let Some(running) = &self.running else { return };
        let state = running.shared.lock();
        let waiting = |s: &mut State| !s.frames.is_empty() && s.failure.is_none();
        let (state, late) = running
            .shared
            .changed
            .wait_timeout_while(state, VIRTUAL_TIMEOUT, waiting)
            .unwrap_or_else(PoisonError::into_inner);
        let failure = match (&state.failure, late.timed_out()) {
            (Some(reason), _) => Some(reason.clone()),
            (None, true) => Some("the encoder gives nothing".to_owned()),
            (None, false) => None,
        };
        drop(state);
        if let Some(reason) = failure {
            self.replace(&reason, now);
        }
    }

    /// Supervises the encoder; to be called a few times a second.
    pub fn tick(&mut self, now: HostTime) {
        self.ending.retain(|thread| !thread.is_finished());
        self.feed(now);
        let Some(running) = &self.running else { return };
        let state = running.shared.lock();
        if state.before.is_some() {
            // It waits for its predecessor, which has its own limit.
            self.last_progress = now;
        }
        let failure = state.failure.clone();
        let waiting = state.frames.front().map(|(_, f)| HostTime(f.host_time));
        let delivered = state.delivered;
        drop(state);
        if delivered != self.delivered {
            self.delivered = delivered;
            self.last_progress = now;
            if now.since(self.started) > FAILURE_RESET_NS {
                self.failures = 0;
            }
        }
        if let Some(reason) = failure {
            self.replace(&reason, now);
        } else if let Some(since) = waiting
            && now.since(since.max(self.last_progress)) > STALL_NS
        {
            self.replace("the encoder gave nothing for 2 s", now);
        }
    }

    /// Drains the encoder: every accepted frame is delivered or reported when this returns.
    pub fn finish(&mut self, rest: RemainingFrames, limit: Duration, now: HostTime) {
        if rest == RemainingFrames::Drop {
            self.drop_waiting(Cause::Late, ENDED_EARLY);
        }
        for Waiting { frame, image } in std::mem::take(&mut self.waiting) {
            if let Err((frame, _)) = self.submit(frame, (&image).into(), now, true) {
                self.drop_frame(&frame, Cause::Late, ENDED_EARLY.to_owned());
            }
        }
        self.waiting_bytes = 0;
        let Some(running) = self.running.take() else {
            return;
        };
        end(running, &self.sink, limit);
        self.last_progress = now;
    }

    /// Passes a frame to the encoder, starting one if necessary; with `wait`, blocks until there is
    /// room. A frame that cannot be encoded is reported.
    ///
    /// # Errors
    /// The frame and the number of frames inside, if the encoder is full.
    fn submit(
        &mut self,
        frame: Frame,
        image: Input<'_>,
        now: HostTime,
        wait: bool,
    ) -> Result<(), (Frame, usize)> {
        let restart = Cause::EncoderRestart;
        if let Some(why) = self.why_not_started(now, wait) {
            self.drop_frame(&frame, restart, why);
            return Ok(());
        }
        if self.running.is_none()
            && let Err(e) = self.start(image, None, now)
        {
            self.failed(now);
            self.drop_frame(&frame, restart, e.to_string());
            return Ok(());
        }
        let epoch = frame.time.div_euclid(self.chunk_ns);
        if self.epoch.is_some_and(|e| epoch > e) {
            self.follow_effort(image, now);
        }
        let key = self.key_frame_requested || self.epoch.is_none_or(|e| epoch > e);
        let pts = frame.time.max(self.previous_pts.saturating_add(1));
        let Some(Running {
            encoder, shared, ..
        }) = &mut self.running
        else {
            self.drop_frame(&frame, restart, NOT_RUNNING.to_owned());
            return Ok(());
        };
        shared.lock().frames.push_back((pts, frame));
        let pushed = if wait {
            encoder.push(pts, image, key)
        } else {
            encoder.try_push(pts, image, key)
        };
        match pushed {
            Ok(()) => {
                self.previous_pts = pts;
                if key {
                    self.epoch = Some(epoch);
                    self.key_frame_requested = false;
                }
            }
            Err(EncodeError::Full { pictures: images }) => {
                if let Some((_, frame)) = shared.lock().frames.pop_back() {
                    return Err((frame, images));
                }
            }
            Err(e) => {
                // The frame is still inside and is reported with the others.
                let reason = e.to_string();
                self.replace(&reason, now);
            }
        }
        Ok(())
    }

    /// Starts an encoder. It delivers nothing until everything of the encoder `before` it is
    /// reported.
    fn start(
        &mut self,
        image: Input<'_>,
        before: Option<Arc<EncoderShared>>,
        now: HostTime,
    ) -> Result<(), EncodeError> {
        self.started = now;
        let effort = self.effort();
        let settings = EncoderSettings {
            quality_db: effort.quality_db,
            preset: effort.preset,
            ..self.settings.clone()
        };
        let shared = Arc::new(EncoderShared {
            state: Mutex::new(State {
                before,
                ..State::default()
            }),
            changed: Condvar::new(),
        });
        let (sink, of_output) = (self.sink.clone(), shared.clone());
        let on_output = Box::new(move |event| deliver(event, &of_output, &sink));
        let encoder = match image {
            Input::Picture(_) => Encoder::start(&settings, on_output)?,
            Input::Native(frame) => Encoder::start_native(&settings, frame.format(), on_output)?,
        };
        self.running = Some(Running {
            encoder,
            shared,
            effort,
        });
        self.delivered = 0;
        self.last_progress = now;
        self.epoch = None;
        Ok(())
    }

    /// Current target settings of the encoder.
    fn effort(&self) -> Effort {
        Effort {
            quality_db: match self.reduction.quality {
                true => (self.settings.quality_db - DEGRADED_QUALITY_DROP_DB).max(MIN_QUALITY_DB),
                false => self.settings.quality_db,
            },
            preset: match self.reduction.preset {
                true => Preset::Ultrafast,
                false => self.settings.preset,
            },
        }
    }

    /// To be called when a chunk, and with it a key frame, begins. An encoder that needs other
    /// settings and cannot change them is replaced. The old one delivers its frames on a thread of
    /// its own, because other cameras' frames are waiting.
    fn follow_effort(&mut self, image: Input<'_>, now: HostTime) {
        let target = self.effort();
        let Some(running) = &mut self.running else {
            return;
        };
        if running.effort == target {
            return;
        }
        let set = match running.effort.preset == target.preset {
            true => running.encoder.set_quality(target.quality_db),
            false => Ok(false),
        };
        running.effort = target;
        match set {
            Ok(true) => {}
            Ok(false) => {
                let Some(running) = self.running.take() else {
                    return;
                };
                let (shared, sink) = (running.shared.clone(), self.sink.clone());
                self.end_in_background(move || end(running, &sink, CHANGE_TIMEOUT));
                if let Err(error) = self.start(image, Some(shared.clone()), now) {
                    log::warn!("starting {} again: {error}", self.settings.element);
                    report_undelivered(&shared, &self.sink, ENDED_EARLY);
                    self.failed(now);
                }
            }
            Err(error) => self.replace(&error.to_string(), now),
        }
    }

    /// Abandons the encoder and reports the frames inside; the next frame starts another one.
    fn replace(&mut self, reason: &str, now: HostTime) {
        let Some(Running {
            encoder, shared, ..
        }) = self.running.take()
        else {
            return;
        };
        log::warn!("{} is given up: {reason}", self.settings.element);
        self.failed(now);
        report_undelivered(&shared, &self.sink, reason);
        self.end_in_background(move || drop(encoder));
        self.last_progress = now;
        self.key_frame_requested = true;
    }

    /// Ends an encoder on a thread of its own: a stuck encoder takes seconds, and this thread
    /// serves other cameras.
    fn end_in_background(&mut self, end: impl FnOnce() + Send + 'static) {
        let name = "encoder-end".to_owned();
        // Without a thread the closure is dropped here, which ends the encoder.
        self.ending
            .extend(std::thread::Builder::new().name(name).spawn(end));
    }

    /// Counts a failure and delays the next start.
    fn failed(&mut self, now: HostTime) {
        if now.since(self.started) > FAILURE_RESET_NS {
            self.failures = 0;
        }
        let pause = match self.failures {
            0 => 0,
            before => (RETRY_NS << (before - 1).min(10)).min(MAX_RETRY_NS),
        };
        self.failures += 1;
        self.retry_at = now + pause;
    }
}

/// Lets an encoder deliver its frames within `limit`; the rest is reported as dropped.
fn end(running: Running, sink: &Sink, limit: Duration) {
    if let Err(e) = running.encoder.finish(limit) {
        log::warn!("ending the encoder: {e}");
    }
    report_undelivered(&running.shared, sink, ENDED_EARLY);
}

/// Reports the frames inside an encoder that has ended or is abandoned; its later events are
/// ignored. Frames are reported in order: those of its predecessor come first, and all under the
/// lock, so that no later frame is delivered meanwhile.
fn report_undelivered(shared: &EncoderShared, sink: &Sink, detail: &str) {
    let mut state = shared.lock();
    if let Some(before) = state.before.take() {
        report_undelivered(&before, sink, ENDED_EARLY);
    }
    state.abandoned = true;
    for (_, frame) in state.frames.drain(..) {
        sink(Encoded::Dropped {
            at: HostTime(frame.time),
            first: frame.number,
            last: frame.number,
            cause: Cause::EncoderRestart,
            detail: detail.to_owned(),
        });
    }
    shared.changed.notify_all();
}

/// Waits until an encoder that is ending has delivered everything; after [`CHANGE_TIMEOUT`] the
/// rest is reported as dropped.
fn wait_for_end(before: &EncoderShared, sink: &Sink) {
    let ending = before
        .changed
        .wait_timeout_while(before.lock(), CHANGE_TIMEOUT, |state| !state.abandoned);
    drop(ending.unwrap_or_else(PoisonError::into_inner));
    report_undelivered(before, sink, ENDED_EARLY);
}

/// Handles an event of an encoder.
fn deliver(event: EncoderEvent, shared: &EncoderShared, sink: &Sink) {
    let unit = match event {
        EncoderEvent::AccessUnit(unit) => unit,
        EncoderEvent::Failed(reason) => {
            shared.lock().failure = Some(reason);
            shared.changed.notify_all();
            return;
        }
    };
    let before = shared.lock().before.clone();
    if let Some(before) = before {
        // Without the lock: the next frame is pushed meanwhile.
        wait_for_end(&before, sink);
    }
    // Delivered under the lock: a frame is either delivered or still inside, never both.
    let mut state = shared.lock();
    state.before = None;
    if state.abandoned {
        return;
    }
    match state.frames.front() {
        Some((pts, _)) if *pts == unit.pts_ns => {
            if let Some((_, frame)) = state.frames.pop_front() {
                state.delivered += 1;
                sink(Encoded::Frame {
                    frame,
                    unit: unit.data,
                    key: unit.key,
                });
            }
        }
        _ => {
            state.failure = Some(format!(
                "it gave a time that it was not given: {}",
                unit.pts_ns
            ))
        }
    }
    drop(state);
    shared.changed.notify_all();
}

#[cfg(test)]
mod tests;
