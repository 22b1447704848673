//! The JSON document.

use anyhow::Result;
use calib::camera_imu::CameraImu;
use serde_json::{Value as Json, json};
use session_archive::manifest::Manifest;

use super::result::CameraResult;
use crate::software::SOFTWARE;
use crate::target_detections::detection_config;

/// Version of the document; incremented when a key changes its meaning.
const VERSION: u32 = 1;

pub(super) fn json(manifest: &Manifest, all: &[CameraResult]) -> Result<Vec<u8>> {
    let document = json!({
        "format": "paws-camera-imu",
        "format_version": VERSION,
        "software": SOFTWARE,
        "session_id": manifest.session_id,
        "started_civil": manifest.started_civil.to_string(),
        "units": "SI; quaternions w x y z; covariance of rotation (in the left optical frame), translation, time offset; \
                  t_imu = t_camera + time_offset_s in the middle of the recording",
        "detection_config": detection_config(),
        "cameras": all.iter().map(one).collect::<Vec<Json>>(),
    });
    let mut bytes = serde_json::to_vec_pretty(&document)?;
    bytes.push(b'\n');
    Ok(bytes)
}

fn one(camera: &CameraResult) -> Json {
    let mut value = match &camera.found {
        Ok(found) => result(found),
        Err(error) => json!({ "error": format!("{error:#}") }),
    };
    value["camera"] = json!(camera.camera);
    value["board"] = json!(camera.board);
    value["line_s"] = json!(camera.line_s);
    value["nominal_imu_from_left"] = json!(camera.nominal);
    value["nominal_noise"] = json!(camera.noise);
    value
}

fn result(found: &CameraImu) -> Json {
    let s = &found.sigmas;
    let rows = found.covariance.row_iter();
    let covariance: Vec<Vec<f64>> = rows.map(|r| r.iter().copied().collect()).collect();
    let noise = |n: &calib::camera_imu::Noise| json!({ "ratio_to_nominal": n.ratio_to_nominal, "redundancy": n.redundancy });
    let n = &found.noises;
    json!({
        "config": found.config,
        "verdict": found.verdict().to_string(),
        "imu_from_left": found.imu_from_left,
        "time_offset_s": found.time_offset_s,
        "time_drift": found.time_drift,
        "gravity_in_target": found.gravity_in_target,
        "gyro_bias": found.gyro_bias,
        "accel_bias": found.accel_bias,
        "board_scale": found.board_scale,
        "gyro_shape": found.gyro_shape,
        "accel_shape": found.accel_shape,
        "sigma": {
            "rotation_rad": s.rotation_rad,
            "translation_m": s.translation_m,
            "time_offset_s": s.time_offset_s,
            "time_drift": s.time_drift,
            "gravity_rad": s.gravity_rad,
            "gyro_bias": s.gyro_bias,
            "accel_bias": s.accel_bias,
            "board_scale": s.board_scale,
        },
        "covariance": covariance,
        "noise": {
            "corners": noise(&n.corners),
            "poses": noise(&n.poses),
            "gyro": noise(&n.gyro),
            "accel": noise(&n.accel),
            "gyro_walk": noise(&n.gyro_walk),
            "accel_walk": noise(&n.accel_walk),
        },
        "unobservable": found.unobservable.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "gates": found.gates.iter().map(|g| json!({
            "name": g.name,
            "verdict": g.verdict.to_string(),
            "text": g.text,
        })).collect::<Vec<Json>>(),
        "images": { "given": found.views[0], "posed": found.views[1], "left_out": found.views[2] },
    })
}
