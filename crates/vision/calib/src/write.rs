//! Writers of calibrations in the formats of other tools.
//!
//! Contract: nothing that exists is overwritten, and a file or folder appears completely or not at
//! all. A format that cannot represent a model exactly rejects it and names the nearest model that
//! it can, for [`convert`](crate::convert::convert); a larger model that means exactly the same is
//! used without asking (`radial2` as `radtan4` with zeros). Values that the format cannot represent
//! besides the lenses (biases, noise, a time offset) are reported in [`Note`]s.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::camera::Distortion;
use crate::convert::{LensModel, exactly};
use crate::error::Note;
use crate::set::{CameraSet, NamedCamera};
use crate::stereo::{Format, StereoCalibration};
use crate::{
    basalt, colmap, euroc, kalibr, kitti, middlebury, nerfstudio, opencv, pair, ros, rosys,
    zed_conf,
};

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
pub(crate) struct Written {
    /// Names and contents. A name may have a folder in it.
    pub(crate) files: Vec<(String, Vec<u8>)>,
    pub(crate) notes: Vec<Note>,
}

impl Written {
    pub(crate) fn file(name: &str, text: String) -> Self {
        Self {
            files: vec![(name.to_owned(), text.into_bytes())],
            notes: Vec::new(),
        }
    }
}

/// Writes a set. `out` is a file if its name has an extension and the format has one file,
/// otherwise a new folder. Returns the files and notes on what could not be represented.
///
/// # Errors
/// [`WriteError`]; then nothing was written.
///
/// ```
/// # use cad_transforms::RigidTransform;
/// # use calib::{CameraModel, CameraSet, Distortion, Format, StereoCalibration, read_stereo, write_cameras};
/// # use calib::Provenance;
///
/// let distortion = Distortion::RadTan4 { k1: -0.2, k2: 0.03, p1: 0.0, p2: 0.0 };
/// let model = CameraModel::new((640, 480), [500.0, 500.0, 319.5, 239.5], distortion);
/// let stereo = StereoCalibration {
///     left: model,
///     right: model,
///     right_from_left: RigidTransform::from_translation_m([-0.063, 0.0, 0.0])?,
///     imu: None,
///     provenance: Provenance { format: None, files: Vec::new(), part: None },
/// };
/// let folder = tempfile::tempdir()?;
/// let out = folder.path().join("camchain.yaml");
/// write_cameras(&CameraSet::of_stereo(&stereo), Format::Kalibr, &out)?;
/// let (again, _notes) = read_stereo(&out, 640, 480)?;
/// assert_eq!((again.left, again.right_from_left), (stereo.left, stereo.right_from_left));
/// // Nothing that exists is overwritten.
/// assert!(write_cameras(&CameraSet::of_stereo(&stereo), Format::Kalibr, &out).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_cameras(
    set: &CameraSet,
    format: Format,
    out: &Path,
) -> Result<(Vec<PathBuf>, Vec<Note>), WriteError> {
    let Written { files, mut notes } = written(set, format)?;
    if let Some(imu) = &set.imu {
        notes.extend(left_out(imu, format));
    }
    if out.symlink_metadata().is_ok() {
        return Err(WriteError::Exists {
            path: out.to_owned(),
        });
    }
    let paths = match (&files[..], out.extension()) {
        ([(_, bytes)], Some(_)) => {
            new_file(out, bytes)?;
            vec![out.to_owned()]
        }
        (_, Some(_)) => {
            let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
            return Err(WriteError::NeedsFolder {
                format: format.name(),
                files: names.join(" and "),
                path: out.to_owned(),
            });
        }
        (_, None) => new_folder(out, &files)?,
    };
    Ok((paths, notes))
}

/// Names and contents of the files, without writing any.
///
/// # Errors
/// [`WriteError`].
pub fn contents(set: &CameraSet, format: Format) -> Result<Vec<(String, Vec<u8>)>, WriteError> {
    Ok(written(set, format)?.files)
}

/// The contents of the files, without writing any.
pub(crate) fn written(set: &CameraSet, format: Format) -> Result<Written, WriteError> {
    match format {
        Format::ZedConf => zed_conf::write(&stereo(set, format)?),
        Format::Euroc => euroc::write(set),
        Format::Kitti => kitti::write(&stereo(set, format)?),
        Format::Pair => pair::write(&stereo(set, format)?),
        Format::Kalibr => kalibr::write(set),
        Format::Basalt => basalt::write(set),
        Format::OpenCv => opencv::write(set),
        Format::Colmap => colmap::write(set, colmap::Form::Text),
        Format::ColmapBin => colmap::write(set, colmap::Form::Binary),
        Format::Nerfstudio => nerfstudio::write(set),
        Format::Ros => ros::write(set),
        Format::Rosys => rosys::write(set),
        Format::Middlebury => middlebury::write(&stereo(set, format)?),
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
    set.stereo(None, Path::new(""))
        .map(|(stereo, _)| stereo)
        .map_err(|error| refused(error.to_string().trim_end_matches(": ").to_owned()))
}

/// The lens in the first of the models that means exactly the same, otherwise an error.
pub(crate) fn lens(
    camera: &str,
    distortion: &Distortion,
    format: Format,
) -> Result<Distortion, WriteError> {
    format
        .models()
        .iter()
        .find_map(|model| exactly(distortion, *model))
        .ok_or_else(|| WriteError::Lens {
            format: format.name(),
            camera: camera.to_owned(),
            model: distortion.name(),
            nearest: nearest(LensModel::of(distortion), format.models()).name(),
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
pub(crate) fn placed(
    camera: &NamedCamera,
    format: Format,
) -> Result<cad_transforms::RigidTransform, WriteError> {
    camera.camera_from_first.ok_or_else(|| WriteError::Refused {
        format: format.name(),
        found: format!("camera {} without a placement", camera.name),
        expected: "every camera's pose".to_owned(),
    })
}

fn left_out(imu: &crate::set::SetImu, format: Format) -> Option<Note> {
    let held: &[&str] = match format {
        Format::Kalibr => &["placement", "rate", "noise", "time offset"],
        Format::Basalt => &["placement", "rate", "noise", "time offset", "biases"],
        Format::Euroc => &["placement", "rate", "noise"],
        _ => &[],
    };
    let there = [
        ("placement", true),
        ("rate", imu.rate_hz.is_some()),
        ("noise", imu.noise.is_some()),
        ("time offset", imu.time_offset_s.is_some_and(|t| t != 0.0)),
        (
            "biases",
            imu.gyro_bias.is_some() || imu.accel_bias.is_some(),
        ),
    ];
    let lost: Vec<&str> = there
        .into_iter()
        .filter(|(what, there)| *there && !held.contains(what))
        .map(|(what, _)| what)
        .collect();
    (!lost.is_empty()).then(|| {
        Note(format!(
            "{} has no field for the IMU's {}: not written",
            format.name(),
            lost.join(", ")
        ))
    })
}

/// Writes a new file: completely under a temporary name in the same folder first.
pub(crate) fn new_file(path: &Path, bytes: &[u8]) -> Result<(), WriteError> {
    let failed = |source: io::Error| match source.kind() {
        io::ErrorKind::AlreadyExists => WriteError::Exists {
            path: path.to_owned(),
        },
        _ => WriteError::Write {
            path: path.to_owned(),
            source,
        },
    };
    let partial = partial(path);
    let result = (|| {
        let mut file = fs::File::create(&partial)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        // A link fails if the name exists, a rename does not.
        match fs::hard_link(&partial, path) {
            Err(e) if e.kind() != io::ErrorKind::AlreadyExists && !path.exists() => {
                // A file system without links: at least not over another file.
                let mut file = fs::OpenOptions::new()
                    .write(true)
                    .create_new(true)
                    .open(path)?;
                file.write_all(bytes)?;
                file.sync_all()
            }
            other => other,
        }
    })();
    // The temporary name is removed in any case; a failure is ignored.
    let _ = fs::remove_file(&partial);
    result.map_err(failed)
}

/// Makes a new folder with these files: under a temporary name first.
fn new_folder(out: &Path, files: &[(String, Vec<u8>)]) -> Result<Vec<PathBuf>, WriteError> {
    let failed = |source| WriteError::Write {
        path: out.to_owned(),
        source,
    };
    let partial = partial(out);
    fs::create_dir(&partial).map_err(failed)?;
    let result = (|| {
        for (name, bytes) in files {
            let path = partial.join(name);
            if let Some(folder) = path.parent() {
                fs::create_dir_all(folder)?;
            }
            let mut file = fs::File::create(path)?;
            file.write_all(bytes)?;
            file.sync_all()?;
        }
        // A non-empty folder is never replaced by a rename.
        fs::rename(&partial, out)
    })();
    if result.is_err() {
        let _ = fs::remove_dir_all(&partial);
    }
    result.map_err(failed)?;
    Ok(files.iter().map(|(name, _)| out.join(name)).collect())
}

/// The temporary name until the file is complete.
fn partial(path: &Path) -> PathBuf {
    let mut name = std::ffi::OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(format!(".{}.partial", std::process::id()));
    path.with_file_name(name)
}

#[cfg(test)]
mod tests;
