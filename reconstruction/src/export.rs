//! Export of a hand-off to plain files: images as PNG, everything else as CSV and JSON.
//!
//! Contract. The requested folder appears complete or not at all: everything is written to a folder
//! of the same name with `.partial` appended, which is renamed at the end. A folder that is not
//! empty is refused and left alone, and so is one that cannot be replaced (a mount point, a link).
//! A run that fails removes what it wrote; one that is killed leaves the `.partial` folder, which
//! the next run refuses to touch. *At a gap* there is no row and no image. *On failure to read* a
//! frame or an IMU batch it is left out and counted ([`Summary::lost`]), and the rest is written;
//! on failure to write everything stops. The same hand-off gives the same bytes.
//!
//! ```text
//! DIR/CAMERA/left/NNNNNN.png    named by the frame's number, at least six digits
//! DIR/CAMERA/right/NNNNNN.png   8 bits, gray or RGB
//! DIR/CAMERA/times.csv          number,time_ns,sigma_ns,time_unreliable,set; set is empty for a frame
//!                               in none, time_unreliable 1 where sigma_ns is not reliable
//! DIR/sets.csv                  set,time_ns,CAMERA,...; frame numbers, empty if there is none
//! DIR/imu/NAME.csv              number,ticks,time_ns,gyro_x_rad_s,...,accel_x_m_s2,...,time_unreliable
//! DIR/calibration.json          intrinsics of every image, transforms of the rig
//! ```
//!
//! Images are named by number and not by time, because gap records and sets refer to numbers, which
//! do not change when clock maps are computed again. An IMU named `feet/imu` is written to
//! `imu/feet/imu.csv`. Floating-point numbers are written with the digits that read back to the
//! same number.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use crate::input::Input;

mod calibration;
mod camera;
mod error;
mod selection;
mod summary;
mod tables;
mod text;

pub use error::ExportError;
pub use selection::Selection;
pub use summary::Summary;

use camera::CameraExport;
use error::writing;

/// Number of stereo frames that [`export`] will write.
pub fn count(input: &Input, selection: &Selection) -> u64 {
    let cameras = 0..input.index().cameras.len();
    let selected = cameras.flat_map(|camera| selection.of_camera(input, camera));
    selected.filter(|(_, selected)| *selected).count() as u64
}

/// Writes a hand-off to the folder `out`. `progress` is called once for each stereo frame, from
/// several threads.
///
/// # Errors
/// See [`ExportError`].
pub fn export(
    input: &Input,
    out: &Path,
    selection: &Selection,
    progress: &(dyn Fn() + Sync),
) -> Result<Summary, ExportError> {
    let partial = begin(out)?;
    let result = write_all(input, &partial, selection, progress).and_then(|summary| {
        fs::rename(&partial, out)
            .map(|()| summary)
            .map_err(writing(out))
    });
    if result.is_err() {
        // It belongs to this run. If removing it fails too, its name shows its origin.
        let _ = fs::remove_dir_all(&partial);
    }
    result
}

fn write_all(
    input: &Input,
    folder: &Path,
    selection: &Selection,
    progress: &(dyn Fn() + Sync),
) -> Result<Summary, ExportError> {
    let stop = AtomicBool::new(false);
    let (cameras, rest) = thread::scope(|scope| {
        let cameras = input.manifest().cameras.iter().enumerate();
        let threads: Vec<_> = cameras
            .map(|(position, camera)| {
                let camera = CameraExport {
                    input,
                    name: &camera.name,
                    position,
                    folder: folder.join(&camera.name),
                    stop: &stop,
                };
                scope.spawn(move || camera.write(selection, progress))
            })
            .collect();
        let rest = tables::write(input, folder, selection);
        if rest.is_err() {
            stop.store(true, Ordering::Relaxed);
        }
        let cameras: Vec<_> = threads
            .into_iter()
            .map(|thread| {
                thread
                    .join()
                    .unwrap_or_else(|e| std::panic::resume_unwind(e))
            })
            .collect();
        (cameras, rest)
    });
    let mut summary = rest?;
    let mut lost = Vec::new();
    for (camera, result) in input.manifest().cameras.iter().zip(cameras) {
        let (written, of_camera) = result?;
        summary.cameras.push((camera.name.clone(), written));
        lost.extend(of_camera);
    }
    lost.append(&mut summary.lost);
    summary.lost = lost;
    Ok(summary)
}

/// Makes the folder to write to first.
fn begin(out: &Path) -> Result<PathBuf, ExportError> {
    let exists = match fs::read_dir(out).map(|mut entries| entries.next().is_some()) {
        Ok(true) => return Err(ExportError::NotEmpty(out.to_owned())),
        Ok(false) => true,
        Err(e) if e.kind() == io::ErrorKind::NotFound => false,
        Err(error) => return Err(writing(out)(error)),
    };
    let mut name = match out.file_name() {
        Some(name) => name.to_owned(),
        None => {
            let error = io::Error::new(io::ErrorKind::InvalidInput, "the folder has no name");
            return Err(writing(out)(error));
        }
    };
    name.push(".partial");
    let partial = out.with_file_name(name);
    if let Some(parent) = partial.parent() {
        fs::create_dir_all(parent).map_err(writing(parent))?;
    }
    match fs::create_dir(&partial) {
        Ok(()) => {}
        Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {
            return Err(ExportError::LeftOver(partial));
        }
        Err(error) => return Err(writing(&partial)(error)),
    }
    // Now, and not by the rename: whether it can be replaced must be known before the work.
    if exists && let Err(error) = fs::remove_dir(out) {
        // Just made, and empty.
        let _ = fs::remove_dir(&partial);
        return Err(writing(out)(error));
    }
    Ok(partial)
}
