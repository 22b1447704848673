//! Stage `bundle-adjustment`: poses from the whole recording.
//!
//! Contract: one pose for each pose of the causal trajectory, at the same time. Its status is that
//! of odometry, except that poses tracked after a loss are *relocalised* if a loop closure with a
//! place from before the loss connects them to the rest. Unconnected poses keep the covariance of
//! their causal pose. Camera extrinsics are refined; a camera far from its nominal pose was moved,
//! which is reported. A stereo calibration that the walk contradicts is reported and replaced. If
//! the adjustment does not converge, which is reported too, all poses keep their causal covariance
//! and cameras their nominal extrinsics. Images are not read again.

use ::odometry::mapping::{
    Connectivity, OdomPose, Progress, RefinedExtrinsics, RefinedStereo, interpolate_poses,
};
use ::odometry::{ImuSample, Mapping, MappingResult};
use cad_transforms::{Covariance, RigidTransform};
use nalgebra::SMatrix;
use scene_bundle::outputs::rig::{RigCamera, RigImu, RigModel};
use scene_bundle::outputs::trajectory::TrajectoryWriter;
use scene_bundle::outputs::{
    self, RIG, RIG_REFINED, TRACKS, TRAJECTORY, TRAJECTORY_CAUSAL, TRAJECTORY_ODOM,
};
use scene_bundle::{Pose, Status, Trajectory};
use serde_json::{Value, json};
use session_input::imu::sort_by_time;

use super::preset::Preset;
use super::{odometry as before, rig};
use crate::input::{HANDOFF, Input};
use crate::pipeline::{Stage, StageError, Work};

/// See the module.
pub(super) struct BundleAdjustmentStage {
    pub(super) preset: Preset,
}

impl Stage<Input> for BundleAdjustmentStage {
    fn name(&self) -> &'static str {
        "bundle-adjustment"
    }

    fn version(&self) -> u32 {
        16
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[HANDOFF, RIG, TRAJECTORY_CAUSAL, TRAJECTORY_ODOM, TRACKS]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[TRAJECTORY, RIG_REFINED]
    }

    fn settings(&self) -> Value {
        json!(before::config(self.preset))
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let model = outputs::rig::read(&work.read(RIG)?)?;
        let causal = outputs::trajectory::read(&work.read(TRAJECTORY_CAUSAL)?)?;
        let odom = outputs::trajectory::read(&work.read(TRAJECTORY_ODOM)?)?;
        let keyframes = outputs::tracks::read(&work.read(TRACKS)?, model.cameras.len())?;
        let mut mapping = Mapping::new(&rig::odometry_rig(&model), &before::config(self.preset));
        let samples = imu_samples(work, &model)?;
        let mut given = vec![0; samples.len()];
        for keyframe in keyframes {
            for (imu, (samples, given)) in samples.iter().zip(&mut given).enumerate() {
                // Up to one sample later, so that the motion is known up to the keyframe.
                let later = samples.partition_point(|s| s.time_ns < keyframe.time_ns);
                let to = (later + 1).min(samples.len()).max(*given);
                for sample in &samples[*given..to] {
                    mapping.add_imu(imu, sample);
                }
                *given = to;
            }
            mapping.add_keyframe(before::from_tracked(keyframe));
        }
        let adjusted = mapping.optimize(|progress| match progress {
            Progress::Linearized {
                iterations,
                max_iterations,
            } => work.progress(iterations as u64, max_iterations as u64),
            Progress::SearchingLoops { done, all } => work.progress(done as u64, all as u64),
        });
        work.note(format!(
            "{} keyframes, {} landmarks, {} loop closures",
            adjusted.poses.len(),
            adjusted.landmarks,
            adjusted.loop_closures.len()
        ));
        let rig = if adjusted.is_converged {
            let (rig, findings) = refined_rig(model, &adjusted.extrinsics, &adjusted.stereo);
            for finding in findings {
                match finding {
                    Finding::Loss(text) => work.record_loss(text),
                    Finding::Note(text) => work.note(text),
                }
            }
            rig
        } else {
            work.record_loss(format!(
                "after {} iterations poses still changed: they keep the covariance of causal ones, and cameras keep their calibrated extrinsics",
                adjusted.iterations
            ));
            model
        };
        outputs::rig::write(work.draft(RIG_REFINED), &rig)?;
        let mut writer = TrajectoryWriter::new(work.draft(TRAJECTORY))?;
        for pose in &refined_poses(&causal, &odom, &adjusted) {
            writer.push(pose)?;
        }
        writer.finish()?;
        Ok(())
    }
}

/// What the estimate of a camera means.
#[derive(Debug, PartialEq)]
enum Finding {
    /// Its calibration is wrong.
    Loss(String),
    /// It agrees with its calibration.
    Note(String),
}

/// The rig with refined camera extrinsics, and where they are significant with refined right lenses
/// and extrinsics of right eyes. A right eye that agrees with its calibration keeps it.
fn refined_rig(
    mut rig: RigModel,
    extrinsics: &[RefinedExtrinsics],
    stereo: &[RefinedStereo],
) -> (RigModel, Vec<Finding>) {
    let mut findings = Vec::new();
    for (camera, extrinsics) in rig.cameras.iter_mut().zip(extrinsics) {
        let name = &camera.name;
        let deviation = format!(
            "{:.1} mm and {:.2} degrees from its calibrated pose",
            1e3 * extrinsics.initial_error[0],
            extrinsics.initial_error[1].to_degrees()
        );
        findings.push(if extrinsics.is_moved {
            Finding::Loss(format!(
                "camera {name} is {deviation}: it was moved since, or the calibration is another rig's; poses and depth use the refined extrinsics"
            ))
        } else {
            Finding::Note(format!("camera {name} is estimated {deviation}"))
        });
        camera.rig_from_left = extrinsics.rig_from_left;
        camera.rig_from_left_covariance = before::covariance(&extrinsics.covariance);
    }
    for (camera, stereo) in rig.cameras.iter_mut().zip(stereo) {
        let (name, error) = (&camera.name, stereo_error(camera, stereo));
        if !stereo.is_significant {
            findings.push(Finding::Note(format!(
                "camera {name}: the right eye agrees with its calibration: {error}"
            )));
            continue;
        }
        findings.push(Finding::Loss(format!(
            "camera {name}: the calibration of the right eye is wrong: {error}; poses and depth use the estimate, a new calibration mends it"
        )));
        (camera.right, camera.right_from_left) =
            stereo.corrected(&camera.right, &camera.right_from_left);
        camera.right_from_left_covariance = stereo_covariance(stereo, &camera.right_from_left);
    }
    (rig, findings)
}

/// Covariance of estimated extrinsics between the eyes, of a small motion of the left optical frame
/// in its own axes.
///
/// The estimate is a rotation of the right eye about its own origin and the length of the baseline;
/// the direction of the baseline, which acts as such a rotation, has no component of its own. The
/// left eye thus moves across the baseline only with the rotation.
fn stereo_covariance(
    stereo: &RefinedStereo,
    right_from_left: &RigidTransform,
) -> Option<Covariance> {
    let left_from_right = right_from_left.rotation().inverse().to_rotation_matrix();
    let baseline = right_from_left.translation();
    let lever_arm = -baseline.cross_matrix();
    let mut by_error = SMatrix::<f64, 6, 4>::zeros();
    by_error
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&(left_from_right * lever_arm));
    by_error
        .fixed_view_mut::<3, 1>(0, 3)
        .copy_from(&(left_from_right * baseline));
    by_error
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(left_from_right.matrix());
    let of_error = stereo.covariance.fixed_view::<4, 4>(0, 0);
    let covariance = by_error * of_error * by_error.transpose();
    before::covariance(&(0.5 * (covariance + covariance.transpose())))
}

/// Estimated error of a stereo calibration with its sigmas, for people.
fn stereo_error(camera: &RigCamera, stereo: &RefinedStereo) -> String {
    let (error, sigmas) = (stereo.error, stereo.sigmas());
    let each = |k: usize, unit: f64| format!("{:.2} ± {:.2}", unit * error[k], unit * sigmas[k]);
    let degrees = 1.0_f64.to_degrees();
    format!(
        "rotation {}, {}, {} degrees about x, y, z, baseline {} %, focal length {} %, principal point {} px, decentering across epipolar lines {}e-3",
        each(0, degrees),
        each(1, degrees),
        each(2, degrees),
        each(3, 100.0),
        each(4, 100.0),
        each(5, camera.right.fx),
        each(6, 1e3),
    )
}

/// Every pose of the causal trajectory, as refined by the bundle adjustment. `odom` are the poses
/// of the same frame sets in the odom frame.
fn refined_poses(causal: &Trajectory, odom: &Trajectory, adjusted: &MappingResult) -> Vec<Pose> {
    let odom: Vec<OdomPose> = odom.poses().iter().map(odom_pose).collect();
    let lost: Vec<(i64, bool)> = (causal.poses().iter())
        .map(|p| (p.time_ns, p.status == Status::Lost))
        .collect();
    let interpolated = interpolate_poses(&odom, &adjusted.poses);
    let connectivity = adjusted.connectivity(&lost);
    let poses = causal.poses().iter().zip(interpolated).zip(connectivity);
    poses
        .map(|((pose, interpolated), connectivity)| {
            let covariance = match connectivity {
                Connectivity::Unconstrained => pose.covariance,
                Connectivity::Continuous | Connectivity::LoopClosed => {
                    before::covariance(&interpolated.covariance)
                }
            };
            let status = match (pose.status, connectivity) {
                (Status::Tracked, Connectivity::LoopClosed) => Status::Relocalised,
                (status, _) => status,
            };
            Pose {
                covariance,
                world_from_rig: interpolated.world_from_rig,
                status,
                ..*pose
            }
        })
        .collect()
}

fn odom_pose(pose: &Pose) -> OdomPose {
    OdomPose {
        time_ns: pose.time_ns,
        odom_from_rig: pose.world_from_rig,
        // Without one, the motion is not known.
        relative_covariance: (pose.covariance)
            .map_or_else(nalgebra::Matrix6::identity, |covariance| {
                *covariance.matrix()
            }),
    }
}

/// The samples of each IMU of the rig in order of time.
fn imu_samples(
    work: &Work<'_, Input>,
    model: &RigModel,
) -> Result<Vec<Vec<ImuSample>>, StageError> {
    let of_imu = |imu: &RigImu| -> Result<Vec<ImuSample>, StageError> {
        let mut samples = Vec::new();
        for batch in work.source().session().imu_batches(&imu.name)? {
            match batch {
                Ok(batch) => samples.extend(batch),
                Err(loss) => work.record_loss_from(&loss),
            }
        }
        // As in the odometry: batches may overlap where a clock map was replaced.
        sort_by_time(&mut samples);
        Ok(samples.iter().map(ImuSample::from).collect())
    };
    model.imus.iter().map(of_imu).collect()
}

#[cfg(test)]
mod tests {
    use camera_models::{CameraModel, Distortion};
    use nalgebra::{Matrix6, SVector, Vector3};

    use super::*;

    fn estimate(error: [f64; 7], covariance: SMatrix<f64, 7, 7>) -> RefinedStereo {
        RefinedStereo {
            error,
            covariance,
            is_significant: true,
        }
    }

    /// A camera that was moved by 2 degrees, with a right eye rotated by 0.2 degrees.
    #[test]
    fn wrong_calibrations_are_losses_and_are_replaced() {
        let lens = CameraModel::new((672, 376), [350.0, 350.0, 335.5, 187.5], Distortion::None);
        let camera = RigCamera {
            name: "feet".to_owned(),
            left: lens,
            right: lens,
            rig_from_left: RigidTransform::identity(),
            rig_from_left_covariance: None,
            right_from_left: RigidTransform::from_translation_m([-0.06, 0.0, 0.0]).unwrap(),
            right_from_left_covariance: None,
            line_s: 0.0,
        };
        let rig = RigModel {
            name: "chest".to_owned(),
            revision: "1".to_owned(),
            cameras: vec![camera],
            imus: Vec::new(),
            shoes: Vec::new(),
        };
        let rotation = |angle_deg: f64| {
            RigidTransform::from_rotation_vector([0.0, angle_deg.to_radians(), 0.0], [0.0; 3])
        };
        let found = |is_wrong: bool| {
            let extrinsics = RefinedExtrinsics {
                rig_from_left: rotation(2.0).unwrap(),
                covariance: Matrix6::identity() * 1e-8,
                initial_error: [0.0, 2.0_f64.to_radians()],
                is_moved: is_wrong,
            };
            let mut error = [0.0; 7];
            error[1] = 0.2_f64.to_radians();
            let stereo = RefinedStereo {
                is_significant: is_wrong,
                ..estimate(error, SMatrix::identity() * 1e-8)
            };
            refined_rig(rig.clone(), &[extrinsics], &[stereo])
        };
        let (refined, findings) = found(true);
        let [Finding::Loss(moved), Finding::Loss(eye)] = &findings[..] else {
            panic!("{findings:?}");
        };
        assert!(
            moved.contains("2.00 degrees from its calibrated pose"),
            "{moved}"
        );
        assert!(
            eye.contains("right eye is wrong: rotation 0.00 ± 0.01, 0.20 ± 0.01"),
            "{eye}"
        );
        let camera = &refined.cameras[0];
        assert_eq!(camera.rig_from_left, rotation(2.0).unwrap());
        let right = rotation(0.2).unwrap() * rig.cameras[0].right_from_left;
        let rest = camera.right_from_left.inverse() * right;
        assert!(
            rest.rotation_vector()
                .iter()
                .chain(&rest.translation_m())
                .all(|v| v.abs() < 1e-12)
        );
        assert!(camera.right_from_left_covariance.is_some());
        let (refined, findings) = found(false);
        assert!(
            findings
                .iter()
                .all(|finding| matches!(finding, Finding::Note(_)))
        );
        assert_eq!(
            refined.cameras[0].right_from_left,
            rig.cameras[0].right_from_left
        );
    }

    /// The covariance of one direction of the error is that of the motion that it causes.
    #[test]
    fn stereo_covariance_is_that_of_motions_of_the_left_eye() {
        let lens = CameraModel::new((672, 376), [350.0, 350.0, 335.5, 187.5], Distortion::None);
        let nominal =
            RigidTransform::from_rotation_vector([0.02, -0.5, 0.1], [-0.06, 0.004, -0.01]).unwrap();
        let extrinsics = |error| {
            let estimate = estimate(error, SMatrix::zeros());
            estimate.corrected(&lens, &nominal).1
        };
        // The Jacobian, as that of the estimator, is of a small rotation.
        let error = [2e-5, -1e-5, 3e-5, 0.02, -0.01, 0.004, 0.0];
        let right_from_left = extrinsics(error);
        for direction in [
            [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            [0.6, -0.3, 0.8, 2.0, 1.0, -1.0, 3.0],
        ] {
            let step = 1e-5;
            let error: [f64; 7] = std::array::from_fn(|k| error[k] + step * direction[k]);
            // `right_from_left * motion` is the extrinsics with the other error.
            let motion = right_from_left.inverse() * extrinsics(error);
            let motion = [motion.translation_m(), motion.rotation_vector()].concat();
            let direction = SVector::from(direction);
            let covariance = direction * direction.transpose();
            let covariance = stereo_covariance(&estimate(error, covariance), &right_from_left);
            let covariance = covariance.expect("it is one");
            for (i, j) in (0..6).flat_map(|i| (0..6).map(move |j| (i, j))) {
                let expected = motion[i] * motion[j] / (step * step);
                let found = covariance.matrix()[(i, j)];
                assert!((found - expected).abs() < 1e-4, "{found} {expected}");
            }
        }
    }

    /// Odometry reads the sigmas of rotation and baseline that the bundle adjustment has found.
    #[test]
    fn stereo_covariance_states_the_sigmas_of_rotation_and_baseline() {
        let sigmas = [1e-4, 3e-4, 2e-4, 2e-3, 1e-3, 1e-3, 5e-3];
        let covariance = SMatrix::from_diagonal(&SVector::from(sigmas.map(|s: f64| s * s)));
        let right_from_left = RigidTransform::from_translation_m([-0.06, 0.002, 0.001]).unwrap();
        let covariance_of_left =
            stereo_covariance(&estimate([0.0; 7], covariance), &right_from_left);
        let covariance_of_left = covariance_of_left.expect("it is one");
        for (k, sigma) in sigmas.iter().enumerate().take(3) {
            assert!((covariance_of_left.sigmas()[3 + k] - sigma).abs() < 1e-12);
        }
        let baseline = Vector3::from(right_from_left.inverse().translation_m());
        let along = baseline.normalize();
        let translation = covariance_of_left.matrix().fixed_view::<3, 3>(0, 0);
        let variance = (along.transpose() * translation * along)[0];
        assert!((variance.sqrt() / baseline.norm() - sigmas[3]).abs() < 1e-12);
    }
}
