//! The thread of the hub, and its output into the queue of the recorder.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;

use super::shared::{HubInput, INBOX_CAPACITY_BYTES, Shared, ToRecorder, lock};
use super::waiting::{POLL_TIMEOUT, span};
use crate::clock::Clock as _;
use crate::encode::RemainingFrames;
use crate::hub::{Hub, Out, Outgoing, TICK_NS};
use crate::queue::PopResult;

pub(super) fn run_hub(mut hub: Hub, sources: usize, shared: &Shared) {
    let mut running = sources;
    // All sources have ended, and frames may still wait for their encoders.
    let mut draining = false;
    let mut now = shared.clock.now();
    let mut next_tick = now;
    loop {
        let timeout = match draining {
            true => POLL_TIMEOUT.min(span(now, next_tick)),
            false => span(now, next_tick),
        };
        let popped = shared.inbox.pop(timeout);
        now = shared.clock.now();
        shared.beat(&shared.hub_beat);
        hub.set_mitigations(*lock(&shared.mitigations));
        let is_idle = shared.is_idle();
        let since = HostTime(shared.recording_since.load(Ordering::SeqCst));
        hub.idle(is_idle, since);
        for (camera, needed) in shared.key_frame_needed.iter().enumerate() {
            if needed.swap(false, Ordering::Relaxed) {
                hub.request_key(camera);
            }
        }
        match popped {
            PopResult::Item(HubInput::Sample(i, sample)) => hub.sample(i, sample, now),
            PopResult::Item(HubInput::Dropped(i, number, at)) => hub.dropped(i, number, at, now),
            PopResult::Item(HubInput::Ended(i, failure)) => {
                if let Some(error) = failure {
                    hub.source_failed(i, &error, now);
                    shared.outcome.source_failed(error);
                }
                running -= 1;
                draining = running == 0;
            }
            PopResult::Nothing => {}
            PopResult::Closed => break,
        }
        if now >= next_tick {
            hub.set_inbox_fill(shared.inbox.bytes() as f64 / INBOX_CAPACITY_BYTES as f64);
            hub.tick(now);
            next_tick = now + TICK_NS;
        }
        // In rounds: on a slow machine this takes longer than the watchdog allows a thread.
        if draining && hub.drain(now) {
            draining = false;
            hub.finish(RemainingFrames::Encode, now);
            shared.all_ended.set();
        }
    }
    hub.finish(RemainingFrames::Drop, shared.clock.now());
    shared.outbox.close();
}

/// Output of the hub and the encoders, into the recorder's queue.
pub(super) fn to_recorder(shared: Arc<Shared>, names: Vec<String>) -> Out {
    let skipping: Vec<AtomicBool> = names.iter().map(|_| AtomicBool::new(false)).collect();
    Arc::new(move |item: Outgoing| {
        let bytes = item.bytes();
        let (camera, number, at, key) = match &item {
            Outgoing::Frame {
                camera, frame, key, ..
            } => (*camera, frame.number, HostTime(frame.time), *key),
            _ => {
                let _ = shared.outbox.push_reserved(ToRecorder::Item(item), bytes);
                return;
            }
        };
        // After a frame is dropped behind the encoder, the following ones refer to it.
        let skip = skipping[camera].load(Ordering::Relaxed) && !key;
        if !skip
            && shared
                .outbox
                .try_push(ToRecorder::Item(item), bytes)
                .is_ok()
        {
            skipping[camera].store(false, Ordering::Relaxed);
            return;
        }
        // Again if the requested key frame did not fit either.
        if !skipping[camera].swap(true, Ordering::Relaxed) || key {
            shared.key_frame_needed[camera].store(true, Ordering::Relaxed);
        }
        let dropped = Outgoing::Dropped {
            at,
            stream: names[camera].clone(),
            first: number,
            last: number,
            cause: Cause::WriterOverload,
            detail: "the disk is too slow".to_owned(),
        };
        let _ = shared.outbox.push_reserved(ToRecorder::Item(dropped), 0);
    })
}
