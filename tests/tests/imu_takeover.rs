//! A simulated walk whose first IMU is disconnected after two seconds, and whose lenses are covered
//! for one second after that: another IMU carries the poses.

use harness::sequences::{Sequence, WalkSettings, walk};
use harness::tracking::{self, Tracking};
use odometry::rig::Rig;
use odometry::{Config, Preset};
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use scene_bundle::Status;

/// From then on the first IMU has no samples, s.
const DISCONNECTED_S: f64 = 2.0;
/// While no camera has images, s.
const COVERED_S: [f64; 2] = [4.0, 5.0];

/// Poses of the faulty walk with the first `imus` IMUs of the rig.
fn tracked(sequence: &Sequence, imus: usize) -> Tracking {
    let mut rig: Rig = sequence.rig().clone();
    rig.imus.truncate(imus);
    let mut tracking = Tracking::new(&rig, Config::preset(Preset::Balanced), true);
    let mut start_ns = None;
    for set in sequence.frame_sets().expect("sets") {
        let mut set = set.expect("a set");
        let start_ns = *start_ns.get_or_insert(set.time_ns);
        let seconds = |time_ns: i64| (time_ns - start_ns) as f64 * 1e-9;
        set.imu.truncate(imus);
        set.imu[0].retain(|sample| seconds(sample.time_ns) < DISCONNECTED_S);
        if (COVERED_S[0]..COVERED_S[1]).contains(&seconds(set.time_ns)) {
            set.views.iter_mut().for_each(|view| *view = None);
        }
        tracking.add(&set).expect("a pose");
    }
    tracking
}

/// Largest error of the position, m, and largest one in its own sigmas, of poses that are not lost;
/// number of lost poses.
fn errors(sequence: &Sequence, tracking: &Tracking) -> (f64, f64, usize) {
    let truth = tracking::truth(sequence).expect("rising times");
    let poses = tracking.causal().poses();
    // World and truth differ by the first pose.
    let to_truth = truth.poses()[0].world_from_rig * poses[0].world_from_rig.inverse();
    let (mut metres, mut sigmas, mut lost) = (0.0_f64, 0.0_f64, 0);
    for (pose, truth) in poses.iter().zip(truth.poses()) {
        assert_eq!(pose.time_ns, truth.time_ns);
        if pose.status == Status::Lost {
            lost += 1;
            continue;
        }
        let found = to_truth * pose.world_from_rig;
        let error = (found.translation() - truth.world_from_rig.translation()).norm();
        let covariance = pose.covariance.as_ref().expect("a covariance").matrix();
        let variance: f64 = (0..3).map(|k| covariance[(k, k)]).sum();
        metres = metres.max(error);
        if error > 0.01 {
            sigmas = sigmas.max(error / variance.sqrt());
        }
    }
    (metres, sigmas, lost)
}

#[test]
fn another_imu_carries_the_poses_through_darkness() {
    let settings = WalkSettings {
        quality: Quality::FAST,
        ..WalkSettings::new(Kind::Pavement, Lighting::Day, 43, 7.0)
    };
    let folder = tempfile::tempdir().expect("folder");
    let sequence = walk(&settings).expect("a walk");
    let sequence = sequence.cached(folder.path()).expect("images");
    let alone = tracked(&sequence, 1);
    let all = tracked(&sequence, 3);
    let (without, with) = (errors(&sequence, &alone), errors(&sequence, &all));
    println!(
        "one IMU: {without:?}; three: {with:?}; {:?}",
        all.imu_uses()
    );
    assert_eq!(alone.imu_uses().len(), 1);
    let used: Vec<usize> = all.imu_uses().iter().map(|used| used.imu).collect();
    assert_eq!(used, [0, 1]);
    assert!(with.2 == 0 && with.0 < 0.3 && with.1 < 3.0, "{with:?}");
    assert!(without.2 > 0 || without.0 > 2.0 * with.0, "{without:?}");
    // Bundle adjustment lets the same IMU take over.
    let refined = all.refine().expect("poses").expect("with mapping");
    let truth = tracking::truth(&sequence).expect("rising times");
    let evaluation = reconstruction::evaluate::evaluate(
        &refined.trajectory,
        &truth,
        &reconstruction::evaluate::Settings::default(),
    );
    let absolute = evaluation.absolute.expect("poses that can be compared");
    println!("refined: {:?}", absolute.translation_m);
    assert!(absolute.translation_m.max < 0.15, "{absolute:?}");
}
