//! Reading the tolerance of a joint.
//!
//! Contract: every variance is above 0. Nothing is mounted exactly, and a covariance with a 0 has
//! no inverse, which a weighting by it would take for no tolerance at all. What is not known is
//! left out.

use std::ops::Range;

use toml::de::DeValue;

use super::table::{Log, Table, number, numbers};
use crate::covariance::Covariance;

/// A key that may be written in one of several units, with the factor to SI.
pub(crate) type Units = [(&'static str, f64); 2];

const SHIFT: Units = [("sigma_translation_m", 1.0), ("sigma_translation_mm", 1e-3)];
const TURN: Units = [
    ("sigma_rotation_rad", 1.0),
    ("sigma_rotation_deg", std::f64::consts::PI / 180.0),
];

/// The tolerance of an entry, where it has one.
pub(crate) fn covariance(table: &Table<'_, '_>, log: &mut Log<'_>) -> Option<Covariance> {
    let has = |key: &str| table.table.contains_key(key);
    let any = |units: &Units| units.iter().any(|(key, _)| has(key));
    match (any(&SHIFT) || any(&TURN), has("covariance")) {
        (false, false) => None,
        (true, true) => {
            let message = format!("both covariance and sigmas in {}, expected one", table.name);
            log.add(table.at.clone(), message);
            None
        }
        (false, true) => {
            let expected = "six rows of six finite numbers";
            let (at, rows) = table.get_list("covariance", log, rows_of_six, expected, 6)?;
            let covariance = valid(&at, Covariance::from_rows(rows), log)?;
            let variance = (0..6).find(|&i| covariance.rows()[i][i] == 0.0);
            match variance {
                None => Some(covariance),
                Some(i) => {
                    let what = format!("entry {i} of the diagonal of covariance");
                    zero(&what, "0", table, at, log);
                    None
                }
            }
        }
        (true, false) => {
            let expected = "one or three numbers above 0";
            let shift = in_units(table, &SHIFT, log, sigmas, expected, 3);
            let turn = in_units(table, &TURN, log, sigmas, expected, 3);
            let (shift, turn) = (
                shift.and_then(|found| above_zero(found, &SHIFT, table, log)),
                turn.and_then(|found| above_zero(found, &TURN, table, log)),
            );
            let ((at, shift), (_, turn)) = (shift?, turn?);
            valid(&at, Covariance::from_sigmas(shift.0, turn.0), log)
        }
    }
}

/// Sigmas whose squares are above 0, or a problem.
fn above_zero(
    (at, sigmas): (Range<usize>, Sigmas),
    units: &Units,
    table: &Table<'_, '_>,
    log: &mut Log<'_>,
) -> Option<(Range<usize>, Sigmas)> {
    if sigmas.0.iter().all(|sigma| sigma * sigma > 0.0) {
        return Some((at, sigmas));
    }
    let key = units
        .iter()
        .find(|(key, _)| table.table.contains_key(*key))
        .map_or(units[0].0, |(key, _)| key);
    let found = log.found(&at);
    zero(key, &found, table, at, log);
    None
}

/// The problem of a joint that is said to be exact.
fn zero(what: &str, found: &str, table: &Table<'_, '_>, at: Range<usize>, log: &mut Log<'_>) {
    let message = format!(
        "{what} in {}: found {found}, expected above 0: leave the tolerance out where it is not known",
        table.name
    );
    log.add(at, message);
}

fn valid<E: ToString>(
    at: &Range<usize>,
    covariance: Result<Covariance, E>,
    log: &mut Log<'_>,
) -> Option<Covariance> {
    covariance
        .map_err(|error| log.add(at.clone(), error.to_string()))
        .ok()
}

/// The value under exactly one of the keys, in SI.
pub(crate) fn in_units<T: UnitScaling>(
    table: &Table<'_, '_>,
    units: &Units,
    log: &mut Log<'_>,
    read: fn(&DeValue<'_>) -> Option<T>,
    expected: &str,
    count: impl Into<Option<usize>>,
) -> Option<(Range<usize>, T)> {
    let mut present = units
        .iter()
        .filter(|(key, _)| table.table.contains_key(*key));
    let first = present.next();
    if let (Some((first, _)), Some((second, _))) = (first, present.next()) {
        let message = format!("both {first} and {second} in {}, expected one", table.name);
        log.add(table.at.clone(), message);
        return None;
    }
    let (key, factor) = first.unwrap_or(&units[0]);
    let (at, value) = table.get_list(key, log, read, expected, count)?;
    Some((at, value.scaled(*factor)))
}

/// What can be brought to another unit.
pub(crate) trait UnitScaling {
    /// Times a factor; a factor of 1 changes no bit.
    fn scaled(self, factor: f64) -> Self;
}

impl UnitScaling for f64 {
    fn scaled(self, factor: f64) -> Self {
        self * factor
    }
}

struct Sigmas([f64; 3]);

impl UnitScaling for Sigmas {
    fn scaled(self, factor: f64) -> Self {
        Self(self.0.map(|v| v * factor))
    }
}

fn sigmas(value: &DeValue<'_>) -> Option<Sigmas> {
    let all = number(value).map(|v| [v; 3]);
    all.or_else(|| numbers::<3>(value))
        .filter(|all| all.iter().all(|v| *v >= 0.0))
        .map(Sigmas)
}

fn rows_of_six(value: &DeValue<'_>) -> Option<[[f64; 6]; 6]> {
    let rows: Option<Vec<[f64; 6]>> = value
        .as_array()?
        .iter()
        .map(|row| numbers::<6>(row.get_ref()))
        .collect();
    rows?.try_into().ok()
}
