//! KITTI odometry `calib.txt`: 3x4 projection matrices of rectified cameras, one per line, with or
//! without the labels `P0:` to `P3:` (Geiger et al. 2012).
//!
//! Contract: `P = K [I | t]` with `t` the origin of the rectified reference camera in this one, so
//! that the pair's offset is the difference of two such `t`, not a single entry. P0 and P1 are the
//! grey cameras, P2 and P3 the colour ones; the folders beside the file show which of them the
//! images come from (`image_2` without `image_0` means colour). The file has no resolution.

use std::path::Path;

use cad_transforms::RigidTransform;
use camera_models::{
    CameraModel, CameraSet, Distortion, LensModel, Note, Provenance, StereoCalibration,
};

use crate::entry::{Entry, InFolder, PairResult, SetResult, Signs, is_number_like};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::output::{FormatFiles, WriteError, stereo};
use crate::text::{Source, number_texts};

/// The format.
pub(crate) const ENTRY: Entry = Entry {
    format: Format::Kitti,
    models: MODELS,
    imu_fields: &[],
    in_folder: InFolder::Named(&["calib.txt"]),
    signs: Signs {
        words: Some(|words| match words {
            [label, ..] if is_projection_label(label) => true,
            [number, ..] => words.len() == 12 && is_number_like(number),
            [] => false,
        }),
        ..Signs::NONE
    },
    read,
    read_pair: Some(read_pair),
    write,
};

/// The lens models of the format, the smallest of a family first.
const MODELS: &[LensModel] = &[LensModel::None];

/// Reads a `calib.txt` for images of `width` x `height` pixels.
///
/// # Errors
/// [`CalibError`].
fn read_pair(files: &dyn Files, path: &Path, [width, height]: [u32; 2]) -> PairResult {
    let source = files.text(path)?;
    let mut projections: [Option<Projection>; 4] = [None; 4];
    let mut unlabelled = 0;
    for (line, text) in source.lines().filter(|(_, text)| !text.is_empty()) {
        let (index, numbers) = match text.split_once(':') {
            Some((label, rest)) => match projection_index(label) {
                Some(index) => (index, rest),
                None => continue, // Tr: of the laser scanner and the like
            },
            None => {
                unlabelled += 1;
                (unlabelled - 1, text)
            }
        };
        let Some(slot) = projections.get_mut(index) else {
            return Err(source.malformed(line, text, "at most four projection matrices"));
        };
        if slot.is_some() {
            return Err(source.malformed(line, text, &format!("P{index} only once")));
        }
        *slot = Some(Projection::parse(&source, line, numbers)?);
    }
    let beside = |name: &str| {
        path.parent()
            .is_some_and(|folder| files.is_folder(&folder.join(name)))
    };
    let (l, r) = if beside("image_2") && !beside("image_0") {
        (2, 3)
    } else {
        (0, 1)
    };
    let (Some(left), Some(right)) = (projections[l], projections[r]) else {
        let found: Vec<String> = (0..4)
            .filter(|i| projections[*i].is_some())
            .map(|i| format!("P{i}"))
            .collect();
        let found = if found.is_empty() {
            "no projection matrix".to_owned()
        } else {
            found.join(" ")
        };
        return Err(source.missing(&format!("P{l} or P{r}"), &found));
    };
    let mut notes = Vec::new();
    if projections.iter().flatten().count() > 2 {
        notes.push(Note(format!("of the four cameras, P{l} and P{r} are used")));
    }
    let offset = std::array::from_fn(|i| right.origin[i] - left.origin[i]);
    let right_from_left =
        RigidTransform::from_translation_m(offset).map_err(|error| CalibError::Implausible {
            path: path.to_owned(),
            reason: format!("offset {offset:?} between P{l} and P{r}: {error}"),
        })?;
    let calibration = StereoCalibration {
        left: left.camera(width, height),
        right: right.camera(width, height),
        right_from_left,
        imu: None,
        provenance: Provenance {
            format: Some(Format::Kitti.name().to_owned()),
            files: vec![path.to_owned()],
            part: Some(format!("P{l} P{r}")),
        },
    };
    calibration
        .validate()
        .map_err(CalibError::invalid(path))
        .map(|calibration| (calibration, notes))
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

/// Whether a word is one of `P0:` to `P3:`.
fn is_projection_label(word: &str) -> bool {
    word.strip_suffix(':')
        .is_some_and(|label| projection_index(label).is_some())
}

fn projection_index(label: &str) -> Option<usize> {
    ["P0", "P1", "P2", "P3"]
        .iter()
        .position(|known| *known == label)
}

#[derive(Clone, Copy)]
struct Projection {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Origin of the reference camera in this camera, metres.
    origin: [f64; 3],
}

impl Projection {
    fn parse(source: &Source, line: usize, text: &str) -> Result<Self, CalibError> {
        let numbers = source.numbers(line, text)?;
        let [fx, skew, cx, x, zero, fy, cy, y, a, b, c, z] = numbers[..] else {
            let expected = format!(
                "12 numbers of a projection matrix, there are {}",
                numbers.len()
            );
            return Err(source.malformed(line, text, &expected));
        };
        if (skew, zero, a, b, c) != (0.0, 0.0, 0.0, 0.0, 1.0) || fx == 0.0 || fy == 0.0 {
            return Err(source.malformed(line, text, "the form fx 0 cx x 0 fy cy y 0 0 1 z"));
        }
        // The last column is K t.
        Ok(Self {
            fx,
            fy,
            cx,
            cy,
            origin: [(x - cx * z) / fx, (y - cy * z) / fy, z],
        })
    }

    fn camera(&self, width: u32, height: u32) -> CameraModel {
        let Self { fx, fy, cx, cy, .. } = *self;
        CameraModel::new((width, height), [fx, fy, cx, cy], Distortion::None)
    }
}

fn write(set: &CameraSet) -> Result<FormatFiles, WriteError> {
    let stereo = &stereo(set, Format::Kitti)?;
    let undistorted = [&stereo.left, &stereo.right]
        .iter()
        .all(|camera| camera.distortion == Distortion::None);
    if !undistorted || stereo.right_from_left.angle_rad() > 1e-12 {
        return Err(WriteError::Refused {
            format: Format::Kitti.name(),
            found: "distorted images, or cameras that are rotated".to_owned(),
            expected: "a rectified pair: rectify it first".to_owned(),
        });
    }
    let row = |label: &str, m: &CameraModel, [x, y, z]: [f64; 3]| {
        let p = [
            [m.fx, 0.0, m.cx, m.fx * x + m.cx * z],
            [0.0, m.fy, m.cy, m.fy * y + m.cy * z],
            [0.0, 0.0, 1.0, z],
        ];
        format!("{label}: {}\n", number_texts(p.as_flattened(), " "))
    };
    let text = row("P0", &stereo.left, [0.0; 3])
        + &row("P1", &stereo.right, stereo.right_from_left.translation_m());
    Ok(FormatFiles::file("calib.txt", text))
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
    fn the_real_sequence() {
        let Some(path) = shared("02_stereo_odometry_kitti/KITTI_sequence_1/calib.txt") else {
            return;
        };
        let (calibration, notes) = read(&path, 1226, 370).unwrap();
        assert_eq!(
            calibration.left.k_matrix(),
            [
                707.0912, 0.0, 601.8873, 0.0, 707.0912, 183.1104, 0.0, 0.0, 1.0
            ]
        );
        assert_eq!(calibration.left, calibration.right);
        // 379.8145 / 707.0912 = 0.53715… m, the baseline KITTI states as about 0.54 m.
        assert_eq!(
            calibration.right_from_left.translation_m(),
            [-379.8145 / 707.0912, 0.0, 0.0]
        );
        assert!(calibration.is_rectified() && notes.is_empty());
    }

    #[test]
    fn colour_cameras_by_the_folders_beside() {
        // P2 and P3 of an official file: neither camera is the reference.
        let text = "P0: 718 0 607 0 0 718 185 0 0 0 1 0\nP1: 718 0 607 -386 0 718 185 0 0 0 1 0\n\
                    P2: 718 0 607 45 0 718 185 -0.1 0 0 1 0.005\nP3: 718 0 607 -337 0 718 185 2.3 0 0 1 0.003\n\
                    Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n";
        let folder = Folder::new();
        let path = folder.file("calib.txt", text);
        let (grey, notes) = read(&path, 1241, 376).unwrap();
        assert_eq!(
            grey.right_from_left.translation_m(),
            [-386.0 / 718.0, 0.0, 0.0]
        );
        assert_eq!(
            notes,
            [Note("of the four cameras, P0 and P1 are used".to_owned())]
        );

        folder.file("image_2/000000.png", "");
        let (colour, _) = read(&path, 1241, 376).unwrap();
        let [x, y, z] = colour.right_from_left.translation_m();
        // A point's projection through P2 and P3 must agree with the recovered offset.
        let p = [1.5, -0.4, 7.0];
        let project = |p: [f64; 3], t: [f64; 3], w: f64| {
            let depth = p[2] + w;
            [
                (718.0 * p[0] + 607.0 * p[2] + t[0]) / depth,
                (718.0 * p[1] + 185.0 * p[2] + t[1]) / depth,
            ]
        };
        let through_p3 = project(p, [-337.0, 2.3, 0.0], 0.003);
        let in_left = [
            p[0] + (45.0 - 607.0 * 0.005) / 718.0,
            p[1] + (-0.1 - 185.0 * 0.005) / 718.0,
            p[2] + 0.005,
        ];
        let in_right = [in_left[0] + x, in_left[1] + y, in_left[2] + z];
        let direct = project(in_right, [0.0; 3], 0.0);
        assert!(
            (through_p3[0] - direct[0]).abs() < 1e-9 && (through_p3[1] - direct[1]).abs() < 1e-9
        );
        assert_eq!(colour.provenance.part.as_deref(), Some("P2 P3"));
    }

    #[test]
    fn invalid_files_are_rejected() {
        let folder = Folder::new();
        let good = "500 0 320 0 0 500 240 0 0 0 1 0";
        let right = "500 0 320 -50 0 500 240 0 0 0 1 0";
        let check = |text: &str, expected: &str| {
            let error = read(&folder.file("calib.txt", text), 640, 480)
                .unwrap_err()
                .to_string();
            assert!(
                error.contains(expected),
                "found {error:?}, expected {expected:?}"
            );
            assert!(error.ends_with("calib.txt"), "{error}");
        };
        check("", "P0 or P1 is missing, found no projection matrix");
        check(
            &format!("P0: {good}\nP2: {right}\n"),
            "P0 or P1 is missing, found P0 P2",
        );
        check(&format!("P0: {good}\nP0: {right}\n"), "line 2: found");
        check(
            &format!("{good}\n500 0 320\n"),
            "line 2: found \"500 0 320\", expected 12 numbers",
        );
        check(
            &format!("{good}\n{}\n", right.replace("-50", "-50,5")),
            "a decimal point",
        );
        check(
            &format!("{good}\n{}\n", right.replace("500 0 320", "500 2 320")),
            "expected the form",
        );
        check(
            &format!(
                "{good}\n{}\n",
                right.replace("500 0 320 -50", "1e-300 0 320 -1e20")
            ),
            "a component is not a finite number",
        );
        check(
            &format!("{good}\n{}\n", right.replace("-50", "-25000")),
            "the cameras are 50 m apart",
        );
        check(&format!("{right}\n{good}\n"), "are left and right swapped?");
        check(
            &format!("{good}\n{right}\n{good}\n{good}\n{good}\n"),
            "at most four",
        );
    }
}
