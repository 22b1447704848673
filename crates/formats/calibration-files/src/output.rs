//! A calibration in the format of another tool, before it is on disk, and the reasons why a format
//! cannot represent one.

use std::io;
use std::path::{Path, PathBuf};

use camera_models::{
    CameraSet, Distortion, LensModel, NamedCamera, Note, StereoCalibration, exactly,
};

use crate::error::CalibError;
use crate::format::Format;

/// Reasons for a calibration not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The format cannot represent this lens: convert it first.
    #[error(
        "writing {format}: it cannot hold the lens {model} of camera {camera}; convert it first, the \
         nearest it can hold is {nearest}"
    )]
    Lens {
        /// The format's name.
        format: &'static str,
        /// The camera's name.
        camera: String,
        /// Its lens model.
        model: &'static str,
        /// The nearest model of the format.
        nearest: &'static str,
    },
    /// The format cannot represent this calibration for another reason.
    #[error("writing {format}: found {found}, expected {expected}")]
    Refused {
        /// The format's name.
        format: &'static str,
        /// What was found.
        found: String,
        /// What the format requires.
        expected: String,
    },
    /// The path exists: give another.
    #[error("writing a calibration: it exists already and is not overwritten: {}", path.display())]
    Exists {
        /// The path.
        path: PathBuf,
    },
    /// The format has more than one file: give a folder.
    #[error("writing {format}: it makes {files}; expected the name of a new folder: {}", path.display())]
    NeedsFolder {
        /// The format's name.
        format: &'static str,
        /// The files' names.
        files: String,
        /// The path that names a file.
        path: PathBuf,
    },
    /// The file system failed.
    #[error("writing a calibration: {}", path.display())]
    Write {
        /// The path.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Files of a set in some format.
pub(crate) struct FormatFiles {
    /// Names and contents. A name may have a folder in it.
    pub(crate) files: Vec<(String, Vec<u8>)>,
    pub(crate) notes: Vec<Note>,
}

impl FormatFiles {
    pub(crate) fn file(name: &str, text: String) -> Self {
        Self {
            files: vec![(name.to_owned(), text.into_bytes())],
            notes: Vec::new(),
        }
    }
}

/// The set as a pair, for formats of pairs only.
pub(crate) fn stereo(set: &CameraSet, format: Format) -> Result<StereoCalibration, WriteError> {
    let refused = |found: String| WriteError::Refused {
        format: format.name(),
        found,
        expected: "a stereo camera, left and right, whose placement is known".to_owned(),
    };
    if set.cameras.len() != 2 {
        return Err(refused(format!("cameras {}", set.names().join(", "))));
    }
    set.stereo(None)
        .map(|(stereo, _)| stereo)
        .map_err(CalibError::invalid(Path::new("")))
        .map_err(|error| refused(error.to_string().trim_end_matches(": ").to_owned()))
}

/// The lens in the first of the format's models that means exactly the same, otherwise an error.
pub(crate) fn lens(
    camera: &str,
    distortion: &Distortion,
    format: Format,
    models: &[LensModel],
) -> Result<Distortion, WriteError> {
    models
        .iter()
        .find_map(|model| exactly(distortion, *model))
        .ok_or_else(|| WriteError::Lens {
            format: format.name(),
            camera: camera.to_owned(),
            model: distortion.name(),
            nearest: nearest(LensModel::of(distortion), models).name(),
        })
}

/// The format's model that is likely to be closest.
fn nearest(model: LensModel, held: &[LensModel]) -> LensModel {
    use LensModel::{
        DoubleSphere, Eucm, KannalaBrandt4, None, RadTan4, RadTan5, Radial2, Rational8,
    };
    let wide = [KannalaBrandt4, DoubleSphere, Eucm];
    let narrow = [Rational8, RadTan5, RadTan4, Radial2];
    let order = if wide.contains(&model) {
        [&wide[..], &narrow[..]].concat()
    } else {
        [&narrow[..], &wide[..]].concat()
    };
    order
        .into_iter()
        .find(|candidate| held.contains(candidate))
        .unwrap_or(None)
}

/// The pose of a camera, or an error for formats that require it.
pub(crate) fn required_pose(
    camera: &NamedCamera,
    format: Format,
) -> Result<cad_transforms::RigidTransform, WriteError> {
    camera.camera_from_first.ok_or_else(|| WriteError::Refused {
        format: format.name(),
        found: format!("camera {} without a placement", camera.name),
        expected: "every camera's pose".to_owned(),
    })
}
