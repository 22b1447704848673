//! State shared by the threads, and the items of their queues.

use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use machine::ladder::Mitigations;
use session_archive::time::HostTime;

use crate::clock::{Clock as _, RealClock};
use crate::hub::Outgoing;
use crate::preview::{Newest, Previews};
use crate::queue::Queue;
use crate::recorder::Recorder;
use crate::run::outcome::{Outcome, StopFlag};
use crate::sources::Sample;
use crate::status::{Request, Response, State, Status};

/// Capacity of the queue of raw frames for the hub, bytes.
pub(super) const INBOX_CAPACITY_BYTES: usize = 128 << 20;

/// Item of the hub's queue.
pub(super) enum HubInput {
    Sample(usize, Sample),
    /// Camera, device's number and arrival.
    Dropped(usize, u64, HostTime),
    /// A source delivers no more samples; with the reason, if it failed.
    Ended(usize, Option<String>),
}

/// Item of the recorder's queue.
pub(super) enum ToRecorder {
    Item(Outgoing),
    Request(Request, &'static str, SyncSender<Response>),
}

/// State shared by all threads.
pub(in crate::run) struct Shared {
    pub(super) clock: Arc<RealClock>,
    pub(super) inbox: Queue<HubInput>,
    pub(super) outbox: Queue<ToRecorder>,
    /// Set when everything has to end.
    pub(super) ending: StopFlag,
    /// Time of the last loop iteration of hub and recorder, ns.
    pub(super) hub_beat: AtomicI64,
    pub(super) recorder_beat: AtomicI64,
    /// Cameras that need a key frame.
    pub(super) key_frame_needed: Vec<AtomicBool>,
    /// Set when all sources have ended.
    pub(super) all_ended: StopFlag,
    /// Last published status of the recorder, for threads that must not wait for it.
    pub(super) latest: Mutex<Option<Arc<Status>>>,
    /// Notified when the status changes.
    pub(super) status_changed: Condvar,
    /// Whether a session is open.
    pub(super) recording: AtomicBool,
    /// Start of the open session.
    pub(super) recording_since: AtomicI64,
    /// Whether frames are kept before a session begins.
    pub(super) has_pre_roll: bool,
    /// Measures against overload of the machine that are in force.
    pub(super) mitigations: Mutex<Mitigations>,
    /// Newest image of each camera.
    pub(super) previews: Arc<Previews>,
    pub(super) outcome: Outcome,
}

impl Shared {
    pub(super) fn new(
        cameras: usize,
        outbox_bytes: usize,
        has_pre_roll: bool,
        outcome: Outcome,
    ) -> Self {
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
    pub(in crate::run) fn latest(&self) -> Option<Arc<Status>> {
        lock(&self.latest).clone()
    }

    pub(in crate::run) fn is_recording(&self) -> bool {
        self.recording.load(Ordering::SeqCst)
    }

    /// Once the recorder's thread runs, called by it alone.
    pub(super) fn set_recording(&self, is_recording: bool) {
        if is_recording && !self.is_recording() {
            let now = self.clock.now().0;
            self.recording_since.store(now, Ordering::SeqCst);
        }
        self.recording.store(is_recording, Ordering::SeqCst);
    }

    /// Whether frames are stored neither now nor later.
    pub(super) fn is_idle(&self) -> bool {
        !self.has_pre_roll && !self.is_recording()
    }

    pub(in crate::run) fn now(&self) -> HostTime {
        self.clock.now()
    }

    pub(in crate::run) fn preview(&self, camera: usize) -> Option<(u64, Newest)> {
        self.previews.newest(camera, self.clock.now())
    }

    /// Publishes the status of the recorder.
    pub(super) fn publish_status(&self, recorder: &Recorder) {
        let is_recording = matches!(recorder.state(), State::Recording | State::Stopping);
        self.set_recording(is_recording);
        *lock(&self.mitigations) = recorder.mitigations();
        *lock(&self.latest) = Some(Arc::new(recorder.status()));
        self.status_changed.notify_all();
    }

    /// Waits up to `limit` for a status newer than `seen`; false if none was published.
    pub(super) fn wait_for_status(&self, seen: Option<&Arc<Status>>, limit: Duration) -> bool {
        let is_seen = |latest: &mut Option<Arc<Status>>| match (latest, seen) {
            (Some(latest), Some(seen)) => Arc::ptr_eq(latest, seen),
            (latest, seen) => latest.is_none() && seen.is_none(),
        };
        let waited = self
            .status_changed
            .wait_timeout_while(lock(&self.latest), limit, is_seen);
        let (_latest, waited) = waited.unwrap_or_else(PoisonError::into_inner);
        !waited.timed_out()
    }

    pub(super) fn beat(&self, which: &AtomicI64) {
        which.store(self.clock.now().0, Ordering::Relaxed);
    }
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
