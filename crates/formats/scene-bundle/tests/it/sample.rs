//! A small bundle with every output, with numbers chosen so that no two can be confused.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use cad_transforms::{Covariance, RigidTransform};
use camera_models::{CameraModel, Distortion, Eye, ImuNoise};
use scene_bundle::outputs::cloud::CloudPoint;
use scene_bundle::outputs::depth::{DepthImage, DepthKey, DepthView, DepthWriter};
use scene_bundle::outputs::keyframes::Keyframe;
use scene_bundle::outputs::masks::Mask;
use scene_bundle::outputs::rig::{RigCamera, RigImu, RigModel};
use scene_bundle::outputs::{self, cloud, keyframes, masks, rig, trajectory};
use scene_bundle::{
    Bundle, Draft, Pose, Provenance, Record, RigRevision, Scene, Status, Trajectory,
};

use crate::{ground, splats};

pub(crate) const START_NS: i64 = 1_403_715_273_262_142_976;

pub(crate) struct Sample {
    pub(crate) folder: tempfile::TempDir,
    pub(crate) path: PathBuf,
}

impl Sample {
    pub(crate) fn new() -> Self {
        Self::with(&rig_model())
    }

    /// The same with another rig.
    pub(crate) fn with(rig_model: &RigModel) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let path = folder.path().join("walk.scene");
        let bundle = Bundle::create_or_open(&path, provenance()).expect("a new bundle");
        let put = |name: &str, write: &dyn Fn(&Draft)| {
            let draft = bundle.begin(name).expect("a draft");
            write(&draft);
            draft.commit(record(name)).expect("committed");
        };
        put(outputs::RIG, &|d| rig::write(d, rig_model).unwrap());
        put(outputs::TRAJECTORY, &|d| {
            trajectory::write(d, &walk(0.0)).unwrap()
        });
        put(outputs::TRAJECTORY_CAUSAL, &|d| {
            trajectory::write(d, &walk(0.01)).unwrap()
        });
        put(outputs::KEYFRAMES, &|d| {
            keyframes::write(d, &keyframe_table(rig_model)).unwrap()
        });
        put(outputs::MASKS, &|d| {
            masks::write(d, "feet", Eye::Left, &mask()).unwrap();
            let frame = keyframe_table(rig_model)[0].frame;
            masks::write_dynamic(d, &rig_model.cameras[0].name, frame, &moving()).unwrap();
        });
        put(outputs::TERRAIN, &ground::write_terrain);
        put(outputs::MAPS, &ground::write_maps);
        put(outputs::COLLISION, &ground::write_collision);
        put(outputs::SPLATS, &splats::write);
        put(outputs::CLOUD, &|d| cloud::write(d, &points()).unwrap());
        put(outputs::DEPTH, &|d| {
            let writer = DepthWriter::new(d, vec![view()]).unwrap();
            for key in depth_keys() {
                writer.write(key, &depth_image(key.frame)).unwrap();
            }
            writer.finish().unwrap();
        });
        bundle.finish(START_NS + 9_000_000_000).expect("finished");
        Self { folder, path }
    }

    pub(crate) fn scene(&self) -> Scene {
        Scene::open(&self.path).expect("the bundle opens")
    }

    pub(crate) fn out(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Empty files where `paws-reconstruct frames` would have written images, except for one.
    pub(crate) fn images(&self, without: &str) -> PathBuf {
        let folder = self.out("frames");
        for keyframe in keyframe_table(&rig_model()) {
            for eye in ["left", "right"] {
                let camera = &rig_model().cameras[usize::from(keyframe.camera)].name;
                let name = format!("{camera}/{eye}/{:06}.png", keyframe.frame);
                let path = folder.join(&name);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                if name != without {
                    std::fs::write(path, "").unwrap();
                }
            }
        }
        folder
    }
}

/// All files below a folder with their contents.
pub(crate) fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        if entry.file_type().unwrap().is_dir() {
            let below = files(&entry.path());
            found.extend(
                below
                    .into_iter()
                    .map(|(path, bytes)| (format!("{name}/{path}"), bytes)),
            );
        } else {
            found.insert(name, std::fs::read(entry.path()).unwrap());
        }
    }
    found
}

pub(crate) fn provenance() -> Provenance {
    Provenance {
        session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
        handoff_blake3: "ab".repeat(32),
        judgement: None,
        rig: RigRevision {
            name: "chest".to_owned(),
            revision: "B".to_owned(),
        },
        program: "paws-reconstruct".to_owned(),
        program_version: "0.1.0".to_owned(),
        started_civil_ns: START_NS,
        ended_civil_ns: None,
    }
}

pub(crate) fn record(name: &str) -> Record {
    Record {
        stage: format!("make-{name}"),
        stage_version: 1,
        settings: serde_json::json!({ "threads": 2 }),
        inputs: BTreeMap::from([("handoff".to_owned(), "ab".repeat(32))]),
    }
}

pub(crate) fn rig_model() -> RigModel {
    let narrow = Distortion::RadTan5 {
        k1: -0.12,
        k2: 0.03,
        p1: 0.001,
        p2: -0.0005,
        k3: 0.002,
    };
    let lens =
        |cx: f64, distortion| CameraModel::new((64, 48), [51.25, 50.5, cx, 23.75], distortion);
    let camera = |name: &str, turn: [f64; 3], left: CameraModel| RigCamera {
        name: name.to_owned(),
        left,
        right: CameraModel {
            cx: left.cx + 0.5,
            ..left
        },
        rig_from_left: RigidTransform::from_rotation_vector(turn, [0.1, turn[1], 0.05]).unwrap(),
        rig_from_left_covariance: Some(
            Covariance::from_sigmas([1e-4, 2e-4, 3e-4], [1e-3; 3]).unwrap(),
        ),
        right_from_left: RigidTransform::from_rotation_vector(
            [0.0, 0.01, 0.0],
            [-0.063, 0.0, 0.001],
        )
        .unwrap(),
        right_from_left_covariance: None,
        line_s: if name == "feet" { 2.5e-5 } else { 0.0 },
    };
    RigModel {
        name: "chest".to_owned(),
        revision: "B".to_owned(),
        cameras: vec![
            camera("left_shoulder", [1.2, -1.2, 1.2], lens(31.0, narrow)),
            camera(
                "feet",
                [2.2, -0.1, 0.3],
                lens(
                    32.125,
                    Distortion::RadTan4 {
                        k1: 0.1,
                        k2: -0.02,
                        p1: 0.0,
                        p2: 0.0,
                    },
                ),
            ),
        ],
        imus: vec![RigImu {
            name: "feet/imu".to_owned(),
            rig_from_imu: RigidTransform::from_translation_m([0.0, 0.01, 0.02]).unwrap(),
            rig_from_imu_covariance: None,
            rate_hz: Some(800.0),
            noise: Some(ImuNoise {
                gyro_noise_density: 1e-4,
                gyro_random_walk: 1e-6,
                accel_noise_density: 1e-3,
                accel_random_walk: 1e-5,
            }),
            range: Some([17.5, 78.5]),
        }],
        shoes: Vec::new(),
    }
}

pub(crate) fn walk(off: f64) -> Trajectory {
    let poses = (0..40).map(|i| {
        let s = f64::from(i);
        let turn = [0.01 * s, 0.2, 0.1 * s - 2.0];
        let covariance = Covariance::from_sigmas([1e-3 * (s + 1.0); 3], [1e-4; 3]).unwrap();
        let world_from_rig =
            RigidTransform::from_rotation_vector(turn, [0.1 * s + off, (s * 0.7).sin(), 1.4])
                .unwrap();
        Pose {
            time_ns: START_NS + i64::from(i) * 33_333_333,
            world_from_rig,
            // Moved, so that the covariance is not diagonal.
            covariance: (i % 3 != 0).then(|| covariance.moved(&world_from_rig)),
            velocity_in_world: (i != 5).then_some([1.4, -0.1 * s, 1e-9]),
            status: Status::from_code((i / 10) as u8).unwrap(),
        }
    });
    Trajectory::new(poses.collect()).unwrap()
}

/// Three keyframes of each camera, not in order.
pub(crate) fn keyframe_table(rig: &RigModel) -> Vec<Keyframe> {
    let all = (0..rig.cameras.len()).flat_map(|camera| {
        (0..3_u32).rev().map(move |i| {
            let s = f64::from(i);
            let turn = [-1.5, 0.1 * s, 0.3 + camera as f64];
            Keyframe {
                set: u64::from(10 * i),
                frame: u64::from(10 * i) + 1_000_000 * camera as u64,
                time_ns: START_NS + i64::from(i) * 333_333_330 + camera as i64,
                camera: camera as u8,
                world_from_left: RigidTransform::from_rotation_vector(turn, [s, -s, 1.25]).unwrap(),
            }
        })
    });
    all.collect()
}

pub(crate) fn mask() -> Mask {
    Mask {
        width: 64,
        height: 48,
        pixels: (0..64 * 48)
            .map(|i| if i / 64 > 40 { 0 } else { 255 })
            .collect(),
    }
}

/// Dynamic pixels on the left.
pub(crate) fn moving() -> Mask {
    Mask {
        pixels: (0..64 * 48)
            .map(|i| if i % 64 < 20 { 0 } else { 255 })
            .collect(),
        ..mask()
    }
}

pub(crate) fn view() -> DepthView {
    DepthView {
        camera: "feet".to_owned(),
        model: CameraModel::new((60, 40), [50.0, 50.0, 30.0, 20.0], Distortion::None),
        view_from_left: RigidTransform::from_rotation_vector([0.01, 0.0, -0.02], [0.0; 3]).unwrap(),
    }
}

/// Of all keyframes of the camera `feet`, the last one first.
pub(crate) fn depth_keys() -> Vec<DepthKey> {
    let keyframes = keyframe_table(&rig_model())
        .into_iter()
        .filter(|k| k.camera == 1);
    let keys = keyframes.map(|k| DepthKey {
        view: 0,
        time_ns: k.time_ns,
        frame: k.frame,
        set: k.set,
    });
    keys.collect()
}

pub(crate) fn depth_image(frame: u64) -> DepthImage {
    let metres = |i: i32| 1.0 + (frame % 7) as f32 * 0.25 + i as f32 * 0.001;
    let depth: Vec<f32> = (0..60 * 40).map(metres).collect();
    let sigma: Vec<f32> = depth.iter().map(|d| d * d * 0.004).collect();
    DepthImage::from_metres(60, 40, &depth, &sigma)
}

pub(crate) fn points() -> Vec<CloudPoint> {
    let points = (0..500_u16).map(|i| {
        let s = f32::from(i);
        CloudPoint {
            x_in_world: [s * 0.37 - 60.0, (s * 0.1).sin() * 7.0, s * 1e-3 - 0.1],
            color: [i as u8, 255 - i as u8, (i / 2) as u8],
            sigma_m: 0.001 * s,
        }
    });
    points.collect()
}
