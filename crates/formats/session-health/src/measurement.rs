//! Metrics measured by one program and compared with the limits by another, as JSON.

use serde::{Deserialize, Serialize};

use crate::finding::{Finding, finding, number_or_nan};
use crate::limits::Limits;

const FORMAT: &str = "paws-measurements";
const VERSION: u32 = 1;

/// A measured metric of one stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// The metric, as in `calib.time_offset`.
    pub metric: String,
    /// The stream.
    pub of: String,
    /// Measured value, in the metric's unit; `null` in JSON if it is not finite.
    #[serde(deserialize_with = "number_or_nan")]
    pub value: f64,
    /// Details as text.
    pub detail: String,
}

impl Measurement {
    /// Compares it with the limits; `None` for an unknown metric.
    pub fn compare(&self, limits: &Limits) -> Option<Finding> {
        finding(
            limits,
            &self.metric,
            &self.of,
            self.value,
            0.0,
            &self.detail,
        )
    }
}

/// The document.
#[derive(Serialize, Deserialize)]
struct Document {
    format: String,
    version: u32,
    software: String,
    measurements: Vec<Measurement>,
}

/// Why a document of measurements cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum BadMeasurements {
    /// It is no JSON of this kind.
    #[error("reading measurements: {0}")]
    Json(#[from] serde_json::Error),
    /// It is of another kind or version.
    #[error(
        "reading measurements: found {format} version {version}, expected {FORMAT} version {VERSION}"
    )]
    Kind {
        /// Its format.
        format: String,
        /// Its version.
        version: u32,
    },
}

/// The document, as one line of JSON with its line break; `software` is the program that measured.
///
/// # Errors
/// Memory is exhausted.
pub fn write_measurements(
    software: &str,
    measurements: &[Measurement],
) -> Result<Vec<u8>, serde_json::Error> {
    let mut text = serde_json::to_vec(&Document {
        format: FORMAT.to_owned(),
        version: VERSION,
        software: software.to_owned(),
        measurements: measurements.to_vec(),
    })?;
    text.push(b'\n');
    Ok(text)
}

/// Reads the document.
///
/// # Errors
/// It is none, or of another version.
pub fn read_measurements(text: &[u8]) -> Result<Vec<Measurement>, BadMeasurements> {
    let document: Document = serde_json::from_slice(text)?;
    if document.format != FORMAT || document.version != VERSION {
        return Err(BadMeasurements::Kind {
            format: document.format,
            version: document.version,
        });
    }
    Ok(document.measurements)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measurements_round_trip() {
        let measured = |value| Measurement {
            metric: "calib.time_offset".to_owned(),
            of: "feet".to_owned(),
            value,
            detail: "late".to_owned(),
        };
        let text = write_measurements("test", &[measured(0.1 + 0.2), measured(f64::NAN)]).unwrap();
        let read = read_measurements(&text).unwrap();
        assert_eq!(read[0], measured(0.1 + 0.2));
        assert!(read[1].value.is_nan());
        assert!(read[0].compare(&Limits::default()).is_some());
        let other = String::from_utf8(text)
            .unwrap()
            .replace("\"version\":1", "\"version\":2");
        let error = read_measurements(other.as_bytes()).unwrap_err().to_string();
        assert!(error.contains("version 2"), "{error}");
        assert!(read_measurements(b"{}").is_err());
    }
}
