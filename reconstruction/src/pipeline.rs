//! Pipeline from a hand-off to a scene bundle, stage by stage.
//!
//! Contract: the stages are a fixed table, each with the outputs that it reads and writes; a stage
//! reads only outputs of earlier stages, or the hand-off. *A stage is skipped* if its outputs exist
//! and were written by this version of it, with these settings, from inputs with these hashes.
//! *Killed at any point*, uncommitted outputs of a stage are discarded, and the next run begins
//! with that stage: outputs appear whole or not at all ([`scene_bundle::Bundle`]). *On failure* of
//! a stage outputs of earlier stages are kept, and so are its own previous outputs. Same input,
//! settings and version give the same bytes, so settings hold everything that an output depends on
//! and nothing else: not the number of threads, nor what time it is.
//!
//! Losses and notes of a stage go into `report.json` of its first output, so that a skipped stage
//! reports them as well.

use std::collections::BTreeMap;
use std::time::Duration;

use scene_bundle::{Bundle, BundleError, Scene};

mod error;
pub mod observer;
mod report;
mod selection;
mod stage;
pub mod stage_timings;
pub mod stages;
mod table;
mod up_to_date;
mod work;

pub use self::error::PipelineError;
pub use self::observer::{Observer, Outcome, State};
pub use self::report::Report;
pub use self::selection::Selection;
pub use self::stage::{Stage, StageError};
pub use self::work::{Findings, Work};

/// The stages, in order. See the module.
pub struct Pipeline<S: ?Sized> {
    stages: Vec<Box<dyn Stage<S>>>,
}

/// Clock and memory meter of the machine.
#[derive(Clone, Copy, Debug)]
pub struct Meter {
    /// Time since some fixed instant.
    pub now: fn() -> Duration,
    /// Resets the peak of the memory use.
    pub forget_peak: fn(),
    /// Peak memory use since, bytes.
    pub peak_bytes: fn() -> Option<u64>,
}

impl Meter {
    /// A stopped clock and no memory meter, for tests.
    pub const STILL: Self = Self {
        now: || Duration::ZERO,
        forget_peak: || {},
        peak_bytes: || None,
    };
}

/// Sources from outside the bundle: the hand-off, with hashes of it and of given files.
pub struct Sources<'a, S: ?Sized> {
    /// Source that stages read.
    pub source: &'a S,
    /// Hashes by name; BLAKE3, hex.
    pub hashes: BTreeMap<String, String>,
}

impl<S: ?Sized> Pipeline<S> {
    /// Builds a pipeline. `sources` are the names of sources from outside the bundle.
    ///
    /// # Errors
    /// [`PipelineError::Table`].
    pub fn new(stages: Vec<Box<dyn Stage<S>>>, sources: &[&str]) -> Result<Self, PipelineError> {
        table::check(&stages, sources)?;
        Ok(Self { stages })
    }

    /// The stages' names, in order.
    pub fn names(&self) -> Vec<&'static str> {
        self.stages.iter().map(|s| s.name()).collect()
    }

    /// Runs the selected stages that are not up to date, and returns the outcome of each.
    ///
    /// # Errors
    /// [`PipelineError`]. Committed outputs are kept.
    pub fn run(
        &self,
        sources: &Sources<'_, S>,
        bundle: &Bundle,
        selection: &Selection,
        observer: &dyn Observer,
        meter: &Meter,
    ) -> Result<Vec<Outcome>, PipelineError> {
        let range = table::range(&self.stages, selection)?;
        self.check_before(bundle, range.start)?;
        let mut outcomes = Vec::new();
        for (number, stage) in self.stages[range.clone()].iter().enumerate() {
            let stage = &**stage;
            let failed = |source| PipelineError::Bundle {
                stage: stage.name(),
                source,
            };
            let record = up_to_date::record(stage, &bundle.manifest(), &sources.hashes);
            observer.begin(stage.name(), number + 1, range.len());
            let scene = bundle.scene();
            let outcome =
                match up_to_date::is_up_to_date(stage, &scene, &record) && !selection.force {
                    true => Outcome {
                        stage: stage.name(),
                        state: State::UpToDate,
                        outputs: up_to_date::hashes(stage, &bundle.manifest()),
                        report: report::read(&scene, stage.outputs()[0]).map_err(failed)?,
                        seconds: 0.0,
                        peak_bytes: None,
                    },
                    false => {
                        (meter.forget_peak)();
                        let began = (meter.now)();
                        let report = run_stage(stage, sources.source, bundle, &record, observer)?;
                        Outcome {
                            stage: stage.name(),
                            state: State::Ran,
                            outputs: up_to_date::hashes(stage, &bundle.manifest()),
                            report,
                            seconds: ((meter.now)().saturating_sub(began)).as_secs_f64(),
                            peak_bytes: (meter.peak_bytes)(),
                        }
                    }
                };
            observer.end(&outcome);
            outcomes.push(outcome);
        }
        Ok(outcomes)
    }

    /// Checks that all outputs of earlier stages that stages from `first` on read exist.
    fn check_before(&self, bundle: &Bundle, first: usize) -> Result<(), PipelineError> {
        let manifest = bundle.manifest();
        for before in &self.stages[..first] {
            for output in before.outputs() {
                let is_read = (self.stages[first..].iter()).any(|s| s.inputs().contains(output));
                if is_read && !manifest.outputs.contains_key(*output) {
                    return Err(PipelineError::Absent {
                        stage: self.stages[first].name(),
                        output,
                        of: before.name(),
                    });
                }
            }
        }
        Ok(())
    }
}

/// Report of the stage that wrote an output; empty if the output is not its first one.
///
/// # Errors
/// The output cannot be read.
pub fn report_of(scene: &Scene, output: &str) -> Result<Report, BundleError> {
    report::read(scene, output)
}

/// Runs a stage and commits its outputs.
fn run_stage<S: ?Sized>(
    stage: &dyn Stage<S>,
    source: &S,
    bundle: &Bundle,
    record: &scene_bundle::Record,
    observer: &dyn Observer,
) -> Result<Report, PipelineError> {
    let failed = |source| PipelineError::Bundle {
        stage: stage.name(),
        source,
    };
    let tables = (stage.inputs(), stage.outputs());
    let work = Work::begin(tables, source, bundle, observer).map_err(failed)?;
    stage.run(&work).map_err(|source| PipelineError::Stage {
        stage: stage.name(),
        source,
    })?;
    let (drafts, report) = work.end();
    report::write(&drafts[0], &report).map_err(failed)?;
    // The first output holds the report: committed last, it never exists without the others.
    for draft in drafts.into_iter().rev() {
        draft.commit(record.clone()).map_err(failed)?;
    }
    stage.clean_up(&bundle.path());
    Ok(report)
}

#[cfg(test)]
mod tests;
