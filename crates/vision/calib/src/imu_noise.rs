//! IMU noise from a static recording.
//!
//! Contract: [`measure`] screens the recording first. Spans in which the IMU moved, was frozen or
//! had single outliers are excluded and reported; no difference is taken across an excluded span or
//! a gap. If too little is left, or an axis never changes, there is no result but a finding with
//! the reason. Everything questionable is a [`Finding`] with a kind.
//!
//! Units are SI: rad/s and m/s², noise as in [`ImuNoise`](camera_models::ImuNoise).

mod bridge;
mod config;
mod file;
mod measurement;
mod screen;
mod series;

use std::ops::Range;
use std::thread;

use crate::allan::fit::Fitter;
use crate::allan::{Coefficient, Curve, Fit, curve};

pub use config::{BridgingConfig, Config, ScreeningConfig};
pub use measurement::{Axis, Measurement, Worst};
pub use series::{AXES, Finding, Series, Severity};

/// Measures the noise of an IMU.
///
/// # Panics
/// If the vectors of the series differ in length or a run extends beyond them.
pub fn measure(series: &Series, config: &Config) -> Measurement {
    let mut screened = screen::screen(series, &config.screening);
    let mut findings = std::mem::take(&mut screened.findings);
    findings.extend(series.bridged.iter().cloned());
    let first = series.times_s.first().copied().unwrap_or(0.0);
    let seconds = |run: &Range<usize>| {
        let at = |i: usize| series.times_s[i] - first;
        [at(run.start), at(run.end - 1)]
    };
    let mut measurement = Measurement {
        config: *config,
        rate_hz: 1.0 / screened.period_s,
        used_s: screened.still.iter().map(seconds).collect(),
        axes: Vec::new(),
        findings: Vec::new(),
    };
    if findings.iter().all(|r| r.severity != Severity::Fail) {
        let curves = curves(series, &screened.still, screened.period_s);
        let fitter = curves.first().map(|curve| Fitter::new(curve, &config.fit));
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
                findings.extend(drift(index, fit, axis, &screened, config));
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
    screened: &screen::Screening,
    config: &Config,
) -> Option<Finding> {
    let longest = screened.still.iter().max_by_key(|run| run.len())?;
    let half = longest.len() / 2;
    let mean = |from: usize| axis[from..from + half].iter().sum::<f64>() / half as f64;
    let moved = mean(longest.start + half) - mean(longest.start);
    let tau_s = half as f64 * screened.period_s;
    let determined = |c: &&Coefficient| fit.value(**c).known().is_some();
    let parts = Coefficient::ALL.iter().filter(determined);
    let variance: f64 = parts
        .filter_map(|c| fit.part(*c, tau_s))
        .map(|part| part * part)
        .sum();
    let expected = (2.0 * variance).sqrt();
    let walks = fit.value(Coefficient::Walk).known().is_some();
    (moved.abs() > config.drift_sigma * expected).then(|| Finding {
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
