//! The report: verdict, reasons, results and curves.

use calib::allan::fit::Coefficient;
use calib::imu_noise::{AXES, Severity};
use charts::{Cell, Page, Table, Verdict};
use session_archive::manifest::Manifest;

use super::plots;
use super::result::ImuResult;
use super::table::{SHOWN, cell, names, summary, worst};

pub(super) fn html(manifest: &Manifest, all: &[ImuResult]) -> String {
    let weights = all
        .iter()
        .flat_map(|imu| &imu.found.findings)
        .map(|r| r.severity);
    let verdict = weights.max().map_or(Verdict::Pass, badge);
    let session = match manifest.name.as_str() {
        "" => manifest.session_id.clone(),
        name => format!("\u{201c}{name}\u{201d}"),
    };
    let mut page = Page::new(&format!("IMU noise from session {session}")).verdict(verdict);
    page = page.text(&format!(
        "Overlapping Allan deviation, fitted by N, B and K as IEEE Std 952 defines them, each axis by itself. ± is two \
         standard deviations. Identifier {}, recorded {}.",
        manifest.session_id, manifest.started_civil
    ));
    for imu in all {
        page = page.section(&imu.recording.name);
        page = page.text(&format!("{}. {}.", imu.recording.source, summary(imu)));
        for remark in &imu.found.findings {
            let text = format!("{}: {}", remark.kind, remark.text);
            page = match remark.severity {
                Severity::Note => page.text(&text),
                weight => page.finding(badge(weight), &text),
            };
        }
        for sensor in 0..2 {
            let axes = || {
                imu.found
                    .axes
                    .iter()
                    .filter(|axis| axis.index / 3 == sensor)
            };
            if axes().next().is_none() {
                continue;
            }
            let mut heads = vec!["Axis".to_owned()];
            heads.extend(SHOWN.map(|c| format!("{}, {}", names(c).0, names(c).1[sensor])));
            heads.push("Mean".to_owned());
            let mut table = Table::new(heads);
            for axis in axes() {
                let mut cells = vec![Cell::from(AXES[axis.index])];
                cells.extend(SHOWN.map(|c| Cell::number(cell(axis, c))));
                cells.push(Cell::number(format!("{:.5}", axis.mean)));
                table = table.row(cells);
            }
            page = page.table(&table);
            let words = SHOWN.map(|c: Coefficient| worst(&imu.found, sensor, c));
            let caption = format!("Worst axis: {}.", words.join("; "));
            page = page.figure(&plots::sensor(imu, sensor), &caption);
        }
        for axis in &imu.found.axes {
            if let Some(svg) = plots::axis(axis) {
                page = page.figure(&svg, "");
            }
        }
    }
    page.to_html()
}

fn badge(weight: Severity) -> Verdict {
    match weight {
        Severity::Note => Verdict::Pass,
        Severity::Warn => Verdict::Warn,
        Severity::Fail => Verdict::Fail,
    }
}
