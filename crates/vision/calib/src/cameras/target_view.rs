//! A detection with its pose and its motion.

use super::pose_graph::PosedView;
use crate::adjust::Point;

/// A detection with its points and its pose.
pub(super) struct TargetView {
    pub(super) posed: PosedView,
    pub(super) points: Vec<Point>,
    /// Whether the pose may be the mirrored solution.
    pub(super) ambiguous: bool,
    /// Image motion to the next or from the previous view, px in 0.1 s; `None` if
    /// unknown.
    pub(super) motion_px: Option<f64>,
}

impl TargetView {
    /// Image motion, px; 0 if unknown.
    pub(super) fn motion_or_zero_px(&self) -> f64 {
        self.motion_px.unwrap_or(0.0)
    }
}

/// Median displacement of the corners that two views of one target share, px.
pub(super) fn median_displacement_px(a: &TargetView, b: &TargetView) -> Option<f64> {
    let moves = a.points.iter().filter_map(|p| {
        let q = b.points.iter().find(|q| q.x_in_target == p.x_in_target)?;
        Some((p.pixel[0] - q.pixel[0]).hypot(p.pixel[1] - q.pixel[1]))
    });
    let mut moves: Vec<f64> = moves.collect();
    moves.sort_by(f64::total_cmp);
    moves.get(moves.len() / 2).copied()
}
