//! A trajectory file as text, and errors that name the line.

use std::path::{Path, PathBuf};

use cad_transforms::RigidTransform;

use crate::trajectory::{Pose, Trajectory};

/// Maximum deviation of a printed quaternion's norm from 1: four decimals per component, as in the
/// ground truth of the TUM RGB-D data, change it by up to 1e-4. Within it, quaternions that deviate
/// by more than a transform allows are normalized.
pub(super) const NORM_TOLERANCE: f64 = 1e-3;

/// Maximum size of a trajectory file, bytes: a day of poses at 100 Hz.
const MAX_BYTES: u64 = 1 << 30;

/// Why a trajectory could not be read.
///
/// A message names the line, what was found and what was expected:
///
/// ```
/// use std::path::Path;
///
/// use scene_bundle::formats::tum;
///
/// let error = tum::parse("# t x y z\n1.0 0 0 0\n", Path::new("poses.txt")).unwrap_err();
/// let text = error.to_string();
/// assert!(text.contains("4 fields"), "{text}");
/// assert!(text.contains("8: t x y z qx qy qz qw"), "{text}");
/// assert!(text.contains("poses.txt"), "{text}");
/// ```
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// The file could not be read: check the path and its permissions.
    #[error("reading a trajectory: {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A line does not follow this kind of file.
    #[error("reading a {kind} trajectory: line {line}: found {found}, expected {expected}: {}", path.display())]
    Malformed {
        /// Kind of file.
        kind: &'static str,
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What was found.
        found: String,
        /// What was expected.
        expected: String,
    },
    /// Two files that belong together have different lengths.
    #[error("reading a {kind} trajectory: found {found} times, expected one for each of the {expected} poses: {}", path.display())]
    Counts {
        /// Kind of file.
        kind: &'static str,
        /// The file with the times.
        path: PathBuf,
        /// Times found.
        found: usize,
        /// Poses found.
        expected: usize,
    },
}

/// The text of one file and where it came from, for messages.
pub(super) struct Source<'a> {
    pub(super) kind: &'static str,
    pub(super) path: &'a Path,
    pub(super) text: &'a str,
}

pub(super) fn read(path: &Path) -> Result<String, FormatError> {
    plain_file::read_to_string(path, MAX_BYTES).map_err(|source| FormatError::Read {
        path: path.to_owned(),
        source,
    })
}

impl<'a> Source<'a> {
    /// Lines with content, with their numbers from 1: not empty, not a comment (`#`).
    pub(super) fn lines(&self) -> impl Iterator<Item = (usize, &'a str)> {
        let text = self.text.trim_start_matches('\u{feff}');
        let lines = text.lines().enumerate();
        lines
            .map(|(i, line)| (i + 1, line.trim()))
            .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
    }

    pub(super) fn malformed(
        &self,
        line: usize,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> FormatError {
        FormatError::Malformed {
            kind: self.kind,
            path: self.path.to_owned(),
            line,
            found: found.into(),
            expected: expected.into(),
        }
    }

    pub(super) fn number(&self, line: usize, word: &str) -> Result<f64, FormatError> {
        match word.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(self.malformed(
                line,
                format!("{word:?}"),
                "a finite number with a decimal point",
            )),
        }
    }

    /// A transform of a printed quaternion `w x y z` and a translation in metres.
    pub(super) fn transform(
        &self,
        line: usize,
        wxyz: [f64; 4],
        translation_m: [f64; 3],
    ) -> Result<RigidTransform, FormatError> {
        let norm = wxyz.iter().map(|v| v * v).sum::<f64>().sqrt();
        let printed = (norm - 1.0).abs() > cad_transforms::transform::UNIT_TOLERANCE
            && (norm - 1.0).abs() <= NORM_TOLERANCE;
        let wxyz = if printed {
            wxyz.map(|v| v / norm)
        } else {
            wxyz
        };
        RigidTransform::from_wxyz(wxyz, translation_m).map_err(|_| {
            self.malformed(
                line,
                format!("a quaternion of norm {norm}"),
                format!("norm 1 within {NORM_TOLERANCE}"),
            )
        })
    }

    /// The trajectory of these rows, with a warning if some of them repeated a time.
    pub(super) fn trajectory(&self, rows: Rows) -> Result<Trajectory, FormatError> {
        if let Some(warning) = rows.warning() {
            log::warn!(
                "reading a {} trajectory: {warning}: {}",
                self.kind,
                self.path.display()
            );
        }
        let mut trajectory = Trajectory::default();
        let mut before: Option<(usize, i64)> = None;
        for (line, pose) in rows.kept {
            let time_ns = pose.time_ns;
            trajectory.push(pose).map_err(|_| {
                // Numbers of a file are finite, so only the time is left to be wrong.
                let (line_before, time_before) = before.unwrap_or_default();
                self.malformed(
                    line,
                    format!("the time {time_ns} ns"),
                    format!("a later one than the {time_before} ns of line {line_before}"),
                )
            })?;
            before = Some((line, time_ns));
        }
        Ok(trajectory)
    }
}

/// Poses with their lines. Of consecutive lines with the same time, the first is kept: ground truth
/// of real data sets has such lines, and evo associates with the first of equal times as well.
#[derive(Debug, Default)]
pub(super) struct Rows {
    kept: Vec<(usize, Pose)>,
    /// Lines that were not kept, and the first of them.
    repeated: usize,
    first_repeated: Option<usize>,
}

impl Rows {
    /// Adds the pose of a line; `false` if it repeats the time of the one before and is not kept.
    pub(super) fn push(&mut self, line: usize, pose: Pose) -> bool {
        let repeats = |(_, last): &(usize, Pose)| last.time_ns == pose.time_ns;
        if self.kept.last().is_some_and(repeats) {
            self.repeated += 1;
            self.first_repeated.get_or_insert(line);
            return false;
        }
        self.kept.push((line, pose));
        true
    }

    /// What is to be said of lines that were not kept.
    fn warning(&self) -> Option<String> {
        let first = self.first_repeated?;
        Some(match self.repeated {
            1 => format!(
                "line {first} repeats the time of the line before; only the first pose of each time is used"
            ),
            count => format!(
                "{count} lines repeat the time of the line before, the first is line {first}; only the first pose of \
                 each time is used"
            ),
        })
    }
}

/// A number with the digits that read back to the same bits.
pub(super) fn format_number(number: f64) -> String {
    format!("{number:?}")
}

/// Several, with a separator.
pub(super) fn format_numbers(numbers: &[f64], separator: &str) -> String {
    let words: Vec<String> = numbers.iter().map(|n| format_number(*n)).collect();
    words.join(separator)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_times_are_counted_and_the_first_line_is_named() {
        let mut rows = Rows::default();
        let pushed: Vec<bool> = [(3, 10), (4, 10), (5, 11), (7, 11), (8, 11), (9, 10)]
            .map(|(line, time_ns)| rows.push(line, Pose::new(time_ns, RigidTransform::identity())))
            .into();
        assert_eq!(pushed, [true, false, true, false, false, true]);
        assert_eq!(
            rows.warning().as_deref(),
            Some(
                "3 lines repeat the time of the line before, the first is line 4; only the first pose of each time is \
                 used"
            )
        );
        assert_eq!(Rows::default().warning(), None);
    }
}
