//! Plots of a calibration: image coverage, and residuals by region, view and size.

use calib::adjust::Prior;
use calib::cameras::Calibration;
use charts::{Axis, Bins, Chart, REPORT_WIDTH as WIDTH, Series};

/// Magnification of drawn residuals.
const RESIDUAL_SCALE: f64 = 1000.0;
/// Every n-th corner is drawn.
const CORNER_STRIDE: usize = 5;
/// Columns and rows of image regions over which residuals are averaged.
const REGIONS: (usize, usize) = (12, 8);
/// Minimum number of residuals of a region that is drawn.
const MIN_RESIDUALS: usize = 5;

/// Corners, residuals in pixels and views of one eye.
fn residuals(found: &Calibration, eye: usize) -> Vec<([f64; 2], [f64; 2])> {
    let views = found
        .solution
        .problem
        .views
        .iter()
        .zip(&found.solution.residuals);
    let own = views.filter(|(view, _)| view.lens == eye);
    own.flat_map(|(view, residuals)| view.points.iter().zip(residuals))
        .filter_map(|(point, residual)| Some((point.pixel, (*residual)?)))
        .collect()
}

/// Detected corners, and the mean residual of each region as a line.
pub(super) fn regions(found: &Calibration, eye: usize) -> String {
    let (width, height) = found.input.eyes[eye].size;
    let (w, h) = (f64::from(width), f64::from(height));
    let all = residuals(found, eye);
    // Charts have their origin at the lower left.
    let seen = all
        .iter()
        .step_by(CORNER_STRIDE)
        .map(|([x, y], _)| (*x, h - 1.0 - y));
    let mut sums = vec![([0.0; 2], [0.0; 2], 0usize); REGIONS.0 * REGIONS.1];
    for ([x, y], [dx, dy]) in &all {
        let cell = |v: f64, n: usize| ((v.max(0.0) * n as f64) as usize).min(n - 1);
        let at = cell(y / h, REGIONS.1) * REGIONS.0 + cell(x / w, REGIONS.0);
        let (pose, sum, count) = &mut sums[at];
        (pose[0], pose[1]) = (pose[0] + x, pose[1] + y);
        (sum[0], sum[1]) = (sum[0] + dx, sum[1] + dy);
        *count += 1;
    }
    let mut strokes = Vec::new();
    for (pose, sum, count) in sums.into_iter().filter(|s| s.2 >= MIN_RESIDUALS) {
        let n = count as f64;
        let (x, y) = (pose[0] / n, h - 1.0 - pose[1] / n);
        strokes.push((x, y));
        strokes.push((
            x + RESIDUAL_SCALE * sum[0] / n,
            y - RESIDUAL_SCALE * sum[1] / n,
        ));
        strokes.push((f64::NAN, f64::NAN));
    }
    Chart::new(&found.input.eyes[eye].name)
        .subtitle(&format!(
            "detected corners, and the mean residual of each region, {RESIDUAL_SCALE:.0} times enlarged"
        ))
        .x_axis(Axis::linear("column", "px").include(0.0).include(w))
        .y_axis(Axis::linear("rows above the lower edge", "px").include(0.0).include(h))
        .series(Series::scatter("corners", seen))
        .series(Series::line("mean residual", strokes).slot(1))
        .to_svg(WIDTH, (f64::from(WIDTH) * h / w).min(520.0) as u32)
}

/// Residual RMS of every view over time, one series per eye.
pub(super) fn views(found: &Calibration) -> String {
    let input = &found.input;
    let first = input.times_ns.first().copied().unwrap_or(0);
    let mut chart = Chart::new("Residuals of every view")
        .x_axis(Axis::time("time in the recording"))
        .y_axis(Axis::linear("RMS", "px").include(0.0));
    for eye in 0..input.eyes.len() {
        let views = found
            .solution
            .problem
            .views
            .iter()
            .zip(&found.solution.residuals);
        let points = views
            .filter(|(view, _)| view.lens == eye)
            .map(|(view, residuals)| {
                let squares = residuals.iter().flatten().map(|[x, y]| x * x + y * y);
                let n = residuals.iter().flatten().count().max(1) as f64;
                let at = input.times_ns[found.instant_of(view.instant)] - first;
                (1e-9 * at as f64, (squares.sum::<f64>() / n).sqrt())
            });
        chart = chart.series(Series::scatter(
            &input.eyes[eye].name,
            points.collect::<Vec<_>>(),
        ));
    }
    chart.to_svg(WIDTH, 300)
}

/// Distribution of the residuals of all eyes.
pub(super) fn sizes(found: &Calibration) -> String {
    let lengths = (0..found.input.eyes.len())
        .flat_map(|eye| residuals(found, eye))
        .flat_map(|(_, [x, y])| [x, y]);
    Chart::new("Residuals in x and y")
        .x_axis(Axis::linear("measured minus predicted", "px"))
        .y_axis(Axis::linear("corners", ""))
        .series(Series::histogram(
            "residuals",
            lengths.collect::<Vec<_>>(),
            Bins::Count(60),
        ))
        .to_svg(WIDTH, 260)
}

/// Posterior over prior sigma of each intrinsic parameter of a camera.
pub(super) fn posterior_over_prior(found: &Calibration, camera: usize) -> String {
    let camera = &found.input.cameras[camera];
    let names = found.lens(camera.left).parameter_names();
    let mut chart = Chart::new(&format!(
        "Information gain of the intrinsics of {}",
        camera.name
    ))
    .x_axis(Axis::categories("parameter", names))
    .y_axis(Axis::log("posterior over prior sigma", ""));
    for eye in [Some(camera.left), camera.right].into_iter().flatten() {
        let priors = &found.solution.problem.lenses[eye].priors;
        let sigmas = found.lens_sigmas(eye).into_iter().zip(priors);
        let shares = sigmas.map(|(sigma, prior)| match prior {
            Prior::Near { sigma: before, .. } => sigma / before,
            Prior::Free | Prior::Fixed => f64::NAN,
        });
        let name = &found.input.eyes[eye].name;
        chart = chart.series(Series::bars(name, shares.collect::<Vec<_>>()));
    }
    chart.to_svg(WIDTH, 280)
}

/// Fit error and held-out error of each lens model.
pub(super) fn models(found: &Calibration, camera: usize) -> String {
    let choice = &found.choices[camera];
    let names = choice.candidates.iter().map(|c| c.model);
    let rms = choice.candidates.iter().map(|c| c.rms_px);
    let held = choice
        .candidates
        .iter()
        .map(|c| c.held_out_px.unwrap_or(f64::NAN));
    let chosen = choice.candidates[choice.chosen].model;
    Chart::new(&format!(
        "Lens models of {}",
        found.input.cameras[camera].name
    ))
    .subtitle(&format!(
        "{chosen} was taken: the simplest that predicts as well as the best"
    ))
    .x_axis(Axis::categories("model", names.collect::<Vec<_>>()))
    .y_axis(Axis::log("RMS", "px"))
    .series(Series::bars(
        "views that it was fitted to",
        rms.collect::<Vec<_>>(),
    ))
    .series(Series::bars(
        "views that were held out",
        held.collect::<Vec<_>>(),
    ))
    .to_svg(WIDTH, 280)
}
