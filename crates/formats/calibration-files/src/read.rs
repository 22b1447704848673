//! Readers of calibrations of any format.

use std::path::{Path, PathBuf};

use camera_models::plausibility::wide;
use camera_models::{CameraSet, Distortion, NamedCamera, Note, StereoCalibration};

use crate::detect::detect;
use crate::entry::{Entry, SetResult};
use crate::error::CalibError;
use crate::files::{Disk, Files};
use crate::format::Format;
use crate::registry;

/// Maximum distance of a principal point from the image centre without a note, as a fraction of the
/// image size.
const MAX_CENTRE_OFFSET: f64 = 0.06;

/// Reads the calibration of a stereo camera from a file, or from a folder with one, for images of
/// `width` x `height` pixels (one eye, not side by side).
///
/// # Errors
/// [`CalibError`], naming the file and where possible the line.
///
/// ```
/// use calibration_files::read_stereo;
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("K.txt");
/// // A camera matrix and a baseline, of a pair that is rectified as delivered.
/// std::fs::write(&path, "700 0 639.5 0 700 359.5 0 0 1\n0.12\n")?;
/// let (stereo, _notes) = read_stereo(&path, 1280, 720)?;
/// assert!(stereo.is_rectified());
/// assert_eq!((stereo.left.fx, stereo.baseline_m()), (700.0, 0.12));
///
/// std::fs::write(&path, "no numbers\n")?;
/// let error = read_stereo(&path, 1280, 720).unwrap_err();
/// assert!(error.to_string().contains("K.txt"), "{error}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_stereo(
    path: &Path,
    width: u32,
    height: u32,
) -> Result<(StereoCalibration, Vec<Note>), CalibError> {
    let files: &dyn Files = &Disk;
    let (format, path) = detect(files, path)?;
    let entry = registry::entry(format);
    let Some(read_pair) = entry.read_pair else {
        let (set, mut notes) = read_set(files, entry, &path, Some([width, height]))?;
        let (stereo, more) = set.stereo(None).map_err(CalibError::invalid(&path))?;
        notes.extend(more);
        return Ok((stereo, notes));
    };
    let (stereo, mut notes) = read_pair(files, &path, [width, height])?;
    // Of an ASL folder the pair is taken from a set, which has this note already.
    if format != Format::Euroc {
        notes.extend(wide(stereo.baseline_m()));
    }
    Ok((stereo, notes))
}

/// Reads all cameras of a file, or of a folder with one. `size` is that of one image; it is
/// required if the file does not contain it, and must be equal to the file's otherwise.
///
/// # Errors
/// [`CalibError`], naming the file and where possible line and key.
///
/// A chain of Kalibr:
///
/// ```
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("camchain.yaml");
/// std::fs::write(
///     &path,
///     "cam0:
///   camera_model: pinhole
///   distortion_model: radtan
///   distortion_coeffs: [-0.28, 0.07, 0.0002, 0.00002]
///   intrinsics: [458.65, 457.3, 367.2, 248.4]
///   resolution: [752, 480]
/// ",
/// )?;
/// let (set, _notes) = calibration_files::read_cameras(&path, None)?;
/// let model = &set.cameras[0].model;
/// assert_eq!((model.width, model.fx), (752, 458.65));
/// assert_eq!(model.distortion.name(), "rad_tan4");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// A file of OpenCV:
///
/// ```
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("camera.yml");
/// std::fs::write(
///     &path,
///     "%YAML:1.0
/// ---
/// camera_matrix: !!opencv-matrix
///    rows: 3
///    cols: 3
///    dt: d
///    data: [ 535.5, 0., 342.25, 0., 535.5, 235.5, 0., 0., 1. ]
/// distortion_coefficients: !!opencv-matrix
///    rows: 1
///    cols: 5
///    dt: d
///    data: [ -0.25, 0.1, 0., 0., 0. ]
/// ",
/// )?;
/// // The file has no image size, so the caller gives it.
/// let (set, _notes) = calibration_files::read_cameras(&path, Some([640, 480]))?;
/// let model = &set.cameras[0].model;
/// assert_eq!((model.fx, model.cx, model.height), (535.5, 342.25, 480));
/// assert!(calibration_files::read_cameras(&path, None).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_cameras(
    path: &Path,
    size: Option<[u32; 2]>,
) -> Result<(CameraSet, Vec<Note>), CalibError> {
    let files: &dyn Files = &Disk;
    let (format, path) = detect(files, path)?;
    let (set, mut notes) = read_set(files, registry::entry(format), &path, size)?;
    notes.extend(
        set.plausibility_notes()
            .map_err(CalibError::invalid(&path))?,
    );
    for NamedCamera { name, model, .. } in &set.cameras {
        let off = |c: f64, size: u32| c - 0.5 * (f64::from(size) - 1.0);
        let (x, y) = (off(model.cx, model.width), off(model.cy, model.height));
        let limit = |size: u32| MAX_CENTRE_OFFSET * f64::from(size);
        // Cropping after rectification may move it anywhere.
        if model.distortion != Distortion::None
            && (x.abs() > limit(model.width) || y.abs() > limit(model.height))
        {
            notes.push(Note(format!(
                "camera {name}: the principal point is ({x:.0}, {y:.0}) px off the middle of {}x{}: is the size right?",
                model.width, model.height
            )));
        }
    }
    Ok((set, notes))
}

/// Format of a path: the format, and the file, or the folder of an ASL data set.
///
/// # Errors
/// [`CalibError::Unrecognised`], [`CalibError::Read`].
pub fn detect_format(path: &Path) -> Result<(Format, PathBuf), CalibError> {
    detect(&Disk, path)
}

/// Reads a set, and compares the sizes of its images with the requested one.
fn read_set(files: &dyn Files, entry: &Entry, path: &Path, size: Option<[u32; 2]>) -> SetResult {
    let (set, notes) = (entry.read)(files, path, size)?;
    if let Some([width, height]) = size
        && let Some(other) = set
            .cameras
            .iter()
            .find(|c| [c.model.width, c.model.height] != [width, height])
    {
        return Err(CalibError::Resolution {
            path: path.to_owned(),
            width,
            height,
            found: format!(
                "{}x{} ({})",
                other.model.width, other.model.height, other.name
            ),
        });
    }
    Ok((set, notes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::Folder;

    #[test]
    fn implausible_pairs_are_noted_in_any_format() {
        let folder = Folder::new();
        let chain = |x: &str| {
            let camera = "camera_model: pinhole, intrinsics: [500, 500, 320, 240], distortion_model: none, resolution: \
                          [640, 480]";
            let text = format!(
                "cam0: {{{camera}}}\ncam1: {{{camera}, T_cn_cnm1: [[1, 0, 0, {x}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, \
                 0, 1]]}}\n"
            );
            let (_, notes) = read_cameras(&folder.file("chain.yaml", &text), None).unwrap();
            notes.into_iter().map(|note| note.0).collect::<Vec<_>>()
        };
        assert_eq!(chain("-0.063"), [""; 0]);
        // Two cameras without names may be anywhere.
        let swapped = chain("0.063");
        assert!(
            swapped.len() == 1
                && swapped[0].contains("cam0 sits to the right of cam1: are they swapped?"),
            "{swapped:?}"
        );
        let wide = chain("-6.3");
        assert!(
            wide.len() == 1
                && wide[0].contains("cam1 is 6.3 m from the first camera: is the file in metres?"),
            "{wide:?}"
        );

        let rosys = |x: &str| {
            let camera = |name: &str, x: &str| {
                format!(
                    "\"{name}\": {{\"calibration\": {{\"intrinsics\": {{\"matrix\": [[500, 0, 320], [0, 500, 240], [0, 0, \
                     1]], \"distortion\": [0, 0, 0, 0, 0], \"size\": {{\"width\": 640, \"height\": 480}}}}, \
                     \"extrinsics\": {{\"x\": {x}, \"y\": 0, \"z\": 0, \"rotation\": {{\"R\": [[1, 0, 0], [0, 1, 0], \
                     [0, 0, 1]]}}, \"_frame_id\": \"rig\"}}}}}}"
                )
            };
            let text = format!(
                "{{\"cameras\": {{{}, {}}}}}",
                camera("left", "0"),
                camera("right", x)
            );
            read_cameras(&folder.file("cameras.json", &text), None)
        };
        assert!(rosys("0.063").unwrap().1.is_empty());
        let error = rosys("-0.063").unwrap_err().to_string();
        assert!(error.contains("left and right swapped"), "{error}");

        // Formats of pairs only, by either reader.
        let zed = "[LEFT_CAM_HD]\nfx=700\nfy=700\ncx=640\ncy=360\nk1=0.1\nk2=0\np1=0\np2=0\nk3=0\n[RIGHT_CAM_HD]\n\
                   fx=700\nfy=700\ncx=640\ncy=360\nk1=0.1\nk2=0\np1=0\np2=0\nk3=0\n[STEREO]\nBaseline=6300\nTY=0\nTZ=0\n\
                   CV_HD=0\nRX_HD=0\nRZ_HD=0\n";
        let path = folder.file("SN1.conf", zed);
        let (_, notes) = read_stereo(&path, 1280, 720).unwrap();
        assert!(
            notes.len() == 1 && notes[0].0.contains("6.3 m"),
            "{notes:?}"
        );
        let (_, notes) = read_cameras(&path, Some([1280, 720])).unwrap();
        assert!(
            notes.len() == 1 && notes[0].0.contains("6.3 m"),
            "{notes:?}"
        );
    }

    #[test]
    fn an_absent_file_is_named() {
        let error = read_stereo(Path::new("no/such.conf"), 1, 1)
            .unwrap_err()
            .to_string();
        assert_eq!(error, "reading a calibration file: no/such.conf");
    }
}
