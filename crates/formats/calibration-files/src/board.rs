//! Files of boards: our own TOML, and the YAML of Kalibr.
//!
//! Contract: every key is known and every number is checked, so that a misspelt key, a size in
//! millimetres or a decimal comma is an error that names file, line and key. Nothing has a default
//! but `first_id`, which is 0.
//!
//! ```toml
//! kind = "aprilgrid"   # or "chessboard", "charuco"
//! columns = 6          # tags; of a chessboard inner corners, of a ChArUco board squares
//! rows = 6
//! tag_m = 0.088        # of the others: square_m, and of a ChArUco board marker_m
//! spacing = 0.3        # gap over tag size
//! ```
//!
//! ```toml
//! kind = "charuco"
//! columns = 8
//! rows = 6
//! square_m = 0.03
//! marker_m = 0.022
//! dictionary = "DICT_4X4_50"
//! ```

use std::path::Path;

use boards::{ARUCO_NAMES, Dictionary, Target};
use toml::de::{DeTable, DeValue};

use crate::error::CalibError;
use crate::files::{Disk, Files};
use crate::text::Source;
use crate::tree::{At, yaml};

/// Reads a board: Kalibr's YAML if the name ends in `.yaml` or `.yml`, otherwise our TOML.
///
/// # Errors
/// [`CalibError`] naming file, line and key.
pub fn read(path: &Path) -> Result<Target, CalibError> {
    let disk: &dyn Files = &Disk;
    of(&disk.text(path)?)
}

/// Parses the same from a text; `path` is for messages and selects the format.
///
/// # Errors
/// [`CalibError`] naming path, line and key.
///
/// ```
/// use std::path::Path;
///
/// use boards::Target;
/// use calibration_files::board::{parse, to_toml};
///
/// let kalibr = "target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n";
/// let board = parse(kalibr, Path::new("april.yaml"))?;
/// assert_eq!(board, Target::AprilGrid { columns: 6, rows: 6, tag_m: 0.088, spacing: 0.3, first_id: 0 });
/// assert_eq!(parse(&to_toml(&board), Path::new("board.toml"))?, board);
///
/// // A misspelt key is an error that names it.
/// let error = parse("kind = \"chessboard\"\ncolums = 7\n", Path::new("board.toml")).unwrap_err();
/// assert!(error.to_string().contains("colums"), "{error}");
/// # Ok::<(), calibration_files::CalibError>(())
/// ```
pub fn parse(text: &str, path: &Path) -> Result<Target, CalibError> {
    of(&Source {
        path: path.to_owned(),
        text: text.to_owned(),
    })
}

fn of(source: &Source) -> Result<Target, CalibError> {
    match source.path.extension().and_then(|e| e.to_str()) {
        Some("yaml" | "yml") => from_kalibr(source),
        _ => from_toml(source),
    }
}

/// Our TOML, as [`read`] takes it; numbers survive exactly.
pub fn to_toml(target: &Target) -> String {
    match target {
        Target::Chessboard {
            columns,
            rows,
            square_m,
        } => format!(
            "kind = \"chessboard\"\n# inner corners\ncolumns = {columns}\nrows = {rows}\nsquare_m = {square_m:?}\n"
        ),
        Target::AprilGrid {
            columns,
            rows,
            tag_m,
            spacing,
            first_id,
        } => format!(
            "kind = \"aprilgrid\"\n# tags\ncolumns = {columns}\nrows = {rows}\ntag_m = {tag_m:?}\n\
             # gap over tag size\nspacing = {spacing:?}\n# of the tag at the bottom left\nfirst_id = {first_id}\n"
        ),
        Target::Charuco {
            columns,
            rows,
            square_m,
            marker_m,
            dictionary,
            first_id,
        } => format!(
            "kind = \"charuco\"\n# squares\ncolumns = {columns}\nrows = {rows}\nsquare_m = {square_m:?}\n\
             marker_m = {marker_m:?}\ndictionary = \"{}\"\nfirst_id = {first_id}\n",
            dictionary.name()
        ),
    }
}

/// Kalibr's YAML; `None` for boards that Kalibr cannot describe: a ChArUco board, or ids that
/// do not start at 0.
pub fn to_kalibr(target: &Target) -> Option<String> {
    match target {
        Target::Chessboard {
            columns,
            rows,
            square_m,
        } => Some(format!(
            "target_type: 'checkerboard'\ntargetCols: {columns}\ntargetRows: {rows}\n\
             rowSpacingMeters: {square_m:?}\ncolSpacingMeters: {square_m:?}\n"
        )),
        Target::AprilGrid {
            columns,
            rows,
            tag_m,
            spacing,
            first_id: 0,
        } => Some(format!(
            "target_type: 'aprilgrid'\ntagCols: {columns}\ntagRows: {rows}\ntagSize: {tag_m:?}\n\
             tagSpacing: {spacing:?}\n"
        )),
        _ => None,
    }
}

fn from_toml(source: &Source) -> Result<Target, CalibError> {
    let text = source.text.trim_start_matches('\u{feff}');
    let line_of = |at: usize| 1 + text[..at.min(text.len())].matches('\n').count();
    let document = DeTable::parse(text).map_err(|error| {
        let line = line_of(error.span().map_or(0, |span| span.start));
        let found = text.lines().nth(line - 1).unwrap_or_default();
        source.malformed(line, found, &format!("TOML ({})", error.message()))
    })?;
    let table = Table {
        source,
        line_of: &line_of,
        values: document.get_ref(),
    };
    let (line, kind) = table.text("kind")?;
    let target = match kind {
        "chessboard" => {
            table.only(&["kind", "columns", "rows", "square_m"])?;
            Target::Chessboard {
                columns: table.count("columns")?,
                rows: table.count("rows")?,
                square_m: table.number("square_m")?,
            }
        }
        "aprilgrid" => {
            table.only(&["kind", "columns", "rows", "tag_m", "spacing", "first_id"])?;
            Target::AprilGrid {
                columns: table.count("columns")?,
                rows: table.count("rows")?,
                tag_m: table.number("tag_m")?,
                spacing: table.number("spacing")?,
                first_id: table.first_id()?,
            }
        }
        "charuco" => {
            table.only(&[
                "kind",
                "columns",
                "rows",
                "square_m",
                "marker_m",
                "dictionary",
                "first_id",
            ])?;
            let (line, name) = table.text("dictionary")?;
            let dictionary = Dictionary::aruco(name).ok_or_else(|| {
                source.malformed(
                    line,
                    name,
                    &format!("dictionary, one of {}", ARUCO_NAMES.join(", ")),
                )
            })?;
            Target::Charuco {
                columns: table.count("columns")?,
                rows: table.count("rows")?,
                square_m: table.number("square_m")?,
                marker_m: table.number("marker_m")?,
                dictionary,
                first_id: table.first_id()?,
            }
        }
        other => {
            return Err(source.malformed(
                line,
                other,
                "kind, one of chessboard, aprilgrid, charuco",
            ));
        }
    };
    match target.invalid_reason() {
        Some((key, reason)) => {
            let line = table.line(key).unwrap_or(line);
            Err(source.malformed(line, &format!("{key} = {}", before_comma(&reason)), &reason))
        }
        None => Ok(target),
    }
}

/// The part of a reason that names what was found.
fn before_comma(reason: &str) -> &str {
    reason.split([',', ' ']).next().unwrap_or(reason)
}

/// A table of plain values, with their lines.
struct Table<'a> {
    source: &'a Source,
    line_of: &'a dyn Fn(usize) -> usize,
    values: &'a DeTable<'a>,
}

impl<'a> Table<'a> {
    fn line(&self, key: &str) -> Option<usize> {
        self.values
            .get(key)
            .map(|value| (self.line_of)(value.span().start))
    }

    fn get(&self, key: &str) -> Result<(usize, &'a DeValue<'a>), CalibError> {
        let value = self.values.get(key).ok_or_else(|| {
            let found: Vec<&str> = self.values.keys().map(|k| k.get_ref().as_ref()).collect();
            self.source.missing(
                key,
                &if found.is_empty() {
                    "no key".to_owned()
                } else {
                    found.join(", ")
                },
            )
        })?;
        Ok(((self.line_of)(value.span().start), value.get_ref()))
    }

    fn text(&self, key: &str) -> Result<(usize, &'a str), CalibError> {
        let (line, value) = self.get(key)?;
        match value.as_str() {
            Some(text) => Ok((line, text)),
            None => Err(self.wrong(line, key, "text in quotes")),
        }
    }

    fn number(&self, key: &str) -> Result<f64, CalibError> {
        let (line, value) = self.get(key)?;
        let text = match value {
            DeValue::Float(number) => number.as_str(),
            DeValue::Integer(number) => number.as_str(),
            _ => return Err(self.wrong(line, key, "a number")),
        };
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(self.wrong(line, key, "a finite number")),
        }
    }

    fn count(&self, key: &str) -> Result<u32, CalibError> {
        let (line, value) = self.get(key)?;
        match value {
            DeValue::Integer(number) if number.radix() == 10 => number.as_str().parse().ok(),
            _ => None,
        }
        .ok_or_else(|| self.wrong(line, key, "a whole number, 0 or more"))
    }

    fn first_id(&self) -> Result<u32, CalibError> {
        match self.values.get("first_id") {
            Some(_) => self.count("first_id"),
            None => Ok(0),
        }
    }

    /// Rejects keys that this kind does not have.
    fn only(&self, known: &[&str]) -> Result<(), CalibError> {
        let unknown = self
            .values
            .keys()
            .find(|key| !known.contains(&key.get_ref().as_ref()));
        match unknown {
            Some(key) => {
                let line = (self.line_of)(key.span().start);
                let expected = format!("only the keys {}", known.join(", "));
                Err(self.source.malformed(line, key.get_ref(), &expected))
            }
            None => Ok(()),
        }
    }

    fn wrong(&self, line: usize, key: &str, expected: &str) -> CalibError {
        let found = self
            .source
            .text
            .lines()
            .nth(line - 1)
            .unwrap_or_default()
            .trim();
        self.source
            .malformed(line, found, &format!("{key} as {expected}"))
    }
}

fn from_kalibr(source: &Source) -> Result<Target, CalibError> {
    let tree = yaml::parse(source)?;
    let root = At::root(source, &tree);
    let text_of = |key: &str| {
        let at = root.get(key)?;
        Ok::<_, CalibError>((at.line(), at.text()?))
    };
    let number = |key: &str| -> Result<(usize, f64), CalibError> {
        let (line, text) = text_of(key)?;
        // The line alone does not identify the key.
        let number = source.number(line, text).map_err(|error| match error {
            CalibError::Malformed {
                path,
                line,
                found,
                expected,
            } => {
                let expected = format!("{key} as {expected}");
                CalibError::Malformed {
                    path,
                    line,
                    found,
                    expected,
                }
            }
            other => other,
        })?;
        Ok((line, number))
    };
    let count = |key: &str| -> Result<u32, CalibError> {
        let (line, text) = text_of(key)?;
        text.parse().map_err(|_| {
            source.malformed(line, text, &format!("{key} as a whole number, 0 or more"))
        })
    };
    let (line, kind) = text_of("target_type")?;
    // Kalibr's name for each of our keys, for errors.
    let (target, names): (Target, [(&str, &str); 4]) = match kind {
        "aprilgrid" => (
            Target::AprilGrid {
                columns: count("tagCols")?,
                rows: count("tagRows")?,
                tag_m: number("tagSize")?.1,
                spacing: number("tagSpacing")?.1,
                first_id: 0,
            },
            [
                ("columns", "tagCols"),
                ("rows", "tagRows"),
                ("tag_m", "tagSize"),
                ("spacing", "tagSpacing"),
            ],
        ),
        "checkerboard" => {
            let (line, rows_apart) = number("rowSpacingMeters")?;
            let (_, columns_apart) = number("colSpacingMeters")?;
            if rows_apart != columns_apart {
                let found =
                    format!("rowSpacingMeters {rows_apart} and colSpacingMeters {columns_apart}");
                return Err(source.malformed(line, &found, "squares: both alike"));
            }
            (
                Target::Chessboard {
                    columns: count("targetCols")?,
                    rows: count("targetRows")?,
                    square_m: rows_apart,
                },
                [
                    ("columns", "targetCols"),
                    ("rows", "targetRows"),
                    ("square_m", "rowSpacingMeters"),
                    ("", ""),
                ],
            )
        }
        other => {
            let expected = "target_type, one of 'aprilgrid', 'checkerboard'";
            return Err(source.malformed(line, other, expected));
        }
    };
    match target.invalid_reason() {
        Some((key, reason)) => {
            let name = names
                .iter()
                .find(|(ours, _)| *ours == key)
                .map_or("tagCols", |(_, name)| name);
            let line = text_of(name).map_or(line, |(line, _)| line);
            Err(source.malformed(line, &format!("{name}: {}", before_comma(&reason)), &reason))
        }
        None => Ok(target),
    }
}

#[cfg(test)]
mod tests;
