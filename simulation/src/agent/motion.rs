//! Motion without ground: limits of speed, and arcs.
//!
//! With constant speed and rate of turn an agent moves along an arc. Its chord has the length
//! `v dt sinc(δ/2)` and the direction `ψ + δ/2`, where `δ = ω dt` is the change of heading `ψ`:
//! one formula for arcs and straight lines, without division by the rate.

use super::{AgentConfig, AgentState, Drive, Motion};

/// Angle below which the series of the sinc is exact to 1e-16.
const SMALL_RAD: f64 = 1e-4;

/// Speeds after the limits: forward and to the left, m/s; rate of turn, rad/s.
pub(super) fn velocity(
    config: &AgentConfig,
    drive: Drive,
    state: &AgentState,
    parts: &[f64; 6],
    dt_s: f64,
) -> [f64; 3] {
    let (speed, rate) = (config.max_speed_m_s, config.max_yaw_rate_rad_s);
    let wanted = match drive {
        Drive::Differential => [parts[0] * speed, 0.0, parts[1] * rate],
        Drive::Wheels => {
            let [left, right] = [parts[0], parts[1]].map(|part| part * speed);
            let turn = (right - left) / config.track_m;
            [0.5 * (left + right), 0.0, turn.clamp(-rate, rate)]
        }
        Drive::Holonomic => {
            // The limit is of the speed, not of each component.
            let size = (parts[0] * parts[0] + parts[1] * parts[1]).sqrt().max(1.0);
            [
                parts[0] / size * speed,
                parts[1] / size * speed,
                parts[2] * rate,
            ]
        }
        Drive::Free => [0.0; 3],
    };
    let [forward, left] = [0, 1].map(|k| wanted[k] - state.velocity[k]);
    let change = (forward * forward + left * left).sqrt();
    let most = config.max_acceleration_m_s2 * dt_s;
    let share = if change > most { most / change } else { 1.0 };
    let most = config.max_yaw_acceleration_rad_s2 * dt_s;
    let turn = (wanted[2] - state.velocity[2]).clamp(-most, most);
    [
        state.velocity[0] + share * forward,
        state.velocity[1] + share * left,
        state.velocity[2] + turn,
    ]
}

/// A motion with constant speeds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arc {
    start_m: [f64; 2],
    yaw_rad: f64,
    /// Path in the frame of the body, m, as if it did not turn.
    straight_m: [f64; 2],
    /// Change of heading, rad.
    turn_rad: f64,
    /// Length of the path, m.
    pub(super) length_m: f64,
}

impl Arc {
    pub(super) fn new(state: &AgentState, velocity: [f64; 3], dt_s: f64) -> Self {
        let straight_m = [velocity[0] * dt_s, velocity[1] * dt_s];
        Self {
            start_m: [state.position_m[0], state.position_m[1]],
            yaw_rad: state.yaw_rad,
            straight_m,
            turn_rad: velocity[2] * dt_s,
            length_m: (straight_m[0] * straight_m[0] + straight_m[1] * straight_m[1]).sqrt(),
        }
    }

    /// Position after a share of the time, m.
    pub(super) fn position_m(&self, share: f64) -> [f64; 2] {
        let half = 0.5 * self.turn_rad * share;
        let chord = share * sinc(half);
        let (sine, cosine) = (
            libm::sin(self.yaw_rad + half),
            libm::cos(self.yaw_rad + half),
        );
        let [forward, left] = self.straight_m;
        [
            self.start_m[0] + chord * (forward * cosine - left * sine),
            self.start_m[1] + chord * (forward * sine + left * cosine),
        ]
    }

    /// Heading after a share of the time, rad.
    pub(super) fn yaw_rad(&self, share: f64) -> f64 {
        wrap(self.yaw_rad + self.turn_rad * share)
    }
}

/// sin x / x.
fn sinc(x: f64) -> f64 {
    match x.abs() < SMALL_RAD {
        true => 1.0 - x * x / 6.0,
        false => libm::sin(x) / x,
    }
}

/// The same angle within -π to π.
pub(super) fn wrap(angle_rad: f64) -> f64 {
    let turn = 2.0 * std::f64::consts::PI;
    let wrapped = angle_rad - turn * libm::round(angle_rad / turn);
    wrapped.clamp(-std::f64::consts::PI, std::f64::consts::PI)
}

/// A step of a free camera.
pub(super) fn fly(config: &AgentConfig, state: &AgentState, parts: &[f64; 6], dt_s: f64) -> Motion {
    let rotate = |v: [f64; 3]| state.world_from_body().rotate(v);
    let size = (parts[..3].iter().map(|v| v * v).sum::<f64>())
        .sqrt()
        .max(1.0);
    let speed = config.max_speed_m_s / size;
    let velocity = [parts[0] * speed, parts[1] * speed, parts[2] * speed];
    let moved = rotate(velocity.map(|v| v * dt_s));
    let turn = |part: f64| part * config.max_yaw_rate_rad_s * dt_s;
    let mut next = *state;
    next.position_m = [0, 1, 2].map(|k| state.position_m[k] + moved[k]);
    let quarter = std::f64::consts::FRAC_PI_2;
    next.roll_rad = wrap(state.roll_rad + turn(parts[3]));
    next.pitch_rad = (state.pitch_rad + turn(parts[4])).clamp(-quarter, quarter);
    next.yaw_rad = wrap(state.yaw_rad + turn(parts[5]));
    next.velocity = [
        velocity[0],
        velocity[1],
        parts[5] * config.max_yaw_rate_rad_s,
    ];
    next.is_on_ground = false;
    Motion {
        state: next,
        blocked: None,
        distance_m: moved.iter().map(|v| v * v).sum::<f64>().sqrt(),
    }
}
