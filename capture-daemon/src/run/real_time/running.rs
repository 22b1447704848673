//! The threads of a run: started together, watched, ended together.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::thread::JoinHandle;

use anyhow::{Context as _, anyhow, bail};
use session_archive::time::{HostTime, NS_PER_S};

use super::hub_thread::{run_hub, to_recorder};
use super::recorder_thread::{run_recorder, send_request};
use super::shared::Shared;
use super::source_thread::pump;
use crate::clock::{Clock as _, RealClock};
use crate::encoding::Encoding;
use crate::hub::Hub;
use crate::recorder::{OnProgress, Queues, Recorder};
use crate::run::build::RunParts;
use crate::run::outcome::Outcome;
use crate::run::store::FolderStore;
use crate::status::{Request, Response};

/// Capacity of the queue of encoded frames and IMU samples for the recorder, bytes.
pub(super) const OUTBOX_CAPACITY_BYTES: usize = 64 << 20;
/// Delay between program start and start of replays, so that all of them are ready, ns.
pub(super) const REPLAY_LEAD_NS: i64 = 200_000_000;
/// Maximum time between two iterations of a thread's loop, ns. With more it is stuck.
pub(super) const WATCHDOG_NS: i64 = 10 * NS_PER_S;

/// A running daemon.
pub(in crate::run) struct Running {
    pub(in crate::run) shared: Arc<Shared>,
    /// Name and nominal rate of each camera.
    pub(in crate::run) cameras: Vec<(String, f64)>,
    pub(super) threads: Vec<JoinHandle<()>>,
}

impl Running {
    pub(super) fn start(
        build: impl FnOnce(HostTime) -> anyhow::Result<RunParts>,
        out: PathBuf,
        record: Option<String>,
        mut on_progress: OnProgress,
        outcome: Outcome,
    ) -> anyhow::Result<Self> {
        let clock = Arc::new(RealClock);
        let mut built = build(clock.now())?;
        built.begin_at(clock.now() + REPLAY_LEAD_NS)?;
        let RunParts {
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
    pub(in crate::run) fn idle() -> Self {
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

    pub(super) fn names(&self) -> Vec<String> {
        self.cameras.iter().map(|(name, _)| name.clone()).collect()
    }

    pub(super) fn request(&self, request: Request, source: &'static str) -> Response {
        send_request(&self.shared, request, source)
    }

    /// Ends all threads; an open session is closed.
    pub(super) fn end(self) {
        self.shared.ending.set();
        self.shared.inbox.close();
        for thread in self.threads {
            let _ = thread.join();
        }
    }

    /// Name of a thread whose loop has stalled, if there is one.
    pub(super) fn stalled_thread(&self) -> Option<&'static str> {
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
    pub(super) fn check(&self) -> anyhow::Result<()> {
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

pub(super) fn spawn(
    name: &str,
    run: impl FnOnce() + Send + 'static,
) -> anyhow::Result<JoinHandle<()>> {
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(run)
        .with_context(|| format!("starting the thread {name}"))
}
