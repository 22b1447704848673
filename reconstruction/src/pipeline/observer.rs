//! How a pipeline is going.

use std::collections::BTreeMap;

use serde::Serialize;

use super::Report;

/// Is told how a pipeline is going; from several threads.
pub trait Observer: Sync {
    /// A stage begins: its name, its number from 1, and how many there are.
    fn begin(&self, stage: &str, number: usize, of: usize);
    /// So much of the stage is done, of so much.
    fn progress(&self, done: u64, total: u64);
    /// A stage is done.
    fn end(&self, outcome: &Outcome);
}

/// Watches nothing.
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
    /// It did.
    Ran,
    /// What it would have made was there.
    UpToDate,
}

/// How a stage went.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// Its name.
    pub stage: &'static str,
    /// Whether it ran.
    pub state: State,
    /// Hashes of its outputs, by name.
    pub outputs: BTreeMap<&'static str, String>,
    /// What it has to say.
    #[serde(flatten)]
    pub report: Report,
    /// How long it took, s.
    pub seconds: f64,
    /// Most memory meanwhile, bytes, where it is known.
    pub peak_bytes: Option<u64>,
}
