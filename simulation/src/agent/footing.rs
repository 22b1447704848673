//! How an agent rests on the ground: the plane through the corners of its footprint.

use super::{AgentConfig, AgentState};
use crate::ground::{Ground, Surface};

/// The ground below a footprint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footing {
    /// Height of the plane below the center, m.
    pub height_m: f64,
    /// As in [`AgentState`], rad.
    pub pitch_rad: f64,
    /// As in [`AgentState`], rad.
    pub roll_rad: f64,
    /// Largest distance of the ground from the plane, m.
    pub residual_m: f64,
    /// Level of the ground below the center.
    pub level: usize,
    /// Whether the agent rests on it.
    pub is_on_ground: bool,
}

impl Footing {
    /// At x, y near the height z; `None` where there is no ground below the center. Where the
    /// ground below a corner is unknown the corner has the height of the center.
    pub fn at(
        ground: &Ground,
        config: &AgentConfig,
        position_m: [f64; 3],
        yaw_rad: f64,
    ) -> Option<Self> {
        let [x, y, z] = position_m;
        let center = ground.surface([x, y], z)?;
        let (sine, cosine) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
        let corner = |forward: f64, left: f64| {
            let at = [
                x + forward * cosine - left * sine,
                y + forward * sine + left * cosine,
            ];
            ground.surface(at, center.height_m)
        };
        let (length, width) = (config.half_length_m, config.half_width_m);
        let corners: [Option<Surface>; 4] = [
            corner(length, width),
            corner(length, -width),
            corner(-length, width),
            corner(-length, -width),
        ];
        // What is more than a step away is another surface, not what the agent rests on.
        let limit = config.max_step_m + config.max_residual_m;
        let heights = corners.map(|corner| {
            let height = corner.map_or(center.height_m, |corner| corner.height_m);
            let is_near = (height - center.height_m).abs() <= limit;
            if is_near { height } else { center.height_m }
        });
        let [fl, fr, rl, rr] = heights;
        let height_m = 0.25 * (fl + fr + rl + rr);
        let along = (fl + fr - rl - rr) / (4.0 * length);
        let across = (fl + rl - fr - rr) / (4.0 * width);
        let plane = |forward: f64, left: f64| height_m + along * forward + across * left;
        let planes = [
            plane(length, width),
            plane(length, -width),
            plane(-length, width),
            plane(-length, -width),
            height_m,
        ];
        let all = [fl, fr, rl, rr, center.height_m];
        let residuals = all
            .iter()
            .zip(planes)
            .map(|(height, plane)| (height - plane).abs());
        let residual_m = residuals.fold(0.0, f64::max);
        let pitch_rad = -libm::atan(along);
        Some(Self {
            height_m,
            pitch_rad,
            // Yaw, pitch, roll: the left axis of the tilted body.
            roll_rad: libm::atan(across * libm::cos(pitch_rad)),
            residual_m,
            level: center.level,
            is_on_ground: residual_m <= config.max_residual_m,
        })
    }

    /// Puts an agent on it.
    pub(super) fn place(&self, state: &mut AgentState) {
        state.position_m[2] = self.height_m;
        state.pitch_rad = self.pitch_rad;
        state.roll_rad = self.roll_rad;
        state.level = self.level;
        state.is_on_ground = self.is_on_ground;
    }
}
