//! What a run is to do, when it ends, and what came of it.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::anyhow;

use crate::recorder::OnProgress;
use crate::status::Progress;

/// Request to end a run; clones share the flag.
#[derive(Clone, Debug, Default)]
pub struct StopFlag(Arc<AtomicBool>);

impl StopFlag {
    /// A flag that is not set.
    pub fn new() -> Self {
        Self::default()
    }

    /// Requests the end.
    pub fn set(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Whether the end was requested.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// Parameters of a recording.
#[derive(Clone, Debug)]
pub struct RecordOptions {
    /// Length of the session; it also ends when all sources have ended.
    pub seconds: f64,
    /// As fast as the machine can, without drops: the same input gives the same bytes.
    pub virtual_time: bool,
    /// Name of the session.
    pub name: String,
    /// Folder in which the session's folder is created.
    pub out: PathBuf,
}

/// Result of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordingSummary {
    /// The session's folder.
    pub session: PathBuf,
    /// Samples stored, all streams.
    pub stored: u64,
    /// Samples missing, all streams; each is accounted for in a gap record.
    pub missing: u64,
    /// Streams without any sample.
    pub absent: Vec<String>,
    /// The failure, if the session was ended by one or a source failed during it.
    pub error: Option<String>,
}

/// Result of a recording: its last progress, and the first source that failed during it.
#[derive(Clone, Default)]
pub(super) struct Outcome(Arc<Mutex<(Option<RecordingSummary>, Option<String>)>>);

impl Outcome {
    /// Stores the failure of a source: the recording continues without it, and ends as failed.
    pub(super) fn source_failed(&self, error: String) {
        self.lock().1.get_or_insert(error);
    }

    /// Forwards progress and stores the last of it.
    pub(super) fn watch(&self, mut on_progress: OnProgress) -> OnProgress {
        let outcome = self.clone();
        Box::new(move |mut progress| {
            if let Progress::Finished {
                session,
                stored,
                missing,
                absent,
                error,
                ..
            } = &mut progress
            {
                let mut outcome = outcome.lock();
                if error.is_none() {
                    error.clone_from(&outcome.1);
                }
                outcome.0 = Some(RecordingSummary {
                    session: session.clone(),
                    stored: *stored,
                    missing: *missing,
                    absent: absent.clone(),
                    error: error.clone(),
                });
            }
            on_progress(progress);
        })
    }

    pub(super) fn is_finished(&self) -> bool {
        self.lock().0.is_some()
    }

    pub(super) fn take(&self) -> anyhow::Result<RecordingSummary> {
        let finished = self.lock().0.take();
        finished.ok_or_else(|| anyhow!("the recording ended without a session"))
    }

    fn lock(&self) -> MutexGuard<'_, (Option<RecordingSummary>, Option<String>)> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Reason for the stop of a recording without failures.
pub(super) fn stop_reason(stop: &StopFlag, all_ended: bool) -> &'static str {
    match (stop.is_set(), all_ended) {
        (true, _) => "signal",
        (false, true) => "sources ended",
        (false, false) => "duration",
    }
}
