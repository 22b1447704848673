//! The output of encoders: each frame is delivered or reported as dropped, once, in order.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use session_archive::record::Frame;
use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;
use video::{Encoder, EncoderEvent};

/// Maximum time for an encoder to deliver its frames when it is replaced for another setting.
pub(super) const CHANGE_TIMEOUT: Duration = Duration::from_secs(5);
/// Cause detail of frames that an encoder accepted and never delivered.
pub(super) const ENDED_EARLY: &str = "the encoder ended without giving them";

/// Output of a [`CameraEncoder`](super::CameraEncoder).
#[derive(Debug)]
pub enum EncoderOutput {
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
pub type Sink = Arc<dyn Fn(EncoderOutput) + Send + Sync>;

/// State shared by the pushing thread and the encoder's threads. Each encoder has its own, so that
/// a late event of a replaced encoder has no effect.
pub(super) struct EncoderShared {
    pub(super) state: Mutex<State>,
    pub(super) changed: Condvar,
}

#[derive(Default)]
pub(super) struct State {
    pub(super) frames: VecDeque<(i64, Frame)>,
    /// Number of access units delivered.
    pub(super) delivered: u64,
    pub(super) failure: Option<String>,
    pub(super) abandoned: bool,
    /// The encoder that this one replaces; it may not have delivered everything yet.
    pub(super) before: Option<Arc<EncoderShared>>,
}

impl EncoderShared {
    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Lets an encoder deliver its frames within `limit`; the rest is reported as dropped.
pub(super) fn end(encoder: Encoder, shared: &EncoderShared, sink: &Sink, limit: Duration) {
    if let Err(e) = encoder.finish(limit) {
        log::warn!("ending the encoder: {e}");
    }
    report_undelivered(shared, sink, ENDED_EARLY);
}

/// Reports the frames inside an encoder that has ended or is abandoned; its later events are
/// ignored. Frames are reported in order: those of its predecessor come first, and all under the
/// lock, so that no later frame is delivered meanwhile.
pub(super) fn report_undelivered(shared: &EncoderShared, sink: &Sink, detail: &str) {
    let mut state = shared.lock();
    if let Some(before) = state.before.take() {
        report_undelivered(&before, sink, ENDED_EARLY);
    }
    state.abandoned = true;
    for (_, frame) in state.frames.drain(..) {
        sink(EncoderOutput::Dropped {
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
pub(super) fn wait_for_end(before: &EncoderShared, sink: &Sink) {
    let ending = before
        .changed
        .wait_timeout_while(before.lock(), CHANGE_TIMEOUT, |state| !state.abandoned);
    drop(ending.unwrap_or_else(PoisonError::into_inner));
    report_undelivered(before, sink, ENDED_EARLY);
}

/// Handles an event of an encoder.
pub(super) fn deliver(event: EncoderEvent, shared: &EncoderShared, sink: &Sink) {
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
                sink(EncoderOutput::Frame {
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
