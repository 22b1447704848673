//! Writers of calibrations in the formats of other tools.
//!
//! Contract: nothing that exists is overwritten, and a file or folder appears completely or not at
//! all. A format that cannot represent a model exactly rejects it and names the nearest model that
//! it can, for [`convert`](camera_models::convert()); a larger model that means exactly the same is
//! used without asking (`radial2` as `radtan4` with zeros). Values that the format cannot represent
//! besides the lenses (biases, noise, a time offset) are reported in [`Note`]s.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use camera_models::{CameraSet, Note, SetImu};

use crate::entry::ImuField;
use crate::format::Format;
use crate::output::{FormatFiles, WriteError};
use crate::registry;

/// Writes a set. `out` is a file if its name has an extension and the format has one file,
/// otherwise a new folder. Returns the files and notes on what could not be represented.
///
/// # Errors
/// [`WriteError`]; then nothing was written.
///
/// ```
/// # use cad_transforms::RigidTransform;
/// # use calibration_files::{Format, read_stereo, write_cameras};
/// # use camera_models::{CameraModel, CameraSet, Distortion, Provenance, StereoCalibration};
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
    let FormatFiles { files, mut notes } = (registry::entry(format).write)(set)?;
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
    Ok((registry::entry(format).write)(set)?.files)
}

fn left_out(imu: &SetImu, format: Format) -> Option<Note> {
    let held = registry::entry(format).imu_fields;
    let there = [
        (ImuField::Placement, true),
        (ImuField::Rate, imu.rate_hz.is_some()),
        (ImuField::Noise, imu.noise.is_some()),
        (
            ImuField::TimeOffset,
            imu.time_offset_s.is_some_and(|t| t != 0.0),
        ),
        (
            ImuField::Biases,
            imu.gyro_bias.is_some() || imu.accel_bias.is_some(),
        ),
    ];
    let lost: Vec<&str> = there
        .into_iter()
        .filter(|(what, there)| *there && !held.contains(what))
        .map(|(what, _)| what.name())
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
fn new_file(path: &Path, bytes: &[u8]) -> Result<(), WriteError> {
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
