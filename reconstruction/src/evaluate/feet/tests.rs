use cad_transforms::rig::Foot;
use cad_transforms::{Covariance, RigidTransform};
use scene_bundle::outputs::contacts::ContactEvent;
use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::{FREE, SAMPLED};

use super::*;

/// Steps of the left foot, one per second from the second one on, 0.5 m each; it is at rest for
/// 0.4 s.
const CONTACTS: &str = "#\n\
    left,1000000000,1100000000,1500000000,1600000000,0,0,0.1,1,0,0,0\n\
    left,2000000000,2100000000,2500000000,2600000000,0.5,0,0.1,1,0,0,0\n\
    left,3000000000,3100000000,3500000000,3600000000,1,0,0.1,1,0,0,0\n\
    left,4000000000,4100000000,,,1.5,0,0.1,1,0,0,0\n";

fn truth() -> GroundTruth {
    let folder = tempfile::tempdir().expect("a folder");
    let mut poses = "#\n".to_owned();
    for step in 0..=50 {
        let (ns, x) = (i64::from(step) * 100_000_000, 0.05 * f64::from(step));
        poses += &format!("{ns},left,swing,{x},0,0.2,1,0,0,0\n");
    }
    std::fs::write(folder.path().join("truth.contacts.csv"), CONTACTS).expect("write");
    std::fs::write(folder.path().join("truth.foot-poses.csv"), poses).expect("write");
    let truth = GroundTruth::of_folder(folder.path()).expect("good files");
    truth.expect("files")
}

fn at(x: f64, y: f64, z: f64) -> RigidTransform {
    RigidTransform::from_rotation_vector([0.0; 3], [x, y, z]).expect("finite")
}

/// The estimate's world is 10 m beside the true one.
fn aligned() -> Similarity {
    Similarity {
        rigid: at(10.0, 0.0, 0.0),
        scale: 1.0,
        rotation_is_known: true,
    }
}

fn contact(strike_s: f64, x: f64) -> FootContact {
    let event = |after_s: f64| ContactEvent {
        time_ns: ((strike_s + after_s) * 1e9) as i64,
        sigma_s: 0.01,
        is_seen: true,
    };
    FootContact {
        foot: Foot::Left,
        events: [event(0.0), event(0.1), event(0.5), event(0.61)],
        world_from_foot: at(x - 10.0, 0.003, 0.1),
        covariance: Covariance::from_sigmas([0.003; 3], [0.003; 3]).expect("positive"),
    }
}

fn pose(time_s: f64, status: FootStatus) -> FootPose {
    let place = at(0.5 * time_s - 10.0, 0.03, 0.2);
    FootPose {
        foot: Foot::Left,
        time_ns: (time_s * 1e9) as i64,
        world_from_foot: place,
        rig_from_foot: place,
        covariance: Some(Covariance::from_sigmas([0.02; 3], [0.02; 3]).expect("positive")),
        status,
    }
}

#[test]
fn contacts_are_matched_and_their_errors_are_those_given() {
    let poses: Vec<FootPose> = [0.0, 1.7, 1.8, 4.9]
        .into_iter()
        .map(|s| match s {
            0.0 => pose(s, FootStatus::Lost),
            _ => pose(s, FootStatus::Bridged),
        })
        .collect();
    // The second one is missing, one is 20 ms late, one is none.
    let mut none = contact(2.0, 0.5);
    none.foot = Foot::Right;
    let contacts = [contact(1.02, 0.0), none, contact(3.0, 1.0)];
    let found = evaluate_feet(&contacts, &poses, &truth(), &aligned());
    assert_eq!((found.contacts, found.found, found.invented), (3, 2, 1));
    let position = found.position_m.expect("pairs");
    assert!((position.rmse - 0.003).abs() < 1e-9, "{position:?}");
    let strike = found.heel_strike_s.expect("pairs");
    assert!(
        (strike.max - 0.02).abs() < 1e-6 && strike.median < 0.011,
        "{strike:?}"
    );
    let toe_off = found.toe_off_s.expect("pairs");
    assert!((toe_off.max - 0.03).abs() < 1e-6, "{toe_off:?}");
    let bridged = found.bridged_m.expect("bridged poses");
    assert_eq!(bridged.count, 3);
    assert!((bridged.max - 0.03).abs() < 1e-6, "{bridged:?}");
    // 1.5 sigmas.
    assert_eq!((found.bridged_within, found.lost), (1.0, 0.25));
}

#[test]
fn without_poses_there_is_nothing_to_compare() {
    let found = evaluate_feet(&[], &[], &truth(), &aligned());
    assert_eq!(found, FeetEvaluation::default());
}

#[test]
fn heights_are_compared_under_footsteps_on_their_storey() {
    let grid = Grid {
        cell_m: 0.1,
        origin_m: [-10.0, 0.0],
        columns: 11,
        rows: 1,
    };
    let level = |height: f32, flag: u8| {
        let mut level = MapLevel::unknown(grid);
        level.elevation.fill(height);
        level.flags.fill(flag);
        level.occupancy.fill(FREE);
        level
    };
    // Another storey, then ground 2 cm too high.
    let mut ground = level(0.12, KNOWN);
    ground.flags[5] = SAMPLED;
    let levels = [level(3.0, KNOWN), ground];
    let found = evaluate_ground(&levels, &truth(), 0..=5_000_000_000, &aligned());
    // The fourth one has no end within the recording.
    assert_eq!((found.footsteps, found.shown), (3, 2));
    let height = found.height_m.expect("ground");
    assert!(
        (height.max - 0.02).abs() < 1e-6 && height.count == 3,
        "{height:?}"
    );
    let none = evaluate_ground(&levels[..1], &truth(), 0..=5_000_000_000, &aligned());
    assert_eq!((none.footsteps, none.height_m), (3, None));
}
