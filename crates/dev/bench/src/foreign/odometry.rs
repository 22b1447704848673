//! Odometry on the rendered walk.

use anyhow::Result;
use cad_transforms::RigidTransform;
use harness::sequences::Sequence;
use harness::tracking;
use odometry::rig::Rig;
use odometry::{Config, Preset};
use serde_json::{Value, json};

use crate::trajectory_errors;

/// Rotation of the right eye of the nominal calibration about y, degrees: 0.1 degrees are a
/// disparity of 0.44 px at infinity.
const ROTATIONS_DEG: [f64; 2] = [0.1, 0.3];

/// One row for each preset with the IMU, and with `balanced` without it and with a wrong nominal
/// calibration.
pub(super) fn rows(sequence: &Sequence) -> Result<Value> {
    let mut rows = Vec::new();
    for preset in [Preset::Fast, Preset::Balanced, Preset::Accurate] {
        rows.push(row(sequence, preset, "with IMU", 0.0)?);
    }
    rows.push(row(sequence, Preset::Balanced, "without IMU", 0.0)?);
    for deg in ROTATIONS_DEG {
        rows.push(row(sequence, Preset::Balanced, "with IMU", deg)?);
    }
    Ok(Value::Array(rows))
}

fn row(sequence: &Sequence, preset: Preset, imu: &str, rotation_deg: f64) -> Result<Value> {
    let nominal = |rig: &mut Rig| {
        if imu == "without IMU" {
            rig.imus.clear();
        }
        let vector = [0.0, rotation_deg.to_radians(), 0.0];
        let rotated = RigidTransform::from_rotation_vector(vector, [0.0; 3])
            .expect("a small rotation is finite");
        for camera in &mut rig.cameras {
            camera.right_from_left = rotated * camera.right_from_left;
        }
    };
    let sequence = sequence.clone().with_nominal_rig(nominal);
    let tracking = tracking::track(&sequence, Config::preset(preset), true)?;
    let truth = tracking::truth(&sequence)?;
    let causal = trajectory_errors::errors(tracking.causal(), &truth);
    let adjusted = tracking.refine()?;
    let adjusted = adjusted.map(|a| trajectory_errors::errors(&a.trajectory, &truth));
    Ok(json!({
        "preset": format!("{preset:?}").to_lowercase(),
        "imu": imu,
        "right_eye_deg": rotation_deg,
        "causal": causal,
        "adjusted": adjusted,
    }))
}
