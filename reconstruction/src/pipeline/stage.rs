//! A stage of the pipeline.

use std::error::Error;
use std::path::Path;

use serde_json::Value;

use super::work::Work;

/// Error of a stage.
pub type StageError = Box<dyn Error + Send + Sync>;

/// A stage of the pipeline. `S` is the source that all stages read: the hand-off.
pub trait Stage<S: ?Sized> {
    /// Its name, on command lines and in the bundle.
    fn name(&self) -> &'static str;
    /// Version, incremented when the same input gives another output.
    fn version(&self) -> u32;
    /// Names of its inputs: outputs of earlier stages, or sources.
    fn inputs(&self) -> &'static [&'static str];
    /// Names of the outputs that it writes, at least one.
    fn outputs(&self) -> &'static [&'static str];
    /// All settings that its outputs depend on, defaults included.
    fn settings(&self) -> Value;
    /// Fills the drafts of its outputs, which the caller commits.
    ///
    /// # Errors
    /// Any error that prevents its outputs, which are then discarded.
    fn run(&self, work: &Work<'_, S>) -> Result<(), StageError>;
    /// Removes what it keeps between runs that were stopped; called after its outputs were
    /// committed. Most stages keep nothing.
    fn clean_up(&self, bundle: &Path) {
        let _ = bundle;
    }
}
