//! A few small images of each camera, stored beside the outputs of a bundle, for its report.
//!
//! Contract: `seen.jsonl` in the bundle's folder has a line for each image. It is not part of the
//! bundle: nothing depends on it, no hash covers it, and a bundle is valid without it. The same
//! session gives the same bytes.

use std::fs;
use std::io::{self, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};
use session_archive::manifest;
use session_input::stills::camera_stills;
use video::still::Still;

use crate::input::Input;

/// The file.
pub const FILE: &str = scene_bundle::layout::CAMERA_IMAGES;
/// Maximum size of the file, bytes. An image has some ten kB, and a camera a handful of them.
const LIMIT: u64 = 16 << 20;

/// A small image of one camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraImage {
    /// The camera.
    pub camera: String,
    /// Role of the image, as in `start` or `middle, least sharp`.
    pub role: String,
    /// Number of its frame.
    pub frame: u64,
    /// s after the session's first frame.
    pub after_s: f64,
    /// `left`, `right` or `both`.
    pub eye: String,
    /// As defined in [`video::still::Look`].
    pub sharpness: f64,
    /// As defined in [`video::still::Look`].
    pub brightness: f64,
    /// As defined in [`video::still::Look`].
    pub clipped: f64,
    /// A JPEG file in base64.
    pub jpeg: String,
}

/// Selects images of a session and writes the file into the bundle in `folder`, whole or not at
/// all. Frames that cannot be decoded are left out.
///
/// # Errors
/// The file cannot be written; the previous one is kept.
pub fn write(folder: &Path, input: &Input) -> io::Result<()> {
    let mut text = String::new();
    for seen in look(input) {
        text.push_str(&serde_json::to_string(&seen)?);
        text.push('\n');
    }
    let beside = folder.join(format!("{FILE}.new"));
    // Remains of a stopped run.
    let _ = fs::remove_file(&beside);
    let written = fs::File::create_new(&beside)
        .and_then(|mut file| file.write_all(text.as_bytes()))
        .and_then(|()| fs::rename(&beside, folder.join(FILE)));
    if written.is_err() {
        let _ = fs::remove_file(&beside);
    }
    written
}

/// The images of a bundle; none if it has no such file. Malformed lines are skipped.
///
/// # Errors
/// The file cannot be read, is not a regular file, or exceeds the maximum size.
pub fn read(folder: &Path) -> io::Result<Vec<CameraImage>> {
    let bytes = plain_file::read_below(folder, Path::new(FILE), LIMIT);
    let text = match bytes.and_then(plain_file::text) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
        Err(error) => return Err(error),
    };
    let lines = text.lines();
    Ok(lines.filter_map(|l| serde_json::from_str(l).ok()).collect())
}

fn look(input: &Input) -> Vec<CameraImage> {
    let index = input.index();
    let first = index.cameras.iter().flat_map(|c| c.frames.first());
    let start_ns = first.map(|f| f.time_ns).min().unwrap_or(0);
    let mut seen = Vec::new();
    for camera in &input.manifest().cameras {
        for still in of_camera(input, camera) {
            let roles: Vec<&str> = still.roles.iter().map(|role| role.name()).collect();
            seen.push(CameraImage {
                camera: camera.name.clone(),
                role: roles.join(", "),
                frame: still.number,
                after_s: still.time_ns.saturating_sub(start_ns) as f64 * 1e-9,
                eye: still.eye.to_owned(),
                sharpness: still.look.sharpness,
                brightness: still.look.brightness,
                clipped: still.look.clipped,
                jpeg: charts::base64(&still.jpeg),
            });
        }
    }
    seen
}

fn of_camera(input: &Input, camera: &manifest::Camera) -> Vec<Still> {
    let Some(index) = input.index().camera(&camera.name) else {
        return Vec::new();
    };
    match camera_stills(camera, index, input.session().access()) {
        Ok(found) => found.stills,
        Err(error) => {
            log::warn!(
                "selecting frames of {} for the report: {error}",
                camera.name
            );
            Vec::new()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_not_a_list_of_images_is_not_read() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join(FILE);
        assert!(read(folder.path()).expect("no file").is_empty());
        fs::write(&path, "no image\n").expect("a file");
        assert!(read(folder.path()).expect("no image").is_empty());
        let file = fs::File::create(&path).expect("a file");
        file.set_len(LIMIT + 1).expect("length");
        assert!(plain_file::is_refusal(
            &read(folder.path()).expect_err("too long")
        ));
        fs::remove_file(&path).expect("removed");
        std::os::unix::fs::symlink("/dev/zero", &path).expect("a link");
        assert!(plain_file::is_refusal(
            &read(folder.path()).expect_err("a link")
        ));
    }
}
