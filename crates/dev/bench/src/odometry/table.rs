//! Results as Markdown tables: causal and refined poses separately.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use harness::sequences::named::ODOMETRY_EXAM;

use super::figures::Figures;
use super::real::{Drive, INTERPOLATED, StandStill};
use super::results::{Results, Row};
use super::run::Job;
use super::sweeps::{CAMERAS, CAMERAS_SETS, PRESETS};

/// Requirements: causal and refined ATE, percent of path length, and time of a stereo pair, ms.
pub(crate) const MAX_CAUSAL_ATE_PERCENT: f64 = 0.3;
pub(crate) const MAX_ADJUSTED_ATE_PERCENT: f64 = 0.1;
pub(crate) const MAX_PAIR_MS: f64 = 20.0;

/// Markdown.
pub(crate) fn text(results: &Results) -> String {
    let mut text = format!(
        "# Odometry, measured\n\nWritten by `cargo xtask bench odometry`; the method is described in [decisions/0010](../decisions/0010-odometry.md). \
         Rows: {}. *Errors in sigmas* is their root mean square, *sharpness* the median stated sigma over the root mean square of errors, of position / rotation; 1 is right.\n",
        results.foot()
    );
    let source = |part: &str| results.sources.get(part).map_or("?", String::as_str);
    if let Some(drive) = &results.kitti {
        kitti(&mut text, drive, source("kitti"));
    }
    if let Some(stand) = &results.euroc {
        euroc(&mut text, stand, source("euroc"));
    }
    for preset in PRESETS {
        let rows = rows_of_test_walks(results, preset);
        if rows.is_empty() {
            continue;
        }
        let title = format!("\n## {} walks, `{preset}`: causal poses\n", rows.len());
        walks(&mut text, &title, &rows, MAX_CAUSAL_ATE_PERCENT, &|row| {
            Some(Entry {
                figures: &row.ran.figures,
                ms: row.ran.wall_ms,
                cpu_ms: row.ran.cpu_ms,
                bytes: row.ran.peak_bytes,
                more: format!("{:.0} ms", row.ran.longest_set_ms),
            })
        });
        let title = format!(
            "\n## {} walks, `{preset}`: adjusted afterwards\n",
            rows.len()
        );
        walks(&mut text, &title, &rows, MAX_ADJUSTED_ATE_PERCENT, &|row| {
            let adjusted = row.adjusted.as_ref()?;
            let each = |seconds: f64| 1e3 * seconds / row.ran.pairs as f64;
            Some(Entry {
                figures: &adjusted.figures,
                ms: row.ran.wall_ms + each(adjusted.wall_s),
                cpu_ms: row.ran.cpu_ms + each(adjusted.cpu_s),
                bytes: adjusted.peak_bytes,
                more: format!("{:.1} s, {} loops", adjusted.wall_s, adjusted.loops),
            })
        });
    }
    cameras(&mut text, results);
    text
}

/// Rows of the walks with one, two and three cameras: of each set of cameras the extremes.
fn cameras(text: &mut String, results: &Results) {
    let of_cameras = |r: &&Row| r.job.sets == Some(CAMERAS_SETS) && r.job.settings == "balanced";
    let rows: Vec<&Row> = results.rows.iter().filter(of_cameras).collect();
    if rows.is_empty() {
        return;
    }
    text.push_str(
        "\n## One, two and three cameras, first 60 s of six walks\n\nOf the walks in which at most 1 % of the poses are lost: the largest error, the range of errors in sigmas and of sharpness (position; rotation), the smallest ratio of tracked poses. Silently wrong are poses of all walks.\n\n\
         | cameras | IMU | poses | walks | ATE, % of path length | errors in sigmas | sharpness | tracked, % | silently wrong | commits |\n|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for (name, cameras) in CAMERAS {
        for with_imu in [true, false] {
            let own: Vec<&&Row> = (rows.iter())
                .filter(|r| r.job.with_imu == with_imu && r.job.cameras == cameras)
                .collect();
            let causal = own.iter().map(|r| &r.ran.figures).collect::<Vec<_>>();
            let refined = own
                .iter()
                .filter_map(|r| Some(&r.adjusted.as_ref()?.figures));
            let commits: BTreeSet<&str> = own.iter().map(|r| r.commit.as_str()).collect();
            let commits = commits.into_iter().collect::<Vec<_>>().join(", ");
            for (poses, figures) in [("causal", causal), ("refined", refined.collect())] {
                let _ = writeln!(
                    text,
                    "| {name} | {} | {poses} | {} | {commits} |",
                    if with_imu { "with" } else { "without" },
                    extremes(&figures)
                );
            }
        }
    }
}

/// Columns of several runs.
fn extremes(figures: &[&Figures]) -> String {
    let kept: Vec<&&Figures> = figures.iter().filter(|f| !f.is_lost()).collect();
    let worst = kept.iter().filter_map(|f| f.ate_percent);
    let range = |of: &dyn Fn(&Figures) -> Option<[f64; 2]>| {
        let pairs: Vec<[f64; 2]> = kept.iter().filter_map(|f| of(f)).collect();
        let each = [0, 1].map(|k| {
            let values = || pairs.iter().map(|pair| pair[k]);
            let least = values().reduce(f64::min)?;
            Some(format!("{least:.1}–{:.1}", values().reduce(f64::max)?))
        });
        each.map(Option::unwrap_or_default).join("; ")
    };
    let tracked = kept.iter().map(|f| {
        let all: usize = f.poses.iter().sum();
        100.0 * f.poses[0] as f64 / all.max(1) as f64
    });
    let number = |value: Option<f64>, digits: usize| {
        value.map_or(String::new(), |v| format!("{v:.digits$}"))
    };
    let wrong: usize = figures.iter().map(|f| f.silently_wrong).sum();
    [
        format!("{} of {}", kept.len(), figures.len()),
        number(worst.reduce(f64::max), 3),
        range(&|f| f.sigmas),
        range(&|f| f.sharpness),
        number(tracked.reduce(f64::min), 1),
        wrong.to_string(),
    ]
    .join(" | ")
}

/// Rows of whole walks with a preset, in the order of the test walks.
pub(crate) fn rows_of_test_walks<'a>(results: &'a Results, preset: &str) -> Vec<&'a Row> {
    let is_whole = |r: &&Row| r.job == Job::whole(&r.job.walk, preset, r.job.is_trial);
    let mut rows: Vec<&Row> = results.rows.iter().filter(is_whole).collect();
    rows.sort_by_key(|r| {
        let place = ODOMETRY_EXAM.iter().position(|walk| *walk == r.job.walk);
        place.unwrap_or(usize::MAX)
    });
    rows
}

struct Entry<'a> {
    figures: &'a Figures,
    ms: f64,
    cpu_ms: f64,
    bytes: u64,
    more: String,
}

fn walks<'a>(
    text: &mut String,
    title: &str,
    rows: &[&'a Row],
    target: f64,
    of: &dyn Fn(&'a Row) -> Option<Entry<'a>>,
) {
    text.push_str(title);
    text.push_str(
        "\n| walk | path length, m | ATE, m | % of path length | rotation, ° | drift over 10 m, % | largest error | ms per pair | CPU ms | longest set, or adjustment | peak MB | completion | tracked / dead reckoned / lost | errors in sigmas, position / rotation | sharpness | silently wrong | load | commit |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let entries: Vec<_> = rows.iter().filter_map(|r| Some((*r, of(r)?))).collect();
    for (row, entry) in &entries {
        let f = entry.figures;
        let number = |value: Option<f64>, digits: usize| {
            value.map_or("lost".to_owned(), |v| format!("{v:.digits$}"))
        };
        let pair = |pair: Option<[f64; 2]>| {
            pair.map_or(String::new(), |[a, b]| format!("{a:.1} / {b:.1}"))
        };
        let mark = if f.ate_percent.is_some_and(|p| p <= target) {
            ""
        } else {
            " (missed)"
        };
        let worst = f
            .worst
            .map_or(String::new(), |[m, s]| format!("{m:.2} m at {s:.0} s"));
        let [tracked, carried, lost] = f.poses;
        let _ = writeln!(
            text,
            "| {} | {:.0} | {} | {}{mark} | {} | {} | {worst} | {:.1} | {:.1} | {} | {:.0} | {:.2} % | {tracked} / {carried} / {lost} | {} | {} | {} | {:.1} | {} |",
            row.job.walk,
            row.ran.path_m,
            number(f.ate_m, 3),
            number(f.ate_percent, 3),
            number(f.turn_deg, 2),
            number(f.drift_percent, 2),
            entry.ms,
            entry.cpu_ms,
            entry.more,
            entry.bytes as f64 * 1e-6,
            100.0 * f.completion,
            pair(f.sigmas),
            pair(f.sharpness),
            f.silently_wrong,
            row.load,
            row.commit,
        );
    }
    summary(text, &entries, target);
}

/// The worst run, and means if none is lost.
fn summary(text: &mut String, entries: &[(&Row, Entry<'_>)], target: f64) {
    let error = |e: &Entry<'_>| match e.figures.is_lost() {
        true => f64::INFINITY,
        false => e.figures.ate_percent.unwrap_or(f64::INFINITY),
    };
    let worst = (entries.iter()).max_by(|a, b| error(&a.1).total_cmp(&error(&b.1)));
    let Some((row, entry)) = worst else { return };
    let lost = entries.iter().filter(|(_, e)| e.figures.is_lost()).count();
    let met = entries.iter().filter(|(_, e)| error(e) <= target).count();
    let slow = entries.iter().filter(|(_, e)| e.ms > MAX_PAIR_MS).count();
    let count = entries.len();
    let _ = write!(
        text,
        "\nWorst: **{}**, {}. {met} of {count} within {target} % of path length; {slow} of {count} above {MAX_PAIR_MS} ms per pair; {lost} lost",
        row.job.walk,
        entry
            .figures
            .ate_percent
            .filter(|_| !entry.figures.is_lost())
            .map_or("lost".to_owned(), |p| format!("{p:.3} %")),
    );
    if lost == 0 {
        let mean = |of: &dyn Fn(&Entry<'_>) -> f64| {
            entries.iter().map(|(_, e)| of(e)).sum::<f64>() / count as f64
        };
        let _ = write!(
            text,
            ". Means: {:.3} %, {:.1} ms per pair, {:.1} ms CPU",
            mean(&error),
            mean(&|e| e.ms),
            mean(&|e| e.cpu_ms)
        );
    }
    text.push_str(".\n");
}

fn kitti(text: &mut String, drive: &Drive, source: &str) {
    let _ = write!(
        text,
        "\n## KITTI, {} stereo pairs, no IMU: drift at the end\n\n{source}. Aligned by the first pose / the best fit / pose {INTERPOLATED}. The rotations between the first {INTERPOLATED} true \
         poses differ by {:.1e} rad from their mean, those of the next {INTERPOLATED} by {:.1e}: the first were not measured but interpolated. A best fit to a nearly straight path does not determine the rotation about it, so none is given.\n\n\
         | preset | poses | from the first, % | best fit, % | from pose {INTERPOLATED}, % | rotation from the first / pose {INTERPOLATED}, ° | ms per pair | CPU ms |\n|---|---|---|---|---|---|---|---|\n",
        drive.pairs, drive.first_turns_differ_rad, drive.later_turns_differ_rad
    );
    for run in &drive.runs {
        for (poses, of) in [("causal", &run.causal), ("adjusted", &run.adjusted)] {
            let [first, fit, measured] = of;
            let _ = writeln!(
                text,
                "| {} | {poses} | {:.3} | {:.3} | {:.3} | {:.2} / {:.2} | {:.1} | {:.1} |",
                run.settings,
                first.percent,
                fit.percent,
                measured.percent,
                first.turn_deg,
                measured.turn_deg,
                run.wall_ms,
                run.cpu_ms
            );
        }
    }
    if let Some(plain) = &drive.plain {
        let [first, fit, measured] = &plain.off;
        let _ = writeln!(
            text,
            "| plain: SGBM, KLT and PnP of OpenCV {} | causal | {:.3} | {:.3} | {:.3} | {:.2} / {:.2} | {:.1} | |",
            plain.opencv,
            first.percent,
            fit.percent,
            measured.percent,
            first.turn_deg,
            measured.turn_deg,
            plain.wall_ms
        );
    }
}

fn euroc(text: &mut String, stand: &StandStill, source: &str) {
    let _ = write!(
        text,
        "\n## EuRoC V1_01: {:.2} s of standing still, {} stereo pairs\n\n{source}. Gravity direction against the true orientation / against the specific force minus the true bias; these two differ by {:.2}° \
         themselves. The true poses move by {:.2} mm.\n\n\
         | preset | gyroscope bias error, rad/s | accelerometer bias error, m/s² | gravity direction error, ° | moved, mm |\n|---|---|---|---|---|\n",
        stand.seconds, stand.pairs, stand.truth_off_itself_deg, stand.truth_moved_mm
    );
    for run in &stand.runs {
        let _ = writeln!(
            text,
            "| {} | {:.5} | {:.3} | {:.3} / {:.3} | {:.2} |",
            run.settings,
            run.gyro_bias_off,
            run.accel_bias_off,
            run.up_off_orientation_deg,
            run.up_off_force_deg,
            run.moved_mm
        );
    }
}
