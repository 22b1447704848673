//! Trajectory files, recognized by their content.
//!
//! Contract: TUM, KITTI, EuRoC and the truth of a simulated session (`truth.CAMERA.csv`) are
//! distinguished by their first line of numbers, a scene bundle by being a folder or a
//! `scene.json`. KITTI poses take their times from a `times.txt` in the same folder; without one
//! they are numbered, at 10 Hz, and compared with numbered ones only.

use std::path::{Path, PathBuf};

use scene_bundle::formats::{euroc, kitti, tum};
use scene_bundle::outputs::{self, TRAJECTORY, TRAJECTORY_CAUSAL};
use scene_bundle::{BundleError, FormatError, Pose, Scene, Trajectory};

/// Period of numbered poses, ns: KITTI's cameras take 10 frames per second.
const NUMBERED_PERIOD_NS: i64 = 100_000_000;
/// Times of the poses of a KITTI sequence, in the folder of the poses.
const TIMES: &str = "times.txt";

/// A trajectory from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedTrajectory {
    /// The poses.
    pub trajectory: Trajectory,
    /// The file has no times: poses are numbered.
    pub is_numbered: bool,
    /// Whether it has a row for every frame set, lost ones included, as in a scene bundle: nothing
    /// was recorded outside of its time range.
    pub has_row_per_set: bool,
}

/// Error of reading a trajectory.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file could not be read: check the path and its permissions.
    #[error("reading a trajectory: {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// Neither of the formats.
    #[error(
        "reading a trajectory: found {found}, expected 8 fields (TUM), 12 (KITTI), or 8, 9, 11 or 17 with commas (EuRoC, \
         truth of a simulation): {}", path.display()
    )]
    Unknown {
        /// The file.
        path: PathBuf,
        /// Its first line.
        found: String,
    },
    /// A line is wrong.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The bundle cannot be read.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// The bundle has no trajectory: run the stage that makes it.
    #[error("reading a trajectory: found a bundle without one, expected the output {expected}: {}", path.display())]
    NoTrajectory {
        /// The bundle.
        path: PathBuf,
        /// The output.
        expected: String,
    },
    /// One file has times and the other has not.
    #[error("comparing trajectories: found poses without times, expected some, as the truth has: {}", path.display())]
    Numbered {
        /// The file without.
        path: PathBuf,
    },
    /// As [`FileError::Numbered`], reversed.
    #[error("comparing trajectories: found poses with times, expected none, as the truth has: {}", path.display())]
    Timed {
        /// The file with times.
        path: PathBuf,
    },
}

/// Reads the trajectory of a path. `output` is which one of a bundle; by default `trajectory`,
/// where it has none `trajectory-causal`. A file has at most 1 GiB.
///
/// # Errors
/// [`FileError`].
pub fn load(path: &Path, output: Option<&str>) -> Result<LoadedTrajectory, FileError> {
    if path.is_dir() || path.extension().is_some_and(|e| e == "json") {
        return of_bundle(path, output);
    }
    let text = plain_file::read_to_string(path, 1 << 30).map_err(|source| FileError::Read {
        path: path.to_owned(),
        source,
    })?;
    let timed = |trajectory| LoadedTrajectory {
        trajectory,
        is_numbered: false,
        has_row_per_set: false,
    };
    let lines = text.trim_start_matches('\u{feff}').lines().map(str::trim);
    let first = lines.clone().find(|l| !l.is_empty() && !l.starts_with('#'));
    let first = first.unwrap_or_default();
    let unknown = || FileError::Unknown {
        path: path.to_owned(),
        found: format!("{:?}", first.chars().take(80).collect::<String>()),
    };
    if first.contains(',') {
        let fields = first.trim_end_matches(',').split(',').count();
        return match fields {
            8 | 11 | 17 => Ok(timed(euroc::parse(&text, path)?.trajectory)),
            9 => {
                // The first field is the device clock. Line numbers are preserved, so that errors
                // name the right line.
                let rest = text.lines().map(|line| match line.split_once(',') {
                    Some((_, rest)) if !line.starts_with('#') => rest,
                    _ => "#",
                });
                let rest: Vec<&str> = rest.collect();
                Ok(timed(euroc::parse(&rest.join("\n"), path)?.trajectory))
            }
            _ => Err(unknown()),
        };
    }
    match first.split_ascii_whitespace().count() {
        8 => Ok(timed(tum::parse(&text, path)?)),
        12 => of_kitti(path, &text),
        _ => Err(unknown()),
    }
}

/// Whether two can be compared; `path` is that of the estimate.
///
/// # Errors
/// [`FileError::Numbered`], [`FileError::Timed`].
pub fn check(
    estimate: &LoadedTrajectory,
    truth: &LoadedTrajectory,
    path: &Path,
) -> Result<(), FileError> {
    let path = path.to_owned();
    match (estimate.is_numbered, truth.is_numbered) {
        (true, false) => Err(FileError::Numbered { path }),
        (false, true) => Err(FileError::Timed { path }),
        _ => Ok(()),
    }
}

fn of_bundle(path: &Path, output: Option<&str>) -> Result<LoadedTrajectory, FileError> {
    let scene = Scene::open(path)?;
    let wanted = match output {
        Some(output) => vec![output],
        None => vec![TRAJECTORY, TRAJECTORY_CAUSAL],
    };
    let Some(name) = wanted.iter().find(|name| scene.has(name)) else {
        return Err(FileError::NoTrajectory {
            path: path.to_owned(),
            expected: wanted.join(" or "),
        });
    };
    Ok(LoadedTrajectory {
        trajectory: outputs::trajectory::read(&scene.output(name)?)?,
        is_numbered: false,
        has_row_per_set: true,
    })
}

fn of_kitti(path: &Path, text: &str) -> Result<LoadedTrajectory, FileError> {
    let times = path.with_file_name(TIMES);
    if times.is_file() {
        return Ok(LoadedTrajectory {
            trajectory: kitti::read(path, &times)?,
            is_numbered: false,
            has_row_per_set: false,
        });
    }
    let poses = kitti::parse_poses(text, path)?.into_iter().enumerate();
    let poses = poses.map(|(n, pose)| Pose::new(n as i64 * NUMBERED_PERIOD_NS, pose));
    Ok(LoadedTrajectory {
        trajectory: Trajectory::new(poses.collect()).expect("numbers rise"),
        is_numbered: true,
        has_row_per_set: false,
    })
}
