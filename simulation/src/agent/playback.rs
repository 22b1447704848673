//! The recorded wearer by time: poses of the rig between those of the trajectory, and the contacts
//! of the feet.

use cad_transforms::rig::Foot;
use cad_transforms::{RigidTransform, so3};
use scene_bundle::outputs::contacts::FootContact;
use scene_bundle::{Pose, Status, Trajectory};

use super::config::AgentConfig;
use super::state::AgentState;
use crate::ground::Ground;
use crate::scene::Recording;

#[cfg(test)]
mod tests;

/// Half of the time over which velocities are measured where the trajectory has none, ns.
const VELOCITY_SPAN_NS: i64 = 50_000_000;

/// A recorded walk that is played back.
///
/// ```
/// use simulation::Playback;
/// use simulation::testing::SyntheticScene;
///
/// let stairs = SyntheticScene::stairs()?;
/// let recording = &stairs.scene.sectors[0].recording;
/// let playback = Playback::new(recording.trajectory.clone().unwrap(), recording.contacts.clone());
/// let [first_ns, last_ns] = playback.range_ns().unwrap();
/// let middle = playback.at(first_ns + (last_ns - first_ns) / 2).unwrap();
/// assert!(middle.velocity_in_world[0].is_finite());
/// assert!(playback.at(last_ns + 1).is_none());
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Playback {
    trajectory: Trajectory,
    contacts: Vec<FootContact>,
}

/// The wearer at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct WearerState {
    /// Pose of the rig.
    pub world_from_rig: RigidTransform,
    /// Velocity of the rig along the world's axes, m/s.
    pub velocity_in_world: [f64; 3],
    /// Contact of the left and of the right foot, from heel strike to toe off: its number in the
    /// contacts of the walk.
    pub contacts: [Option<usize>; 2],
}

impl Playback {
    /// Of a trajectory and the contacts of the walk by time.
    pub fn new(trajectory: Trajectory, contacts: Vec<FootContact>) -> Self {
        Self {
            trajectory,
            contacts,
        }
    }

    /// Of a recording; `None` without a trajectory.
    pub fn of(recording: &Recording) -> Option<Self> {
        let trajectory = recording.trajectory.clone()?;
        Some(Self::new(trajectory, recording.contacts.clone()))
    }

    /// Times of the first and the last pose, ns; `None` without poses.
    pub fn range_ns(&self) -> Option<[i64; 2]> {
        let poses = self.trajectory.poses();
        Some([poses.first()?.time_ns, poses.last()?.time_ns])
    }

    /// The contacts of the walk.
    pub fn contacts(&self) -> &[FootContact] {
        &self.contacts
    }

    /// The wearer at a time: positions on the straight line and rotations on the shortest arc
    /// between the poses before and after. `None` before the first, after the last, and where one
    /// of the two is lost.
    pub fn at(&self, time_ns: i64) -> Option<WearerState> {
        let (world_from_rig, recorded) = self.pose(time_ns)?;
        let velocity_in_world = recorded.or_else(|| self.measured_velocity(time_ns));
        Some(WearerState {
            world_from_rig,
            velocity_in_world: velocity_in_world.unwrap_or([0.0; 3]),
            contacts: [Foot::Left, Foot::Right].map(|foot| self.contact(foot, time_ns)),
        })
    }

    /// An agent where the wearer is: on the ground that is nearest to the height of the agent's
    /// eyes below the rig, with the heading of the rig's forward axis. `None` as [`Self::at`], and
    /// where there is no ground.
    pub fn state(&self, ground: &Ground, config: &AgentConfig, time_ns: i64) -> Option<AgentState> {
        let recorded = self.at(time_ns)?;
        let yaw_rad = yaw_rad(&recorded.world_from_rig);
        let [x, y, z] = recorded.world_from_rig.translation_m();
        let below_m = [x, y, z - config.eye_height_m];
        let mut state = AgentState::on_ground(ground, config, below_m, yaw_rad)?;
        let (sine, cosine) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
        let [x, y, _] = recorded.velocity_in_world;
        let turn = self.ends(time_ns).map_or(0.0, |([a, b], span_s)| {
            super::motion::wrap(self::yaw_rad(&b) - self::yaw_rad(&a)) / span_s
        });
        state.velocity = [x * cosine + y * sine, y * cosine - x * sine, turn];
        Some(state)
    }

    /// Where the rig was on the wearer: its pose on an agent that stands level below it, with the
    /// median height and tilt of the walk. `None` where no pose has ground below.
    pub fn body_from_rig(&self, ground: &Ground, config: &AgentConfig) -> Option<RigidTransform> {
        let mut columns: [Vec<f64>; 3] = Default::default();
        for pose in self.trajectory.usable() {
            let world_from_rig = &pose.world_from_rig;
            let [x, y, z] = world_from_rig.translation_m();
            let Some(surface) = ground.surface([x, y], z - config.eye_height_m) else {
                continue;
            };
            let [forward, left, up] = [0, 1, 2].map(|axis| {
                let mut unit = [0.0; 3];
                unit[axis] = 1.0;
                world_from_rig.rotate(unit)[2]
            });
            columns[0].push(z - surface.height_m);
            columns[1].push(-libm::asin(forward.clamp(-1.0, 1.0)));
            columns[2].push(libm::atan2(left, up));
        }
        let [height_m, pitch_rad, roll_rad] = columns.map(|mut values| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied()
        });
        let rotation = so3::from_yaw_pitch_roll(0.0, pitch_rad?, roll_rad?);
        let wxyz = [rotation.w, rotation.i, rotation.j, rotation.k];
        RigidTransform::from_wxyz(wxyz, [0.0, 0.0, height_m?]).ok()
    }

    /// Pose at a time, with the velocity where both neighbors have one.
    fn pose(&self, time_ns: i64) -> Option<(RigidTransform, Option<[f64; 3]>)> {
        let poses = self.trajectory.poses();
        let next = poses.partition_point(|pose| pose.time_ns <= time_ns);
        let before = &poses[next.checked_sub(1)?];
        let is_usable = |pose: &Pose| pose.status != Status::Lost;
        if before.time_ns == time_ns {
            let found = (before.world_from_rig, before.velocity_in_world);
            return is_usable(before).then_some(found);
        }
        let after = poses.get(next)?;
        if !(is_usable(before) && is_usable(after)) {
            return None;
        }
        let span = (after.time_ns - before.time_ns) as f64;
        let share = (time_ns - before.time_ns) as f64 / span;
        let (a, b) = (&before.world_from_rig, &after.world_from_rig);
        let turn = so3::log(&(a.rotation().inverse() * b.rotation()));
        let rotation = a.rotation() * so3::exp(turn * share);
        let mix = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|k| a[k] + share * (b[k] - a[k]));
        let position_m = mix(a.translation_m(), b.translation_m());
        let wxyz = [rotation.w, rotation.i, rotation.j, rotation.k];
        let pose = RigidTransform::from_wxyz(wxyz, position_m).ok()?;
        let velocity = before.velocity_in_world.zip(after.velocity_in_world);
        Some((pose, velocity.map(|(a, b)| mix(a, b))))
    }

    /// Poses a short time before and after, within the recording, and the time between, s.
    fn ends(&self, time_ns: i64) -> Option<([RigidTransform; 2], f64)> {
        let [first_ns, last_ns] = self.range_ns()?;
        let from_ns = (time_ns - VELOCITY_SPAN_NS).max(first_ns);
        let to_ns = (time_ns + VELOCITY_SPAN_NS).min(last_ns);
        let (from, _) = self.pose(from_ns)?;
        let (to, _) = self.pose(to_ns)?;
        (to_ns > from_ns).then(|| ([from, to], 1e-9 * (to_ns - from_ns) as f64))
    }

    fn measured_velocity(&self, time_ns: i64) -> Option<[f64; 3]> {
        let ([from, to], span_s) = self.ends(time_ns)?;
        let (a, b) = (from.translation_m(), to.translation_m());
        Some([0, 1, 2].map(|k| (b[k] - a[k]) / span_s))
    }

    /// Contact of a foot at a time: the last that began.
    fn contact(&self, foot: Foot, time_ns: i64) -> Option<usize> {
        let begun = |contact: &FootContact| contact.events[0].time_ns <= time_ns;
        let count = self.contacts.partition_point(begun);
        let last = self.contacts[..count]
            .iter()
            .rposition(|c| c.foot == foot)?;
        (time_ns < self.contacts[last].events[3].time_ns).then_some(last)
    }
}

/// Heading of the forward axis of a rig.
fn yaw_rad(world_from_rig: &RigidTransform) -> f64 {
    let [x, y, _] = world_from_rig.rotate([1.0, 0.0, 0.0]);
    libm::atan2(y, x)
}
