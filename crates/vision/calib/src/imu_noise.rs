//! IMU noise from a static recording.
//!
//! Contract: [`measure`] screens the recording first. Spans in which the IMU moved, was frozen or
//! had single outliers are excluded and reported; no difference is taken across an excluded span or
//! a gap. If too little is left, or an axis never changes, there is no result but a finding with
//! the reason. Everything questionable is a [`Finding`] with a kind.
//!
//! Units are SI: rad/s and m/s², noise as in [`ImuNoise`].

mod bridge;
mod file;
mod screen;

use std::ops::Range;
use std::thread;

use crate::allan::fit::Fitter;
use crate::allan::{Coefficient, Curve, Fit, Value, curve};
use crate::stereo::ImuNoise;

/// Names of the six axes, gyroscope first.
pub const AXES: [&str; 6] = [
    "gyro x", "gyro y", "gyro z", "accel x", "accel y", "accel z",
];
/// Minimum length of the longest static run without a gap, s.
pub const MIN_STATIC_S: f64 = 60.0;
/// Maximum difference between the halves of a recording, in multiples of the expected noise.
const DRIFT_SIGMAS: f64 = 4.0;

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

/// Result for one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Index in [`AXES`].
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
    /// Measured rate, Hz.
    pub rate_hz: f64,
    /// Time spans used, s after the first sample.
    pub used_s: Vec<[f64; 2]>,
    /// The six axes in the order of [`AXES`]; empty if the recording is rejected.
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

    /// The `imu.yaml` of Kalibr. `topic` names the stream in it, `origin` is a comment on the
    /// source of the values. A coefficient that is not determined is a comment instead of a value.
    pub fn kalibr_yaml(&self, topic: &str, origin: &str) -> String {
        file::kalibr_yaml(self, topic, origin)
    }
}

/// Measures the noise of an IMU.
///
/// # Panics
/// If the vectors of the series differ in length or a run extends beyond them.
pub fn measure(series: &Series) -> Measurement {
    let screened = screen::screen(series);
    let mut findings = screened.findings;
    findings.extend(series.bridged.iter().cloned());
    let first = series.times_s.first().copied().unwrap_or(0.0);
    let seconds = |run: &Range<usize>| {
        let at = |i: usize| series.times_s[i] - first;
        [at(run.start), at(run.end - 1)]
    };
    let mut measurement = Measurement {
        rate_hz: 1.0 / screened.period_s,
        used_s: screened.still.iter().map(seconds).collect(),
        axes: Vec::new(),
        findings: Vec::new(),
    };
    if findings.iter().all(|r| r.severity != Severity::Fail) {
        let curves = curves(series, &screened.still, screened.period_s);
        let fitter = curves.first().map(Fitter::new);
        for (index, curve) in curves.into_iter().enumerate() {
            let fit = fitter.as_ref().filter(|_| !screened.dead[index]);
            let fit = fit.and_then(|fitter| fitter.fit(&curve));
            let axis = &series.axes[index];
            let used: usize = screened.still.iter().map(Range::len).sum();
            let sum: f64 = screened
                .still
                .iter()
                .flat_map(|run| &axis[run.clone()])
                .sum();
            if let Some(fit) = &fit {
                findings.extend(fit_findings(index, fit));
                findings.extend(drift(index, fit, axis, &screened.still, screened.period_s));
            }
            measurement.axes.push(Axis {
                index,
                mean: sum / used.max(1) as f64,
                curve,
                fit,
            });
        }
    }
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    measurement.findings = findings;
    measurement
}

/// The curves of the six axes, one thread each.
fn curves(series: &Series, runs: &[Range<usize>], period_s: f64) -> Vec<Curve> {
    thread::scope(|scope| {
        let axes = series.axes.iter();
        let threads: Vec<_> = axes
            .map(|axis| scope.spawn(move || curve(axis, runs, period_s)))
            .collect();
        let joined = threads.into_iter().map(|thread| match thread.join() {
            Ok(curve) => curve,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        joined.collect()
    })
}

/// Findings on the quality of a fit.
fn fit_findings(index: usize, fit: &Fit) -> Vec<Finding> {
    let mut findings = Vec::new();
    let name = AXES[index];
    let first = fit.points.first().map_or(0.0, |p| p.tau_s);
    if fit.misfit > 0.0 {
        // The point with the largest deviation indicates the cause.
        let off =
            |p: &&crate::allan::fit::Scatter| (p.deviation / fit.deviation(p.tau_s)).ln().abs();
        let points = fit.points.iter().filter(|p| p.freedom > 20.0);
        let worst = points.max_by(|a, b| off(a).total_cmp(&off(b)));
        let at = worst.map_or(0.0, |p| p.tau_s);
        findings.push(Finding {
            severity: Severity::Warn,
            kind: "misfit",
            text: format!(
                "{name}: the curve is off the noise model by about {:.1} %, most at {at:.3} s: something periodic, \
                 a filter or a slow motion; the uncertainties allow for it",
                100.0 * fit.misfit
            ),
        });
    } else if fit.from_s > first {
        findings.push(Finding {
            severity: Severity::Note,
            kind: "filtered",
            text: format!(
                "{name}: averages shorter than {:.3} s do not follow the model and were left out: the sensor \
                 filters or repeats its values",
                fit.from_s
            ),
        });
    }
    findings
}

/// Whether the halves of the longest run differ by more than the noise explains. The squared
/// difference of two neighbouring averages is on average twice the Allan variance. Only determined
/// coefficients count as noise: a drift may have been fitted as the beginning of a random walk.
fn drift(
    index: usize,
    fit: &Fit,
    axis: &[f64],
    runs: &[Range<usize>],
    period_s: f64,
) -> Option<Finding> {
    let longest = runs.iter().max_by_key(|run| run.len())?;
    let half = longest.len() / 2;
    let mean = |from: usize| axis[from..from + half].iter().sum::<f64>() / half as f64;
    let moved = mean(longest.start + half) - mean(longest.start);
    let tau_s = half as f64 * period_s;
    let determined = |c: &&Coefficient| fit.value(**c).known().is_some();
    let parts = Coefficient::ALL.iter().filter(determined);
    let variance: f64 = parts
        .filter_map(|c| fit.part(*c, tau_s))
        .map(|part| part * part)
        .sum();
    let expected = (2.0 * variance).sqrt();
    let walks = fit.value(Coefficient::Walk).known().is_some();
    (moved.abs() > DRIFT_SIGMAS * expected).then(|| Finding {
        severity: if walks { Severity::Warn } else { Severity::Note },
        kind: "drift",
        text: format!(
            "{}: the halves of the recording differ by {:.2e} {}, {:.0} times what its measured noise explains: {}",
            AXES[index],
            moved,
            if index < 3 { "rad/s" } else { "m/s²" },
            moved.abs() / expected,
            if walks {
                "still warming up?"
            } else {
                "still warming up, or a random walk that needs a longer recording"
            }
        ),
    })
}

#[cfg(test)]
mod tests;
