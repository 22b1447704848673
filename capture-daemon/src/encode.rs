//! Encoding one camera's frames, through failures.
//!
//! A [`CameraEncoder`] takes frames and hands on access units with their companion records, in order. Key
//! frames are forced where a chunk of the archive begins. An encoder that fails, or gives nothing for
//! [`STALL_NS`], is replaced, at once the first time and ever more slowly if that goes on; frames that
//! were inside it are reported as dropped, never forgotten. Given-up encoders that do not let go are
//! bounded too: with `MAX_ENDING_ENCODERS` of them no other is started ([`CameraEncoder::is_failing`] tells).
//!
//! Frames wait for the encoder in a queue that is bounded in bytes ([`CameraEncoder::take_fill`]), also for one that is to be
//! started again. When it is full, the new frame is dropped whole, before the encoder, so that no other frame depends on
//! it. Frames in their cameras' own buffers do not wait: the camera needs its buffers back. A full encoder refuses them,
//! which counts as a full queue.

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

/// An encoder that holds frames and gives nothing for so long is taken to be stuck.
pub const STALL_NS: i64 = 2_000_000_000;
/// How long until the next try after a second failure in a row; twice as long after each further one.
const RETRY_NS: i64 = 1_000_000_000;
/// The longest time between two tries.
const MAX_RETRY_NS: i64 = 32 * RETRY_NS;
/// A failure that comes so long after the start is the first one again.
const FAILURE_RESET_NS: i64 = 10_000_000_000;
/// Given-up encoders that may be ending at once: each holds its pictures until it is gone, and one that
/// hangs in its driver never is.
const MAX_ENDING_ENCODERS: usize = 3;
/// Virtual time waits for every frame; longer than this in real time is a stuck encoder.
const VIRTUAL_TIMEOUT: Duration = Duration::from_secs(60);

/// By how much coarser frames are encoded to make fewer bits: half as many, about.
const DEGRADED_QUALITY_DROP_DB: f64 = 4.0;
/// But no coarser than this.
const MIN_QUALITY_DB: f64 = 30.0;
/// How long an encoder may take to give what is inside when it is ended for another setting.
const CHANGE_TIMEOUT: Duration = Duration::from_secs(5);

/// Why a frame is dropped that came while no encoder was running.
const NOT_RUNNING: &str = "no encoder is running";
/// Why frames are dropped that an encoder was given and did not give back.
const ENDED_EARLY: &str = "the encoder ended without giving them";

/// What a lane hands on.
#[derive(Debug)]
pub enum Encoded {
    /// An access unit and its companion.
    Frame {
        /// Everything but what the archive writer fills in.
        frame: Frame,
        /// Annex B.
        unit: Bytes,
        /// Whether it can be decoded alone.
        key: bool,
    },
    /// Frames that will not come.
    Dropped {
        /// Time of the first.
        at: HostTime,
        /// First number.
        first: u64,
        /// Last number.
        last: u64,
        /// Why.
        cause: Cause,
        /// What exactly happened.
        detail: String,
    },
}

/// Where a lane hands on to; called from the encoder's threads.
pub type Sink = Arc<dyn Fn(Encoded) + Send + Sync>;

/// What the pushing thread and the encoder's threads share. Each encoder has its own, so that a late
/// word of a replaced one changes nothing.
struct EncoderShared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    frames: VecDeque<(i64, Frame)>,
    /// Access units handed on.
    delivered: u64,
    failure: Option<String>,
    abandoned: bool,
    /// The encoder that made way for this one and may not have given everything yet.
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
    /// What it was last set to.
    effort: Effort,
}

/// What may change from one chunk to the next.
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

/// What is made easier for the encoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EffortReduction {
    /// The fastest preset, where there are several: larger files of the same quality.
    pub preset: bool,
    /// Fewer bits: coarser images.
    pub quality: bool,
}

/// What [`CameraEncoder::finish`] does with frames that still wait for the encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RemainingFrames {
    /// Encodes them.
    Encode,
    /// Reports them as dropped: nobody stores them any more.
    Drop,
}

/// One camera's way through its encoder.
pub struct CameraEncoder {
    settings: EncoderSettings,
    chunk_ns: i64,
    sink: Sink,
    running: Option<Running>,
    /// Epoch of the newest key frame.
    epoch: Option<i64>,
    previous_pts: i64,
    /// Access units that the running encoder had given when it was last looked at, and when it
    /// had last given one.
    delivered: u64,
    last_progress: HostTime,
    /// When an encoder was last started, and failures in a row since.
    started: HostTime,
    failures: u32,
    retry_at: HostTime,
    /// Given up, and not yet gone.
    ending: Vec<JoinHandle<()>>,
    key_frame_requested: bool,
    reduction: EffortReduction,
    waiting: VecDeque<Waiting>,
    waiting_bytes: usize,
    /// Bytes that may wait.
    capacity: usize,
    /// A frame that cannot wait was refused since the fill was last looked at.
    refused: bool,
}

impl CameraEncoder {
    /// A lane; the encoder starts with the first frame. Frames of up to `capacity` bytes wait in front of it, one
    /// always.
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

    /// Whether the encoder has failed and none has worked for a while since. Looked at in
    /// [`Self::tick`].
    pub fn is_failing(&self) -> bool {
        self.failures > 0
    }

    /// Bytes of the frames in front of the encoder and inside.
    pub fn queued_bytes(&self) -> usize {
        let shared = self.running.as_ref();
        self.waiting_bytes + shared.map_or(0, |r| r.encoder.queued_bytes())
    }

    /// How far the encoder is behind, 0 to 1: how full the queue in front of it is, and 1 if it was too full for a
    /// frame that cannot wait since the last look. What waits for an encoder that is to be started again says nothing.
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

    /// Makes it easier for the encoder from the next chunk on, or again as configured.
    pub fn reduce_effort(&mut self, reduction: EffortReduction) {
        self.reduction = reduction;
    }

    /// Makes the next frame a key frame.
    pub fn request_key(&mut self) {
        self.key_frame_requested = true;
    }

    /// Takes a frame; never waits. What cannot be encoded is reported as dropped.
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

    /// Hands waiting frames to the encoder as far as it has room; call it often. They go on waiting while none may be
    /// started.
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

    /// For when no frame is taken any more; never waits. Hands waiting frames on as [`Self::feed`] does, and reports
    /// them if there is no encoder for them. Whether none waits: then [`Self::finish`] has only to drain the encoder.
    pub fn drain(&mut self, now: HostTime) -> bool {
        self.feed(now);
        if self.running.is_none() {
            self.drop_waiting(Cause::EncoderRestart, NOT_RUNNING);
        }
        self.waiting.is_empty()
    }

    /// Reports what waits as dropped.
    pub fn drop_waiting(&mut self, cause: Cause, why: &str) {
        for Waiting { frame, .. } in std::mem::take(&mut self.waiting) {
            self.drop_frame(&frame, cause, why.to_owned());
        }
        self.waiting_bytes = 0;
    }

    /// Why no encoder is running and none may be started now, if that is so; with `wait`, however many hang.
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

    /// Takes a frame and waits until it has come out: virtual time drops nothing, and the order of
    /// everything is the order of the calls.
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

    /// Looks after the encoder; call it a few times a second.
    pub fn tick(&mut self, now: HostTime) {
        self.ending.retain(|thread| !thread.is_finished());
        self.feed(now);
        let Some(running) = &self.running else { return };
        let state = running.shared.lock();
        if state.before.is_some() {
            // It waits for the one before it, which has its own limit.
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

    /// Drains the encoder: everything taken is handed on or reported when this returns.
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

    /// Gives a frame to the encoder, and starts one if need be; waits for room if it is to `wait`. What cannot be
    /// encoded is reported.
    ///
    /// # Errors
    /// The frame, if the encoder is full, and how many are inside.
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

    /// Starts an encoder, which hands on nothing until everything of the one `before` it is told.
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

    /// What encoders are set to now.
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

    /// A chunk begins, and with it a key frame: an encoder that is to be set to something else and cannot change it
    /// makes way for another one. It gives what it has on a thread of its own: other cameras' frames are waiting.
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

    /// Gives the encoder up and reports what was inside; the next frame starts another.
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

    /// Ends an encoder on a thread of its own: one that is stuck takes seconds, and this thread has other cameras to
    /// serve.
    fn end_in_background(&mut self, end: impl FnOnce() + Send + 'static) {
        let name = "encoder-end".to_owned();
        // Without a thread what was handed over is dropped here, and so ended.
        self.ending
            .extend(std::thread::Builder::new().name(name).spawn(end));
    }

    /// Counts a failure and puts off the next start.
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

/// Lets an encoder give what is inside, for so long; the rest is reported as dropped.
fn end(running: Running, sink: &Sink, limit: Duration) {
    if let Err(e) = running.encoder.finish(limit) {
        log::warn!("ending the encoder: {e}");
    }
    report_undelivered(&running.shared, sink, ENDED_EARLY);
}

/// Reports what is inside an encoder that has ended or is given up; whatever it still says is ignored from here on. In
/// the order of the frames: what an encoder before it has left comes first, and all under the lock, so that nobody
/// hands on a later frame meanwhile.
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

/// Waits until an encoder that is ending has given everything; after [`CHANGE_TIMEOUT`] the rest is reported as dropped.
fn wait_for_end(before: &EncoderShared, sink: &Sink) {
    let ending = before
        .changed
        .wait_timeout_while(before.lock(), CHANGE_TIMEOUT, |state| !state.abandoned);
    drop(ending.unwrap_or_else(PoisonError::into_inner));
    report_undelivered(before, sink, ENDED_EARLY);
}

/// An encoder said something.
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
    // Handed on under the lock: a frame is either handed on or still inside, never both.
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
