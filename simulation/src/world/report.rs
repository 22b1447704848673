//! What is reported of an environment after a step or reset.

use super::episode::Target;
use super::frames;
use super::observation::polar;
use super::rows::Row;
use super::shared::Shared;
use crate::episode::EndReason;
use crate::episode::task::weighted_by_path_length;

/// Everything that follows from the state: camera, numbers, observation.
pub(crate) fn report(shared: &Shared, row: &mut Row<'_>) {
    report_camera(shared, row);
    report_numbers(shared, row);
}

/// The deviation of the camera from recorded ones and its predicted PSNR, and whether it is too
/// far.
pub(super) fn report_camera(shared: &Shared, row: &mut Row<'_>) -> bool {
    let world_from_camera = frames::view(row).world_from_camera;
    let deviation = shared.deviation(*row.sector, &world_from_camera);
    let support_db = shared.support_db(*row.sector, row.state);
    *row.support_db = support_db as f32;
    (*row.deviation_m, *row.deviation_rad) = deviation.map_or((-1.0, -1.0), |deviation| {
        (deviation.distance_m as f32, deviation.angle_rad as f32)
    });
    shared.config.end.is_too_far(deviation.as_ref(), support_db)
}

/// Numbers of the episode, and the observation.
pub(super) fn report_numbers(shared: &Shared, row: &mut Row<'_>) {
    let episode = &*row.episode;
    *row.collisions = episode.collisions;
    *row.clipped = episode.clipped;
    *row.steps = u32::try_from(episode.steps).unwrap_or(u32::MAX);
    *row.path_length_m = episode.path_length_m as f32;
    *row.remaining_m = episode.remaining_m as f32;
    let success = f64::from(u8::from(episode.end == EndReason::Goal));
    let covered = match episode.first_m > 0.0 {
        true => (1.0 - episode.remaining_m / episode.first_m).clamp(0.0, 1.0),
        false => 0.0,
    };
    let by_length =
        |share| weighted_by_path_length(share, episode.first_m, episode.path_length_m) as f32;
    *row.spl = by_length(success);
    *row.soft_spl = by_length(covered);
    *row.frame_age_s = row.queue.as_ref().map_or(0.0, |queue| queue.age_s()) as f32;
    let (config, state) = (&shared.config, &*row.state);
    let terrain = &shared.terrains[*row.sector as usize];
    let target = match episode.target {
        Target::Goal { position_m, .. } => polar(state, position_m),
        Target::Path { along_m } => {
            let ahead = terrain.path.at(along_m + config.task.lookahead_m);
            ahead.map_or([0.0; 2], |point| polar(state, point))
        }
        Target::Command => {
            let time_s = episode.steps as f64 * config.dt_s;
            config.task.command(episode.seed, episode.number, time_s)
        }
    };
    shared
        .layout
        .write(&terrain.ground, state, target, row.observation);
}
