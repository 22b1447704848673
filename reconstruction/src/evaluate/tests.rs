use std::path::Path;

use cad_transforms::{Covariance, RigidTransform};
use scene_bundle::{Pose, Status};
use test_data::shared;

use super::*;

/// A walker's path with rotations, at 10 Hz.
fn truth(count: usize) -> Trajectory {
    let poses = (0..count).map(|i| {
        let s = i as f64 * 0.1;
        let turn = [0.05 * (3.0 * s).sin(), 0.04 * (2.0 * s).cos(), 0.3 * s];
        let place = [
            4.0 * (0.3 * s).sin(),
            -4.0 * (0.3 * s).cos(),
            1.3 + 0.1 * s.sin(),
        ];
        let pose = RigidTransform::from_rotation_vector(turn, place).expect("finite");
        Pose::new(1_000_000_000 + i as i64 * 100_000_000, pose)
    });
    Trajectory::new(poses.collect()).expect("rising")
}

fn changed(of: &Trajectory, change: impl Fn(usize, &mut Pose)) -> Trajectory {
    let mut poses = of.poses().to_vec();
    for (i, pose) in poses.iter_mut().enumerate() {
        change(i, pose);
    }
    Trajectory::new(poses).expect("rising")
}

fn with(alignment: Alignment) -> Settings {
    Settings {
        alignment,
        ..Settings::default()
    }
}

#[test]
fn a_transformed_and_scaled_copy_is_aligned() {
    let truth = truth(200);
    let away = RigidTransform::from_rotation_vector([0.3, -1.0, 2.0], [5.0, 6.0, 7.0]);
    let away = away.expect("finite");
    let moved = changed(&truth, |_, pose| {
        pose.world_from_rig = away * pose.world_from_rig
    });
    for alignment in [Alignment::Se3, Alignment::Sim3, Alignment::First] {
        let found = evaluate(&moved, &truth, &with(alignment));
        let absolute = found.absolute.expect("enough");
        assert!(absolute.translation_m.max < 1e-12, "{alignment:?}");
        // Tiny angles are accurate to the square root of the precision.
        assert!(absolute.rotation_rad.expect("turns").max < 1e-7);
    }
    let none = evaluate(&moved, &truth, &with(Alignment::None));
    assert!(none.absolute.expect("enough").translation_m.mean > 5.0);

    let larger = changed(&moved, |_, pose| {
        let place = pose.world_from_rig.translation() * 2.5;
        pose.world_from_rig = align::transform(*pose.world_from_rig.rotation(), place);
    });
    let found = evaluate(&larger, &truth, &with(Alignment::Sim3));
    assert!((found.true_from_estimated.expect("enough").scale - 0.4).abs() < 1e-12);
    assert!(found.absolute.expect("enough").translation_m.max < 1e-12);
    assert!(found.relative[0].translation_m.expect("10 m").max < 1e-12);
    let rigid = evaluate(&larger, &truth, &with(Alignment::Se3));
    assert!(rigid.absolute.expect("enough").translation_m.rmse > 1.0);
}

#[test]
fn a_mirrored_copy_is_not_aligned_by_a_reflection() {
    let truth = truth(100);
    let mirrored = changed(&truth, |_, pose| {
        let [x, y, z] = pose.world_from_rig.translation_m();
        let turn = *pose.world_from_rig.rotation();
        pose.world_from_rig = align::transform(turn, nalgebra::Vector3::new(x, -y, z * z));
    });
    let found = evaluate(&mirrored, &truth, &with(Alignment::Se3));
    let rigid = found.true_from_estimated.expect("enough").rigid;
    let determinant = rigid.rotation().to_rotation_matrix().matrix().determinant();
    assert!((determinant - 1.0).abs() < 1e-12);
    assert!(found.absolute.expect("enough").translation_m.rmse > 0.05);
}

#[test]
fn poses_on_a_line_or_at_one_position_do_not_determine_the_rotation() {
    let line = changed(&truth(50), |i, pose| {
        pose.world_from_rig =
            RigidTransform::from_translation_m([0.1 * i as f64, 0.0, 0.0]).expect("finite");
    });
    for estimate in [
        line.clone(),
        changed(&line, |_, pose| {
            pose.world_from_rig = RigidTransform::identity()
        }),
    ] {
        let found = evaluate(&estimate, &line, &with(Alignment::Se3));
        assert!(!found.true_from_estimated.expect("enough").rotation_is_known);
        let absolute = found.absolute.expect("positions are compared nevertheless");
        assert_eq!(absolute.rotation_rad, None);
        let first = evaluate(&estimate, &line, &with(Alignment::First));
        assert!(first.absolute.expect("enough").rotation_rad.is_some());
    }
    let two = Trajectory::new(line.poses()[..2].to_vec()).expect("rising");
    assert_eq!(evaluate(&two, &line, &with(Alignment::Se3)).absolute, None);
    let nothing = evaluate(&Trajectory::default(), &line, &with(Alignment::None));
    assert_eq!((nothing.absolute, nothing.matched), (None, 0));
    assert_eq!(nothing.completion.share, 0.0);
}

#[test]
fn the_nearest_in_time_within_the_tolerance_is_matched() {
    let truth = truth(11);
    let shifted = |ns: i64| changed(&truth, |_, pose| pose.time_ns += ns);
    let matched =
        |estimate: &Trajectory| evaluate(estimate, &truth, &with(Alignment::None)).matched;
    assert_eq!(matched(&shifted(10_000_000)), 11);
    assert_eq!(matched(&shifted(10_000_001)), 0);
    assert_eq!(matched(&shifted(-10_000_000)), 11);
    // A longer estimate: each ground-truth pose takes one of it.
    let mut poses = Vec::new();
    for pose in truth.poses() {
        for ns in [-30_000_000, 4_000_000, 30_000_000] {
            poses.push(Pose::new(pose.time_ns + ns, pose.world_from_rig));
        }
    }
    let longer = Trajectory::new(poses).expect("rising");
    let found = evaluate(&longer, &truth, &with(Alignment::None));
    assert_eq!(found.matched, 11);
    assert!(found.absolute.expect("enough").translation_m.max < 1e-15);
}

#[test]
fn drift_is_measured_over_path_length_and_time() {
    // Straight motion at 1 m/s; the estimate is 2 % too long and rotates by 1 mrad per pose.
    let straight = changed(&truth(101), |i, pose| {
        let place = [0.1 * i as f64, 0.0, 0.0];
        pose.world_from_rig = RigidTransform::from_translation_m(place).expect("finite");
    });
    let estimate = changed(&straight, |i, pose| {
        let i = i as f64;
        let place = [0.102 * i, 0.0, 0.0];
        pose.world_from_rig =
            RigidTransform::from_rotation_vector([1e-3 * i, 0.0, 0.0], place).expect("finite");
    });
    let drift = |delta, overlapping| {
        let settings = Settings {
            deltas: vec![delta],
            overlapping,
            ..with(Alignment::First)
        };
        evaluate(&estimate, &straight, &settings).relative.remove(0)
    };
    // Rounding makes some ten steps of 0.1 m slightly less than 1 m.
    let way = drift(Delta::Meters(0.95), false);
    assert_eq!(way.translation_m.expect("10 stretches").count, 10);
    assert!((way.share.expect("a path").mean - 0.02).abs() < 1e-9);
    assert!((way.translation_m.expect("a path").max - 0.02).abs() < 1e-9);
    assert!((way.rotation_rad.expect("a path").max - 0.01).abs() < 1e-9);
    assert_eq!(
        drift(Delta::Meters(0.95), true)
            .share
            .expect("a path")
            .count,
        91
    );
    let time = drift(Delta::Seconds(2.0), false);
    assert_eq!(time.translation_m.expect("2 s").count, 5);
    assert!((time.translation_m.expect("2 s").mean - 0.04).abs() < 1e-9);
    assert_eq!(drift(Delta::Poses(25), false).share.expect("25").count, 4);
    let far = drift(Delta::Meters(11.0), true);
    assert_eq!((far.translation_m, far.share), (None, None));
    let standing = changed(&straight, |_, pose| {
        pose.world_from_rig = RigidTransform::identity()
    });
    let settings = Settings {
        deltas: vec![Delta::Seconds(1.0)],
        ..with(Alignment::None)
    };
    let standing = evaluate(&standing, &standing, &settings).relative.remove(0);
    assert_eq!(
        (standing.share, standing.translation_m.expect("1 s").max),
        (None, 0.0)
    );
}

#[test]
fn time_without_a_pose_is_a_gap() {
    let truth = truth(101);
    let whole = evaluate(&truth, &truth, &with(Alignment::Se3)).completion;
    assert_eq!(
        (whole.share, whole.truth_s, whole.gaps.len()),
        (1.0, 10.0, 0)
    );

    // Lost for poses 20 to 29: no pose is usable from 19 to 30, which is 1.1 s.
    let lost = changed(&truth, |i, pose| {
        if (20..30).contains(&i) {
            pose.status = Status::Lost;
            pose.world_from_rig = RigidTransform::identity();
        }
    });
    let found = evaluate(&lost, &truth, &with(Alignment::Se3));
    assert_eq!(
        (found.matched, found.poses.lost, found.poses.tracked),
        (91, 10, 91)
    );
    assert!(found.absolute.expect("enough").translation_m.max < 1e-12);
    assert!((found.completion.share - 0.89).abs() < 1e-12);
    assert!((found.completion.longest_gap_s() - 1.1).abs() < 1e-12);

    // Missing poses count the same, also at both ends.
    let kept = lost.usable().skip(5).cloned().collect::<Vec<_>>();
    let some = Trajectory::new(kept[..kept.len() - 10].to_vec()).expect("rising");
    let completion = evaluate(&some, &truth, &with(Alignment::Se3)).completion;
    assert_eq!(completion.gaps.len(), 3);
    assert!((completion.share - (1.0 - 0.05 - 0.11 - 0.1)).abs() < 1e-12);

    // Poses outside of the ground truth's time do not count.
    let half = Trajectory::new(truth.poses()[..51].to_vec()).expect("rising");
    assert_eq!(
        evaluate(&truth, &half, &with(Alignment::Se3))
            .completion
            .share,
        1.0
    );
}

/// Errors drawn from the stated covariance, scaled by `factor`.
fn with_errors(truth: &Trajectory, factor: f64) -> Trajectory {
    let [shift, turn] = [0.02, 0.01];
    let covariance = Covariance::from_sigmas([shift; 3], [turn; 3]).expect("sigmas");
    // Sums of twelve uniform numbers less six: nearly normal.
    let mut state = 7_u64;
    let mut normal = || {
        let mut sum = -6.0;
        for _ in 0..12 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            sum += (state >> 11) as f64 / (1_u64 << 53) as f64;
        }
        factor * sum
    };
    let mut poses = truth.poses().to_vec();
    for pose in &mut poses[1..] {
        let w: [f64; 3] = std::array::from_fn(|_| turn * normal());
        let v: [f64; 3] = std::array::from_fn(|_| shift * normal());
        let motion = RigidTransform::from_rotation_vector(w, v).expect("finite");
        pose.world_from_rig = pose.world_from_rig * motion.inverse();
        pose.covariance = Some(covariance);
    }
    Trajectory::new(poses).expect("rising")
}

#[test]
fn consistent_covariances_are_recognized_and_others_not() {
    let truth = truth(3000);
    let found = |factor: f64| {
        let estimate = with_errors(&truth, factor);
        let settings = with(Alignment::Se3);
        evaluate(&estimate, &truth, &settings)
            .consistency
            .expect("covariances")
    };
    let right = found(1.0);
    assert_eq!((right.count, right.without), (2999, 1));
    // The mean of 2999 chi-squares of 3 has a standard deviation of 0.045, of 6 of 0.063; twice 3
    // of those.
    assert!((right.nees_translation - 3.0).abs() < 0.27, "{right:?}");
    assert!((right.nees_rotation - 3.0).abs() < 0.27, "{right:?}");
    assert!((right.nees - 6.0).abs() < 0.38, "{right:?}");
    // Sums of twelve uniform numbers have lighter tails than a normal distribution.
    assert!(right.within > 0.995, "{right:?}");
    assert!(right.silently_wrong < 30, "{right:?}");
    let twice = found(2.0);
    for (of, expected) in [(&right, 1.0), (&twice, 0.5)] {
        for found in [of.sharpness_translation, of.sharpness_rotation] {
            assert!((found / expected - 1.0).abs() < 0.05, "{of:?}");
        }
    }
    assert!((twice.nees - 24.0).abs() < 1.5, "{twice:?}");
    assert!(twice.silently_wrong > 500 && twice.first_wrong_ns.is_some());
    assert!(found(0.5).within == 1.0);
}

#[test]
fn position_and_heading_are_aligned_tilt_is_not() {
    let truth = truth(50);
    let covariance = Covariance::from_sigmas([0.01; 3], [0.01; 3]).expect("sigmas");
    let stated = changed(&truth, |_, pose| pose.covariance = Some(covariance));
    let nees = |turn: [f64; 3], place: [f64; 3]| {
        let away = RigidTransform::from_rotation_vector(turn, place).expect("finite");
        let moved = changed(&stated, |_, pose| {
            pose.world_from_rig = away * pose.world_from_rig
        });
        let found = evaluate(&moved, &truth, &with(Alignment::Se3));
        found.consistency.expect("covariances")
    };
    assert!(nees([0.0, 0.0, 1.0], [5.0, 6.0, 7.0]).nees < 1e-9);
    // 0.1 rad is 10 sigmas.
    let tilted = nees([0.1, 0.0, 0.0], [0.0; 3]);
    assert!((tilted.nees_rotation - 100.0).abs() < 2.0, "{tilted:?}");
    assert_eq!(tilted.silently_wrong, 50);
    let none = evaluate(&truth, &truth, &with(Alignment::Se3));
    assert_eq!(none.consistency, None);
}

/// Results of evo 1.38.1: RMSE, mean, median, max of the absolute error in m, then of the rotation
/// in rad, with the number of poses; then RMSE over 1 m of true path and over 10 poses, m and rad,
/// with the number of segments.
struct Evo {
    estimate: &'static str,
    truth: &'static str,
    alignment: Alignment,
    poses: usize,
    translation: [f64; 4],
    rotation: [f64; 4],
    metre: (usize, f64, f64),
    ten: (usize, f64, f64),
}

const EVO: [Evo; 4] = [
    Evo {
        estimate: "freiburg1_xyz-rgbdslam.txt",
        truth: "freiburg1_xyz-groundtruth.txt",
        alignment: Alignment::Se3,
        poses: 785,
        translation: [
            0.013470088849733695,
            0.012024498709110232,
            0.011183186775061079,
            0.03475954589500904,
        ],
        rotation: [
            0.035913633072146615,
            0.03533760250975909,
            0.03492126477198465,
            0.06352284343172925,
        ],
        metre: (7, 0.025015577291434683, 0.025310674173922996),
        ten: (78, 0.014610132023888821, 0.012244730138468827),
    },
    Evo {
        estimate: "freiburg1_xyz-rgbdslam.txt",
        truth: "freiburg1_xyz-groundtruth.txt",
        alignment: Alignment::Sim3,
        poses: 785,
        translation: [
            0.013389384904168217,
            0.011986889624888907,
            0.011133899090810867,
            0.03484614485226119,
        ],
        rotation: [
            0.035913633072146615,
            0.03533760250975909,
            0.03492126477198465,
            0.06352284343172925,
        ],
        metre: (7, 0.024503281038618072, 0.025310674173922996),
        ten: (78, 0.014635713150242745, 0.012244730138468827),
    },
    Evo {
        estimate: "KITTI_00_ORB.txt",
        truth: "KITTI_00_gt.txt",
        alignment: Alignment::Se3,
        poses: 4541,
        translation: [
            1.303449714565045,
            1.1569971285389946,
            1.0656247695558074,
            3.587949120678975,
        ],
        rotation: [
            0.013199934149812497,
            0.010760241256541906,
            0.00921344239690794,
            0.11785483173528602,
        ],
        metre: (2740, 0.04587923579189293, 0.0034988554102445054),
        ten: (454, 0.19400775757969543, 0.010880555061948792),
    },
    Evo {
        estimate: "KITTI_00_ORB.txt",
        truth: "KITTI_00_gt.txt",
        alignment: Alignment::Sim3,
        poses: 4541,
        translation: [
            0.937709073611404,
            0.8726926319693136,
            0.8446910134863976,
            2.693499863613383,
        ],
        rotation: [
            0.013199934149812497,
            0.010760241256541906,
            0.00921344239690794,
            0.11785483173528602,
        ],
        metre: (2740, 0.04555202814860267, 0.0034988554102445054),
        ten: (454, 0.18926635013619342, 0.010880555061948792),
    },
];

#[test]
fn real_trajectories_have_the_errors_that_evo_gives() {
    let Some(folder) = shared("04_trajectories/evo") else {
        return;
    };
    for evo in EVO {
        let load = |name: &str| files::load(&folder.join(name), None).expect("a trajectory");
        let (estimate, truth) = (load(evo.estimate), load(evo.truth));
        files::comparable(&estimate, &truth, &folder).expect("of one kind");
        let settings = Settings {
            deltas: vec![Delta::Meters(1.0), Delta::Poses(10)],
            overlapping: false,
            ..with(evo.alignment)
        };
        let found = evaluate(&estimate.trajectory, &truth.trajectory, &settings);
        assert_eq!(found.matched, evo.poses);
        let absolute = found.absolute.expect("enough");
        let numbers = |s: &Statistics| [s.rmse, s.mean, s.median, s.max];
        // The goal is 1e-6 m; printed matrices of single precision differ slightly in how they are
        // orthonormalized.
        let check = |found: f64, expected: f64, what: &str| {
            let name = (evo.estimate, evo.alignment);
            assert!(
                (found - expected).abs() < 1e-6,
                "{what} of {name:?}: {found}, {expected}"
            );
        };
        let rotation = absolute.rotation_rad.expect("a path with rotations");
        for k in 0..4 {
            check(
                numbers(&absolute.translation_m)[k],
                evo.translation[k],
                "ATE",
            );
            check(numbers(&rotation)[k], evo.rotation[k], "turn");
        }
        for (relative, (count, metres, rad)) in found.relative.iter().zip([evo.metre, evo.ten]) {
            let translation = relative.translation_m.expect("stretches");
            assert_eq!(translation.count, count);
            check(translation.rmse, metres, "RPE");
            check(
                relative.rotation_rad.expect("stretches").rmse,
                rad,
                "RPE rotation",
            );
        }
    }
}

#[test]
fn formats_are_recognized_by_content() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("a file");
        path
    };
    let load = |path: &Path| files::load(path, None);
    let walk = truth(20);
    let (rows, times) = scene_bundle::formats::kitti::to_text(&walk);
    let tum = write("tum", &scene_bundle::formats::tum::to_text(&walk));
    let euroc = write("euroc", &scene_bundle::formats::euroc::to_text(&walk, None));
    let kitti = write("kitti", &rows);
    assert_eq!(load(&tum).expect("TUM").trajectory, walk);
    assert_eq!(load(&euroc).expect("EuRoC").trajectory, walk);
    let numbered = load(&kitti).expect("KITTI");
    assert!(numbered.is_numbered && numbered.trajectory.len() == 20);
    assert!(matches!(
        files::comparable(&numbered, &load(&tum).expect("TUM"), &kitti),
        Err(files::FileError::Numbered { .. })
    ));
    assert!(matches!(
        files::comparable(&load(&tum).expect("TUM"), &numbered, &tum),
        Err(files::FileError::Timed { .. })
    ));
    write("times.txt", &times);
    let timed = load(&kitti).expect("KITTI");
    assert!(!timed.is_numbered);
    assert_eq!(timed.trajectory.poses()[3].time_ns, walk.poses()[3].time_ns);

    let simulated = "#device_ticks,time [ns],p_x [m]\n12,1000,1,2,3,1,0,0,0\n,2000,4,5,6,1,0,0,0\n";
    let simulated = load(&write("truth.feet.csv", simulated))
        .expect("truth")
        .trajectory;
    assert_eq!(simulated.poses()[1].time_ns, 2000);
    assert_eq!(
        simulated.poses()[1].world_from_rig.translation_m(),
        [4.0, 5.0, 6.0]
    );
    let wrong = load(&write(
        "wrong",
        "#device\n1,1000,1,2,3,1,0,0,0\n2,2000,4,5,x,1,0,0,0\n",
    ));
    assert!(wrong.unwrap_err().to_string().contains("line 3"));
    let wrong = load(&write("other", "1 2 3\n")).unwrap_err().to_string();
    assert!(
        wrong.contains("found \"1 2 3\", expected 8 fields (TUM)"),
        "{wrong}"
    );
    let empty = load(&write("empty", "")).unwrap_err().to_string();
    assert!(empty.contains("found \"\""), "{empty}");
    assert!(load(&folder.path().join("none")).is_err());
}

/// Our export has times, and KITTI's ground truth (`poses/00.txt`) has none: what is compared is
/// the pose of each frame.
#[test]
fn kitti_export_with_times_is_compared_with_ground_truth_without() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        std::fs::write(&path, text).expect("a file");
        path
    };
    let walk = truth(50);
    let (rows, times) = scene_bundle::formats::kitti::to_text(&walk);
    let export = write("export/poses.txt", &rows);
    write("export/times.txt", &times);
    let dataset = write("dataset/00.txt", &rows);
    let load = |path: &Path| files::load(path, None).expect("KITTI");
    let (timed, numbered) = (load(&export), load(&dataset));
    assert!(!timed.is_numbered && numbered.is_numbered);
    for (estimate, truth) in [(&timed, &numbered), (&numbered, &timed)] {
        let (estimate, truth) = files::comparable(estimate, truth, &export).expect("by number");
        let found = evaluate(estimate, truth, &with(Alignment::None));
        assert_eq!(found.matched, 50);
        assert!(found.absolute.expect("compared").translation_m.max < 1e-12);
    }

    // An export without one of the poses: which one is not known.
    let short = rows.lines().skip(1).collect::<Vec<_>>().join("\n");
    let short = load(&write("dataset/short.txt", &short));
    let error = files::comparable(&timed, &short, &export).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("found 50 poses, expected 49") && error.contains("compared by number"),
        "{error}"
    );
}
