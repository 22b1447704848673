//! The report: verdict, estimate of each parameter, and charts.

use calib::verify::{CameraEstimate, Finding as CalibrationFinding};
use charts::{Axis, Bins, Cell, Chart, Page, Series, Table, Verdict as Badge};
use session_archive::handoff::Verdict;
use session_archive::manifest::Manifest;
use session_health::Finding;

use super::result::SessionVerification;

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
        None => "the calibration recorded with the session; no rig file was read".to_owned(),
    };
    page = page.text(&format!(
        "Against {against}. {} bursts of images, and all samples of the gyroscopes. A parameter is inconsistent if it deviates \
         by more than {} sigmas of its tolerance plus {} sigmas of the measurement.",
        checked.bursts,
        checked.verification.config.decision.tolerance_sigma,
        checked.verification.config.decision.detection_sigma
    ));
    for finding in findings.iter().filter(|f| f.verdict != Verdict::Pass) {
        page = page.finding(badge(finding.verdict), &finding.text);
    }
    for what in &checked.left_out {
        page = page.text(&format!("Left out: {what}."));
    }
    page = page.section("Parameters");
    let mut table = Table::new([
        "",
        "Deviation from nominal",
        "Sigma",
        "Minimum detectable",
        "Verdict",
    ]);
    for found in &checked.verification.findings {
        let mut verdict = checked.verdict(found, findings);
        if verdict.is_empty() {
            verdict = "undetermined".to_owned();
        }
        table = table.row([
            Cell::from(format!("{}: {}", found.camera, name(found))),
            Cell::number(components(found)),
            Cell::number(shown(found, found.sigma)),
            Cell::number(shown(found, found.min_detectable)),
            Cell::from(verdict),
        ]);
    }
    page = page.table(&table);
    page = page.text(
        "Rotations are about the x, y and z axes of the left optical frame, stereo rotations about those of the right one. Delays are \
         positive for late timestamps.",
    );
    page = page.figure(
        &angles(checked),
        "Estimates about each axis. Deviations beyond the lines are detected 39 times in 40.",
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

fn name(found: &CalibrationFinding) -> &'static str {
    use calib::verify::Parameter;
    match found.parameter {
        Parameter::StereoRotation => "right eye",
        Parameter::Camera => "camera on the plate",
        Parameter::Imu => "IMU in the camera",
        Parameter::ImageTime => "image times",
        Parameter::ImuTime => "IMU sample times",
        Parameter::Clock => "clock",
    }
}

fn shown(found: &CalibrationFinding, value: f64) -> String {
    match found.parameter.is_rotation() {
        true => format!("{:.3}\u{b0}", value.to_degrees()),
        false => format!("{:.2} ms", value * 1e3),
    }
}

fn components(found: &CalibrationFinding) -> String {
    let all: Vec<String> = found.estimate.iter().map(|v| shown(found, *v)).collect();
    all.join(", ")
}

/// Every estimated angle, with its detection threshold.
fn angles(checked: &SessionVerification) -> String {
    let rotations = || {
        let all = checked.verification.findings.iter();
        all.filter(|f| f.parameter.is_rotation() && !f.estimate.is_empty())
    };
    let names: Vec<String> = rotations()
        .map(|f| format!("{} {}", f.camera, name(f)))
        .collect();
    let mut chart = Chart::new("Estimated rotations against nominal")
        .x_axis(Axis::categories("", names))
        .y_axis(Axis::linear("angle", "\u{b0}").include(0.0));
    for (axis, label) in ["x", "y", "z"].iter().enumerate() {
        let values = rotations()
            .enumerate()
            .map(|(i, f)| (i as f64, f.estimate[axis].to_degrees()));
        chart = chart.series(Series::scatter(label, values));
    }
    for (sign, label) in [
        (1.0, "detectable from"),
        (-1.0, "detectable from, negative"),
    ] {
        let off = rotations().enumerate();
        let off = off.map(|(i, f)| (i as f64, sign * f.min_detectable.to_degrees()));
        chart = chart.series(Series::steps(label, off));
    }
    chart.to_svg(WIDTH, HEIGHT)
}

fn one(mut page: Page, camera: &CameraEstimate) -> Page {
    match &camera.eyes {
        None => page = page.text("Too few stereo matches."),
        Some(eyes) => {
            let bins = || Bins::Width(0.05);
            let chart = Chart::new("Epipolar error of the matches")
                .x_axis(Axis::linear("distance", "px"))
                .y_axis(Axis::linear("matches", "").include(0.0))
                .series(Series::histogram(
                    "nominal",
                    eyes.nominal_px.iter().copied(),
                    bins(),
                ))
                .series(Series::histogram(
                    "estimate",
                    eyes.found_px.iter().copied(),
                    bins(),
                ));
            let caption = format!(
                "{:.3} px RMS with the nominal extrinsics, {:.3} px with the estimate; {} of {} matches. \
                 Parallax in {} of {} track segments.",
                eyes.nominal_rms_px,
                eyes.found_rms_px,
                eyes.matches,
                eyes.of,
                eyes.parallax_segments,
                eyes.segments
            );
            page = page.figure(&chart.to_svg(WIDTH, HEIGHT), &caption);
        }
    }
    let Some(imu) = &camera.imu else {
        return page.text(
            "No comparison with a gyroscope: too little rotation, too few tracks, or no gyroscope.",
        );
    };
    for (axis, label) in ["x", "y", "z"].iter().enumerate() {
        let from_images = imu.rates.iter().map(|(t, seen, _)| (*t, seen[axis]));
        let from_gyro = imu.rates.iter().map(|(t, _, nominal)| (*t, nominal[axis]));
        let chart = Chart::new(&format!("Angular rate about {label}"))
            .x_axis(Axis::time("since the first burst"))
            .y_axis(Axis::linear("rate", "rad/s"))
            .series(Series::scatter("from images", from_images))
            .series(Series::scatter(
                "from the gyroscope, nominal extrinsics",
                from_gyro,
            ));
        page = page.figure(&chart.to_svg(WIDTH, 220), "");
    }
    page.text(&format!(
        "{} of {} track segments used. Image timestamps are {:.2} ms late against the gyroscope, sigma {:.2} ms. A row is exposed \
         {:.1} \u{b5}s after the one above it.",
        imu.segments,
        imu.of,
        imu.time_offset_s * 1e3,
        imu.time_offset_sigma_s * 1e3,
        imu.line_s * 1e6
    ))
}
