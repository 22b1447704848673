//! The report: verdict, estimate of each parameter, and charts.

use calib::verify::{CameraFound, Finding as Found};
use charts::{Axis, Bins, Cell, Chart, Page, Series, Table, Verdict as Badge};
use session_archive::handoff::Verdict;
use session_archive::manifest::Manifest;

use super::SessionVerification;
use crate::quality::Finding;

const WIDTH: u32 = 760;
const HEIGHT: u32 = 300;

pub(super) fn html(
    manifest: &Manifest,
    checked: &SessionVerification,
    findings: &[Finding],
    verdict: Verdict,
) -> String {
    let session = match manifest.name.as_str() {
        "" => manifest.session_id.clone(),
        name => format!("\u{201c}{name}\u{201d}"),
    };
    let mut page =
        Page::new(&format!("Calibration against session {session}")).verdict(badge(verdict));
    let against = match &checked.revision {
        Some((file, revision)) => format!("{file}, revision {revision}"),
        None => "what was recorded with the session; no rig file was read".to_owned(),
    };
    page = page.text(&format!(
        "Against {against}. {} bursts of pictures, and all samples of the gyroscopes. A number is off where it differs \
         by more than two sigmas of its tolerance and {} sigmas of the measurement together.",
        checked.bursts,
        calib::verify::SURE
    ));
    for finding in findings.iter().filter(|f| f.verdict != Verdict::Pass) {
        page = page.finding(badge(finding.verdict), &finding.text);
    }
    for what in &checked.left_out {
        page = page.text(&format!("Left out: {what}."));
    }
    page = page.section("Told numbers");
    let mut table = Table::new([
        "",
        "Found against told",
        "Sigma",
        "Would be noticed from",
        "Verdict",
    ]);
    for found in &checked.verification.findings {
        let mut verdict = checked.verdict(found, findings);
        if verdict.is_empty() {
            verdict = "not determined".to_owned();
        }
        table = table.row([
            Cell::from(format!("{}: {}", found.camera, name(found))),
            Cell::number(components(found)),
            Cell::number(shown(found, found.sigma)),
            Cell::number(shown(found, found.noticed)),
            Cell::from(verdict),
        ]);
    }
    page = page.table(&table);
    page = page.text(
        "Turns are about the x, y and z axes of the left optical frame, those of eyes of the right one. Delays are \
         positive where stamps are late.",
    );
    page = page.figure(
        &angles(checked),
        "What was found about each axis. Beyond the lines it is noticed 39 times in 40.",
    );
    for camera in &checked.verification.cameras {
        page = page.section(&camera.name);
        page = one(page, camera);
    }
    page.to_html()
}

fn badge(verdict: Verdict) -> Badge {
    match verdict {
        Verdict::Pass => Badge::Pass,
        Verdict::Warn => Badge::Warn,
        Verdict::Fail => Badge::Fail,
    }
}

fn name(found: &Found) -> &'static str {
    use calib::verify::What;
    match found.what {
        What::Eyes => "right eye",
        What::Camera => "on the plate",
        What::Imu => "IMU in the camera",
        What::Pictures => "times of pictures",
        What::Samples => "times of IMU samples",
        What::Clock => "clock",
    }
}

fn shown(found: &Found, value: f64) -> String {
    match found.what.is_turn() {
        true => format!("{:.3}\u{b0}", value.to_degrees()),
        false => format!("{:.2} ms", value * 1e3),
    }
}

fn components(found: &Found) -> String {
    let all: Vec<String> = found.found.iter().map(|v| shown(found, *v)).collect();
    all.join(", ")
}

/// Every estimated angle, with its detection threshold.
fn angles(checked: &SessionVerification) -> String {
    let rotations = || {
        let all = checked.verification.findings.iter();
        all.filter(|f| f.what.is_turn() && !f.found.is_empty())
    };
    let names: Vec<String> = rotations()
        .map(|f| format!("{} {}", f.camera, name(f)))
        .collect();
    let mut chart = Chart::new("Turns found against told")
        .x_axis(Axis::categories("", names))
        .y_axis(Axis::linear("angle", "\u{b0}").include(0.0));
    for (axis, label) in ["x", "y", "z"].iter().enumerate() {
        let values = rotations()
            .enumerate()
            .map(|(i, f)| (i as f64, f.found[axis].to_degrees()));
        chart = chart.series(Series::scatter(label, values));
    }
    for (sign, label) in [(1.0, "noticed from"), (-1.0, "noticed from, below")] {
        let off = rotations().enumerate();
        let off = off.map(|(i, f)| (i as f64, sign * f.noticed.to_degrees()));
        chart = chart.series(Series::steps(label, off));
    }
    chart.to_svg(WIDTH, HEIGHT)
}

fn one(mut page: Page, camera: &CameraFound) -> Page {
    match &camera.eyes {
        None => page = page.text("Too little was matched between the eyes."),
        Some(eyes) => {
            let bins = || Bins::Width(0.05);
            let chart = Chart::new("Matches beside their epipolar lines")
                .x_axis(Axis::linear("distance", "px"))
                .y_axis(Axis::linear("matches", "").include(0.0))
                .series(Series::histogram(
                    "as told",
                    eyes.told_px.iter().copied(),
                    bins(),
                ))
                .series(Series::histogram(
                    "as found",
                    eyes.found_px.iter().copied(),
                    bins(),
                ));
            let caption = format!(
                "{:.3} px root mean square as told, {:.3} px as found; {} of {} matches.",
                eyes.told_rms_px, eyes.found_rms_px, eyes.matches, eyes.of
            );
            page = page.figure(&chart.to_svg(WIDTH, HEIGHT), &caption);
        }
    }
    let Some(imu) = &camera.imu else {
        return page.text(
            "No comparison with a gyroscope: too little turned, too little was seen of it, or there is none.",
        );
    };
    for (axis, label) in ["x", "y", "z"].iter().enumerate() {
        let by_pictures = imu.rates.iter().map(|(t, seen, _)| (*t, seen[axis]));
        let by_gyro = imu.rates.iter().map(|(t, _, nominal)| (*t, nominal[axis]));
        let chart = Chart::new(&format!("Turning about {label}"))
            .x_axis(Axis::time("since the first burst"))
            .y_axis(Axis::linear("rate", "rad/s"))
            .series(Series::scatter("by pictures", by_pictures))
            .series(Series::scatter("by the gyroscope, as told", by_gyro));
        page = page.figure(&chart.to_svg(WIDTH, 220), "");
    }
    page.text(&format!(
        "{} of {} moves used. Pictures are stamped {:.2} ms late of the gyroscope, sigma {:.2} ms. A row is exposed \
         {:.1} \u{b5}s after the one above it.",
        imu.moves,
        imu.of,
        imu.late_s * 1e3,
        imu.late_sigma_s * 1e3,
        imu.line_s * 1e6
    ))
}
