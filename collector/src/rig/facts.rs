//! What factory files say of a rig's cameras.

use std::path::Path;

use anyhow::{Context, Result};
use cad_transforms::FieldOfView;
use cad_transforms::rig::check::{CameraFacts, Facts};

use crate::cli::BadArguments;

/// Sizes of one picture, tried in this order where none is given: a calibration file may be for one size only.
const SIZES: [[u32; 2]; 7] = [
    [1280, 720],
    [1920, 1200],
    [1920, 1080],
    [960, 600],
    [2208, 1242],
    [672, 376],
    [752, 480],
];

/// Reads the calibrations of `--calibration`.
pub(super) fn read(arguments: &[String]) -> Result<Facts> {
    let mut facts = Facts::new();
    for argument in arguments {
        let bad = || {
            let what = format!(
                "--calibration {argument:?} is not CAMERA=FILE or CAMERA=FILE@WIDTHxHEIGHT"
            );
            BadArguments(what)
        };
        let (camera, file) = argument.split_once('=').ok_or_else(bad)?;
        let (file, size) = match file.rsplit_once('@') {
            Some((file, size)) => {
                let (width, height) = size.split_once('x').ok_or_else(bad)?;
                let number = |text: &str| text.parse::<u32>().map_err(|_| bad());
                (file, Some([number(width)?, number(height)?]))
            }
            None => (file, None),
        };
        let known = of_camera(Path::new(file), size)
            .with_context(|| format!("reading the calibration of {camera}"))?;
        if facts.insert(camera.to_owned(), known).is_some() {
            let what = format!("--calibration names {camera} twice");
            return Err(BadArguments(what).into());
        }
    }
    Ok(facts)
}

fn of_camera(path: &Path, size: Option<[u32; 2]>) -> Result<CameraFacts> {
    let sizes = size.map_or(SIZES.to_vec(), |size| vec![size]);
    let mut first_error = None;
    for [width, height] in sizes {
        let calibration = match calib::read_stereo(path, width, height) {
            Ok((calibration, _)) => calibration,
            Err(error) => {
                first_error.get_or_insert(error);
                continue;
            }
        };
        let left = &calibration.left;
        let view = FieldOfView::from_pinhole(
            [left.width, left.height],
            [left.fx, left.fy],
            [left.cx, left.cy],
        );
        let file = path
            .file_name()
            .unwrap_or(path.as_os_str())
            .to_string_lossy();
        return Ok(CameraFacts {
            source: format!("{file} at {width}x{height}"),
            left_from_right: Some(calibration.right_from_left.inverse()),
            view,
            serial: serial(&file),
        });
    }
    Err(first_error.expect("there is a size").into())
}

/// The number in `SN12345678.conf`.
fn serial(file: &str) -> Option<String> {
    let digits = file.strip_prefix("SN")?.strip_suffix(".conf")?;
    let all_digits = !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit());
    all_digits.then(|| digits.to_owned())
}
