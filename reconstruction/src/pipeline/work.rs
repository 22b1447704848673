//! Context of a running stage.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use scene_bundle::{Bundle, BundleError, Draft, OutputReader, Scene};

use super::observer::Observer;
use super::report::Report;

/// Context of a running stage: its source, outputs of earlier stages, and drafts of its own. May be
/// used from several threads.
pub struct Work<'a, S: ?Sized> {
    source: &'a S,
    scene: Scene,
    inputs: &'static [&'static str],
    outputs: &'static [&'static str],
    drafts: Vec<Draft>,
    findings: Findings,
    observer: &'a dyn Observer,
}

/// Notes and losses of a stage, in their order. May be used from several threads.
#[derive(Debug, Default)]
pub struct Findings {
    report: Mutex<Report>,
}

impl Findings {
    /// Adds a note on an assumption or finding. Notes are kept in order: add them from one thread.
    pub fn note(&self, sentence: impl Into<String>) {
        self.report(|report| report.notes.push(sentence.into()));
    }

    /// Adds a loss: a part of the input that could not be used. The program then exits with 3.
    pub fn record_loss(&self, sentence: impl Into<String>) {
        self.report(|report| report.losses.push(sentence.into()));
    }

    /// The losses so far.
    pub fn losses(&self) -> Vec<String> {
        let report = self.report.lock().unwrap_or_else(PoisonError::into_inner);
        report.losses.clone()
    }

    fn report(&self, change: impl FnOnce(&mut Report)) {
        change(&mut self.report.lock().unwrap_or_else(PoisonError::into_inner));
    }

    /// All of them.
    pub fn into_report(self) -> Report {
        let report = self.report.into_inner();
        report.unwrap_or_else(PoisonError::into_inner)
    }
}

impl<'a, S: ?Sized> Work<'a, S> {
    /// `inputs` and `outputs` are those of the stage.
    pub(super) fn begin(
        (inputs, outputs): (&'static [&'static str], &'static [&'static str]),
        source: &'a S,
        bundle: &Bundle,
        observer: &'a dyn Observer,
    ) -> Result<Self, BundleError> {
        let drafts = outputs.iter().map(|output| bundle.begin(output));
        Ok(Self {
            source,
            scene: bundle.scene(),
            inputs,
            outputs,
            drafts: drafts.collect::<Result<_, _>>()?,
            findings: Findings::default(),
            observer,
        })
    }

    /// Source that all stages read.
    pub fn source(&self) -> &'a S {
        self.source
    }

    /// An output of an earlier stage.
    ///
    /// # Errors
    /// As [`Scene::output`].
    ///
    /// # Panics
    /// If the table does not name it as an input of this stage: the dependency would be unknown.
    pub fn read(&self, output: &str) -> Result<OutputReader, BundleError> {
        assert!(
            self.inputs.contains(&output),
            "{output} is not an input of this stage"
        );
        self.scene.output(output)
    }

    /// An output of this stage as an earlier run left it; `None` without one, and where it cannot
    /// be read.
    ///
    /// # Panics
    /// If the table does not name it as an output of this stage.
    pub fn earlier(&self, output: &str) -> Option<OutputReader> {
        assert!(
            self.outputs.contains(&output),
            "{output} is not an output of this stage"
        );
        self.scene.output(output).ok()
    }

    /// The draft of an output of this stage.
    ///
    /// # Panics
    /// If the table does not name it as one.
    pub fn draft(&self, output: &str) -> &Draft {
        let position = self.outputs.iter().position(|name| *name == output);
        &self.drafts[position.expect("an output of this stage")]
    }

    /// Notes and losses of the stage.
    pub fn findings(&self) -> &Findings {
        &self.findings
    }

    /// As [`Findings::note`].
    pub fn note(&self, sentence: impl Into<String>) {
        self.findings.note(sentence);
    }

    /// As [`Findings::record_loss`].
    pub fn record_loss(&self, sentence: impl Into<String>) {
        self.findings.record_loss(sentence);
    }

    /// Adds a loss from an error, with its causes.
    pub fn record_loss_from(&self, error: &dyn std::error::Error) {
        self.record_loss(scene_bundle::error_chain(error));
    }

    /// The folder of the bundle, for what a stage keeps between runs that were stopped.
    pub fn folder(&self) -> PathBuf {
        self.scene.path()
    }

    /// Reports an intermediate result.
    pub fn status(&self, text: &str) {
        self.observer.status(text);
    }

    /// Reports progress: `done` of `total`.
    pub fn progress(&self, done: u64, total: u64) {
        self.observer.progress(done, total);
    }

    pub(super) fn end(self) -> (Vec<Draft>, Report) {
        (self.drafts, self.findings.into_report())
    }
}
