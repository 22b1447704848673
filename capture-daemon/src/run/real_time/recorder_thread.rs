//! The thread of the recorder, and requests to it.

use std::sync::atomic::Ordering;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;

use session_archive::time::HostTime;

use super::shared::{Shared, ToRecorder};
use super::waiting::{POLL_TIMEOUT, span};
use crate::clock::Clock as _;
use crate::queue::PopResult;
use crate::recorder::Recorder;
use crate::status::{Request, Response, State};

/// Maximum age of the published status, ns.
const STATUS_MAX_AGE_NS: i64 = 200_000_000;
/// Maximum time for a request.
pub(super) const REQUEST_LIMIT: Duration = Duration::from_secs(5);
/// Maximum time for a stop: queued frames are encoded first (`recorder::MAX_STOP_NS`). Clients wait
/// longer ([`control::answer_limit`], the page), and so does systemd (`deploy/pawsd.service`).
pub(super) const STOP_REQUEST_LIMIT: Duration = Duration::from_secs(30);

pub(super) fn run_recorder(mut recorder: Recorder, shared: &Shared) {
    // Stop requests are answered when the session is closed.
    let mut stopping: Vec<SyncSender<Response>> = Vec::new();
    let mut status_changed: Option<(HostTime, State)> = None;
    loop {
        let timeout = match status_changed {
            // The results of the disk are checked as often as samples arrive.
            Some((at, state)) if state != State::Stopping => {
                span(shared.clock.now(), at + STATUS_MAX_AGE_NS)
            }
            _ => POLL_TIMEOUT,
        };
        let popped = shared.outbox.pop(timeout);
        shared.beat(&shared.recorder_beat);
        match popped {
            PopResult::Item(ToRecorder::Item(item)) => recorder.handle(item),
            PopResult::Item(ToRecorder::Request(request, source, reply)) => {
                let is_stop = request == Request::Stop;
                if matches!(request, Request::Start { .. }) {
                    // Before there is a folder that could be taken for an ended session.
                    shared.set_recording(true);
                }
                status_changed = None;
                let answer = recorder.request(request, source);
                if is_stop && recorder.state() == State::Stopping {
                    stopping.push(reply);
                } else {
                    let _ = reply.try_send(answer);
                }
            }
            PopResult::Nothing => {}
            PopResult::Closed => break,
        }
        recorder.tick();
        if recorder.state() != State::Stopping {
            for reply in stopping.drain(..) {
                let _ = reply.try_send(recorder.request(Request::Status, "control"));
            }
        }
        let (now, state) = (shared.clock.now(), recorder.state());
        let is_new = status_changed
            .is_none_or(|(at, was)| was != state || now.since(at) >= STATUS_MAX_AGE_NS);
        if is_new {
            status_changed = Some((now, state));
            shared.publish_status(&recorder);
        }
        for camera in recorder.take_key_frame_requests() {
            shared.key_frame_needed[camera].store(true, Ordering::Relaxed);
        }
    }
    recorder.close_now("shutdown");
}

pub(in crate::run) fn send_request(
    shared: &Shared,
    request: Request,
    source: &'static str,
) -> Response {
    let failed = |message: &str| Response::Error {
        message: message.to_owned(),
    };
    let (reply, answer) = sync_channel(1);
    let limit = match request {
        Request::Stop => STOP_REQUEST_LIMIT,
        _ => REQUEST_LIMIT,
    };
    if shared
        .outbox
        .push_reserved(ToRecorder::Request(request, source, reply), 0)
        .is_err()
    {
        return failed("the daemon is ending");
    }
    answer
        .recv_timeout(limit)
        .unwrap_or_else(|_| failed("the recorder does not answer"))
}
