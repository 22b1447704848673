//! Synthetic walk of two laps in a ring of points, with drifting poses: bundle adjustment recovers
//! the ground truth, and the second lap closes loops with the first.

use camera_models::{CameraModel, Distortion};
use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::config::Preset;
use crate::keyframe::{BodyState, Keypoint, StereoObservation};
use crate::rig::StereoCamera;

fn rig() -> Rig {
    let model = CameraModel {
        width: 672,
        height: 376,
        fx: 350.0,
        fy: 350.0,
        cx: 335.5,
        cy: 187.5,
        distortion: Distortion::None,
    };
    // Facing outward: optical z along the y axis of the rig, optical x along its x axis.
    let rows = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0];
    Rig {
        cameras: vec![StereoCamera {
            name: "side".to_owned(),
            left: model,
            right: model,
            rig_from_left: RigidTransform::from_rotation_rows(rows, [0.0, 0.1, 0.05]).unwrap(),
            covariance: None,
            right_from_left: RigidTransform::from_translation_m([-0.06, 0.0, 0.0]).unwrap(),
            right_from_left_covariance: None,
            line_s: 0.0,
        }],
        imus: Vec::new(),
    }
}

const STEPS: usize = 60;
const PATH_RADIUS_M: f64 = 2.0;

/// On a circle about the center of the ring, which is to its right, so that the camera faces
/// outward; with sway.
fn truth(k: usize) -> (UnitQuaternion<f64>, Vector3<f64>) {
    let angle = -(k as f64) * std::f64::consts::TAU / STEPS as f64;
    let sway = Vector3::new(0.15 * (4.0 * angle).sin(), 0.1 * (6.0 * angle).sin(), 0.0);
    let heading = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, angle));
    let rotation = heading * UnitQuaternion::from_scaled_axis(sway);
    (
        rotation,
        heading * Vector3::new(0.0, PATH_RADIUS_M, 0.0) - Vector3::new(0.0, PATH_RADIUS_M, 0.0),
    )
}

/// Points all around, each with its own descriptor.
fn points() -> Vec<(Vector3<f64>, [u64; 4])> {
    let mut state = 7_u64;
    let mut draw = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    (0..900)
        .map(|_| {
            let angle = draw() as f64 / u64::MAX as f64 * std::f64::consts::TAU;
            let far = PATH_RADIUS_M + 1.5 + 2.5 * (draw() as f64 / u64::MAX as f64);
            let up = 1.6 * (draw() as f64 / u64::MAX as f64) - 0.7;
            let x = Vector3::new(far * angle.sin(), far * angle.cos() - PATH_RADIUS_M, up);
            (x, [draw(), draw(), draw(), draw()])
        })
        .collect()
}

/// Keyframes of `laps` laps with drifting poses.
fn keyframes(laps: usize, drift_m: f64, with_keypoints: bool) -> Vec<Keyframe> {
    keyframes_of(&rig(), laps, drift_m, with_keypoints)
}

fn keyframes_of(rig: &Rig, laps: usize, drift_m: f64, with_keypoints: bool) -> Vec<Keyframe> {
    let (cameras, _) = body_frame(rig);
    let points = points();
    let count = laps * STEPS;
    // A point that left the view gets a new track id.
    let mut ids: Vec<Option<u64>> = vec![None; cameras.len() * points.len()];
    let mut next = 0;
    (0..count)
        .map(|k| {
            let (rotation, position) = truth(k);
            let mut observations = Vec::new();
            let mut keypoints = Vec::new();
            let each = cameras.iter().enumerate();
            let both = each.flat_map(|camera| points.iter().map(move |point| (camera, point)));
            for (n, ((index, camera), (x, descriptor))) in both.enumerate() {
                let in_body = rotation.inverse() * (x - position);
                let (body_from_left, arm) = &camera.body_from_left;
                let in_left = body_from_left.transpose() * (in_body - arm);
                let pixel = camera.left.project(in_left.into()).filter(|p| {
                    in_left.z > 0.3 && (1.0..671.0).contains(&p[0]) && (1.0..375.0).contains(&p[1])
                });
                let Some(left) = pixel else {
                    ids[n] = None;
                    continue;
                };
                let (right_rotation, origin) = &camera.right_from_left;
                let right = camera
                    .right
                    .project((right_rotation * in_left + origin).into());
                let id = *ids[n].get_or_insert_with(|| {
                    next += 1;
                    next
                });
                let left = left.map(|v| v as f32);
                observations.push(StereoObservation {
                    id,
                    camera: index as u8,
                    left,
                    right: right.map(|r| r.map(|v| v as f32)),
                });
                if with_keypoints {
                    keypoints.push(Keypoint {
                        camera: index as u8,
                        left,
                        rho: (1.0 / in_left.norm()) as f32,
                        descriptor: *descriptor,
                    });
                }
            }
            let laps_done = k as f64 / STEPS as f64;
            let drift = Vector3::new(
                drift_m * laps_done,
                -0.5 * drift_m * laps_done,
                0.2 * drift_m * laps_done,
            );
            Keyframe {
                number: k as u64 + 1,
                state: BodyState {
                    time_ns: k as i64 * 400_000_000,
                    position: position + drift,
                    rotation,
                    velocity: Vector3::zeros(),
                    gyro_bias: Vector3::zeros(),
                    accel_bias: Vector3::zeros(),
                    gyro_rate: Vector3::zeros(),
                },
                imu_valid: false,
                stereo_errors: vec![[0.0; 7]],
                extrinsics_errors: vec![[0.0; 6]],
                exposure_offset_s: vec![0.0; cameras.len()],
                observations,
                keypoints,
            }
        })
        .collect()
}

fn solved(keyframes: Vec<Keyframe>) -> MappingResult {
    solved_on(&rig(), keyframes)
}

fn solved_on(rig: &Rig, keyframes: Vec<Keyframe>) -> MappingResult {
    let mut mapping = Mapping::new(rig, &Config::preset(Preset::Balanced));
    for keyframe in keyframes {
        mapping.add_keyframe(keyframe);
    }
    mapping.optimize(|_| {})
}

fn farthest(refined: &MappingResult) -> f64 {
    let initial_error = |pose: &RefinedPose| {
        let (_, position) = truth(pose.number as usize - 1);
        (Vector3::from(pose.world_from_rig.translation_m()) - position).norm()
    };
    refined.poses.iter().map(initial_error).fold(0.0, f64::max)
}

#[test]
fn drifted_lap_is_corrected() {
    let refined = solved(keyframes(1, 0.3, false));
    assert_eq!(refined.poses.len(), STEPS);
    assert!(refined.loop_closures.is_empty());
    // Pixels have single precision: about 1e-5 px, over sixty keyframes.
    assert!(farthest(&refined) < 1e-3, "{}", farthest(&refined));
}

#[test]
fn second_lap_closes_loops_with_the_first() {
    let frames = keyframes(2, 0.15, true);
    let refined = solved(frames.clone());
    assert!(
        refined.loop_closures.len() > 10,
        "{}",
        refined.loop_closures.len()
    );
    for found in &refined.loop_closures {
        let [a, b] = found.frames.map(|n| n as usize - 1);
        // The same place is one lap apart, up to the overlap of the views.
        assert!((b - a).abs_diff(STEPS) < 12, "{found:?}");
    }
    assert!(farthest(&refined) < 5e-3, "{}", farthest(&refined));
    // With a loop closure the end is nearly as certain as the start.
    let spread = |a: &MappingResult| {
        a.poses
            .last()
            .unwrap()
            .covariance
            .fixed_view::<3, 3>(0, 0)
            .trace()
    };
    let mut without = frames;
    for keyframe in &mut without {
        keyframe.keypoints.clear();
    }
    assert!(spread(&refined) < spread(&solved(without)));
}

#[test]
fn perceptual_aliasing_gives_no_loop_closure() {
    // The second lap is one floor higher, reached without observations: drift does not explain
    // that.
    let mut frames = keyframes(2, 0.0, true);
    for keyframe in &mut frames[STEPS..] {
        keyframe.state.position.z += 3.0;
        keyframe.state.time_ns += 20_000_000_000;
        for observation in &mut keyframe.observations {
            observation.id += 1_000_000;
        }
    }
    let refined = solved(frames);
    // The remaining closures are between the end and the start of the same lap.
    let across = |l: &&LoopClosure| (l.frames[0] <= STEPS as u64) != (l.frames[1] <= STEPS as u64);
    assert_eq!(refined.loop_closures.iter().filter(across).count(), 0);
}

#[test]
fn moved_camera_is_corrected_and_reported() {
    let mut rig = rig();
    let sure = nalgebra::Vector6::from_element(1e-8);
    rig.cameras[0].covariance = Some(Matrix6::from_diagonal(&sure));
    let mut second = rig.cameras[0].clone();
    let aside = RigidTransform::from_rotation_vector([0.0, 0.5, 0.1], [0.1, 0.05, -0.1]).unwrap();
    second.rig_from_left = second.rig_from_left * aside;
    second.covariance = None;
    rig.cameras.push(second);
    let frames = keyframes_of(&rig, 1, 0.1, false);
    let right = solved_on(&rig, frames.clone());
    assert!(
        right.extrinsics.iter().all(|m| !m.is_moved),
        "{:?}",
        right.extrinsics
    );
    assert!(
        right
            .extrinsics
            .iter()
            .all(|m| m.initial_error[0] < 1e-4 && m.initial_error[1] < 1e-5)
    );
    // Nominal extrinsics with an error of two degrees.
    let mut nominal = rig.clone();
    let initial_error =
        RigidTransform::from_rotation_vector([0.02, -0.024, 0.016], [0.0; 3]).unwrap();
    nominal.cameras[1].rig_from_left = nominal.cameras[1].rig_from_left * initial_error;
    let found = solved_on(&nominal, frames);
    let extrinsics = &found.extrinsics;
    assert!(
        !extrinsics[0].is_moved && extrinsics[1].is_moved,
        "{extrinsics:?}"
    );
    let left = extrinsics[1].rig_from_left.inverse() * rig.cameras[1].rig_from_left;
    let share = left.angle_rad() / initial_error.angle_rad();
    assert!(share < 0.15, "remaining fraction {share}");
    assert!(farthest(&found) < 0.03, "{}", farthest(&found));
}

#[test]
fn cameras_with_common_landmarks_correct_their_extrinsics() {
    // Noise-free landmarks that two cameras observe: wrong Jacobians would not converge.
    let exact = crate::backend::solver::tests::window(5, 0.0);
    let mut moved = exact.clone();
    let nominal = &rig().cameras[0];
    let both = [nominal.clone(), nominal.clone()];
    let priors = ExtrinsicsPrior::of_rig(&Default::default(), &both, &exact.cameras);
    let stereo = stereo::prior_information(&exact.config, &both);
    let information = extrinsics::joint_information(&priors, 1.0, &stereo);
    moved.prior = moved.prior.with_calibrations(&exact.cameras, &information);
    let error = nalgebra::Vector6::new(0.0, 1e-3, 0.0, 0.01, -0.02, 0.01);
    extrinsics::apply_error(&mut moved.cameras[1].body_from_left, &error);
    extrinsics::apply_error(&mut moved.cameras[0].body_from_left, &(-0.5 * error));
    let begun =
        bundle_adjustment::optimize(&Default::default(), &mut moved.clone(), &[], 1, &mut |_| {});
    assert!(!begun.is_converged && begun.iterations == 1);
    let ended = bundle_adjustment::optimize(&Default::default(), &mut moved, &[], 12, &mut |_| {});
    assert!(ended.is_converged && ended.iterations < 12, "{ended:?}");
    for (prior, camera) in priors.iter().zip(&moved.cameras) {
        let error = prior.error(camera).amax();
        assert!(error < 1e-6, "{error}");
    }
}

#[test]
fn observation_sigma_grows_with_the_track_length() {
    let window = crate::backend::solver::tests::window(4, 0.0);
    let landmark = window.landmarks.values().next().expect("a landmark");
    let nominal = landmark.observations.clone();
    let mut widened = nominal.clone();
    widen(&mut widened, &[0, 1, 2, 3]);
    for ((number, before), (_, after)) in nominal.iter().zip(&widened) {
        let times = (1.0 + (number - nominal[0].0) as f64).sqrt();
        assert!((before.left.basis - after.left.basis * times).amax() < 1e-9);
        let [before, after] = [before, after].map(|s| s.right.expect("a stereo match").basis);
        assert!((before - after * times).amax() < 1e-9);
    }
}

#[test]
fn invalid_imu_interval_gives_no_imu_factor() {
    let mut rig = rig();
    rig.imus.push(crate::test_rig::imu());
    let mut mapping = Mapping::new(&rig, &Config::preset(Preset::Balanced));
    let believed = [true, true, false, true];
    for (k, mut keyframe) in (0..).zip(keyframes(1, 0.0, false)).take(4) {
        for n in 0..40 {
            let time_ns = keyframe.state.time_ns - 390_000_000 + n * 10_000_000;
            let sample = ImuSample {
                time_ns,
                gyro: [1e-3 * n as f64, 0.0, 0.0],
                accel: [1e-3 * n as f64, 0.0, 9.8 + 1e-3 * n as f64],
            };
            mapping.add_imu(0, &sample);
        }
        keyframe.imu_valid = believed[k];
        mapping.add_keyframe(keyframe);
    }
    for (motion, believed) in mapping.motions.iter().zip(believed).skip(1) {
        let motion = motion.as_ref().expect("a previous keyframe");
        assert_eq!(motion.has_gravity, believed);
    }
}

#[test]
fn result_does_not_depend_on_the_number_of_threads() {
    // More than one piece of landmarks.
    let frames = keyframes(5, 0.1, true);
    assert!(solved(frames.clone()).landmarks > 3 * 1024);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| solved(frames.clone()).poses)
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn covariance_after_a_tracking_loss_contains_the_motion_meanwhile() {
    let rig = rig();
    let loss = STEPS / 2;
    let mut frames = keyframes(1, 0.0, false);
    for keyframe in &mut frames[loss..] {
        for observation in &mut keyframe.observations {
            observation.id += 1_000_000;
        }
    }
    let mut config = Config::preset(Preset::Balanced);
    // Covariances are interpolated, but not across the loss.
    for max_covariances in [STEPS, 6] {
        config.mapping.max_covariances = max_covariances;
        let mut mapping = Mapping::new(&rig, &config);
        for keyframe in frames.clone() {
            mapping.add_keyframe(keyframe);
        }
        let refined = mapping.optimize(|_| {});
        let yaw_sigmas: Vec<f64> = (refined.poses.iter())
            .map(|pose| pose.covariance[(5, 5)].sqrt())
            .collect();
        // The rotation of a step without observations, from the constant-velocity model.
        let density = config.inertial.constant_velocity_noise_density[1];
        let expected = config.backend.covariance.sigma_inflation * density * 0.4_f64.sqrt();
        println!("{expected:.3} {yaw_sigmas:.3?}");
        assert!(yaw_sigmas[..loss].iter().all(|sigma| *sigma < 0.1));
        assert!(
            yaw_sigmas[loss..]
                .iter()
                .all(|sigma| *sigma > 0.6 * expected)
        );
    }
}
