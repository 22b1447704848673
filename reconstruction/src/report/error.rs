//! Errors of the report.

use std::io;
use std::path::PathBuf;

use scene_bundle::BundleError;
use splats::SplatError;

use crate::evaluate::ground_truth::GroundTruthError;

/// Why no page was written.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The bundle cannot be read.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// The stage timings cannot be read.
    #[error("reading the stage timings: {}", path.display())]
    StageTimings {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The images beside the bundle cannot be read.
    #[error("reading the images of the cameras: {}", path.display())]
    CameraImage {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The film of an agent cannot be read.
    #[error("reading the film of an agent: {}", path.display())]
    Film {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: io::Error,
    },
    /// The ground truth of feet cannot be read.
    #[error(transparent)]
    GroundTruth(#[from] GroundTruthError),
    /// An image cannot be encoded: a defect of the program.
    #[error("encoding an image of the cloud")]
    Image(#[from] png::EncodingError),
    /// The scene of Gaussians cannot be rendered.
    #[error("rendering the scene of Gaussians")]
    Gaussians(#[from] SplatError),
}
