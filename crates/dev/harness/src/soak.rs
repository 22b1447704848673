//! Long recordings in virtual time, with memory monitoring.
//!
//! The calling process does the recording, so nothing else may run in it meanwhile.

#![expect(
    clippy::disallowed_methods,
    reason = "speed is measured with the machine's clock"
)]

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use capture_daemon::run::{StopFlag, record};
use capture_daemon::status::Progress;
use session_archive::time::{HostTime, NS_PER_S};
use session_archive::verify::{Report, verify};

use crate::contents;
use crate::rig::{Rig, in_virtual_time};

/// Memory of this process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// Current resident size, bytes.
    pub resident: u64,
    /// Peak resident size, bytes.
    pub peak: u64,
}

/// One measurement of the memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MemorySample {
    /// Time in the session, s.
    pub session_s: f64,
    /// Measured memory.
    pub memory: Memory,
}

/// Result of a long recording.
#[derive(Debug)]
pub struct SoakResult {
    /// The session's folder.
    pub session: PathBuf,
    /// One measurement per chunk.
    pub samples: Vec<MemorySample>,
    /// Wall-clock time, s.
    pub wall_s: f64,
    /// Report of the verification.
    pub report: Report,
}

/// Records `seconds` of `rig` in virtual time below `out`, and verifies the session.
///
/// # Errors
/// It cannot be recorded, or not without a failure.
pub fn soak(rig: &Rig, seconds: u32, out: &Path) -> Result<SoakResult> {
    let config = rig.config(out)?;
    let options = in_virtual_time(f64::from(seconds), out);
    let samples = Arc::new(Mutex::new(Vec::with_capacity(4 * seconds as usize + 16)));
    let seen = samples.clone();
    let mut began = HostTime(0);
    let watch = Box::new(move |progress| match progress {
        Progress::Started { at, .. } => began = at,
        Progress::Durable { until, .. } => {
            if let Ok(memory) = memory() {
                let session_s = until.since(began) as f64 / NS_PER_S as f64;
                let sample = MemorySample { session_s, memory };
                seen.lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .push(sample);
            }
        }
        _ => {}
    });
    let start = Instant::now();
    let finished = record(&config, &options, &StopFlag::new(), watch)?;
    let wall_s = start.elapsed().as_secs_f64();
    ensure!(
        finished.error.is_none(),
        "the recording failed: {finished:?}"
    );
    let report = verify(&contents::open(&finished.session)?, |_| {})?;
    let samples = std::mem::take(&mut *samples.lock().unwrap_or_else(PoisonError::into_inner));
    Ok(SoakResult {
        session: finished.session,
        samples,
        wall_s,
        report,
    })
}

impl SoakResult {
    /// Growth of the memory after `from_s` of the session, bytes: the larger of the growth of the
    /// resident size and of the peak between measurements.
    ///
    /// # Errors
    /// There is no measurement at or after that time.
    pub fn growth(&self, from_s: f64) -> Result<u64> {
        let at = self
            .samples
            .iter()
            .position(|sample| sample.session_s >= from_s);
        let later = &self.samples[at.context("the memory was not measured late enough")?..];
        let (base, last) = (later[0].memory, later[later.len() - 1].memory);
        let highest = later
            .iter()
            .map(|sample| sample.memory.resident)
            .max()
            .unwrap_or_default();
        Ok(highest
            .saturating_sub(base.resident)
            .max(last.peak.saturating_sub(base.peak)))
    }

    /// Checks that every sample of the rig is present and nothing is damaged.
    ///
    /// # Errors
    /// The first failed check.
    pub fn check_counts(&self, rig: &Rig, seconds: u32) -> Result<()> {
        ensure!(self.report.is_sound(), "not valid: {:?}", self.report);
        for (name, stream) in &self.report.streams {
            let rate = if name.ends_with("/imu") {
                rig.imu_rate_hz
            } else {
                rig.rate_hz
            };
            let expected = (rate * f64::from(seconds)).round() as u64;
            let found = (stream.first, stream.samples, stream.gaps);
            ensure!(
                found == (0, expected, 0),
                "{name}: first number, samples and missing are {found:?}, expected (0, {expected}, 0)"
            );
        }
        let (found, expected) = (self.report.streams.len(), 2 * rig.cameras);
        ensure!(found == expected, "{found} streams, expected {expected}");
        Ok(())
    }
}

/// Memory of this process, from `/proc/self/status` (proc_pid_status(5)).
///
/// # Errors
/// The file cannot be read or parsed.
pub fn memory() -> Result<Memory> {
    let text = std::fs::read_to_string("/proc/self/status")
        .context("reading the memory of this process")?;
    let field = |name: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(name));
        let kib = line.and_then(|line| line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok());
        kib.map(|kib| kib * 1024)
            .with_context(|| format!("no {name} in /proc/self/status"))
    };
    Ok(Memory {
        resident: field("VmRSS:")?,
        peak: field("VmHWM:")?,
    })
}
