//! Allan deviation plots.

use calib::allan::Fit;
use calib::imu_noise::{AXES, Axis};
use charts::{Axis as Scale, Chart, REPORT_WIDTH as WIDTH, Series};

use super::result::ImuResult;
use super::table::{SHOWN, names};

const HEIGHT: u32 = 420;
/// Number of points of a drawn curve.
const CURVE_POINTS: usize = 120;

fn scales(sensor: usize) -> (Scale, Scale) {
    let unit = ["rad/s", "m/s²"][sensor];
    (
        Scale::log("averaging time τ", "s"),
        Scale::log("Allan deviation", unit),
    )
}

/// Averaging times of a curve, logarithmically spaced.
fn taus(fit: &Fit) -> impl Iterator<Item = f64> + use<> {
    let ends = fit.points.first().zip(fit.points.last());
    let (first, last) = ends.map_or((1.0, 1.0), |(a, b)| (a.tau_s, b.tau_s));
    let step = (last / first).ln() / (CURVE_POINTS - 1) as f64;
    (0..CURVE_POINTS).map(move |i| first * (step * i as f64).exp())
}

/// The three axes of the gyroscope (0) or the accelerometer (1): measurement and models.
pub(super) fn sensor(imu: &ImuResult, sensor: usize) -> String {
    let (x, y) = scales(sensor);
    let title = ["gyroscope", "accelerometer"][sensor];
    let mut chart = Chart::new(&format!(
        "{}: Allan deviation of the {title}",
        imu.recording.name
    ))
    .subtitle("marks: measured; lines: fitted noise model")
    .x_axis(x)
    .y_axis(y);
    let axes = imu
        .found
        .axes
        .iter()
        .filter(|axis| axis.index / 3 == sensor);
    for (slot, axis) in axes.enumerate() {
        let points = axis.curve.points.iter().map(|p| (p.tau_s, p.deviation()));
        chart = chart.series(Series::scatter(AXES[axis.index], points).slot(slot));
        if let Some(fit) = &axis.fit {
            let line = taus(fit).map(|tau| (tau, fit.deviation(tau)));
            chart = chart.series(Series::line("", line).slot(slot));
        }
    }
    chart.to_svg(WIDTH, HEIGHT)
}

/// One axis: measurement with its 95 % band, the model, and its components.
pub(super) fn axis(axis: &Axis) -> Option<String> {
    let fit = axis.fit.as_ref()?;
    let (x, y) = scales(axis.index / 3);
    let band = |k: usize| fit.points.iter().map(move |p| (p.tau_s, p.interval[k]));
    let measured = fit.points.iter().map(|p| (p.tau_s, p.deviation));
    let low = band(0)
        .chain(band(1))
        .map(|p| p.1)
        .fold(f64::INFINITY, f64::min);
    let mut chart = Chart::new(&format!("{} with its parts", AXES[axis.index]))
        .x_axis(x)
        .y_axis(y)
        .series(Series::scatter("measured", measured).slot(0))
        .series(Series::line("95 %", dense(band(0).collect())).slot(5))
        .series(Series::line("", dense(band(1).collect())).slot(5))
        .series(Series::line("model", taus(fit).map(|t| (t, fit.deviation(t)))).slot(6));
    for (k, coefficient) in SHOWN.into_iter().enumerate() {
        let part = taus(fit).filter_map(|t| Some((t, fit.part(coefficient, t)?)));
        // A component far below the curve would only make the chart tall.
        let part: Vec<(f64, f64)> = part.filter(|p| p.1 > 0.5 * low).collect();
        if !part.is_empty() {
            let (name, _) = names(coefficient);
            chart = chart.series(Series::line(name, dense(part)).slot(k + 1));
        }
    }
    Some(chart.to_svg(WIDTH, HEIGHT))
}

/// Inserts points, so that the line is drawn without marks.
fn dense(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let between = |w: &[(f64, f64)]| {
        let ((x0, y0), (x1, y1)) = (w[0], w[1]);
        [0, 1, 2].map(|k| {
            let share = f64::from(k) / 3.0;
            (x0 * (x1 / x0).powf(share), y0 * (y1 / y0).powf(share))
        })
    };
    let mut line: Vec<(f64, f64)> = points.windows(2).flat_map(between).collect();
    line.extend(points.last());
    line
}
