//! Points of detections as observations of a bundle adjustment.

use boards::Target;
use cad_transforms::RigidTransform;

use crate::adjust::{self, Problem};
use crate::target::DetectedCorner;

/// Points of a detection, for a view of the problem.
pub(super) fn points(target: &Target, corners: &[DetectedCorner]) -> Vec<adjust::Point> {
    let known = target.corners();
    corners
        .iter()
        .filter_map(|seen| {
            let at = known.binary_search_by_key(&seen.id, |c| c.id).ok()?;
            let [x, y] = known[at].at_m;
            Some(adjust::Point {
                x_in_target: [x, y, 0.0],
                pixel: seen.pixel,
                sigma_px: seen.sigma_px.max(MIN_SIGMA_PX),
            })
        })
        .collect()
}

/// Sigma floor of a corner, px: residual errors of paper, print and lens.
const MIN_SIGMA_PX: f64 = 0.02;

/// A problem with one lens and an independent pose per view.
pub(super) fn single_lens_problem(
    lens: adjust::LensBlock,
    views: &[(RigidTransform, Vec<adjust::Point>)],
) -> Problem {
    Problem {
        lenses: vec![lens],
        poses: Vec::new(),
        instants: views.iter().map(|(pose, _)| *pose).collect(),
        clusters: Vec::new(),
        views: views
            .iter()
            .enumerate()
            .map(|(instant, (_, points))| adjust::View {
                instant,
                lens: 0,
                path: Vec::new(),
                target: None,
                points: points.clone(),
            })
            .collect(),
    }
}
