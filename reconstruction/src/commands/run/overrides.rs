//! Calibrations given to `paws-reconstruct run` in addition to the session.
//!
//! Contract: the session is not touched. Every file that is read is listed in
//! [`RigOverrides::files`] with its hash, which goes into the bundle. Values set before are kept: a
//! folder does not replace a file that is given individually.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use cad_transforms::rig::Rig;
use cad_transforms::{Frame, FramePart};
use reconstruction::Input;
use reconstruction::pipeline::stages::rig::{OverrideFile, RigOverrides};

/// The rig file of `paws calib cameras`, and that of `paws calib camera-imu`, which includes the
/// IMUs.
const RIG_FILES: [&str; 2] = ["rig.toml", "rig-imu.toml"];
/// Tolerance for equal poses, m and rad: rig files hold all digits.
const POSE_TOLERANCE: f64 = 1e-9;

/// Reads a folder written by `paws calib`: the rig file, that with IMUs if there is one, and the
/// intrinsics of each camera of the session that has a file there; only values that are not set
/// yet.
///
/// # Errors
/// The folder has none of these files, a file cannot be read, or the two rig files are of different
/// calibrations.
pub(super) fn folder(rig_overrides: &mut RigOverrides, folder: &Path, input: &Input) -> Result<()> {
    let [cameras, imus] = RIG_FILES.map(|name| folder.join(name));
    if cameras.exists() && imus.exists() {
        same_cameras(&cameras, &imus)?;
    }
    let best = [&imus, &cameras].into_iter().find(|path| path.exists());
    let mut found = usize::from(best.is_some());
    if let (Some(best), None) = (best, &rig_overrides.rig) {
        rig(rig_overrides, best)?;
    }
    for camera in &input.manifest().cameras {
        let file = folder.join(format!("{}.yaml", camera.name));
        if !file.exists() {
            continue;
        }
        found += 1;
        if !rig_overrides.calibrations.contains_key(&camera.name) {
            lenses(rig_overrides, &camera.name, &file, input)?;
        }
    }
    let names = input.manifest().cameras.iter();
    let names: Vec<String> = names
        .map(|camera| format!("{}.yaml", camera.name))
        .collect();
    ensure!(
        found > 0,
        "taking a calibration: found neither {} nor {}, expected what `{}` writes: {}",
        RIG_FILES.join(" nor "),
        names.join(" nor "),
        command_line::remedy::CALIBRATE,
        folder.display()
    );
    Ok(())
}

/// A rig file with IMUs whose cameras differ from those of the other rig file is outdated.
fn same_cameras(cameras: &Path, imus: &Path) -> Result<()> {
    let (of_cameras, of_imus) = (Rig::read(cameras)?, Rig::read(imus)?);
    for camera in of_cameras.cameras() {
        let left = Frame::of_camera(camera, FramePart::Left)?;
        let at = of_cameras.transform(&Frame::rig(), &left)?;
        let same = of_imus.transform(&Frame::rig(), &left).is_ok_and(|other| {
            let off = at.inverse() * other;
            off.distance_m() < POSE_TOLERANCE && off.angle_rad() < POSE_TOLERANCE
        });
        ensure!(
            same,
            "taking a calibration: {} and {} have different poses of {camera}, expected the same; \
             `{}` --force recomputes the latter: {}",
            RIG_FILES[0],
            RIG_FILES[1],
            command_line::remedy::CALIBRATE_IMUS,
            imus.display()
        );
    }
    Ok(())
}

/// Reads a rig file.
///
/// # Errors
/// It cannot be read.
pub(super) fn rig(rig_overrides: &mut RigOverrides, path: &Path) -> Result<()> {
    let text = plain_file::read_to_string(path, plain_file::TEXT_LIMIT);
    let text = text.with_context(|| format!("reading {}", path.display()))?;
    note(rig_overrides, path, text.as_bytes());
    rig_overrides.rig = Some(text);
    Ok(())
}

/// Reads the intrinsics of a camera.
///
/// # Errors
/// The session has no such camera, or the file cannot be read.
pub(super) fn lenses(
    rig_overrides: &mut RigOverrides,
    camera: &str,
    path: &Path,
    input: &Input,
) -> Result<()> {
    let cameras = &input.manifest().cameras;
    let Some(recorded) = cameras.iter().find(|c| c.name == *camera) else {
        let known: Vec<&str> = cameras.iter().map(|c| c.name.as_str()).collect();
        bail!(
            "taking a calibration: the session has no camera {camera:?}, expected one of {}",
            known.join(", ")
        );
    };
    let (width, height) = (recorded.width / 2, recorded.height);
    let (calibration, notes) = calibration_files::read_stereo(path, width, height)?;
    for note in notes {
        log::warn!("{}: {}", path.display(), note.0);
    }
    for file in &calibration.provenance.files {
        let bytes = plain_file::read(file, plain_file::DOCUMENT_LIMIT)
            .with_context(|| format!("reading {}", file.display()))?;
        note(rig_overrides, file, &bytes);
    }
    rig_overrides
        .calibrations
        .insert(camera.to_owned(), calibration);
    Ok(())
}

fn note(rig_overrides: &mut RigOverrides, path: &Path, bytes: &[u8]) {
    let name = path.file_name().unwrap_or(path.as_os_str());
    let given = OverrideFile {
        file: name.to_string_lossy().into_owned(),
        blake3: blake3::hash(bytes).to_hex().to_string(),
    };
    if !rig_overrides.files.contains(&given) {
        rig_overrides.files.push(given);
    }
}
