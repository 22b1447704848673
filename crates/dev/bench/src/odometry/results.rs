//! Results so far: a file that parts of the benchmark add to.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::real::{Drive, StandStill};
use super::run::{AdjustedRun, Job, TrackingRun};
use super::{charts, table};

const FILE: &str = "odometry.json";

/// See the module.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(crate) struct Results {
    /// Of the last part that was run.
    pub(crate) stamp: Value,
    /// KITTI, if its images were available.
    pub(crate) kitti: Option<Drive>,
    /// EuRoC.
    pub(crate) euroc: Option<StandStill>,
    /// Source and day of these two parts.
    #[serde(default)]
    pub(crate) sources: BTreeMap<String, String>,
    /// Walks.
    pub(crate) rows: Vec<Row>,
}

/// One run on a walk.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Row {
    #[serde(flatten)]
    pub(crate) job: Job,
    #[serde(flatten)]
    pub(crate) ran: TrackingRun,
    /// Result of the bundle adjustment, if it was run.
    pub(crate) adjusted: Option<AdjustedRun>,
    /// Source that was run.
    pub(crate) commit: String,
    /// Day of the run.
    pub(crate) date: String,
    /// Load at the start: runnable processes, mean of a minute, over the number of processors.
    pub(crate) load: f64,
}

impl Results {
    /// Results in the folder; empty without a file.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub(crate) fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(FILE);
        match fs::read_to_string(&path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(Self::default()),
            Err(e) => Err(e).with_context(|| format!("reading {}", path.display())),
            Ok(text) => serde_json::from_str(&text).with_context(|| {
                format!(
                    "reading earlier results: remove or repair {}",
                    path.display()
                )
            }),
        }
    }

    /// Replaces an earlier row of the same job.
    pub(crate) fn add(&mut self, row: Row) {
        match self.rows.iter_mut().find(|r| r.job == row.job) {
            Some(old) => *old = row,
            None => self.rows.push(row),
        }
    }

    /// Where the rows are from: machine, days, sources and command. Parts that were run on
    /// different days are combined, so this is not the stamp of the last part alone.
    pub(crate) fn foot(&self) -> String {
        let field = |key: &str| self.stamp[key].as_str().unwrap_or_default().to_owned();
        let several = |of: fn(&Row) -> &str| {
            let all: BTreeSet<&str> = self.rows.iter().map(of).collect();
            all.into_iter().collect::<Vec<_>>().join(", ")
        };
        let [days, commits] = [several(|r| &r.date), several(|r| &r.commit)];
        [field("machine"), days, commits, field("command")].join("; ")
    }

    /// Writes results, tables and charts.
    ///
    /// # Errors
    /// Any I/O error.
    pub(crate) fn write(&self, folder: &Path) -> Result<()> {
        let mut report = serde_json::to_value(self)?;
        report["benchmark"] = "odometry".into();
        let foot = self.foot();
        let mut files = vec![
            (FILE.to_owned(), format!("{report:#}\n")),
            ("odometry.md".to_owned(), table::text(self)),
        ];
        files.extend(charts::draw(self, &foot));
        write(folder, files)
    }
}

/// Writes files into a folder.
///
/// # Errors
/// Any I/O error.
pub(crate) fn write(folder: &Path, files: Vec<(String, String)>) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    for (name, text) in files {
        let path = folder.join(name);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
    }
    Ok(())
}

/// Load of the machine: runnable processes, mean of the last minute, over the number of processors.
pub(crate) fn load() -> f64 {
    let text = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let first = text.split_whitespace().next();
    let load: f64 = first.and_then(|t| t.parse().ok()).unwrap_or(f64::NAN);
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    load / processors as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::figures::Figures;

    #[test]
    fn written_results_are_read_back_and_extended() {
        let trajectory = scene_bundle::Trajectory::default();
        let row = |walk: &str| Row {
            job: Job::whole(walk, "balanced", false),
            ran: TrackingRun {
                stereo_cameras: 3,
                pairs: 30,
                seconds: 1.0,
                path_m: 2.0,
                keyframes: 4,
                wall_ms: 5.0,
                cpu_ms: 6.0,
                longest_set_ms: 7.0,
                peak_bytes: 8,
                shifts: 0,
                figures: Figures::of(&trajectory, &trajectory).expect("nothing to compare"),
            },
            adjusted: None,
            commit: "0".to_owned(),
            date: "2026-01-01".to_owned(),
            load: 0.5,
        };
        let folder = tempfile::tempdir().expect("a folder");
        let mut results = Results::default();
        results.add(row("pavement-day-21-110"));
        results.write(folder.path()).expect("written");
        let mut again = Results::read(folder.path()).expect("read");
        again.add(row("room-day-21-140"));
        again.add(row("pavement-day-21-110"));
        assert_eq!(again.rows.len(), 2);
        assert_eq!(again.rows[0].job, results.rows[0].job);
        let mut of_later = row("stairs-day-21-140");
        of_later.commit = "1".to_owned();
        again.add(of_later);
        assert_eq!(again.foot(), "; 2026-01-01; 0, 1; ");
    }
}
