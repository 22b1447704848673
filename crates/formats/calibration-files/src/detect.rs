//! Format detection for calibration files.
//!
//! Contract: by file names and first lines, never by trying one reader after the other, so that a
//! damaged file is reported by the reader of its own format. A folder that matches two formats is
//! an error.

use std::path::{Path, PathBuf};

use crate::entry::{Entry, InFolder};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::registry::ENTRIES;
use crate::tree::{At, Node, Value, json, yaml};

const EXPECTED: &str = "a ZED SNnnnn.conf, an ASL folder with cam0/sensor.yaml and cam1/sensor.yaml, a KITTI \
                        calib.txt with P0 and P1, a K.txt with a camera matrix and a baseline, or a file of Kalibr, \
                        Basalt, OpenCV, COLMAP, nerfstudio, ROS, RoSys or Middlebury";

/// Format of a path: the format, and the file, or the folder of an ASL data set.
pub(crate) fn detect(files: &dyn Files, path: &Path) -> Result<(Format, PathBuf), CalibError> {
    if files.is_folder(path) {
        in_folder(files, path)
    } else {
        Ok((of_file(files, path)?, path.to_owned()))
    }
}

fn in_folder(files: &dyn Files, folder: &Path) -> Result<(Format, PathBuf), CalibError> {
    let mut found: Vec<(Format, PathBuf)> = Vec::new();
    for entry in &ENTRIES {
        match entry.in_folder {
            InFolder::Below { file, inner } => {
                let folders = [folder.to_owned(), folder.join(inner)];
                let with_file = folders
                    .into_iter()
                    .filter(|folder| files.is_there(&folder.join(file)));
                found.extend(with_file.map(|folder| (entry.format, folder)));
            }
            InFolder::Named(names) => {
                for file in names.iter().map(|name| folder.join(name)) {
                    // Formats whose files have the same name: KITTI's and Middlebury's.
                    if let Some((format, _)) = found.iter_mut().find(|(_, known)| *known == file) {
                        *format = of_file(files, &file).unwrap_or(*format);
                    } else if files.is_there(&file) {
                        found.push((entry.format, file));
                    }
                }
            }
            InFolder::Extension(extension) => {
                let entries = files.entries(folder).map_err(|source| CalibError::Read {
                    path: folder.to_owned(),
                    source,
                })?;
                let named = entries.into_iter().filter(|file| {
                    file.extension()
                        .is_some_and(|own| own.eq_ignore_ascii_case(extension))
                        && files.is_there(file)
                });
                found.extend(named.map(|file| (entry.format, file)));
            }
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

fn of_file(files: &dyn Files, path: &Path) -> Result<Format, CalibError> {
    let by_name = ENTRIES.iter().find(|entry| {
        let own = path.file_name();
        entry
            .signs
            .name
            .is_some_and(|name| own.is_some_and(|own| own == name))
    });
    if let Some(entry) = by_name {
        return Ok(entry.format);
    }
    let extension = |known: &[&str]| {
        path.extension()
            .is_some_and(|own| known.iter().any(|e| own.eq_ignore_ascii_case(e)))
    };
    let source = match extension(&["json", "txt"]) {
        true => files.document(path)?,
        false => files.text(path)?,
    };
    let first = source
        .lines()
        .map(|(_, line)| line)
        .find(|line| !line.is_empty() && !line.starts_with(['#', ';']));
    let first = first.unwrap_or_default();
    let own_extension = path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default();
    let mut entries = ENTRIES.iter();
    if let Some(entry) = entries.find(|e| e.signs.start.is_some_and(|is| is(own_extension, first)))
    {
        return Ok(entry.format);
    }
    if first.starts_with('{') || extension(&["json"]) {
        let tree = json::parse(&source)?;
        let root = At::root(&source, &tree);
        let found = ENTRIES
            .iter()
            .find(|e| e.signs.json.is_some_and(|is| is(&root)));
        return format_of(found).ok_or_else(|| unrecognised(path, &keys(&tree)));
    }
    if extension(&["yaml", "yml"]) || first.starts_with("%YAML") || first == "---" {
        let tree = yaml::parse(&source)?;
        let root = At::root(&source, &tree);
        let found = ENTRIES
            .iter()
            .find(|e| e.signs.yaml.is_some_and(|is| is(&root)));
        return format_of(found).ok_or_else(|| unrecognised(path, &keys(&tree)));
    }
    let words: Vec<&str> = first.split_ascii_whitespace().collect();
    let found = ENTRIES
        .iter()
        .find(|e| e.signs.words.is_some_and(|is| is(&words)));
    format_of(found).ok_or_else(|| {
        let start: String = first.chars().take(40).collect();
        unrecognised(path, &format!("a file that starts with {start:?}"))
    })
}

fn format_of(entry: Option<&Entry>) -> Option<Format> {
    entry.map(|entry| entry.format)
}

fn keys(tree: &Node) -> String {
    let mut keys = match &tree.value {
        Value::Map(entries) => entries.iter().map(|(key, _)| key.as_str()).collect(),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::Disk;
    use crate::read_stereo;
    use crate::test_data::Folder;

    #[test]
    fn formats_are_distinguished() {
        let folder = Folder::new();
        let check = |name: &str, text: &str, expected: Format| {
            assert_eq!(
                of_file(&Disk, &folder.file(name, text)).unwrap(),
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
            let error = of_file(&Disk, &folder.file(name, text))
                .unwrap_err()
                .to_string();
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
}
