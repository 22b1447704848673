//! Errors of learned depth and segmentation.

use std::path::PathBuf;

/// Error of a network or of ONNX Runtime.
#[derive(Debug, thiserror::Error)]
pub enum LearnedError {
    /// No path of ONNX Runtime is configured, or there is no file at the path: give the path of the
    /// library.
    #[error(
        "loading ONNX Runtime: {found}, expected the path of a library of ONNX Runtime 1.17 or later"
    )]
    NoLibrary {
        /// Where the path came from, and what was found.
        found: String,
    },
    /// The file is not a usable ONNX Runtime: use another one.
    #[error("loading ONNX Runtime, expected a library of version 1.17 or later for this machine: {}", library.display())]
    Library {
        /// Path of the file.
        library: PathBuf,
        /// Error of the system or of the library.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A process can load only one ONNX Runtime: start another process for another library.
    #[error("loading ONNX Runtime: found {} already loaded, expected the same library: {}", loaded.display(), requested.display())]
    OtherLibrary {
        /// Path of the loaded library.
        loaded: PathBuf,
        /// Path of the requested library.
        requested: PathBuf,
    },
    /// A file cannot be read.
    #[error("reading {what}: {}", file.display())]
    Read {
        /// `a network` or `settings of a network`.
        what: &'static str,
        /// Path of the file.
        file: PathBuf,
        /// Error of the file system.
        source: std::io::Error,
    },
    /// ONNX Runtime rejects the file: it is not a model, or it has operators that this version does
    /// not support.
    #[error("opening a network, expected an ONNX model that this ONNX Runtime can run: {}", file.display())]
    Model {
        /// Path of the file.
        file: PathBuf,
        /// Error of ONNX Runtime.
        source: ort::Error,
    },
    /// The settings do not have the format of `docs/reference/learned.md`.
    #[error("reading settings of a network: {}", file.display())]
    Toml {
        /// Path of the settings.
        file: PathBuf,
        /// Position and reason.
        source: toml::de::Error,
    },
    /// Invalid settings: change them.
    #[error("reading settings of a network: found {found}, expected {expected}: {}", file.display())]
    Settings {
        /// Path of the settings, whether the file exists or not.
        file: PathBuf,
        /// The value found.
        found: String,
        /// The supported values.
        expected: String,
    },
    /// An input or output of the network has another type or shape.
    #[error("using a network: {tensor} is {found}, expected {expected}: {}", file.display())]
    Tensor {
        /// Path of the network.
        file: PathBuf,
        /// Name of the input or output.
        tensor: String,
        /// Type, shape or value found.
        found: String,
        /// The supported values.
        expected: String,
    },
    /// Invalid image, or its size differs from that of the other image or exceeds the input of the
    /// network.
    #[error("reading an image: found {found}, expected {expected}")]
    Image {
        /// Type, shape or value found.
        found: String,
        /// The supported values.
        expected: String,
    },
    /// Inference failed, often for lack of memory or because the network does not support this
    /// image size.
    #[error("running a network: {}", file.display())]
    Run {
        /// Path of the file.
        file: PathBuf,
        /// Error of ONNX Runtime.
        source: ort::Error,
    },
}
