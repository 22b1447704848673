//! OpenCV on the same corners.

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use calib::cameras::Input;
use camera_models::{CameraModel, Distortion};
use serde_json::json;

use crate::python;

/// What it found.
pub(super) struct OpenCvCalibration {
    pub(super) left: CameraModel,
    pub(super) left_from_right: RigidTransform,
    /// Processor time of the calibration alone, s.
    pub(super) seconds: f64,
}

/// Calibrates the first two eyes of an input, starting from their factory values.
pub(super) fn calibrate(input: &Input) -> Result<OpenCvCalibration> {
    let known = input.targets[0].corners();
    let mut views = Vec::new();
    for left in input.detections.iter().filter(|s| s.eye == 0) {
        let same = |s: &&calib::cameras::TargetDetection| s.eye == 1 && s.instant == left.instant;
        let Some(right) = input.detections.iter().find(same) else {
            continue;
        };
        let (mut points, mut l, mut r) = (Vec::new(), Vec::new(), Vec::new());
        for a in &left.corners {
            let Some(b) = right.corners.iter().find(|b| b.id == a.id) else {
                continue;
            };
            let at = known[known
                .binary_search_by_key(&a.id, |c| c.id)
                .expect("a corner of the board")]
            .at_m;
            points.push([at[0], at[1], 0.0]);
            l.push(a.pixel);
            r.push(b.pixel);
        }
        if points.len() >= 8 {
            views.push(json!({ "points": points, "left": l, "right": r }));
        }
    }
    let guess = |eye: usize| {
        let model = input.eyes[eye].factory.context("a factory lens")?;
        let mut d = model.distortion.coefficients();
        d.resize(5, 0.0);
        anyhow::Ok(json!({ "k": model.k_matrix(), "d": d }))
    };
    let job = json!({ "size": input.eyes[0].size, "views": views, "left": guess(0)?, "right": guess(1)? });
    let found = python::ask("calib/opencv.py", &job)?;
    let numbers = |key: &str| -> Result<Vec<f64>> {
        serde_json::from_value(found[key].clone()).with_context(|| format!("reading {key}"))
    };
    let p = numbers("left")?;
    let rows: [f64; 9] = numbers("rotation_rows")?
        .try_into()
        .ok()
        .context("nine numbers")?;
    let at: [f64; 3] = numbers("translation_m")?
        .try_into()
        .ok()
        .context("three numbers")?;
    let (width, height) = input.eyes[0].size;
    Ok(OpenCvCalibration {
        left: CameraModel {
            width,
            height,
            fx: p[0],
            fy: p[1],
            cx: p[2],
            cy: p[3],
            distortion: Distortion::RadTan5 {
                k1: p[4],
                k2: p[5],
                p1: p[6],
                p2: p[7],
                k3: p[8],
            },
        },
        left_from_right: RigidTransform::from_rotation_rows(rows, at)?.inverse(),
        seconds: found["seconds"].as_f64().context("seconds")?,
    })
}
