//! Result of a measurement.

use camera_models::ImuNoise;

use super::config::Config;
use super::series::Finding;
use crate::allan::{Coefficient, Curve, Fit, Value};

/// Result for one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Index in [`AXES`](super::AXES).
    pub index: usize,
    /// Mean of the samples used.
    pub mean: f64,
    /// The Allan variance curve.
    pub curve: Curve,
    /// The fitted model; `None` for a rejected axis.
    pub fit: Option<Fit>,
}

/// Result of a measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Configuration of the measurement.
    pub config: Config,
    /// Measured rate, Hz.
    pub rate_hz: f64,
    /// Time spans used, s after the first sample.
    pub used_s: Vec<[f64; 2]>,
    /// The six axes in the order of [`AXES`](super::AXES); empty if the recording is rejected.
    pub axes: Vec<Axis>,
    /// All findings, most severe first.
    pub findings: Vec<Finding>,
}

/// Worst of the three axes of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Worst {
    /// The largest of the determined values.
    Known(f64),
    /// None is determined; all are below this.
    Below(f64),
    /// An axis was rejected.
    Unavailable,
}

impl Measurement {
    /// Worst value of a coefficient of the gyroscope (0) or the accelerometer (1).
    pub fn worst(&self, sensor: usize, coefficient: Coefficient) -> Worst {
        let axes = self.axes.get(3 * sensor..3 * sensor + 3).unwrap_or(&[]);
        let values: Option<Vec<Value>> = axes
            .iter()
            .map(|axis| Some(axis.fit.as_ref()?.value(coefficient)))
            .collect();
        let Some(values) = values.filter(|values| !values.is_empty()) else {
            return Worst::Unavailable;
        };
        let known = values.iter().filter_map(|v| v.known());
        if let Some(worst) = known.reduce(f64::max) {
            return Worst::Known(worst);
        }
        let limit = |v: &Value| match v {
            Value::Below(limit) => *limit,
            Value::Known { value, .. } => *value,
        };
        Worst::Below(values.iter().map(limit).fold(0.0, f64::max))
    }

    /// The noise model, if the recording determines all four coefficients.
    pub fn noise(&self) -> Option<ImuNoise> {
        let known = |sensor, coefficient| match self.worst(sensor, coefficient) {
            Worst::Known(value) => Some(value),
            _ => None,
        };
        Some(ImuNoise {
            gyro_noise_density: known(0, Coefficient::White)?,
            gyro_random_walk: known(0, Coefficient::Walk)?,
            accel_noise_density: known(1, Coefficient::White)?,
            accel_random_walk: known(1, Coefficient::Walk)?,
        })
    }

    /// Whether the recording was rejected: there is no result.
    pub fn is_rejected(&self) -> bool {
        self.axes.is_empty()
    }
}
