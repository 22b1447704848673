//! Real time: a thread per source, one for the hub, one for the recorder.
//!
//! Between them are two queues bounded in bytes. When the inbox is full a frame is dropped before
//! the hub; when the outbox to the recorder is full, frames are dropped behind the encoder up to
//! the next key frame, which is requested until one is delivered. Both are reported with their
//! cause. IMU samples wait instead, and are gathered so that the hub is not woken for each. Hub,
//! recorder and the daemon's own loop sleep until something arrives or is due. When a source fails,
//! everything continues without it, with an alarm. When the loop of hub or recorder stalls for
//! [`WATCHDOG_NS`], the run ends with an error; the session is closed before, if the recorder still
//! can.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context as _, anyhow, bail};
use machine::ladder::Mitigations;
use session_archive::record::paws::gap::Cause;
use session_archive::time::{HostTime, NS_PER_S};

use super::build::{Built, build};
use super::crash_recovery;
use super::operator::Operator;
use super::page;
use super::store::FolderStore;
use super::{Finished, Outcome, RecordOptions, StopFlag, stop_reason};
use crate::announce::{self, FirstFrames};
use crate::clock::{Clock, RealClock};
use crate::config::{Config, DEFAULT_SOCKET};
use crate::control;
use crate::encode::RemainingFrames;
use crate::encoding::Encoding;
use crate::error_chain::with_causes;
use crate::hub::{Hub, Out, Outgoing, TICK_NS};
use crate::notify::Notify;
use crate::preview::{Newest, Previews};
use crate::queue::{Popped, Queue};
use crate::realtime_priority;
use crate::recorder::{OnProgress, Queues, RECOVERY, Recorder};
use crate::sources::{AnySource, RawFrame, Sample, Sink, Source, SourceError};
use crate::status::{Progress, Request, Response, State, Status};

/// Capacity of the queue of raw frames for the hub, bytes.
const INBOX_CAPACITY_BYTES: usize = 128 << 20;
/// Maximum number of frames in their cameras' own buffers in that queue, of all cameras together.
const MAX_NATIVE_FRAMES: usize = 6;
/// Capacity of the queue of encoded frames and IMU samples for the recorder, bytes.
const OUTBOX_CAPACITY_BYTES: usize = 64 << 20;
/// Maximum wait before a thread checks whether the end was requested, and the recorder whether a
/// session is closed.
const POLL_TIMEOUT: Duration = Duration::from_millis(20);
/// Delay between program start and start of replays, so that all of them are ready, ns.
const REPLAY_LEAD_NS: i64 = 200_000_000;
/// While nobody stores frames, one frame per this interval is previewed and checked, ns; the others
/// are only counted and timed.
const IDLE_PREVIEW_PERIOD_NS: i64 = NS_PER_S;
/// Maximum lag of a source behind its schedule, ns. With more it has to skip samples.
const MAX_LAG_NS: i64 = NS_PER_S / 2;
/// Maximum time between two iterations of a thread's loop, ns. With more it is stuck.
const WATCHDOG_NS: i64 = 10 * NS_PER_S;
/// Maximum time for closing a recording, ns. After it the recording is abandoned.
const CLOSE_LIMIT_NS: i64 = 4 * WATCHDOG_NS;
/// Maximum age of the published status, ns.
const STATUS_MAX_AGE_NS: i64 = 200_000_000;
/// Maximum time for a request.
const REQUEST_LIMIT: Duration = Duration::from_secs(5);
/// Maximum time for a stop: queued frames are encoded first (`recorder::MAX_STOP_NS`). Clients wait
/// longer ([`control::answer_limit`], the page), and so does systemd (`deploy/pawsd.service`).
const STOP_REQUEST_LIMIT: Duration = Duration::from_secs(30);

/// Item of the hub's queue.
enum HubInput {
    Sample(usize, Sample),
    /// Camera, device's number and arrival.
    Dropped(usize, u64, HostTime),
    /// A source delivers no more samples; with the reason, if it failed.
    Ended(usize, Option<String>),
}

/// Item of the recorder's queue.
enum ToRecorder {
    Item(Outgoing),
    Request(Request, &'static str, SyncSender<Response>),
}

/// State shared by all threads.
pub(super) struct Shared {
    clock: Arc<RealClock>,
    inbox: Queue<HubInput>,
    outbox: Queue<ToRecorder>,
    /// Set when everything has to end.
    ending: StopFlag,
    /// Time of the last loop iteration of hub and recorder, ns.
    hub_beat: AtomicI64,
    recorder_beat: AtomicI64,
    /// Cameras that need a key frame.
    key_frame_needed: Vec<AtomicBool>,
    /// Set when all sources have ended.
    all_ended: StopFlag,
    /// Last published status of the recorder, for threads that must not wait for it.
    latest: Mutex<Option<Arc<Status>>>,
    /// Notified when the status changes.
    status_changed: Condvar,
    /// Whether a session is open.
    recording: AtomicBool,
    /// Start of the open session.
    recording_since: AtomicI64,
    /// Whether frames are kept before a session begins.
    has_pre_roll: bool,
    /// Measures against overload of the machine that are in force.
    mitigations: Mutex<Mitigations>,
    /// Newest image of each camera.
    previews: Arc<Previews>,
    outcome: Outcome,
}

impl Shared {
    fn new(cameras: usize, outbox_bytes: usize, has_pre_roll: bool, outcome: Outcome) -> Self {
        let clock = Arc::new(RealClock);
        let now = clock.now().0;
        Self {
            clock,
            inbox: Queue::new(INBOX_CAPACITY_BYTES),
            outbox: Queue::new(outbox_bytes),
            ending: StopFlag::new(),
            hub_beat: AtomicI64::new(now),
            recorder_beat: AtomicI64::new(now),
            key_frame_needed: (0..cameras).map(|_| AtomicBool::new(false)).collect(),
            all_ended: StopFlag::new(),
            latest: Mutex::default(),
            status_changed: Condvar::new(),
            recording: AtomicBool::new(false),
            recording_since: AtomicI64::new(now),
            has_pre_roll,
            mitigations: Mutex::default(),
            previews: Arc::new(Previews::new(cameras)),
            outcome,
        }
    }

    /// Recent status of the recorder; `None` before its first iteration.
    pub(super) fn latest(&self) -> Option<Arc<Status>> {
        lock(&self.latest).clone()
    }

    pub(super) fn is_recording(&self) -> bool {
        self.recording.load(Ordering::SeqCst)
    }

    /// Once the recorder's thread runs, called by it alone.
    fn set_recording(&self, is_recording: bool) {
        if is_recording && !self.is_recording() {
            let now = self.clock.now().0;
            self.recording_since.store(now, Ordering::SeqCst);
        }
        self.recording.store(is_recording, Ordering::SeqCst);
    }

    /// Whether frames are stored neither now nor later.
    fn is_idle(&self) -> bool {
        !self.has_pre_roll && !self.is_recording()
    }

    pub(super) fn now(&self) -> HostTime {
        self.clock.now()
    }

    pub(super) fn preview(&self, camera: usize) -> Option<(u64, Newest)> {
        self.previews.newest(camera, self.clock.now())
    }

    /// Publishes the status of the recorder.
    fn publish_status(&self, recorder: &Recorder) {
        let is_recording = matches!(recorder.state(), State::Recording | State::Stopping);
        self.set_recording(is_recording);
        *lock(&self.mitigations) = recorder.mitigations();
        *lock(&self.latest) = Some(Arc::new(recorder.status()));
        self.status_changed.notify_all();
    }

    /// Waits up to `limit` for a status newer than `seen`.
    fn wait_for_status(&self, seen: Option<&Arc<Status>>, limit: Duration) {
        let is_seen = |latest: &mut Option<Arc<Status>>| match (latest, seen) {
            (Some(latest), Some(seen)) => Arc::ptr_eq(latest, seen),
            (latest, seen) => latest.is_none() && seen.is_none(),
        };
        let waited = self
            .status_changed
            .wait_timeout_while(lock(&self.latest), limit, is_seen);
        drop(waited);
    }

    fn beat(&self, which: &AtomicI64) {
        which.store(self.clock.now().0, Ordering::Relaxed);
    }
}

/// A running daemon.
pub(super) struct Running {
    pub(super) shared: Arc<Shared>,
    /// Name and nominal rate of each camera.
    pub(super) cameras: Vec<(String, f64)>,
    threads: Vec<JoinHandle<()>>,
}

impl Running {
    fn start(
        build: impl FnOnce(HostTime) -> anyhow::Result<Built>,
        out: std::path::PathBuf,
        record: Option<String>,
        mut on_progress: OnProgress,
        outcome: Outcome,
    ) -> anyhow::Result<Self> {
        let clock = Arc::new(RealClock);
        let mut built = build(clock.now())?;
        built.begin_at(clock.now() + REPLAY_LEAD_NS)?;
        let Built {
            sources,
            cameras,
            setup,
        } = built;
        let chunk_ns = setup.chunk_ns;
        let listed = cameras
            .iter()
            .map(|c| (c.name.clone(), c.rate_hz))
            .collect();
        let names: Vec<String> = cameras.iter().map(|c| c.name.clone()).collect();
        let shared = Arc::new(Shared::new(
            cameras.len(),
            OUTBOX_CAPACITY_BYTES,
            setup.pre_roll_ns > 0,
            outcome,
        ));
        // The pre-roll is written within one request, chunk by chunk.
        let of_progress = shared.clone();
        let on_progress: OnProgress = Box::new(move |progress| {
            of_progress.beat(&of_progress.recorder_beat);
            on_progress(progress);
        });
        let queued = shared.clone();
        let encoding = Encoding::new(cameras.len());
        let queues = Queues {
            bytes: Box::new(move || queued.outbox.bytes() as u64),
            encoding: encoding.clone(),
        };
        let store = FolderStore::random(out, setup.reserve_bytes);
        let mut recorder = Recorder::new(setup, clock, Box::new(store), queues, on_progress);
        if let Some(name) = record {
            shared.set_recording(true);
            recorder.start(&name, "control").map_err(|e| anyhow!(e))?;
        }
        let out = to_recorder(shared.clone(), names.clone());
        let mut hub = Hub::new(cameras, chunk_ns, false, &encoding, &out);
        hub.show(shared.previews.clone());
        let mut threads = Vec::new();
        let count = sources.len();
        for (i, source) in sources.into_iter().enumerate() {
            let shared = shared.clone();
            threads.push(spawn(&format!("source-{}", names[i]), move || {
                pump(i, source, &shared)
            })?);
        }
        let of_hub = shared.clone();
        threads.push(spawn("hub", move || run_hub(hub, count, &of_hub))?);
        let of_recorder = shared.clone();
        threads.push(spawn("recorder", move || {
            run_recorder(recorder, &of_recorder)
        })?);
        Ok(Self {
            shared,
            cameras: listed,
            threads,
        })
    }

    /// A daemon without threads.
    #[cfg(test)]
    pub(super) fn idle() -> Self {
        Self {
            shared: Arc::new(Shared::new(
                0,
                OUTBOX_CAPACITY_BYTES,
                false,
                Outcome::default(),
            )),
            cameras: Vec::new(),
            threads: Vec::new(),
        }
    }

    fn names(&self) -> Vec<String> {
        self.cameras.iter().map(|(name, _)| name.clone()).collect()
    }

    fn request(&self, request: Request, source: &'static str) -> Response {
        send_request(&self.shared, request, source)
    }

    /// Ends all threads; an open session is closed.
    fn end(self) {
        self.shared.ending.set();
        self.shared.inbox.close();
        for thread in self.threads {
            let _ = thread.join();
        }
    }

    /// Name of a thread whose loop has stalled, if there is one.
    fn stalled_thread(&self) -> Option<&'static str> {
        let now = self.shared.clock.now();
        let late = |beat: &AtomicI64| now.0 - beat.load(Ordering::Relaxed) > WATCHDOG_NS;
        // A stuck recorder makes the hub wait, and not vice versa.
        if late(&self.shared.recorder_beat) {
            Some("recorder")
        } else if late(&self.shared.hub_beat) {
            Some("hub")
        } else {
            None
        }
    }

    /// Checks that all threads make progress. If not, the session is closed first, if the recorder
    /// can.
    fn check(&self) -> anyhow::Result<()> {
        let Some(thread) = self.stalled_thread() else {
            return Ok(());
        };
        if thread != "recorder" {
            self.request(Request::Stop, "failure: the program is stuck");
        }
        bail!(
            "the thread {thread} has been stuck for {} s",
            WATCHDOG_NS / NS_PER_S
        )
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn spawn(name: &str, run: impl FnOnce() + Send + 'static) -> anyhow::Result<JoinHandle<()>> {
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(run)
        .with_context(|| format!("starting the thread {name}"))
}

pub(super) fn send_request(shared: &Shared, request: Request, source: &'static str) -> Response {
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

/// Thread of a source: passes everything to the hub.
fn pump(i: usize, source: AnySource, shared: &Shared) {
    let hub_sink = HubSink {
        source: i,
        shared,
        shown: AtomicI64::new(i64::MIN),
    };
    let ended = match source {
        AnySource::Scheduled(source) => replay(source, &hub_sink),
        AnySource::Live(source) => {
            realtime_priority::this_thread();
            source.run(&hub_sink)
        }
    };
    let failure = ended.err().map(|error| with_causes(&error));
    let _ = shared.inbox.push_reserved(HubInput::Ended(i, failure), 0);
}

/// Waits for the arrival time of each sample.
fn replay(mut source: Box<dyn Source>, hub_sink: &HubSink<'_>) -> Result<(), SourceError> {
    loop {
        source.set_pixels_needed(hub_sink.pixels_needed());
        let Some(sample) = source.next_sample()? else {
            break;
        };
        if !wait_until(sample.host_time(), hub_sink.shared) {
            break;
        }
        let now = hub_sink.now();
        let is_behind = now.since(sample.host_time()) > MAX_LAG_NS;
        hub_sink.put(sample);
        if is_behind {
            // They follow it in the order of their numbers.
            for lost in source.skip_overdue(now) {
                hub_sink.put(Sample::Dropped(lost));
            }
        }
    }
    Ok(())
}

/// Sink of one source's samples, into the hub's queue.
struct HubSink<'a> {
    source: usize,
    shared: &'a Shared,
    /// Time of the newest frame with pixels.
    shown: AtomicI64,
}

impl Sink for HubSink<'_> {
    fn now(&self) -> HostTime {
        self.shared.clock.now()
    }

    fn pixels_needed(&self) -> bool {
        let shown = self.shown.load(Ordering::Relaxed);
        !self.shared.is_idle() || self.now().0.saturating_sub(shown) >= IDLE_PREVIEW_PERIOD_NS
    }

    fn put(&self, sample: Sample) {
        if matches!(sample, Sample::Frame(_) | Sample::Native(_)) {
            self.shown.store(self.now().0, Ordering::Relaxed);
        }
        let (i, inbox) = (self.source, &self.shared.inbox);
        // Cameras lend few of their own buffers, so the number of waiting ones is limited, however
        // small they are.
        let bytes = match &sample {
            Sample::Native(_) => sample.bytes().max(INBOX_CAPACITY_BYTES / MAX_NATIVE_FRAMES),
            _ => sample.bytes(),
        };
        // A push is rejected only at the end.
        let _ = match &sample {
            Sample::Frame(RawFrame {
                number, host_time, ..
            })
            | Sample::Native(RawFrame {
                number, host_time, ..
            }) => {
                let dropped = HubInput::Dropped(i, *number, *host_time);
                inbox
                    .try_push(HubInput::Sample(i, sample), bytes)
                    .or_else(|_| inbox.push_reserved(dropped, 0))
            }
            // Their times are already taken, and the hub gathers them anyway.
            Sample::Imu(_) | Sample::Arrival(_) => {
                inbox.push_gathered(HubInput::Sample(i, sample), bytes)
            }
            _ => inbox.push_reserved(HubInput::Sample(i, sample), bytes),
        };
    }

    fn is_ending(&self) -> bool {
        self.shared.ending.is_set()
    }
}

/// Sleeps until a time; false if the end came first.
fn wait_until(time: HostTime, shared: &Shared) -> bool {
    loop {
        let left = time - shared.clock.now();
        if shared.ending.is_set() {
            return false;
        }
        if left <= 0 {
            return true;
        }
        #[expect(
            clippy::disallowed_methods,
            reason = "this is the clock of the replayed devices"
        )]
        std::thread::sleep(Duration::from_nanos(left as u64).min(POLL_TIMEOUT));
    }
}

/// Time from `now` until `then`; zero if it has passed.
fn span(now: HostTime, then: HostTime) -> Duration {
    Duration::from_nanos(then.since(now).max(0) as u64)
}

fn run_hub(mut hub: Hub, sources: usize, shared: &Shared) {
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
            Popped::Item(HubInput::Sample(i, sample)) => hub.sample(i, sample, now),
            Popped::Item(HubInput::Dropped(i, number, at)) => hub.dropped(i, number, at, now),
            Popped::Item(HubInput::Ended(i, failure)) => {
                if let Some(error) = failure {
                    hub.source_failed(i, &error, now);
                    shared.outcome.source_failed(error);
                }
                running -= 1;
                draining = running == 0;
            }
            Popped::Nothing => {}
            Popped::Closed => break,
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
fn to_recorder(shared: Arc<Shared>, names: Vec<String>) -> Out {
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

fn run_recorder(mut recorder: Recorder, shared: &Shared) {
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
            Popped::Item(ToRecorder::Item(item)) => recorder.handle(item),
            Popped::Item(ToRecorder::Request(request, source, reply)) => {
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
            Popped::Nothing => {}
            Popped::Closed => break,
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

pub(super) fn record(
    build: impl FnOnce(HostTime) -> anyhow::Result<Built>,
    options: &RecordOptions,
    stop: &StopFlag,
    on_progress: OnProgress,
) -> anyhow::Result<Finished> {
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

/// Runs the daemon until `stop` is set: armed, answering on the control socket, reporting to
/// systemd.
///
/// # Errors
/// The configuration cannot be applied, or a thread is stuck.
pub fn daemon(config: &Config, stop: &StopFlag) -> anyhow::Result<()> {
    let out =
        config.session.out.clone().ok_or_else(|| {
            anyhow!("the configuration has no [session] out: where do sessions go?")
        })?;
    std::fs::create_dir_all(&out)
        .with_context(|| format!("creating the folder for sessions {}", out.display()))?;
    let log_progress: OnProgress = Box::new(|progress| match progress {
        Progress::Started { session, notes, .. } => {
            log::info!("recording {}", session.display());
            notes
                .iter()
                .for_each(|publish_status| log::warn!("{publish_status}"));
        }
        Progress::Finished {
            session,
            reason,
            seconds,
            stored,
            missing,
            streams,
            ..
        } => {
            log::info!(
                "closed {} ({reason}): {seconds:.1} s, {stored} samples, {missing} missing",
                session.display()
            );
            for stream in streams.iter().filter(|s| s.missing > 0) {
                log::warn!("{stream}");
            }
        }
        Progress::Durable { .. } | Progress::Alarm { .. } => {}
    });
    let out_folder = out.clone();
    // Before the first press could begin a new one.
    let cut_off = crash_recovery::find(&out);
    let running = Running::start(
        |start| build(config, start),
        out,
        None,
        log_progress,
        Outcome::default(),
    )?;
    let of_control = running.shared.clone();
    let server = control::serve(&config.control.socket, move |request| {
        send_request(&of_control, request, "control")
    })
    .with_context(|| {
        format!(
            "opening the control socket {}",
            config.control.socket.display()
        )
    })?;
    let shared = running.shared.clone();
    let report = move |text: String| {
        let alarm = Outgoing::Alarm {
            at: shared.clock.now(),
            text,
            stream: RECOVERY.to_owned(),
            active: true,
        };
        let _ = shared.outbox.push_reserved(ToRecorder::Item(alarm), 0);
    };
    crash_recovery::close(out_folder.clone(), cut_off, report)
        .context("looking after earlier recordings")?;
    let operator = Operator::start(&config.operator, &running.shared)?;
    let mut page = page::PageSupervisor::new(config.page.as_ref(), &out_folder);
    page.supervise(&running);
    realtime_priority::lock_memory();
    let notify = Notify::from_env();
    notify.ready();
    let shared = running.shared.clone();
    let mut first_frames = FirstFrames::wait(running.names());
    let mut is_armed = false;
    // Twice as often as required, because the loop sleeps between its iterations.
    let watchdog_ns = notify
        .watchdog_interval()
        .map_or(NS_PER_S, |interval| interval.as_nanos() as i64 / 2)
        .min(NS_PER_S);
    let mut next_status = shared.clock.now();
    let mut next_watchdog = next_status;
    let result = loop {
        if stop.is_set() {
            break Ok(());
        }
        if let Err(stalled_thread) = running.check() {
            break Err(stalled_thread);
        }
        let now = shared.clock.now();
        let seen = shared.latest();
        if let Some(status) = &seen {
            first_frames.update(status);
            if status.state == State::Armed && !is_armed {
                is_armed = true;
                announce::step(armed(config));
            }
        }
        operator.show();
        page.supervise(&running);
        if now >= next_status {
            next_status = now + NS_PER_S;
            if let Some(status) = &seen {
                notify.status(&format!("{}, {:.0} s", status.state, status.seconds));
            }
        }
        if now >= next_watchdog {
            next_watchdog = now + watchdog_ns;
            notify.watchdog();
        }
        // It is published five times a second while the recorder runs, so the end is detected soon.
        let due = next_status.min(next_watchdog);
        shared.wait_for_status(seen.as_ref(), span(now, due));
    };
    notify.stopping();
    drop(page);
    drop(operator);
    drop(server);
    if result.is_ok() {
        stop_under_watchdog(running, &notify, Duration::from_nanos(watchdog_ns as u64))?;
    }
    result
}

/// Closes the open recording and ends all threads, and notifies the watchdog meanwhile.
fn stop_under_watchdog(
    running: Running,
    notify: &Notify,
    interval: Duration,
) -> anyhow::Result<()> {
    let (done, is_done) = sync_channel::<()>(0);
    let stopping = spawn("stop", move || {
        running.request(Request::Stop, "signal");
        running.end();
        drop(done);
    })?;
    while is_done.recv_timeout(interval) == Err(RecvTimeoutError::Timeout) {
        notify.watchdog();
    }
    let _ = stopping.join();
    Ok(())
}

/// Instruction for the operator once all cameras and IMUs deliver.
fn armed(config: &Config) -> String {
    let button = match config.operator.buttons.is_empty() {
        true => "",
        false => "the button or ",
    };
    let socket = match &config.control.socket {
        usual if usual == Path::new(DEFAULT_SOCKET) => String::new(),
        other => format!(" --socket {}", other.display()),
    };
    format!("armed: everything delivers; start with {button}`pawsd start{socket}`")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use bytes::Bytes;
    use session_archive::record::Frame;
    use session_archive::time::TickLength;
    use video::encoder::Preset;
    use video::{EncoderSettings, Picture, PixelFormat};

    use super::*;
    use crate::hub::{CameraSetup, FINISH_LIMIT};
    use crate::recorder::MAX_STOP_NS;
    use crate::sync::clock::ClockConfig;

    /// A status published before the wait is not missed, and the status already seen does not end
    /// the wait.
    #[test]
    fn status_change_ends_the_wait() {
        const LONG: Duration = Duration::from_secs(3600);
        const STATUS: &str =
            r#"{"state": "idle", "seconds": 0, "streams": [], "alarms": [], "encoders": []}"#;
        let status = || Arc::new(serde_json::from_str(STATUS).expect("a status"));
        let shared = Arc::new(Shared::new(0, 0, false, Outcome::default()));
        shared.wait_for_status(None, Duration::from_millis(1));
        *lock(&shared.latest) = Some(status());
        shared.wait_for_status(None, LONG);
        let seen = shared.latest();
        shared.wait_for_status(seen.as_ref(), Duration::from_millis(1));
        let waiting = {
            let shared = shared.clone();
            std::thread::spawn(move || shared.wait_for_status(seen.as_ref(), LONG))
        };
        *lock(&shared.latest) = Some(status());
        shared.status_changed.notify_all();
        waiting.join().expect("it ends");
    }

    /// Otherwise a stop on a slow machine would be reported as a failure, or killed, while it is in
    /// progress.
    #[test]
    fn stop_clients_wait_longer_than_a_stop_takes() {
        let recorder = Duration::from_nanos(MAX_STOP_NS as u64);
        let client = control::answer_limit(&Request::Stop);
        assert!(recorder < STOP_REQUEST_LIMIT && STOP_REQUEST_LIMIT < client);
        assert!(REQUEST_LIMIT < control::answer_limit(&Request::Status));
        let number = |text: &str, before: &str, unit: Duration| {
            let (_, number) = text.split_once(before).expect(before);
            let number: String = number.chars().take_while(char::is_ascii_digit).collect();
            unit * number.parse::<u32>().expect("a number")
        };
        let unit = include_str!("../../../deploy/pawsd.service");
        let second = Duration::from_secs(1);
        assert!(STOP_REQUEST_LIMIT < number(unit, "\nTimeoutStopSec=", second));
        let page = include_str!("../../../crates/devices/rig-link/src/page/app.js");
        let page = number(page, "const ACT_LIMIT = ", Duration::from_millis(1));
        assert!(STOP_REQUEST_LIMIT < page);
    }

    /// Otherwise the end of a replay on a slow machine would be taken for a stuck thread.
    #[test]
    fn hub_loop_keeps_running_while_the_last_frames_are_encoded() {
        const { assert!(FINISH_LIMIT.as_nanos() < WATCHDOG_NS as u128) };
        let shared = Arc::new(Shared::new(
            1,
            OUTBOX_CAPACITY_BYTES,
            false,
            Outcome::default(),
        ));
        shared.set_recording(true);
        // Number of each delivered or reported frame, and time of the hub's last loop iteration.
        let reported: Arc<Mutex<Vec<(u64, i64)>>> = Arc::default();
        let (into, of_hub) = (reported.clone(), shared.clone());
        let out: Out = Arc::new(move |item| {
            let number = match item {
                Outgoing::Frame { frame, .. } => frame.number,
                Outgoing::Dropped { first, .. } => first,
                _ => return,
            };
            let beat = of_hub.hub_beat.load(Ordering::Relaxed);
            lock(&into).push((number, beat));
        });
        let (width, height) = (1344, 376);
        let setup = CameraSetup {
            name: "feet".to_owned(),
            trigger: None,
            rate_hz: 15.0,
            clock: ClockConfig::new(TickLength::NANOSECOND),
            number_bits: None,
            still: true,
            stamped: None,
            encoder: EncoderSettings {
                element: "x264enc".to_owned(),
                width,
                height,
                rate_hz: 15.0,
                quality_db: 40.0,
                threads: 1,
                max_key_interval_frames: 30,
                preset: Preset::default(),
            },
            imu: None,
        };
        let encoding = Encoding::new(1);
        let mut hub = Hub::new(vec![setup], NS_PER_S, false, &encoding, &out);
        let bytes = PixelFormat::I420.bytes(width, height).expect("even");
        // Noise: encoding a frame takes much longer than pushing it.
        let noise = |mut state: u64| {
            let mut next = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005);
                state = state.wrapping_add(1_442_695_040_888_963_407);
                (state >> 56) as u8
            };
            let data: Vec<u8> = (0..bytes).map(|_| next()).collect();
            Picture::new(width, height, PixelFormat::I420, data).expect("an image")
        };
        let images = [noise(1), noise(2)];
        // Many more than fit into an encoder.
        for number in 0..24 {
            let now = shared.now();
            let frame = RawFrame {
                number,
                device_ticks: now.0,
                kernel_time: None,
                host_time: now,
                exposure_ns: None,
                eyes_apart_ns: None,
                image: images[number as usize % 2].clone(),
            };
            hub.sample(0, Sample::Frame(frame), now);
        }
        let _ = shared.inbox.push_reserved(HubInput::Ended(0, None), 0);
        let of_hub = shared.clone();
        let hub = std::thread::spawn(move || run_hub(hub, 1, &of_hub));
        while !shared.all_ended.is_set() {
            wait_until(shared.now() + POLL_TIMEOUT.as_nanos() as i64, &shared);
        }
        shared.inbox.close();
        hub.join().expect("the hub");
        assert!(!encoding.is_busy(0));
        let mut reported = lock(&reported).clone();
        reported.sort_unstable();
        assert!(reported.iter().map(|(number, _)| *number).eq(0..24));
        let beats: BTreeSet<i64> = reported.iter().map(|(_, beat)| *beat).collect();
        assert!(beats.len() > 3, "{beats:?}");
    }

    /// A full outbox also rejects the requested key frame: then the next frame must be one.
    #[test]
    fn key_frame_is_requested_until_one_is_delivered() {
        let shared = Arc::new(Shared::new(1, 1000, false, Outcome::default()));
        let out = to_recorder(shared.clone(), vec!["feet".to_owned()]);
        let frame = |number, key| {
            out(Outgoing::Frame {
                camera: 0,
                frame: Frame {
                    number,
                    ..Frame::default()
                },
                unit: Bytes::from(vec![0; 500]),
                key,
            });
            shared.key_frame_needed[0].swap(false, Ordering::Relaxed)
        };
        assert!(!frame(0, true), "there is room");
        assert!(frame(1, false));
        assert!(!frame(2, false), "it was requested");
        assert!(frame(3, true), "it did not fit");
        while let Popped::Item(_) = shared.outbox.pop(Duration::ZERO) {}
        assert!(!frame(4, false), "no reference frame, and requested");
        assert!(!frame(5, true));
        let mut numbers = Vec::new();
        while let Popped::Item(item) = shared.outbox.pop(Duration::ZERO) {
            match item {
                ToRecorder::Item(Outgoing::Frame { frame, .. }) => numbers.push(Ok(frame.number)),
                ToRecorder::Item(Outgoing::Dropped { first, .. }) => numbers.push(Err(first)),
                _ => {}
            }
        }
        assert_eq!(numbers, [Err(4), Ok(5)]);
    }
}
