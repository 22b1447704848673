//! Frames of an environment's camera in time.

use cad_transforms::RigidTransform;
use nalgebra::Vector3;

use super::rows::Row;
use super::shared::Shared;
use crate::agent::{AgentState, Drive};
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

/// Velocity of a camera on an agent, m/s, and its angular rate, rad/s, in its own axes. The agent
/// moves and turns on the plane below it. A free camera moves along its forward and left axes and
/// turns about the vertical: its state has no more.
pub(super) fn motion(
    state: &AgentState,
    body_from_camera: &RigidTransform,
    drive: Drive,
) -> [[f64; 3]; 2] {
    let [forward, left, turn] = state.velocity;
    let world_from_body = state.world_from_body();
    let (velocity, rate) = match drive {
        Drive::Free => (
            world_from_body.rotate([forward, left, 0.0]),
            [0.0, 0.0, turn],
        ),
        _ => {
            let (sine, cosine) = (libm::sin(state.yaw_rad), libm::cos(state.yaw_rad));
            let [x, y] = [
                forward * cosine - left * sine,
                forward * sine + left * cosine,
            ];
            let [pitch, roll] = [state.pitch_rad, state.roll_rad].map(libm::cos);
            let up = world_from_body.rotate([0.0, 0.0, 1.0]);
            let climb = -(up[0] * x + up[1] * y) / (pitch * roll);
            // Of its heading about the vertical, which a turn about the normal of the plane gives.
            let about_normal = turn * pitch / roll;
            ([x, y, climb], up.map(|v| v * about_normal))
        }
    };
    let lever_m = Vector3::from(world_from_body.rotate(body_from_camera.translation_m()));
    let velocity = Vector3::from(velocity) + Vector3::from(rate).cross(&lever_m);
    let camera_from_world = (world_from_body * *body_from_camera).inverse();
    [velocity.into(), rate].map(|v| camera_from_world.rotate(v))
}
