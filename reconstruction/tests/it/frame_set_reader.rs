//! Frame sets for odometry: the same images and samples, through another interface.

use std::collections::BTreeMap;

use reconstruction::input::Input;
use reconstruction::pipeline::stages::frame_set_reader::FrameSetReader;
use reconstruction::pipeline::stages::rig::{self, RigOverrides};
use session_archive::time::HostTime;
use session_input::Color;

use crate::session::{hand_over, hand_over_with};

/// A rig file with the extrinsics of both cameras and the IMU.
pub(crate) const RIG: &str = include_str!("../../../cad-transforms/rigs/example.toml");

/// The session has no intrinsics of this camera.
pub(crate) fn rig_overrides(folder: &std::path::Path) -> RigOverrides {
    let file = folder.join("K.txt");
    std::fs::write(&file, "60 0 36.5 0 60 24.5 0 0 1\n0.063\n").expect("a file");
    let (calibration, _) = calibration_files::read_stereo(&file, 74, 50).expect("a calibration");
    RigOverrides {
        rig: Some(RIG.to_owned()),
        calibrations: BTreeMap::from([("feet".to_owned(), calibration)]),
        ..RigOverrides::default()
    }
}

#[test]
fn luma_frame_sets_have_samples_up_to_the_last_image() {
    let folder = tempfile::tempdir().expect("folder");
    let recorded = hand_over(folder.path());
    let input = Input::open(folder.path()).expect("open");
    let all = input.session().imu("feet/imu", ..).expect("imu");
    let mut given = Vec::new();
    let sets = input.session().sets().expect("sets");
    let luma_frame_sets = input.session().luma_frame_sets(..).expect("sets");
    assert_eq!(luma_frame_sets.len(), recorded.sets.len());
    for (set, grey) in sets.zip(luma_frame_sets) {
        let set = set.expect("a set");
        assert_eq!((set.number, set.time), (grey.number, grey.time));
        assert!(grey.losses.is_empty());
        for (view, grey) in set.views.iter().zip(&grey.views) {
            assert_eq!(view.is_some(), grey.is_some());
            let (Some(view), Some(grey)) = (view, grey) else {
                continue;
            };
            assert_eq!((view.number, view.time), (grey.number, grey.time));
            assert_eq!(grey.left.color, Color::Grey);
            assert_eq!(
                grey.right.data.len(),
                (grey.right.width * grey.right.height) as usize
            );
            match view.left.color {
                Color::Grey => assert_eq!((&view.left, &view.right), (&grey.left, &grey.right)),
                Color::Rgb => {
                    // Luma of full-range BT.601 out of rounded RGB is within a level or so.
                    let luma = |p: &[u8]| {
                        0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2])
                    };
                    let pixels = view.left.data.chunks_exact(3).map(luma);
                    let apart = pixels
                        .zip(&*grey.left.data)
                        .map(|(a, b)| (a - f64::from(*b)).abs());
                    let mean = apart.sum::<f64>() / grey.left.data.len() as f64;
                    assert!(mean < 1.0, "{mean}");
                }
            }
        }
        let latest = grey.views.iter().flatten().map(|v| v.time).max();
        let latest = latest.map_or(grey.time, |t| t.max(grey.time));
        given.extend(grey.imu[0].iter().copied());
        let [.., before, last] = &given[..] else {
            panic!("no samples");
        };
        assert!(before.time_ns < latest.ns() && latest.ns() <= last.time_ns);
    }
    // Each once, and nothing left out.
    assert_eq!(given[..], all[..given.len()]);
    assert!(given.len() > 480);

    // From the middle on, samples begin after the previous set.
    let from = HostTime(recorded.sets[20].time);
    let mut part = input.session().luma_frame_sets(from..).expect("sets");
    let first = part.next().expect("a set");
    assert_eq!(first.number, 20);
    assert!(first.imu[0][0].time_ns > recorded.sets[19].time);
    assert!(first.imu[0].len() < 40, "{}", first.imu[0].len());
}

#[test]
fn an_unreadable_frame_is_a_loss_and_the_rest_of_its_set_is_returned() {
    let folder = tempfile::tempdir().expect("folder");
    let recorded = hand_over_with(folder.path(), |camera, number, mut unit| {
        if camera == "feet" && number == 110 {
            unit.data = vec![0; 30].into();
        }
        unit
    });
    let input = Input::open(folder.path()).expect("open");
    let luma_frame_sets: Vec<_> = input.session().luma_frame_sets(..).expect("sets").collect();
    assert_eq!(luma_frame_sets.len(), recorded.sets.len());
    let losses: Vec<String> = luma_frame_sets
        .iter()
        .flat_map(|set| &set.losses)
        .map(|e| e.to_string())
        .collect();
    assert!(
        losses.contains(&"reading frame 110 of feet".to_owned()),
        "{losses:?}"
    );
    let lossy = luma_frame_sets
        .iter()
        .find(|set| !set.losses.is_empty())
        .expect("a loss");
    assert!(lossy.views[0].is_some() && lossy.views[1].is_none());
}

#[test]
fn frame_sets_follow_the_cameras_of_the_rig_in_its_order() {
    let folder = tempfile::tempdir().expect("folder");
    let recorded = hand_over(folder.path());
    let input = Input::open(folder.path()).expect("open");
    let (mut model, _) = rig::model(&input, &rig_overrides(folder.path())).expect("a rig");
    model.cameras.reverse();
    let frame_set_reader = FrameSetReader::new(&input, &model).expect("a feed");
    assert_eq!(frame_set_reader.len(), recorded.sets.len());
    for (set, expected) in frame_set_reader.zip(&recorded.sets) {
        assert_eq!(set.time_ns, expected.time);
        let borrowed = set.borrowed();
        assert!(borrowed.views[1].is_some());
        assert_eq!(
            borrowed.views[0].is_none(),
            expected.missing.contains(&"feet".to_owned())
        );
        assert!(set.imu[0].windows(2).all(|w| w[0].time_ns < w[1].time_ns));
    }
    model.cameras.truncate(1);
    model.imus.clear();
    let set = FrameSetReader::new(&input, &model)
        .expect("a feed")
        .next()
        .expect("a set");
    assert_eq!((set.views.len(), set.imu.len()), (1, 0));
    model.cameras[0].name = "head".to_owned();
    assert!(FrameSetReader::new(&input, &model).is_err());
}
