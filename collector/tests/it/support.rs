//! A synthetic session of a synthetic rig, written by the archive's own writer: two cameras with a
//! common trigger, a slower free-running one, an IMU. [`Session::good`] passes every check; tests
//! introduce one fault each.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use console_output::{Clock, Console, Show};
use session_archive::manifest::{Camera, Imu, Stop};
use session_archive::record::{
    CameraCalibration, ClockMap, Event, Frame, FrameSet, FrameTransform, FrameTransforms, Gap,
    Health, ImuBatch, Quaternion, Vector3, paws,
};
use session_archive::storage::{DiskStorage, Storage};
use session_archive::time::{CivilTime, HostTime, NS_PER_S, TickLength};
use session_archive::writer::{SessionSpec, SessionWriter};

pub(crate) const MS: i64 = 1_000_000;
pub(crate) const START: i64 = 5_000 * NS_PER_S;
pub(crate) const ID: &str = "0192aa00-0000-7000-8000-000000000001";

/// One stereo frame.
#[derive(Clone)]
pub(crate) struct StereoFrame {
    pub(crate) camera: usize,
    pub(crate) frame: Frame,
    pub(crate) unit: Vec<u8>,
    pub(crate) key: bool,
}

/// Content of a session.
#[derive(Clone)]
pub(crate) struct Session {
    pub(crate) spec: SessionSpec,
    pub(crate) stereo_frames: Vec<StereoFrame>,
    pub(crate) imu: Vec<ImuBatch>,
    pub(crate) sets: Vec<FrameSet>,
    pub(crate) gaps: Vec<Gap>,
    pub(crate) events: Vec<(i64, Event)>,
    pub(crate) health: Vec<(i64, Health)>,
    pub(crate) calibrations: BTreeMap<String, CameraCalibration>,
    pub(crate) transforms: Option<FrameTransforms>,
    pub(crate) clocks: Vec<(i64, ClockMap)>,
    pub(crate) closed: bool,
}

pub(crate) fn camera(name: &str, rate_hz: f64, trigger: Option<&str>) -> Camera {
    Camera {
        name: name.to_owned(),
        width: 128,
        height: 48,
        codec: "h264".to_owned(),
        colour: "grey".to_owned(),
        rate_hz,
        tick: TickLength::NANOSECOND,
        trigger: trigger.map(str::to_owned),
        source: "synthetic".to_owned(),
        encoder: "none".to_owned(),
    }
}

/// Placeholder bytes of an access unit; different for every frame.
pub(crate) fn unit(camera: usize, number: u64, bytes: usize) -> Vec<u8> {
    let mut x = (camera as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ number.wrapping_mul(0xD1B5_4A32_D192_ED03);
    let mut out = Vec::with_capacity(bytes + 8);
    while out.len() < bytes {
        x ^= x << 13;
        x ^= x >> 7;
        x ^= x << 17;
        out.extend(x.to_le_bytes());
    }
    out.truncate(bytes);
    out
}

pub(crate) fn calibration() -> CameraCalibration {
    CameraCalibration {
        width: 64,
        height: 48,
        distortion_model: "plumb_bob".to_owned(),
        d: vec![-0.1, 0.02, 0.001, -0.002, 0.0],
        k: vec![50.0, 0.0, 32.0, 0.0, 51.0, 24.0, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![
            50.0, 0.0, 32.0, 0.0, 0.0, 51.0, 24.0, 0.0, 0.0, 0.0, 1.0, 0.0,
        ],
        ..CameraCalibration::default()
    }
}

/// `parent_from_child` with the rotation as a quaternion w x y z.
pub(crate) fn transform(
    parent: &str,
    child: &str,
    wxyz: [f64; 4],
    xyz: [f64; 3],
) -> FrameTransform {
    FrameTransform {
        timestamp: None,
        parent_frame_id: parent.to_owned(),
        child_frame_id: child.to_owned(),
        translation: Some(Vector3 {
            x: xyz[0],
            y: xyz[1],
            z: xyz[2],
        }),
        rotation: Some(Quaternion {
            w: wxyz[0],
            x: wxyz[1],
            y: wxyz[2],
            z: wxyz[3],
        }),
    }
}

/// `left_from_right` of a camera with a baseline of 63 mm.
fn both_eyes(camera: &str) -> FrameTransform {
    let [left, right] = ["left", "right"].map(|eye| format!("{camera}/{eye}"));
    transform(&left, &right, [1.0, 0.0, 0.0, 0.0], [0.063, 0.0, 0.0])
}

impl Session {
    /// A session without fault.
    pub(crate) fn good(seconds: f64) -> Self {
        Self::with_units(seconds, 200)
    }

    /// A session without fault with access units of this size.
    pub(crate) fn with_units(seconds: f64, unit_bytes: usize) -> Self {
        let cameras = vec![
            camera("left_shoulder", 30.0, Some("gmsl")),
            camera("right_shoulder", 30.0, Some("gmsl")),
            camera("feet", 15.0, None),
        ];
        let end = (seconds * 1e9) as i64;
        let mut stereo_frames = Vec::new();
        // The trigger reaches the second camera 20 us late; the free camera runs 12 ms behind.
        for (camera, period, phase) in [
            (0, 33_333_333, 0),
            (1, 33_333_333, 20_000),
            (2, 66_666_666, 12 * MS),
        ] {
            let mut epoch = -1;
            for i in 0.. {
                let t = i * period + phase;
                if t >= end {
                    break;
                }
                let key = t / (500 * MS) != epoch;
                epoch = t / (500 * MS);
                let number = 100 + i as u64;
                stereo_frames.push(StereoFrame {
                    camera,
                    frame: Frame {
                        number,
                        device_ticks: t,
                        host_time: START + t + 3 * MS,
                        time: START + t,
                        sigma_ns: 20_000,
                        // The feet are observed by two cameras without a common trigger.
                        eyes_apart_ns: (camera == 2).then_some(-40_000),
                        clock_map: 1,
                        ..Frame::default()
                    },
                    unit: unit(camera, number, unit_bytes),
                    key,
                });
            }
        }
        let sets = sets(&stereo_frames, &cameras);
        let eyes = cameras.iter().flat_map(|c| {
            ["left", "right"].map(|eye| (format!("{}/{eye}", c.name), calibration()))
        });
        let seconds_whole = 0..(seconds as i64).max(1);
        Self {
            calibrations: eyes.collect(),
            spec: SessionSpec {
                session_id: ID.to_owned(),
                name: "walk".to_owned(),
                software: "tests".to_owned(),
                started: HostTime(START),
                started_civil: CivilTime(1_790_000_000 * NS_PER_S),
                chunk_ns: 500 * MS,
                cameras,
                imus: vec![Imu {
                    name: "feet/imu".to_owned(),
                    rate_hz: 200.0,
                    tick: TickLength::ZED_MINI,
                    source: "synthetic".to_owned(),
                    noise: None,
                }],
                rig: vec![("rig.toml".to_owned(), b"revision = 1\n".to_vec())],
            },
            stereo_frames,
            imu: (0..(seconds * 10.0) as i64).map(batch).collect(),
            sets,
            gaps: Vec::new(),
            events: vec![
                (START, event(paws::event::Kind::Start, "button", "")),
                (
                    START + end / 2,
                    event(paws::event::Kind::Mark, "control", "the \"stairs\", up"),
                ),
            ],
            health: seconds_whole
                .clone()
                .map(|s| (START + s * NS_PER_S, health(s)))
                .collect(),
            transforms: Some(FrameTransforms {
                transforms: vec![
                    transform(
                        "rig",
                        "left_shoulder/left",
                        [1.0, 0.0, 0.0, 0.0],
                        [0.1, 0.2, 0.0],
                    ),
                    transform(
                        "rig",
                        "right_shoulder/left",
                        [1.0, 0.0, 0.0, 0.0],
                        [0.1, -0.2, 0.0],
                    ),
                    transform("rig", "feet/left", [0.5, 0.5, 0.5, 0.5], [0.0, 0.0, -0.3]),
                    both_eyes("left_shoulder"),
                    both_eyes("right_shoulder"),
                    both_eyes("feet"),
                    transform(
                        "feet/left",
                        "feet/imu",
                        // A rotation of 90 degrees about z.
                        [0.5_f64.sqrt(), 0.0, 0.0, 0.5_f64.sqrt()],
                        [0.01, 0.02, 0.03],
                    ),
                ],
            }),
            clocks: ["left_shoulder", "right_shoulder", "feet", "feet/imu"]
                .iter()
                .flat_map(|clock| seconds_whole.clone().map(|s| clock_map(clock, s)))
                .collect(),
            closed: true,
        }
    }

    /// Removes frames `first..=last` of a camera; with a gap record if `noted`.
    pub(crate) fn drop_frames(&mut self, camera: usize, first: u64, last: u64, noted: bool) {
        let name = self.spec.cameras[camera].name.clone();
        let dropped =
            |p: &StereoFrame| p.camera == camera && (first..=last).contains(&p.frame.number);
        let time = |number: u64| {
            let mut stereo_frames = self.stereo_frames.iter();
            stereo_frames
                .find(|p| p.camera == camera && p.frame.number == number)
                .map(|p| p.frame.time)
        };
        if noted {
            self.gaps.push(Gap {
                stream: name,
                first,
                last,
                cause: paws::gap::Cause::EncoderOverload.into(),
                time_before: time(first - 1),
                time_after: time(last + 1),
                detail: "too slow".to_owned(),
            });
        }
        self.stereo_frames.retain(|p| !dropped(p));
        self.sets = sets(&self.stereo_frames, &self.spec.cameras);
    }

    /// The frames of a camera.
    pub(crate) fn frames(&mut self, camera: usize) -> impl Iterator<Item = &mut Frame> {
        let stereo_frames = self.stereo_frames.iter_mut();
        stereo_frames
            .filter(move |p| p.camera == camera)
            .map(|p| &mut p.frame)
    }

    /// Writes the session into a folder.
    pub(crate) fn write(&self, folder: &Path) {
        enum Item<'a> {
            StereoFrame(&'a StereoFrame),
            Imu(&'a ImuBatch),
            Set(&'a FrameSet),
            Gap(&'a Gap),
            Event(&'a Event),
            Health(&'a Health),
            Clock(&'a ClockMap),
        }
        let storage: Arc<dyn Storage> = Arc::new(DiskStorage::new(folder));
        let mut writer = SessionWriter::create(storage, self.spec.clone()).unwrap();
        let start = self.spec.started;
        for (of, calibration) in &self.calibrations {
            writer.append(of, start, start, calibration).unwrap();
        }
        if let Some(transforms) = &self.transforms {
            writer.append("", start, start, transforms).unwrap();
        }
        let mut items: Vec<(i64, Item<'_>)> = Vec::new();
        // Ordered by arrival, which faults in a frame's time do not change.
        items.extend(
            self.stereo_frames
                .iter()
                .map(|p| (p.frame.host_time, Item::StereoFrame(p))),
        );
        let arrival = |b: &ImuBatch| *b.host_times.last().unwrap();
        items.extend(self.imu.iter().map(|b| (arrival(b), Item::Imu(b))));
        items.extend(self.sets.iter().map(|s| (s.time + 4 * MS, Item::Set(s))));
        items.extend(
            self.gaps
                .iter()
                .map(|g| (g.time_before.unwrap_or(START), Item::Gap(g))),
        );
        items.extend(self.events.iter().map(|(t, e)| (*t, Item::Event(e))));
        items.extend(self.health.iter().map(|(t, h)| (*t, Item::Health(h))));
        items.extend(self.clocks.iter().map(|(t, c)| (*t, Item::Clock(c))));
        items.sort_by_key(|i| i.0);
        for (time, item) in items {
            let at = HostTime(time);
            match item {
                Item::StereoFrame(p) => {
                    let name = &self.spec.cameras[p.camera].name;
                    writer.append_frame(name, p.frame, &p.unit, p.key).unwrap();
                }
                Item::Imu(b) => {
                    writer
                        .append("feet/imu", HostTime(b.times[0]), at, b)
                        .unwrap();
                }
                Item::Set(s) => writer.append("", HostTime(s.time), at, s).unwrap(),
                Item::Gap(g) => writer.append("", at, at, g).unwrap(),
                Item::Event(e) => writer.append("", at, at, e).unwrap(),
                Item::Health(h) => writer.append("", at, at, h).unwrap(),
                Item::Clock(c) => writer.append(&c.clock, at, at, c).unwrap(),
            }
        }
        if self.closed {
            let stop = Stop {
                at: start,
                reason: "duration".to_owned(),
            };
            writer.close(stop).unwrap();
        }
    }
}

/// Sets at the times of the first camera, with the nearest frame of the others within 20 ms.
fn sets(stereo_frames: &[StereoFrame], cameras: &[Camera]) -> Vec<FrameSet> {
    let of = |camera| stereo_frames.iter().filter(move |p| p.camera == camera);
    let sets = of(0).zip(0..).map(|(reference, number)| {
        let time = reference.frame.time;
        let (mut members, mut missing) = (Vec::new(), Vec::new());
        for (i, camera) in cameras.iter().enumerate() {
            let nearest = of(i).min_by_key(|p| p.frame.time.abs_diff(time));
            match nearest.filter(|p| p.frame.time.abs_diff(time) < 16 * MS as u64) {
                Some(p) => members.push(paws::frame_set::Member {
                    camera: camera.name.clone(),
                    number: p.frame.number,
                    time: p.frame.time,
                }),
                None => missing.push(camera.name.clone()),
            }
        }
        FrameSet {
            number,
            time,
            members,
            missing,
        }
    });
    sets.collect()
}

/// The n-th batch of 20 samples at 200 Hz.
fn batch(n: i64) -> ImuBatch {
    let k = |i: i64| n * 20 + i;
    let times: Vec<i64> = (0..20).map(|i| START + k(i) * 5 * MS).collect();
    ImuBatch {
        first_number: k(0) as u64,
        device_ticks: (0..20).map(|i| k(i) * 128).collect(),
        host_times: times.iter().map(|t| t + MS).collect(),
        times,
        sigma_ns: 10_000,
        clock_map: 1,
        gyro_counts: (0..60).map(|i| i - 7 + n as i32).collect(),
        gyro_scale: 0.5,
        accel_counts: (0..60).map(|i| 100 - i - n as i32).collect(),
        accel_scale: 0.25,
        temperature_counts: vec![2512; 20],
        temperature_scale_c: 0.01,
        ..ImuBatch::default()
    }
}

pub(crate) fn event(kind: paws::event::Kind, source: &str, text: &str) -> Event {
    Event {
        kind: kind.into(),
        source: source.to_owned(),
        text: text.to_owned(),
    }
}

fn health(second: i64) -> Health {
    let stream = |name: &str, rate_hz: f64| paws::health::Stream {
        name: name.to_owned(),
        rate_hz,
        received: (rate_hz * second as f64) as u64,
        stored: (rate_hz * second as f64) as u64,
        queue_bytes: 300_000,
        bitrate: 8e6,
        ..Default::default()
    };
    Health {
        streams: vec![
            stream("left_shoulder", 30.0),
            stream("right_shoulder", 30.0),
            stream("feet", 15.0),
            paws::health::Stream {
                frame_sync: Some(paws::health::FrameSync {
                    offset_ns: 2 * MS,
                    sigma_ns: 20_000,
                    residual_p99_ns: 100_000,
                    pairs: 900,
                    ..Default::default()
                }),
                ..stream("feet/imu", 200.0)
            },
        ],
        writer_queue_bytes: 100_000,
        write_max_ns: 2 * MS as u64,
        sync_max_ns: 5 * MS as u64,
        free_bytes: 100_000_000_000,
        temperature_c: Some(55.0),
        durable_until: START + second * NS_PER_S,
        degradation: "normal".to_owned(),
        ..Health::default()
    }
}

fn clock_map(clock: &str, second: i64) -> (i64, ClockMap) {
    let device = second * NS_PER_S;
    let ticks = if clock.ends_with("imu") {
        second * 25_600
    } else {
        device
    };
    let (tick_num, tick_den) = if clock.ends_with("imu") {
        (78_125, 2)
    } else {
        (1, 1)
    };
    let map = ClockMap {
        clock: clock.to_owned(),
        version: second as u32 + 1,
        tick_num,
        tick_den,
        model: paws::clock_map::Model::Affine.into(),
        pieces: vec![paws::clock_map::Piece {
            ticks_from: 0,
            ticks_ref: ticks,
            host_ref: START + device + second * 20_000,
            rate_ppb: 20_000.0,
            sigma_ns: 500_000 / (second as u64 + 1),
            ..Default::default()
        }],
        latency_ns: 0,
        latency_sigma_ns: 1_000,
        samples: 30 * (second as u64 + 1),
        ..ClockMap::default()
    };
    (START + device, map)
}

/// Runs a function that writes to a console, and returns the output.
pub(crate) fn capture<T>(run: impl FnOnce(&mut Console<'_>) -> T) -> (T, String) {
    let mut out = Vec::new();
    let mut console = Console {
        out: &mut out,
        show: Show::Nothing,
        clock: Clock::STILL,
    };
    let result = run(&mut console);
    (result, String::from_utf8(out).unwrap())
}

/// A program in a folder that stands for `paws-calib` and measures nothing.
pub(crate) fn calib_program(folder: &Path) -> Option<PathBuf> {
    calib_script(folder, &prints(&measurements(1, "")))
}

/// A program in a folder that stands for `paws-calib` and runs these commands of the shell.
pub(crate) fn calib_script(folder: &Path, commands: &str) -> Option<PathBuf> {
    let program = folder.join("paws-calib");
    script(&program, commands);
    Some(program)
}

/// A document of measurements, which are given as JSON.
pub(crate) fn measurements(version: u32, measured: &str) -> String {
    format!(
        r#"{{"format":"paws-measurements","version":{version},"software":"test",
"measurements":[{measured}]}}"#
    )
}

/// The command of the shell that prints a text without quotation marks of the shell.
pub(crate) fn prints(text: &str) -> String {
    format!("echo '{text}'")
}

/// Writes a program that runs these commands of the shell.
pub(crate) fn script(program: &Path, commands: &str) {
    let text = program.with_extension("sh");
    std::fs::write(&text, format!("#!/bin/sh\n{commands}\n")).unwrap();
    install(&text, program);
    std::fs::remove_file(&text).unwrap();
}

/// Copies a program. Another process does it: a file that this one has open for writing is open in
/// the processes that other tests are just starting, too, and cannot be executed meanwhile.
pub(crate) fn install(from: &Path, to: &Path) {
    let mut install = Command::new("install");
    install.args(["-m", "755"]).args([from, to]);
    assert!(install.status().unwrap().success(), "{install:?}");
}

/// Every file below a folder with its content, by relative path.
pub(crate) fn tree(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fn walk(root: &Path, folder: &Path, out: &mut BTreeMap<String, Vec<u8>>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path: PathBuf = entry.unwrap().path();
            if path.is_dir() {
                walk(root, &path, out);
            } else {
                let name = path.strip_prefix(root).unwrap().to_str().unwrap();
                out.insert(name.to_owned(), std::fs::read(&path).unwrap());
            }
        }
    }
    let mut out = BTreeMap::new();
    if folder.is_dir() {
        walk(folder, folder, &mut out);
    }
    out
}
