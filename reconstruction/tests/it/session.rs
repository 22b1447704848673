//! A small session: two cameras and an IMU, 2.5 s, with everything in it that a reader has to get
//! right.
//!
//! `left_shoulder` is grey at 20 Hz, `feet` is in colour at 12.5 Hz and runs free. `feet` lost
//! three frames in one place. Frame sets follow `left_shoulder`; some have no frame of `feet`, and
//! the frames of `left_shoulder` with a number that ends in 7 are in no set at all.

use std::f64::consts::TAU;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use session_archive::handoff::{HandOff, Verdict};
use session_archive::index::Index;
use session_archive::layout;
use session_archive::manifest::{Camera, Imu, Stop};
use session_archive::reader::SessionReader;
use session_archive::record::paws::clock_map::Model;
use session_archive::record::paws::frame_set::Member;
use session_archive::record::{
    CameraCalibration, ClockMap, Frame, FrameSet, FrameTransform, FrameTransforms, ImuBatch,
    Quaternion, Vector3,
};
use session_archive::storage::{DiskStorage, Storage, replace};
use session_archive::time::{CivilTime, HostTime, TickLength};
use session_archive::writer::{SessionSpec, SessionWriter};
use video::{AccessUnit, Encoder, EncoderEvent, EncoderSettings, PixelFormat, RawImage};

pub(crate) const START: HostTime = HostTime(86_400_000_000_007);
const MS: i64 = 1_000_000;
/// The time and the sigma of samples are odd numbers: they must not be rounded in transit.
const CHUNK_NS: i64 = 500 * MS;

/// A frame as it went in.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    pub(crate) number: u64,
    pub(crate) time: HostTime,
    pub(crate) sigma_ns: u64,
    pub(crate) time_unreliable: bool,
    /// Left and right side by side, I420.
    pub(crate) image: RawImage,
}

/// What was recorded, to compare with.
pub(crate) struct RecordedSession {
    pub(crate) left_shoulder: Vec<Source>,
    pub(crate) feet: Vec<Source>,
    pub(crate) imu: Vec<ImuBatch>,
    pub(crate) sets: Vec<FrameSet>,
}

impl RecordedSession {
    pub(crate) fn camera(&self, name: &str) -> &[Source] {
        match name {
            "feet" => &self.feet,
            _ => &self.left_shoulder,
        }
    }
}

/// Records a session into `folder`, indexes it and hands it over.
pub(crate) fn hand_over(folder: &Path) -> RecordedSession {
    hand_over_with(folder, |_, _, unit| unit)
}

/// The same, with access units changed on their way to the disk, after their key frames were
/// chosen.
pub(crate) fn hand_over_with(
    folder: &Path,
    change: impl Fn(&str, u64, AccessUnit) -> AccessUnit,
) -> RecordedSession {
    let recorded = record(folder, change);
    index(folder);
    seal(folder, Verdict::Pass);
    recorded
}

pub(crate) fn index(folder: &Path) {
    let storage = Arc::new(DiskStorage::new(folder));
    let reader = SessionReader::open(storage.clone()).expect("open");
    let index = Index::build(&reader, |_| {}).expect("index");
    replace(&*storage, layout::INDEX, &index.to_bytes().expect("encode")).expect("write");
}

/// Seals all that belongs to the session.
pub(crate) fn seal(folder: &Path, verdict: Verdict) {
    let files = [
        layout::MANIFEST.to_owned(),
        layout::INDEX.to_owned(),
        layout::rig_file("rig.toml"),
        layout::segment(0),
    ];
    seal_only(folder, verdict, &files);
}

/// Seals a session that was made elsewhere, with all files of its rig and all segments.
pub(crate) fn seal_session(folder: &Path, verdict: Verdict) {
    let storage: Arc<dyn Storage> = Arc::new(DiskStorage::new(folder));
    let reader = SessionReader::open(storage.clone()).expect("open");
    let manifest = reader.manifest();
    let rig = manifest.rig.iter().map(|file| layout::rig_file(&file.name));
    let files: Vec<String> = [layout::MANIFEST.to_owned(), layout::INDEX.to_owned()]
        .into_iter()
        .chain(rig)
        .chain(reader.segment_numbers().map(layout::segment))
        .collect();
    let id = &manifest.session_id;
    HandOff::seal(
        &*storage,
        id,
        verdict,
        "tests",
        CivilTime(7),
        &files,
        |_| {},
    )
    .expect("seal");
}

pub(crate) fn seal_only(folder: &Path, verdict: Verdict, files: &[String]) {
    let storage = DiskStorage::new(folder);
    let id = spec().session_id;
    HandOff::seal(&storage, &id, verdict, "tests", CivilTime(7), files, |_| {}).expect("seal");
}

fn spec() -> SessionSpec {
    let camera = |name: &str, (width, height), color: &str, codec: &str, rate_hz| Camera {
        name: name.to_owned(),
        width,
        height,
        codec: codec.to_owned(),
        colour: color.to_owned(),
        rate_hz,
        tick: TickLength::NANOSECOND,
        trigger: None,
        source: "made up".to_owned(),
        encoder: "test".to_owned(),
    };
    SessionSpec {
        session_id: "0192aa00-0000-7000-8000-000000000001".to_owned(),
        name: "test".to_owned(),
        software: "tests".to_owned(),
        started: START,
        started_civil: CivilTime(1_790_000_000_000_000_000),
        chunk_ns: CHUNK_NS,
        cameras: vec![
            camera("left_shoulder", (192, 64), "grey", "h264", 20.0),
            camera("feet", (148, 50), "yuv420", "h265", 12.5),
        ],
        imus: vec![Imu {
            name: "feet/imu".to_owned(),
            rate_hz: 200.0,
            tick: TickLength::ZED_MINI,
            source: "made up".to_owned(),
            noise: None,
        }],
        rig: vec![("rig.toml".to_owned(), b"revision = 1\n".to_vec())],
    }
}

/// Waves that move, steeper in one eye than in the other.
fn image(width: u32, height: u32, number: u64, color: bool) -> RawImage {
    let phase = number as f64 * 0.13;
    let wave = |x: u32, y: u32, seed: f64| {
        let eye = if x < width / 2 { 1.0 } else { 1.7 };
        let (x, y) = (f64::from(x), f64::from(y));
        128.0
            + 50.0 * (TAU * (x * eye / 40.0 + phase + seed)).sin()
            + 40.0 * (TAU * (y / 23.0 + x / 90.0 - phase) + seed).cos()
    };
    let mut data = Vec::with_capacity(PixelFormat::I420.bytes(width, height).expect("even size"));
    for y in 0..height {
        data.extend((0..width).map(|x| wave(x, y, 0.0) as u8));
    }
    for seed in [1.0, 2.0] {
        for y in 0..height / 2 {
            let chroma = |x| {
                if color {
                    (wave(2 * x, 2 * y, seed) / 2.0 + 64.0) as u8
                } else {
                    128
                }
            };
            data.extend((0..width / 2).map(chroma));
        }
    }
    RawImage::new(width, height, PixelFormat::I420, data).expect("complete image")
}

fn sources(camera: &Camera, count: u64, first_ns: i64, skip: &[u64]) -> Vec<Source> {
    let period = (1e9 / camera.rate_hz) as i64;
    (0..count)
        .filter(|n| !skip.contains(n))
        .map(|n| Source {
            number: 100 + n,
            time: START + first_ns + n as i64 * period + (n * n * 7_919 % 100_003) as i64,
            sigma_ns: 20_001 + n,
            // As while a clock has not settled.
            time_unreliable: n < 3,
            image: image(camera.width, camera.height, n, camera.colour != "grey"),
        })
        .collect()
}

/// The access units of both cameras, encoded once for all tests.
fn encoded(cameras: &[Camera], sources: [&[Source]; 2]) -> &'static [Vec<AccessUnit>; 2] {
    static UNITS: OnceLock<[Vec<AccessUnit>; 2]> = OnceLock::new();
    UNITS.get_or_init(|| [0, 1].map(|camera| encode(&cameras[camera], sources[camera])))
}

fn encode(camera: &Camera, sources: &[Source]) -> Vec<AccessUnit> {
    let settings = EncoderSettings {
        element: if camera.codec == "h264" {
            "x264enc"
        } else {
            "x265enc"
        }
        .to_owned(),
        width: camera.width,
        height: camera.height,
        rate_hz: camera.rate_hz,
        quality_db: 46.0,
        threads: 1,
        max_key_interval_frames: 1000,
        preset: video::encoder::Preset::default(),
    };
    let units: Arc<Mutex<Vec<AccessUnit>>> = Arc::default();
    let collecting = units.clone();
    let on_output = move |event| match event {
        EncoderEvent::AccessUnit(unit) => collecting.lock().expect("lock").push(unit),
        EncoderEvent::Failed(reason) => panic!("{reason}"),
    };
    let mut encoder = Encoder::start(&settings, Box::new(on_output)).expect("start");
    let mut epoch = None;
    for source in sources {
        let own = Some(source.time.ns() / CHUNK_NS);
        let key = own != epoch;
        epoch = own;
        encoder
            .push(source.time.ns(), &source.image, key)
            .expect("push");
    }
    encoder.finish(Duration::from_secs(60)).expect("finish");
    std::mem::take(&mut *units.lock().expect("lock"))
}

/// Ten samples each 50 ms; the first half as counts, the second in SI units.
fn batches() -> Vec<ImuBatch> {
    let batch = |b: u64| {
        let numbers = b * 10..b * 10 + 10;
        let times = numbers
            .clone()
            .map(|n| START.ns() + n as i64 * 5 * MS + (n % 7) as i64 * 13);
        let counts = |scale: i64| {
            let all = numbers
                .clone()
                .flat_map(move |n| [n as i64 * scale, -(n as i64), 40 - n as i64]);
            all.map(|c| c as i32).collect::<Vec<_>>()
        };
        let si = |scale: f64| {
            counts(3)
                .iter()
                .map(|c| f64::from(*c) * scale / 3.0)
                .collect()
        };
        let common = ImuBatch {
            first_number: numbers.start,
            device_ticks: numbers.clone().map(|n| n as i64 * 128 + 5).collect(),
            host_times: times.clone().map(|t| t + MS).collect(),
            times: times.collect(),
            sigma_ns: 10_000,
            time_unreliable: b < 2,
            clock_map: 1,
            ..ImuBatch::default()
        };
        if b < 25 {
            ImuBatch {
                gyro_counts: counts(2),
                gyro_scale: 5.326e-4,
                accel_counts: counts(-1),
                accel_scale: 9.8189 * 8.0 / 32768.0,
                ..common
            }
        } else {
            ImuBatch {
                gyro: si(1e-3),
                accel: si(0.1),
                ..common
            }
        }
    };
    (0..50).map(batch).collect()
}

/// One set for each frame of `left_shoulder` whose number does not end in 7, with the frame of
/// `feet` that is nearest in time, if it is within 20 ms.
fn sets(left_shoulder: &[Source], feet: &[Source]) -> Vec<FrameSet> {
    let chosen = left_shoulder.iter().filter(|s| s.number % 10 != 7);
    let member = |camera: &str, source: &Source| Member {
        camera: camera.to_owned(),
        number: source.number,
        time: source.time.ns(),
    };
    chosen
        .zip(0..)
        .map(|(source, number)| {
            let apart = |f: &&Source| (f.time - source.time).abs();
            let near = feet.iter().min_by_key(apart).filter(|f| apart(f) < 20 * MS);
            let mut members = vec![member("left_shoulder", source)];
            members.extend(near.map(|f| member("feet", f)));
            FrameSet {
                number,
                time: source.time.ns(),
                missing: near.map_or(vec!["feet".to_owned()], |_| Vec::new()),
                members,
            }
        })
        .collect()
}

/// Something to be written, with the time by which to sort it.
enum Sample<'a> {
    Frame(&'a str, &'a Source, &'a AccessUnit),
    Imu(&'a ImuBatch),
    Set(&'a FrameSet),
}

fn record(folder: &Path, change: impl Fn(&str, u64, AccessUnit) -> AccessUnit) -> RecordedSession {
    let spec = spec();
    let (grey, color) = (&spec.cameras[0], &spec.cameras[1]);
    let recorded = RecordedSession {
        // The first frame has the time of an IMU sample.
        left_shoulder: sources(grey, 50, 10 * MS + 26, &[]),
        feet: sources(color, 31, 3 * MS, &[12, 13, 14]),
        imu: batches(),
        sets: Vec::new(),
    };
    let units = encoded(&spec.cameras, [&recorded.left_shoulder, &recorded.feet]);
    let recorded = RecordedSession {
        sets: sets(&recorded.left_shoulder, &recorded.feet),
        ..recorded
    };

    let mut samples: Vec<(i64, Sample<'_>)> = Vec::new();
    for (name, units) in ["left_shoulder", "feet"].into_iter().zip(units) {
        let sources = recorded.camera(name);
        assert_eq!(sources.len(), units.len());
        let frames = sources.iter().zip(units);
        samples.extend(frames.map(|(s, u)| (s.time.ns(), Sample::Frame(name, s, u))));
    }
    samples.extend(recorded.imu.iter().map(|b| (b.times[9], Sample::Imu(b))));
    samples.extend(recorded.sets.iter().map(|s| (s.time + 1, Sample::Set(s))));
    samples.sort_by_key(|(time, _)| *time);

    let storage: Arc<dyn Storage> = Arc::new(DiskStorage::new(folder));
    let mut writer = SessionWriter::create(storage, spec).expect("create");
    write_state(&mut writer);
    for (time, sample) in &samples {
        let time = HostTime(*time);
        match sample {
            Sample::Frame(camera, source, unit) => {
                let frame = Frame {
                    number: source.number,
                    device_ticks: time - START,
                    host_time: time.ns() + 3 * MS,
                    time: time.ns(),
                    sigma_ns: source.sigma_ns,
                    time_unreliable: source.time_unreliable,
                    clock_map: 1,
                    ..Frame::default()
                };
                let unit = change(camera, source.number, (*unit).clone());
                writer
                    .append_frame(camera, frame, &unit.data, unit.key)
                    .expect("frame");
            }
            Sample::Imu(batch) => writer.append("feet/imu", time, time, *batch).expect("imu"),
            Sample::Set(set) => writer.append("", time, time, *set).expect("set"),
        }
    }
    let stop = Stop {
        at: START + 2_500 * MS,
        reason: "duration".to_owned(),
    };
    writer.close(stop).expect("close");
    recorded
}

pub(crate) fn lens(eye: &str) -> CameraCalibration {
    CameraCalibration {
        frame_id: eye.to_owned(),
        width: 96,
        height: 64,
        distortion_model: "plumb_bob".to_owned(),
        d: vec![0.1, -0.2, 0.001, 0.0, 1.0 / 3.0],
        k: vec![70.25, 0.0, 47.5, 0.0, 70.25, 31.5, 0.0, 0.0, 1.0],
        ..CameraCalibration::default()
    }
}

/// Calibrates `left_shoulder` only, twice; maps the clock of `feet` twice.
fn write_state(writer: &mut SessionWriter) {
    for eye in ["left_shoulder/left", "left_shoulder/right"] {
        let older = CameraCalibration {
            k: vec![1.0; 9],
            ..lens(eye)
        };
        writer
            .append(eye, START, START, &older)
            .expect("calibration");
        writer
            .append(eye, START, START, &lens(eye))
            .expect("calibration");
    }
    let transforms = FrameTransforms {
        transforms: vec![FrameTransform {
            parent_frame_id: "rig".to_owned(),
            child_frame_id: "feet/left".to_owned(),
            translation: Some(Vector3 {
                x: 0.1,
                y: 0.0,
                z: -0.25,
            }),
            rotation: Some(Quaternion {
                x: 0.5,
                y: -0.5,
                z: 0.5,
                w: -0.5,
            }),
            ..FrameTransform::default()
        }],
    };
    writer
        .append("", START, START, &transforms)
        .expect("transforms");
    for version in [1, 2] {
        let map = ClockMap {
            clock: "feet".to_owned(),
            version,
            tick_num: 1,
            tick_den: 1,
            model: Model::Constant.into(),
            ..ClockMap::default()
        };
        writer
            .append("feet", START, START, &map)
            .expect("clock map");
    }
}
