//! Assembly of the parts: in real time on threads, or in virtual time in a loop.

use anyhow::Context as _;
use session_archive::time::HostTime;

use crate::config::Config;
use crate::recorder::OnProgress;

mod build;
mod claim;
mod crash_recovery;
mod identity;
mod machine_monitor;
mod operator;
mod outcome;
mod page;
mod real_time;
mod store;
mod virtual_time;

pub(crate) use build::choose_encoder;
pub use build::{RunParts, build};
pub use outcome::{RecordOptions, RecordingSummary, StopFlag};
pub use page::fingerprint;
pub use real_time::daemon;
pub use store::FolderStore;

/// Records one session: starts immediately, ends after the given time or when `stop` is set.
///
/// # Errors
/// The configuration cannot be applied, or no session could be created. A session that was ended by
/// a failure, or continued without a source that failed, is not an error: see
/// [`RecordingSummary::error`].
pub fn record(
    config: &Config,
    options: &RecordOptions,
    stop: &StopFlag,
    on_progress: OnProgress,
) -> anyhow::Result<RecordingSummary> {
    let build = |start| build::build(config, start);
    record_built(build, options, stop, on_progress)
}

/// As [`record`], with the caller's sources and setups: `build` takes the time at which scheduled
/// sources are to begin.
///
/// # Errors
/// As for [`record`].
pub fn record_built(
    build: impl FnOnce(HostTime) -> anyhow::Result<RunParts>,
    options: &RecordOptions,
    stop: &StopFlag,
    on_progress: OnProgress,
) -> anyhow::Result<RecordingSummary> {
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
