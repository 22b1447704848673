//! Kalibr's `imu.yaml`.

use std::fmt::Write as _;

use super::measurement::{Measurement, Worst};
use super::series::AXES;
use crate::allan::{Coefficient, Value};

impl Measurement {
    /// The `imu.yaml` of Kalibr. `topic` names the stream in it, `origin` is a comment on the
    /// source of the values. A coefficient that is not determined is a comment instead of a value.
    pub fn kalibr_yaml(&self, topic: &str, origin: &str) -> String {
        kalibr_yaml(self, topic, origin)
    }
}

fn kalibr_yaml(found: &Measurement, topic: &str, origin: &str) -> String {
    let mut text = String::new();
    for line in origin.lines() {
        let _ = writeln!(text, "# {line}");
    }
    let _ = writeln!(
        text,
        "# Of three axes each number is the worst. Continuous time, SI units."
    );
    let sensors = [("accelerometer", 1, "m/s"), ("gyroscope", 0, "rad/s")];
    for (sensor, index, unit) in sensors {
        let numbers = [
            ("noise_density", Coefficient::White, "^2"),
            ("random_walk", Coefficient::Walk, "^3"),
        ];
        for (name, coefficient, power) in numbers {
            // m/s² and m/s³, but rad/s and rad/s².
            let unit = match (index, power) {
                (1, power) => format!("{unit}{power}/sqrt(Hz)"),
                (_, "^2") => format!("{unit}/sqrt(Hz)"),
                _ => format!("{unit}^2/sqrt(Hz)"),
            };
            let key = format!("{sensor}_{name}");
            let _ = match found.worst(index, coefficient) {
                Worst::Known(value) => writeln!(text, "{key}: {value:.6e} # {unit}"),
                Worst::Below(limit) => writeln!(
                    text,
                    "# {key}: not determined by this recording; below {limit:.2e} {unit} with 95 %"
                ),
                Worst::Unavailable => writeln!(text, "# {key}: an axis gave nothing to measure"),
            };
            for axis in found.axes.iter().filter(|axis| axis.index / 3 == index) {
                let value = axis.fit.as_ref().map(|fit| fit.value(coefficient));
                let words = match value {
                    None => "refused".to_owned(),
                    Some(Value::Below(limit)) => format!("below {limit:.2e}"),
                    Some(Value::Known { value, sigma, .. }) => {
                        format!("{value:.4e}, two sigma {:.1e}", 2.0 * sigma)
                    }
                };
                let _ = writeln!(text, "#   {}: {words}", AXES[axis.index]);
            }
        }
    }
    let _ = writeln!(text, "rostopic: {topic}");
    let _ = writeln!(text, "update_rate: {:.3}", found.rate_hz);
    text
}
