//! The report: verdict, reasons, results and residuals.

use anyhow::Result;
use cad_transforms::Rig;
use calib::cameras::{Calibration, Severity};
use charts::{Cell, Page, Table, Verdict};
use session_archive::manifest::Manifest;

use super::document::relative_poses;
use super::plots;
use crate::rig_poses::section;

/// HTML of the report; `rig` is the calibrated rig, if there is one.
pub(super) fn html(manifest: &Manifest, found: &Calibration, rig: Option<&Rig>) -> Result<String> {
    let verdict = match found.severity() {
        Some(Severity::Fail) => Verdict::Fail,
        Some(Severity::Warn) => Verdict::Warn,
        _ => Verdict::Pass,
    };
    let input = &found.input;
    let session = match manifest.name.as_str() {
        "" => manifest.session_id.clone(),
        name => format!("\u{201c}{name}\u{201d}"),
    };
    let mut page = Page::new(&format!("Cameras from session {session}")).verdict(verdict);
    page = page.text(&format!(
        "{} instants of {} were used. \u{b1} is two standard deviations. Identifier {}, recorded {}.",
        found.used.len(),
        input.times_ns.len(),
        manifest.session_id,
        manifest.started_civil
    ));
    for finding in &found.findings {
        page = match finding.severity {
            Severity::Fail => page.finding(Verdict::Fail, &finding.text),
            Severity::Warn => page.finding(Verdict::Warn, &finding.text),
            Severity::Note => page.text(&finding.text),
        };
    }
    if let Some(rig) = rig {
        let cameras = input.cameras.iter();
        let lenses = cameras.map(|camera| (camera.name.as_str(), found.lens(camera.left)));
        page = section(page, rig, &lenses.collect::<Vec<_>>())?;
    }
    page = page.section("Cameras against their nominal calibration");
    let mut table = Table::new(["", "Deviation from nominal", "", "\u{b1}", ""]);
    for pose in relative_poses(found) {
        let deviation = |f: fn((f64, f64)) -> f64, unit: &str| {
            pose.deviation
                .map_or("-".to_owned(), |o| format!("{:.3} {unit}", f(o)))
        };
        table = table.row([
            Cell::from(pose.what.as_str()),
            Cell::number(deviation(|o| o.0, "mm")),
            Cell::number(deviation(|o| o.1, "\u{b0}")),
            Cell::number(format!("{:.3} mm", 2.0 * pose.sigma.0)),
            Cell::number(format!("{:.4}\u{b0}", 2.0 * pose.sigma.1)),
        ]);
    }
    page = page.table(&table);
    page = page.figure(
        &plots::views(found),
        "An outlier view has a wrong pose, or the rig moved.",
    );
    page = page.figure(
        &plots::sizes(found),
        "Narrow and symmetric: the residuals are noise.",
    );
    for (number, camera) in input.cameras.iter().enumerate() {
        page = page.section(&camera.name);
        page = page.figure(
            &plots::models(found, number),
            "Lower is better; a model that only fits better predicts worse.",
        );
        page = page.figure(
            &plots::posterior_over_prior(found, number),
            "At 1 the recording does not constrain the parameter: it keeps its nominal value.",
        );
        for eye in [Some(camera.left), camera.right].into_iter().flatten() {
            page = page.table(&parameters(found, eye));
            page = page.figure(
                &plots::regions(found, eye),
                "Parallel strokes in a region are errors of the lens model.",
            );
        }
    }
    Ok(page.to_html())
}

fn parameters(found: &Calibration, eye: usize) -> Table {
    let model = found.lens(eye);
    let factory = found.input.eyes[eye].factory;
    let same = factory.filter(|f| f.distortion.name() == model.distortion.name());
    let heads = [
        found.input.eyes[eye].name.as_str(),
        "Found",
        "\u{b1}",
        "Factory",
    ];
    let mut table = Table::new(heads);
    let values = model
        .parameters()
        .into_iter()
        .zip(found.lens_sigmas(eye))
        .enumerate();
    for (k, (value, sigma)) in values {
        // Focal lengths and principal points are comparable between models.
        let nominal = match same {
            Some(factory) => Some(factory.parameters()[k]),
            None => factory.filter(|_| k < 4).map(|f| f.parameters()[k]),
        };
        table = table.row([
            Cell::from(model.parameter_names()[k]),
            Cell::number(format!("{value:.5}")),
            Cell::number(format!("{:.5}", 2.0 * sigma)),
            Cell::number(nominal.map_or("-".to_owned(), |t| format!("{t:.5}"))),
        ]);
    }
    table
}
