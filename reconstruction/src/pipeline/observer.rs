//! Progress of a pipeline.

use std::collections::BTreeMap;

use serde::Serialize;

use super::report::Report;

/// Receives the progress of a pipeline; from several threads.
pub trait Observer: Sync {
    /// A stage begins: its name, its number from 1, and the number of stages.
    fn begin(&self, stage: &str, number: usize, of: usize);
    /// Progress of the stage: `done` of `total`.
    fn progress(&self, done: u64, total: u64);
    /// An intermediate result of the stage, a few words.
    fn status(&self, text: &str) {
        let _ = text;
    }
    /// A stage is done.
    fn end(&self, outcome: &Outcome);
}

/// Ignores all progress.
#[derive(Clone, Copy, Debug)]
pub struct NoObserver;

impl Observer for NoObserver {
    fn begin(&self, _stage: &str, _number: usize, _of: usize) {}
    fn progress(&self, _done: u64, _total: u64) {}
    fn end(&self, _outcome: &Outcome) {}
}

/// Whether a stage ran.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// The stage ran.
    Ran,
    /// Its outputs were up to date.
    UpToDate,
}

/// Outcome of a stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// Its name.
    pub stage: &'static str,
    /// Whether it ran.
    pub state: State,
    /// Hashes of its outputs, by name.
    pub outputs: BTreeMap<&'static str, String>,
    /// Its notes and losses.
    #[serde(flatten)]
    pub report: Report,
    /// Time, s.
    pub seconds: f64,
    /// Peak memory, bytes, if known.
    pub peak_bytes: Option<u64>,
}
