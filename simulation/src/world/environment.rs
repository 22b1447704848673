//! One environment: its episode, a step, a reset.

use super::block::{OUTSIDE_MAP, UNKNOWN, block_code, is_collision};
use super::episode::{Episode, Phase, Target};
use super::frames;
use super::pursuit::pursue;
use super::report::{report, report_camera, report_numbers};
use super::rows::Row;
use super::shared::Shared;
use crate::SimulationError;
use crate::agent::{self, AgentState, Drive};
use crate::episode::end::EndReason;
use crate::episode::start::{self, Condition, Exclusions};
use crate::episode::task::{Task, goals};
use crate::randomness::{RandomStream, Stream};

/// The first state of an episode.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EpisodeStart {
    pub(crate) sector: u32,
    pub(crate) state: AgentState,
    pub(crate) episode: Episode,
}

/// Draws start and target of an episode.
///
/// # Errors
/// [`SimulationError::Start`].
pub(crate) fn begin(
    shared: &Shared,
    seed: u64,
    number: u64,
) -> Result<EpisodeStart, SimulationError> {
    let config = &shared.config;
    let parameters = config.randomization.draw(seed, number);
    let mut exclusions = Exclusions::default();
    let is_empty = match config.start.mode {
        start::StartMode::FreeSpace => shared.candidates.cells.is_empty(),
        start::StartMode::Recorded => shared.candidates.views.is_empty(),
    };
    if is_empty {
        return Err(exclusions.error(0));
    }
    for draw in 0..config.start.max_tries {
        let found = start::draw(shared, seed, number, draw).and_then(|start| {
            let position_m = start.state.position_m;
            let target = target(shared, seed, number, start.sector, position_m);
            Ok((start, target.ok_or(Condition::Goal)?))
        });
        match found {
            Ok((start, (target, remaining_m))) => {
                return Ok(EpisodeStart {
                    sector: start.sector,
                    state: start.state,
                    episode: Episode {
                        number,
                        phase: Phase::Running,
                        parameters,
                        target,
                        first_m: remaining_m,
                        remaining_m,
                        ..Episode::new(seed)
                    },
                });
            }
            Err(condition) => exclusions.count(condition),
        }
    }
    Err(exclusions.error(config.start.max_tries))
}

/// The target of an episode that starts at a position, and the distance to its end.
fn target(
    shared: &Shared,
    seed: u64,
    number: u64,
    sector: u32,
    position_m: [f64; 3],
) -> Option<(Target, f64)> {
    let terrain = &shared.terrains[sector as usize];
    match shared.config.task.task {
        Task::PointGoal => {
            let random = RandomStream::new(seed, number, Stream::Goal);
            let task = &shared.config.task;
            let chosen = goals::choose(&shared.goals, task, terrain.frame, position_m, &random);
            let (index, remaining_m) = chosen?;
            let position_m = shared.goals[index as usize].position_m;
            Some((Target::Goal { index, position_m }, remaining_m))
        }
        Task::FollowPath => {
            let along_m = terrain.path.nearest(position_m)?.along_m;
            let remaining_m = terrain.path.length_m() - along_m;
            let is_worth_it = remaining_m > shared.config.task.success_radius_m;
            is_worth_it.then_some((Target::Path { along_m }, remaining_m))
        }
        Task::Velocity => Some((Target::Command, 0.0)),
    }
}

/// Puts an environment into its first state.
pub(crate) fn reset(shared: &Shared, row: &mut Row<'_>, begin: &EpisodeStart) {
    *row.sector = begin.sector;
    *row.state = begin.state;
    *row.episode = begin.episode;
    *row.body_from_camera = begin.episode.parameters.body_from_camera(&shared.mount);
    frames::begin(shared, row);
    row.clear_step();
    report(shared, row);
}

/// Takes an agent over the edges to another sector, and its target with it.
fn cross(shared: &Shared, row: &mut Row<'_>) {
    let mut unused_m = [0.0; 3];
    let carried_m = match &mut row.episode.target {
        Target::Goal { position_m, .. } => position_m,
        _ => &mut unused_m,
    };
    let Some((sector, state)) = shared.cross(*row.sector, row.state, carried_m) else {
        return;
    };
    let [from, to] = [*row.sector, sector].map(|sector| &shared.terrains[sector as usize]);
    *row.sector = sector;
    *row.state = state;
    let episode = &mut *row.episode;
    let Target::Path { along_m } = &mut episode.target else {
        return;
    };
    if from.frame != to.frame
        && let Some(position) = to.path.nearest(state.position_m)
    {
        // The path of the other recording goes on from here; that it does is no progress.
        let remaining_m = to.path.length_m() - position.along_m;
        *along_m = position.along_m;
        episode.first_m += remaining_m - episode.remaining_m;
        episode.remaining_m = remaining_m;
    }
}

/// Components of an action at most.
const MAX_ACTION_SIZE: usize = 6;

/// Advances an environment by a step. One that has ended does not change.
pub(crate) fn step(shared: &Shared, row: &mut Row<'_>, action: &[f64]) {
    row.clear_step();
    if row.episode.phase != Phase::Running {
        return;
    }
    let config = &shared.config;
    let mut clipped = [0.0; MAX_ACTION_SIZE];
    let clipped = &mut clipped[..action.len()];
    for (value, component) in clipped.iter_mut().zip(action) {
        *value = component.clamp(-1.0, 1.0);
        row.episode.clipped += u32::from(*value != *component);
    }
    let mut agent = config.agent;
    agent.max_speed_m_s *= row.episode.parameters.speed_scale;
    agent.max_yaw_rate_rad_s *= row.episode.parameters.yaw_rate_scale;
    let ground = &shared.terrains[*row.sector as usize].ground;
    let motion = agent::advance(
        ground,
        &agent,
        config.drive,
        row.state,
        clipped,
        config.dt_s,
    );
    *row.state = motion.state;
    let block = motion
        .blocked
        .as_ref()
        .map_or(0, |blocked| block_code(blocked.reason));
    *row.blocked = block;
    row.episode.steps += 1;
    row.episode.collisions += u32::from(motion.blocked.is_some());
    row.episode.path_length_m += motion.distance_m;
    cross(shared, row);
    frames::advance(shared, row);
    let too_far = report_camera(shared, row);
    let (mut terms, is_success) = pursue(shared, row, motion.blocked.is_some());
    let tilt_cosine = libm::cos(row.state.pitch_rad) * libm::cos(row.state.roll_rad);
    let is_walking = config.drive != Drive::Free;
    let end = config.end.choose(|reason| match reason {
        EndReason::Goal => is_success,
        EndReason::Fall => {
            let is_tilted = tilt_cosine < libm::cos(config.end.max_tilt_rad);
            is_walking && (is_tilted || !row.state.is_on_ground)
        }
        EndReason::Collision => config.end.collision_ends && is_collision(block),
        EndReason::PhysicsFault => row.episode.is_faulty,
        EndReason::LeftMap => config.end.left_map_ends && block == OUTSIDE_MAP,
        EndReason::UnknownGround => config.end.unknown_ground_ends && block == UNKNOWN,
        EndReason::Deviation => too_far,
        EndReason::TimeLimit => row.episode.steps >= shared.max_steps,
        EndReason::None => false,
    });
    if end != EndReason::None {
        row.episode.phase = Phase::Ended;
        row.episode.end = end;
        *row.end_reasons = end as i8;
        *row.terminated = config.end.terminates(end);
        *row.truncated = !*row.terminated;
    }
    terms[7] = f64::from(u8::from(*row.terminated && end != EndReason::Goal));
    *row.reward_terms = terms;
    *row.rewards = config.reward.total(&terms);
    report_numbers(shared, row);
}
