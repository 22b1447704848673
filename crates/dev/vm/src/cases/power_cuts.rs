//! `power-cuts`: the power is cut at every kind of instant of a recording, on real file systems.
//! Does every session open, is all there that was reported durable, and how much is lost?
//!
//! The first two must be so. How much is lost is reported and no bound is asserted: on a busy host
//! frames wait in front of the encoders, a cut takes them too, and nothing promised that they are
//! on disk.
//!
//! Two kinds of cuts. [`replayed`]: one recording through dm-log-writes gives every disk that a cut
//! may have left, torn caches included; hundreds are mounted and examined. [`live`]: guests are
//! killed while they record. The negative control records with syncs that do nothing, and must be
//! caught.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use anyhow::{Result, ensure};
use serde::Serialize;
use serde_json::json;

use crate::case::{Bench, Case, Report};
use crate::image::FileSystem;

pub mod live;
pub mod replayed;

use replayed::{Plan, Recording};

/// The case.
pub(super) const CASE: Case = Case {
    name: "power-cuts",
    shows: "the power is cut while pawsd records: every session opens, nothing reported durable is lost",
    quick: true,
    on_qemu: false,
    run,
};

/// The length of chunks that the daemon has by default, ms.
const CHUNK_MS: u32 = 500;

/// What came of one cut.
#[derive(Clone, Debug, Serialize)]
pub struct Cut {
    /// Where: entry of the log, or milliseconds from the start of the recording.
    pub at: u64,
    /// Whether the disk's cache was torn.
    pub torn: bool,
    /// By stream, what was lost, ns; none if there was nothing yet that could be.
    pub lost: BTreeMap<String, i64>,
    /// Places that hold something else than a cut leaves at the end.
    pub damage: u64,
    /// Whether the file system had to be repaired before it could be mounted.
    pub repaired: bool,
    /// What must not be.
    pub error: Option<String>,
}

impl Cut {
    /// The most that a stream has lost, ns.
    pub fn most_lost(&self) -> Option<i64> {
        self.lost.values().copied().max()
    }

    /// What is wrong with it, if anything is.
    fn wrong(&self) -> Option<String> {
        let torn = if self.torn { ", torn" } else { "" };
        let error = self.error.as_ref()?;
        Some(format!("cut at {}{torn}: {error}", self.at))
    }
}

/// What went wrong, of cuts.
pub fn wrong(cuts: &[Cut]) -> Vec<String> {
    cuts.iter().filter_map(Cut::wrong).collect()
}

fn most_lost_ms(cuts: &[Cut]) -> i64 {
    let lost = cuts.iter().filter_map(Cut::most_lost);
    lost.max().unwrap_or(0) / 1_000_000
}

fn run(bench: &Bench) -> Result<Report> {
    let (states, cuts, controls) = if bench.quick {
        (6, 2, 6)
    } else {
        (100, 25, 20)
    };
    let mut line = String::new();
    let mut figures = serde_json::Map::new();
    let mut all_wrong = Vec::new();
    for file_system in FileSystem::ALL {
        let name = file_system.name();
        let plan = Plan {
            file_system,
            chunk_ms: CHUNK_MS,
            seconds: if bench.quick { 4 } else { 10 },
            syncs: true,
        };
        let recording = Recording::make(bench, &format!("{name}-log"), plan)?;
        let replayed = recording.cuts(bench, states)?;
        let live = live::cuts(bench, &format!("{name}-live"), file_system, cuts)?;
        for (kind, cuts) in [("replayed", &replayed), ("live", &live)] {
            let wrong = wrong(cuts);
            let _ = write!(
                line,
                "{name}: {} of {} {kind} cuts good, most lost {} ms",
                cuts.len() - wrong.len(),
                cuts.len(),
                most_lost_ms(cuts)
            );
            let repaired = cuts.iter().filter(|cut| cut.repaired).count();
            if repaired > 0 {
                let _ = write!(line, ", {repaired} after a repair by e2fsck");
            }
            line.push_str("; ");
            all_wrong.extend(
                wrong
                    .into_iter()
                    .map(|text| format!("{name}, {kind}: {text}")),
            );
        }
        figures.insert(
            name.to_owned(),
            json!({ "replayed": replayed, "live": live }),
        );
    }
    let caught = control(bench, controls)?;
    let _ = write!(line, "without syncs {caught} of {controls} cuts are caught");
    figures.insert(
        "control".to_owned(),
        json!({ "cuts": controls, "caught": caught }),
    );
    ensure!(
        all_wrong.is_empty(),
        "{line}; {} cuts went wrong:\n  {}",
        all_wrong.len(),
        all_wrong.join("\n  ")
    );
    ensure!(
        caught > 0,
        "{line}; the examination finds nothing where nothing is synced, so it proves nothing"
    );
    Ok(Report {
        line,
        figures: figures.into(),
    })
}

/// How many of the cuts are caught in a recording whose syncs do nothing.
fn control(bench: &Bench, states: u32) -> Result<usize> {
    let plan = Plan {
        file_system: FileSystem::Ext4,
        chunk_ms: CHUNK_MS,
        seconds: 4,
        syncs: false,
    };
    let recording = Recording::make(bench, "control-log", plan)?;
    Ok(wrong(&recording.cuts(bench, states)?).len())
}
