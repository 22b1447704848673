//! A slice of `cargo xtask bench odometry`: one short walk, causal and refined, and the two real
//! recordings.
//!
//! Bounds are three times the values measured when they were set, so that they detect breakage and
//! not gradual change.

use std::collections::BTreeMap;

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Lens};
use harness::data;
use harness::sequences::{self, OwnedFrameSet, Sequence, WalkSettings, walk};
use harness::tracking::{self, RefinedWalk, Tracking, drive, still, track};
use nalgebra::Vector3;
use odometry::keyframe::StereoObservation;
use odometry::mapping::RefinedExtrinsics;
use odometry::rig::StereoCamera;
use odometry::{Config, Odometry, Preset, Rig};
use reconstruction::evaluate::{self, Evaluation, evaluate};
use rig_sim::camera::{Quality, codec};
use rig_sim::scene::{Kind, Lighting};
use scene_bundle::{Status, Trajectory};

fn balanced() -> Config {
    Config::preset(Preset::Balanced)
}

fn evaluated(estimate: &Trajectory, truth: &Trajectory) -> Evaluation {
    evaluate(estimate, truth, &evaluate::Settings::default())
}

fn percent(of: &Evaluation) -> f64 {
    let absolute = of.absolute.as_ref().expect("poses that can be compared");
    100.0 * absolute.translation_m.rmse / of.path_m
}

/// All on one walk, because rendering it takes longer than tracking.
#[test]
fn refined_walk_is_more_accurate_and_wrong_extrinsics_are_no_silent_error() {
    let settings = WalkSettings {
        quality: Quality::FAST,
        ..WalkSettings::new(Kind::Pavement, Lighting::Day, 41, 12.0)
    };
    let folder = tempfile::tempdir().expect("folder");
    let sequence = walk(&settings).expect("a walk");
    let sequence = sequence.cached(folder.path()).expect("images");
    check_causal_and_refined_accuracy(&sequence);
    check_wrong_extrinsics_give_no_silently_wrong_pose(sequence.clone());
    // Eight seconds.
    check_moved_camera_is_detected(sequence.first(120));
}

fn check_causal_and_refined_accuracy(sequence: &Sequence) {
    let truth = tracking::truth(sequence).expect("rising times");
    let tracking = track(sequence, balanced(), true).expect("poses");
    let causal = evaluated(tracking.causal(), &truth);
    let adjusted = tracking.refine().expect("poses").expect("with mapping");
    let is_moved = |m: &RefinedExtrinsics| m.is_moved;
    assert!(
        !adjusted.extrinsics.iter().any(is_moved),
        "{:?}",
        adjusted.extrinsics
    );
    let adjusted = evaluated(&adjusted.trajectory, &truth);
    println!(
        "causal {:.4} %, refined {:.4} % of {:.1} m",
        percent(&causal),
        percent(&adjusted),
        causal.path_m
    );
    assert!(causal.path_m > 8.0, "{}", causal.path_m);
    assert_eq!(causal.completion.share, 1.0);
    assert_eq!(causal.poses.lost, 0);
    assert!(percent(&causal) < 0.2, "{causal:?}");
    assert!(percent(&adjusted) < 0.2, "{adjusted:?}");
    for of in [causal, adjusted] {
        let found = of.consistency.expect("covariances");
        println!("{found:?}");
        assert_eq!(found.silently_wrong, 0, "{found:?}");
        // 3 is right. The stated sigmas of 12 s are up to 9 times the errors: extrinsics and stereo
        // calibrations are uncertain, those of this walk are exact.
        assert!(
            found.nees_translation < 6.0 && found.nees_rotation < 6.0,
            "{found:?}"
        );
        assert!(found.sharpness_translation < 12.0, "{found:?}");
        assert!(found.sharpness_rotation < 12.0, "{found:?}");
    }
}

/// The window corrects causal poses by a centimeter at a corner of this walk.
#[test]
fn refined_poses_do_not_jump_where_causal_ones_do() {
    let settings = WalkSettings {
        quality: Quality::FAST,
        size: [336, 188],
        ..WalkSettings::new(Kind::Plaza, Lighting::Day, 1, 9.0)
    };
    let sequence = walk(&settings).expect("a walk");
    let truth = tracking::truth(&sequence).expect("rising times");
    let tracking = track(&sequence, balanced(), true).expect("poses");
    let causal_m = jump_m(tracking.causal(), &truth);
    let adjusted = tracking.refine().expect("poses").expect("with mapping");
    let refined_m = jump_m(&adjusted.trajectory, &truth);
    println!("causal {causal_m:.4} m, refined {refined_m:.4} m");
    assert!(causal_m > 0.006, "{causal_m}");
    assert!(refined_m < 0.004, "{refined_m}");
    let poses = adjusted.trajectory.poses();
    assert!(poses.iter().all(|pose| pose.covariance.is_some()));
    let consistency = evaluated(&adjusted.trajectory, &truth).consistency;
    assert_eq!(consistency.expect("covariances").silently_wrong, 0);
}

/// Largest deviation of the error of a pose from the mean of those of its neighbors, m.
fn jump_m(estimate: &Trajectory, truth: &Trajectory) -> f64 {
    let fit = evaluated(estimate, truth).true_from_estimated;
    let fit = fit.expect("poses that can be compared");
    let poses = estimate.poses().iter().zip(truth.poses());
    let errors: Vec<Vector3<f64>> = poses
        .map(|(pose, truth)| {
            fit.apply(&pose.world_from_rig).translation() - truth.world_from_rig.translation()
        })
        .collect();
    let jumps = (errors.windows(3)).map(|w| (w[1] - (w[0] + w[2]) * 0.5).norm());
    jumps.fold(0.0, f64::max)
}

#[test]
fn landmarks_observed_by_two_cameras_have_one_id() {
    let settings = WalkSettings {
        quality: Quality::FAST,
        ..WalkSettings::new(Kind::Pavement, Lighting::Day, 42, 4.0)
    };
    let sequence = walk(&settings).expect("a walk");
    let mut odometry = Odometry::new(sequence.rig(), balanced());
    let mut keyframes = Vec::new();
    let followed = sequence.for_each(|set| {
        for (k, samples) in set.imu.iter().enumerate() {
            samples.iter().for_each(|s| odometry.add_imu(k, s));
        }
        odometry.add_frames(&set.borrowed());
        keyframes.extend(odometry.take_keyframes(false));
        Ok(())
    });
    followed.expect("images");
    keyframes.extend(odometry.take_keyframes(true));
    let cameras = &sequence.rig().cameras;
    let mut off_px = Vec::new();
    for keyframe in &keyframes {
        let mut seen: BTreeMap<u64, Vec<&StereoObservation>> = BTreeMap::new();
        for one in &keyframe.observations {
            seen.entry(one.id).or_default().push(one);
        }
        for both in seen.values().filter(|seen| seen.len() > 1) {
            let [a, b] = both[..] else {
                panic!("observed by three of these cameras: {both:?}");
            };
            assert_ne!(a.camera, b.camera, "twice in one image");
            let [from, to] = [a, b].map(|seen| &cameras[usize::from(seen.camera)]);
            // The point triangulated by one camera must be visible to the other.
            let Some(place) = place(from, a) else {
                continue;
            };
            let there = to.rig_from_left.inverse() * from.rig_from_left;
            let found = Lens::new(&to.left).project(there.apply(place));
            off_px.push(found.map_or(f64::INFINITY, |[x, y]| {
                (x - f64::from(b.left[0])).hypot(y - f64::from(b.left[1]))
            }));
        }
    }
    off_px.sort_by(f64::total_cmp);
    let count = off_px.len();
    assert!(count > keyframes.len(), "{count}");
    let (median, most) = (off_px[count / 2], off_px[count * 95 / 100]);
    println!(
        "{count} corners by two cameras in {} keyframes, median error {median:.2} px, 95 % below {most:.2} px",
        keyframes.len()
    );
    assert!(median < 2.0 && most < 10.0, "{median} {most}");
}

/// Triangulated point in the left frame of a camera, m: between the rays of its eyes.
fn place(camera: &StereoCamera, seen: &StereoObservation) -> Option<[f64; 3]> {
    let ray = |model: &CameraModel, at: [f32; 2]| {
        let ray = Lens::new(model).unproject(at.map(f64::from))?;
        Some(Vector3::from(ray).normalize())
    };
    let left = ray(&camera.left, seen.left)?;
    let right = ray(&camera.right, seen.right?)?;
    let back = camera.right_from_left.inverse();
    let right = back.rotation() * right;
    let across = *back.translation();
    let between = left.dot(&right);
    let along = (left - right * between).dot(&across) / (1.0 - between * between);
    // A distant point may be triangulated beyond infinity.
    (along > 0.0).then(|| (left * along).into())
}

/// Cameras that deviate from their nominal rotation by what a calibration without a stated
/// covariance may, without IMU. Where the window took extrinsics as exact, 32 of these poses were
/// silently wrong.
fn check_wrong_extrinsics_give_no_silently_wrong_pose(sequence: Sequence) {
    // Of the left eyes against the rig, and of the right eyes about y.
    let turns = [
        ([0.0035, -0.003, 0.002], 0.001),
        ([-0.003, 0.0035, -0.002], -0.0015),
        ([0.002, 0.003, -0.0035], 0.001),
    ];
    let rotation = |by| RigidTransform::from_rotation_vector(by, [0.0; 3]).expect("finite");
    let sequence = sequence.with_nominal_rig(|rig| {
        rig.imus.clear();
        for (camera, (left, right)) in rig.cameras.iter_mut().zip(turns) {
            camera.rig_from_left = camera.rig_from_left * rotation(left);
            camera.right_from_left = rotation([0.0, right, 0.0]) * camera.right_from_left;
            camera.covariance = None;
            camera.right_from_left_covariance = None;
        }
    });
    let truth = tracking::truth(&sequence).expect("rising times");
    let tracking = track(&sequence, balanced(), false).expect("poses");
    let causal = evaluated(tracking.causal(), &truth);
    let consistency = causal.consistency.as_ref().expect("covariances");
    println!("{:.3} %, {consistency:?}", percent(&causal));
    assert_eq!(consistency.silently_wrong, 0, "{consistency:?}");
    assert!(percent(&causal) < 0.6, "{}", percent(&causal));
}

fn check_moved_camera_is_detected(sequence: Sequence) {
    let off = RigidTransform::from_rotation_vector([0.02, -0.015, 0.01], [0.0; 3]).expect("finite");
    let sequence = sequence.with_nominal_rig(|rig| {
        let camera = &mut rig.cameras[2];
        camera.rig_from_left = camera.rig_from_left * off;
    });
    let tracking = track(&sequence, balanced(), true).expect("poses");
    let adjusted = tracking.refine().expect("poses").expect("with mapping");
    let moved: Vec<bool> = adjusted.extrinsics.iter().map(|m| m.is_moved).collect();
    assert_eq!(moved, [false, false, true], "{:?}", adjusted.extrinsics);
    let nominal = &sequence.rig().cameras[2];
    let right = nominal.rig_from_left * off.inverse();
    let left = adjusted.extrinsics[2].rig_from_left.inverse() * right;
    println!("{:.3} of {:.3} rad left", left.angle_rad(), off.angle_rad());
    // A rotation about the path has little effect on a straight walk of 8 s.
    assert!(left.angle_rad() < 0.5 * off.angle_rad());
}

/// Causal poses of the first frame sets of a walk of 20 s with one of its cameras, or all.
fn check_causal_poses(
    (kind, seed, sets): (Kind, u64, usize),
    camera: Option<&str>,
    with_imu: bool,
    change: impl FnOnce(&mut Rig),
) -> Trajectory {
    let settings = WalkSettings {
        quality: Quality::FAST,
        cameras: camera.map(str::to_owned).into_iter().collect(),
        with_imu,
        ..WalkSettings::new(kind, Lighting::Day, seed, 20.0)
    };
    let sequence = walk(&settings).expect("a walk").first(sets);
    let sequence = sequence.with_nominal_rig(change);
    let truth = tracking::truth(&sequence).expect("rising times");
    let tracking = track(&sequence, balanced(), false).expect("poses");
    let errors = evaluated(tracking.causal(), &truth);
    let consistency = errors.consistency.expect("covariances");
    assert_eq!(consistency.silently_wrong, 0, "{consistency:?}");
    tracking.causal().clone()
}

/// On a plain floor a camera that faces down sees the wearer's legs only, and a dozen corners agree
/// with each other. Nine poses were silently wrong.
#[test]
fn legs_in_front_of_a_plain_floor_give_no_silently_wrong_pose() {
    check_causal_poses((Kind::Corridor, 41, 60), Some("feet"), true, |_| {});
}

/// The rotation moves rows by 2 px. Five poses were silently wrong when only matches within 1.5 px
/// of their epipolar lines were accepted.
#[test]
fn right_eyes_rotated_about_x_give_no_silently_wrong_pose() {
    check_causal_poses((Kind::Pavement, 21, 120), None, true, |rig| {
        for camera in &mut rig.cameras {
            let turn =
                RigidTransform::from_rotation_vector([0.3_f64.to_radians(), 0.0, 0.0], [0.0; 3]);
            camera.right_from_left = turn.expect("finite") * camera.right_from_left;
            camera.right_from_left_covariance = None;
        }
    });
}

/// Two cameras whose right eyes are rotated about y, as by 1.2 px of disparity at infinity.
#[test]
fn right_eyes_rotated_about_y_are_estimated_and_reported() {
    let settings = WalkSettings {
        quality: Quality::FAST,
        cameras: ["left_shoulder", "right_shoulder"]
            .map(str::to_owned)
            .to_vec(),
        ..WalkSettings::new(Kind::Pavement, Lighting::Day, 21, 20.0)
    };
    let angles = [0.2_f64.to_radians(), -0.15_f64.to_radians()];
    let exact = walk(&settings).expect("a walk").first(105);
    let folder = tempfile::tempdir().expect("folder");
    let exact = exact.cached(folder.path()).expect("images");
    for change in [principal_points_2_px_wrong, baselines_3_percent_wrong] {
        let sequence = exact.clone().with_nominal_rig(|rig| {
            for camera in &mut rig.cameras {
                change(camera);
                camera.right_from_left_covariance = None;
            }
        });
        check_causal_and_refined_poses(&sequence, 4.0);
    }
    let sequence = exact.with_nominal_rig(|rig| {
        for (camera, angle) in rig.cameras.iter_mut().zip(angles) {
            let turn = RigidTransform::from_rotation_vector([0.0, angle, 0.0], [0.0; 3]);
            camera.right_from_left = turn.expect("finite") * camera.right_from_left;
            camera.right_from_left_covariance = None;
        }
    });
    // Without an estimate distances of 10 m are 30 % wrong.
    let refined = check_causal_and_refined_poses(&sequence, 2.0);
    for (stereo, angle) in refined.stereo.iter().zip(angles) {
        let (error, sigma) = (stereo.error[1], stereo.sigmas()[1]);
        println!("{error} rad, sigma {sigma} rad, truth {}", -angle);
        assert!(stereo.is_significant, "{stereo:?}");
        assert!((error + angle).abs() < 3.0 * sigma, "{error} {sigma}");
        assert!((error + angle).abs() < 0.5 * angle.abs(), "{error}");
    }
}

fn principal_points_2_px_wrong(camera: &mut StereoCamera) {
    camera.right.cx += 2.0;
}

fn baselines_3_percent_wrong(camera: &mut StereoCamera) {
    let exact = camera.right_from_left;
    let longer = exact.translation_m().map(|m| 1.03 * m);
    camera.right_from_left =
        RigidTransform::from_wxyz(exact.rotation_wxyz(), longer).expect("finite");
}

/// No pose is silently wrong; the root mean square error is less than a share of the path.
fn check_causal_and_refined_poses(sequence: &Sequence, max_percent: f64) -> RefinedWalk {
    let truth = tracking::truth(sequence).expect("rising times");
    let tracking = track(sequence, balanced(), true).expect("poses");
    let causal = evaluated(tracking.causal(), &truth);
    let refined = tracking.refine().expect("poses").expect("with mapping");
    for of in [causal, evaluated(&refined.trajectory, &truth)] {
        let consistency = of.consistency.as_ref().expect("covariances");
        println!("{:.3} %, {consistency:?}", percent(&of));
        assert_eq!(consistency.silently_wrong, 0, "{consistency:?}");
        assert!(percent(&of) < max_percent, "{}", percent(&of));
    }
    refined
}

/// The rig stands for the first 0.8 s. With little damping of the window, tilt and accelerometer
/// biases of a rig whose cameras are not mounted as calibrated grew together, by tens of degrees.
#[test]
fn tilt_of_a_rig_at_rest_remains() {
    let settings = WalkSettings {
        quality: Quality::FAST,
        ..WalkSettings::new(Kind::Room, Lighting::Day, 81, 20.0)
    };
    let sequence = walk(&settings).expect("a walk").first(14);
    let turns = [
        [2e-3, 1e-3, -1e-3],
        [-1e-3, 2e-3, 1e-3],
        [1e-3, -2e-3, 2e-3],
    ];
    let sequence = sequence.with_nominal_rig(|rig| {
        for (camera, turn) in rig.cameras.iter_mut().zip(turns) {
            let turn = RigidTransform::from_rotation_vector(turn, [0.0; 3]).expect("finite");
            camera.rig_from_left = camera.rig_from_left * turn;
        }
    });
    let truth = tracking::truth(&sequence).expect("rising times");
    let tracking = track(&sequence, balanced(), false).expect("poses");
    let poses = tracking.causal().poses().iter().zip(truth.poses());
    let offsets = poses.map(|(pose, truth)| pose.world_from_rig * truth.world_from_rig.inverse());
    let offsets: Vec<RigidTransform> = offsets.collect();
    let turned_deg = offsets
        .iter()
        .map(|offset| (offsets[0].inverse() * *offset).angle_rad().to_degrees());
    let turned_deg = turned_deg.fold(0.0, f64::max);
    println!("{turned_deg} degrees");
    assert!(turned_deg < 1.0, "{turned_deg}");
}

/// One camera without IMU, whose stereo calibration is exact: the scale is that of its disparities,
/// whose mean error of 0.02 px makes paths too long. They are within the stated sigmas.
#[test]
fn refined_paths_of_one_camera_have_the_length_that_their_sigmas_state() {
    let long_percent = [Kind::Plaza, Kind::Trail].map(|kind| {
        let settings = WalkSettings {
            quality: Quality::FAST,
            cameras: vec!["left_shoulder".to_owned()],
            with_imu: false,
            ..WalkSettings::new(kind, Lighting::Day, 92, 10.0)
        };
        let sequence = walk(&settings).expect("a walk");
        let truth = tracking::truth(&sequence).expect("rising times");
        let tracking = track(&sequence, balanced(), true).expect("poses");
        let refined = tracking.refine().expect("poses").expect("with mapping");
        let scaled = evaluate::Settings {
            alignment: evaluate::Alignment::Sim3,
            ..evaluate::Settings::default()
        };
        let fit = evaluate(&refined.trajectory, &truth, &scaled).true_from_estimated;
        let found = evaluated(&refined.trajectory, &truth).consistency;
        assert_eq!(found.expect("covariances").silently_wrong, 0);
        100.0 * (1.0 / fit.expect("poses that can be compared").scale - 1.0)
    });
    println!("{long_percent:?}");
    assert!(
        long_percent.iter().all(|of| of.abs() < 3.0),
        "{long_percent:?}"
    );
}

/// One of these poses was lost when twelve corners were required.
#[test]
fn walk_on_weak_texture_without_imu_is_tracked_from_its_start() {
    let poses = check_causal_poses(
        (Kind::Corridor, 42, 60),
        Some("left_shoulder"),
        false,
        |_| {},
    );
    let is_tracked = |pose: &scene_bundle::Pose| pose.status == Status::Tracked;
    assert!(poses.poses().iter().all(is_tracked));
}

/// A second and a half without IMU that begins while the wearer walks, for every preset, with
/// images as rendered and after a codec. Up to three of the first poses were lost.
#[test]
fn recordings_that_start_in_motion_are_tracked_from_their_first_pose() {
    for kind in [Kind::Pavement, Kind::Stairs, Kind::Room] {
        let settings = WalkSettings {
            quality: Quality::FAST,
            cameras: vec!["left_shoulder".to_owned()],
            with_imu: false,
            ..WalkSettings::new(kind, Lighting::Day, 71, 3.5)
        };
        let sequence = walk(&settings).expect("a walk");
        let truth = tracking::truth(&sequence).expect("rising times");
        // After 2 s the wearer walks.
        let sets = sequence.frame_sets().expect("images").skip(30);
        let sets: Vec<OwnedFrameSet> = sets.collect::<Result<_, _>>().expect("images");
        let [from, to] = [0, sets.len() - 1].map(|k| sequence.world_from_rig(sets[k].time_ns));
        let motion = from.expect("truth").inverse() * to.expect("truth");
        assert!(Vector3::from(motion.translation_m()).norm() > 0.8);
        for preset in [Preset::Fast, Preset::Balanced, Preset::Accurate] {
            for quantization in [0.0, 32.0] {
                let causal = track_quantized(&sequence, &sets, preset, quantization);
                let is_tracked = |pose: &&scene_bundle::Pose| pose.status == Status::Tracked;
                let tracked = causal.poses().iter().filter(is_tracked).count();
                let consistency = evaluated(&causal, &truth).consistency.expect("covariances");
                println!(
                    "{kind:?} {preset:?} {quantization}: {tracked} of {}",
                    sets.len()
                );
                assert_eq!(tracked, sets.len(), "{kind:?} {preset:?} {quantization}");
                assert_eq!(consistency.silently_wrong, 0, "{consistency:?}");
            }
        }
    }
}

/// Causal poses from images after a codec with a quantization step, gray levels.
fn track_quantized(
    sequence: &Sequence,
    sets: &[OwnedFrameSet],
    preset: Preset,
    step: f32,
) -> Trajectory {
    let mut tracking = Tracking::new(sequence.rig(), Config::preset(preset), false);
    for set in sets {
        let mut set = set.clone();
        for view in set.views.iter_mut().flatten() {
            let size = [view.width, view.height];
            for eye in [&mut view.left, &mut view.right] {
                codec::quantize(eye, view.width, size, step);
            }
        }
        tracking.add(&set).expect("a set");
    }
    tracking.causal().clone()
}

#[test]
fn drive_without_imu_has_bounded_drift() {
    let [folder] = match data::sets(["02_stereo_odometry_kitti/KITTI_sequence_1"]) {
        Ok(sets) => sets,
        Err(reason) => return eprintln!("{reason}"),
    };
    let sequence = sequences::kitti(&folder).expect("a sequence");
    let truth = tracking::truth(&sequence).expect("rising times");
    let tracking = track(&sequence, balanced(), false).expect("poses");
    let from =
        |pose| drive::from_pose(tracking.causal(), &truth, pose).expect("equal numbers of poses");
    let fit = drive::best_fit(tracking.causal(), &truth).expect("equal numbers of poses");
    println!("{:?} {fit:?} {:?}", from(0), from(12));
    // The first true poses are interpolated: with alignment at the first, its error grows with path
    // length.
    assert!(from(0).percent < 1.3 && fit.percent < 0.6 && from(12).percent < 1.4);
}

#[test]
fn rest_determines_biases_and_the_vertical() {
    let [folder, truth] = match data::sets([
        "03_stereo_imu/euroc_V1_01_micro",
        "03_stereo_imu/euroc_groundtruth/V1_01_easy.csv",
    ]) {
        Ok(sets) => sets,
        Err(reason) => return eprintln!("{reason}"),
    };
    let found = still::still(&folder, &truth, balanced()).expect("a sequence");
    println!("{found:?}");
    assert!(found.gyro_bias_off < 2e-3, "{found:?}");
    assert!(found.moved_m < 5e-3, "{found:?}");
    // The accelerometer bias is unobservable at rest and tilts the vertical in proportion: 0.08
    // m/s² of 9.81 are half a degree.
    assert!(found.up_off_orientation_deg < 1.0 && found.up_off_force_deg < 1.0);
    assert!(found.truth_off_itself_deg < 0.5, "{found:?}");
}
