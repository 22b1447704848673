//! A hand-off to a scene bundle, stage by stage.
//!
//! Contract: the stages are a fixed table, each with the outputs that it reads and those that it makes; a stage reads only
//! what an earlier one makes, or the hand-off. *A stage is skipped* if its outputs are there and were made by this
//! version of it, with these settings, of inputs with these hashes. *Killed at any point*, what a stage had not committed is
//! gone, and the next run begins with that stage: outputs appear whole or not at all ([`scene_bundle::Bundle`]). *On
//! failure* of a stage the outputs of earlier ones stay, and so does what it had made itself before. Same
//! input, settings and version give the same bytes, so settings hold everything that an output depends on and nothing
//! else: not the number of threads, nor what time it is.
//!
//! What a stage lost of its input, and what it has to say, goes into `report.json` of its first output, so that a stage
//! that is skipped is as loud as one that runs.

use std::collections::BTreeMap;
use std::error::Error;
use std::time::Duration;

use scene_bundle::{Bundle, BundleError, Scene};
use serde_json::Value;

pub mod observer;
mod report;
pub mod stage_timings;
pub mod stages;
mod table;
mod up_to_date;
mod work;

pub use self::observer::{Observer, Outcome, State};
pub use self::report::Report;
pub use self::work::Work;

/// What a stage may fail with.
pub type StageError = Box<dyn Error + Send + Sync>;

/// One step from the hand-off to the bundle. `S` is what all steps read: the hand-off.
pub trait Stage<S: ?Sized> {
    /// Its name, on command lines and in the bundle.
    fn name(&self) -> &'static str;
    /// Counted up when the same input gives another output.
    fn version(&self) -> u32;
    /// Names of what it reads: outputs of earlier stages, or sources.
    fn inputs(&self) -> &'static [&'static str];
    /// Names of the outputs that it makes, at least one.
    fn outputs(&self) -> &'static [&'static str];
    /// All settings that its outputs depend on, defaults included.
    fn settings(&self) -> Value;
    /// Fills the drafts of its outputs. They are committed by the caller.
    ///
    /// # Errors
    /// Whatever keeps it from making its outputs. Nothing of it stays then.
    fn run(&self, work: &Work<'_, S>) -> Result<(), StageError>;
}

/// Why a pipeline stopped.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The table contradicts itself: a defect of the program.
    #[error("the table of stages is wrong: {0}")]
    Table(String),
    /// There is no such stage: use one of those that are there.
    #[error("choosing stages: found {found:?}, expected one of {known}")]
    NoStage {
        /// The name.
        found: String,
        /// All names.
        known: String,
    },
    /// The last stage comes before the first: exchange them.
    #[error("choosing stages: {from} comes after {to}, expected the other order")]
    Order {
        /// The first.
        from: String,
        /// The last.
        to: String,
    },
    /// An output of a stage that is not to run is not there: begin with that stage.
    #[error(
        "beginning with stage {stage}: output {output} is not there, expected it of stage {of}"
    )]
    Absent {
        /// The first stage.
        stage: &'static str,
        /// What it lacks.
        output: &'static str,
        /// Which stage makes it.
        of: &'static str,
    },
    /// A stage failed.
    #[error("stage {stage}")]
    Stage {
        /// Which.
        stage: &'static str,
        /// Why.
        source: StageError,
    },
    /// The bundle could not be read or written.
    #[error("stage {stage}")]
    Bundle {
        /// Which stage was next.
        stage: &'static str,
        /// Why.
        source: BundleError,
    },
}

/// The stages, in order. See the module.
pub struct Pipeline<S: ?Sized> {
    stages: Vec<Box<dyn Stage<S>>>,
}

/// Which stages to run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// The first; those before are taken as they are.
    pub from: Option<String>,
    /// The last.
    pub to: Option<String>,
    /// Whether stages are made again whose outputs are there.
    pub force: bool,
}

/// What a pipeline is told of the machine.
#[derive(Clone, Copy, Debug)]
pub struct Meter {
    /// Time since some fixed instant.
    pub now: fn() -> Duration,
    /// Forgets how much memory was used at most until now.
    pub forget_peak: fn(),
    /// How much memory was used at most since, bytes.
    pub peak_bytes: fn() -> Option<u64>,
}

impl Meter {
    /// A clock that stands still and no memory, for tests.
    pub const STILL: Self = Self {
        now: || Duration::ZERO,
        forget_peak: || {},
        peak_bytes: || None,
    };
}

/// What goes in from outside the bundle: the hand-off, and the hashes of that and of files that were given.
pub struct Sources<'a, S: ?Sized> {
    /// What stages read.
    pub source: &'a S,
    /// Hashes by name; BLAKE3, hex.
    pub hashes: BTreeMap<String, String>,
}

impl<S: ?Sized> Pipeline<S> {
    /// Puts stages together. `sources` are names of what comes from outside the bundle.
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

    /// Runs the stages that are to run and are not done, and says of each how it went.
    ///
    /// # Errors
    /// [`PipelineError`]. What was committed stays.
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

    /// Everything that stages from `first` on read of earlier ones has to be there.
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

/// What the stage that made an output had to say; nothing where the output is not its first one.
///
/// # Errors
/// The output cannot be read.
pub fn report_of(scene: &Scene, output: &str) -> Result<Report, BundleError> {
    report::read(scene, output)
}

/// Runs a stage and commits what it made.
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
    let work = Work::begin(stage, source, bundle, observer).map_err(failed)?;
    stage.run(&work).map_err(|source| PipelineError::Stage {
        stage: stage.name(),
        source,
    })?;
    let (drafts, report) = work.end();
    report::write(&drafts[0], &report).map_err(failed)?;
    // The first output holds the report: committed last, it is never there without the others.
    for draft in drafts.into_iter().rev() {
        draft.commit(record.clone()).map_err(failed)?;
    }
    Ok(report)
}

#[cfg(test)]
mod tests;
