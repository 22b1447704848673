//! What a format module states about its format, for the table of formats.

use std::path::Path;

use camera_models::{CameraSet, LensModel, Note, StereoCalibration};

use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::output::{FormatFiles, WriteError};
use crate::tree::At;

/// The cameras of a file, and what has to be shown to the user.
pub(crate) type SetResult = Result<(CameraSet, Vec<Note>), CalibError>;
/// The same for a stereo camera.
pub(crate) type PairResult = Result<(StereoCalibration, Vec<Note>), CalibError>;

/// One format.
pub(crate) struct Entry {
    pub(crate) format: Format,
    /// The lens models that it can represent, the smallest of a family first.
    pub(crate) models: &'static [LensModel],
    /// Fields of an IMU that it can represent.
    pub(crate) imu_fields: &'static [ImuField],
    /// How a folder with a calibration is recognized.
    pub(crate) in_folder: InFolder,
    /// How a file is recognized.
    pub(crate) signs: Signs,
    /// Reads all cameras of a file, or of an ASL folder. With a size, in pixels, a file without one
    /// gets it.
    pub(crate) read: fn(&dyn Files, &Path, Option<[u32; 2]>) -> SetResult,
    /// Reads a stereo camera for images of this size, in pixels; without it, the pair is taken from
    /// the set.
    pub(crate) read_pair: Option<ReadPair>,
    /// The files for a set.
    pub(crate) write: fn(&CameraSet) -> Result<FormatFiles, WriteError>,
}

/// Reads a stereo camera of images of a size, pixels.
pub(crate) type ReadPair = fn(&dyn Files, &Path, [u32; 2]) -> PairResult;

/// A field of an IMU besides its pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ImuField {
    Placement,
    Rate,
    Noise,
    TimeOffset,
    Biases,
}

/// What identifies a folder with a calibration.
pub(crate) enum InFolder {
    /// A file with one of these names.
    Named(&'static [&'static str]),
    /// A file with this extension, in any case.
    Extension(&'static str),
    /// This file below the folder itself, or below the folder `inner` in it; the calibration is
    /// that folder.
    Below {
        file: &'static str,
        inner: &'static str,
    },
}

/// What identifies a file, tried in this order. Each sign is compared for all formats before the
/// next one.
pub(crate) struct Signs {
    /// Its name alone.
    pub(crate) name: Option<&'static str>,
    /// Its extension, or the start of its first line that is not a comment.
    pub(crate) start: Option<fn(extension: &str, first: &str) -> bool>,
    /// Keys of a JSON file.
    pub(crate) json: Option<fn(&At<'_>) -> bool>,
    /// Keys of a YAML file.
    pub(crate) yaml: Option<fn(&At<'_>) -> bool>,
    /// Words of the first line that is not a comment.
    pub(crate) words: Option<fn(&[&str]) -> bool>,
}

impl Signs {
    /// No sign: never recognized.
    pub(crate) const NONE: Self = Self {
        name: None,
        start: None,
        json: None,
        yaml: None,
        words: None,
    };
}

/// Loose on purpose: a misspelt number is reported by the reader of the format.
pub(crate) fn is_number_like(word: &str) -> bool {
    word.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '-' | '+' | '.'))
}

impl ImuField {
    /// Name in messages.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Placement => "placement",
            Self::Rate => "rate",
            Self::Noise => "noise",
            Self::TimeOffset => "time offset",
            Self::Biases => "biases",
        }
    }
}
