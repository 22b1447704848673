//! The same walks with other settings, fewer cameras, no IMU.

use anyhow::Result;

use super::options::Options;
use super::results::Results;
use super::run::{Job, Passes};
use super::test_walks::{self, add};

/// Walks on which settings are compared: streets by day, stairs, a square at night, flickering
/// lamps.
pub(crate) const SETTINGS_ON: [&str; 4] = [
    "pavement-day-21-110",
    "stairs-day-21-140",
    "plaza-night-22-110",
    "corridor-flicker-22-110",
];
/// Their first sets: 40 s.
pub(crate) const SETTINGS_SETS: usize = 600;
/// Walks on which cameras are compared: one in each scene.
pub(crate) const CAMERAS_ON: [&str; 6] = [
    "pavement-day-21-110",
    "room-day-21-140",
    "stairs-day-21-140",
    "corridor-day-21-110",
    "plaza-night-22-110",
    "trail-low-sun-22-110",
];
/// Their first sets: 60 s.
pub(crate) const CAMERAS_SETS: usize = 900;

/// The presets.
pub(crate) const PRESETS: [&str; 3] = ["fast", "balanced", "accurate"];
/// One setting of `balanced` at a time: its key, and its values in order; the preset's own is among
/// them.
pub(crate) const SWEEPS: [(&str, &[usize]); 3] = [
    ("frontend.max_features", &[30, 45, 60, 80, 110, 160, 240]),
    ("backend.window_size", &[4, 6, 8, 11, 16]),
    ("backend.max_iterations", &[1, 2, 4, 8]),
];
/// Which cameras are used together.
pub(crate) const CAMERAS: [(&str, &[&str]); 5] = [
    ("feet", &["feet"]),
    ("left shoulder", &["left_shoulder"]),
    ("left shoulder, feet", &["left_shoulder", "feet"]),
    ("both shoulders", &["left_shoulder", "right_shoulder"]),
    ("all three", &[]),
];

/// Rotation errors of one camera's calibration, degrees, and the walks.
pub(crate) const ROTATION_ERRORS_DEG: [f64; 8] = [0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0];
pub(crate) const MOUNTS_ON: [&str; 2] = ["pavement-day-21-110", "corridor-day-21-110"];
/// Their first sets: 40 s.
pub(crate) const MOUNTS_SETS: usize = 600;

/// The name of `balanced` with one setting changed.
pub(crate) fn balanced_with(key: &str, value: usize) -> String {
    format!("balanced {key}={value}")
}

/// Presets and single settings.
///
/// # Errors
/// Of a run.
pub(crate) fn settings(options: &Options, results: &mut Results) -> Result<()> {
    let mut names: Vec<String> = PRESETS.map(str::to_owned).to_vec();
    for (key, values) in SWEEPS {
        names.extend(values.iter().map(|value| balanced_with(key, *value)));
    }
    let walks = test_walks::chosen(options).into_iter();
    for walk in walks.filter(|w| options.quick || SETTINGS_ON.contains(w)) {
        for name in &names {
            let mut job = Job::whole(walk, name, options.quick);
            job.sets = Some(SETTINGS_SETS);
            add(&job, options, Passes::One, results)?;
        }
    }
    Ok(())
}

/// A camera with a calibration error.
///
/// # Errors
/// Of a run.
pub(crate) fn mounts(options: &Options, results: &mut Results) -> Result<()> {
    let walks = test_walks::chosen(options).into_iter();
    for walk in walks.filter(|w| options.quick || MOUNTS_ON.contains(w)) {
        for rotation_error_deg in ROTATION_ERRORS_DEG {
            let mut job = Job::whole(walk, "balanced", options.quick);
            job.sets = Some(MOUNTS_SETS);
            job.rotation_error_deg = rotation_error_deg;
            add(&job, options, Passes::One, results)?;
        }
    }
    Ok(())
}

/// One, two and three cameras, with and without IMU.
///
/// # Errors
/// Of a run.
pub(crate) fn cameras(options: &Options, results: &mut Results) -> Result<()> {
    let walks = test_walks::chosen(options).into_iter();
    for walk in walks.filter(|w| options.quick || CAMERAS_ON.contains(w)) {
        for (_, cameras) in CAMERAS {
            for with_imu in [true, false] {
                let mut job = Job::whole(walk, "balanced", options.quick);
                job.cameras = cameras.iter().map(|c| (*c).to_owned()).collect();
                job.with_imu = with_imu;
                job.sets = Some(CAMERAS_SETS);
                add(&job, options, Passes::One, results)?;
            }
        }
    }
    Ok(())
}
