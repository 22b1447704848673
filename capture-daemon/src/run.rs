//! Putting the parts together: in real time on threads, or in virtual time in a loop.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::{Context as _, anyhow};
use session_archive::time::HostTime;

use crate::config::Config;
use crate::recorder::OnProgress;
use crate::status::Progress;

mod build;
mod claim;
mod crash_recovery;
pub(crate) mod identity;
mod machine_monitor;
mod operator;
mod page;
mod real_time;
mod store;
mod virtual_time;

pub(crate) use build::choose_encoder;
pub use build::{Built, build};
pub use page::fingerprint;
pub use real_time::daemon;
pub use store::FolderStore;

/// Asks a run to end; clones ask the same run.
#[derive(Clone, Debug, Default)]
pub struct StopFlag(Arc<AtomicBool>);

impl StopFlag {
    /// A flag that is not set.
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks to end.
    pub fn set(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Whether the end was asked for.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// What to record.
#[derive(Clone, Debug)]
pub struct RecordOptions {
    /// Length of the session; it also ends when all sources have ended.
    pub seconds: f64,
    /// As fast as the machine can, dropping nothing: the same input gives the same bytes.
    pub virtual_time: bool,
    /// Name of the session.
    pub name: String,
    /// Folder in which the session's folder is made.
    pub out: PathBuf,
}

/// What came of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Finished {
    /// The session's folder.
    pub session: PathBuf,
    /// Samples stored, all streams.
    pub stored: u64,
    /// Samples missing, all streams; each is accounted for in a gap record.
    pub missing: u64,
    /// Streams of which nothing came at all.
    pub absent: Vec<String>,
    /// What failed, if the session was ended by a failure or a source failed during it.
    pub error: Option<String>,
}

/// How a recording ends: what its last progress says, and the first source that failed during it.
#[derive(Clone, Default)]
struct Outcome(Arc<Mutex<(Option<Finished>, Option<String>)>>);

impl Outcome {
    /// A source has failed: the recording goes on without it, and ends as failed.
    fn source_failed(&self, error: String) {
        self.lock().1.get_or_insert(error);
    }

    /// Hands progress on and keeps the last of it.
    fn watch(&self, mut on_progress: OnProgress) -> OnProgress {
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
                outcome.0 = Some(Finished {
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

    fn is_finished(&self) -> bool {
        self.lock().0.is_some()
    }

    fn take(&self) -> anyhow::Result<Finished> {
        let finished = self.lock().0.take();
        finished.ok_or_else(|| anyhow!("the recording ended without a session"))
    }

    fn lock(&self) -> MutexGuard<'_, (Option<Finished>, Option<String>)> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Why a recording is stopped when nothing failed.
fn stop_reason(stop: &StopFlag, all_ended: bool) -> &'static str {
    match (stop.is_set(), all_ended) {
        (true, _) => "signal",
        (false, true) => "sources ended",
        (false, false) => "duration",
    }
}

/// Records one session: starts at once, ends after the time given or when `stop` is set.
///
/// # Errors
/// The configuration cannot be put to work, or no session could be created. A session that was
/// ended by a failure, or went on without a source that failed, is not an error: see
/// [`Finished::error`].
pub fn record(
    config: &Config,
    options: &RecordOptions,
    stop: &StopFlag,
    on_progress: OnProgress,
) -> anyhow::Result<Finished> {
    let build = |start| build::build(config, start);
    record_built(build, options, stop, on_progress)
}

/// As [`record`], with sources and set-ups of the caller's: `build` is given the time at which
/// scheduled sources are to begin.
///
/// # Errors
/// As for [`record`].
pub fn record_built(
    build: impl FnOnce(HostTime) -> anyhow::Result<Built>,
    options: &RecordOptions,
    stop: &StopFlag,
    on_progress: OnProgress,
) -> anyhow::Result<Finished> {
    std::fs::create_dir_all(&options.out)
        .with_context(|| format!("creating the folder for sessions {}", options.out.display()))?;
    if options.virtual_time {
        virtual_time::record(build, options, stop, on_progress)
    } else {
        real_time::record(build, options, stop, on_progress)
    }
}

#[cfg(test)]
mod tests;
