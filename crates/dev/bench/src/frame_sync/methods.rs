//! The frame-sync estimator of crate `zed`, and its peer, behind one interface.

use zed::frame_sync::{Bounds, FrameSync};
use zed::report::Sample;

use super::world::{Frame, STAMP_LATENCY};

/// A time with its stated sigma.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stamp {
    /// ns on the clock of the method's camera times.
    pub(crate) time: f64,
    /// One sigma, ns, where the method knows such a thing.
    pub(crate) sigma: Option<f64>,
}

/// Maps samples to camera time.
pub(crate) trait Method {
    fn name(&self) -> &'static str;

    /// Takes a frame.
    fn frame(&mut self, frame: &Frame);

    /// Takes a sample that arrived at `host_ns` and returns its time immediately.
    fn sample(&mut self, sample: &Sample, host_ns: i64) -> Option<Stamp>;

    /// Offset of the method's time of a frame against the start of the frame, ns: its own zero, and
    /// the minimum latency of timestamps.
    fn base(&self) -> f64;
}

/// [`FrameSync`].
pub(crate) struct FrameSyncMethod(FrameSync);

impl FrameSyncMethod {
    pub(crate) fn new() -> Self {
        Self(FrameSync::new(Bounds::default()))
    }
}

impl Method for FrameSyncMethod {
    fn name(&self) -> &'static str {
        "frame sync (ours)"
    }

    fn frame(&mut self, frame: &Frame) {
        self.0.frame(frame.sequence, frame.kernel_ns);
    }

    fn sample(&mut self, sample: &Sample, host_ns: i64) -> Option<Stamp> {
        self.0.sample(sample, host_ns);
        let tie = self.0.estimate().ok()?;
        Some(Stamp {
            time: tie.host_ns(sample.ticks)? as f64,
            sigma: Some(tie.sigma_ns as f64),
        })
    }

    fn base(&self) -> f64 {
        STAMP_LATENCY
    }
}

/// Method of zed-open-capture (its `sensorcapture.cpp` and `videocapture.cpp` at 9373915),
/// reimplemented from a description in four steps. Ticks become nanoseconds in 32-bit floats. The
/// zero of both streams is the host's time when the first frame is taken from the driver. Of every
/// fifty samples with frame sync the host's span over the device's (of the second half at first, of
/// all but five later; kept between 0.8 and 1.2) is multiplied into the scale of the ticks that
/// follow. Then the last of these samples is compared with the next frame that comes, and the mean
/// of three such differences is subtracted.
#[derive(Default)]
pub(crate) struct ZedOpenCapture {
    zero: i64,
    first_kernel: Option<i64>,
    before: Option<u64>,
    run_ns: u64,
    scale: f64,
    count_before: u32,
    pairs: Vec<(i64, i64)>,
    rounds: u32,
    /// Sample waiting for a frame.
    waiting: Option<i64>,
    differences: Vec<i64>,
    offset: i64,
}

impl ZedOpenCapture {
    const PAIRS: usize = 50;
    const DIFFERENCES: usize = 3;

    fn scale_by_pairs(&mut self) {
        let first = if self.rounds <= 1 { Self::PAIRS / 2 } else { 5 };
        let (host, device) = self.pairs[first];
        let (last_host, last_device) = self.pairs[Self::PAIRS - 1];
        let scale = (last_host - host) as f64 / (last_device - device) as f64;
        self.scale *= scale.clamp(0.8, 1.2);
        self.rounds += 1;
        self.pairs.clear();
    }
}

impl Method for ZedOpenCapture {
    fn name(&self) -> &'static str {
        "zed-open-capture's"
    }

    fn frame(&mut self, frame: &Frame) {
        let first = *self.first_kernel.get_or_insert_with(|| {
            self.zero = frame.host_ns;
            frame.kernel_ns
        });
        let time = self.zero + frame.kernel_ns - first;
        if let Some(sample) = self.waiting.take() {
            self.differences.push(sample - time);
            if self.differences.len() == Self::DIFFERENCES {
                self.offset += self.differences.iter().sum::<i64>() / Self::DIFFERENCES as i64;
                self.differences.clear();
            }
        }
    }

    fn sample(&mut self, sample: &Sample, host_ns: i64) -> Option<Stamp> {
        let device_ns = (sample.ticks as f32 * 39_062.5).round() as u64;
        let Some(before) = self.before.replace(device_ns) else {
            self.zero = host_ns;
            self.scale = 1.0;
            return None;
        };
        self.run_ns += ((device_ns - before) as f64 * self.scale) as u64;
        let time = self.zero - self.offset + self.run_ns as i64;
        let is_sync = sample.frame_sync || sample.sync_count > self.count_before;
        if self.count_before != 0 && is_sync {
            self.pairs.push((host_ns, time));
            if self.pairs.len() == Self::PAIRS {
                self.scale_by_pairs();
                self.waiting = Some(time);
            }
        }
        self.count_before = sample.sync_count;
        Some(Stamp {
            time: time as f64,
            sigma: None,
        })
    }

    fn base(&self) -> f64 {
        let shift = self.first_kernel.map_or(0, |kernel| self.zero - kernel);
        STAMP_LATENCY + shift as f64
    }
}
