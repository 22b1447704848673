//! Stage `mapping`: poses with everything known.
//!
//! Contract: one pose for each pose of the causal trajectory, at the same time; its status stays that of odometry, but for a
//! span without sight between keyframes that the adjustment holds on both sides. Pictures are not read again.

use ::odometry::mapping::{Progress, between};
use ::odometry::{ImuSample, Mapping};
use cad_transforms::RigidTransform;
use scene_bundle::outputs::trajectory::TrajectoryWriter;
use scene_bundle::outputs::{self, RIG, TRACKS, TRAJECTORY, TRAJECTORY_CAUSAL};
use scene_bundle::{Pose, Trajectory};
use serde_json::Value;

use super::{HANDOFF, Preset, odometry as before, rig};
use crate::input::Input;
use crate::pipeline::{Stage, StageError, Work};

/// See the module.
pub(super) struct MappingStage {
    pub(super) preset: Preset,
}

impl Stage<Input> for MappingStage {
    fn name(&self) -> &'static str {
        "mapping"
    }

    fn version(&self) -> u32 {
        1
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[HANDOFF, RIG, TRAJECTORY_CAUSAL, TRACKS]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[TRAJECTORY]
    }

    fn settings(&self) -> Value {
        before::told(&before::settings(self.preset))
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let model = outputs::rig::read(&work.read(RIG)?)?;
        let causal = outputs::trajectory::read(&work.read(TRAJECTORY_CAUSAL)?)?;
        let keyframes = outputs::tracks::read(&work.read(TRACKS)?, model.cameras.len())?;
        let mut mapping = Mapping::new(&rig::of_odometry(&model), &before::settings(self.preset));
        let mut samples = Vec::new();
        if let Some(imu) = model.imus.first() {
            for batch in work.source().imu_batches(&imu.name)? {
                match batch {
                    Ok(batch) => samples.extend(batch.iter().map(|s| ImuSample {
                        time_ns: s.time.ns(),
                        gyro: s.gyro,
                        accel: s.accel,
                    })),
                    Err(loss) => work.lose(loss.to_string()),
                }
            }
        }
        let mut given = 0;
        for keyframe in keyframes {
            // Up to one sample later, so that motion is known to the keyframe.
            let to = samples.partition_point(|s| s.time_ns < keyframe.time_ns) + 1;
            for sample in &samples[given.min(samples.len())..to.min(samples.len())] {
                mapping.add_imu(0, sample);
            }
            given = given.max(to);
            mapping.add_keyframe(before::read(keyframe));
        }
        let adjusted = mapping.solve(|progress| match progress {
            Progress::Adjusted { rounds, most } => work.progress(rounds as u64, most as u64),
            Progress::Looked { done, all } => work.progress(done as u64, all as u64),
        });
        work.note(format!(
            "{} keyframes, {} landmarks, {} places seen again",
            adjusted.poses.len(),
            adjusted.landmarks,
            adjusted.loops.len()
        ));
        let poses = finished(&causal, &adjusted);
        let mut writer = TrajectoryWriter::new(work.draft(TRAJECTORY))?;
        for pose in &poses {
            writer.push(pose)?;
        }
        writer.finish()?;
        Ok(())
    }
}

/// Every pose of the causal trajectory where the adjustment puts it.
fn finished(causal: &Trajectory, adjusted: &::odometry::Adjusted) -> Vec<Pose> {
    let times: Vec<(i64, RigidTransform)> = (causal.poses().iter())
        .map(|p| (p.time_ns, p.world_from_rig))
        .collect();
    let keys: Vec<(i64, RigidTransform)> = (adjusted.poses.iter())
        .map(|p| (p.time_ns, p.world_from_rig))
        .collect();
    let moved = between(&times, &keys);
    let poses = causal.poses().iter().zip(moved);
    poses
        .map(|(pose, world_from_rig)| {
            // The keyframe at or before it: certainty changes slowly.
            let next = adjusted
                .poses
                .partition_point(|p| p.time_ns <= pose.time_ns);
            let key = adjusted.poses.get(next.saturating_sub(1));
            Pose {
                covariance: key.and_then(|k| before::covariance(&k.covariance)),
                world_from_rig,
                ..*pose
            }
        })
        .collect()
}
