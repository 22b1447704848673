//! Two USB cameras, one for each eye of a simulated walk, without hardware: driver buffers as a
//! source in virtual time.
//!
//! Buffers are JPEG files as cameras write them: 4:2:2, without Huffman tables, padded. Timestamps
//! are in whole microseconds, as the kernel's are. The daemon's own code makes samples of the
//! buffers ([`sample_from_buffer`]) and pairs of the samples ([`StereoJoiner`]); only the driver
//! and its two waiting threads are replaced.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::{Context as _, Result};
use capture_daemon::config::V4l2Config;
use capture_daemon::sources::device::{StereoJoiner, sample_from_buffer};
use capture_daemon::sources::{Sample, Sink, Source, SourceError, SourceInfo};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use session_archive::time::HostTime;
use v4l2::FrameInfo;
use v4l2::stream::{Clock, TimestampSource};
use video::capture::Eye;

use crate::footage::Footage;

/// Latency from the timestamp to the arrival, ns.
const DELAY_NS: i64 = 8_000_000;
/// Number of frames by which the right camera started earlier than the left one.
const RIGHT_AHEAD_FRAMES: usize = 7;
/// Padding after the end of a file, bytes.
const PADDING_BYTES: usize = 100;

/// Two USB cameras; see the module documentation.
pub struct TwoCameras {
    info: SourceInfo,
    samples: VecDeque<Sample>,
}

impl TwoCameras {
    /// The cameras of `config` with the properties `info`, from `start` on. The right timestamps
    /// are later by `later_us(frame)`; if `is_cut(frame, eye)` (eye 0 or 1), only half of the file
    /// arrives.
    ///
    /// # Errors
    /// `config` has only one camera, or an image cannot be encoded.
    pub fn new(
        footage: &Footage,
        config: &V4l2Config,
        info: SourceInfo,
        later_us: impl Fn(usize) -> i64,
        is_cut: impl Fn(usize, usize) -> bool,
        start: HostTime,
    ) -> Result<Self> {
        let right = config.right.as_ref().context("there is one camera alone")?;
        let kept = SampleSink {
            start,
            samples: Mutex::default(),
        };
        let joined = StereoJoiner::new(right.within_ns, &kept);
        let settings = config.eyes();
        let first_ns = footage.frames.first().map_or(0, |frame| frame.time_ns);
        for (n, frame) in footage.frames.iter().enumerate() {
            let since_us = (frame.time_ns - first_ns) / 1000;
            let eyes = [Eye::Left, Eye::Right].into_iter().zip(&settings);
            for (side, (eye, config)) in eyes.enumerate() {
                let mut bytes = buffer(footage, n, side)?;
                if is_cut(n, side) {
                    bytes.truncate(bytes.len() / 2);
                }
                let later_us = [0, later_us(n)][side];
                let time_ns = start.0 + 1000 * (since_us + later_us);
                let info = FrameInfo {
                    sequence: (n + [0, RIGHT_AHEAD_FRAMES][side]) as u32,
                    time_ns,
                    clock: Clock::Monotonic,
                    stamped: TimestampSource::StartOfExposure,
                    bytes_used: bytes.len(),
                    corrupt: false,
                    short: false,
                };
                let arrival = HostTime(time_ns + DELAY_NS);
                joined
                    .eye(eye)
                    .put(sample_from_buffer(config, &info, &bytes, arrival, true));
            }
        }
        joined.finish();
        let samples = std::mem::take(&mut *kept.lock());
        Ok(Self { info, samples })
    }
}

impl Source for TwoCameras {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_sample(&mut self) -> Result<Option<Sample>, SourceError> {
        Ok(self.samples.pop_front())
    }

    fn digest(&self) -> Vec<u8> {
        Vec::new()
    }
}

/// Stores samples; its clock is the arrival of the newest.
struct SampleSink {
    start: HostTime,
    samples: Mutex<VecDeque<Sample>>,
}

impl SampleSink {
    fn lock(&self) -> MutexGuard<'_, VecDeque<Sample>> {
        self.samples.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Sink for SampleSink {
    fn now(&self) -> HostTime {
        self.lock().back().map_or(self.start, Sample::host_time)
    }

    fn put(&self, sample: Sample) {
        self.lock().push_back(sample);
    }

    fn is_ending(&self) -> bool {
        false
    }
}

/// One eye of a frame as a camera buffer.
fn buffer(footage: &Footage, n: usize, side: usize) -> Result<Vec<u8>> {
    let [width, height] = footage.eye();
    let size = (u16::try_from(width)?, u16::try_from(height)?);
    let rgb = footage.rgb(n, side)?;
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, 95);
    encoder.set_sampling_factor(SamplingFactor::F_2_1);
    encoder.encode(&rgb, size.0, size.1, ColorType::Rgb)?;
    let mut buffer = without_tables(&file);
    buffer.resize(buffer.len() + PADDING_BYTES, 0);
    Ok(buffer)
}

/// The file without its Huffman tables, which are the standard ones.
fn without_tables(file: &[u8]) -> Vec<u8> {
    let mut kept = file[..2].to_vec();
    let mut at = 2;
    while file[at + 1] != 0xda {
        let length = usize::from(u16::from_be_bytes([file[at + 2], file[at + 3]]));
        let end = at + 2 + length;
        if file[at + 1] != 0xc4 {
            kept.extend_from_slice(&file[at..end]);
        }
        at = end;
    }
    kept.extend_from_slice(&file[at..]);
    kept
}
