//! Depth maps of keyframes, posed in the world.

use cad_transforms::RigidTransform;
use scene_bundle::outputs::depth::{DepthImage, DepthIndex, DepthView, read};
use scene_bundle::{BundleError, OutputReader};
use terrain::RowMotion;

use crate::pipeline::stages::depth_frames::DepthFrame;

/// Depth map of a keyframe, posed in the world.
pub(super) struct PosedDepthMap {
    pub(super) depth_map: DepthImage,
    /// Focal lengths and principal point, px.
    pub(super) focal: [f64; 2],
    pub(super) center: [f64; 2],
    pub(super) world_from_view: FastTransform,
    pub(super) view_from_world: FastTransform,
    pub(super) left_from_view: FastTransform,
    pub(super) row_motion: RowMotion,
}

/// A rigid transform in a form that is fast to apply.
#[derive(Clone, Copy)]
pub(super) struct FastTransform {
    rows: [f64; 9],
    translation: [f64; 3],
}

/// A surface point of a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Surface {
    /// m.
    pub(super) x_in_world: [f64; 3],
    /// Along the view's axis, m.
    pub(super) depth_m: f64,
    /// One standard deviation along the view's axis, m.
    pub(super) sigma_m: f64,
    /// The axis of the view along which sigma is, of length 1.
    pub(super) axis_in_world: [f64; 3],
}

impl FastTransform {
    fn of(transform: &RigidTransform) -> Self {
        Self {
            rows: transform.rotation_rows(),
            translation: transform.translation_m(),
        }
    }

    pub(super) fn rotate(&self, v: [f64; 3]) -> [f64; 3] {
        let r = &self.rows;
        [0, 3, 6].map(|k| r[k] * v[0] + r[k + 1] * v[1] + r[k + 2] * v[2])
    }

    pub(super) fn apply(&self, x: [f64; 3]) -> [f64; 3] {
        let turned = self.rotate(x);
        [0, 1, 2].map(|k| turned[k] + self.translation[k])
    }
}

impl PosedDepthMap {
    pub(super) fn read(
        depth: &OutputReader,
        index: &DepthIndex,
        frame: &DepthFrame,
    ) -> Result<Self, BundleError> {
        let depth_map = read(depth, index, &frame.key)?;
        let view = &index.views[frame.key.view];
        Ok(Self::new(
            depth_map,
            view,
            &frame.world_from_view,
            frame.row_motion,
        ))
    }

    pub(super) fn new(
        depth_map: DepthImage,
        view: &DepthView,
        world_from_view: &RigidTransform,
        row_motion: RowMotion,
    ) -> Self {
        let model = &view.model;
        Self {
            depth_map,
            focal: [model.fx, model.fy],
            center: [model.cx, model.cy],
            world_from_view: FastTransform::of(world_from_view),
            view_from_world: FastTransform::of(&world_from_view.inverse()),
            left_from_view: FastTransform::of(&view.view_from_left.inverse()),
            row_motion,
        }
    }

    /// Sets all sigmas to this.
    #[cfg(test)]
    pub(super) fn blur(&mut self, sigma_m: f64) {
        let sigma = scene_bundle::outputs::depth::stored_sigma(sigma_m as f32);
        self.depth_map.sigma.fill(sigma);
    }

    pub(super) fn width(&self) -> u32 {
        self.depth_map.width
    }

    pub(super) fn height(&self) -> u32 {
        self.depth_map.height
    }

    /// Whether the views may overlap: the angle between their axes is less than about 90 degrees.
    pub(super) fn may_share(&self, other: &Self) -> bool {
        let axis = |look: &Self| look.world_from_view.rotate([0.0, 0.0, 1.0]);
        let (a, b) = (axis(self), axis(other));
        a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() > -0.2
    }

    fn ray(&self, column: u32, row: u32) -> [f64; 3] {
        let at = [f64::from(column), f64::from(row)];
        let [x, y] = [0, 1].map(|k| (at[k] - self.center[k]) / self.focal[k]);
        [x, y, 1.0]
    }

    /// Direction of a pixel in the recorded left optical frame.
    pub(super) fn ray_in_left(&self, column: u32, row: u32) -> [f64; 3] {
        self.left_from_view.rotate(self.ray(column, row))
    }

    /// Surface of a pixel, if its sigma is at most `largest_sigma_m`.
    pub(super) fn surface(&self, column: u32, row: u32, largest_sigma_m: f64) -> Option<Surface> {
        let depth = self.depth_map.depth_m(column, row)?;
        let sigma_m = self.depth_map.sigma_m(column, row)?;
        let x_in_view = self.ray(column, row).map(|v| v * depth);
        let x_in_view = self.row_motion.at_pose(f64::from(row), x_in_view);
        (sigma_m <= largest_sigma_m).then(|| Surface {
            x_in_world: self.world_from_view.apply(x_in_view),
            depth_m: depth,
            sigma_m,
            axis_in_world: self.world_from_view.rotate([0.0, 0.0, 1.0]),
        })
    }
}
