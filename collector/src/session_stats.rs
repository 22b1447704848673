//! Statistics of one pass over a session: everything that validation and the report use.
//!
//! Only the time of each sample is stored, so memory is about 70 bytes per frame and 12 per IMU
//! sample: some 100 MB for three cameras and IMUs over an hour. Damage is skipped
//! ([`session_archive::verify`] reports it); messages that cannot be decoded are left out.

use std::collections::BTreeMap;

use session_archive::reader::{Entry, Message, ReadError, SessionReader};
use session_archive::record::{
    CameraCalibration, ClockMap, Event, Frame, FrameSet, FrameTransforms, Gap, Health, ImuBatch,
    Record,
};
use session_archive::time::{HostTime, TickLength};

/// [`Sample::step_ns`] of a sample whose interval is unknown on the device clock.
pub const NO_STEP: u32 = u32::MAX;

/// Time of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Host clock, ns.
    pub time: i64,
    /// Device time since the previous number, ns; [`NO_STEP`] if that sample is missing or the
    /// device clock did not advance.
    pub step_ns: u32,
}

/// Statistics of a frame, without its image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameStats {
    /// Time.
    pub sample: Sample,
    /// Number in the stream.
    pub number: u64,
    /// Device clock, unwrapped, ticks.
    pub ticks: i64,
    /// One standard deviation of its time, ns.
    pub sigma_ns: u64,
    /// Length of the access unit.
    pub bytes: u32,
    /// Whether it is a key frame.
    pub key: bool,
    /// Whether its image equals the previous one.
    pub frozen: bool,
    /// Whether its time may be outside its stated sigma.
    pub time_unreliable: bool,
    /// Delay of the right image after the left, ns, if the two arrive separately.
    pub eyes_apart_ns: Option<i64>,
}

/// Statistics of an IMU stream, without the values.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImuStats {
    /// All samples, in the order recorded.
    pub samples: Vec<Sample>,
    /// Sigma of each batch, ns.
    pub sigmas_ns: Vec<u64>,
    /// Samples whose time may be outside its stated sigma.
    pub unreliable_samples: u64,
    /// Longest time with all six values unchanged, ns.
    pub stuck_ns: i64,
}

/// Statistics of a frame set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameSetStats {
    /// Time of the set.
    pub time: i64,
    /// Position of the camera in the manifest, and time of its frame.
    pub members: Vec<(usize, i64)>,
}

/// Statistics of a session.
#[derive(Clone, Debug, Default)]
pub struct SessionStats {
    /// Frames of each camera, in the order of the manifest.
    pub cameras: Vec<Vec<FrameStats>>,
    /// Samples of each IMU, in the order of the manifest.
    pub imus: Vec<ImuStats>,
    /// Frame sets.
    pub sets: Vec<FrameSetStats>,
    /// Gap records.
    pub gaps: Vec<Gap>,
    /// Events by time.
    pub events: Vec<(HostTime, Event)>,
    /// Health records by time.
    pub health: Vec<(HostTime, Health)>,
    /// Clock maps by clock, with the time from which each was in force.
    pub clocks: BTreeMap<String, Vec<(HostTime, ClockMap)>>,
    /// Newest calibration of each eye, as in `feet/left`.
    pub calibrations: BTreeMap<String, CameraCalibration>,
    /// Newest transforms of the rig.
    pub transforms: Option<FrameTransforms>,
}

/// Kind of record on a channel.
#[derive(Clone, Copy)]
enum Kind {
    Frame(usize),
    Imu(usize),
    Set,
    Gap,
    Event,
    Health,
    Clock,
    Calibration,
    Transforms,
}

impl SessionStats {
    /// Collects the statistics of a session; `progress` is called with the bytes of each message.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn gather(
        reader: &SessionReader,
        mut progress: impl FnMut(u64),
    ) -> Result<Self, ReadError> {
        let mut stats_collector = StatsCollector::new(reader);
        for entry in reader.entries() {
            if let Entry::Message(m) = entry? {
                progress(m.data.len() as u64);
                stats_collector.message(&m);
            }
        }
        let mut stats = stats_collector.stats;
        stats.events.sort_by_key(|e| e.0);
        stats.health.sort_by_key(|h| h.0);
        Ok(stats)
    }

    /// First and last time of any sample.
    pub fn span(&self) -> Option<(i64, i64)> {
        let frames = self.cameras.iter().flatten().map(|f| f.sample.time);
        let imu = self.imus.iter().flat_map(|i| &i.samples).map(|s| s.time);
        frames.chain(imu).fold(None, |span: Option<(i64, i64)>, t| {
            Some(span.map_or((t, t), |(a, b)| (a.min(t), b.max(t))))
        })
    }
}

/// The previous sample of a stream.
#[derive(Clone, Copy)]
struct PreviousSample {
    number: u64,
    ticks: i64,
}

/// A run of IMU samples with equal values: the values, bit for bit, and when it began.
type ConstantRun = ([u64; 6], i64);

struct StatsCollector {
    kinds: BTreeMap<u16, (Kind, String)>,
    ticks: Vec<TickLength>,
    imu_ticks: Vec<TickLength>,
    before: Vec<Option<PreviousSample>>,
    imu_before: Vec<Option<PreviousSample>>,
    runs: Vec<Option<ConstantRun>>,
    names: Vec<String>,
    stats: SessionStats,
}

impl StatsCollector {
    fn new(reader: &SessionReader) -> Self {
        let manifest = reader.manifest();
        let (cameras, imus) = (&manifest.cameras, &manifest.imus);
        let kinds = manifest.streams.iter().filter_map(|s| {
            let of = s.of.clone();
            let kind = match s.schema.as_str() {
                n if n == Frame::SCHEMA.name => {
                    Kind::Frame(cameras.iter().position(|c| c.name == of)?)
                }
                n if n == ImuBatch::SCHEMA.name => {
                    Kind::Imu(imus.iter().position(|i| i.name == of)?)
                }
                n if n == FrameSet::SCHEMA.name => Kind::Set,
                n if n == Gap::SCHEMA.name => Kind::Gap,
                n if n == Event::SCHEMA.name => Kind::Event,
                n if n == Health::SCHEMA.name => Kind::Health,
                n if n == ClockMap::SCHEMA.name => Kind::Clock,
                n if n == CameraCalibration::SCHEMA.name => Kind::Calibration,
                n if n == FrameTransforms::SCHEMA.name => Kind::Transforms,
                _ => return None,
            };
            Some((s.id, (kind, of)))
        });
        Self {
            kinds: kinds.collect(),
            ticks: cameras.iter().map(|c| c.tick).collect(),
            imu_ticks: imus.iter().map(|i| i.tick).collect(),
            before: vec![None; cameras.len()],
            imu_before: vec![None; imus.len()],
            runs: vec![None; imus.len()],
            names: cameras.iter().map(|c| c.name.clone()).collect(),
            stats: SessionStats {
                cameras: vec![Vec::new(); cameras.len()],
                imus: vec![ImuStats::default(); imus.len()],
                ..SessionStats::default()
            },
        }
    }

    /// Adds a message; one that does not match its schema is left out.
    fn message(&mut self, m: &Message) {
        let Some((kind, of)) = self.kinds.get(&m.stream) else {
            return;
        };
        let stats = &mut self.stats;
        match *kind {
            Kind::Frame(i) => {
                let Ok(f) = m.decode::<Frame>() else { return };
                let step_ns = step(&mut self.before[i], f.number, f.device_ticks, self.ticks[i]);
                stats.cameras[i].push(FrameStats {
                    sample: Sample {
                        time: f.time,
                        step_ns,
                    },
                    number: f.number,
                    ticks: f.device_ticks,
                    sigma_ns: f.sigma_ns,
                    bytes: f.payload_bytes,
                    key: f.key_frame,
                    frozen: f.frozen,
                    time_unreliable: f.time_unreliable,
                    eyes_apart_ns: f.eyes_apart_ns,
                });
            }
            Kind::Imu(i) => {
                let Ok(b) = m.decode::<ImuBatch>() else {
                    return;
                };
                let imu = &mut stats.imus[i];
                let numbers = (0..).map(|k| b.first_number.saturating_add(k));
                let samples = b.times.iter().zip(&b.device_ticks).zip(numbers);
                imu.samples.extend(samples.map(|((&time, &ticks), number)| {
                    let before = &mut self.imu_before[i];
                    let step_ns = step(before, number, ticks, self.imu_ticks[i]);
                    Sample { time, step_ns }
                }));
                imu.sigmas_ns.push(b.sigma_ns);
                if b.time_unreliable {
                    imu.unreliable_samples += b.times.len() as u64;
                }
                imu.record_stuck_values(&b, &mut self.runs[i]);
            }
            Kind::Set => {
                let Ok(set) = m.decode::<FrameSet>() else {
                    return;
                };
                let camera = |name: &str| self.names.iter().position(|n| n == name);
                let members = set.members.iter();
                let members = members.filter_map(|m| Some((camera(&m.camera)?, m.time)));
                stats.sets.push(FrameSetStats {
                    time: set.time,
                    members: members.collect(),
                });
            }
            Kind::Gap => stats.gaps.extend(m.decode::<Gap>().ok()),
            Kind::Event => stats.events.extend(m.decode().ok().map(|e| (m.time, e))),
            Kind::Health => stats.health.extend(m.decode().ok().map(|h| (m.time, h))),
            Kind::Clock => {
                let Ok(map) = m.decode::<ClockMap>() else {
                    return;
                };
                let maps = stats.clocks.entry(of.clone()).or_default();
                maps.push((m.time, map));
            }
            Kind::Calibration => {
                let Ok(calibration) = m.decode::<CameraCalibration>() else {
                    return;
                };
                stats.calibrations.insert(of.clone(), calibration);
            }
            Kind::Transforms => stats.transforms = m.decode().ok().or(stats.transforms.take()),
        }
    }
}

impl ImuStats {
    fn record_stuck_values(&mut self, batch: &ImuBatch, run: &mut Option<ConstantRun>) {
        let counts = |v: &[i32]| v.iter().map(|c| *c as u64).collect::<Vec<u64>>();
        let values = |v: &[f64]| v.iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
        let [gyro, accel] = [
            (&batch.gyro_counts, &batch.gyro),
            (&batch.accel_counts, &batch.accel),
        ]
        .map(|(c, v)| if c.is_empty() { values(v) } else { counts(c) });
        let vectors = gyro.chunks_exact(3).zip(accel.chunks_exact(3));
        for ((g, a), &time) in vectors.zip(&batch.times) {
            let now = [g[0], g[1], g[2], a[0], a[1], a[2]];
            match run {
                Some((values, since)) if *values == now => {
                    self.stuck_ns = self.stuck_ns.max(time.saturating_sub(*since));
                }
                _ => *run = Some((now, time)),
            }
        }
    }
}

/// Device time since the previous sample, ns, if the numbers are consecutive.
fn step(before: &mut Option<PreviousSample>, number: u64, ticks: i64, tick: TickLength) -> u32 {
    let last = before.replace(PreviousSample { number, ticks });
    let ns = last
        .filter(|b| b.number.checked_add(1) == Some(number))
        .and_then(|b| tick.ns(ticks.checked_sub(b.ticks)?));
    ns.filter(|ns| *ns > 0)
        .and_then(|ns| u32::try_from(ns).ok())
        .unwrap_or(NO_STEP)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_needs_consecutive_numbers_and_an_increasing_clock() {
        let mut before = None;
        let mut next = |number, ticks| step(&mut before, number, ticks, TickLength::ZED_MINI);
        assert_eq!(next(7, 100), NO_STEP);
        assert_eq!(next(8, 228), 5_000_000);
        assert_eq!(next(10, 484), NO_STEP);
        assert_eq!(next(11, 400), NO_STEP);
        assert_eq!(next(12, 402), 78_125);
        assert_eq!(next(13, i64::MAX), NO_STEP);
    }
}
