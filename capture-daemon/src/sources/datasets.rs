//! Recorded data sets as lists of stereo frames and IMU samples.
//!
//! Contract: [`open`] only lists and reads text; images are read one at a time by [`load_png`] when
//! they are due. A returned list has strictly increasing times, every frame has a left and a right
//! image on disk, and times are the recorded integers, never rounded through floating point. Listed
//! images that do not exist are skipped and noted, and leave a gap in numbers and times: no frame
//! is invented, none is moved. An image of one eye only is an error.
//!
//! Three layouts are known:
//! - ASL / EuRoC: `mav0/cam0`, `mav0/cam1` with `data.csv`, and `mav0/imu0/data.csv`;
//! - KITTI: `image_0` and `image_1`, `image_2` and `image_3`, or `image_l` and `image_r`, with
//!   numbered images and perhaps `times.txt`;
//! - plain: folders `left` and `right`, or one pair `left.png` and `right.png`.

use std::path::{Path, PathBuf};

use plain_file::Kind;

use super::Extent;

mod asl;
mod error;
mod folder;
mod kitti;
mod png_file;
mod text;

pub use error::DatasetError;
pub use png_file::{DecodedPng, MAX_PIXELS, PngShape, Samples, decode_png, load_png, probe_png};

/// A recorded data set, ready to be replayed.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoDataset {
    /// Its layout.
    pub kind: DatasetKind,
    /// The opened folder. The calibration reader takes it unchanged.
    pub root: PathBuf,
    /// Stereo frames in strictly increasing time, at least one.
    pub frames: Vec<StereoFrameRef>,
    /// IMU samples in strictly increasing time; empty if the data set has no IMU.
    pub imu: Vec<ImuSample>,
    /// Calibration files in the data set, to be copied into the session byte by byte.
    pub calibration_files: Vec<PathBuf>,
    /// Frame rate in Hz: from the median interval of the timestamps, or as given.
    pub rate_hz: f64,
    /// Absent or ignored parts, to be shown.
    pub notes: Vec<String>,
    /// The lists continue behind the part that was read: see [`open_head`].
    pub is_head: bool,
}

/// The layouts of data sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DatasetKind {
    /// ASL / EuRoC folder.
    Asl,
    /// KITTI-style folders with numbered images.
    Kitti,
    /// Folders `left` and `right`.
    Folders,
    /// One pair, `left.png` and `right.png`.
    Pair,
}

/// One stereo frame of a data set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StereoFrameRef {
    /// Number in the recording's own count. A skipped number is a frame that the data set lost.
    pub number: u64,
    /// Time on the recording's clock, ns.
    pub device_time_ns: i64,
    /// The left image.
    pub left: PathBuf,
    /// The right image.
    pub right: PathBuf,
}

/// One IMU sample of a data set, as written there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time on the recording's clock, ns.
    pub device_time_ns: i64,
    /// Angular rate, rad/s: the nearest `f64` to the digits in the file.
    pub gyro_rad_s: [f64; 3],
    /// Specific force, m/s²: the nearest `f64` to the digits in the file.
    pub accel_m_s2: [f64; 3],
}

/// Maximum rate that may be given, Hz: frames must have different times in ns.
pub const MAX_RATE_HZ: f64 = 1e6;

/// The layout of the data set in `path`.
///
/// # Errors
/// [`DatasetError::Unrecognised`] when no layout fits, or more than one.
pub fn detect(path: &Path) -> Result<DatasetKind, DatasetError> {
    let fits = [
        (DatasetKind::Asl, asl::root_of(path).is_some()),
        (DatasetKind::Kitti, kitti::folders_of(path).is_some()),
        (DatasetKind::Folders, folder::is_folders(path)),
        (DatasetKind::Pair, folder::is_pair(path)),
    ];
    let kinds: Vec<DatasetKind> = fits
        .into_iter()
        .filter(|(_, fits)| *fits)
        .map(|(kind, _)| kind)
        .collect();
    match kinds.as_slice() {
        [kind] => Ok(*kind),
        [] => Err(DatasetError::Unrecognised {
            path: path.to_owned(),
            found: describe_contents(path),
            expected: "mav0/cam0 and cam1, image_0 and image_1, image_2 and image_3, image_l and image_r, left and \
                       right, or left.png and right.png"
                .to_owned(),
        }),
        several => Err(DatasetError::Unrecognised {
            path: path.to_owned(),
            found: format!("the layouts {several:?} simultaneously"),
            expected: "one data set in the folder".to_owned(),
        }),
    }
}

/// Description of a folder that is no data set.
fn describe_contents(path: &Path) -> String {
    match std::fs::metadata(path).map(|data| Kind::of(data.file_type())) {
        Err(_) => "no folder".to_owned(),
        Ok(Some(Kind::Folder)) => "a folder without any of them".to_owned(),
        Ok(Some(other)) => other.to_string(),
        Ok(None) => "a file".to_owned(),
    }
}

/// Lists the data set in `path`.
///
/// `rate_hz` gives the times of a data set without times: frame `n` is at `n / rate_hz`, rounded to
/// the nearest ns. If the data set has times it is ignored and that is noted.
///
/// # Errors
/// [`DatasetError`], naming file and line.
pub fn open(path: &Path, rate_hz: Option<f64>) -> Result<StereoDataset, DatasetError> {
    open_as_far(path, rate_hz, Extent::Whole)
}

/// As [`open`], with the beginning of each list only: for a check.
///
/// # Errors
/// As [`open`], and [`DatasetError::Head`] if more of a list might suffice.
pub fn open_head(path: &Path, rate_hz: Option<f64>) -> Result<StereoDataset, DatasetError> {
    open_as_far(path, rate_hz, Extent::Head)
}

fn open_as_far(
    path: &Path,
    rate_hz: Option<f64>,
    extent: Extent,
) -> Result<StereoDataset, DatasetError> {
    if let Some(rate_hz) = rate_hz.filter(|rate| !(*rate > 0.0 && *rate <= MAX_RATE_HZ)) {
        return Err(DatasetError::Rate {
            path: path.to_owned(),
            rate_hz,
        });
    }
    match detect(path)? {
        DatasetKind::Asl => asl::open(path, rate_hz, extent),
        DatasetKind::Kitti => kitti::open(path, rate_hz, extent),
        DatasetKind::Folders => folder::open_folders(path, rate_hz),
        DatasetKind::Pair => folder::open_pair(path, rate_hz),
    }
}

/// Time of frame `number` at a constant rate, ns.
pub(super) fn time_at(number: u64, rate_hz: f64) -> i64 {
    // Exact to the ns up to 2^53 ns behind the first frame, 104 days.
    (number as f64 * 1e9 / rate_hz).round() as i64
}

/// Rate from the median interval of timestamped frames, Hz. One frame has no interval and needs
/// `given`.
fn rate_of(
    frames: &[StereoFrameRef],
    given: Option<f64>,
    path: &Path,
) -> Result<f64, DatasetError> {
    let mut intervals_ns: Vec<i64> = frames
        .windows(2)
        // Timestamps may be any integers; the user of the list rejects impossible times.
        .map(|pair| {
            pair[1]
                .device_time_ns
                .saturating_sub(pair[0].device_time_ns)
        })
        .collect();
    intervals_ns.sort_unstable();
    match intervals_ns.get(intervals_ns.len() / 2) {
        Some(median_ns) => Ok(1e9 / *median_ns as f64),
        None => given.ok_or_else(|| DatasetError::NeedsRate {
            path: path.to_owned(),
        }),
    }
}

/// Calibration files in the folder itself, sorted by name.
fn calibration_files(root: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let names = text::file_names(root)?;
    let is_calibration = |name: &&String| {
        *name == "calib.txt" || *name == "K.txt" || name.to_ascii_lowercase().ends_with(".conf")
    };
    Ok(names
        .iter()
        .filter(is_calibration)
        .map(|name| root.join(name))
        .collect())
}

#[cfg(test)]
mod tests;
