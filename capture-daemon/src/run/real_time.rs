//! Real time: a thread per source, one for the hub, one for the recorder.
//!
//! Between them are two queues bounded in bytes. When the inbox is full a frame is dropped before
//! the hub; when the outbox to the recorder is full, frames are dropped behind the encoder up to
//! the next key frame, which is requested until one is delivered. Both are reported with their
//! cause. IMU samples wait instead, and are gathered so that the hub is not woken for each. Hub,
//! recorder and the daemon's own loop sleep until something arrives or is due. When a source fails,
//! everything continues without it, with an alarm. When the loop of hub or recorder stalls for
//! `WATCHDOG_NS`, the run ends with an error; the session is closed before, if the recorder still
//! can.

use anyhow::bail;
use session_archive::time::{HostTime, NS_PER_S};

use self::running::{REPLAY_LEAD_NS, WATCHDOG_NS};
use self::waiting::{POLL_TIMEOUT, wait_until};
use super::build::RunParts;
use super::outcome::{Outcome, RecordOptions, RecordingSummary, StopFlag, stop_reason};
use crate::announce::FirstFrames;
use crate::clock::Clock as _;
use crate::recorder::OnProgress;
use crate::status::Request;

mod daemon;
mod hub_thread;
mod recorder_thread;
mod running;
mod shared;
mod source_thread;
#[cfg(test)]
mod tests;
mod waiting;

pub use self::daemon::daemon;
pub(super) use self::recorder_thread::send_request;
pub(super) use self::running::Running;
pub(super) use self::shared::Shared;

/// Maximum time for closing a recording, ns. After it the recording is abandoned.
const CLOSE_LIMIT_NS: i64 = 4 * WATCHDOG_NS;

/// Records one session in real time. See [`super::record_built`].
pub(super) fn record(
    build: impl FnOnce(HostTime) -> anyhow::Result<RunParts>,
    options: &RecordOptions,
    stop: &StopFlag,
    on_progress: OnProgress,
) -> anyhow::Result<RecordingSummary> {
    let outcome = Outcome::default();
    let running = Running::start(
        build,
        options.out.clone(),
        Some(options.name.clone()),
        outcome.watch(on_progress),
        outcome.clone(),
    )?;
    let shared = running.shared.clone();
    let mut first_frames = FirstFrames::wait(running.names());
    let end = shared.clock.now() + REPLAY_LEAD_NS + (options.seconds * NS_PER_S as f64) as i64;
    let mut stop_requested = false;
    let mut give_up = HostTime::MAX;
    while !outcome.is_finished() {
        let now = shared.clock.now();
        if !stop_requested && (stop.is_set() || now >= end || shared.all_ended.is_set()) {
            stop_requested = true;
            give_up = now + CLOSE_LIMIT_NS;
            let reason = stop_reason(stop, shared.all_ended.is_set());
            running.request(Request::Stop, reason);
        }
        running.check()?;
        if let Some(status) = shared.latest() {
            first_frames.update(&status);
        }
        if now > give_up {
            bail!(
                "the session could not be closed within {} s",
                CLOSE_LIMIT_NS / NS_PER_S
            );
        }
        wait_until(now + POLL_TIMEOUT.as_nanos() as i64, &shared);
    }
    running.end();
    outcome.take()
}
