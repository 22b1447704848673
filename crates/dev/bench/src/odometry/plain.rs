//! KITTI's drive by plain visual odometry, built from OpenCV's functions.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use cad_transforms::RigidTransform;
use harness::sequences::Sequence;
use scene_bundle::{Pose, Trajectory};
use serde::Deserialize;
use serde_json::json;

use crate::python;

/// Result.
pub(crate) struct Plain {
    /// Poses of the rig, at the times of the pairs.
    pub(crate) trajectory: Trajectory,
    /// Time of a stereo pair, ms.
    pub(crate) wall_ms: f64,
    /// Version.
    pub(crate) opencv: String,
}

#[derive(Deserialize)]
struct Answer {
    /// The first left camera from each, rows of 3x4.
    poses: Vec<[f64; 12]>,
    ms: f64,
    opencv: String,
}

/// Drives the sequence that was read from a folder.
///
/// # Errors
/// No interpreter with OpenCV, or none of its motions fits.
pub(crate) fn drive(folder: &Path, sequence: &Sequence, truth: &Trajectory) -> Result<Plain> {
    let [camera] = &sequence.rig().cameras[..] else {
        anyhow::bail!("plain odometry has one camera");
    };
    let k = camera.left.k_matrix();
    let question = json!({
        "folder": folder,
        "focal_px": k[0],
        "center_px": [k[2], k[5]],
        "baseline_m": camera.right_from_left.translation().norm(),
        "threads": 2,
    });
    let answer = python::ask("odometry/plain.py", &question)?;
    let answer: Answer = serde_json::from_value(answer).context("reading what OpenCV found")?;
    let (found, expected) = (answer.poses.len(), truth.len());
    ensure!(
        found == expected,
        "plain odometry: found {found} poses, expected {expected}"
    );
    let times = truth.poses().iter().map(|pose| pose.time_ns);
    let poses = times.zip(answer.poses).map(|(time_ns, rows)| {
        let first_from_left = RigidTransform::from_rows_3x4(rows)?;
        let pose = camera.rig_from_left * first_from_left * camera.rig_from_left.inverse();
        Ok(Pose::new(time_ns, pose))
    });
    Ok(Plain {
        trajectory: Trajectory::new(poses.collect::<Result<_>>()?)?,
        wall_ms: answer.ms,
        opencv: answer.opencv,
    })
}
