//! A slice of `cargo xtask bench odometry`: one short walk, causal and adjusted, and the two real recordings.
//!
//! Bounds are three times what was measured when they were set, so that they catch what breaks and not what drifts.

use std::collections::BTreeMap;

use cad_transforms::RigidTransform;
use calib::{CameraModel, Lens};
use nalgebra::Vector3;
use odometry::keyframe::Seen;
use odometry::mapping::AdjustedMount;
use odometry::rig::StereoCamera;
use odometry::{Odometry, Preset, Settings};
use reconstruction::evaluate::{self, Evaluation, evaluate};
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use scene_bundle::Trajectory;
use tests::data;
use tests::sequences::{self, Sequence, WalkSettings, walk};
use tests::tracking::{self, drive, still, track};

fn balanced() -> Settings {
    Settings::preset(Preset::Balanced)
}

fn evaluated(estimate: &Trajectory, truth: &Trajectory) -> Evaluation {
    evaluate(estimate, truth, &evaluate::Settings::default())
}

fn percent(of: &Evaluation) -> f64 {
    let absolute = of.absolute.as_ref().expect("poses that can be compared");
    100.0 * absolute.translation_m.rmse / of.path_m
}

/// Both of one walk, because rendering it takes longer than following it.
#[test]
fn a_walk_is_followed_and_adjusted_better_and_a_camera_that_was_moved_is_told() {
    let settings = WalkSettings {
        quality: Quality::FAST,
        ..WalkSettings::new(Kind::Pavement, Lighting::Day, 41, 12.0)
    };
    let folder = tempfile::tempdir().expect("folder");
    let sequence = walk(&settings).expect("a walk");
    let sequence = sequence.cached(folder.path()).expect("pictures");
    is_followed_and_adjusted_better(&sequence);
    // Eight seconds.
    is_told_when_a_camera_was_moved(sequence.first(120));
}

fn is_followed_and_adjusted_better(sequence: &Sequence) {
    let truth = tracking::truth(sequence).expect("rising times");
    let tracking = track(sequence, balanced(), true).expect("poses");
    let causal = evaluated(tracking.causal(), &truth);
    let adjusted = tracking.refine().expect("poses").expect("with mapping");
    let is_moved = |m: &AdjustedMount| m.is_moved;
    assert!(
        !adjusted.extrinsics.iter().any(is_moved),
        "{:?}",
        adjusted.extrinsics
    );
    let adjusted = evaluated(&adjusted.trajectory, &truth);
    println!(
        "causal {:.4} %, adjusted {:.4} % of {:.1} m",
        percent(&causal),
        percent(&adjusted),
        causal.path_m
    );
    assert!(causal.path_m > 8.0, "{}", causal.path_m);
    assert_eq!(causal.completion.share, 1.0);
    assert_eq!(causal.poses.lost, 0);
    assert!(percent(&causal) < 0.2, "{causal:?}");
    assert!(percent(&adjusted) < 0.2, "{adjusted:?}");
}

#[test]
fn what_two_cameras_see_has_one_number() {
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
    followed.expect("pictures");
    keyframes.extend(odometry.take_keyframes(true));
    let cameras = &sequence.rig().cameras;
    let mut off_px = Vec::new();
    for keyframe in &keyframes {
        let mut seen: BTreeMap<u64, Vec<&Seen>> = BTreeMap::new();
        for one in &keyframe.seen {
            seen.entry(one.id).or_default().push(one);
        }
        for both in seen.values().filter(|seen| seen.len() > 1) {
            let [a, b] = both[..] else {
                panic!("seen by three of these cameras: {both:?}");
            };
            assert_ne!(a.camera, b.camera, "twice in one picture");
            let [from, to] = [a, b].map(|seen| &cameras[usize::from(seen.camera)]);
            // Where the eyes of the one see it, the other must.
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
        "{count} corners by two cameras in {} keyframes, off by {median:.2} px, 95 % by less than {most:.2} px",
        keyframes.len()
    );
    assert!(median < 2.0 && most < 10.0, "{median} {most}");
}

/// Where the eyes of a camera see something, in its left frame, m: between their rays.
fn place(camera: &StereoCamera, seen: &Seen) -> Option<[f64; 3]> {
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
    // A far thing may seem to be behind infinity.
    (along > 0.0).then(|| (left * along).into())
}

fn is_told_when_a_camera_was_moved(sequence: Sequence) {
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
    // What a turn about the way makes of a straight walk of 8 s is little.
    assert!(left.angle_rad() < 0.5 * off.angle_rad());
}

#[test]
fn a_drive_without_imu_ends_where_it_should() {
    let [folder] = match data::sets(["02_stereo_odometry_kitti/KITTI_sequence_1"]) {
        Ok(sets) => sets,
        Err(reason) => return eprintln!("{reason}"),
    };
    let sequence = sequences::kitti(&folder).expect("a sequence");
    let truth = tracking::truth(&sequence).expect("rising times");
    let tracking = track(&sequence, balanced(), false).expect("poses");
    let from = |pose| drive::from_pose(tracking.causal(), &truth, pose).expect("as many poses");
    let fit = drive::best_fit(tracking.causal(), &truth).expect("as many poses");
    println!("{:?} {fit:?} {:?}", from(0), from(12));
    // The first poses of the truth were interpolated: laid on by the first, its error counts with the way.
    assert!(from(0).percent < 3.3 && fit.percent < 0.75 && from(12).percent < 1.9);
}

#[test]
fn standing_still_shows_biases_and_what_is_up() {
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
    // The accelerometer's bias cannot be seen at rest and tilts what is up by as much as it is large: 0.08 m/s² of
    // 9.81 are half a degree.
    assert!(found.up_off_orientation_deg < 1.0 && found.up_off_force_deg < 1.0);
    assert!(found.truth_off_itself_deg < 0.5, "{found:?}");
}
