//! Free-space votes: other views support a surface, or see through it.
//!
//! A surface that views of other instants see through was free then: it belongs to a dynamic
//! object, or is an error of the matcher. Only supported surfaces become points.

use super::config::VoteConfig;
use super::posed_depth_map::{PosedDepthMap, Surface};

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

impl PosedDepthMap {
    fn evidence(&self, config: &VoteConfig, surface: &Surface) -> Evidence {
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
            if (depth - z).abs() <= config.support_sigma * both {
                return Evidence::Supports;
            }
            known += 1;
            beyond += u32::from(depth - z > config.free_space_sigma * both);
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
    pub(super) fn classify(
        &self,
        config: &VoteConfig,
        others: &[(bool, &PosedDepthMap)],
    ) -> PointMotion {
        let (mut supports, mut violations, mut violating_views) = (0, 0, 0);
        for (is_later, other) in others {
            match other.evidence(config, self) {
                Evidence::Supports => supports += u32::from(*is_later),
                Evidence::ViolatesFreeSpace => {
                    violations += 1;
                    violating_views += u32::from(*is_later);
                }
                Evidence::Unknown => {}
            }
        }
        if supports >= config.min_support_views
            && supports >= config.support_per_violation * violations
        {
            PointMotion::Static
        } else if violating_views >= config.min_violation_views && violating_views > supports {
            PointMotion::Dynamic
        } else {
            PointMotion::Unknown
        }
    }
}
