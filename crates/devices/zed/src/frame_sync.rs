//! Relation of the IMU's clock to the camera's.
//!
//! The camera signals each frame to the microcontroller; the first sample behind it carries a flag
//! and a count. The camera's driver stamps each frame with the host's clock and a sequence number.
//! So both clocks see the same events: the frames. [`FrameSync`] is fed both streams as they come
//! and keeps a [`FrameSyncEstimate`], the line that turns ticks into the time of the camera's
//! stamps.
//!
//! **How.** Frames come in equal steps, so that each stream by itself is a line over its own
//! counter. The IMU's flag is late by anything up to one sample period, so its points lie in a band
//! of that width; the true line is half a period before the middle of that band. The driver's
//! stamps are late by a latency that is never less than some minimum; their line is the lower edge.
//! Aligning the two lines requires an integer: which count is which sequence number. Arrivals of
//! samples never enter the lines, however late they are; they only decide that number.
//!
//! **The whole number.** A wrong one shifts all times by one frame period, and both lines fit as
//! well as before. The difference is that a sample cannot arrive before it was taken, and that the
//! fastest of thousands arrive soon: their latency against the estimate has to lie within
//! [`Bounds`]. One number that fits is taken, several are [`NoEstimate::Ambiguous`], none is
//! [`NoEstimate::OutOfBounds`]. Once taken it remains, however late arrivals become; only an
//! arrival that would be too early unseats it, and [`FrameSyncEstimate::revision`] changes.
//!
//! **Bias of the flag.** It is half a sample period where all delays are as likely. Nothing is
//! assumed of that: every line that is before each flag by 0 to one sample period may be the true
//! one. Where the delay sweeps through the whole period (it does unless the two rates are in a
//! simple ratio) these lines are as good as one. Where it does not, they are a band:
//! [`FrameSyncEstimate::unresolved_ns`] is its width, its middle is taken, and the width is part of
//! sigma.
//!
//! * *Early.* Nothing until [`FrameSyncConfig::min_pairs`] frames were seen by both. Then an
//!   estimate whose sigma shrinks.
//! * *Lost samples, dropped frames* leave holes in the counters, which are counted and do no harm.
//! * *A stream that restarts*, or a counter that slips, is noticed within
//!   [`FrameSyncConfig::max_outliers`] events; all begins again.
//! * *Frames in unequal steps* (exposure that sets the frame rate) are [`NoEstimate::Irregular`].
//! * *Not seen at all*: the least latency of the camera's stamps and any constant delay of the
//!   flag. They are constants of the device, to be calibrated.
//! * *Memory* is bounded by [`FrameSyncConfig::window`] events of each stream.
//!
//! Pure; never run on a real device, whose latencies are not known: [`Bounds::default`] is an
//! assumption.

use std::collections::VecDeque;
use std::fmt;

use crate::number::Numbers;
use crate::report::{Sample, TICKS_PER_S, ticks_ns};

mod config;
mod line;
mod track;

use line::{LowerEnvelope, SlopeBand, lower_envelope, slope_band, slope_of};
use track::{CountCheck, Track};

pub use config::FrameSyncConfig;

const TICK_NS: f64 = 1e9 / TICKS_PER_S as f64;

/// Prior bounds of the latencies, ns: smallest and largest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// From the beginning of a frame, as the microcontroller receives the frame sync, to the
    /// driver's stamp: the least of many.
    pub camera_ns: (i64, i64),
    /// From the measurement of a sample to its arrival: the least of many.
    pub imu_ns: (i64, i64),
}

impl Default for Bounds {
    /// Wide enough for USB. At 60 frames per second and less one number always fits; at 100 several
    /// may.
    fn default() -> Self {
        Self {
            camera_ns: (0, 8_000_000),
            imu_ns: (0, 4_000_000),
        }
    }
}

/// A line from the IMU's ticks to the time of the camera's stamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameSyncEstimate {
    /// Where the line is anchored: at the newest frame.
    pub at_ticks: u64,
    /// Time of the camera's stamps at `at_ticks`, ns.
    pub host_ns: i64,
    /// `host_ns` minus the device's clock there, ns.
    pub offset_ns: i64,
    /// How much faster the host's clock runs than the device's, parts in 1e9.
    pub rate_ppb: i64,
    /// Count of the microcontroller minus the driver's sequence number, for the same frame.
    pub sync_minus_sequence: i64,
    /// Frames that both streams have within the window.
    pub pairs: u64,
    /// By how much the stamps of those frames lie above the line: half of them by less.
    pub residual_median_ns: u64,
    /// See `residual_median_ns`; 99 in 100.
    pub residual_p99_ns: u64,
    /// Span in which the true line may lie as far as the flags determine it, ns: next to nothing
    /// when their delay has swept through a sample period.
    pub unresolved_ns: u64,
    /// One sigma of times by this line near the window, against the least latency of the camera's
    /// stamps, ns.
    pub sigma_ns: u64,
    /// From frame to frame, ns of the host.
    pub frame_period_ns: i64,
    /// From a measurement to its arrival, the least by this line, ns.
    pub least_latency_ns: i64,
    /// Changes when an earlier estimate was wrong by whole frames, or a stream restarted.
    pub revision: u64,
}

impl FrameSyncEstimate {
    /// Time of the camera's stamps at these ticks, ns. None beyond the range of an `i64`.
    pub fn host_ns(&self, ticks: u64) -> Option<i64> {
        let device = i128::from(ticks_ns(ticks)?) - i128::from(ticks_ns(self.at_ticks)?);
        let drift = device * i128::from(self.rate_ppb) / 1_000_000_000;
        i64::try_from(i128::from(self.host_ns) + device + drift).ok()
    }
}

/// Why there is no estimate.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoEstimate {
    /// The camera does not signal its frames to the microcontroller: switch frame sync on.
    #[error("the IMU says that frame sync is not active")]
    NotActive,
    /// Wait.
    #[error(
        "too few frames: the IMU counted {syncs}, the camera sent {frames}, expected {expected} of each"
    )]
    TooFew {
        /// Flagged samples within the window.
        syncs: usize,
        /// Frames within the window.
        frames: usize,
        /// Number required of each.
        expected: usize,
    },
    /// Fix the camera's frame rate, or do without.
    #[error(
        "frames in unequal steps: the flags are spread over {spread_ns} ns, expected one sample period, {period_ns} ns"
    )]
    Irregular {
        /// How far.
        spread_ns: i64,
        /// Of the IMU.
        period_ns: i64,
    },
    /// The two streams' frame rates differ: they are not of the same camera.
    #[error(
        "a frame takes {camera_ns} ns by the camera's stamps and {imu_ns} ns by the IMU's flags"
    )]
    Rates {
        /// By the driver's stamps.
        camera_ns: i64,
        /// By the flags.
        imu_ns: i64,
    },
    /// Narrow the bounds (calibrate the latencies) or use a lower frame rate.
    #[error("{} frames fit as well as each other: least latency {least_latency_ns} ns and steps of {period_ns} ns within the bounds", numbers.len())]
    Ambiguous {
        /// What may be the count minus the sequence number.
        numbers: Vec<i64>,
        /// Least latency by the first of them.
        least_latency_ns: i64,
        /// From frame to frame.
        period_ns: i64,
    },
    /// Arrivals are later than expected at all times, or the bounds are wrong.
    #[error(
        "no frame fits: the least latency would be {least_latency_ns} ns, or a multiple of {period_ns} ns more or less"
    )]
    OutOfBounds {
        /// By the number that comes nearest.
        least_latency_ns: i64,
        /// From frame to frame.
        period_ns: i64,
    },
}

/// What was counted since the beginning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SyncCounters {
    /// Flagged samples.
    pub syncs: u64,
    /// Frames that the microcontroller counted and whose flagged sample never came.
    pub lost_syncs: u64,
    /// Frames with a stamp.
    pub frames: u64,
    /// Sequence numbers that were left out.
    pub lost_frames: u64,
    /// Number of restarts.
    pub restarts: u64,
}

/// The fastest arrival of a block.
#[derive(Clone, Copy, Debug)]
struct Fastest {
    device_ns: i64,
    host_ns: i64,
}

/// Estimates the relation of the two clocks. See the [module](self).
#[derive(Clone)]
pub struct FrameSync {
    config: FrameSyncConfig,
    bounds: Bounds,
    numbers: Numbers,
    active: bool,
    syncs: Track,
    frames: Track,
    blocks: VecDeque<Fastest>,
    /// When the newest block began.
    block_from: i64,
    since_fit: usize,
    /// Count minus sequence number, once taken.
    number: Option<i64>,
    revision: u64,
    restarts: u64,
    result: Result<FrameSyncEstimate, NoEstimate>,
}

impl fmt::Debug for FrameSync {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FrameSync")
            .field("result", &self.result)
            .finish_non_exhaustive()
    }
}

impl FrameSync {
    /// Nothing seen yet.
    pub fn new(bounds: Bounds) -> Self {
        let config = FrameSyncConfig::default();
        Self {
            config,
            bounds,
            numbers: Numbers::new(),
            active: false,
            syncs: Track::new(&config),
            frames: Track::new(&config),
            blocks: VecDeque::with_capacity(config.blocks + 1),
            block_from: 0,
            since_fit: 0,
            number: None,
            revision: 0,
            restarts: 0,
            result: Err(NoEstimate::TooFew {
                syncs: 0,
                frames: 0,
                expected: config.min_pairs,
            }),
        }
    }

    /// Takes a sample, flagged or not, that arrived at `host_ns`. All of them are needed.
    pub fn sample(&mut self, sample: &Sample, host_ns: i64) {
        if self.numbers.number(sample.ticks, host_ns).stepped {
            self.begin_again();
        }
        self.active = sample.sync_active;
        let device_ns = sample.device_ns();
        self.arrival(Fastest { device_ns, host_ns });
        if !sample.sync_active {
            return;
        }
        let seen = self
            .syncs
            .count(sample.sync_count, sample.frame_sync.then_some(device_ns));
        if seen == CountCheck::Slipped {
            self.begin_again();
        }
    }

    /// Takes a frame with the driver's sequence number and time stamp.
    pub fn frame(&mut self, sequence: u32, kernel_ns: i64) {
        if self.frames.count(sequence, Some(kernel_ns)) == CountCheck::Slipped {
            self.begin_again();
            self.frames.count(sequence, Some(kernel_ns));
        }
        self.since_fit += 1;
        if self.since_fit >= self.refit_frames() {
            self.since_fit = 0;
            self.result = self.fit();
        }
    }

    fn refit_frames(&self) -> usize {
        let held = self.frames.points().len();
        self.config
            .min_refit_frames
            .max(held / self.config.refit_divisor)
    }

    /// The estimate as of the last few frames.
    ///
    /// # Errors
    /// Why there is none.
    pub fn estimate(&self) -> Result<&FrameSyncEstimate, &NoEstimate> {
        self.result.as_ref()
    }

    /// What was counted.
    pub fn counters(&self) -> SyncCounters {
        SyncCounters {
            syncs: self.syncs.seen(),
            lost_syncs: self.syncs.missed(),
            frames: self.frames.seen(),
            lost_frames: self.frames.missed(),
            restarts: self.restarts,
        }
    }

    fn begin_again(&mut self) {
        self.syncs.clear();
        self.frames.clear();
        self.blocks.clear();
        self.number = None;
        self.restarts += 1;
        self.since_fit = 0;
        self.result = Err(NoEstimate::TooFew {
            syncs: 0,
            frames: 0,
            expected: self.config.min_pairs,
        });
    }

    /// Keeps the fastest arrival of each block.
    fn arrival(&mut self, new: Fastest) {
        let late = |f: &Fastest| f.host_ns - f.device_ns;
        match self.blocks.back_mut() {
            Some(fastest) if new.device_ns - self.block_from < self.config.block_ns => {
                if late(&new) < late(fastest) {
                    *fastest = new;
                }
            }
            _ => {
                self.block_from = new.device_ns;
                self.blocks.push_back(new);
                if self.blocks.len() > self.config.blocks {
                    self.blocks.pop_front();
                }
            }
        }
    }

    fn fit(&mut self) -> Result<FrameSyncEstimate, NoEstimate> {
        if !self.active && self.syncs.points().is_empty() && !self.blocks.is_empty() {
            return Err(NoEstimate::NotActive);
        }
        let (syncs, frames) = (self.syncs.points().len(), self.frames.points().len());
        let expected = self.config.min_pairs;
        let too_few = NoEstimate::TooFew {
            syncs,
            frames,
            expected,
        };
        let period_ns = self.numbers.period_ns().ok_or(too_few.clone())?;
        if syncs.min(frames) < expected {
            return Err(too_few);
        }
        let flags = self.fit_flags(period_ns)?.ok_or(too_few.clone())?;
        let stamps = self.fit_stamps(&flags)?.ok_or(too_few)?;
        self.syncs.expect(flags.line, flags.line.slope / 2.0);
        self.frames.expect(stamps.line, stamps.line.slope / 2.0);
        let number = self.choose(&flags, &stamps)?;
        self.tie_of(&flags, &stamps, number)
    }

    /// The frames by the IMU's flags, half a sample period early.
    fn fit_flags(&self, period_ns: i64) -> Result<Option<SlopeBand>, NoEstimate> {
        let points = self.syncs.points();
        let Some(slope) = slope_of(points) else {
            return Ok(None);
        };
        let Some(mut slope_band) = slope_band(points, slope, period_ns as f64, &self.config) else {
            return Ok(None);
        };
        // Ticks are whole numbers.
        if slope_band.width > period_ns as f64 + 2.0 * TICK_NS {
            return Err(NoEstimate::Irregular {
                spread_ns: slope_band.width as i64,
                period_ns,
            });
        }
        slope_band.line.value -= period_ns as f64 / 2.0;
        Ok(Some(slope_band))
    }

    /// The frames by the driver's stamps, at the least latency.
    fn fit_stamps(&self, flags: &SlopeBand) -> Result<Option<LowerEnvelope>, NoEstimate> {
        let points = self.frames.points();
        let Some(slope) = slope_of(points) else {
            return Ok(None);
        };
        let frame_ns = flags.line.slope;
        let rates = |camera: f64| NoEstimate::Rates {
            camera_ns: camera as i64,
            imu_ns: frame_ns as i64,
        };
        // A slope from late stamps is not exact; far off it is another frame rate.
        if (slope / frame_ns - 1.0).abs() > self.config.max_frame_rate_deviation {
            return Err(rates(slope));
        }
        let within = frame_ns * self.config.max_rate_deviation;
        Ok(lower_envelope(points, frame_ns, within, &self.config))
    }

    /// Which count is which sequence number.
    fn choose(&mut self, flags: &SlopeBand, stamps: &LowerEnvelope) -> Result<i64, NoEstimate> {
        let period = stamps.line.slope;
        let least = self.least_latency(flags, stamps, 0);
        let lowest = (self.bounds.imu_ns.0 - self.bounds.camera_ns.1) as f64;
        let highest = (self.bounds.imu_ns.1 - self.bounds.camera_ns.0) as f64;
        // A number greater by one moves the estimate one period back, and arrivals one period away
        // from it.
        if let Some(number) = self.number
            && least + number as f64 * period >= lowest - stamps.sigma
        {
            return Ok(number);
        }
        let first = ((lowest - least) / period).ceil() as i64;
        let last = ((highest - least) / period).floor() as i64;
        let least_latency_ns = |number: i64| (least + number as f64 * period).round() as i64;
        let period_ns = period.round() as i64;
        if self.number.take().is_some() {
            self.revision += 1;
        }
        match last - first {
            0 => {
                self.number = Some(first);
                Ok(first)
            }
            more if more > 0 => Err(NoEstimate::Ambiguous {
                numbers: (first..=last).collect(),
                least_latency_ns: least_latency_ns(first),
                period_ns,
            }),
            _ => Err(NoEstimate::OutOfBounds {
                least_latency_ns: least_latency_ns(first),
                period_ns,
            }),
        }
    }

    /// Least latency of samples by the estimate with this number, ns.
    fn least_latency(&self, flags: &SlopeBand, stamps: &LowerEnvelope, number: i64) -> f64 {
        let latency = |f: &Fastest| {
            let count = flags.line.inverse(f.device_ns) - number as f64;
            stamps.line.above(f.host_ns, count)
        };
        self.blocks
            .iter()
            .map(latency)
            .fold(f64::INFINITY, f64::min)
    }

    fn tie_of(
        &self,
        flags: &SlopeBand,
        stamps: &LowerEnvelope,
        number: i64,
    ) -> Result<FrameSyncEstimate, NoEstimate> {
        let frames = self.frames.points();
        let syncs = self.syncs.points();
        let mut residuals: Vec<f64> = Vec::with_capacity(frames.len());
        let mut k = 0;
        for frame in frames {
            while k < syncs.len() && syncs[k].n < frame.n + number {
                k += 1;
            }
            if k < syncs.len() && syncs[k].n == frame.n + number {
                residuals.push(stamps.line.above(frame.y, frame.n as f64).abs());
            }
        }
        let (Some(newest), true) = (frames.back(), residuals.len() >= self.config.min_pairs) else {
            return Err(NoEstimate::TooFew {
                syncs: syncs.len(),
                frames: frames.len(),
                expected: self.config.min_pairs,
            });
        };
        residuals.sort_by(f64::total_cmp);
        let quantile = |share: f64| residuals[((residuals.len() - 1) as f64 * share) as usize];

        // Anchored on a whole tick near the newest frame.
        let device_ns = flags.line.at((newest.n + number) as f64).max(0.0);
        let at_ticks = (device_ns / TICK_NS).round() as u64;
        let device_ns = ticks_ns(at_ticks).unwrap_or(i64::MAX);
        let count = flags.line.inverse(device_ns) - number as f64;
        let host_ns = stamps.line.y(count);
        let rate = stamps.line.slope / flags.line.slope - 1.0;
        let unresolved = flags.unresolved;
        let spread = unresolved.max(TICK_NS) / 12_f64.sqrt();
        Ok(FrameSyncEstimate {
            at_ticks,
            host_ns,
            offset_ns: host_ns - device_ns,
            rate_ppb: (rate * 1e9).round() as i64,
            sync_minus_sequence: number,
            pairs: residuals.len() as u64,
            residual_median_ns: quantile(0.5) as u64,
            residual_p99_ns: quantile(0.99) as u64,
            unresolved_ns: unresolved as u64,
            sigma_ns: spread.hypot(stamps.sigma).ceil() as u64,
            frame_period_ns: stamps.line.slope.round() as i64,
            least_latency_ns: self.least_latency(flags, stamps, number).round() as i64,
            revision: self.revision + self.restarts,
        })
    }
}

#[cfg(test)]
mod tests;
