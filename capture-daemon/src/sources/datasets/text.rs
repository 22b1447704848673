//! Folders and text files of a data set, with errors that name file and line.

use std::collections::BTreeSet;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use plain_file::{Kind, NotPlain, TooLong};

use super::DatasetError;
use crate::sources::{Extent, HEAD_BYTES};

/// The text of one file and its path.
pub(super) struct Text {
    path: PathBuf,
    text: String,
    /// Whether the file continues behind the text.
    pub(super) is_head: bool,
}

/// One line, from 1.
#[derive(Clone, Copy)]
pub(super) struct Line<'t> {
    source: &'t Text,
    pub(super) number: usize,
    pub(super) text: &'t str,
}

/// Maximum size of a table of a data set, bytes. An hour of an IMU at 200 Hz takes 110 MB in
/// EuRoC's format.
const MAX_BYTES: u64 = 1 << 30;

impl Text {
    pub(super) fn read(path: &Path, extent: Extent) -> Result<Self, DatasetError> {
        let read = match extent {
            Extent::Whole => plain_file::read_to_string(path, MAX_BYTES).map(|text| (text, false)),
            Extent::Head => head(path),
        };
        let (text, is_head) = read.map_err(|source| DatasetError::Read {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self {
            path: path.to_owned(),
            text,
            is_head,
        })
    }

    /// Lines with content that are not comments.
    pub(super) fn lines(&self) -> impl Iterator<Item = Line<'_>> {
        self.text
            .trim_start_matches('\u{feff}')
            .lines()
            .enumerate()
            .map(|(i, text)| Line {
                source: self,
                number: i + 1,
                text: text.trim(),
            })
            .filter(|line| !line.text.is_empty() && !line.text.starts_with('#'))
    }
}

/// The complete lines at the beginning of a file, and whether it continues.
fn head(path: &Path) -> io::Result<(String, bool)> {
    let file = plain_file::open(path)?;
    let found = file.metadata()?.len();
    if found > MAX_BYTES {
        let limit = MAX_BYTES;
        let too_long = TooLong { found, limit };
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, too_long));
    }
    let mut bytes = Vec::new();
    file.take(HEAD_BYTES).read_to_end(&mut bytes)?;
    let continues = found > bytes.len() as u64;
    if continues {
        let last = bytes.iter().rposition(|byte| *byte == b'\n');
        bytes.truncate(last.map_or(0, |last| last + 1));
    }
    Ok((plain_file::text(bytes)?, continues))
}

impl<'t> Line<'t> {
    pub(super) fn malformed(&self, found: &str, expected: &str) -> DatasetError {
        DatasetError::Malformed {
            path: self.source.path.clone(),
            line: self.number,
            found: found.to_owned(),
            expected: expected.to_owned(),
        }
    }

    /// Exactly `N` fields between commas.
    pub(super) fn fields<const N: usize>(
        &self,
        expected: &str,
    ) -> Result<[&'t str; N], DatasetError> {
        let fields: Vec<&str> = self.text.split(',').map(str::trim).collect();
        fields
            .try_into()
            .map_err(|_| self.malformed(self.text, expected))
    }

    pub(super) fn stamp_ns(&self, field: &str) -> Result<i64, DatasetError> {
        field
            .parse()
            .map_err(|_| self.malformed(field, "a time as an integer of nanoseconds"))
    }

    /// The nearest `f64` to a decimal number.
    pub(super) fn number(&self, field: &str) -> Result<f64, DatasetError> {
        match field.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(self.malformed(field, "a finite number")),
        }
    }

    /// A time in seconds, exactly by its digits, rounded to the nearest ns.
    pub(super) fn seconds_as_ns(&self, field: &str) -> Result<i64, DatasetError> {
        seconds_as_ns(field).ok_or_else(|| self.malformed(field, "a time in seconds"))
    }
}

/// Fails if `time_ns` is not after `*last_ns`, then replaces it.
pub(super) fn check_rising(
    last_ns: &mut Option<i64>,
    time_ns: i64,
    line: &Line<'_>,
) -> Result<(), DatasetError> {
    match last_ns.replace(time_ns) {
        Some(last_ns) if time_ns <= last_ns => {
            Err(line.malformed(&time_ns.to_string(), &format!("a time after {last_ns} ns")))
        }
        _ => Ok(()),
    }
}

/// Whether something exists at the path. A non-file, such as a pipe, is rejected when it is opened.
pub(super) fn is_there(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|data| !data.is_dir())
}

/// Names of the files in a folder. Names that are not UTF-8 belong to no data set and are skipped,
/// and so are folders and dangling links; any other non-file is an error.
pub(super) fn file_names(folder: &Path) -> Result<BTreeSet<String>, DatasetError> {
    let unreadable = |source| DatasetError::Read {
        path: folder.to_owned(),
        source,
    };
    let mut names = BTreeSet::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let name = entry.file_name().into_string().ok();
        let Some(name) = name.filter(|name| !name.starts_with('.')) else {
            continue;
        };
        let Ok(data) = std::fs::metadata(entry.path()) else {
            continue;
        };
        match Kind::of(data.file_type()) {
            None => {
                names.insert(name);
            }
            Some(Kind::Folder) => {}
            Some(other) => {
                return Err(DatasetError::Read {
                    path: entry.path(),
                    source: io::Error::other(NotPlain(other)),
                });
            }
        }
    }
    Ok(names)
}

/// A decimal number of seconds, with or without an exponent, in ns. Never through floating point:
/// an `f64` of seconds since 1970 steps by 238 ns.
fn seconds_as_ns(text: &str) -> Option<i64> {
    let (mantissa, exponent) = match text.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (
            mantissa,
            exponent.parse::<i32>().ok().filter(|e| e.abs() <= 30)?,
        ),
        None => (text, 0),
    };
    let (negative, digits) = match mantissa.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, mantissa.strip_prefix('+').unwrap_or(mantissa)),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let all_digits = |part: &str| part.bytes().all(|b| b.is_ascii_digit());
    if whole.len() + fraction.len() == 0 || !all_digits(whole) || !all_digits(fraction) {
        return None;
    }
    let value: i128 = format!("{whole}{fraction}").parse().ok()?;
    let shift = exponent + 9 - i32::try_from(fraction.len()).ok()?;
    let power = 10i128.checked_pow(shift.unsigned_abs())?;
    let magnitude = if shift >= 0 {
        value.checked_mul(power)?
    } else {
        (value + power / 2) / power
    };
    i64::try_from(if negative { -magnitude } else { magnitude }).ok()
}

#[cfg(test)]
mod tests {
    use super::seconds_as_ns;

    #[test]
    fn seconds_are_exact() {
        for (text, expected) in [
            ("0", 0),
            ("0.000000e+00", 0),
            ("1.036224e-01", 103_622_400),
            ("4.544e+02", 454_400_000_000),
            ("1403715273.262142976", 1_403_715_273_262_142_976),
            ("-1.5", -1_500_000_000),
            ("+.25", 250_000_000),
            ("3.", 3_000_000_000),
            ("0.0000000004", 0),
            ("0.0000000005", 1),
            ("1e-9", 1),
        ] {
            assert_eq!(seconds_as_ns(text), Some(expected), "{text}");
        }
        for text in [
            "",
            ".",
            "-",
            "1,5",
            "1.2.3",
            "nan",
            "inf",
            "1e",
            "1e99",
            "0x10",
            "99999999999",
            "1e30",
            "--1",
            "1 2",
        ] {
            assert_eq!(seconds_as_ns(text), None, "{text}");
        }
        // Result of a conversion through f64.
        let naive = ("1403715273.262143".parse::<f64>().unwrap() * 1e9) as i64;
        assert_ne!(Some(naive), seconds_as_ns("1403715273.262143"));
    }
}
