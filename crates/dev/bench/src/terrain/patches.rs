//! Contact patches of true footprints on the reconstructed ground, against those on the true one.

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use terrain::edges::Edge;
use terrain::ground::Ground;
use terrain::planes::Polygon;
use terrain::{PatchConfig, contact_patch};

use super::surface::Surface;
use super::truth::{CONTACT_SIGMA_M, Footprint, SOLE_M, Truth};

/// Spacing of the points of a sole at which both patches are compared, m.
const SAMPLE_M: f64 = 0.005;
/// A sole hangs free if less than this share of it bears.
const HANGING_SHARE: f64 = 0.95;

/// Patches of the footprints of a walk.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct PatchScores {
    pub(super) footprints: usize,
    /// Those whose sole hangs free in part.
    pub(super) hanging: usize,
    /// Intersection over union of these, from the worst one on.
    pub(super) hanging_iou: Vec<f64>,
    /// The same if the whole sole were the patch.
    pub(super) hanging_whole_iou: Vec<f64>,
    /// Smallest intersection over union of the others, and the number of those of them that are
    /// said to hang free.
    pub(super) whole_iou_min: f64,
    pub(super) whole_said_hanging: usize,
    /// Mean share of patches below which depth shows ground.
    pub(super) ground_share: f64,
}

/// Compares the patches of all footprints.
///
/// # Errors
/// A pose that is not finite.
pub(super) fn patch_scores(surface: &Surface, truth: &Truth<'_>) -> Result<PatchScores> {
    let ground = Ground::new(&surface.ground);
    let mut scores = PatchScores {
        footprints: truth.footprints.len(),
        whole_iou_min: 1.0,
        ..PatchScores::default()
    };
    for print in &truth.footprints {
        let own = PatchComparison::new(print, (&ground, &surface.edges), truth)?;
        scores.ground_share += own.ground_share / truth.footprints.len() as f64;
        if own.true_share < HANGING_SHARE {
            scores.hanging += 1;
            scores.hanging_iou.push(own.iou);
            scores.hanging_whole_iou.push(own.true_share);
        } else {
            scores.whole_iou_min = scores.whole_iou_min.min(own.iou);
            scores.whole_said_hanging += usize::from(own.area_share < HANGING_SHARE);
        }
    }
    scores.hanging_iou.sort_by(f64::total_cmp);
    scores.hanging_whole_iou.sort_by(f64::total_cmp);
    Ok(scores)
}

/// A footprint on both grounds.
struct PatchComparison {
    true_share: f64,
    area_share: f64,
    ground_share: f64,
    iou: f64,
}

impl PatchComparison {
    fn new(
        print: &Footprint,
        (ground, edges): (&Ground<'_>, &[Edge]),
        truth: &Truth<'_>,
    ) -> Result<Self> {
        let config = PatchConfig::default();
        let [heel, toe, half] = SOLE_M;
        let outline = [[-heel, -half], [toe, -half], [toe, half], [-heel, half]];
        let pose = &print.world_from_foot;
        let (q, x) = (pose.rotation.coords, pose.translation.vector);
        let place = RigidTransform::from_wxyz([q.w, q.x, q.y, q.z], x.into());
        let place = place.context("a footprint")?;
        let patch = contact_patch(ground, edges, &place, &outline, CONTACT_SIGMA_M, &config);
        let foot_from_world = place.inverse();
        let corners = patch.outline_m.iter().map(|corner| {
            let [x, y, _] = foot_from_world.apply(*corner);
            [x, y]
        });
        let polygon = Polygon {
            outline: corners.collect(),
            holes: Vec::new(),
        };
        let [along, across] = [heel + toe, 2.0 * half].map(|m| (m / SAMPLE_M).round() as i32);
        let (mut all, mut bearing, mut both, mut either) = (0, 0, 0, 0);
        for cell in 0..along * across {
            let middle = |k: i32| (f64::from(k) + 0.5) * SAMPLE_M;
            let [x, y] = [middle(cell % along) - heel, middle(cell / along) - half];
            let sole = pose * Point3::new(x, y, 0.0);
            let height = truth.ground(sole.coords.into(), config.max_gap_m);
            let bears = height.is_some_and(|height| sole.z - height <= config.max_gap_m);
            let is_in_patch = polygon.contains([x, y]);
            all += 1;
            bearing += i32::from(bears);
            both += i32::from(bears && is_in_patch);
            either += i32::from(bears || is_in_patch);
        }
        Ok(Self {
            true_share: f64::from(bearing) / f64::from(all),
            area_share: patch.area_share,
            ground_share: patch.ground_share,
            iou: f64::from(both) / f64::from(either.max(1)),
        })
    }
}
