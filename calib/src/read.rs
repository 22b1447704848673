//! Finding out what kind of calibration a path holds.
//!
//! Contract: goes by names and by the first lines, never by trying one reader after the other, so a
//! damaged file is reported by the reader of its own kind. A folder that fits two kinds is an error.

use std::path::{Path, PathBuf};

use crate::error::{CalibError, Note};
use crate::stereo::{Format, StereoCalibration};
use crate::text::Source;
use crate::{euroc, kitti, pair, zed_conf};

const EXPECTED: &str = "a ZED SNnnnn.conf, an ASL folder with cam0/sensor.yaml and cam1/sensor.yaml, a KITTI \
                        calib.txt with P0 and P1, or a K.txt with a camera matrix and a baseline";

/// Reads the calibration of a stereo camera from a file, or from a folder that holds one, for pictures
/// of `width` x `height` pixels (one eye, not side by side).
///
/// # Errors
/// [`CalibError`], naming the file and where possible the line.
pub fn read_stereo(
    path: &Path,
    width: u32,
    height: u32,
) -> Result<(StereoCalibration, Vec<Note>), CalibError> {
    let (format, path) = if path.is_dir() {
        in_folder(path)?
    } else {
        (of_file(path)?, path.to_owned())
    };
    match format {
        Format::ZedConf => zed_conf::read(&path, width, height),
        Format::Euroc => euroc::read(&path, width, height),
        Format::Kitti => kitti::read(&path, width, height),
        Format::Pair => pair::read(&path, width, height),
    }
}

fn in_folder(folder: &Path) -> Result<(Format, PathBuf), CalibError> {
    let mut found = Vec::new();
    for asl in [folder.to_owned(), folder.join("mav0")] {
        if asl.join("cam0/sensor.yaml").is_file() {
            found.push((Format::Euroc, asl));
        }
    }
    for (format, name) in [(Format::Kitti, "calib.txt"), (Format::Pair, "K.txt")] {
        let file = folder.join(name);
        if file.is_file() {
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
            && file.is_file()
        {
            found.push((Format::ZedConf, file));
        }
    }
    // The order of a folder's entries is not defined; the message's must be.
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
    if path.file_name().is_some_and(|name| name == "sensor.yaml") {
        return Ok(Format::Euroc);
    }
    let source = Source::read(path)?;
    let first = source
        .lines()
        .map(|(_, line)| line)
        .find(|line| !line.is_empty() && !line.starts_with(['#', ';']));
    let first = first.unwrap_or_default();
    let words: Vec<&str> = first.split_ascii_whitespace().collect();
    let is_conf = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("conf"));
    if is_conf || first.to_ascii_uppercase().starts_with("[LEFT_CAM_") {
        return Ok(Format::ZedConf);
    }
    match words.as_slice() {
        [label, ..] if kitti::is_projection_label(label) => Ok(Format::Kitti),
        [number, ..] if words.len() == 12 && is_number_like(number) => Ok(Format::Kitti),
        [number, ..] if words.len() == 9 && is_number_like(number) => Ok(Format::Pair),
        _ => Err(CalibError::Unrecognised {
            path: path.to_owned(),
            found: format!(
                "a file that starts with {:?}",
                first.chars().take(40).collect::<String>()
            ),
            expected: EXPECTED.to_owned(),
        }),
    }
}

/// Loose on purpose: a misspelt number is for the reader of its kind to report.
fn is_number_like(word: &str) -> bool {
    word.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '-' | '+' | '.'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::Folder;

    #[test]
    fn tells_the_kinds_apart() {
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
        let middlebury = folder.file(
            "middlebury.txt",
            "cam0=[999.421 0 294.182; 0 999.421 252.932; 0 0 1]\n",
        );
        let error = of_file(&middlebury).unwrap_err().to_string();
        assert!(error.contains("starts with \"cam0=[999.421"), "{error}");
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
    fn an_absent_file_is_named() {
        let error = read_stereo(Path::new("no/such.conf"), 1, 1)
            .unwrap_err()
            .to_string();
        assert_eq!(error, "reading a calibration file: no/such.conf");
    }
}
