//! Factory calibrations of a rig's cameras.

use std::path::Path;

use anyhow::{Context, Result};
use cad_transforms::FieldOfView;
use cad_transforms::rig::check::{CameraFacts, Facts};
use calibration_files::{CalibError, Format, detect_format, zed_conf};
use camera_models::StereoCalibration;
use console_output::BadArguments;

/// Sizes of one image, tried in this order if none is given: a ZED file has some of them.
const SIZES: [[u32; 2]; 6] = [
    [1280, 720],
    [1920, 1200],
    [1920, 1080],
    [960, 600],
    [2208, 1242],
    [672, 376],
];

/// Reads the calibrations of `--calibration`.
pub(super) fn read(arguments: &[String]) -> Result<Facts> {
    let mut facts = Facts::new();
    for argument in arguments {
        let Some((camera, file)) = argument.split_once('=') else {
            let what = format!(
                "--calibration {argument:?} is not CAMERA=FILE or CAMERA=FILE@WIDTHxHEIGHT"
            );
            return Err(BadArguments(what).into());
        };
        // Anything else after an @ is part of the path.
        let (file, size) = match file.rsplit_once('@') {
            Some((file, size)) if size_of(size).is_some() => (file, size_of(size)),
            _ => (file, None),
        };
        let known = match of_camera(Path::new(file), size) {
            Err(CalibError::SizeUnknown { found, .. }) => {
                let what = format!(
                    "--calibration {argument}: found {found}, expected the size of an image, which the file \
                     does not state: give it as {camera}={file}@WIDTHxHEIGHT"
                );
                return Err(BadArguments(what).into());
            }
            other => other.with_context(|| format!("reading the calibration of {camera}"))?,
        };
        if facts.insert(camera.to_owned(), known).is_some() {
            let what = format!("--calibration names {camera} twice");
            return Err(BadArguments(what).into());
        }
    }
    Ok(facts)
}

/// `WIDTHxHEIGHT`.
fn size_of(text: &str) -> Option<[u32; 2]> {
    let (width, height) = text.split_once('x')?;
    Some([width.parse().ok()?, height.parse().ok()?])
}

fn of_camera(path: &Path, size: Option<[u32; 2]>) -> Result<CameraFacts, CalibError> {
    let (format, file) = detect_format(path)?;
    let calibration = calibration(path, format, size)?;
    let left = &calibration.left;
    let view = FieldOfView::from_pinhole(
        [left.width, left.height],
        [left.fx, left.fy],
        [left.cx, left.cy],
    );
    // For a data set of many files, the named folder.
    let named = if file.is_file() { &file } else { path };
    let name = named.file_name().unwrap_or(named.as_os_str());
    let serial = match format {
        Format::ZedConf => zed_conf::serial_in_name(&file).map(str::to_owned),
        _ => None,
    };
    Ok(CameraFacts {
        source: format!(
            "{} at {}x{}",
            name.to_string_lossy(),
            left.width,
            left.height
        ),
        left_from_right: Some(calibration.right_from_left.inverse()),
        view,
        serial,
    })
}

/// The calibration for images of a size. Without a size it is that of the file, and for a ZED file
/// the first of [`SIZES`] that the file has; if that section is damaged, no other is tried.
fn calibration(
    path: &Path,
    format: Format,
    size: Option<[u32; 2]>,
) -> Result<StereoCalibration, CalibError> {
    let read = |[width, height]: [u32; 2]| {
        calibration_files::read_stereo(path, width, height).map(|(calibration, _)| calibration)
    };
    if let Some(size) = size {
        return read(size);
    }
    if format != Format::ZedConf {
        let (set, _) = calibration_files::read_cameras(path, None)?;
        let own = set.cameras.first();
        return read(own.map_or([0, 0], |own| [own.model.width, own.model.height]));
    }
    let mut found = read(SIZES[0]);
    for size in &SIZES[1..] {
        match found {
            Err(CalibError::Resolution { .. }) => found = read(*size),
            _ => break,
        }
    }
    found
}
