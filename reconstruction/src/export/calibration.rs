//! `calibration.json`: calibration and transforms of the session, in plain JSON.
//!
//! Conventions: integer pixel coordinates are pixel centres; `K` and `R` are 3x3 and `P` is 3x4,
//! row by row; a transform `parent_from_child` takes coordinates in the child frame to the parent
//! frame; metres; unit quaternions as `w x y z`, Hamilton convention.

use serde_json::{Map, Value, json};
use session_archive::record::{CameraCalibration, FrameTransform, Quaternion, Vector3};

use crate::input::Input;

/// The content of the file. A side without a calibration is `null`.
pub(super) fn json(input: &Input) -> Value {
    let manifest = input.manifest();
    let cameras: Map<String, Value> = manifest
        .cameras
        .iter()
        .map(|camera| {
            let eye = |eye: &str| {
                let calibration = input.calibration(&format!("{}/{eye}", camera.name));
                calibration.map_or(Value::Null, lens)
            };
            let eyes = json!({ "left": eye("left"), "right": eye("right") });
            (camera.name.clone(), eyes)
        })
        .collect();
    let transforms: Vec<Value> = input.transforms().iter().map(transform).collect();
    json!({
        "session_id": manifest.session_id,
        "cameras": cameras,
        "transforms": transforms,
    })
}

fn lens(calibration: &CameraCalibration) -> Value {
    json!({
        "frame": calibration.frame_id,
        "width": calibration.width,
        "height": calibration.height,
        "distortion_model": calibration.distortion_model,
        "D": calibration.d,
        "K": calibration.k,
        "R": calibration.r,
        "P": calibration.p,
    })
}

fn transform(transform: &FrameTransform) -> Value {
    // Absent in protobuf means zero; a quaternion of zeros is not a rotation and is written
    // unchanged.
    let Vector3 { x, y, z } = transform.translation.unwrap_or_default();
    let q: Quaternion = transform.rotation.unwrap_or_default();
    json!({
        "parent": transform.parent_frame_id,
        "child": transform.child_frame_id,
        "translation_m": [x, y, z],
        "rotation_wxyz": [q.w, q.x, q.y, q.z],
    })
}
