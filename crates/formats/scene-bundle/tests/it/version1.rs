//! A small bundle of version 1 of the format, as it was written once (`tests/data/version1.scene`).
//! It must stay readable, and the same numbers must give the same bytes; a change of either is a
//! new version.
//!
//! `it_is_still_written` leaves what it wrote in `target/tmp`; until version 1 is released, the
//! fixture may be exchanged for that (without `lock`).
//!
//! The numbers are short binary fractions, so they are the same on every machine.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use cad_transforms::{Covariance, RigidTransform};
use camera_models::{CameraModel, Distortion, Eye};
use scene_bundle::outputs::cloud::CloudPoint;
use scene_bundle::outputs::depth::{DepthImage, DepthKey, DepthView, DepthWriter};
use scene_bundle::outputs::keyframes::Keyframe;
use scene_bundle::outputs::masks::Mask;
use scene_bundle::outputs::rig::{RigCamera, RigImu, RigModel};
use scene_bundle::outputs::{self, cloud, depth, keyframes, masks, rig, trajectory};
use scene_bundle::verify::verify;
use scene_bundle::{Bundle, Draft, Pose, Record, Scene, Status, Trajectory};

use crate::sample::{files, provenance};

fn fixture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/version1.scene")
}

fn turned(place: [f64; 3]) -> RigidTransform {
    RigidTransform::from_wxyz([0.5, -0.5, 0.5, -0.5], place).unwrap()
}

fn model() -> RigModel {
    let distortion = Distortion::KannalaBrandt4 {
        k1: 0.125,
        k2: -0.25,
        k3: 0.0,
        k4: 0.0625,
    };
    let lens = CameraModel::new((4, 2), [3.5, 3.25, 1.5, 0.5], distortion);
    RigModel {
        name: "chest".to_owned(),
        revision: "B".to_owned(),
        cameras: vec![RigCamera {
            name: "feet".to_owned(),
            left: lens,
            right: lens,
            rig_from_left: turned([0.125, 0.0, -0.25]),
            rig_from_left_covariance: Some(
                Covariance::from_sigmas([0.25, 0.5, 1.0], [0.125; 3]).unwrap(),
            ),
            right_from_left: RigidTransform::from_translation_m([-0.0625, 0.0, 0.0]).unwrap(),
            right_from_left_covariance: None,
            line_s: 0.0009765625,
        }],
        imus: vec![RigImu {
            name: "feet/imu".to_owned(),
            rig_from_imu: RigidTransform::identity(),
            rig_from_imu_covariance: None,
            rate_hz: Some(800.0),
            noise: None,
            range: Some([32.0, 128.0]),
        }],
        shoes: Vec::new(),
    }
}

fn walk() -> Trajectory {
    let poses = (0..8_u8).map(|i| Pose {
        time_ns: i64::MAX - 8 + i64::from(i),
        world_from_rig: turned([f64::from(i), -0.5, 1.25]),
        covariance: (i % 2 == 0)
            .then(|| Covariance::from_sigmas([0.5, 0.25, 0.125], [0.0625; 3]).unwrap()),
        velocity_in_world: (i > 2).then_some([1.5, 0.0, -0.75]),
        status: Status::from_code(i / 2).unwrap(),
    });
    Trajectory::new(poses.collect()).unwrap()
}

fn keyframe() -> Keyframe {
    Keyframe {
        set: u64::MAX,
        frame: 7,
        time_ns: -3,
        camera: 0,
        world_from_left: turned([1.0, 2.0, 3.0]),
    }
}

fn mask() -> Mask {
    Mask {
        width: 4,
        height: 2,
        pixels: vec![255, 255, 0, 255, 0, 0, 0, 0],
    }
}

fn view() -> DepthView {
    DepthView {
        camera: "feet".to_owned(),
        model: CameraModel::new((3, 2), [2.0, 2.0, 1.0, 0.5], Distortion::None),
        view_from_left: RigidTransform::identity(),
    }
}

fn depth_image() -> DepthImage {
    DepthImage {
        width: 3,
        height: 2,
        depth: vec![1000, 0, 65535, 1, 258, 513],
        sigma: vec![100, 0, 65535, 1, 3, 2],
    }
}

fn points() -> Vec<CloudPoint> {
    let point = |x: f32, color| CloudPoint {
        x_in_world: [x, -0.5, 1.25],
        color,
        sigma_m: 0.0625,
    };
    vec![point(2.0, [1, 2, 3]), point(-7.5, [255, 128, 0])]
}

/// Writes the bundle.
fn write(path: &Path) {
    let bundle = Bundle::create_or_open(path, provenance()).unwrap();
    let key = DepthKey {
        view: 0,
        time_ns: -3,
        frame: 7,
        set: u64::MAX,
    };
    let put = |name: &str, write: &dyn Fn(&Draft)| {
        let draft = bundle.begin(name).unwrap();
        write(&draft);
        let record = Record {
            stage: format!("make-{name}"),
            stage_version: 3,
            settings: serde_json::json!({ "rate_hz": 0.5, "names": ["a", "b"] }),
            inputs: BTreeMap::from([("handoff".to_owned(), "ab".repeat(32))]),
        };
        draft.commit(record).unwrap();
    };
    put(outputs::RIG, &|d| rig::write(d, &model()).unwrap());
    put(outputs::TRAJECTORY, &|d| {
        trajectory::write(d, &walk()).unwrap()
    });
    put(outputs::KEYFRAMES, &|d| {
        keyframes::write(d, &[keyframe()]).unwrap()
    });
    put(outputs::MASKS, &|d| {
        masks::write(d, "feet", Eye::Right, &mask()).unwrap()
    });
    put(outputs::CLOUD, &|d| cloud::write(d, &points()).unwrap());
    put(outputs::DEPTH, &|d| {
        let writer = DepthWriter::new(d, vec![view()]).unwrap();
        writer.write(key, &depth_image()).unwrap();
        writer.finish().unwrap();
    });
    bundle.finish(1).unwrap();
}

#[test]
fn version_1_is_still_read() {
    let scene = Scene::open(&fixture()).unwrap();
    assert_eq!(scene.manifest().version, 1);
    let checked = verify(&scene, |_| {}).unwrap();
    assert!(
        checked.is_whole() && checked.unnamed.is_empty(),
        "{checked:?}"
    );
    let of = |name: &str| scene.output(name).unwrap();
    assert_eq!(rig::read(&of(outputs::RIG)).unwrap(), model());
    assert_eq!(trajectory::read(&of(outputs::TRAJECTORY)).unwrap(), walk());
    let spans = trajectory::read_spans(&of(outputs::TRAJECTORY)).unwrap();
    assert_eq!(spans, walk().spans());
    assert_eq!(
        keyframes::read(&of(outputs::KEYFRAMES)).unwrap(),
        [keyframe()]
    );
    let found = masks::read(&of(outputs::MASKS), "feet", Eye::Right).unwrap();
    assert_eq!(found, Some(mask()));
    assert_eq!(cloud::read(&of(outputs::CLOUD)).unwrap(), points());
    let index = depth::read_index(&of(outputs::DEPTH)).unwrap();
    assert_eq!(index.views, [view()]);
    let found = depth::read(&of(outputs::DEPTH), &index, &index.images[0]).unwrap();
    assert_eq!(found, depth_image());
    let output = &scene.manifest().outputs[outputs::RIG];
    assert_eq!(
        (output.stage.as_str(), output.stage_version),
        ("make-rig", 3)
    );
    assert_eq!(scene.manifest().provenance.ended_civil_ns, Some(1));
}

/// Version 1 has no verdict on the session, which is not the same as a session without fault.
#[test]
fn an_unknown_verdict_is_shown() {
    let shown = Command::new(env!("CARGO_BIN_EXE_paws-scene"))
        .arg("show")
        .arg(fixture())
        .output()
        .unwrap();
    assert_eq!(shown.status.code(), Some(0), "{shown:?}");
    let text = String::from_utf8(shown.stdout).unwrap();
    let note = "verdict            not known: the bundle does not say\n";
    assert!(text.contains(note), "{text}");
    assert!(!text.contains("accepted"), "{text}");
}

#[test]
fn it_is_still_written() {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("version1.scene");
    let _ = std::fs::remove_dir_all(&path);
    write(&path);
    // Which bytes a PNG has for the same pixels is the compressor's business, and hashes of those
    // and names after them follow; everything else is ours.
    let ours = |folder: &Path| -> BTreeMap<String, Vec<u8>> {
        let all = files(folder).into_iter();
        let ours = all.filter(|(path, _)| ["npy", "ply", "json"].iter().any(|e| path.ends_with(e)));
        ours.map(|(path, bytes)| match path.split_once('/') {
            Some((folder, file)) => (
                format!("{}/{file}", folder.split('.').next().unwrap()),
                bytes,
            ),
            None => (path, Vec::new()),
        })
        .collect()
    };
    let mut stored = ours(&fixture());
    // The only name that changed.
    let index = stored.get_mut("depth/depth.json").unwrap();
    let renamed = String::from_utf8_lossy(index).replace("\"pictures\"", "\"images\"");
    *index = renamed.into_bytes();
    assert_eq!(ours(&path), stored);
}
