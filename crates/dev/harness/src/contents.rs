//! A whole session in memory, read by the plain reader; for sessions of seconds or minutes.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result, ensure};
use bytes::Bytes;
use capture_daemon::sources::ImuValues;
use session_archive::manifest::Manifest;
use session_archive::reader::{Entry, Message, SessionReader};
use session_archive::record::{
    ClockMap, CompressedVideo, Event, Frame, FrameSet, Gap, Health, ImuBatch, Record, Segment,
};
use session_archive::storage::DiskStorage;
use session_archive::time::{HostTime, TickLength};
use video::raw_image::without_padding;
use video::{AccessUnit, Codec, Decoder, RawImage};

/// A frame as stored.
#[derive(Clone, Debug)]
pub struct StoredFrame {
    /// Its companion record.
    pub record: Frame,
    /// Its access unit.
    pub unit: Bytes,
}

/// An IMU sample as stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoredSample {
    /// Its number.
    pub number: u64,
    /// Device clock.
    pub ticks: i64,
    /// Arrival time.
    pub host_time: HostTime,
    /// Its time.
    pub time: HostTime,
    /// One standard deviation of `time`, ns.
    pub sigma_ns: u64,
    /// Whether `time` may be outside its sigma.
    pub time_unreliable: bool,
    /// Version of the clock map that gave the time.
    pub clock_map: u32,
    /// Measured values.
    pub values: ImuValues,
}

/// Everything in a session, each list in the order stored.
#[derive(Debug)]
pub struct Contents {
    /// The manifest.
    pub manifest: Manifest,
    /// Number of messages, without those that identify a segment.
    pub messages: u64,
    /// By camera.
    pub frames: BTreeMap<String, Vec<StoredFrame>>,
    /// By IMU.
    pub imu: BTreeMap<String, Vec<StoredSample>>,
    /// Gap records.
    pub gaps: Vec<Gap>,
    /// Events with their times.
    pub events: Vec<(HostTime, Event)>,
    /// Frame sets.
    pub sets: Vec<FrameSet>,
    /// Health records with their times.
    pub health: Vec<(HostTime, Health)>,
    /// By clock.
    pub clock_maps: BTreeMap<String, Vec<ClockMap>>,
}

/// Opens the session in a folder.
///
/// # Errors
/// The session cannot be opened.
pub fn open(folder: &Path) -> Result<SessionReader> {
    SessionReader::open(Arc::new(DiskStorage::new(folder)))
        .with_context(|| format!("opening the session {}", folder.display()))
}

impl Contents {
    /// Reads the session in a folder. Damage is skipped; `verify` reports it.
    ///
    /// # Errors
    /// It cannot be read, a message contradicts its schema, or an access unit does not follow its
    /// record.
    pub fn read(folder: &Path) -> Result<Self> {
        let reader = open(folder)?;
        let manifest = reader.manifest().clone();
        let mut contents = Self {
            messages: 0,
            frames: manifest
                .cameras
                .iter()
                .map(|c| (c.name.clone(), Vec::new()))
                .collect(),
            imu: manifest
                .imus
                .iter()
                .map(|i| (i.name.clone(), Vec::new()))
                .collect(),
            gaps: Vec::new(),
            events: Vec::new(),
            sets: Vec::new(),
            health: Vec::new(),
            clock_maps: BTreeMap::new(),
            manifest,
        };
        let mut awaited = BTreeMap::new();
        for entry in reader.entries() {
            if let Entry::Message(message) = entry? {
                contents.take(&message, &mut awaited)?;
            }
        }
        ensure!(
            awaited.is_empty(),
            "frame records without an access unit: {awaited:?}"
        );
        Ok(contents)
    }

    fn take(&mut self, m: &Message, awaited: &mut BTreeMap<String, Frame>) -> Result<()> {
        let stream = self.manifest.streams.iter().find(|s| s.id == m.stream);
        let stream = stream.with_context(|| format!("a message of channel {}", m.stream))?;
        let (schema, of) = (stream.schema.as_str(), stream.of.clone());
        if schema == Segment::SCHEMA.name {
            return Ok(());
        }
        self.messages += 1;
        if schema == Frame::SCHEMA.name {
            let frame: Frame = m.decode()?;
            ensure!(
                m.time.0 == frame.time,
                "frame {} of {of} has another log time",
                frame.number
            );
            ensure!(
                awaited.insert(of, frame).is_none(),
                "a frame record without an access unit"
            );
        } else if schema == CompressedVideo::SCHEMA.name {
            let video: CompressedVideo = m.decode()?;
            let record = awaited
                .remove(&of)
                .context("an access unit without a frame record")?;
            ensure!(
                m.time.0 == record.time,
                "a unit of {of} has another time than its record"
            );
            let frame = StoredFrame {
                record,
                unit: video.data,
            };
            self.frames.entry(of).or_default().push(frame);
        } else if schema == ImuBatch::SCHEMA.name {
            self.imu
                .entry(of)
                .or_default()
                .extend(samples(&m.decode()?)?);
        } else if schema == Gap::SCHEMA.name {
            self.gaps.push(m.decode()?);
        } else if schema == Event::SCHEMA.name {
            self.events.push((m.time, m.decode()?));
        } else if schema == FrameSet::SCHEMA.name {
            self.sets.push(m.decode()?);
        } else if schema == Health::SCHEMA.name {
            self.health.push((m.time, m.decode()?));
        } else if schema == ClockMap::SCHEMA.name {
            self.clock_maps.entry(of).or_default().push(m.decode()?);
        }
        Ok(())
    }

    /// First and last missing number and cause of each gap of a stream.
    pub fn gaps_of(&self, stream: &str) -> Vec<(u64, u64, i32)> {
        let gaps = self.gaps.iter().filter(|gap| gap.stream == stream);
        gaps.map(|gap| (gap.first, gap.last, gap.cause)).collect()
    }

    /// Checks that the numbers of a stream and those of its gaps are exactly 0 to the last, each
    /// once; returns the number of stored ones.
    ///
    /// # Errors
    /// A number is duplicated or absent.
    pub fn check_numbers(&self, stream: &str) -> Result<u64> {
        let frames = self
            .frames
            .get(stream)
            .into_iter()
            .flatten()
            .map(|f| f.record.number);
        let samples = self.imu.get(stream).into_iter().flatten().map(|s| s.number);
        let present: Vec<u64> = frames.chain(samples).collect();
        let gaps = self
            .gaps_of(stream)
            .into_iter()
            .flat_map(|(first, last, _)| first..=last);
        let mut all: Vec<u64> = present.iter().copied().chain(gaps).collect();
        all.sort_unstable();
        let wrong = all
            .iter()
            .zip(0..)
            .find(|(found, expected)| **found != *expected);
        ensure!(wrong.is_none(), "{stream}: (number, expected) {wrong:?}");
        Ok(present.len() as u64)
    }

    /// Checks that every time is the tick mapped by the clock map of its record. It is capped at
    /// the arrival (a latency need not be configured), and at least a nanosecond after the previous
    /// time.
    ///
    /// # Errors
    /// A map is absent, or a time differs.
    pub fn check_times(&self) -> Result<()> {
        let check = |clock: &str, rows: &mut dyn Iterator<Item = (u32, i64, i64, i64)>| {
            let mut last = HostTime::MIN;
            for (version, ticks, arrival, time) in rows {
                let mapped = self.mapped(clock, version, ticks);
                let mapped = mapped.with_context(|| format!("{clock}: no map {version}"))?;
                let right = mapped.min(HostTime(arrival)).max(last + 1);
                ensure!(
                    time == right.0,
                    "{clock}: tick {ticks} is at {time}, and at {right} by map {version}"
                );
                last = right;
            }
            Ok(())
        };
        for (name, frames) in &self.frames {
            let rows = frames.iter().map(|f| &f.record);
            check(
                name,
                &mut rows.map(|r| (r.clock_map, r.device_ticks, r.host_time, r.time)),
            )?;
        }
        for (name, samples) in &self.imu {
            let row = |s: &StoredSample| (s.clock_map, s.ticks, s.host_time.0, s.time.0);
            check(name, &mut samples.iter().map(row))?;
        }
        Ok(())
    }

    /// Maps a tick by a version of a clock's map, by the formula of the format; `None` if the
    /// session does not have the map.
    pub fn mapped(&self, clock: &str, version: u32, ticks: i64) -> Option<HostTime> {
        let map = self
            .clock_maps
            .get(clock)?
            .iter()
            .find(|map| map.version == version)?;
        let pieces = map.pieces.iter().rev();
        let piece = pieces
            .clone()
            .find(|p| p.ticks_from <= ticks)
            .or_else(|| map.pieces.first())?;
        let tick = TickLength {
            num: map.tick_num,
            den: map.tick_den,
        };
        let device_ns = tick.ns(ticks - piece.ticks_ref)?;
        let gained = (device_ns as f64 * piece.rate_ppb * 1e-9).round() as i64;
        Some(HostTime(
            piece.host_ref + device_ns + gained - map.latency_ns,
        ))
    }

    /// Decodes all frames of a camera, one GOP at a time.
    ///
    /// # Errors
    /// An image cannot be decoded, or `each` fails.
    pub fn decode(
        &self,
        camera: &str,
        mut each: impl FnMut(&Frame, &RawImage) -> Result<()>,
    ) -> Result<()> {
        let listed = self.manifest.camera(camera).context("no such camera")?;
        let codec = Codec::from_foxglove_format(&listed.codec).context("an unknown codec")?;
        let mut decoder = Decoder::new(codec);
        let mut frames = self.frames[camera].as_slice();
        while let Some((first, rest)) = frames.split_first() {
            ensure!(
                first.record.key_frame,
                "{camera} does not begin with a key frame"
            );
            let length = 1 + rest.iter().take_while(|f| !f.record.key_frame).count();
            let (group, behind) = frames.split_at(length);
            frames = behind;
            let units: Vec<AccessUnit> = group
                .iter()
                .zip(0..)
                .map(|(frame, place)| AccessUnit {
                    // The decoder needs their order only.
                    pts_ns: place * 1_000_000,
                    data: frame.unit.clone(),
                    key: frame.record.key_frame,
                })
                .collect();
            let number = first.record.number;
            let images = decoder
                .decode(&units)
                .with_context(|| format!("decoding {camera} from frame {number} on"))?;
            for (frame, (_, image)) in group.iter().zip(&images) {
                let image = without_padding(image, listed.width, listed.height)
                    .with_context(|| format!("{camera}: {image:?} of another size"))?;
                each(&frame.record, &image)?;
            }
        }
        Ok(())
    }
}

/// The samples of a batch.
///
/// # Errors
/// Its lists have inconsistent lengths.
fn samples(batch: &ImuBatch) -> Result<Vec<StoredSample>> {
    let n = batch.device_ticks.len();
    let lengths = [batch.host_times.len(), batch.times.len()];
    ensure!(
        lengths == [n; 2],
        "an IMU batch of {n} samples with {lengths:?} times"
    );
    let vector = |values: &[f64], k: usize| [values[3 * k], values[3 * k + 1], values[3 * k + 2]];
    let counts = |values: &[i32], k: usize| [values[3 * k], values[3 * k + 1], values[3 * k + 2]];
    let values = |k| match (batch.gyro_counts.len(), batch.gyro.len()) {
        (c, 0) if c == 3 * n && batch.accel_counts.len() == 3 * n => Ok(ImuValues::Counts {
            gyro: counts(&batch.gyro_counts, k),
            accel: counts(&batch.accel_counts, k),
        }),
        (0, v) if v == 3 * n && batch.accel.len() == 3 * n => Ok(ImuValues::Si {
            gyro: vector(&batch.gyro, k),
            accel: vector(&batch.accel, k),
        }),
        found => Err(anyhow::anyhow!(
            "an IMU batch of {n} samples with {found:?} numbers"
        )),
    };
    (0..n)
        .map(|k| {
            Ok(StoredSample {
                number: batch.first_number + k as u64,
                ticks: batch.device_ticks[k],
                host_time: HostTime(batch.host_times[k]),
                time: HostTime(batch.times[k]),
                sigma_ns: batch.sigma_ns,
                time_unreliable: batch.time_unreliable,
                clock_map: batch.clock_map,
                values: values(k)?,
            })
        })
        .collect()
}
