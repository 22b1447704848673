//! Format detection for calibration files.
//!
//! Contract: by file names and first lines, never by trying one reader after the other, so that a
//! damaged file is reported by the reader of its own format. A folder that matches two formats is
//! an error.

use std::path::{Path, PathBuf};

use crate::camera::Distortion;
use crate::error::{CalibError, Note};
use crate::set::{CameraSet, NamedCamera};
use crate::stereo::{Format, StereoCalibration};
use crate::text::Source;
use crate::tree::{At, json, yaml};
use crate::{
    basalt, colmap, euroc, kalibr, kitti, middlebury, nerfstudio, opencv, pair, ros, rosys, set,
    zed_conf,
};

const EXPECTED: &str = "a ZED SNnnnn.conf, an ASL folder with cam0/sensor.yaml and cam1/sensor.yaml, a KITTI \
                        calib.txt with P0 and P1, a K.txt with a camera matrix and a baseline, or a file of Kalibr, \
                        Basalt, OpenCV, COLMAP, nerfstudio, ROS, RoSys or Middlebury";

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
/// use calib::read_stereo;
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
    let (format, path) = detect_format(path)?;
    let (stereo, mut notes) = match format {
        Format::ZedConf => zed_conf::read(&path, width, height)?,
        Format::Kitti => kitti::read(&path, width, height)?,
        Format::Pair => pair::read(&path, width, height)?,
        Format::Euroc => return euroc::read(&path, width, height),
        _ => {
            let (set, mut notes) = of_format(format, &path, Some([width, height]))?;
            let (stereo, more) = set.stereo(None, &path)?;
            notes.extend(more);
            return Ok((stereo, notes));
        }
    };
    notes.extend(set::wide(&stereo));
    Ok((stereo, notes))
}

/// Reads all cameras of a file, or of a folder with one. `size` is that of one image; it is
/// required if the file does not contain it, and must be equal to the file's otherwise.
///
/// # Errors
/// [`CalibError`], naming the file and where possible line and key.
pub fn read_cameras(
    path: &Path,
    size: Option<[u32; 2]>,
) -> Result<(CameraSet, Vec<Note>), CalibError> {
    let (format, path) = detect_format(path)?;
    let (set, mut notes) = of_format(format, &path, size)?;
    notes.extend(set.plausibility_notes(&path)?);
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
    if path.is_dir() {
        in_folder(path)
    } else {
        Ok((of_file(path)?, path.to_owned()))
    }
}

fn of_format(
    format: Format,
    path: &Path,
    size: Option<[u32; 2]>,
) -> Result<(CameraSet, Vec<Note>), CalibError> {
    let unknown = |found: &str| CalibError::SizeUnknown {
        path: path.to_owned(),
        found: found.to_owned(),
    };
    let pair =
        |(stereo, notes): (StereoCalibration, Vec<Note>)| (CameraSet::of_stereo(&stereo), notes);
    let (set, notes) = match format {
        Format::ZedConf => {
            let Some([width, height]) = size else {
                let all: Vec<String> = zed_conf::resolutions(path)?
                    .into_iter()
                    .map(|(w, h, tag)| format!("{tag} {w}x{h}"))
                    .collect();
                return Err(unknown(&format!("sections for {}", all.join(", "))));
            };
            pair(zed_conf::read(path, width, height)?)
        }
        Format::Kitti | Format::Pair => {
            let [width, height] = size.ok_or_else(|| unknown("camera matrices alone"))?;
            pair(match format {
                Format::Kitti => kitti::read(path, width, height)?,
                _ => pair::read(path, width, height)?,
            })
        }
        Format::Euroc => euroc::read_cameras(path, size, 1)?,
        Format::Kalibr => kalibr::read(path)?,
        Format::Basalt => basalt::read(path)?,
        Format::OpenCv => opencv::read(path, size)?,
        Format::Colmap | Format::ColmapBin => colmap::read(path)?,
        Format::Nerfstudio => nerfstudio::read(path)?,
        Format::Ros => ros::read(path)?,
        Format::Rosys => rosys::read(path)?,
        Format::Middlebury => middlebury::read(path)?,
    };
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

/// Files that identify a folder.
const IN_FOLDER: [(Format, &str); 13] = [
    (Format::Kitti, "calib.txt"),
    (Format::Pair, "K.txt"),
    (Format::Kalibr, "camchain-imucam.yaml"),
    (Format::Kalibr, "camchain.yaml"),
    (Format::Basalt, "calibration.json"),
    (Format::OpenCv, "calibration.yml"),
    (Format::OpenCv, "intrinsics.yml"),
    (Format::Colmap, "cameras.txt"),
    (Format::ColmapBin, "cameras.bin"),
    (Format::Nerfstudio, "transforms.json"),
    (Format::Ros, "left.yaml"),
    (Format::Ros, "camera.yaml"),
    (Format::Rosys, "cameras.json"),
];

/// Whether the path exists and could be a file. Other things, such as a pipe, are rejected by the
/// reader of the format.
fn is_there(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|data| !data.is_dir())
}

fn in_folder(folder: &Path) -> Result<(Format, PathBuf), CalibError> {
    let mut found = Vec::new();
    for asl in [folder.to_owned(), folder.join("mav0")] {
        if is_there(&asl.join("cam0/sensor.yaml")) {
            found.push((Format::Euroc, asl));
        }
    }
    for (format, name) in IN_FOLDER {
        let file = folder.join(name);
        if is_there(&file) {
            // KITTI's and Middlebury's files have the same name.
            let format = match format {
                Format::Kitti => of_file(&file).unwrap_or(format),
                other => other,
            };
            found.push((format, file));
        }
    }
    let unreadable = |source| CalibError::Read {
        path: folder.to_owned(),
        source,
    };
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let file = entry.map_err(unreadable)?.path();
        if file
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("conf"))
            && is_there(&file)
        {
            found.push((Format::ZedConf, file));
        }
    }
    // The order of directory entries is not defined; that of the message must be.
    found.sort_by(|(_, a), (_, b)| a.cmp(b));
    let names: Vec<String> = found
        .iter()
        .map(|(_, file)| {
            file.strip_prefix(folder)
                .unwrap_or(file)
                .display()
                .to_string()
        })
        .map(|name| {
            if name.is_empty() {
                "cam0".to_owned()
            } else {
                name
            }
        })
        .collect();
    match found.len() {
        1 => Ok(found.remove(0)),
        n => Err(CalibError::Unrecognised {
            path: folder.to_owned(),
            found: if n == 0 {
                "no calibration file".to_owned()
            } else {
                names.join(" and ")
            },
            expected: if n == 0 {
                EXPECTED.to_owned()
            } else {
                "exactly one; give the file itself".to_owned()
            },
        }),
    }
}

fn of_file(path: &Path) -> Result<Format, CalibError> {
    let named = |name: &str| path.file_name().is_some_and(|own| own == name);
    let extension = |known: &[&str]| {
        path.extension()
            .is_some_and(|own| known.iter().any(|e| own.eq_ignore_ascii_case(e)))
    };
    if named("sensor.yaml") {
        return Ok(Format::Euroc);
    }
    if named("cameras.bin") {
        return Ok(Format::ColmapBin);
    }
    if named("cameras.txt") {
        return Ok(Format::Colmap);
    }
    let source = match extension(&["json", "txt"]) {
        true => Source::read_document(path)?,
        false => Source::read(path)?,
    };
    let first = source
        .lines()
        .map(|(_, line)| line)
        .find(|line| !line.is_empty() && !line.starts_with(['#', ';']));
    let first = first.unwrap_or_default();
    let words: Vec<&str> = first.split_ascii_whitespace().collect();
    if extension(&["conf"]) || first.to_ascii_uppercase().starts_with("[LEFT_CAM_") {
        return Ok(Format::ZedConf);
    }
    if first.starts_with('{') || extension(&["json"]) {
        let tree = json::parse(&source)?;
        return of_json(&At::root(&source, &tree)).ok_or_else(|| unrecognised(path, &keys(&tree)));
    }
    if extension(&["yaml", "yml"]) || first.starts_with("%YAML") || first == "---" {
        let tree = yaml::parse(&source)?;
        return of_yaml(&At::root(&source, &tree)).ok_or_else(|| unrecognised(path, &keys(&tree)));
    }
    match words.as_slice() {
        [label, ..] if kitti::is_projection_label(label) => Ok(Format::Kitti),
        [number, ..] if words.len() == 12 && is_number_like(number) => Ok(Format::Kitti),
        [number, ..] if words.len() == 9 && is_number_like(number) => Ok(Format::Pair),
        [_, model, ..] if colmap::is_model(model) => Ok(Format::Colmap),
        [start, ..] if start.starts_with("cam0=[") => Ok(Format::Middlebury),
        _ => {
            let start: String = first.chars().take(40).collect();
            Err(unrecognised(
                path,
                &format!("a file that starts with {start:?}"),
            ))
        }
    }
}

fn of_json(root: &At<'_>) -> Option<Format> {
    let has = |key: &str| root.find(key).is_some();
    if has("value0") {
        Some(Format::Basalt)
    } else if has("frames") || has("fl_x") || has("camera_angle_x") {
        Some(Format::Nerfstudio)
    } else if has("cameras") {
        Some(Format::Rosys)
    } else {
        None
    }
}

fn of_yaml(root: &At<'_>) -> Option<Format> {
    let has = |key: &str| root.find(key).is_some();
    if has("cam0") {
        Some(Format::Kalibr)
    } else if has("camera_matrix") && (has("projection_matrix") || has("distortion_model")) {
        Some(Format::Ros)
    } else if root.find_any(opencv::LEFT[0]).is_some() || root.find_any(opencv::MONO[0]).is_some() {
        Some(Format::OpenCv)
    } else if has("sensor_type") {
        Some(Format::Euroc)
    } else {
        None
    }
}

fn keys(tree: &crate::tree::Node) -> String {
    let mut keys = match &tree.value {
        crate::tree::Value::Map(entries) => entries.iter().map(|(key, _)| key.as_str()).collect(),
        _ => Vec::new(),
    };
    keys.truncate(8);
    match keys.is_empty() {
        true => "no keys".to_owned(),
        false => format!("the keys {}", keys.join(", ")),
    }
}

fn unrecognised(path: &Path, found: &str) -> CalibError {
    CalibError::Unrecognised {
        path: path.to_owned(),
        found: found.to_owned(),
        expected: EXPECTED.to_owned(),
    }
}

/// Loose on purpose: a misspelt number is reported by the reader of the format.
fn is_number_like(word: &str) -> bool {
    word.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '-' | '+' | '.'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::Folder;

    #[test]
    fn formats_are_distinguished() {
        let folder = Folder::new();
        let check = |name: &str, text: &str, expected: Format| {
            assert_eq!(
                of_file(&folder.file(name, text)).unwrap(),
                expected,
                "{name}"
            );
        };
        check("SN1.conf", "", Format::ZedConf);
        check(
            "renamed.txt",
            "\u{feff}\n[left_cam_hd]\nfx=1\n",
            Format::ZedConf,
        );
        check("calib.txt", "P0: 1 0 0 0 0 1 0 0 0 0 1 0\n", Format::Kitti);
        check("bare.txt", "1 0 0 0 0 1 0 0 0 0 1 0", Format::Kitti);
        check("K.txt", "1 0 0 0 1 0 0 0 1\n0.1\n", Format::Pair);
        check("cam0/sensor.yaml", "", Format::Euroc);
        check(
            "m.txt",
            "cam0=[999.421 0 294.182; 0 1 2; 0 0 1]\n",
            Format::Middlebury,
        );
        check("chain.yaml", "cam0: {camera_model: ds}\n", Format::Kalibr);
        check(
            "b.json",
            "{\"value0\": {\"T_imu_cam\": []}}",
            Format::Basalt,
        );
        check(
            "cv.yml",
            "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n",
            Format::OpenCv,
        );
        check("mono.yml", "camera_matrix: [1]\n", Format::OpenCv);
        check(
            "zed_left.yaml",
            "camera_matrix: [1]\ndistortion_model: radtan\n",
            Format::Ros,
        );
        check(
            "c.txt",
            "# Camera list\n1 PINHOLE 640 480 1 1 1 1\n",
            Format::Colmap,
        );
        check(
            "t.json",
            "{\"fl_x\": 1, \"frames\": []}",
            Format::Nerfstudio,
        );
        check("r.json", "{\"cameras\": {}}", Format::Rosys);
        for (name, text, expected) in [
            ("x.txt", "hello world\n", "starts with \"hello world\""),
            ("x.yaml", "imu_topic: a\n", "found the keys imu_topic"),
            ("x.json", "[1]", "found no keys"),
        ] {
            let error = of_file(&folder.file(name, text)).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn a_folder_must_hold_exactly_one() {
        let folder = Folder::new();
        let error = read_stereo(folder.path(), 640, 480)
            .unwrap_err()
            .to_string();
        assert!(
            error.starts_with("recognising a calibration: found no calibration file"),
            "{error}"
        );

        folder.file("K.txt", "500 0 320 0 500 240 0 0 1\n0.1\n");
        let (calibration, _) = read_stereo(folder.path(), 640, 480).unwrap();
        assert_eq!(calibration.provenance.files, [folder.path().join("K.txt")]);

        folder.file("calib.txt", "");
        let error = read_stereo(folder.path(), 640, 480)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("found K.txt and calib.txt, expected exactly one"),
            "{error}"
        );
    }

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
