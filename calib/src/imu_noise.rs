//! The noise of an IMU from a recording in which it lay still.
//!
//! Contract: [`measure`] looks before it measures. Spans in which the IMU moved, stood frozen or gave single wild
//! values are left out and named; no difference is taken across what was left out, nor across a gap. Where
//! too little is left, or an axis never changes, there is a refusal with its reason in place of a result.
//! Everything doubtful is a [`Finding`] with a name.
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
/// The longest stretch without motion or gap must be this long, s.
pub const MIN_STATIC_S: f64 = 60.0;
/// Halves of a recording may differ by this many times what the noise explains.
const DRIFT_SIGMAS: f64 = 4.0;

/// What an IMU delivered.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// Rate that was promised, Hz.
    pub nominal_rate_hz: f64,
    /// Time of each sample by the sensor's clock, s.
    pub times_s: Vec<f64>,
    /// Angular rate x y z, rad/s, and specific force x y z, m/s².
    pub axes: [Vec<f64>; 6],
    /// Temperature of each sample, °C; empty where there is none.
    pub temperature_c: Vec<f32>,
    /// The runs of samples without a gap.
    pub runs: Vec<Range<usize>>,
    /// What [`Series::bridged`] has to say.
    pub bridged: Vec<Finding>,
}

/// How much a remark weighs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Good to know.
    Note,
    /// The result may be worse than it looks.
    Warn,
    /// There is no result, of an axis or of all.
    Fail,
}

/// Something about a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// How much it weighs.
    pub severity: Severity,
    /// What kind of thing, in one word: `moved`, `frozen`, `clipped`, `outliers`, `coarse`, `repeated`,
    /// `rate`, `jitter`, `gaps`, `bridged`, `short`, `temperature`, `drift`, `misfit`, `filtered`, `not finite`.
    pub kind: &'static str,
    /// What exactly.
    pub text: String,
}

/// One axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Which: a position in [`AXES`].
    pub index: usize,
    /// Mean of what was used.
    pub mean: f64,
    /// The curve.
    pub curve: Curve,
    /// The model; none for an axis that is refused.
    pub fit: Option<Fit>,
}

/// What was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Measured rate, Hz.
    pub rate_hz: f64,
    /// Stretches that were used, s after the first sample.
    pub used_s: Vec<[f64; 2]>,
    /// The six axes in the order of [`AXES`]; empty after a refusal of all.
    pub axes: Vec<Axis>,
    /// Everything worth knowing, the heaviest first.
    pub findings: Vec<Finding>,
}

/// One number for a sensor: of the three axes the worst.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Worst {
    /// The largest of those known.
    Known(f64),
    /// None is known; all are below this.
    Below(f64),
    /// An axis was refused.
    Unavailable,
}

impl Measurement {
    /// A coefficient of the gyroscope (0) or the accelerometer (1).
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

    /// The noise model, if the recording tells all four numbers.
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

    /// Whether there is any result.
    pub fn is_rejected(&self) -> bool {
        self.axes.is_empty()
    }

    /// The `imu.yaml` of Kalibr. `topic` names the stream in it, `origin` says in a comment where the
    /// numbers come from. A number that the recording does not tell is a comment and no number.
    pub fn kalibr_yaml(&self, topic: &str, origin: &str) -> String {
        file::kalibr_yaml(self, topic, origin)
    }
}

/// Measures the noise of an IMU.
///
/// # Panics
/// If the vectors of the series differ in length or a run reaches beyond them.
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

/// The curves of the six axes, each on a thread.
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

/// What a fit says against itself.
fn fit_findings(index: usize, fit: &Fit) -> Vec<Finding> {
    let mut findings = Vec::new();
    let name = AXES[index];
    let first = fit.points.first().map_or(0.0, |p| p.tau_s);
    if fit.misfit > 0.0 {
        // Where it is furthest off, which says what to look for.
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

/// Whether the halves of the longest run differ by more than the noise explains. The squared difference
/// of two neighbouring averages is on average twice the Allan variance. Only what is determined counts as
/// noise: a drift may well have been taken for the beginning of a random walk.
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
