//! Starts of episodes, drawn until all conditions hold, a bounded number of times.
//!
//! - [`StartMode::Recorded`]: below a recorded camera, with an offset (as PAWS-Sim starts).
//! - [`StartMode::FreeSpace`]: anywhere on free ground, uniform by area (as Beogym starts).

pub(crate) mod candidates;

use std::fmt::Write;

use estimator_config::config;
use serde::{Deserialize, Serialize};

use crate::SimulationError;
use crate::agent::AgentState;
use crate::error::check_range;
use crate::ground::Cover;
use crate::randomness::{RandomStream, Stream};
use crate::reference_poses::viewing_direction;
use crate::world::shared::Shared;

/// Where episodes start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StartMode {
    /// Near a recorded camera: uniform in a disc around it, facing where it looked within an
    /// angle.
    Recorded,
    /// On free ground, uniform by area, with any yaw.
    FreeSpace,
}

config! {
    /// Where episodes start, and the conditions of a start.
    pub struct StartConfig {
        /// Where.
        pub mode: StartMode = StartMode::FreeSpace,
        /// Greatest horizontal offset from the recorded camera, m. Source of a limit: PAWS, 3 m.
        pub max_offset_m: f64 = 1.0,
        /// Greatest yaw between the camera and the recorded one, rad. Source: PAWS, 30 degrees.
        pub max_offset_rad: f64 = std::f64::consts::FRAC_PI_6,
        /// Horizontal distance to the nearest edge, obstacle or unknown cell, at least, m. Starts
        /// nearer than the agent's radius would begin with a collision.
        pub min_clearance_m: f64 = 0.30,
        /// Predicted PSNR of the first view, at least, dB; 0 is no condition. Needs a scene of
        /// which it is known what the training saw.
        pub min_support_db: f64 = 0.0,
        /// Draws after which no start is an error.
        pub max_tries: usize = 1000,
    }
}

/// Random numbers of a draw.
const NUMBERS: u64 = 8;

impl StartConfig {
    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        let pi = std::f64::consts::PI;
        for (name, value, range, expected) in [
            (
                "start.max_offset_m",
                self.max_offset_m,
                [0.0, 1e6],
                "at least 0",
            ),
            (
                "start.max_offset_rad",
                self.max_offset_rad,
                [0.0, pi],
                "0 to π",
            ),
            (
                "start.min_clearance_m",
                self.min_clearance_m,
                [0.0, 1e6],
                "at least 0",
            ),
            (
                "start.min_support_db",
                self.min_support_db,
                [0.0, 200.0],
                "0 to 200",
            ),
            (
                "start.max_tries",
                self.max_tries as f64,
                [1.0, 1e6],
                "1 to 1000000",
            ),
        ] {
            check_range(name, value, range, expected)?;
        }
        Ok(())
    }
}

/// A condition that excluded a draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Condition {
    Ground,
    Cover,
    Component,
    Clearance,
    Footing,
    Deviation,
    Support,
    Goal,
}

/// Draws that each condition excluded.
#[derive(Clone, Debug, Default)]
pub(crate) struct Exclusions([usize; 8]);

impl Exclusions {
    const NAMES: [&str; 8] = [
        "no known ground",
        "not free",
        "not connected",
        "clearance",
        "footing",
        "too far from recorded cameras",
        "support",
        "no goal in range",
    ];

    pub(crate) fn count(&mut self, condition: Condition) {
        self.0[condition as usize] += 1;
    }

    pub(crate) fn error(&self, tries: usize) -> SimulationError {
        let mut reasons = String::new();
        for (name, count) in Self::NAMES.iter().zip(self.0) {
            if count > 0 {
                let separator = if reasons.is_empty() { "" } else { ", " };
                let _ = write!(reasons, "{separator}{name} {count}");
            }
        }
        SimulationError::Start { tries, reasons }
    }
}

/// A start that holds all conditions but those of the task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Start {
    pub(crate) sector: u32,
    pub(crate) state: AgentState,
}

/// The `number`-th draw of an episode.
pub(crate) fn draw(
    shared: &Shared,
    seed: u64,
    episode: u64,
    number: usize,
) -> Result<Start, Condition> {
    let random = RandomStream::new(seed, episode, Stream::Start);
    let first = number as u64 * NUMBERS;
    let proposal = match shared.config.start.mode {
        StartMode::FreeSpace => in_free_space(shared, &random, first),
        StartMode::Recorded => near_recorded(shared, &random, first),
    };
    check(shared, proposal)
}

/// Sector, position, height near the ground, yaw.
pub(crate) type Proposal = (u32, [f64; 2], f64, f64);

fn in_free_space(shared: &Shared, random: &RandomStream, first: u64) -> Proposal {
    let cells = &shared.candidates.cells;
    let cell = &cells[random.below(first, cells.len())];
    let half_m = 0.5 * cell.edge_m;
    let at_m =
        [0, 1].map(|k| cell.center_m[k] + random.range(first + 1 + k as u64, [-half_m, half_m]));
    let yaw_rad = random.range(first + 3, shared.config.randomization.start_yaw_rad);
    (cell.sector, at_m, cell.height_m, yaw_rad)
}

fn near_recorded(shared: &Shared, random: &RandomStream, first: u64) -> Proposal {
    let body_from_camera = &shared.mount;
    let views = &shared.candidates.views;
    let view = &views[random.below(first, views.len())];
    let config = &shared.config.start;
    let radius_m = config.max_offset_m * random.uniform(first + 1).sqrt();
    let direction_rad = std::f64::consts::TAU * random.uniform(first + 2);
    let limit = config.max_offset_rad;
    let offset_rad = random.range(first + 3, [-limit, limit]);
    // The agent's camera looks where the recorded one did; its mount may be rotated.
    let azimuth = |axis: [f64; 3]| libm::atan2(axis[1], axis[0]);
    let recorded_rad = azimuth(viewing_direction(&view.world_from_camera));
    let yaw_rad = recorded_rad + offset_rad - azimuth(viewing_direction(body_from_camera));
    // The camera, not the body, is at the offset.
    let [x, y, z] = view.world_from_camera.translation_m();
    let [forward, left, up] = body_from_camera.translation_m();
    let (sine, cosine) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
    let at_m = [
        x + radius_m * libm::cos(direction_rad) - (forward * cosine - left * sine),
        y + radius_m * libm::sin(direction_rad) - (forward * sine + left * cosine),
    ];
    (view.sector, at_m, z - up, yaw_rad)
}

/// The state on the ground, or the first condition that does not hold. Cameras are those without
/// errors of their mount: other ranges of these draw the same starts.
pub(crate) fn check(
    shared: &Shared,
    (sector, at_m, near_z_m, yaw_rad): Proposal,
) -> Result<Start, Condition> {
    let terrain = &shared.terrains[sector as usize];
    let (ground, config) = (&terrain.ground, &shared.config);
    let surface = ground.surface(at_m, near_z_m).ok_or(Condition::Ground)?;
    if !matches!(ground.cover(at_m, surface.level), Cover::Free) {
        return Err(Condition::Cover);
    }
    let component = ground.component(at_m, surface.level);
    if component.is_none() || component != terrain.component {
        return Err(Condition::Component);
    }
    if ground.clearance_m(at_m, surface.level) < config.start.min_clearance_m {
        return Err(Condition::Clearance);
    }
    let position_m = [at_m[0], at_m[1], surface.height_m];
    let state = AgentState::on_ground(ground, &config.agent, position_m, yaw_rad)
        .filter(|state| state.is_on_ground)
        .ok_or(Condition::Footing)?;
    let tilt_cosine = libm::cos(state.pitch_rad) * libm::cos(state.roll_rad);
    if tilt_cosine < libm::cos(config.end.max_tilt_rad) {
        return Err(Condition::Footing);
    }
    let world_from_camera = state.world_from_body() * shared.mount;
    let support_db = shared.support_db(sector, &state);
    if support_db < config.start.min_support_db {
        return Err(Condition::Support);
    }
    let deviation = shared.deviation(sector, &world_from_camera);
    if config.end.is_too_far(deviation.as_ref(), support_db) {
        return Err(Condition::Deviation);
    }
    Ok(Start { sector, state })
}
