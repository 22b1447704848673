//! Depth maps of keyframes in the world, and their votes on the surfaces of others: support and
//! free-space violation.

use cad_transforms::RigidTransform;
use scene_bundle::outputs::depth::{DepthImage, DepthIndex, DepthKey, DepthView, read};
use scene_bundle::{BundleError, OutputReader};

use super::rolling_shutter::RowMotion;

/// Maximum difference of two depths that support each other, in combined sigmas.
pub(super) const SUPPORT_SIGMA: f64 = 2.0;
/// A view sees through a surface (free-space violation) if all its depths there are farther by more
/// than this many combined sigmas.
pub(super) const FREE_SPACE_SIGMA: f64 = 3.0;
/// Minimum number of views of other instants that support a static surface. With one, feet that
/// rest for a moment and people who walk along the viewing direction would remain.
pub(super) const MIN_SUPPORT_VIEWS: u32 = 2;
/// Number of supporting views required for each free-space violation: matchers err, and two in four
/// rarely err alike.
pub(super) const SUPPORT_PER_VIOLATION: u32 = 3;
/// Minimum number of views of other instants that see through a dynamic surface.
const MIN_VIOLATION_VIEWS: u32 = 2;

/// A depth map with its pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct DepthFrame {
    pub(super) key: DepthKey,
    /// Pose at the exposure of its middle row.
    pub(super) world_from_view: RigidTransform,
    pub(super) row_motion: RowMotion,
}

/// Depth map of a keyframe, posed in the world.
pub(super) struct PosedDepthMap {
    depth_map: DepthImage,
    /// Focal lengths and principal point, px.
    focal: [f64; 2],
    center: [f64; 2],
    world_from_view: FastTransform,
    view_from_world: FastTransform,
    left_from_view: FastTransform,
    row_motion: RowMotion,
}

/// A rigid transform in a form that is fast to apply.
#[derive(Clone, Copy)]
struct FastTransform {
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
    axis_in_world: [f64; 3],
}

/// Motion of a surface, from the votes of all other views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PointMotion {
    /// Static: supported by others.
    Static,
    /// Dynamic: free at other times.
    Dynamic,
    /// Too few votes, or contradicting ones.
    Unknown,
}

/// Vote of a view on a surface of another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Evidence {
    /// Outside of the view, occluded, or without depth.
    Unknown,
    /// The surface is supported.
    Supports,
    /// Free-space violation: the view sees through it.
    ViolatesFreeSpace,
}

impl FastTransform {
    fn of(transform: &RigidTransform) -> Self {
        Self {
            rows: transform.rotation_rows(),
            translation: transform.translation_m(),
        }
    }

    fn rotate(&self, v: [f64; 3]) -> [f64; 3] {
        let r = &self.rows;
        [0, 3, 6].map(|k| r[k] * v[0] + r[k + 1] * v[1] + r[k + 2] * v[2])
    }

    fn apply(&self, x: [f64; 3]) -> [f64; 3] {
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
        let x_in_view = self.row_motion.at_middle(f64::from(row), x_in_view);
        (sigma_m <= largest_sigma_m).then(|| Surface {
            x_in_world: self.world_from_view.apply(x_in_view),
            depth_m: depth,
            sigma_m,
            axis_in_world: self.world_from_view.rotate([0.0, 0.0, 1.0]),
        })
    }

    fn evidence(&self, surface: &Surface) -> Evidence {
        let in_view = self.view_from_world.apply(surface.x_in_world);
        if in_view[2] <= 0.0 {
            return Evidence::Unknown;
        }
        // The row of the projection hardly depends on the motion within the frame.
        let row = self.focal[1] * in_view[1] / in_view[2] + self.center[1];
        let [x, y, z] = self.row_motion.at_row(row, in_view);
        let at = [
            self.focal[0] * x / z + self.center[0],
            self.focal[1] * y / z + self.center[1],
        ];
        let size = [self.depth_map.width, self.depth_map.height];
        if (0..2).any(|k| !(at[k] >= 0.0 && at[k] < f64::from(size[k]) - 1.0)) {
            return Evidence::Unknown;
        }
        let (column, row) = (at[0] as u32, at[1] as u32);
        // Across the viewing axis a surface is known much better than along it.
        let along = self.view_from_world.rotate(surface.axis_in_world)[2];
        let of_surface = along * surface.sigma_m;
        let (mut known, mut beyond) = (0, 0);
        // A point between pixels may be on the surface of any of the four.
        for (right, down) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (column, row) = (column + right, row + down);
            let seen = self.depth_map.depth_m(column, row);
            let (Some(depth), Some(sigma)) = (seen, self.depth_map.sigma_m(column, row)) else {
                continue;
            };
            let both = of_surface.hypot(sigma);
            if (depth - z).abs() <= SUPPORT_SIGMA * both {
                return Evidence::Supports;
            }
            known += 1;
            beyond += u32::from(depth - z > FREE_SPACE_SIGMA * both);
        }
        match known == 4 && beyond == 4 {
            true => Evidence::ViolatesFreeSpace,
            false => Evidence::Unknown,
        }
    }
}

impl Surface {
    /// Classifies the surface by the votes of others, each with a flag whether it is of another
    /// instant: dynamic objects are supported by views of the same instant.
    pub(super) fn classify(&self, others: &[(bool, &PosedDepthMap)]) -> PointMotion {
        let (mut supports, mut violations, mut violating_views) = (0, 0, 0);
        for (is_later, other) in others {
            match other.evidence(self) {
                Evidence::Supports => supports += u32::from(*is_later),
                Evidence::ViolatesFreeSpace => {
                    violations += 1;
                    violating_views += u32::from(*is_later);
                }
                Evidence::Unknown => {}
            }
        }
        if supports >= MIN_SUPPORT_VIEWS && supports >= SUPPORT_PER_VIOLATION * violations {
            PointMotion::Static
        } else if violating_views >= MIN_VIOLATION_VIEWS && violating_views > supports {
            PointMotion::Dynamic
        } else {
            PointMotion::Unknown
        }
    }
}
