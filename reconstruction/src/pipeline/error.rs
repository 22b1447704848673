//! Why a pipeline stopped.

use scene_bundle::BundleError;

use super::stage::StageError;

/// Why a pipeline stopped.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The table contradicts itself: a defect of the program.
    #[error("the table of stages is wrong: {0}")]
    Table(String),
    /// Unknown stage: use one of the listed ones.
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
    /// An output of a stage that is not to run is missing: begin with that stage.
    #[error("beginning with stage {stage}: output {output} is missing, expected it of stage {of}")]
    Absent {
        /// The first stage.
        stage: &'static str,
        /// The missing output.
        output: &'static str,
        /// The stage that writes it.
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
