//! Detections of shoe tags against the truth: recall, errors and their stated sigmas, time.

use anyhow::{Context as _, Result};
use cad_transforms::RigidTransform;
use nalgebra::{Vector3, Vector6};
use serde::{Deserialize, Serialize};

use super::recording::{FrameTruth, Recording, Sighting};
use super::statistics::{percentile, rms};

/// Error of a detection from which on it is wrong, m.
const WRONG_M: f64 = 0.05;
/// Time since the last detection of a foot for which its tag is predicted, s.
const PREDICTED_S: f64 = 0.15;

/// Detections of one walk.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Row {
    frames: usize,
    /// Tags that are whole and visible in both eyes, and those of them that were found.
    pub(super) visible: usize,
    pub(super) found: usize,
    /// The same where the foot was found within 0.15 s before.
    pub(super) predicted: usize,
    pub(super) found_predicted: usize,
    /// The same while the foot is flat.
    pub(super) visible_flat: usize,
    pub(super) found_flat: usize,
    /// Detections of tags of which nothing is visible in either eye.
    pub(super) invented: usize,
    /// Detections that are more than 5 cm wrong.
    pub(super) wrong: usize,
    /// Root mean square errors while flat: of the tag in its plane and along its normal, mm, its
    /// tilt, degrees.
    plane_mm: f64,
    normal_mm: f64,
    tilt_deg: f64,
    /// Of the middle of the sole, by single frames, in the camera: 50th and 95th percentile, RMS.
    sole_mm: [f64; 3],
    /// Mean squared error in stated sigmas, per dimension.
    nees: f64,
    /// Median exposure, ms.
    exposure_ms: f64,
    /// Median time per stereo frame: all frames, ms, and mean.
    pub(super) median_ms: f64,
    pub(super) mean_ms: f64,
}

/// Detections of a recording.
pub(super) fn row(recording: &Recording) -> Result<Row> {
    let times: Vec<f64> = recording.frames.iter().map(|frame| frame.ms).collect();
    let exposures = recording.frames.iter().map(|frame| frame.exposure_ms);
    let mut row = Row {
        exposure_ms: percentile(exposures.collect(), 0.5),
        frames: recording.frames.len(),
        mean_ms: times.iter().sum::<f64>() / times.len().max(1) as f64,
        median_ms: percentile(times, 0.5),
        ..Row::default()
    };
    let (mut squares, mut nees, mut soles) = (Vector6::zeros(), 0.0, Vec::new());
    let mut last_seen_ns = [i64::MIN / 2; 2];
    let mut sightings = recording.sightings.iter().peekable();
    for (index, frame) in recording.frames.iter().enumerate() {
        let mut seen: [Option<&Sighting>; 2] = [None; 2];
        while let Some(own) = sightings.next_if(|own| own.frame == index) {
            seen[own.foot] = Some(own);
        }
        for foot in 0..2 {
            let is_flat = frame.feet[foot].is_flat;
            let is_found = seen[foot].is_some();
            let age_s = 1e-9 * (frame.time_ns - last_seen_ns[foot]) as f64;
            if frame.visible[foot] == [1.0; 2] {
                row.visible += 1;
                row.found += usize::from(is_found);
                row.predicted += usize::from(age_s < PREDICTED_S);
                row.found_predicted += usize::from(is_found && age_s < PREDICTED_S);
                row.visible_flat += usize::from(is_flat);
                row.found_flat += usize::from(is_found && is_flat);
            }
            let Some(own) = seen[foot] else { continue };
            last_seen_ns[foot] = frame.time_ns;
            row.invented += usize::from(frame.visible[foot] == [0.0; 2]);
            let error = error(frame, own);
            row.wrong += usize::from(error.fixed_rows::<3>(0).norm() > WRONG_M);
            if is_flat {
                squares += error.component_mul(&error);
                let inverse = own.covariance.matrix().try_inverse();
                let inverse = inverse.context("inverting a covariance")?;
                nees += error.dot(&(inverse * error)) / 6.0;
                soles.push(1e3 * sole_error(&recording.foot_from_tag[foot], &error));
            }
        }
    }
    let count = soles.len().max(1) as f64;
    let [x, y, z, a, b, _]: [f64; 6] = (squares / count).map(f64::sqrt).into();
    row.plane_mm = 1e3 * x.hypot(y);
    row.normal_mm = 1e3 * z;
    row.tilt_deg = a.hypot(b).to_degrees();
    row.nees = nees / count;
    row.sole_mm = [
        percentile(soles.clone(), 0.5),
        percentile(soles.clone(), 0.95),
        rms(&soles),
    ];
    Ok(row)
}

/// Error of a sighting as a small motion of the tag in its own axes: translation, rotation.
fn error(frame: &FrameTruth, seen: &Sighting) -> Vector6<f64> {
    let error = frame.rig_from_tag[seen.foot].inverse() * seen.rig_from_tag;
    let ([x, y, z], [a, b, c]) = (error.translation_m(), error.rotation_vector());
    Vector6::new(x, y, z, a, b, c)
}

/// Distance of the middle of the sole from the true one, m.
fn sole_error(foot_from_tag: &RigidTransform, error: &Vector6<f64>) -> f64 {
    let sole = Vector3::from(foot_from_tag.inverse().translation_m());
    let turn = error.fixed_rows::<3>(3).into_owned();
    (error.fixed_rows::<3>(0) + turn.cross(&sole)).norm()
}
