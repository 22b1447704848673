//! The results as JSON and as lines of text.

use anyhow::Result;
use cad_transforms::{Frame, Rig, RigidTransform};
use calib::cameras::{Calibration, Severity};
use nalgebra::Matrix6;
use serde_json::{Value as Json, json};
use session_archive::manifest::Manifest;

use crate::software::SOFTWARE;
use crate::target_detections::detection_config;

/// Version of the document; incremented when a key changes its meaning.
const VERSION: u32 = 1;

/// Text of a severity.
pub(super) fn word(severity: Severity) -> &'static str {
    match severity {
        Severity::Note => "note",
        Severity::Warn => "WARN",
        Severity::Fail => "FAIL",
    }
}

/// Estimated extrinsics: `left_from_right` of a camera, or a camera's left eye in that of the first
/// camera.
pub(super) struct RelativePose {
    /// Name, as in `feet/right in feet/left`.
    pub(super) what: String,
    /// Estimated `parent_from_child`.
    pub(super) parent_from_child: RigidTransform,
    /// Covariance of `[translation, rotation]` in the parent's axes, m and rad.
    pub(super) covariance: Matrix6<f64>,
    /// Deviation from the nominal value, mm and degrees, if there is one.
    pub(super) deviation: Option<(f64, f64)>,
    /// Largest sigma, mm and degrees.
    pub(super) sigma: (f64, f64),
}

impl RelativePose {
    fn new(
        what: String,
        (parent_from_child, covariance): (RigidTransform, Matrix6<f64>),
        nominal: Option<RigidTransform>,
    ) -> Self {
        let deviation = nominal.map(|nominal| {
            let turn = nominal.inverse() * parent_from_child;
            let shift = parent_from_child.translation() - nominal.translation();
            (1e3 * shift.norm(), turn.angle_rad().to_degrees())
        });
        let sigma = |range: std::ops::Range<usize>| {
            range
                .map(|k| covariance[(k, k)].max(0.0).sqrt())
                .fold(0.0, f64::max)
        };
        Self {
            what,
            parent_from_child,
            covariance,
            deviation,
            sigma: (1e3 * sigma(0..3), sigma(3..6).to_degrees()),
        }
    }
}

/// All estimated extrinsics, stereo pairs first. Cameras are relative to the first one: the pose of
/// the rig frame on the plate is not observable.
pub(super) fn relative_poses(found: &Calibration) -> Vec<RelativePose> {
    let cameras = &found.input.cameras;
    let mut all = Vec::new();
    for (number, camera) in cameras.iter().enumerate() {
        if let Some(pose) = found.poses.pairs[number] {
            let what = format!("{0}/right in {0}/left", camera.name);
            let nominal = camera.left_from_right.as_ref().map(|t| t.transform);
            all.push(RelativePose::new(what, found.pose(pose), nominal));
        }
    }
    let Some(first) = (0..cameras.len()).find(|&c| found.poses.cameras[c].is_some()) else {
        return all;
    };
    for number in first + 1..cameras.len() {
        let Some(pose) = found.left_from_left(first, number) else {
            continue;
        };
        let nominal = |c: usize| cameras[c].rig_from_left.as_ref().map(|t| t.transform);
        let nominal = nominal(first)
            .zip(nominal(number))
            .map(|(a, b)| a.inverse() * b);
        let what = format!(
            "{}/left in {}/left",
            cameras[number].name, cameras[first].name
        );
        all.push(RelativePose::new(what, pose, nominal));
    }
    all
}

/// The document; `rig` is the calibrated rig, if there is one.
pub(super) fn json(manifest: &Manifest, found: &Calibration, rig: Option<&Rig>) -> Result<Vec<u8>> {
    let input = &found.input;
    let mut frames = Vec::new();
    for placed in rig
        .map(super::rig_poses::of)
        .transpose()?
        .unwrap_or_default()
    {
        frames.push(json!({
            "frame": placed.frame,
            "rig_from_frame": rig.and_then(|r| r.transform(&Frame::rig(), &placed.frame).ok()),
            "translation_mm": placed.at_mm,
            "roll_pitch_yaw_deg": placed.rpy_deg,
            "sigma_mm_deg": placed.sigma,
        }));
    }
    let eyes = (0..input.eyes.len()).map(|eye| {
        let model = found.lens(eye);
        let coverage = &found.coverage[eye];
        json!({
            "name": input.eyes[eye].name,
            "camera_model": model,
            "parameters": model.parameter_names(),
            "values": model.parameters(),
            "sigmas": found.lens_sigmas(eye),
            "factory": input.eyes[eye].factory,
            "views": coverage.views,
            "rms_px": found.solution.rms_px(|view| view.lens == eye),
        })
    });
    let relative_poses = relative_poses(found).into_iter().map(|pose| {
        let covariance: Vec<Vec<f64>> = (0..6)
            .map(|i| (0..6).map(|j| pose.covariance[(i, j)]).collect())
            .collect();
        json!({
            "transform": pose.what,
            "parent_from_child": pose.parent_from_child,
            "covariance_in_parent": covariance,
            "deviation_from_nominal_mm_deg": pose.deviation.map(|(mm, deg)| [mm, deg]),
        })
    });
    let choices = found
        .choices
        .iter()
        .zip(&input.cameras)
        .map(|(choice, camera)| {
            let candidates = choice.candidates.iter().map(|c| {
                json!({
                    "model": c.model,
                    "coefficients": c.coefficients,
                    "rms_px": finite(c.rms_px),
                    "held_out_px": c.held_out_px,
                    "bic_over_best": finite(c.bic),
                    "remark": c.remark,
                })
            });
            json!({
                "camera": camera.name,
                "chosen": choice.candidates[choice.chosen].model,
                "candidates": candidates.collect::<Vec<Json>>(),
            })
        });
    let findings = found.findings.iter();
    let findings = findings.map(|f| json!({ "severity": word(f.severity), "text": f.text }));
    let document = json!({
        "format": "paws-cameras",
        "format_version": VERSION,
        "software": SOFTWARE,
        "session_id": manifest.session_id,
        "started_civil": manifest.started_civil.to_string(),
        "units": "pixels, m, rad; sigma is one standard deviation; covariances are of [translation, rotation] in the axes of the parent",
        "config": found.config,
        "detection_config": detection_config(),
        "eyes": eyes.collect::<Vec<Json>>(),
        "extrinsics": relative_poses.collect::<Vec<Json>>(),
        "origin_camera": rig.and_then(Rig::origin_camera),
        "frames": frames,
        "lens_models": choices.collect::<Vec<Json>>(),
        "sagitta_m": found.sagitta_m,
        "instants_used": found.used.len(),
        "noise_scale": found.solution.scale,
        "findings": findings.collect::<Vec<Json>>(),
    });
    let mut bytes = serde_json::to_vec_pretty(&document)?;
    bytes.push(b'\n');
    Ok(bytes)
}

/// JSON has no infinity.
fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// The printed lines.
pub(super) fn lines(found: &Calibration) -> Vec<String> {
    let input = &found.input;
    let mut lines = Vec::new();
    for finding in &found.findings {
        lines.push(format!("{}  {}", word(finding.severity), finding.text));
    }
    lines.push(String::new());
    lines.push(
        "eye                      lens             views  RMS px  fx px             factory"
            .to_owned(),
    );
    for eye in 0..input.eyes.len() {
        let model = found.lens(eye);
        let factory = input.eyes[eye].factory;
        lines.push(format!(
            "{:<24} {:<16} {:>5}  {:>6.3}  {:>8.2} \u{b1} {:<5.2}  {}",
            input.eyes[eye].name,
            model.distortion.name(),
            found.coverage[eye].views,
            found.solution.rms_px(|view| view.lens == eye),
            model.fx,
            2.0 * found.lens_sigmas(eye)[0],
            factory.map_or("unknown".to_owned(), |f| format!("{:.2}", f.fx)),
        ));
    }
    lines.push(String::new());
    lines.push(
        "extrinsics                                  deviation from nominal   \u{b1}".to_owned(),
    );
    for pose in relative_poses(found) {
        let deviation = pose
            .deviation
            .map_or("no nominal value".to_owned(), |(mm, deg)| {
                format!("{mm:>7.2} mm {deg:>7.3}\u{b0}")
            });
        lines.push(format!(
            "{:<42} {deviation:<22} {:>6.2} mm {:>6.3}\u{b0}",
            pose.what,
            2.0 * pose.sigma.0,
            2.0 * pose.sigma.1
        ));
    }
    lines.push(String::new());
    lines
}
