//! Time to close a session's files: the last chunk, a summary and the manifest, all synced, after
//! sessions of different lengths. Time is virtual, the disk is real.

use std::path::Path;

use anyhow::{Context, Result};
use serde_json::{Value, json};
use session_archive::storage::DiskStorage;
use session_archive::writer::{DEFAULT_CHUNK_NS, SessionWriter};

use super::{Plan, STOP_LIMIT_S};
use crate::load::{self, CountingStorage, Destination};
use crate::meter::{median, timed};

/// Stopping after sessions of one length.
pub(super) struct Stopping {
    pub(super) session_s: f64,
    /// One for each session, s.
    pub(super) stops_s: Vec<f64>,
    segments: usize,
    frames: u64,
}

impl Stopping {
    pub(super) fn median_s(&self) -> f64 {
        median(self.stops_s.iter().copied())
    }

    pub(super) fn json(&self) -> Value {
        json!({
            "session_s": self.session_s,
            "stop_s": { "median": self.median_s(), "all": self.stops_s },
            "segments": self.segments,
            "frames": self.frames,
        })
    }
}

pub(super) fn measure(plan: &Plan, disk: &Path) -> Result<Vec<Stopping>> {
    let mut all = Vec::new();
    for &(session_s, times) in plan.stops {
        let mut stopping = Stopping {
            session_s,
            stops_s: Vec::new(),
            segments: 0,
            frames: 0,
        };
        for _ in 0..times {
            record_and_stop(&mut stopping, disk)?;
        }
        println!(
            "closing after {session_s:.0} s: {:.1} ms ({} segments; stopping may take {:.0} ms)",
            1e3 * stopping.median_s(),
            stopping.segments,
            1e3 * STOP_LIMIT_S
        );
        all.push(stopping);
    }
    Ok(all)
}

/// Small frames, so that an hour fits on any disk; those of the last three seconds are of full
/// size, because they are what stopping writes.
fn record_and_stop(stopping: &mut Stopping, disk: &Path) -> Result<()> {
    let (small, large) = (load::units(150, 250), load::units(60_000, 100_000));
    let folder = tempfile::tempdir_in(disk).context("making a folder to write to")?;
    let (storage, _) = CountingStorage::new(DiskStorage::new(folder.path()), Destination::Disk);
    let mut writer = SessionWriter::create(storage, load::spec(DEFAULT_CHUNK_NS))?;
    let near_end = load::START + ((stopping.session_s - 3.0) * 1e9) as i64;
    for arrival in load::arrivals(stopping.session_s, DEFAULT_CHUNK_NS) {
        let late = arrival.place().1 >= near_end;
        load::put(&mut writer, &arrival, if late { &large } else { &small })?;
        stopping.frames += u64::from(matches!(arrival, load::Arrival::Frame(..)));
    }
    let (manifest, took) = timed(|| writer.close(load::stop(load::START)));
    stopping.segments = manifest?.segments.len();
    stopping.stops_s.push(took.wall_s);
    Ok(())
}
