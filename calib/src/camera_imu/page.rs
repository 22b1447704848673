//! The report: verdict, result and residuals.

use anyhow::Result;
use cad_transforms::Rig;
use calib::camera_imu::{CameraImu, Residual, Verdict as Gate};
use charts::{
    Axis, Cell, Chart, Page, REPORT_HEIGHT as HEIGHT, REPORT_WIDTH as WIDTH, Series, Table, Verdict,
};
use session_archive::manifest::Manifest;

use super::result::CameraResult;
use super::table::rows;
use crate::rig_poses::section;

/// HTML of the report; `rig` is the rig with its IMUs, if there is one.
pub(super) fn html(manifest: &Manifest, all: &[CameraResult], rig: Option<&Rig>) -> Result<String> {
    let worst = all.iter().map(|m| match &m.found {
        Ok(found) => found.verdict(),
        Err(_) => Gate::Fail,
    });
    let verdict = badge(worst.max().unwrap_or(Gate::Fail));
    let session = match manifest.name.as_str() {
        "" => manifest.session_id.clone(),
        name => format!("\u{201c}{name}\u{201d}"),
    };
    let mut page = Page::new(&format!("Cameras and IMUs from session {session}")).verdict(verdict);
    page = page.text(&format!(
        "Rotation is that from the nominal value to the estimate, about the axes of the left camera. The time offset is \
         added to an image's time to find its IMU samples. Sigma is one standard deviation. Identifier \
         {}, recorded {}.",
        manifest.session_id, manifest.started_civil
    ));
    if let Some(rig) = rig {
        let lenses = all.iter().filter_map(|m| {
            let (lens, _) = m.lenses.first()?;
            Some((m.camera.as_str(), lens))
        });
        page = section(page, rig, &lenses.collect::<Vec<_>>())?;
    }
    for result in all {
        page = page.section(&result.camera);
        page = match &result.found {
            Ok(found) => camera(page, result, found),
            Err(error) => page.finding(Verdict::Fail, &format!("No result: {error:#}")),
        };
    }
    Ok(page.to_html())
}

/// Accessor of one kind of residual.
type Of<'a> = &'a dyn Fn(&Residual) -> Option<f64>;

fn badge(gate: Gate) -> Verdict {
    match gate {
        Gate::Pass => Verdict::Pass,
        Gate::Warn => Verdict::Warn,
        Gate::Fail => Verdict::Fail,
    }
}

fn camera(mut page: Page, result: &CameraResult, found: &CameraImu) -> Page {
    let mut table = Table::new(["Quantity", "Nominal", "Estimate", "Sigma", "Unit"]);
    for row in rows(result, found) {
        let nominal = row.nominal.map_or("".to_owned(), |t| format!("{t:.4}"));
        table = table.row([
            Cell::Text(row.name),
            Cell::number(nominal),
            Cell::number(format!("{:.4}", row.found)),
            Cell::number(format!("{:.4}", row.sigma)),
            Cell::from(row.unit),
        ]);
    }
    page = page.table(&table);
    let mut gates = Table::new(["", "Check", "Result"]);
    for gate in &found.gates {
        gates = gates.row([
            Cell::Verdict(badge(gate.verdict)),
            Cell::from(gate.name),
            Cell::Text(gate.text.clone()),
        ]);
    }
    page = page.table(&gates);
    let residuals = &found.residuals;
    let kinds: [(&str, Of<'_>); 4] = [
        ("corners, in stated sigmas", &|r| Some(r.corner)),
        ("poses, in estimated sigmas", &|r| Some(r.pose)),
        ("gyroscope, in estimated sigmas", &|r| r.gyro),
        ("accelerometer, in estimated sigmas", &|r| r.accel),
    ];
    let zero = residuals.first().map_or(0, |r| r.time_ns);
    for (name, of) in kinds {
        let points = residuals
            .iter()
            .filter_map(|r| Some(((r.time_ns - zero) as f64 * 1e-9, of(r)?)));
        let chart = Chart::new(&format!("Residuals: {name}"))
            .x_axis(Axis::linear("time", "s"))
            .y_axis(Axis::linear("RMS", "").include(0.0))
            .series(Series::scatter("", points));
        page = page.figure(&chart.to_svg(WIDTH, HEIGHT), "");
    }
    let points = found.correlation.iter().map(|[t, c]| (1e3 * t, *c));
    let chart = Chart::new("Correlation of angular rates by time offset")
        .x_axis(Axis::linear("time offset", "ms"))
        .y_axis(Axis::linear("correlation", "").include(0.0).include(1.0))
        .series(Series::line("", points))
        .vline(1e3 * found.time_offset_s, "found");
    page = page.figure(
        &chart.to_svg(WIDTH, HEIGHT),
        "Correlation for the initial time offset.",
    );
    let mut chart = Chart::new("Lever arm: two-sigma ellipses")
        .subtitle("about the estimate")
        .x_axis(Axis::linear("along the first axis", "mm"))
        .y_axis(Axis::linear("along the second axis", "mm"));
    for (slot, (name, a, b)) in [("x y", 3, 4), ("y z", 4, 5), ("z x", 5, 3)]
        .into_iter()
        .enumerate()
    {
        chart = chart.series(Series::line(name, ellipse(found, a, b)).slot(slot));
    }
    page.figure(&chart.to_svg(WIDTH, HEIGHT), "")
}

/// Two-sigma ellipse of two of the seven parameters, mm.
fn ellipse(found: &CameraImu, a: usize, b: usize) -> Vec<(f64, f64)> {
    let c = &found.covariance;
    // Cholesky factor of the 2x2 block.
    let first = c[(a, a)].max(0.0).sqrt();
    let along = c[(a, b)] / first.max(f64::MIN_POSITIVE);
    let rest = (c[(b, b)] - along * along).max(0.0).sqrt();
    (0..=72)
        .map(|k| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 72.0).sin_cos();
            (2e3 * first * cos, 2e3 * (along * cos + rest * sin))
        })
        .collect()
}
