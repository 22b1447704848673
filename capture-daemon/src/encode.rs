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
use std::sync::PoisonError;
use std::thread::JoinHandle;
use std::time::Duration;

use session_archive::record::Frame;
use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;
use video::encoder::Input;
use video::{EncodeError, EncoderSettings, RawImage};

mod delivery;
mod restarts;
mod running;
#[cfg(test)]
mod tests;

pub use self::delivery::{EncoderOutput, Sink};

use self::delivery::{ENDED_EARLY, State, end};
use self::running::{FAILURE_RESET_NS, Running};

/// Maximum time without output from an encoder that holds frames. After it the encoder is
/// considered stuck.
pub const STALL_NS: i64 = 2_000_000_000;
/// Maximum number of abandoned encoders that are terminating at the same time. Each holds its
/// frames until it has terminated, and an encoder that is stuck in its driver never does.
const MAX_ENDING_ENCODERS: usize = 3;
/// Virtual time waits for every frame; an encoder that takes longer than this in real time is
/// stuck.
const VIRTUAL_TIMEOUT: Duration = Duration::from_secs(60);

/// Cause detail of frames that arrived while no encoder was running.
const NOT_RUNNING: &str = "no encoder is running";

/// A frame that waits for room in the encoder.
struct Waiting {
    frame: Frame,
    image: RawImage,
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
            Input::RawImage(image) => image,
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
        (self.sink)(EncoderOutput::Dropped {
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
        end(running.encoder, &running.shared, &self.sink, limit);
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
            Err(EncodeError::Full { images }) => {
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
}
