//! A calibration file as text, and numbers out of it with errors that name the line.

use std::path::{Path, PathBuf};

use crate::error::CalibError;

/// The text of one file and where it came from.
pub(crate) struct Source {
    pub(crate) path: PathBuf,
    pub(crate) text: String,
}

impl Source {
    pub(crate) fn read(path: &Path) -> Result<Self, CalibError> {
        let text = std::fs::read_to_string(path).map_err(|source| CalibError::Read {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self {
            path: path.to_owned(),
            text,
        })
    }

    /// Lines from 1, trimmed, without a byte order mark.
    pub(crate) fn lines(&self) -> impl Iterator<Item = (usize, &str)> {
        self.text
            .trim_start_matches('\u{feff}')
            .lines()
            .enumerate()
            .map(|(i, line)| (i + 1, line.trim()))
    }

    pub(crate) fn malformed(&self, line: usize, found: &str, expected: &str) -> CalibError {
        CalibError::Malformed {
            path: self.path.clone(),
            line,
            found: if found.is_empty() {
                "nothing".to_owned()
            } else {
                format!("{found:?}")
            },
            expected: expected.to_owned(),
        }
    }

    pub(crate) fn missing(&self, what: &str, found: &str) -> CalibError {
        CalibError::Missing {
            path: self.path.clone(),
            what: what.to_owned(),
            found: found.to_owned(),
        }
    }

    /// A finite number with a decimal point. A decimal comma is refused by name: programs that take
    /// `736,862` for 736 have destroyed calibrations before.
    pub(crate) fn number(&self, line: usize, text: &str) -> Result<f64, CalibError> {
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => {
                let with_point = text.replacen(',', ".", 1);
                let expected = if text.contains(',') && with_point.parse::<f64>().is_ok() {
                    "a decimal point (the file was written with a decimal comma)"
                } else {
                    "a finite number"
                };
                Err(self.malformed(line, text, expected))
            }
        }
    }

    /// All numbers of a line, separated by blanks.
    pub(crate) fn numbers(&self, line: usize, text: &str) -> Result<Vec<f64>, CalibError> {
        text.split_ascii_whitespace()
            .map(|word| self.number(line, word))
            .collect()
    }
}
