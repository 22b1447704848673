//! A recording in a process of its own, so that its processor time is known: this program, started
//! again with [`RECORD`], which calls what `pawsd record` calls.

use anyhow::{Context, Result, bail, ensure};
use capture_daemon::config::Config;
use capture_daemon::run::{self, RecordOptions, StopFlag};

/// First argument of the process, after the benchmark's name, followed by configuration, folder and
/// seconds.
pub(crate) const RECORD: &str = "--record";

/// Work of the process.
///
/// # Errors
/// Bad arguments, or the recording fails.
pub(crate) fn record(arguments: &[String]) -> Result<()> {
    let [config, out, seconds] = arguments else {
        bail!("{RECORD} takes a configuration, a folder and seconds");
    };
    let options = RecordOptions {
        seconds: seconds.parse().context("reading the seconds")?,
        virtual_time: false,
        name: String::new(),
        out: out.into(),
    };
    let config = Config::read(config.as_ref())?;
    let finished = run::record(&config, &options, &StopFlag::new(), Box::new(|_| {}))?;
    ensure!(
        finished.error.is_none(),
        "the recording failed: {:?}",
        finished.error
    );
    Ok(())
}
