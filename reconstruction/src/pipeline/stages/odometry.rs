//! Stage `odometry`: causal poses, and the input of the bundle adjustment.
//!
//! Contract: a pose for every frame set of the session, in order of time, each computed from the
//! data before it only; sets that cannot be read are losses and are bridged by the IMU. Memory does
//! not grow with the session.

use ::odometry::{Config, ImuUse, Odometry, Status};
use cad_transforms::{Covariance, RigidTransform};
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::tracks::{Keypoint, StereoObservation, TrackedKeyframe, TracksWriter};
use scene_bundle::outputs::trajectory::TrajectoryWriter;
use scene_bundle::outputs::{RIG, TRACKS, TRAJECTORY_CAUSAL, TRAJECTORY_ODOM};
use scene_bundle::{Pose, outputs, trajectory};
use serde_json::{Value, json};

use super::frame_set_reader::FrameSetReader;
use super::keyframe_candidates::KeyframeCandidates;
use super::keyframe_spacing::KeyframeSpacing;
use super::preset::Preset;
use super::rig;
use crate::input::{HANDOFF, Input};
use crate::pipeline::{Stage, StageError, Work};

/// See the module.
pub(super) struct OdometryStage {
    pub(super) preset: Preset,
}

/// Configuration of odometry and mapping for a preset of the pipeline.
pub(super) fn config(preset: Preset) -> Config {
    Config::preset(match preset {
        Preset::Fast => ::odometry::Preset::Fast,
        Preset::Balanced => ::odometry::Preset::Balanced,
        Preset::Accurate => ::odometry::Preset::Accurate,
    })
}

impl Stage<Input> for OdometryStage {
    fn name(&self) -> &'static str {
        "odometry"
    }

    fn version(&self) -> u32 {
        19
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[HANDOFF, RIG]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[TRAJECTORY_CAUSAL, TRAJECTORY_ODOM, TRACKS]
    }

    fn settings(&self) -> Value {
        let Config {
            frontend,
            inertial,
            backend,
            estimator,
            .. // `mapping` does not change causal poses.
        } = config(self.preset);
        json!({
            "frontend": frontend,
            "inertial": inertial,
            "backend": backend,
            "estimator": estimator,
        })
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let model = outputs::rig::read(&work.read(RIG)?)?;
        if model.cameras.len() > outputs::tracks::MAX_CAMERAS {
            let found = model.cameras.len();
            let most = outputs::tracks::MAX_CAMERAS;
            return Err(format!("found {found} cameras, expected at most {most}").into());
        }
        let mut odometry = Odometry::new(&rig::odometry_rig(&model), config(self.preset));
        let mut poses = TrajectoryWriter::new(work.draft(TRAJECTORY_CAUSAL))?;
        let mut odom = TrajectoryWriter::new(work.draft(TRAJECTORY_ODOM))?;
        let mut tracks = TracksWriter::new(work.draft(TRACKS))?;
        for camera in &model.cameras {
            let index = work.source().index().camera(&camera.name);
            if let Some(undecodable) = index.map(|i| i.undecodable).filter(|count| *count > 0) {
                work.record_loss(format!(
                    "{undecodable} frames of {} have no key frame",
                    camera.name
                ));
            }
        }
        let frame_set_reader = FrameSetReader::new(work.source(), &model)?;
        let all = frame_set_reader.len() as u64;
        let (mut reckoned, mut lost) = (0_u64, 0_u64);
        let keyframe_spacing = KeyframeSpacing::preset(self.preset);
        let mut candidates = KeyframeCandidates::new(model.cameras.len(), keyframe_spacing);
        let session = work.source().session();
        for (done, set) in frame_set_reader.enumerate() {
            for loss in &set.losses {
                work.record_loss_from(loss);
            }
            for (imu, samples) in set.imu.iter().enumerate() {
                for sample in samples {
                    odometry.add_imu(imu, sample);
                }
            }
            let estimate = odometry.add_frames(&set.borrowed());
            match estimate.status {
                Status::Tracked => {}
                Status::DeadReckoned => reckoned += 1,
                Status::Lost => lost += 1,
            }
            let pose = pose(&estimate);
            poses.push(&pose)?;
            odom.push(&odom_pose(&estimate))?;
            let kept = candidates.push(pose, set.timed_frames());
            kept.iter().for_each(|frame| session.keep(frame));
            for keyframe in odometry.take_keyframes(false) {
                tracks.push(&to_tracked(&keyframe))?;
            }
            work.progress(done as u64 + 1, all);
        }
        let kept = candidates.finish();
        kept.iter().for_each(|frame| session.keep(frame));
        for keyframe in odometry.take_keyframes(true) {
            tracks.push(&to_tracked(&keyframe))?;
        }
        imu_notes(odometry.imu_uses(), &model).for_each(|note| work.note(note));
        if reckoned > 0 {
            work.note(format!("{reckoned} of {all} poses are dead reckoned"));
        }
        if lost > 0 {
            work.record_loss(format!("{lost} of {all} poses are lost"));
        }
        for shift in odometry.camera_shifts() {
            work.record_loss(format!(
                "camera {} seems to have rotated by {:.1} degrees on its plate at {} ns",
                model.cameras[shift.camera].name,
                shift.rotation_rad.to_degrees(),
                shift.time_ns
            ));
        }
        poses.finish()?;
        odom.finish()?;
        tracks.finish()?;
        Ok(())
    }
}

/// Which IMU was used when, if not the first one of the rig throughout.
fn imu_notes<'a>(uses: &'a [ImuUse], model: &'a RigModel) -> impl Iterator<Item = String> + 'a {
    let is_first_throughout = matches!(uses, [] | [ImuUse { imu: 0, .. }]);
    let uses = uses.iter().filter(move |_| !is_first_throughout);
    uses.enumerate().map(move |(k, used)| {
        let (name, time_ns) = (&model.imus[used.imu].name, used.time_ns);
        match k {
            0 => format!("IMU {name} is used at the start, at {time_ns} ns"),
            _ => format!("IMU {name} is used from {time_ns} ns on: the one before was silent"),
        }
    })
}

fn pose(estimate: &::odometry::Estimate) -> Pose {
    Pose {
        covariance: covariance(&estimate.covariance),
        velocity_in_world: Some(estimate.velocity.into()),
        status: status(estimate),
        ..Pose::new(estimate.time_ns, estimate.world_from_rig)
    }
}

/// The pose in the odom frame, with its covariance relative to the keyframe before it.
fn odom_pose(estimate: &::odometry::Estimate) -> Pose {
    Pose {
        covariance: covariance(&estimate.relative_covariance),
        status: status(estimate),
        ..Pose::new(estimate.time_ns, estimate.odom_from_rig)
    }
}

fn status(estimate: &::odometry::Estimate) -> trajectory::Status {
    match estimate.status {
        Status::Tracked => trajectory::Status::Tracked,
        Status::DeadReckoned => trajectory::Status::DeadReckoned,
        Status::Lost => trajectory::Status::Lost,
    }
}

/// As stored in files; `None` if rounding makes it invalid.
pub(super) fn covariance(matrix: &nalgebra::Matrix6<f64>) -> Option<Covariance> {
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)]));
    Covariance::from_rows(rows).ok()
}

fn to_tracked(keyframe: &::odometry::Keyframe) -> TrackedKeyframe {
    let state = &keyframe.state;
    let q = state.rotation;
    let world_from_body = RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], state.position.into())
        .expect("the state of a keyframe is a pose");
    TrackedKeyframe {
        set: keyframe.number,
        time_ns: state.time_ns,
        world_from_body,
        velocity: state.velocity.into(),
        gyro_bias: state.gyro_bias.into(),
        accel_bias: state.accel_bias.into(),
        gyro_rate: state.gyro_rate.into(),
        imu_valid: keyframe.imu_valid,
        exposure_offset_s: keyframe.exposure_offset_s.clone(),
        stereo_errors: keyframe.stereo_errors.clone(),
        extrinsics_errors: keyframe.extrinsics_errors.clone(),
        observations: (keyframe.observations.iter())
            .map(|s| StereoObservation {
                track: s.id,
                camera: s.camera,
                left_px: s.left,
                right_px: s.right,
            })
            .collect(),
        keypoints: (keyframe.keypoints.iter())
            .map(|m| Keypoint {
                camera: m.camera,
                left_px: m.left,
                inverse_range: m.rho,
                descriptor: m.descriptor,
            })
            .collect(),
    }
}

/// As the odometry had it.
pub(super) fn from_tracked(keyframe: TrackedKeyframe) -> ::odometry::Keyframe {
    ::odometry::Keyframe {
        number: keyframe.set,
        state: ::odometry::keyframe::BodyState {
            time_ns: keyframe.time_ns,
            position: *keyframe.world_from_body.translation(),
            rotation: *keyframe.world_from_body.rotation(),
            velocity: keyframe.velocity.into(),
            gyro_bias: keyframe.gyro_bias.into(),
            accel_bias: keyframe.accel_bias.into(),
            gyro_rate: keyframe.gyro_rate.into(),
        },
        imu_valid: keyframe.imu_valid,
        exposure_offset_s: keyframe.exposure_offset_s,
        stereo_errors: keyframe.stereo_errors,
        extrinsics_errors: keyframe.extrinsics_errors,
        observations: (keyframe.observations.iter())
            .map(|s| ::odometry::keyframe::StereoObservation {
                id: s.track,
                camera: s.camera,
                left: s.left_px,
                right: s.right_px,
            })
            .collect(),
        keypoints: (keyframe.keypoints.iter())
            .map(|m| ::odometry::keyframe::Keypoint {
                camera: m.camera,
                left: m.left_px,
                rho: m.inverse_range,
                descriptor: m.descriptor,
            })
            .collect(),
    }
}
