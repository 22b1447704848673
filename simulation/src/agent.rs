//! An agent: its size and limits, its state, and one step of its motion over the ground.
//!
//! Contract: [`advance`] is a function of its arguments. The agent never passes through an
//! obstacle, a step above its limit, a low ceiling or unknown ground, whatever its speed: it stops
//! in front of it, or slides along it where the configuration says so, and the result says why and
//! where.

mod collision;
pub(crate) mod config;
mod drive;
mod footing;
mod motion;
mod playback;
pub(crate) mod state;

#[cfg(test)]
mod tests;

pub use config::AgentConfig;
pub use drive::Drive;
pub use footing::Footing;
pub use playback::{Playback, WearerState};
pub use state::AgentState;

use cad_transforms::RigidTransform;

use crate::ground::{Block, Ground};

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// The state after it.
    pub state: AgentState,
    /// What stopped it, if anything.
    pub blocked: Option<Block>,
    /// Length of the path, m.
    pub distance_m: f64,
}

/// Moves an agent for `dt_s` seconds. Components of `action` beyond -1 to 1 count as -1 and 1,
/// missing ones as 0. Actions, duration and state have to be finite: of NaN comes NaN.
///
/// ```
/// use simulation::testing::SyntheticScene;
/// use simulation::{AgentConfig, AgentState, Drive, Ground, advance};
///
/// let plane = SyntheticScene::tilted_plane([0.0, 0.0])?;
/// let levels = plane.scene.sectors[0].levels.as_ref().unwrap();
/// let config = AgentConfig::default();
/// let ground = Ground::new(levels.to_vec(), &config)?;
/// let mut state = AgentState::on_ground(&ground, &config, [2.0, 3.0, 0.0], 0.0).unwrap();
/// for _ in 0..10 {
///     state = advance(&ground, &config, Drive::Differential, &state, &[1.0, 0.0], 0.1).state;
/// }
/// assert!(state.position_m[0] > 3.0 && state.is_on_ground);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
pub fn advance(
    ground: &Ground,
    config: &AgentConfig,
    drive: Drive,
    state: &AgentState,
    action: &[f64],
    dt_s: f64,
) -> Motion {
    let mut parts = [0.0; 6];
    for (part, value) in parts.iter_mut().zip(action) {
        *part = value.clamp(-1.0, 1.0);
    }
    if drive == Drive::Free {
        let (state, distance_m) = motion::fly(config, state, &parts, dt_s);
        return Motion {
            state,
            blocked: None,
            distance_m,
        };
    }
    let velocity = motion::velocity(config, drive, state, &parts, dt_s);
    let arc = motion::Arc::new(state, velocity, dt_s);
    let sweep = collision::sweep(ground, config.slides, state, &arc);
    let mut next = *state;
    let [x, y] = sweep.position_m;
    next.position_m = [x, y, sweep.height_m];
    next.yaw_rad = arc.yaw_rad(sweep.share);
    next.velocity = match sweep.blocked {
        None => velocity,
        Some(_) if config.slides => {
            // The mean velocity of what it did.
            let [x, y] = [0, 1].map(|k| (next.position_m[k] - state.position_m[k]) / dt_s);
            let (sine, cosine) = (libm::sin(next.yaw_rad), libm::cos(next.yaw_rad));
            [x * cosine + y * sine, y * cosine - x * sine, velocity[2]]
        }
        Some(_) => [0.0; 3],
    };
    next.level = sweep.level;
    match Footing::at(ground, config, next.position_m, next.yaw_rad) {
        Some(footing) => footing.place(&mut next),
        None => next.is_on_ground = false,
    }
    Motion {
        state: next,
        blocked: sweep.blocked,
        distance_m: sweep.length_m,
    }
}

/// An agent that comes onto the ground of another recording at a pose in its frame: with the
/// velocity that it has, at rest on that ground. `None` where it cannot be: on unknown or blocked
/// ground, and where the ground is further away in height than a step.
pub(crate) fn enter(
    ground: &Ground,
    config: &AgentConfig,
    drive: Drive,
    state: &AgentState,
    sector_from_body: &RigidTransform,
) -> Option<AgentState> {
    let mut next = state.with_pose(sector_from_body);
    let [x, y, z] = next.position_m;
    if drive == Drive::Free {
        next.level = ground.surface([x, y], z).map_or(0, |surface| surface.level);
        return Some(next);
    }
    let height_m = collision::free_height_m(ground, [x, y], z, &mut next.level).ok()?;
    Footing::at(ground, config, [x, y, height_m], next.yaw_rad)?.place(&mut next);
    Some(next)
}
