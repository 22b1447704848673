//! A walk as a session archive and as a film, read back.

use std::sync::Arc;

use cad_transforms::rig::Rig;
use rig_sim::calibration_error::CalibrationError;
use rig_sim::camera::Quality;
use rig_sim::faults::{Fault, Faults, Kind as FaultKind};
use rig_sim::preview::film::film;
use rig_sim::render::session::{BEGIN, SessionError, write};
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation};
use session_archive::reader::{Entry, SessionReader};
use session_archive::record::{
    CameraCalibration, Frame, FrameSet, FrameTransforms, Gap, ImuBatch, Record,
};
use session_archive::storage::DiskStorage;
use session_archive::verify::verify;

const RIG: &str = include_str!("../../../../cad-transforms/rigs/example.toml");
const SECONDS: f64 = 3.0;

fn rig() -> Rig {
    Rig::parse(RIG).unwrap()
}

fn walk() -> Arc<Simulation> {
    let settings = Settings {
        kind: Kind::Corridor,
        lighting: Lighting::Day,
        seed: 1,
        seconds: SECONDS,
        rate_hz: 10.0,
        width: 64,
        height: 36,
        quality: Quality::FAST,
    };
    Arc::new(Simulation::new(&settings, &rig()).unwrap())
}

fn fault(kind: FaultKind, strength: f64, from_s: f64) -> Fault {
    Fault {
        kind,
        strength,
        from_s,
        to_s: f64::INFINITY,
        camera: Some("feet".to_owned()),
        foot: None,
    }
}

/// All records of a kind, in the order stored.
fn records<R: Record + Default>(reader: &SessionReader) -> Vec<R> {
    let streams = &reader.manifest().streams;
    let mut found = Vec::new();
    for entry in reader.entries() {
        let Entry::Message(message) = entry.unwrap() else {
            continue;
        };
        let stream = streams.iter().find(|s| s.id == message.stream);
        if stream.is_some_and(|s| s.schema == R::SCHEMA.name) {
            found.push(message.decode().unwrap());
        }
    }
    found
}

#[test]
fn session_is_valid_and_contains_ground_truth() {
    let folder = tempfile::tempdir().unwrap();
    let simulation = walk();
    let faults = Faults {
        list: vec![
            fault(FaultKind::Disconnect, 0.5, 1.0),
            fault(FaultKind::Dropped, 1.0, 2.7),
        ],
        seed: 1,
    };
    write(&simulation, &rig(), RIG, &faults, folder.path(), &|| {}).unwrap();
    let reader = SessionReader::open(Arc::new(DiskStorage::new(folder.path()))).unwrap();
    let report = verify(&reader, |_| {}).unwrap();
    assert!(report.is_sound(), "{report:?}");
    let of = |stream: &str| {
        let s = &report.streams[stream];
        (s.first, s.samples, s.gaps)
    };
    assert_eq!(of("left_shoulder"), (0, 30, 0));
    // Five frames while the device was disconnected, three dropped.
    assert_eq!(of("feet"), (0, 22, 8));
    let (_, samples, gaps) = of("feet/imu");
    // The oscillator of an IMU has a rate error of some ppm.
    assert!(
        (1199..=1201).contains(&(samples + gaps)),
        "{samples} {gaps}"
    );
    assert!((199..=201).contains(&gaps), "{gaps}");
    let gaps = records::<Gap>(&reader);
    let of_frames: Vec<_> = gaps.iter().filter(|g| g.stream == "feet").collect();
    let causes: Vec<_> = of_frames
        .iter()
        .map(|g| (g.first, g.last, g.cause().as_str_name()))
        .collect();
    assert_eq!(
        causes,
        [(10, 14, "CAUSE_DISCONNECTED"), (27, 29, "CAUSE_DEVICE")]
    );
    for frame in records::<Frame>(&reader) {
        let taken = BEGIN + simulation.settings().frame_ns(frame.number);
        assert_eq!(frame.time, taken.ns());
    }
    let sets = records::<FrameSet>(&reader);
    let complete = sets.iter().filter(|s| s.missing.is_empty()).count();
    assert_eq!((sets.len(), complete), (30, 22));
    let batches = records::<ImuBatch>(&reader);
    let synced: usize = batches.iter().map(|b| b.frame_sync.len()).sum();
    // Every camera's IMU counts every frame while the device is connected.
    assert!((80..=86).contains(&synced), "{synced}");
    let names: Vec<&str> = reader
        .manifest()
        .rig
        .iter()
        .map(|f| f.name.as_str())
        .collect();
    assert!(
        names.contains(&"truth.feet.csv")
            && names.contains(&"truth.foot-poses.csv")
            && names.contains(&"truth.step-edges.csv")
            && names.contains(&"rig.toml"),
        "{names:?}"
    );

    let again = tempfile::tempdir().unwrap();
    write(&simulation, &rig(), RIG, &faults, again.path(), &|| {}).unwrap();
    let bytes =
        |folder: &std::path::Path| std::fs::read(folder.join("segments/000000.mcap")).unwrap();
    assert!(
        bytes(folder.path()) == bytes(again.path()),
        "the same walk gives the same bytes"
    );
}

#[test]
fn clock_faults_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let faults = Faults {
        list: vec![fault(FaultKind::ClockStep, 0.1, 1.0)],
        seed: 1,
    };
    let error = write(&walk(), &rig(), RIG, &faults, folder.path(), &|| {}).unwrap_err();
    assert!(
        matches!(error, SessionError::Clock("clock_step")),
        "{error}"
    );
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn film_contains_every_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("walk.mp4");
    let done = std::sync::atomic::AtomicU32::new(0);
    let count = || {
        done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
    };
    film(&walk(), &path, &count).unwrap();
    assert_eq!(done.into_inner(), 90);
    let bytes = std::fs::read(&path).unwrap();
    // ISO base media: the file type comes first; the sample sizes tell how many images there are.
    assert_eq!(&bytes[4..8], b"ftyp");
    let stsz = bytes.windows(4).position(|w| w == b"stsz").unwrap();
    let count = u32::from_be_bytes(bytes[stsz + 12..stsz + 16].try_into().unwrap());
    assert_eq!(count, 30);
}

#[test]
fn target_session_contains_boards_and_ground_truth_beside_the_nominal_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let settings = Settings {
        kind: Kind::Targets,
        ..*walk().settings()
    };
    let mut calibration_error = CalibrationError::default();
    calibration_error.of_mut("feet").time_offset_ns = 3_000_000;
    calibration_error.of_mut("left_shoulder").rotation.y = 0.01;
    let nominal = Simulation::new(&settings, &rig()).unwrap();
    let simulation = Arc::new(
        nominal
            .clone()
            .with_calibration_error(&rig(), &calibration_error)
            .unwrap(),
    );
    let faults = Faults::default();
    write(&simulation, &rig(), RIG, &faults, folder.path(), &|| {}).unwrap();
    let reader = SessionReader::open(Arc::new(DiskStorage::new(folder.path()))).unwrap();
    assert!(verify(&reader, |_| {}).unwrap().is_sound());
    let file = |name: &str| std::fs::read_to_string(folder.path().join("rig").join(name)).unwrap();
    assert_eq!(file("rig.toml"), RIG);
    for (number, board) in simulation.boards().iter().enumerate() {
        let path = folder.path().join(format!("rig/target.{number}.toml"));
        assert_eq!(
            calibration_files::board::read(&path).unwrap(),
            *board.sheet().target()
        );
    }
    let is = Rig::parse(&file("truth.rig.toml")).unwrap();
    let left = "left_shoulder/left".parse().unwrap();
    let place = |rig: &Rig| rig.transform(&"rig".parse().unwrap(), &left).unwrap();
    let off = place(&rig()).inverse() * place(&is);
    assert!((off.angle_rad() - 0.01).abs() < 1e-9);
    assert!(file("truth.cameras.toml").contains("time_offset_ns = 3000000"));
    assert!(file("truth.targets.csv").lines().count() > 3 * 144);
    // Frames have nominal timestamps; ground truth has the exposure times.
    let frames: Vec<Frame> = records(&reader);
    assert_eq!(frames.len(), 90);
    let truth = |name: &str| -> Vec<i64> {
        let text = file(&format!("truth.{name}.csv"));
        let rows = text
            .lines()
            .skip(1)
            .map(|line| line.split(',').nth(1).unwrap().parse().unwrap());
        rows.collect()
    };
    for (feet, shoulder) in truth("feet").iter().zip(truth("left_shoulder")) {
        assert_eq!(feet + 3_000_000, shoulder);
        assert_eq!(frames.iter().filter(|f| f.time == shoulder).count(), 3);
    }
    // Recorded intrinsics and extrinsics are the nominal ones.
    let other = tempfile::tempdir().unwrap();
    write(
        &Arc::new(nominal),
        &rig(),
        RIG,
        &faults,
        other.path(),
        &|| {},
    )
    .unwrap();
    let other = SessionReader::open(Arc::new(DiskStorage::new(other.path()))).unwrap();
    let statics = |r: &SessionReader| {
        let lenses: Vec<CameraCalibration> = records(r);
        let places: Vec<FrameTransforms> = records(r);
        (lenses, places)
    };
    assert_eq!(statics(&reader), statics(&other));
    let imu = |r: &SessionReader| -> Vec<ImuBatch> { records(r) };
    assert_ne!(imu(&reader), imu(&other));
}
