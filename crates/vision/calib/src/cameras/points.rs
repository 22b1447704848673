//! Points of detections as observations of a bundle adjustment.

use boards::Target;
use cad_transforms::RigidTransform;

use crate::adjust::{self, Problem};
use crate::target::DetectedCorner;

/// Points of a detection, for a view of the problem. Sigmas are at least `min_sigma_px`.
pub(super) fn points(
    target: &Target,
    corners: &[DetectedCorner],
    min_sigma_px: f64,
) -> Vec<adjust::Point> {
    let known = target.corners();
    corners
        .iter()
        .filter_map(|seen| {
            let at = known.binary_search_by_key(&seen.id, |c| c.id).ok()?;
            let [x, y] = known[at].at_m;
            Some(adjust::Point {
                x_in_target: [x, y, 0.0],
                pixel: seen.pixel,
                sigma_px: seen.sigma_px.max(min_sigma_px),
            })
        })
        .collect()
}

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
