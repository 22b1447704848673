//! Estimates of odometry at rest: biases and the vertical.

use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use nalgebra::Vector3;
use odometry::Config;
use serde::Serialize;

use crate::sequences;

/// Errors after a second at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Still {
    /// Number of frame sets.
    pub sets: usize,
    /// Time from the first to the last set, s.
    pub seconds: f64,
    /// Norm of the error of the gyroscope bias, rad/s.
    pub gyro_bias_off: f64,
    /// Norm of the error of the accelerometer bias, m/s². At rest it cannot be separated from a
    /// tilt.
    pub accel_bias_off: f64,
    /// Angle between the estimated vertical and that of the true orientation, degrees.
    pub up_off_orientation_deg: f64,
    /// Angle between the estimated vertical and the mean specific force minus the true
    /// accelerometer bias, degrees.
    pub up_off_force_deg: f64,
    /// Angle between the two true verticals, degrees.
    pub truth_off_itself_deg: f64,
    /// Maximum distance of a pose from the first one, m.
    pub moved_m: f64,
    /// Maximum distance of a true pose from the first one, m.
    pub truth_moved_m: f64,
}

/// Runs odometry on the images at rest in the beginning of a recording in EuRoC's format.
///
/// # Errors
/// Files that are absent or not in the expected format.
pub fn still(folder: &Path, truth: &Path, settings: Config) -> Result<Still> {
    let sequence = sequences::euroc(folder, truth, None)?;
    let times: Vec<i64> = sequence.times().collect();
    let (first, last) = (times.first(), times.last());
    let (first, last) = first.zip(last).context("there is no image")?;
    let mut tracking = super::Tracking::new(sequence.rig(), settings, false);
    let mut estimates = Vec::new();
    sequence.for_each(|set| {
        estimates.push(tracking.add(&set)?);
        Ok(())
    })?;
    let end = estimates.last().context("there is no pose")?;
    let [gyro_bias, accel_bias] = biases(truth, *last)?;
    let during = sequence.imu()[0].iter();
    let forces: Vec<Vector3<f64>> = during
        .filter(|s| (*first..=*last).contains(&s.time_ns))
        .map(|s| Vector3::from(s.accel))
        .collect();
    ensure!(!forces.is_empty(), "the IMU measured nothing meanwhile");
    let force = forces.iter().sum::<Vector3<f64>>() / forces.len() as f64 - accel_bias;
    let true_pose = sequence
        .world_from_rig(*last)
        .context("there is no ground truth")?;
    let up = |pose: &cad_transforms::RigidTransform| pose.rotation().inverse() * Vector3::z();
    let (own, oriented) = (up(&end.world_from_rig), up(&true_pose));
    let apart = |a: &Vector3<f64>, b: &Vector3<f64>| a.angle(b).to_degrees();
    let start = estimates[0].world_from_rig;
    let moved = estimates
        .iter()
        .map(|e| (start.inverse() * e.world_from_rig).distance_m());
    let true_start = sequence
        .world_from_rig(*first)
        .context("there is no ground truth")?;
    let truth_moved = (sequence.truth_at_sets().into_iter())
        .map(|(_, pose)| (true_start.inverse() * pose).distance_m());
    Ok(Still {
        sets: times.len(),
        seconds: (last - first) as f64 * 1e-9,
        gyro_bias_off: (end.gyro_bias - gyro_bias).norm(),
        accel_bias_off: (end.accel_bias - accel_bias).norm(),
        up_off_orientation_deg: apart(&own, &oriented),
        up_off_force_deg: apart(&own, &force),
        truth_off_itself_deg: apart(&oriented, &force),
        moved_m: moved.fold(0.0, f64::max),
        truth_moved_m: truth_moved.fold(0.0, f64::max),
    })
}

/// True biases of gyroscope and accelerometer at the row nearest to a time.
fn biases(truth: &Path, time_ns: i64) -> Result<[Vector3<f64>; 2]> {
    let text = std::fs::read_to_string(truth);
    let text = text.with_context(|| format!("reading {}", truth.display()))?;
    let rows = text.lines().filter(|l| !l.starts_with('#'));
    let time = |row: &&str| row.split(',').next().and_then(|t| t.parse::<i64>().ok());
    let nearest = rows.min_by_key(|row| time(row).map_or(u64::MAX, |t| t.abs_diff(time_ns)));
    let row = nearest.context("there is no ground truth")?;
    let values: Vec<f64> = (row.split(',').skip(11).take(6))
        .filter_map(|v| v.trim().parse().ok())
        .collect();
    let found = values.len();
    ensure!(
        found == 6,
        "reading the true biases: found {found} numbers behind the velocity, expected 6, in {}",
        truth.display()
    );
    Ok([
        Vector3::from_column_slice(&values[..3]),
        Vector3::from_column_slice(&values[3..]),
    ])
}
