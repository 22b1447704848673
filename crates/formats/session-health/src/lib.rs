//! Verdicts of a session: metrics, their limits, and findings.
//!
//! A metric is measured somewhere else; [`finding`] compares it with its [`Limit`]. The limits are
//! one table, [`TABLE`], in which the user may set rows ([`Limits::set`]). [`Measurement`] carries
//! a metric from one program to another.

mod finding;
mod limits;
mod measurement;

pub use finding::{Finding, finding, number_or_nan, overall, reasons};
pub use limits::{BadLimit, Limit, Limits, TABLE, Unit, limit_text};
pub use measurement::{BadMeasurements, Measurement, read_measurements, write_measurements};
