//! Samples of an IMU, and findings about them.

use std::ops::Range;

/// Names of the six axes, gyroscope first.
pub const AXES: [&str; 6] = [
    "gyro x", "gyro y", "gyro z", "accel x", "accel y", "accel z",
];

/// Samples of an IMU.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// Nominal rate, Hz.
    pub nominal_rate_hz: f64,
    /// Time of each sample by the sensor's clock, s.
    pub times_s: Vec<f64>,
    /// Angular rate x y z, rad/s, and specific force x y z, m/s².
    pub axes: [Vec<f64>; 6],
    /// Temperature of each sample, °C; empty if not measured.
    pub temperature_c: Vec<f32>,
    /// The runs of samples without a gap.
    pub runs: Vec<Range<usize>>,
    /// Findings of [`Series::bridged`].
    pub bridged: Vec<Finding>,
}

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Information.
    Note,
    /// The result may be worse than it appears.
    Warn,
    /// No result, for an axis or for all.
    Fail,
}

/// Finding about a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Severity.
    pub severity: Severity,
    /// Kind, in one word: `moved`, `frozen`, `clipped`, `outliers`, `coarse`, `repeated`, `rate`,
    /// `jitter`, `gaps`, `bridged`, `short`, `temperature`, `drift`, `misfit`, `filtered`, `not
    /// finite`.
    pub kind: &'static str,
    /// Description.
    pub text: String,
}
