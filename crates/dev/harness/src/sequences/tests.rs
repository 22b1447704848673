use rig_sim::faults::{Fault, Faults, Kind as FaultKind};
use rig_sim::scene::{Kind, Lighting};

use super::*;
use crate::data;

/// Two seconds, small and fast to render.
fn small() -> WalkSettings {
    WalkSettings {
        size: [160, 96],
        rate_hz: 5.0,
        quality: rig_sim::camera::Quality::FAST,
        ..WalkSettings::new(Kind::Room, Lighting::Day, 3, 2.0)
    }
}

fn fault(kind: FaultKind, strength: f64, from_s: f64, to_s: f64, camera: &str) -> Fault {
    Fault {
        kind,
        strength,
        from_s,
        to_s,
        camera: Some(camera.to_owned()),
        foot: None,
    }
}

fn all(sequence: &Sequence) -> Vec<OwnedFrameSet> {
    let sets = sequence.frame_sets().expect("sets");
    sets.collect::<Result<_>>().expect("images")
}

#[test]
fn walk_is_identical_if_rendered_cached_or_with_fewer_cameras() {
    let rendered = walk(&small()).expect("a walk");
    let sets = all(&rendered);
    assert_eq!(sets.len(), 10);
    assert!(sets.iter().all(|s| s.views.iter().all(Option::is_some)));
    let folder = tempfile::tempdir().expect("a folder");
    let first = rendered.clone().first(4).cached(folder.path());
    assert_eq!(all(&first.expect("room on the disk")), sets[..4]);
    let prerendered = rendered.cached(folder.path()).expect("room on the disk");
    assert_eq!(all(&prerendered), sets);
    let again = walk(&small()).and_then(|w| w.first(4).cached(folder.path()));
    assert_eq!(all(&again.expect("a walk")), sets[..4]);
    assert_eq!(
        std::fs::read_dir(folder.path()).expect("a folder").count(),
        1
    );

    let fewer = walk(&WalkSettings {
        cameras: vec!["right_shoulder".to_owned()],
        with_imu: false,
        ..small()
    });
    let fewer = fewer.expect("a walk");
    assert!(fewer.imu().is_empty() && fewer.rig().imus.is_empty());
    for (some, set) in all(&fewer).into_iter().zip(&sets) {
        assert_eq!(some.views, set.views[2..]);
    }
    assert_eq!(fewer.rig().cameras[0].name, "right_shoulder");
    let unknown = walk(&WalkSettings {
        cameras: vec!["knee".to_owned()],
        ..small()
    });
    assert!(unknown.unwrap_err().to_string().contains("left_shoulder"));
}

#[test]
fn every_imu_sample_is_delivered_once_and_up_to_its_set() {
    let sequence = walk(&small()).expect("a walk");
    let mut given = vec![Vec::new(); 3];
    sequence
        .for_each(|set| {
            let last = set.views.iter().flatten().map(|v| v.time_ns).max();
            let last = last.unwrap_or(0).max(set.time_ns);
            for (given, new) in given.iter_mut().zip(set.imu) {
                given.extend(new);
                let [.., before, end] = &given[..] else {
                    panic!("too few samples")
                };
                assert!(before.time_ns < last && last <= end.time_ns);
            }
            Ok(())
        })
        .expect("a walk");
    for (given, all) in given.iter().zip(sequence.imu()) {
        assert_eq!(given[..], all[..given.len()]);
        // The walk continues for half a period after its last image.
        assert!(
            all.len() - given.len() <= 41,
            "{} of {}",
            given.len(),
            all.len()
        );
    }
}

#[test]
fn ground_truth_agrees_with_the_walk_and_the_imu() {
    let sequence = walk(&small()).expect("a walk");
    assert_eq!(sequence.truth_at_sets().len(), sequence.len());
    assert!(sequence.world_from_rig(-1).is_none());
    let imu = &sequence.rig().imus[0];
    // Rotation of the IMU between two true poses, compared with the mean of its measurements: its
    // bias is below 2e-2 rad/s.
    let (from, to) = (1_000_000_000, 1_050_000_000);
    let pose = |t| sequence.world_from_rig(t).expect("within") * imu.rig_from_imu;
    let turned = (pose(from).inverse() * pose(to)).rotation_vector();
    let during = sequence.imu()[0]
        .iter()
        .filter(|s| (from..to).contains(&s.time_ns));
    let rates: Vec<[f64; 3]> = during.map(|s| s.gyro).collect();
    for axis in 0..3 {
        let mean = rates.iter().map(|r| r[axis]).sum::<f64>() / rates.len() as f64;
        let expected = turned[axis] / 0.05;
        assert!((mean - expected).abs() < 0.05, "{mean} against {expected}");
    }
}

#[test]
fn faults_remove_images_and_samples() {
    let list = vec![
        fault(FaultKind::Dropped, 1.0, 0.4, 0.8, "feet"),
        fault(FaultKind::Frozen, 1.0, 1.0, 1.4, "feet"),
        fault(FaultKind::Late, 5.0, 0.0, 2.0, "left_shoulder"),
        fault(FaultKind::Duplicated, 1.0, 0.0, 2.0, "right_shoulder"),
        fault(FaultKind::ImuGap, 0.5, 1.0, f64::INFINITY, "right_shoulder"),
    ];
    let faults = Faults { list, seed: 1 };
    let settings = WalkSettings { faults, ..small() };
    let sequence = walk(&settings).expect("a walk");
    let at = |name: &str| {
        let mut cameras = sequence.rig().cameras.iter();
        cameras.position(|c| c.name == name).expect("a camera")
    };
    let (feet, left, right) = (at("feet"), at("left_shoulder"), at("right_shoulder"));
    let sets = all(&sequence);
    let has =
        |camera: usize| -> Vec<bool> { sets.iter().map(|s| s.views[camera].is_some()).collect() };
    // Frames at 0.1, 0.3, 0.5 s and so on.
    let expected: Vec<bool> = (0..10).map(|n| ![2, 3].contains(&n)).collect();
    assert_eq!(has(feet), expected);
    let feet_at = |n: usize| sets[n].views[feet].as_ref().expect("an image");
    assert_eq!(feet_at(5).left, feet_at(4).left);
    assert_eq!(feet_at(6).left, feet_at(4).left);
    assert_ne!(feet_at(7).left, feet_at(4).left);
    // One frame that is 5 s late delays all later ones.
    let first_late = has(left).iter().position(|there| !there);
    if let Some(first) = first_late {
        assert!(has(left)[first..].iter().all(|there| !there));
    }
    assert!(has(right).iter().all(|there| *there));
    let samples = &sequence.imu()[right];
    let longest = samples
        .windows(2)
        .map(|w| w[1].time_ns - w[0].time_ns)
        .max();
    let longest = longest.expect("samples");
    assert!((500_000_000..=505_000_000).contains(&longest), "{longest}");
}

#[test]
fn device_faults_are_equal_for_prerendered_and_rendered_images() {
    let clean = walk(&small()).expect("a walk");
    let prerendered = std::sync::Arc::new(all(&clean));
    let list = vec![
        fault(FaultKind::Dropped, 0.5, 0.4, 2.0, "feet"),
        fault(FaultKind::Frozen, 0.5, 0.0, 2.0, "left_shoulder"),
        fault(FaultKind::Torn, 0.5, 0.0, 2.0, "right_shoulder"),
    ];
    let faults = Faults { list, seed: 2 };
    let settings = WalkSettings { faults, ..small() };
    let rendered = all(&walk(&settings).expect("a walk"));
    let taken_over = walk(&settings).and_then(|w| w.with_images(&prerendered));
    assert_eq!(all(&taken_over.expect("whole sets")), rendered);
    assert_ne!(rendered, *prerendered);
    let short = std::sync::Arc::new(prerendered[..3].to_vec());
    assert!(clean.with_images(&short).is_err());
}

#[test]
fn walk_names_are_parsed() {
    for name in named::TUNING.into_iter().chain(named::EXAM) {
        named::settings(name).expect(name);
    }
    let settings = named::settings("plaza-low-sun-7-12.5").expect("a name");
    assert_eq!(
        (settings.kind, settings.light),
        (Kind::Plaza, Lighting::LowSun)
    );
    assert_eq!((settings.seed, settings.seconds), (7, 12.5));
    assert!(named::settings("plaza-noon-7-60").is_err());
}

#[test]
fn kitti_moves_forward_along_x() {
    let sets = data::sets(["02_stereo_odometry_kitti/KITTI_sequence_1"]);
    let folder = match sets {
        Ok([folder]) => folder,
        Err(reason) => return eprintln!("{reason}"),
    };
    let sequence = kitti(&folder).expect("a sequence");
    assert_eq!(sequence.len(), 30);
    let last = sequence.world_from_rig(2_900_000_000).expect("a pose");
    let [x, y, z] = last.translation_m();
    assert!(x > 20.0 && y.abs() < 3.0 && z.abs() < 2.0, "{x} {y} {z}");
    let baseline = sequence.rig().cameras[0].right_from_left.distance_m();
    assert!((baseline - 0.537).abs() < 1e-3);
    let sets = all(&sequence.first(2));
    let view = sets[1].views[0].as_ref().expect("an image");
    assert_eq!((view.width, view.height), (1226, 370));
    assert!(view.left != view.right && sets[0].borrowed().views[0].is_some());
}

#[test]
fn euroc_is_at_rest_and_continues_without_images() {
    let paths = [
        "03_stereo_imu/euroc_V1_01_micro",
        "03_stereo_imu/euroc_groundtruth/V1_01_easy.csv",
    ];
    let [folder, truth] = match data::sets(paths) {
        Ok(sets) => sets,
        Err(reason) => return eprintln!("{reason}"),
    };
    let still = euroc(&folder, &truth, None).expect("a sequence");
    assert_eq!(still.len(), 20);
    let sets = all(&still);
    assert!(sets.iter().all(|s| s.views[0].is_some()));
    // 200 Hz against 20 Hz.
    assert!(sets[1..].iter().all(|s| s.imu[0].len() == 10));
    let times: Vec<i64> = still.times().collect();
    let moved = still.world_from_rig(times[0]).expect("a pose").inverse()
        * still.world_from_rig(times[19]).expect("a pose");
    assert!(moved.distance_m() < 0.01);

    let longer = euroc(&folder, &truth, Some(10.0)).expect("a sequence");
    // Its periods vary.
    assert!((200..=201).contains(&longer.len()), "{}", longer.len());
    let sets = all(&longer);
    let with = sets.iter().filter(|s| s.views[0].is_some()).count();
    assert_eq!(with, 20);
    assert!(sets[1..].iter().all(|s| (9..=11).contains(&s.imu[0].len())));
    // Ground truth ends before the IMU data, but not within ten seconds.
    assert_eq!(longer.truth_at_sets().len(), longer.len());
}
