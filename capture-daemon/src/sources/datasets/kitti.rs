//! KITTI-style folders: images named by their number, `000000.png`, in one folder per eye.
//!
//! Contract: the number in the name is the frame's number and determines its time: the line of that
//! index in `times.txt` (seconds), or the number divided by the given rate. A number that is absent
//! on both sides is a gap in numbers and times; absent on one side it is an error.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::text::{Text, check_rising, file_names, is_there};
use super::{
    DatasetError, DatasetKind, Extent, StereoDataset, StereoFrameRef, calibration_files, rate_of,
    time_at,
};

/// Folder names, left and right. Of the official four cameras the gray pair comes first, as in the
/// reader of its calibration.
const FOLDERS: [(&str, &str); 3] = [
    ("image_0", "image_1"),
    ("image_2", "image_3"),
    ("image_l", "image_r"),
];

/// The folders of the two eyes, if `path` has both.
pub(super) fn folders_of(path: &Path) -> Option<(PathBuf, PathBuf)> {
    FOLDERS
        .iter()
        .map(|(left, right)| (path.join(left), path.join(right)))
        .find(|(left, right)| left.is_dir() && right.is_dir())
}

pub(super) fn open(
    path: &Path,
    rate_hz: Option<f64>,
    extent: Extent,
) -> Result<StereoDataset, DatasetError> {
    let Some((left_folder, right_folder)) = folders_of(path) else {
        return Err(DatasetError::Empty {
            path: path.to_owned(),
        });
    };
    let mut left = images(&left_folder)?;
    let mut right = images(&right_folder)?;
    check_pairs((left_folder, &left), (right_folder, &right))?;

    let mut notes = Vec::new();
    let (first, last) = (left.keys().next(), left.keys().next_back());
    if let (Some(first), Some(last)) = (first, last)
        && last - first + 1 != left.len() as u64
    {
        notes.push(format!(
            "of the images {first} to {last}, {} are absent",
            last - first + 1 - left.len() as u64
        ));
    }
    let times_file = path.join("times.txt");
    let (times_ns, is_head) = if is_there(&times_file) {
        let (times_ns, is_head) = read_times(&times_file, extent)?;
        (Some(times_ns), is_head)
    } else {
        (None, false)
    };
    if let (Some(times_ns), true) = (&times_ns, is_head) {
        let known = times_ns.len() as u64;
        left.retain(|number, _| *number < known);
        right.retain(|number, _| *number < known);
        if left.is_empty() {
            return Err(DatasetError::Head { path: times_file });
        }
    }
    let time_of = |number: u64| match (&times_ns, rate_hz) {
        (Some(times_ns), _) => usize::try_from(number)
            .ok()
            .and_then(|i| times_ns.get(i))
            .copied()
            .ok_or_else(|| DatasetError::Malformed {
                path: times_file.clone(),
                line: times_ns.len() + 1,
                found: "the end of the file".to_owned(),
                expected: format!("a time for image {number}"),
            }),
        (None, Some(rate_hz)) => Ok(time_at(number, rate_hz)),
        (None, None) => Err(DatasetError::NeedsRate {
            path: path.to_owned(),
        }),
    };
    let frames: Vec<StereoFrameRef> = left
        .into_iter()
        .zip(right.into_values())
        .map(|((number, left), right)| {
            Ok(StereoFrameRef {
                number,
                device_time_ns: time_of(number)?,
                left,
                right,
            })
        })
        .collect::<Result<_, DatasetError>>()?;
    let rate = match (&times_ns, rate_hz) {
        (None, Some(rate_hz)) => rate_hz,
        _ => rate_of(&frames, rate_hz, path)?,
    };
    if let (Some(_), Some(rate_hz)) = (&times_ns, rate_hz)
        && frames.len() > 1
    {
        notes.push(format!(
            "the rate of {rate_hz} Hz is ignored: times.txt has the times"
        ));
    }
    Ok(StereoDataset {
        kind: DatasetKind::Kitti,
        root: path.to_owned(),
        frames,
        imu: Vec::new(),
        calibration_files: calibration_files(path)?,
        rate_hz: rate,
        notes,
        is_head,
    })
}

/// Every image has its partner.
fn check_pairs(
    (left_folder, left): (PathBuf, &BTreeMap<u64, PathBuf>),
    (right_folder, right): (PathBuf, &BTreeMap<u64, PathBuf>),
) -> Result<(), DatasetError> {
    let only = |a: &BTreeMap<u64, PathBuf>, b: &BTreeMap<u64, PathBuf>| -> Vec<u64> {
        a.keys()
            .filter(|number| !b.contains_key(number))
            .copied()
            .collect()
    };
    let (left_only, right_only) = (only(left, right), only(right, left));
    let first = left_only.first().into_iter().chain(right_only.first());
    match first.min() {
        None => Ok(()),
        Some(first) => Err(DatasetError::Unpaired {
            left_only: left_only.len(),
            right_only: right_only.len(),
            first: format!("number {first}"),
            left: left_folder,
            right: right_folder,
        }),
    }
}

/// The numbered images of one eye.
fn images(folder: &Path) -> Result<BTreeMap<u64, PathBuf>, DatasetError> {
    let mut images = BTreeMap::new();
    for name in file_names(folder)? {
        let Some(stem) = name.strip_suffix(".png") else {
            continue;
        };
        let number = stem
            .parse::<u64>()
            .ok()
            .filter(|_| stem.bytes().all(|b| b.is_ascii_digit()));
        let fresh =
            number.is_some_and(|number| images.insert(number, folder.join(&name)).is_none());
        if !fresh {
            return Err(DatasetError::Unrecognised {
                path: folder.to_owned(),
                found: name,
                expected: "images named by their number, each number once, as in 000000.png"
                    .to_owned(),
            });
        }
    }
    if images.is_empty() {
        return Err(DatasetError::Empty {
            path: folder.to_owned(),
        });
    }
    Ok(images)
}

/// The times, and whether the file continues.
fn read_times(file: &Path, extent: Extent) -> Result<(Vec<i64>, bool), DatasetError> {
    let text = Text::read(file, extent)?;
    let mut times_ns = Vec::new();
    let mut last_ns = None;
    for line in text.lines() {
        let time_ns = line.seconds_as_ns(line.text)?;
        check_rising(&mut last_ns, time_ns, &line)?;
        times_ns.push(time_ns);
    }
    Ok((times_ns, text.is_head))
}
