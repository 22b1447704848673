//! Charts of `odometry`.

use charts::{Axis, Chart, Series};

use super::figures::Figures;
use super::results::{Results, Row};
use super::sweeps::{
    CAMERAS, CAMERAS_SETS, MOUNTS_ON, MOUNTS_SETS, PRESETS, SETTINGS_ON, SETTINGS_SETS, SWEEPS,
    balanced_with,
};
use super::table::{
    MAX_ADJUSTED_ATE_PERCENT, MAX_CAUSAL_ATE_PERCENT, MAX_PAIR_MS, rows_of_test_walks,
};

const WIDTH: u32 = 760;
const HEIGHT: u32 = 400;

/// ATE at which lost walks are drawn, percent.
const LOST_PERCENT: f64 = 100.0;

/// Causal poses, or refined ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Poses {
    Causal,
    Adjusted,
}

impl Poses {
    const ALL: [Self; 2] = [Self::Causal, Self::Adjusted];

    fn name(self) -> &'static str {
        match self {
            Self::Causal => "causal",
            Self::Adjusted => "adjusted",
        }
    }

    fn target(self) -> f64 {
        match self {
            Self::Causal => MAX_CAUSAL_ATE_PERCENT,
            Self::Adjusted => MAX_ADJUSTED_ATE_PERCENT,
        }
    }

    fn figures(self, row: &Row) -> Option<&Figures> {
        match self {
            Self::Causal => Some(&row.ran.figures),
            Self::Adjusted => Some(&row.adjusted.as_ref()?.figures),
        }
    }

    /// Processor time of a stereo pair, ms, which depends less on the load.
    fn cpu_ms(self, row: &Row) -> f64 {
        let adjusting = row.adjusted.as_ref().map_or(0.0, |a| a.cpu_s);
        match self {
            Self::Causal => row.ran.cpu_ms,
            Self::Adjusted => row.ran.cpu_ms + 1e3 * adjusting / row.ran.pairs as f64,
        }
    }
}

/// Names and texts of all charts that there are results for.
pub(crate) fn draw(results: &Results, stamp: &str) -> Vec<(String, String)> {
    let mut files = Vec::new();
    let mut add = |name: String, chart: Option<Chart>| {
        if let Some(chart) = chart {
            let svg = chart.footnote(stamp).to_svg(WIDTH, HEIGHT);
            files.push((format!("odometry-{name}.svg"), svg));
        }
    };
    for poses in Poses::ALL {
        add(format!("walks-{}", poses.name()), walks(results, poses));
        add(
            format!("settings-{}", poses.name()),
            settings(results, poses),
        );
        add(format!("cameras-{}", poses.name()), cameras(results, poses));
    }
    add("time".to_owned(), time(results));
    add("mounts".to_owned(), mounts(results));
    add("sigmas".to_owned(), sigmas(results));
    files
}

/// Error of each walk.
fn walks(results: &Results, poses: Poses) -> Option<Chart> {
    let rows = rows_of_test_walks(results, "balanced");
    let names: Vec<&str> = rows.iter().map(|r| r.job.walk.as_str()).collect();
    let lost = rows
        .iter()
        .filter_map(|r| poses.figures(r))
        .filter(|f| f.is_lost());
    let mut chart = Chart::new(&format!("ATE per path length, {} poses", poses.name()))
        .subtitle(&format!(
            "{} simulated walks of {:.0} to {:.0} m, three stereo cameras, best fit without scale; {} lost",
            rows.len(),
            rows.iter().map(|r| r.ran.path_m).fold(f64::INFINITY, f64::min),
            rows.iter().map(|r| r.ran.path_m).fold(0.0, f64::max),
            lost.count()
        ))
        .x_axis(Axis::categories("", names.clone()))
        .y_axis(Axis::linear("ATE", "% of path length").include(0.0))
        .hline(poses.target(), "target");
    for preset in PRESETS {
        let rows = rows_of_test_walks(results, preset);
        if rows.is_empty() {
            continue;
        }
        let value = |name: &&str| {
            let row = rows.iter().find(|r| r.job.walk == *name);
            let figures = row.and_then(|r| poses.figures(r));
            figures.and_then(|f| f.ate_percent).unwrap_or(f64::NAN)
        };
        chart = chart.series(Series::bars(preset, names.iter().map(value)));
    }
    (!names.is_empty()).then_some(chart)
}

/// Time of a stereo pair on each walk.
fn time(results: &Results) -> Option<Chart> {
    let rows = rows_of_test_walks(results, "balanced");
    let names: Vec<&str> = rows.iter().map(|r| r.job.walk.as_str()).collect();
    let of = |of: &dyn Fn(&Row) -> f64| rows.iter().map(|r| of(r)).collect::<Vec<_>>();
    let chart = Chart::new("Time of a stereo pair, balanced, causal poses")
        .subtitle("two threads; wall time counts what else the machine did")
        .x_axis(Axis::categories("", names.clone()))
        .y_axis(Axis::linear("mean time of a stereo pair", "ms").include(0.0))
        .series(Series::bars("wall time", of(&|r| r.ran.wall_ms)))
        .series(Series::bars(
            "processor time of all threads",
            of(&|r| r.ran.cpu_ms),
        ))
        .hline(MAX_PAIR_MS, "target for wall time");
    (!names.is_empty()).then_some(chart)
}

/// Errors in stated sigmas.
fn sigmas(results: &Results) -> Option<Chart> {
    let rows = rows_of_test_walks(results, "balanced");
    let names: Vec<&str> = rows.iter().map(|r| r.job.walk.as_str()).collect();
    let of = |poses: Poses, k: usize| {
        let value = |row: &&Row| {
            let sigmas = poses.figures(row).and_then(|f| f.sigmas);
            sigmas.map_or(f64::NAN, |s| s[k])
        };
        rows.iter().map(value).collect::<Vec<_>>()
    };
    let chart = Chart::new("Errors in stated sigmas, balanced")
        .subtitle("root of the mean square over the poses of a walk; above 1 the stated covariance is too small")
        .x_axis(Axis::categories("", names.clone()))
        .y_axis(Axis::log("error over sigma", ""))
        .series(Series::bars("position, causal", of(Poses::Causal, 0)))
        .series(Series::bars("rotation, causal", of(Poses::Causal, 1)))
        .series(Series::bars("position, refined", of(Poses::Adjusted, 0)))
        .series(Series::bars("rotation, refined", of(Poses::Adjusted, 1)))
        .hline(1.0, "right");
    (!names.is_empty()).then_some(chart)
}

/// Mean error and time of some rows; `None` if one is lost or there is none.
fn mean(rows: &[&Row], poses: Poses) -> Option<(f64, f64)> {
    let count = rows.len() as f64;
    let errors = rows.iter().map(|row| {
        let figures = poses.figures(row)?;
        figures.ate_percent.filter(|_| !figures.is_lost())
    });
    let error = errors.sum::<Option<f64>>()?;
    let ms: f64 = rows.iter().map(|r| poses.cpu_ms(r)).sum();
    (!rows.is_empty()).then_some((ms / count, error / count))
}

/// Mean error against mean time, over settings.
fn settings(results: &Results, poses: Poses) -> Option<Chart> {
    let rows_of = |name: &str| -> Vec<&Row> {
        let is_it = |r: &&Row| {
            r.job.sets == Some(SETTINGS_SETS)
                && (r.job.is_trial || SETTINGS_ON.contains(&r.job.walk.as_str()))
                && r.job.settings == name
                && r.job.rotation_error_deg == 0.0
                && r.job.cameras.is_empty()
                && r.job.with_imu
        };
        results.rows.iter().filter(is_it).collect()
    };
    let walks = rows_of("balanced").len();
    let of = |name: &str| {
        let rows = rows_of(name);
        mean(&rows, poses).filter(|_| rows.len() == walks)
    };
    let mut lost = Vec::new();
    let mut point = |name: &str| match of(name) {
        Some(point) => point,
        None => {
            lost.push(name.to_owned());
            (f64::NAN, f64::NAN)
        }
    };
    let presets = PRESETS.map(&mut point);
    let mut series = vec![Series::scatter("presets", presets).labels(PRESETS).slot(3)];
    for (k, (key, values)) in SWEEPS.into_iter().enumerate() {
        let points: Vec<_> = (values.iter())
            .map(|value| point(&balanced_with(key, *value)))
            .collect();
        let labels = values.iter().map(usize::to_string);
        let name = key.rsplit('.').next().unwrap_or(key);
        series.push(Series::line(name, points).labels(labels).slot(k));
    }
    let missing = match lost.is_empty() {
        true => String::new(),
        false => format!("; lost or not run: {}", lost.join(", ")),
    };
    let chart = Chart::new(&format!(
        "Error against time over settings, {} poses",
        poses.name()
    ))
    .subtitle(&format!(
        "means over the first 40 s of {walks} walks ({}); one setting of balanced changed at a time{missing}",
        SETTINGS_ON.join(", ")
    ))
    .x_axis(Axis::log("processor time of a stereo pair", "ms"))
    .y_axis(Axis::linear("ATE", "% of path length").include(0.0));
    let chart = series.into_iter().fold(chart, Chart::series);
    (walks > 0).then_some(chart)
}

/// Error against the calibration error of a camera.
fn mounts(results: &Results) -> Option<Chart> {
    let rows: Vec<&Row> = (results.rows.iter())
        .filter(|r| r.job.sets == Some(MOUNTS_SETS) && r.job.settings == "balanced")
        .filter(|r| r.job.is_trial || MOUNTS_ON.contains(&r.job.walk.as_str()))
        .collect();
    let mut walks: Vec<&str> = rows.iter().map(|r| r.job.walk.as_str()).collect();
    walks.dedup();
    let detections = rows
        .iter()
        .filter(|r| r.adjusted.as_ref().is_some_and(|a| !a.moved.is_empty()));
    let least = detections
        .map(|r| r.job.rotation_error_deg)
        .fold(f64::INFINITY, f64::min);
    let mut chart = Chart::new("Error against the calibration error of a camera's rotation")
        .subtitle(&format!(
            "the first 40 s, balanced, camera feet; reported as rotated from {least} degrees on"
        ))
        .x_axis(Axis::linear("calibration error", "degrees"))
        .y_axis(Axis::log("ATE", "% of path length"));
    for (k, walk) in walks.iter().enumerate() {
        for poses in Poses::ALL {
            let points = rows.iter().filter(|r| r.job.walk == *walk).map(|row| {
                let error = poses.figures(row).and_then(|f| f.ate_percent);
                (row.job.rotation_error_deg, error.unwrap_or(f64::NAN))
            });
            let label = format!("{walk}, {}", poses.name());
            let slot = 2 * k + usize::from(poses == Poses::Adjusted);
            chart = chart.series(Series::line(&label, points).slot(slot));
        }
    }
    (!rows.is_empty()).then_some(chart)
}

/// Error by cameras, with and without IMU: each walk a point, lost ones too.
fn cameras(results: &Results, poses: Poses) -> Option<Chart> {
    let names = CAMERAS.map(|(name, _)| name);
    let mut walks: Vec<&str> = Vec::new();
    let mut all = Vec::new();
    for with_imu in [true, false] {
        let mut points = Vec::new();
        for (place, (_, cameras)) in CAMERAS.iter().enumerate() {
            let is_it = |r: &&Row| {
                r.job.sets == Some(CAMERAS_SETS)
                    && r.job.cameras == *cameras
                    && r.job.with_imu == with_imu
            };
            for row in results.rows.iter().filter(is_it) {
                if !walks.contains(&row.job.walk.as_str()) {
                    walks.push(&row.job.walk);
                }
                let walk = walks.iter().position(|w| *w == row.job.walk).unwrap_or(0);
                let figures = poses.figures(row).filter(|f| !f.is_lost());
                let error = figures.and_then(|f| f.ate_percent).unwrap_or(LOST_PERCENT);
                // Those with an IMU to the left of the others, walks side by side.
                let side = if with_imu { -0.3 } else { 0.1 };
                points.push((place as f64 + side + 0.04 * walk as f64, error));
            }
        }
        all.push(points);
    }
    let count = all.iter().flatten();
    let lost = count.filter(|(_, error)| *error == LOST_PERCENT).count();
    let chart = Chart::new(&format!(
        "Error over cameras and IMU, {} poses",
        poses.name()
    ))
    .subtitle(&format!(
        "each point the first 60 s of one of {} walks, from left to right {}; {lost} lost",
        walks.len(),
        walks.join(", ")
    ))
    .x_axis(Axis::categories("", names))
    .y_axis(Axis::log("ATE", "% of path length"))
    .series(Series::scatter("with IMU", all.swap_remove(0)))
    .series(Series::scatter("without IMU", all.swap_remove(0)))
    .hline(LOST_PERCENT, "lost");
    (!walks.is_empty()).then_some(chart)
}
