//! Answers against ground truth.

use anyhow::Result;
use cad_transforms::RigidTransform;
use fiducials::poses_from_corners;
use fiducials::square::distance;
use serde::Serialize;

use super::methods::{Answers, TagEstimate};
use super::scene::{Camera, Scene, tag};
use crate::meter::{median, quantile};

/// What a method reaches under a condition.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Score {
    pub(super) method: String,
    pub(super) images: usize,
    /// Images in which it reports the tag with corners that are wrong by less than a cell (RMS).
    pub(super) found: usize,
    /// Other tags that it reports: other ids, other places.
    pub(super) wrong: usize,
    /// Errors of corners of those that are found, px.
    pub(super) corner_rms_px: f64,
    pub(super) corner_p95_px: f64,
    /// Mean of these errors away from the middle of the tag, px.
    pub(super) corner_outward_px: f64,
    /// Error of the distance, RMS, percent of it.
    pub(super) range_rms_percent: f64,
    /// Angle between the normals.
    pub(super) tilt_median_deg: f64,
    pub(super) tilt_p95_deg: f64,
    /// Processor time of an image on one thread, median.
    pub(super) ms: f64,
}

impl Score {
    pub(super) fn recall_percent(&self) -> f64 {
        100.0 * self.found as f64 / self.images.max(1) as f64
    }
}

/// The score of a method. Methods without a pose are given that of [`poses_from_corners`].
pub(super) fn score(camera: &Camera, scenes: &[Scene], answers: &Answers) -> Result<Score> {
    let (mut found, mut wrong) = (0, 0);
    let (mut corners, mut outward) = (Vec::new(), Vec::new());
    let (mut ranges, mut tilts) = (Vec::new(), Vec::new());
    for (scene, answer) in scenes.iter().zip(&answers.images) {
        let truth = scene.corners(camera)?;
        let cell_px = distance(truth[0], truth[2]) / (8.0 * std::f64::consts::SQRT_2);
        let is_right = |seen: &&TagEstimate| {
            let corners = seen.corners_in_order_of(&truth);
            let own = [0, 1, 2, 3].map(|k: usize| distance(corners[k], truth[k]));
            scene.has_tag && seen.id == scene.id && rms(&own) < cell_px
        };
        let right = answer.tags.iter().find(is_right);
        found += usize::from(right.is_some());
        wrong += answer.tags.len() - usize::from(right.is_some());
        let Some(right) = right else { continue };
        let middle = [0, 1].map(|k: usize| truth.iter().map(|c| c[k]).sum::<f64>() / 4.0);
        let found_corners = right.corners_in_order_of(&truth);
        for (own, truth) in found_corners.iter().zip(&truth) {
            corners.push(distance(*own, *truth));
            let [x, y] = [0, 1].map(|k: usize| truth[k] - middle[k]);
            let along = x * (own[0] - truth[0]) + y * (own[1] - truth[1]);
            outward.push(along / libm::hypot(x, y));
        }
        let pose = match right.left_from_tag {
            Some(pose) => Some(pose),
            None => poses_from_corners(&camera.lens, &tag(scene.id)?, &found_corners)
                .map(|[better, _]| better),
        };
        if let Some(pose) = pose {
            let truth = &scene.left_from_tag;
            let range = |pose: &RigidTransform| pose.translation().norm();
            ranges.push(100.0 * (range(&pose) / range(truth) - 1.0));
            let normals = [&pose, truth].map(|own| own.rotate([0.0, 0.0, 1.0]));
            let [[a, b, c], [x, y, z]] = normals;
            tilts.push(libm::acos((a * x + b * y + c * z).min(1.0)).to_degrees());
        }
    }
    tilts.sort_by(f64::total_cmp);
    let mean = outward.iter().sum::<f64>() / outward.len() as f64;
    let corner_rms_px = rms(&corners);
    corners.sort_by(f64::total_cmp);
    Ok(Score {
        method: answers.name.clone(),
        images: scenes.len(),
        found,
        wrong,
        corner_rms_px,
        corner_p95_px: quantile(&corners, 0.95),
        corner_outward_px: mean,
        range_rms_percent: rms(&ranges),
        tilt_median_deg: quantile(&tilts, 0.5),
        tilt_p95_deg: quantile(&tilts, 0.95),
        ms: median(answers.images.iter().map(|answer| answer.ms)),
    })
}

/// Root mean square; NaN of no values.
fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}
