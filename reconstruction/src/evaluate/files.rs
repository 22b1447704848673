//! Trajectory files, recognized by their content.
//!
//! Contract: TUM, KITTI, EuRoC and the truth of a simulated session (`truth.CAMERA.csv`) are
//! distinguished by their first line of numbers, a scene bundle by being a folder or a
//! `scene.json`. KITTI poses take their times from a `times.txt` in the same folder; without one
//! they are numbered, at 10 Hz. Numbered poses are compared with numbered ones and, by number, with
//! a KITTI file that has times and the same number of poses ([`comparable`]).

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
    /// The poses by number instead of time, of a KITTI file with times.
    pub by_number: Option<Trajectory>,
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
    /// Poses without times are compared with those of a file that is not of KITTI's format.
    #[error(
        "comparing trajectories: found KITTI poses without a {TIMES} beside them, expected times, as the ground truth \
         has, or a ground truth in KITTI's format with one pose per frame: {}", path.display()
    )]
    Numbered {
        /// The file without times.
        path: PathBuf,
    },
    /// As [`FileError::Numbered`], reversed.
    #[error(
        "comparing trajectories: the ground truth is KITTI poses without a {TIMES} beside them; found poses with \
         times, expected KITTI poses, one per frame (`paws scene export --format kitti`): {}", path.display()
    )]
    Timed {
        /// The file with times.
        path: PathBuf,
    },
    /// Two KITTI files, one without times, have different numbers of poses.
    #[error(
        "comparing trajectories: found {found} poses, expected {expected}, as the ground truth has: one of the two \
         KITTI files has no {TIMES} beside it, so poses are compared by number; an export leaves out lost poses; a \
         {TIMES} beside both, of one clock, allows any number: {}", path.display()
    )]
    Lengths {
        /// The estimate.
        path: PathBuf,
        /// Its poses.
        found: usize,
        /// Poses of the ground truth.
        expected: usize,
    },
}

impl LoadedTrajectory {
    /// Poses with times that are not from a KITTI file.
    pub fn timed(trajectory: Trajectory) -> Self {
        Self {
            trajectory,
            is_numbered: false,
            by_number: None,
            has_row_per_set: false,
        }
    }

    fn numbered(&self) -> Option<&Trajectory> {
        match self.is_numbered {
            true => Some(&self.trajectory),
            false => self.by_number.as_ref(),
        }
    }
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
    let timed = LoadedTrajectory::timed;
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

/// The poses of an estimate and of the ground truth that are compared: by time if both have times,
/// or neither; by number if one of two KITTI files has none and their numbers of poses are the
/// same. `path` is that of the estimate.
///
/// # Errors
/// [`FileError::Numbered`], [`FileError::Timed`], [`FileError::Lengths`].
pub fn comparable<'a>(
    estimate: &'a LoadedTrajectory,
    truth: &'a LoadedTrajectory,
    path: &Path,
) -> Result<(&'a Trajectory, &'a Trajectory), FileError> {
    if estimate.is_numbered == truth.is_numbered {
        return Ok((&estimate.trajectory, &truth.trajectory));
    }
    let path = path.to_owned();
    match (estimate.numbered(), truth.numbered()) {
        (Some(estimate), Some(truth)) if estimate.len() == truth.len() => Ok((estimate, truth)),
        (Some(estimate), Some(truth)) => Err(FileError::Lengths {
            path,
            found: estimate.len(),
            expected: truth.len(),
        }),
        _ if estimate.is_numbered => Err(FileError::Numbered { path }),
        _ => Err(FileError::Timed { path }),
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
    let trajectory = outputs::trajectory::read(&scene.output(name)?)?;
    Ok(LoadedTrajectory {
        has_row_per_set: true,
        ..LoadedTrajectory::timed(trajectory)
    })
}

fn of_kitti(path: &Path, text: &str) -> Result<LoadedTrajectory, FileError> {
    let poses = kitti::parse_poses(text, path)?.into_iter().enumerate();
    let poses = poses.map(|(n, pose)| Pose::new(n as i64 * NUMBERED_PERIOD_NS, pose));
    let numbered = Trajectory::new(poses.collect()).expect("numbers rise");
    let times = path.with_file_name(TIMES);
    if times.is_file() {
        return Ok(LoadedTrajectory {
            by_number: Some(numbered),
            ..LoadedTrajectory::timed(kitti::read(path, &times)?)
        });
    }
    Ok(LoadedTrajectory {
        is_numbered: true,
        ..LoadedTrajectory::timed(numbered)
    })
}
