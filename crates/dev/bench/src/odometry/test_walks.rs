//! The ten test walks, and a run of a job with progress output.

use anyhow::{Result, ensure};
use harness::sequences::named::ODOMETRY_EXAM;

use super::options::Options;
use super::results::{Results, Row, load};
use super::run::{Job, Passes, run};

/// Walks of a quick run: 20 s, rendered at lower quality.
const QUICK: [&str; 2] = ["pavement-day-21-20", "corridor-flicker-22-20"];
/// Path length of a test walk, m.
const PATH_M: std::ops::RangeInclusive<f64> = 100.0..=300.0;

/// The walks of this run.
pub(crate) fn chosen(options: &Options) -> Vec<&'static str> {
    let all: &[&str] = if options.quick {
        &QUICK
    } else {
        &ODOMETRY_EXAM
    };
    let all = all.iter().copied();
    all.filter(|name| options.takes(name)).collect()
}

/// All walks with some presets, causal and refined.
///
/// # Errors
/// Of a run, or a walk of unexpected length.
pub(crate) fn walks(options: &Options, presets: &[&str], results: &mut Results) -> Result<()> {
    for walk in chosen(options) {
        for preset in presets {
            let job = Job::whole(walk, preset, options.quick);
            let path_m = add(&job, options, Passes::Two, results)?;
            ensure!(
                options.quick || PATH_M.contains(&path_m),
                "walking {walk}: found {path_m:.1} m, expected {PATH_M:?}"
            );
        }
    }
    Ok(())
}

/// Runs a job and stores its row; returns the path length, m.
///
/// # Errors
/// Of the run, or an I/O error.
pub(crate) fn add(
    job: &Job,
    options: &Options,
    passes: Passes,
    results: &mut Results,
) -> Result<f64> {
    let load = load();
    let (ran, adjusted) = run(job, &options.walks, passes)?;
    let field = |key: &str| results.stamp[key].as_str().unwrap_or_default().to_owned();
    let row = Row {
        job: job.clone(),
        ran,
        adjusted,
        commit: field("commit"),
        date: field("date"),
        load,
    };
    println!("{}", row.line());
    let path_m = row.ran.path_m;
    results.add(row);
    results.write(&options.out)?;
    Ok(path_m)
}

impl Row {
    /// Progress line.
    fn line(&self) -> String {
        let (job, ran) = (&self.job, &self.ran);
        let error =
            |percent: Option<f64>| percent.map_or("lost".to_owned(), |p| format!("{p:.3} %"));
        let adjusted = self.adjusted.as_ref().map_or_else(String::new, |a| {
            format!(
                ", adjusted {} in {:.1} s with {} loops",
                error(a.figures.ate_percent),
                a.wall_s,
                a.loops
            )
        });
        format!(
            "{:24} {:9} {} cameras{}: {:.1} m, {} of it{adjusted}, {:.1} ms ({:.1} ms CPU), {:.0} MB, completion {:.4}, {} moved, {} silently wrong, load {:.1}",
            job.walk,
            job.settings,
            ran.stereo_cameras,
            if job.with_imu { "" } else { " without IMU" },
            ran.path_m,
            error(ran.figures.ate_percent),
            ran.wall_ms,
            ran.cpu_ms,
            ran.peak_bytes as f64 * 1e-6,
            ran.figures.completion,
            ran.shifts,
            ran.figures.silently_wrong,
            self.load
        )
    }
}
