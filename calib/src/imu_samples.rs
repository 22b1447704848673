//! IMU samples of a session in SI units, with their gaps.
//!
//! Contract: samples come in the order of their numbers, each number at most once. Every jump of
//! the number is an [`ImuGap`], with the cause from the gap record, or `unknown` without one.
//! Samples without all six values are left out and become a gap. Damage on disk is skipped and
//! counted. Memory is 72 bytes per sample: 260 MB for five hours at 200 Hz.

use std::collections::BTreeMap;
use std::ops::Range;

use session_archive::reader::{Entry, Message, ReadError, SessionReader};
use session_archive::record::{Gap, ImuBatch, Record, paws};
use session_archive::text::enum_words;
use session_archive::time::TickLength;

/// One sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ImuSample {
    /// Host clock, ns, by the clock map in force.
    pub(crate) time: i64,
    /// Device clock, ticks of [`ImuRecording::tick`].
    pub(crate) ticks: i64,
    /// Angular rate in the IMU's frame, rad/s.
    pub(crate) gyro: [f64; 3],
    /// Specific force in the IMU's frame, m/s².
    pub(crate) accel: [f64; 3],
    /// Temperature of the sensor, °C.
    pub(crate) temperature_c: Option<f32>,
    /// Whether `time` may be outside its stated sigma.
    pub(crate) time_unreliable: bool,
}

/// A gap in the samples of an IMU.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ImuGap {
    /// Position of the first sample after the gap.
    pub(crate) at: usize,
    /// Samples missing.
    pub(crate) missing: u64,
    /// Cause from the gap record, or `unknown`.
    pub(crate) cause: String,
}

/// The stream of one IMU.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ImuRecording {
    /// Name of its frame, as in `feet/imu`.
    pub(crate) name: String,
    /// Nominal rate, Hz.
    pub(crate) rate_hz: f64,
    /// Length of a tick of its clock.
    pub(crate) tick: TickLength,
    /// Description of the device or driver.
    pub(crate) source: String,
    /// Scale of one count in rad/s and m/s², if the device delivers counts.
    pub(crate) count: [Option<f64>; 2],
    /// All samples.
    pub(crate) samples: Vec<ImuSample>,
    /// Gaps, in order.
    pub(crate) gaps: Vec<ImuGap>,
}

impl ImuRecording {
    /// Ranges of samples without a gap, in order.
    pub(crate) fn continuous_runs(&self) -> Vec<Range<usize>> {
        let mut starts = vec![0];
        starts.extend(self.gaps.iter().map(|gap| gap.at));
        starts.push(self.samples.len());
        let runs = starts.windows(2).map(|w| w[0]..w[1]);
        runs.filter(|run| !run.is_empty()).collect()
    }
}

/// IMU recordings of a session.
#[derive(Clone, Debug)]
pub(crate) struct ImuSamples {
    /// The selected IMUs, in the order of the manifest.
    pub(crate) imus: Vec<ImuRecording>,
    /// Number of damaged ranges of the session.
    pub(crate) damaged: u64,
}

/// Reads the IMUs whose name `selected` accepts, in one pass; `progress` is called with the bytes
/// of each message.
///
/// # Errors
/// An I/O error occurs.
pub(crate) fn read(
    reader: &SessionReader,
    selected: impl Fn(&str) -> bool,
    mut progress: impl FnMut(u64),
) -> Result<ImuSamples, ReadError> {
    let manifest = reader.manifest();
    let mut imus: Vec<ImuRecording> = Vec::new();
    for imu in manifest.imus.iter().filter(|imu| selected(&imu.name)) {
        imus.push(ImuRecording {
            name: imu.name.clone(),
            rate_hz: imu.rate_hz,
            tick: imu.tick,
            source: imu.source.clone(),
            count: [None; 2],
            samples: Vec::new(),
            gaps: Vec::new(),
        });
    }
    let mut streams = BTreeMap::new();
    for stream in &manifest.streams {
        let at = imus.iter().position(|imu| imu.name == stream.of);
        if let (true, Some(at)) = (stream.schema == ImuBatch::SCHEMA.name, at) {
            streams.insert(stream.id, at);
        }
    }
    let mut numbers: Vec<Vec<u64>> = vec![Vec::new(); imus.len()];
    let mut gaps: Vec<Gap> = Vec::new();
    let mut damaged = 0;
    for entry in reader.entries() {
        match entry? {
            Entry::Message(m) => {
                progress(m.data.len() as u64);
                if let Some(&at) = streams.get(&m.stream) {
                    take(&mut imus[at], &mut numbers[at], &m);
                } else if is_gap(reader, &m) {
                    gaps.extend(m.decode::<Gap>().ok());
                }
            }
            Entry::Damage { .. } | Entry::SegmentMissing { .. } => damaged += 1,
            Entry::SegmentEnd { .. } => {}
        }
    }
    for (imu, numbers) in imus.iter_mut().zip(numbers) {
        order(imu, numbers, &gaps);
    }
    Ok(ImuSamples { imus, damaged })
}

fn is_gap(reader: &SessionReader, m: &Message) -> bool {
    let stream = reader.stream(m.stream);
    stream.is_some_and(|stream| stream.schema == Gap::SCHEMA.name)
}

fn take(imu: &mut ImuRecording, numbers: &mut Vec<u64>, m: &Message) {
    let Ok(batch) = m.decode::<ImuBatch>() else {
        return;
    };
    let scales = [
        (!batch.gyro_counts.is_empty()).then_some(batch.gyro_scale),
        (!batch.accel_counts.is_empty()).then_some(batch.accel_scale),
    ];
    for (count, scale) in imu.count.iter_mut().zip(scales) {
        *count = scale.or(*count);
    }
    let samples = (0..batch.times.len()).filter_map(|k| Some((k, sample(&batch, k)?)));
    for (k, sample) in samples {
        numbers.push(batch.first_number.saturating_add(k as u64));
        imu.samples.push(sample);
    }
}

/// Sample `k` of a batch; `None` if one of its values is missing.
pub(crate) fn sample(batch: &ImuBatch, k: usize) -> Option<ImuSample> {
    let vector = |counts: &[i32], scale: f64, values: &[f64]| -> Option<[f64; 3]> {
        let at = 3 * k..3 * k + 3;
        match counts.get(at.clone()) {
            Some(c) => Some([c[0], c[1], c[2]].map(|c| f64::from(c) * scale)),
            None => values.get(at).map(|v| [v[0], v[1], v[2]]),
        }
    };
    let temperature = batch.temperature_counts.get(k);
    Some(ImuSample {
        time: *batch.times.get(k)?,
        ticks: *batch.device_ticks.get(k)?,
        gyro: vector(&batch.gyro_counts, batch.gyro_scale, &batch.gyro)?,
        accel: vector(&batch.accel_counts, batch.accel_scale, &batch.accel)?,
        temperature_c: temperature.map(|c| (f64::from(*c) * batch.temperature_scale_c) as f32),
        time_unreliable: batch.time_unreliable,
    })
}

/// Sorts the samples by number if necessary, drops duplicate numbers, and finds the gaps.
fn order(imu: &mut ImuRecording, mut numbers: Vec<u64>, gaps: &[Gap]) {
    if numbers.windows(2).any(|w| w[0] >= w[1]) {
        let mut rig_poses: Vec<usize> = (0..numbers.len()).collect();
        rig_poses.sort_by_key(|&i| numbers[i]);
        rig_poses.dedup_by_key(|i| numbers[*i]);
        imu.samples = rig_poses.iter().map(|&i| imu.samples[i]).collect();
        numbers = rig_poses.iter().map(|&i| numbers[i]).collect();
    }
    let nominal: Vec<&Gap> = gaps.iter().filter(|gap| gap.stream == imu.name).collect();
    for (i, pair) in numbers.windows(2).enumerate() {
        let (first, last) = (pair[0] + 1, pair[1] - 1);
        if first > last {
            continue;
        }
        let of = |gap: &&&Gap| gap.first <= last && gap.last >= first;
        let cause = nominal.iter().find(of).map(|gap| {
            let cause = paws::gap::Cause::try_from(gap.cause).unwrap_or_default();
            enum_words(cause.as_str_name(), "CAUSE_")
        });
        imu.gaps.push(ImuGap {
            at: i + 1,
            missing: last - first + 1,
            cause: cause.unwrap_or_else(|| "unknown".to_owned()),
        });
    }
}

#[cfg(test)]
mod tests;
