//! `K.txt` of a rectified pair: nine numbers of the camera matrix on the first line, rows first,
//! and the baseline in metres on the second. FoundationStereo's demo data has this form.
//!
//! Contract: both cameras are the same ideal pinhole, the right one displaced along x. The file has
//! no resolution; that the principal point is inside the image is the only possible check.

use std::path::Path;

use cad_transforms::RigidTransform;
use camera_models::plausibility::MAX_BASELINE_M;
use camera_models::{CameraModel, CameraSet, Distortion, LensModel, Provenance, StereoCalibration};

use crate::entry::{Entry, InFolder, PairResult, SetResult, Signs, is_number_like};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::output::{FormatFiles, WriteError, stereo};
use crate::text::{number_text, number_texts};

/// The format.
pub(crate) const ENTRY: Entry = Entry {
    format: Format::Pair,
    models: MODELS,
    imu_fields: &[],
    in_folder: InFolder::Named(&["K.txt"]),
    signs: Signs {
        words: Some(|words| words.len() == 9 && is_number_like(words[0])),
        ..Signs::NONE
    },
    read,
    read_pair: Some(read_pair),
    write,
};

/// The lens models of the format, the smallest of a family first.
const MODELS: &[LensModel] = &[LensModel::None];

/// Reads a `K.txt` for images of `width` x `height` pixels.
///
/// # Errors
/// [`CalibError`].
fn read_pair(files: &dyn Files, path: &Path, [width, height]: [u32; 2]) -> PairResult {
    let source = files.text(path)?;
    let lines: Vec<(usize, &str)> = source
        .lines()
        .filter(|(_, line)| !line.is_empty())
        .collect();
    let [(k_line, k_text), (baseline_line, baseline_text)] = lines[..] else {
        let found = format!("{} lines", lines.len());
        return Err(source.missing(
            "a line with the camera matrix and one with the baseline",
            &found,
        ));
    };
    let k = source.numbers(k_line, k_text)?;
    let [fx, skew, cx, zero, fy, cy, a, b, c] = k[..] else {
        return Err(source.malformed(
            k_line,
            k_text,
            "nine numbers of the camera matrix, rows first",
        ));
    };
    if (skew, zero, a, b, c) != (0.0, 0.0, 0.0, 0.0, 1.0) {
        return Err(source.malformed(k_line, k_text, "the form fx 0 cx 0 fy cy 0 0 1"));
    }
    let baseline_m = source.number(baseline_line, baseline_text)?;
    if !(baseline_m > 0.0 && baseline_m <= MAX_BASELINE_M) {
        let expected = format!("a baseline in metres, above 0 and at most {MAX_BASELINE_M}");
        return Err(source.malformed(baseline_line, baseline_text, &expected));
    }
    let camera = CameraModel::new((width, height), [fx, fy, cx, cy], Distortion::None);
    let calibration = StereoCalibration {
        left: camera,
        right: camera,
        right_from_left: RigidTransform::from_translation_m([-baseline_m, 0.0, 0.0])
            .expect("the baseline is finite"),
        imu: None,
        provenance: Provenance {
            format: Some(Format::Pair.name().to_owned()),
            files: vec![path.to_owned()],
            part: None,
        },
    };
    calibration
        .validate()
        .map_err(CalibError::invalid(path))
        .map(|calibration| (calibration, Vec::new()))
}

/// Reads a file as a set of two cameras.
fn read(files: &dyn Files, path: &Path, size: Option<[u32; 2]>) -> SetResult {
    let size = size.ok_or_else(|| CalibError::SizeUnknown {
        path: path.to_owned(),
        found: "camera matrices alone".to_owned(),
    })?;
    let (stereo, notes) = read_pair(files, path, size)?;
    Ok((CameraSet::of_stereo(&stereo), notes))
}

fn write(set: &CameraSet) -> Result<FormatFiles, WriteError> {
    let stereo = &stereo(set, Format::Pair)?;
    if !stereo.is_rectified() || stereo.left != stereo.right {
        return Err(WriteError::Refused {
            format: Format::Pair.name(),
            found: "two different cameras, or a pair that is not rectified".to_owned(),
            expected: "a rectified pair with one camera matrix: rectify it first".to_owned(),
        });
    }
    let [x, ..] = stereo.right_from_left.translation_m();
    let k = number_texts(&stereo.left.k_matrix(), " ");
    Ok(FormatFiles::file(
        "K.txt",
        format!("{k}\n{}\n", number_text(-x)),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::Disk;
    use crate::test_data::{Folder, shared};

    /// The reader on files on disk.
    fn read(path: &Path, width: u32, height: u32) -> PairResult {
        super::read_pair(&Disk, path, [width, height])
    }

    #[test]
    fn the_desk_pair() {
        let Some(path) = shared("01_stereo_depth/foundationstereo_demo/K.txt") else {
            return;
        };
        let (calibration, notes) = read(&path, 960, 540).unwrap();
        assert_eq!(
            calibration.left.k_matrix()[..3],
            [754.6680908203125, 0.0, 489.3794860839844]
        );
        assert_eq!(calibration.left.cy, 265.16162109375);
        assert_eq!(
            calibration.right_from_left.translation_m(),
            [-0.063, 0.0, 0.0]
        );
        assert_eq!(calibration.left, calibration.right);
        assert!(calibration.is_rectified() && notes.is_empty());
        // A quarter of the size: detected by the principal point.
        assert!(matches!(
            read(&path, 480, 270),
            Err(CalibError::Implausible { .. })
        ));
    }

    #[test]
    fn invalid_files_are_rejected() {
        let folder = Folder::new();
        let check = |text: &str, expected: &str| {
            let error = read(&folder.file("K.txt", text), 640, 480)
                .unwrap_err()
                .to_string();
            assert!(
                error.contains(expected),
                "found {error:?}, expected {expected:?}"
            );
            assert!(error.ends_with("K.txt"), "{error}");
        };
        check("500 0 320 0 500 240 0 0 1\n", "found 1 lines");
        check("500 0 320 0 500 240 0 0\n0.1\n", "line 1: found");
        check(
            "500 1 320 0 500 240 0 0 1\n0.1\n",
            "expected the form fx 0 cx 0 fy cy 0 0 1",
        );
        check(
            "500 0 320 0 500 240 0 0 1\n63\n",
            "line 2: found \"63\", expected a baseline in metres",
        );
        check(
            "500 0 320 0 500 240 0 0 1\n0,063\n",
            "line 2: found \"0,063\", expected a decimal point",
        );
        check(
            "500 0 320 0 nan 240 0 0 1\n0.1\n",
            "line 1: found \"nan\", expected a finite number",
        );
        check(
            "-500 0 320 0 500 240 0 0 1\n0.1\n",
            "left camera: focal lengths -500 and 500",
        );
    }
}
