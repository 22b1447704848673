//! Plain images: folders `left` and `right`, or one pair `left.png` and `right.png`.
//!
//! Contract: in folders, the n-th name of either side, sorted, forms frame n; the numbers of images
//! must be equal. Names need not match, so an image lost on each side cannot be detected here: data
//! sets with numbers or timestamps have layouts of their own. Times follow from the rate.

use std::path::{Path, PathBuf};

use super::text::{file_names, is_there};
use super::{DatasetError, DatasetKind, StereoDataset, StereoFrameRef, calibration_files, time_at};

pub(super) fn is_folders(path: &Path) -> bool {
    path.join("left").is_dir() && path.join("right").is_dir()
}

pub(super) fn is_pair(path: &Path) -> bool {
    is_there(&path.join("left.png")) && is_there(&path.join("right.png"))
}

pub(super) fn open_folders(
    path: &Path,
    rate_hz: Option<f64>,
) -> Result<StereoDataset, DatasetError> {
    let (left_folder, right_folder) = (path.join("left"), path.join("right"));
    let left = images(&left_folder)?;
    let right = images(&right_folder)?;
    if left.len() != right.len() {
        let shared = left.len().min(right.len());
        let first = left
            .get(shared)
            .or(right.get(shared))
            .and_then(|file| file.file_name())
            .unwrap_or_default();
        return Err(DatasetError::Unpaired {
            left_only: left.len() - shared,
            right_only: right.len() - shared,
            first: first.display().to_string(),
            left: left_folder,
            right: right_folder,
        });
    }
    list(
        path,
        DatasetKind::Folders,
        left.into_iter().zip(right),
        rate_hz,
    )
}

pub(super) fn open_pair(path: &Path, rate_hz: Option<f64>) -> Result<StereoDataset, DatasetError> {
    let pair = (path.join("left.png"), path.join("right.png"));
    list(path, DatasetKind::Pair, std::iter::once(pair), rate_hz)
}

fn list(
    path: &Path,
    kind: DatasetKind,
    pairs: impl Iterator<Item = (PathBuf, PathBuf)>,
    rate_hz: Option<f64>,
) -> Result<StereoDataset, DatasetError> {
    let Some(rate_hz) = rate_hz else {
        return Err(DatasetError::NeedsRate {
            path: path.to_owned(),
        });
    };
    let frame = |(number, (left, right)): (u64, (PathBuf, PathBuf))| StereoFrameRef {
        number,
        device_time_ns: time_at(number, rate_hz),
        left,
        right,
    };
    Ok(StereoDataset {
        kind,
        root: path.to_owned(),
        frames: (0..).zip(pairs).map(frame).collect(),
        imu: Vec::new(),
        calibration_files: calibration_files(path)?,
        rate_hz,
        notes: Vec::new(),
        is_head: false,
    })
}

/// The images of one folder in the order of their names.
fn images(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let names = file_names(folder)?;
    let images: Vec<PathBuf> = names
        .into_iter()
        .filter(|name| name.ends_with(".png"))
        .map(|name| folder.join(name))
        .collect();
    if images.is_empty() {
        return Err(DatasetError::Empty {
            path: folder.to_owned(),
        });
    }
    Ok(images)
}
