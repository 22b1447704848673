//! A small synthetic session, written through the public API, for the tests of this crate.

#![allow(dead_code, reason = "every test program uses a part of this")]

pub(crate) mod numbers;

use std::sync::Arc;

use session_archive::manifest::{Camera, Imu, Manifest, Stop, Stream};
use session_archive::reader::{Entry, Message, SessionReader};
use session_archive::record::{
    CompressedVideo, Event, Frame, Gap, ImuBatch, Protobuf, Segment, paws, timestamp,
};
use session_archive::storage::Storage;
use session_archive::time::{CivilTime, HostTime, TickLength};
use session_archive::writer::{SessionSpec, SessionWriter, WriteError};

pub(crate) const MS: i64 = 1_000_000;
pub(crate) const START: HostTime = HostTime(5_000_000_000_000);

pub(crate) const CAMERAS: [&str; 2] = ["left_shoulder", "feet"];

pub(crate) fn camera(name: &str, rate_hz: f64) -> Camera {
    Camera {
        name: name.to_owned(),
        width: 64,
        height: 24,
        codec: "h264".to_owned(),
        colour: "grey".to_owned(),
        rate_hz,
        tick: TickLength::NANOSECOND,
        trigger: None,
        source: "synthetic".to_owned(),
        encoder: "none".to_owned(),
    }
}

pub(crate) fn spec() -> SessionSpec {
    SessionSpec {
        session_id: "0192aa00-0000-7000-8000-000000000001".to_owned(),
        name: "test".to_owned(),
        software: "tests".to_owned(),
        started: START,
        started_civil: CivilTime(1_790_000_000_000_000_000),
        chunk_ns: 500 * MS,
        cameras: vec![camera(CAMERAS[0], 30.0), camera(CAMERAS[1], 20.0)],
        imus: vec![Imu {
            name: "feet/imu".to_owned(),
            rate_hz: 200.0,
            tick: TickLength::ZED_MINI,
            source: "synthetic".to_owned(),
            noise: None,
        }],
        rig: vec![("rig.toml".to_owned(), b"revision = 1\n".to_vec())],
    }
}

/// Bytes that stand for an access unit; different for every frame.
pub(crate) fn unit(camera: u64, number: u64, bytes: usize) -> Vec<u8> {
    let mut x =
        camera.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ number.wrapping_mul(0xD1B5_4A32_D192_ED03);
    (0..bytes)
        .map(|_| {
            x ^= x << 13;
            x ^= x >> 7;
            x ^= x << 17;
            x as u8
        })
        .collect()
}

pub(crate) fn frame(number: u64, time: HostTime) -> Frame {
    Frame {
        number,
        device_ticks: time.0 - START.0,
        host_time: time.0 + 3 * MS,
        time: time.0,
        sigma_ns: 20_000,
        clock_map: 1,
        ..Frame::default()
    }
}

/// One sample of the session, in the order of arrival.
#[derive(Clone, Debug)]
pub(crate) enum Sample {
    Frame {
        camera: usize,
        number: u64,
        time: HostTime,
        key: bool,
    },
    Imu {
        first: u64,
        time: HostTime,
    },
    Mark {
        time: HostTime,
    },
    /// A frame that is not there.
    Gap {
        camera: usize,
        number: u64,
        time: HostTime,
    },
}

/// Two cameras (30 and 20 Hz, key frame first in every half second), one IMU (200 Hz in batches of
/// 20), a mark every second.
pub(crate) fn samples(seconds: f64) -> Vec<Sample> {
    samples_at([33_333_333, 50 * MS], seconds)
}

/// The same with other periods of the cameras.
pub(crate) fn samples_at(periods: [i64; 2], seconds: f64) -> Vec<Sample> {
    let mut out = Vec::new();
    let end = (seconds * 1e9) as i64;
    for (camera, period) in periods.into_iter().enumerate() {
        let mut epoch = -1;
        for number in 0.. {
            let t = number as i64 * period + camera as i64 * 7 * MS;
            if t >= end {
                break;
            }
            let key = t / (500 * MS) != epoch;
            epoch = t / (500 * MS);
            out.push(Sample::Frame {
                camera,
                number: 100 + number,
                time: START + t,
                key,
            });
        }
    }
    for batch in 0..(seconds * 10.0) as i64 {
        out.push(Sample::Imu {
            first: (batch * BATCH) as u64,
            time: START + batch * 100 * MS,
        });
    }
    for s in 0..seconds as i64 {
        out.push(Sample::Mark {
            time: START + s * 1000 * MS,
        });
    }
    out.sort_by_key(|s| match s {
        Sample::Frame { time, .. } | Sample::Mark { time } | Sample::Gap { time, .. } => time.0,
        Sample::Imu { time, .. } => time.0 + 95 * MS,
    });
    out
}

impl Sample {
    /// The log time of its messages.
    pub(crate) fn time(&self) -> HostTime {
        match self {
            Self::Frame { time, .. }
            | Self::Imu { time, .. }
            | Self::Mark { time }
            | Self::Gap { time, .. } => *time,
        }
    }

    /// The messages that it must become: channel, sequence number where it is given by the
    /// sample, payload. Made with the generated types, and not as the writer makes them.
    pub(crate) fn messages(&self, manifest: &Manifest, bytes: usize) -> Vec<ExpectedMessage> {
        let expected = |stream: Option<&Stream>, sequence, data| ExpectedMessage {
            stream: stream.expect("stream").id,
            sequence,
            time: self.time(),
            data,
        };
        match self {
            Self::Frame {
                camera,
                number,
                time,
                key,
            } => {
                let name = &manifest.cameras[*camera].name;
                let data = unit(*camera as u64, *number, bytes);
                let companion = Frame {
                    payload_crc32: crc32fast::hash(&data),
                    payload_bytes: data.len() as u32,
                    key_frame: *key,
                    ..frame(*number, *time)
                };
                let video = CompressedVideo {
                    timestamp: Some(timestamp(*time)),
                    frame_id: format!("{name}/left"),
                    data: data.into(),
                    format: "h264".to_owned(),
                };
                let sequence = Some(*number as u32);
                vec![
                    expected(
                        manifest.stream::<Frame>(name),
                        sequence,
                        companion.encode_to_vec(),
                    ),
                    expected(
                        manifest.stream::<CompressedVideo>(name),
                        sequence,
                        video.encode_to_vec(),
                    ),
                ]
            }
            Self::Imu { first, time } => vec![expected(
                manifest.stream::<ImuBatch>("feet/imu"),
                None,
                imu_batch(*first, *time).encode_to_vec(),
            )],
            Self::Mark { .. } => vec![expected(
                manifest.stream::<Event>(""),
                None,
                mark().encode_to_vec(),
            )],
            Self::Gap { camera, number, .. } => vec![expected(
                manifest.stream::<Gap>(""),
                None,
                gap(*camera, *number).encode_to_vec(),
            )],
        }
    }

    /// Stream and numbers, if it is numbered.
    pub(crate) fn numbers(&self) -> Option<(&'static str, u64, u64)> {
        match self {
            Self::Frame { camera, number, .. } | Self::Gap { camera, number, .. } => {
                Some((CAMERAS[*camera], *number, *number))
            }
            Self::Imu { first, .. } => Some(("feet/imu", *first, *first + BATCH as u64 - 1)),
            Self::Mark { .. } => None,
        }
    }
}

/// A message that was appended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ExpectedMessage {
    pub(crate) stream: u16,
    pub(crate) sequence: Option<u32>,
    pub(crate) time: HostTime,
    pub(crate) data: Vec<u8>,
}

impl ExpectedMessage {
    pub(crate) fn is(&self, m: &Message) -> bool {
        self.stream == m.stream
            && self.time == m.time
            && self.sequence.is_none_or(|s| s == m.sequence)
            && self.data == m.data
    }
}

/// Samples in an IMU batch.
const BATCH: i64 = 20;

fn imu_batch(first: u64, time: HostTime) -> ImuBatch {
    let times: Vec<i64> = (0..BATCH).map(|i| time.0 + i * 5 * MS).collect();
    ImuBatch {
        first_number: first,
        device_ticks: (0..BATCH).map(|i| (first as i64 + i) * 128).collect(),
        host_times: times.iter().map(|t| t + MS).collect(),
        times,
        sigma_ns: 10_000,
        clock_map: 1,
        gyro_counts: (0..3 * BATCH).map(|i| i as i32 - 7).collect(),
        gyro_scale: 5.3e-4,
        accel_counts: (0..3 * BATCH).map(|i| 100 - i as i32).collect(),
        accel_scale: 2.4e-3,
        ..ImuBatch::default()
    }
}

fn mark() -> Event {
    Event {
        kind: paws::event::Kind::Mark.into(),
        source: "control".to_owned(),
        text: "here".to_owned(),
    }
}

fn gap(camera: usize, number: u64) -> Gap {
    Gap {
        stream: CAMERAS[camera].to_owned(),
        first: number,
        last: number,
        cause: paws::gap::Cause::EncoderOverload.into(),
        ..Gap::default()
    }
}

pub(crate) fn put(
    writer: &mut SessionWriter,
    sample: &Sample,
    bytes: usize,
) -> Result<(), WriteError> {
    match sample {
        Sample::Frame {
            camera,
            number,
            time,
            key,
        } => {
            let unit = unit(*camera as u64, *number, bytes);
            writer.append_frame(CAMERAS[*camera], frame(*number, *time), &unit, *key)
        }
        Sample::Imu { first, time } => {
            let batch = imu_batch(*first, *time);
            writer.append("feet/imu", *time, *time + 100 * MS, &batch)
        }
        Sample::Mark { time } => writer.append("", *time, *time, &mark()),
        Sample::Gap {
            camera,
            number,
            time,
        } => writer.append("", *time, *time, &gap(*camera, *number)),
    }
}

/// Everything that the session returns, but who its segments are.
pub(crate) fn messages(reader: &SessionReader) -> Vec<Message> {
    let own = reader.manifest().stream::<Segment>("").map(|s| s.id);
    reader
        .entries()
        .filter_map(|entry| match entry.expect("read") {
            Entry::Message(m) if Some(m.stream) != own => Some(m),
            _ => None,
        })
        .collect()
}

pub(crate) fn stop(at: HostTime) -> Stop {
    Stop {
        at,
        reason: "duration".to_owned(),
    }
}

/// Records the samples; closes cleanly.
pub(crate) fn record(
    storage: Arc<dyn Storage>,
    samples: &[Sample],
    bytes: usize,
) -> Result<(), WriteError> {
    let mut writer = SessionWriter::create(storage, spec())?;
    for sample in samples {
        put(&mut writer, sample, bytes)?;
    }
    writer.close(stop(START)).map(|_| ())
}
