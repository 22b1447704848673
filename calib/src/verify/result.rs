//! The result of a verification, as metrics, lines and JSON.

use anyhow::{Context, Result};
use calib::verify::{Finding as CalibrationFinding, Parameter, Status, Verification};
use serde_json::json;
use session_archive::handoff::Verdict;
use session_archive::manifest;
use session_health::{Finding, Limits, Measurement};

use crate::software::SOFTWARE;

/// Result of verifying a session's calibration.
pub(super) struct SessionVerification {
    /// Estimates and findings.
    pub(super) verification: Verification,
    /// Name and revision of the rig file, where the session has one.
    pub(super) revision: Option<(String, String)>,
    /// Cameras left out, with the reason.
    pub(super) left_out: Vec<String>,
    /// Number of processed bursts.
    pub(super) bursts: usize,
}

impl SessionVerification {
    /// The determined parameters as metrics.
    pub(super) fn measurements(&self) -> Vec<Measurement> {
        let determined = self.verification.findings.iter();
        let determined = determined.filter(|f| f.status != Status::Undetermined);
        let one = |found: &CalibrationFinding| {
            let (metric, value) = match found.parameter {
                Parameter::StereoRotation => ("calib.stereo_rotation", found.excess.to_degrees()),
                Parameter::Camera => ("calib.camera_rotation", found.excess.to_degrees()),
                Parameter::Imu => ("calib.imu_rotation", found.excess.to_degrees()),
                _ => ("calib.time_offset", found.excess * 1e9),
            };
            Measurement {
                metric: metric.to_owned(),
                of: found.camera.clone(),
                value,
                detail: self.words(found),
            }
        };
        determined.map(one).collect()
    }

    /// The metrics compared with the limits.
    pub(super) fn findings(&self, limits: &Limits) -> Vec<Finding> {
        let measurements = self.measurements();
        measurements
            .iter()
            .filter_map(|m| m.compare(limits))
            .collect()
    }

    /// Text of a finding, with the revision that it contradicts.
    pub(super) fn words(&self, found: &CalibrationFinding) -> String {
        match &self.revision {
            Some((_, revision))
                if found.status == Status::Inconsistent && found.parameter == Parameter::Camera =>
            {
                format!("{} since revision {revision}", found.text)
            }
            _ => found.text.clone(),
        }
    }

    pub(super) fn lines(&self, findings: &[Finding]) -> Vec<String> {
        let mut lines = Vec::new();
        if let Some((file, revision)) = &self.revision {
            lines.push(format!("against {file}, revision {revision}"));
        }
        for camera in &self.verification.cameras {
            let eyes = camera.eyes.as_ref().map(|eyes| {
                format!(
                    "epipolar error {:.2} px RMS with the nominal extrinsics, {:.2} px with the estimate ({} matches), parallax in {} of {} track segments",
                    eyes.nominal_rms_px,
                    eyes.found_rms_px,
                    eyes.matches,
                    eyes.parallax_segments,
                    eyes.segments
                )
            });
            let eyes = eyes.unwrap_or_else(|| "too few stereo matches".to_owned());
            lines.push(format!("{}: {eyes}", camera.name));
        }
        for found in &self.verification.findings {
            let verdict = self.verdict(found, findings);
            lines.push(format!("{verdict:4}  {}", self.words(found)));
        }
        lines.extend(self.left_out.iter().map(|what| format!("left out: {what}")));
        lines
    }

    /// PASS, WARN or FAIL; empty for an undetermined parameter.
    pub(super) fn verdict(&self, found: &CalibrationFinding, findings: &[Finding]) -> String {
        let words = self.words(found);
        let of = findings
            .iter()
            .find(|f| f.of == found.camera && f.text.contains(&words));
        of.map_or(String::new(), |f| f.verdict.to_string())
    }

    pub(super) fn json(&self, manifest: &manifest::Manifest, verdict: Verdict) -> Result<Vec<u8>> {
        let document = json!({
            "format": "paws-calib-verify",
            "version": 1,
            "software": SOFTWARE,
            "session_id": manifest.session_id,
            "rig_file": self.revision.as_ref().map(|r| &r.0),
            "revision": self.revision.as_ref().map(|r| &r.1),
            "verdict": verdict,
            "bursts": self.bursts,
            "left_out": self.left_out,
            "found": self.verification,
        });
        let mut text = serde_json::to_vec_pretty(&document).context("writing JSON")?;
        text.push(b'\n');
        Ok(text)
    }
}
