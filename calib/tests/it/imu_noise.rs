//! `paws calib imu` on a simulated IMU at rest: the estimates match the simulated noise.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use cad_transforms::RigidTransform;
use rig_sim::imu::{Imu, ImuFaults, ImuModel};
use rig_sim::scene::{Kind, Lighting, Scene};
use rig_sim::walker::Walker;
use serde_json::Value;
use session_archive::manifest::{self, Stop};
use session_archive::record::{Gap, ImuBatch, paws};
use session_archive::storage::DiskStorage;
use session_archive::time::{CivilTime, HostTime, NS_PER_S, TickLength};
use session_archive::writer::{SessionSpec, SessionWriter};

use crate::rendered::calib;

const START: i64 = 5_000 * NS_PER_S;
const ID: &str = "0192aa00-0000-7000-8000-000000000001";

const RATE: i64 = 100;
const PERIOD: i64 = NS_PER_S / RATE;

/// As in a ZED Mini, slower, and at constant temperature.
pub(crate) fn model() -> ImuModel {
    ImuModel {
        rate_hz: RATE as f64,
        scale_and_skew: [0.0; 2],
        warming: [0.0; 2],
        ..ImuModel::ZED_MINI
    }
}

/// Writes a session of an IMU at rest on a table, and carried during `carried`. Samples in `lost`
/// are missing.
pub(crate) fn write(
    folder: &Path,
    model: ImuModel,
    seconds: i64,
    carried: [i64; 2],
    lost: [i64; 2],
) {
    let scene = Scene::new(Kind::Corridor, Lighting::Day, 1);
    let walker = Walker::new(&scene, 1, 30.0);
    let imu = Imu::new(model, RigidTransform::identity(), seconds as f64, 11);
    let spec = SessionSpec {
        session_id: ID.to_owned(),
        name: "table".to_owned(),
        software: "tests".to_owned(),
        started: HostTime(START),
        started_civil: CivilTime(1_790_000_000 * NS_PER_S),
        chunk_ns: 10 * NS_PER_S,
        cameras: Vec::new(),
        imus: vec![manifest::Imu {
            name: "feet/imu".to_owned(),
            rate_hz: RATE as f64,
            tick: TickLength::ZED_MINI,
            source: "simulated".to_owned(),
            noise: None,
        }],
        rig: Vec::new(),
    };
    let mut writer = SessionWriter::create(Arc::new(DiskStorage::new(folder)), spec).unwrap();
    for second in 0..seconds {
        let is_lost = (lost[0]..lost[1]).contains(&second);
        let numbers = second * RATE..(second + 1) * RATE;
        let times: Vec<i64> = numbers.clone().map(|n| START + n * PERIOD).collect();
        let last = HostTime(times[times.len() - 1]);
        if is_lost {
            if second == lost[0] {
                let gap = Gap {
                    stream: "feet/imu".to_owned(),
                    first: (lost[0] * RATE) as u64,
                    last: (lost[1] * RATE - 1) as u64,
                    cause: paws::gap::Cause::Disconnected.into(),
                    ..Gap::default()
                };
                writer.append("", last, last, &gap).unwrap();
            }
            continue;
        }
        let moving = (carried[0]..carried[1]).contains(&second);
        let mut counts = [Vec::new(), Vec::new()];
        for n in numbers.clone() {
            // The walker stands at first; the walk starts after 10 s.
            let walked = (n - carried[0] * RATE) as f64 / RATE as f64;
            let at = if moving {
                (10.0 + walked).min(30.0)
            } else {
                0.0
            };
            let sample = imu.sample(&walker, n as usize, at, &ImuFaults::NONE);
            for (to, from) in counts.iter_mut().zip(imu.counts(&sample)) {
                to.extend(from.map(i32::from));
            }
        }
        let [gyro_counts, accel_counts] = counts;
        let batch = ImuBatch {
            first_number: numbers.start as u64,
            device_ticks: numbers.map(|n| n * 256).collect(),
            host_times: times.clone(),
            times,
            gyro_counts,
            gyro_scale: model.count[0],
            accel_counts,
            accel_scale: model.count[1],
            ..ImuBatch::default()
        };
        writer
            .append("feet/imu", HostTime(batch.times[0]), last, &batch)
            .unwrap();
    }
    let stop = Stop {
        at: HostTime(START + seconds * NS_PER_S),
        reason: "duration".to_owned(),
    };
    writer.close(stop).unwrap();
}

/// The files of a folder with their content.
fn files(folder: &Path) -> BTreeMap<OsString, Vec<u8>> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    let file = |entry: fs::DirEntry| (entry.file_name(), fs::read(entry.path()).unwrap());
    entries.map(file).collect()
}

#[test]
fn estimated_noise_matches_the_simulation() {
    let folder = tempfile::tempdir().unwrap();
    let (session, out) = (folder.path().join("s"), folder.path().join("out"));
    write(&session, model(), 3 * 3600, [0, 0], [0, 0]);
    let [session, to] = [&session, &out].map(|p| p.to_str().unwrap());
    let (code, text) = calib(&["imu", session, "--out", to]);
    println!("{text}");
    assert_eq!(code, Some(0), "{text}");

    let json: Value =
        serde_json::from_slice(&fs::read(out.join("imu-noise.json")).unwrap()).unwrap();
    let axes = json["imus"][0]["axes"].as_array().unwrap();
    let model = model();
    let (mut known, mut inside) = (0, 0);
    for (i, axis) in axes.iter().enumerate() {
        // Rounding to counts adds a little white noise.
        let rounding = model.count[i / 3].powi(2) / 12.0 / model.rate_hz;
        let white = (model.noise_density[i / 3].powi(2) + rounding).sqrt();
        for (key, truth, most) in [
            ("white", white, 0.002),
            ("walk", model.random_walk[i / 3], 0.3),
        ] {
            println!("{} {key}: {}, truth {truth:.4e}", axis["axis"], axis[key]);
            let Some(value) = axis[key]["value"].as_f64() else {
                let limit = axis[key]["below_95"].as_f64().unwrap();
                assert!(key == "walk" && limit > truth, "{i} {key}");
                continue;
            };
            let sigma = axis[key]["sigma"].as_f64().unwrap();
            let off = (value - truth).abs();
            assert!(off < 3.5 * sigma && sigma < most * truth, "{i} {key}");
            known += 1;
            inside += u32::from(off < 2.0 * sigma);
        }
    }
    // Three hours are just enough to determine the random walk of the gyroscope.
    assert!(
        known >= 10 && inside + 2 >= known,
        "{inside} of {known} within two sigma"
    );

    let yaml = fs::read_to_string(out.join("feet_imu-noise.yaml")).unwrap();
    for key in [
        "gyroscope_noise_density",
        "gyroscope_random_walk",
        "accelerometer_noise_density",
    ] {
        assert!(yaml.lines().any(|line| line.starts_with(key)), "{yaml}");
    }
    for file in ["imu-noise.html", "feet_imu-gyro.svg", "feet_imu-accel.svg"] {
        assert!(out.join(file).is_file(), "{file}");
    }

    // Nothing is overwritten without `--force`, and with it the result is the same.
    let before = files(&out);
    let (code, text) = calib(&["imu", session, "--out", to]);
    assert!(
        code == Some(1) && text.contains("--force was not given"),
        "{text}"
    );
    let (code, _) = calib(&["imu", session, "--out", to, "--force"]);
    assert_eq!(code, Some(0));
    assert_eq!(files(&out), before);
}

#[test]
fn motion_and_gaps_are_reported_and_a_walk_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let (session, out) = (folder.path().join("s"), folder.path().join("out"));
    write(&session, model(), 900, [12, 30], [500, 540]);
    let [path, to] = [&session, &out].map(|p| p.to_str().unwrap());
    let (code, text) = calib(&["imu", path, "--out", to]);
    assert_eq!(code, Some(0), "{text}");
    assert!(
        text.contains("the IMU moved between 12.0 s and 30.0 s"),
        "{text}"
    );
    assert!(text.contains("a gap cut the recording"), "{text}");
    assert!(
        text.contains("random walk K not determined by this recording"),
        "{text}"
    );
    let yaml = fs::read_to_string(out.join("feet_imu-noise.yaml")).unwrap();
    assert!(
        yaml.contains("# gyroscope_random_walk: not determined"),
        "{yaml}"
    );
    assert!(!yaml.contains("\ngyroscope_random_walk:"), "{yaml}");

    let walk = folder.path().join("walk");
    write(&walk, model(), 20, [0, 20], [0, 0]);
    let out = folder.path().join("refused");
    let [path, to] = [&walk, &out].map(|p| p.to_str().unwrap());
    let (code, text) = calib(&["imu", path, "--out", to]);
    assert_eq!(code, Some(1), "{text}");
    assert!(
        text.contains("REFUSED  moved: the IMU moved all the time"),
        "{text}"
    );
    assert!(!out.join("feet_imu-noise.yaml").exists());
    let (code, text) = calib(&["imu", path, "--imu", "left/imu", "--out", to, "--force"]);
    assert!(
        code == Some(1) && text.contains("the session has feet/imu"),
        "{text}"
    );
    let (code, text) = calib(&["imu", path]);
    assert!(
        code == Some(1) && text.contains("--out names another path"),
        "{text}"
    );
}
