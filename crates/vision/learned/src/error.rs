//! Why a network gave no answer.

use std::path::PathBuf;

/// See the variants.
#[derive(Debug, thiserror::Error)]
pub enum LearnedError {
    /// Nobody said where ONNX Runtime is, or it is not there: name its library.
    #[error(
        "loading ONNX Runtime: {found}, expected the path of a library of ONNX Runtime 1.17 or later"
    )]
    NoLibrary {
        /// Where was looked, and what was there.
        found: String,
    },
    /// The file cannot be used as ONNX Runtime: take another.
    #[error("loading ONNX Runtime, expected a library of version 1.17 or later for this machine: {}", library.display())]
    Library {
        /// Its path.
        library: PathBuf,
        /// What the system or the library said.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A process has one ONNX Runtime: start another process for another library.
    #[error("loading ONNX Runtime: found {} already loaded, expected the same library: {}", loaded.display(), requested.display())]
    OtherLibrary {
        /// The one that is loaded.
        loaded: PathBuf,
        /// The one that was asked for.
        requested: PathBuf,
    },
    /// A file cannot be read.
    #[error("reading {what}: {}", file.display())]
    Read {
        /// `a network` or `settings of a network`.
        what: &'static str,
        /// Its path.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// ONNX Runtime does not take the file: it is no network, or has operators that this version does not know.
    #[error("opening a network, expected an ONNX model that this ONNX Runtime can run: {}", file.display())]
    Model {
        /// Its path.
        file: PathBuf,
        /// What ONNX Runtime said.
        source: ort::Error,
    },
    /// The settings are not as `docs/learned.md` tells.
    #[error("reading settings of a network: {}", file.display())]
    Toml {
        /// Path of the settings.
        file: PathBuf,
        /// Where and why.
        source: toml::de::Error,
    },
    /// Settings that cannot be followed: change them.
    #[error("reading settings of a network: found {found}, expected {expected}: {}", file.display())]
    Settings {
        /// Path of the settings, whether they are there or not.
        file: PathBuf,
        /// What they say.
        found: String,
        /// What is possible.
        expected: String,
    },
    /// The network takes or gives something else.
    #[error("using a network: {tensor} is {found}, expected {expected}: {}", file.display())]
    Tensor {
        /// Path of the network.
        file: PathBuf,
        /// Which of its inputs or outputs.
        tensor: String,
        /// What it is.
        found: String,
        /// What is possible.
        expected: String,
    },
    /// Not a picture, or not one of the pair's size, or of one that the network takes.
    #[error("taking a picture: found {found}, expected {expected}")]
    Image {
        /// What it is.
        found: String,
        /// What is possible.
        expected: String,
    },
    /// ONNX Runtime gave up; often for want of memory, or because the network takes no pictures of this size.
    #[error("running a network: {}", file.display())]
    Run {
        /// Its path.
        file: PathBuf,
        /// What ONNX Runtime said.
        source: ort::Error,
    },
}
