//! Noise as text and tables, in SI and data-sheet units.

use std::f64::consts::PI;

use calib::allan::{Coefficient, Value};
use calib::imu_noise::{AXES, Axis, Measurement, Worst};
use console_output::text;

use super::result::ImuResult;

/// The coefficients that are shown.
pub(super) const SHOWN: [Coefficient; 3] = [
    Coefficient::White,
    Coefficient::Instability,
    Coefficient::Walk,
];

/// Names of a coefficient, with its unit for a gyroscope and an accelerometer.
pub(super) fn names(coefficient: Coefficient) -> (&'static str, [&'static str; 2]) {
    match coefficient {
        Coefficient::Quantisation => ("quantisation Q", ["rad", "m/s"]),
        Coefficient::White => ("white noise N", ["rad/s/√Hz", "m/s²/√Hz"]),
        Coefficient::Instability => ("bias instability B", ["rad/s", "m/s²"]),
        Coefficient::Walk => ("random walk K", ["rad/s²/√Hz", "m/s³/√Hz"]),
    }
}

/// Recorded and used duration.
pub(super) fn summary(imu: &ImuResult) -> String {
    let used: f64 = imu.found.used_s.iter().map(|[from, to]| to - from).sum();
    let continuous_runs = imu.found.used_s.len();
    format!(
        "{} at {:.2} Hz, {} used{}",
        text::count(imu.recording.samples.len() as u64, "sample"),
        imu.found.rate_hz,
        text::duration((used * 1e9) as i64),
        match continuous_runs {
            0 | 1 => String::new(),
            n => format!(" in {n} stretches"),
        }
    )
}

/// A value with two sigma, or its upper limit.
pub(super) fn cell(axis: &Axis, coefficient: Coefficient) -> String {
    match axis.fit.as_ref().map(|fit| fit.value(coefficient)) {
        None => "refused".to_owned(),
        Some(Value::Below(limit)) if !limit.is_finite() => "undetermined".to_owned(),
        Some(Value::Below(limit)) => format!("below {limit:.1e}"),
        Some(Value::Known { value, sigma, .. }) => format!("{value:.3e} ± {:.0e}", 2.0 * sigma),
    }
}

/// A coefficient in data-sheet units; `None` if data sheets do not state it.
pub(super) fn data_sheet(sensor: usize, coefficient: Coefficient, value: f64) -> Option<String> {
    let degrees = value * 180.0 / PI;
    let micro_g = value / 9.806_65e-6;
    let shown = charts::significant;
    match (sensor, coefficient) {
        (0, Coefficient::White) => Some(format!(
            "{} °/√h, {} m°/s/√Hz",
            shown(degrees * 60.0),
            shown(degrees * 1e3)
        )),
        (0, Coefficient::Instability) => Some(format!("{} °/h", shown(degrees * 3600.0))),
        (0, Coefficient::Walk) => Some(format!("{} °/h/√h", shown(degrees * 3600.0 * 60.0))),
        (1, Coefficient::White) => Some(format!(
            "{} µg/√Hz, {} m/s/√h",
            shown(micro_g),
            shown(value * 60.0)
        )),
        (1, Coefficient::Instability) => Some(format!("{} µg", shown(micro_g))),
        _ => None,
    }
}

/// The worst axis of a sensor in one line.
pub(super) fn worst(found: &Measurement, sensor: usize, coefficient: Coefficient) -> String {
    let (name, units) = names(coefficient);
    let unit = units[sensor];
    match found.worst(sensor, coefficient) {
        Worst::Known(value) => match data_sheet(sensor, coefficient, value) {
            Some(other) => format!("{name} {value:.3e} {unit} ({other})"),
            None => format!("{name} {value:.3e} {unit}"),
        },
        Worst::Below(limit) => {
            format!("{name} not determined by this recording (below {limit:.1e} {unit} with 95 %)")
        }
        Worst::Unavailable => format!("{name} not measured: an axis was rejected"),
    }
}

/// The table of one IMU.
pub(super) fn lines(found: &Measurement) -> Vec<String> {
    let mut lines = Vec::new();
    for (sensor, title) in ["gyroscope", "accelerometer"].into_iter().enumerate() {
        let axes: Vec<&Axis> = found
            .axes
            .iter()
            .filter(|a| a.index / 3 == sensor)
            .collect();
        if axes.is_empty() {
            continue;
        }
        let mut head = format!("{:8}", "");
        for coefficient in SHOWN {
            let (name, units) = names(coefficient);
            let words = format!("{name}, {}", units[sensor]);
            head.push_str(&format!("  {words:30}"));
        }
        lines.push(head.trim_end().to_owned());
        for axis in axes {
            let mut line = format!("{:8}", AXES[axis.index]);
            for coefficient in SHOWN {
                line.push_str(&format!("  {:30}", cell(axis, coefficient)));
            }
            lines.push(line.trim_end().to_owned());
        }
        for coefficient in SHOWN {
            lines.push(format!(
                "{title}, worst axis: {}",
                worst(found, sensor, coefficient)
            ));
        }
    }
    lines
}
