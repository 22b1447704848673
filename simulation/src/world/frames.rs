//! Frames of an environment's camera in time.

use super::rows::Row;
use super::shared::Shared;
use crate::camera::{CameraSchedule, CameraView, FrameQueue};

/// Where the camera is.
pub(crate) fn view(row: &Row<'_>) -> CameraView {
    CameraView {
        sector: *row.sector as usize,
        world_from_camera: row.state.world_from_body() * *row.body_from_camera,
    }
}

/// Times of the frames of an episode; `None` where each step has the frame of its end.
pub(crate) fn schedule(shared: &Shared, seed: u64, episode: u64) -> Option<CameraSchedule> {
    let timing = &shared.config.timing;
    (!timing.is_immediate()).then(|| CameraSchedule::draw(timing, seed, episode))
}

/// Begins an episode: frames in transit belong to the one before.
pub(super) fn begin(shared: &Shared, row: &mut Row<'_>) {
    let schedule = schedule(shared, row.episode.seed, row.episode.number);
    let start = view(row);
    *row.queue = schedule.map(|schedule| Box::new(FrameQueue::new(schedule, &start)));
}

/// Advances by the step that moved the agent.
pub(super) fn advance(shared: &Shared, row: &mut Row<'_>) {
    let after = view(row);
    if let Some(queue) = row.queue {
        queue.advance(&shared.scene, &after, shared.step_ns);
    }
}
