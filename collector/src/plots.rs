//! The charts of a report. Times are seconds after the first sample; a stream has the same color in
//! all charts.

use std::collections::BTreeMap;

use charts::{Axis, Bins, Chart, REPORT_WIDTH as WIDTH, Series, Span, Timeline};
use session_archive::manifest::Manifest;
use session_archive::record::{ClockMap, paws};
use session_archive::text::enum_words;
use session_archive::time::TickLength;

use crate::cadence::Cadence;
use crate::scan_session::SessionScan;
use crate::session_stats::{NO_STEP, Sample, SessionStats};

/// Height of small charts, pixels.
pub(crate) const LOW: u32 = 180;
/// Maximum number of drawn events.
const MAX_EVENT_MARKS: usize = 60;
/// Maximum number of points of a long series: two per pixel of the width, the extremes of each
/// interval.
const MAX_POINTS: usize = 2 * WIDTH as usize;

/// Draws the charts of one session.
pub(crate) struct Plots<'a> {
    manifest: &'a Manifest,
    found: &'a SessionScan,
    start: i64,
}

impl<'a> Plots<'a> {
    /// Charts of this scan.
    pub(crate) fn new(manifest: &'a Manifest, found: &'a SessionScan) -> Self {
        Self {
            manifest,
            found,
            start: found.stats.span().map_or(0, |(start, _)| start),
        }
    }

    /// The common time axis of all charts.
    fn axis(&self) -> Axis {
        let end = self.stats().span().map_or(0, |(_, end)| end);
        Axis::time("time").include(0.0).include(self.seconds(end))
    }

    fn stats(&self) -> &SessionStats {
        &self.found.stats
    }

    fn seconds(&self, time: i64) -> f64 {
        time.saturating_sub(self.start) as f64 / 1e9
    }

    /// Recorded spans and gaps of each stream.
    pub(crate) fn timeline(&self) -> Timeline {
        let mut timeline = Timeline::new("Recorded spans and gaps", self.axis()).kinds([
            "recorded",
            "missing, with gap record",
            "missing, without gap record",
        ]);
        let cameras = self.manifest.cameras.iter().zip(&self.stats().cameras);
        for (camera, frames) in cameras {
            let samples: Vec<Sample> = frames.iter().map(|f| f.sample).collect();
            timeline = self.row(timeline, &camera.name, &samples);
        }
        for (imu, stats) in self.manifest.imus.iter().zip(&self.stats().imus) {
            timeline = self.row(timeline, &imu.name, &stats.samples);
        }
        for (time, event) in self.stats().events.iter().take(MAX_EVENT_MARKS) {
            let kind = paws::event::Kind::try_from(event.kind).unwrap_or_default();
            let label = enum_words(kind.as_str_name(), "KIND_");
            timeline = timeline.mark(self.seconds(time.0), &label);
        }
        timeline
    }

    fn row(&self, timeline: Timeline, name: &str, samples: &[Sample]) -> Timeline {
        let mut spans = recorded(samples);
        let gaps = self.stats().gaps.iter().filter(|g| g.stream == name);
        let mut missing = 0_u64;
        for gap in gaps {
            missing = gap.count().saturating_add(missing);
            let from = gap.time_before.or(gap.time_after);
            let to = gap.time_after.or(gap.time_before);
            if let Some((from, to)) = from.zip(to) {
                spans.push((from, to, 1));
            }
        }
        for lost in self.found.report.lost.iter().filter(|l| l.stream == name) {
            let count = lost.last.saturating_sub(lost.first).saturating_add(1);
            missing = count.saturating_add(missing);
            spans.push((lost.after.0, lost.before.0, 2));
        }
        let note = match missing {
            0 => "complete".to_owned(),
            n => format!("{n} missing"),
        };
        let spans = spans.into_iter().map(|(from, to, kind)| Span {
            from: self.seconds(from),
            to: self.seconds(to),
            kind,
        });
        timeline.row(name, &note, spans)
    }

    /// Interval between consecutive frames.
    pub(crate) fn frame_intervals(&self) -> Chart {
        let mut chart = Chart::new("Frame interval")
            .x_axis(self.axis())
            .y_axis(Axis::linear("interval", "ms").include(0.0));
        for (camera, frames) in self.manifest.cameras.iter().zip(&self.stats().cameras) {
            let times = frames.iter().map(|f| f.sample.time);
            let points = self.intervals(times, 1e-6);
            chart = chart.series(Series::line(&camera.name, points));
        }
        chart
    }

    /// Distribution of the frame periods around their median.
    pub(crate) fn frame_histogram(&self) -> Chart {
        let mut chart = Chart::new("Frame period by the camera's clock, against its median")
            .x_axis(Axis::linear("deviation", "µs"))
            .y_axis(Axis::linear("frames", ""));
        for (i, frames) in self.stats().cameras.iter().enumerate() {
            let samples = || frames.iter().map(|f| f.sample);
            let period = Cadence::of(samples()).period_ns;
            let off = samples()
                .filter(|s| s.step_ns != NO_STEP)
                .map(|s| (f64::from(s.step_ns) - period) * 1e-3);
            let name = &self.manifest.cameras[i].name;
            chart = chart.series(Series::histogram(name, off, Bins::Count(60)));
        }
        chart
    }

    /// Interval between consecutive IMU samples.
    pub(crate) fn imu_intervals(&self) -> Chart {
        let mut chart = Chart::new("IMU sample interval")
            .x_axis(self.axis())
            .y_axis(Axis::linear("interval", "ms").include(0.0));
        for (i, imu) in self.manifest.imus.iter().enumerate() {
            let times = self.stats().imus[i].samples.iter().map(|s| s.time);
            let points = self.intervals(times, 1e-6);
            chart = chart.series(Series::line(&imu.name, points).slot(i));
        }
        chart
    }

    fn intervals(&self, times: impl Iterator<Item = i64>, scale: f64) -> Vec<(f64, f64)> {
        let mut before: Option<i64> = None;
        let points = times.filter_map(|time| {
            let last = before.replace(time)?;
            Some((self.seconds(time), time.saturating_sub(last) as f64 * scale))
        });
        thin(points.collect())
    }

    /// Time offset of each frame from its frame set.
    pub(crate) fn set_errors(&self) -> Chart {
        let mut chart = Chart::new("Time offset of each frame from its frame set")
            .x_axis(self.axis())
            .y_axis(Axis::linear("distance", "ms"));
        for (i, camera) in self.manifest.cameras.iter().enumerate() {
            let members = self.stats().sets.iter().filter_map(|set| {
                let (_, time) = set.members.iter().find(|m| m.0 == i)?;
                let off = time.saturating_sub(set.time) as f64 * 1e-6;
                Some((self.seconds(set.time), off))
            });
            chart = chart.series(Series::line(&camera.name, thin(members.collect())));
        }
        chart
    }

    /// Time spread of cameras with a common trigger; `None` without such cameras.
    pub(crate) fn trigger_errors(&self) -> Option<Chart> {
        let cameras = &self.manifest.cameras;
        let mut chart = Chart::new("Time offset of triggered cameras from the first one")
            .x_axis(self.axis())
            .y_axis(Axis::linear("distance", "µs").include(0.0));
        let mut any = false;
        for (i, camera) in cameras.iter().enumerate() {
            let trigger = camera.trigger.as_ref();
            let mut same = cameras.iter();
            let first = same.position(|c| trigger.is_some() && c.trigger.as_ref() == trigger);
            let Some(first) = first.filter(|first| *first != i) else {
                continue;
            };
            let points = self.stats().sets.iter().filter_map(|set| {
                let of = |i| set.members.iter().find(|m| m.0 == i).map(|m| m.1);
                let off = of(i)?.saturating_sub(of(first)?);
                Some((self.seconds(set.time), off as f64 * 1e-3))
            });
            any = true;
            let line = Series::line(&camera.name, thin(points.collect()));
            chart = chart.series(line.slot(i));
        }
        any.then_some(chart)
    }

    /// Bit rate of the compressed images per second.
    pub(crate) fn bitrates(&self) -> Chart {
        let mut chart = Chart::new("Bit rate of the compressed images")
            .x_axis(self.axis())
            .y_axis(Axis::linear("bit rate", "Mbit/s").include(0.0));
        for (camera, frames) in self.manifest.cameras.iter().zip(&self.stats().cameras) {
            let mut seconds: BTreeMap<i64, u64> = BTreeMap::new();
            for frame in frames {
                let second = frame.sample.time.saturating_sub(self.start) / 1_000_000_000;
                *seconds.entry(second).or_default() += u64::from(frame.bytes);
            }
            // The last second is usually incomplete.
            if seconds.len() > 2 {
                seconds.pop_last();
            }
            let points = seconds.into_iter();
            let points = points.map(|(s, bytes)| (s as f64, bytes as f64 * 8e-6));
            chart = chart.series(Series::line(&camera.name, thin(points.collect())));
        }
        chart
    }

    /// Drift of each device clock against the host's since the first map.
    pub(crate) fn clock_offsets(&self) -> Chart {
        let mut chart = Chart::new("Device clocks against the host's, since their first map")
            .x_axis(self.axis())
            .y_axis(Axis::linear("offset", "ms"));
        for (clock, maps) in &self.stats().clocks {
            let first = maps.first().and_then(|(_, map)| offset_ns(map));
            let points = maps.iter().filter_map(|(time, map)| {
                let moved = offset_ns(map)?.saturating_sub(first?);
                Some((self.seconds(time.0), moved as f64 * 1e-6))
            });
            chart = chart.series(Series::steps(clock, points).slot(self.slot(clock)));
        }
        chart
    }

    /// Uncertainty of each clock map.
    pub(crate) fn clock_sigmas(&self) -> Chart {
        let mut chart = Chart::new("Uncertainty of the clock maps (one sigma)")
            .x_axis(self.axis())
            .y_axis(Axis::log("sigma", "µs"));
        for (clock, maps) in &self.stats().clocks {
            let points = maps.iter().filter_map(|(time, map)| {
                let own = map.pieces.last()?.sigma_ns as f64;
                let sigma = own.hypot(map.latency_sigma_ns as f64);
                Some((self.seconds(time.0), sigma * 1e-3))
            });
            chart = chart.series(Series::steps(clock, points).slot(self.slot(clock)));
        }
        chart
    }

    /// Color slot of a clock, equal to that of its stream: cameras first, then IMUs.
    fn slot(&self, clock: &str) -> usize {
        let cameras = self.manifest.cameras.iter().map(|c| &c.name);
        let mut names = cameras.chain(self.manifest.imus.iter().map(|i| &i.name));
        names.position(|n| n == clock).unwrap_or_default()
    }

    /// Samples per second by the recorder's count.
    pub(crate) fn health_rates(&self) -> Chart {
        let mut chart = Chart::new("Samples received per second")
            .x_axis(self.axis())
            .y_axis(Axis::log("rate", "Hz"));
        let mut rates: BTreeMap<&str, Vec<(f64, f64)>> = BTreeMap::new();
        for (time, health) in &self.stats().health {
            for stream in &health.streams {
                let points = rates.entry(&stream.name).or_default();
                points.push((self.seconds(time.0), stream.rate_hz));
            }
        }
        for (name, points) in rates {
            let line = Series::line(name, thin(points)).slot(self.slot(name));
            chart = chart.series(line);
        }
        chart
    }

    /// Bytes waiting for encoders and the disk.
    pub(crate) fn health_queues(&self) -> Chart {
        let health = &self.stats().health;
        let writer = health.iter();
        let writer = writer.map(|(t, h)| (self.seconds(t.0), h.writer_queue_bytes as f64 * 1e-6));
        let encoder = health.iter().map(|(t, h)| {
            let queued = h.streams.iter().map(|s| s.queue_bytes);
            let bytes = queued.fold(0, u64::saturating_add);
            (self.seconds(t.0), bytes as f64 * 1e-6)
        });
        Chart::new("Waiting in the recorder")
            .x_axis(self.axis())
            .y_axis(Axis::linear("bytes", "MB").include(0.0))
            .series(Series::line("for the encoders", thin(encoder.collect())))
            .series(Series::line("for the disk", thin(writer.collect())))
    }

    /// Maximum write and sync latency of each second.
    pub(crate) fn health_latency(&self) -> Chart {
        let health = &self.stats().health;
        let write = health
            .iter()
            .map(|(t, h)| (self.seconds(t.0), h.write_max_ns as f64 * 1e-6));
        let sync = health
            .iter()
            .map(|(t, h)| (self.seconds(t.0), h.sync_max_ns as f64 * 1e-6));
        Chart::new("Longest write and sync of each second")
            .x_axis(self.axis())
            .y_axis(Axis::linear("time", "ms").include(0.0))
            .series(Series::line("write", thin(write.collect())))
            .series(Series::line("sync", thin(sync.collect())))
    }

    /// Free space on the recorder's disk.
    pub(crate) fn health_space(&self) -> Chart {
        let health = self.stats().health.iter();
        let free = health.map(|(t, h)| (self.seconds(t.0), h.free_bytes as f64 * 1e-9));
        Chart::new("Free on the recorder's disk")
            .x_axis(self.axis())
            .y_axis(Axis::linear("space", "GB").include(0.0))
            .series(Series::line("", thin(free.collect())))
    }

    /// Temperature of the recorder; `None` without a sensor.
    pub(crate) fn health_temperature(&self) -> Option<Chart> {
        let health = self.stats().health.iter();
        let points: Vec<_> = health
            .filter_map(|(t, h)| Some((self.seconds(t.0), h.temperature_c?)))
            .collect();
        (!points.is_empty()).then(|| {
            Chart::new("Hottest sensor of the recorder")
                .x_axis(self.axis())
                .y_axis(Axis::linear("temperature", "°C"))
                .series(Series::line("", thin(points)))
        })
    }

    /// One line with rate and longest gap of the cameras, for a caption.
    pub(crate) fn rhythm_caption(&self) -> String {
        let cameras = self.manifest.cameras.iter().zip(&self.stats().cameras);
        let texts = cameras.map(|(camera, frames)| {
            let cadence = Cadence::of(frames.iter().map(|f| f.sample));
            format!(
                "{}: {:.2} Hz, longest gap {}",
                camera.name,
                cadence.rate_hz(),
                charts::si(cadence.longest_gap_ns as f64 * 1e-9, "s")
            )
        });
        texts.collect::<Vec<_>>().join("; ")
    }
}

/// Spans without a gap: consecutive samples at most 2.5 median intervals apart.
fn recorded(samples: &[Sample]) -> Vec<(i64, i64, usize)> {
    let mut steps: Vec<i64> = samples
        .windows(2)
        .map(|w| w[1].time.saturating_sub(w[0].time))
        .collect();
    let usual = crate::cadence::median(&mut steps).unwrap_or(0);
    let mut spans: Vec<(i64, i64, usize)> = Vec::new();
    for sample in samples {
        match spans.last_mut() {
            Some(span) if sample.time.saturating_sub(span.1) <= usual.saturating_mul(5) / 2 => {
                span.1 = span.1.max(sample.time);
            }
            _ => spans.push((sample.time, sample.time, 0)),
        }
    }
    spans
}

/// Host time minus device time by the newest segment of a map, ns.
fn offset_ns(map: &ClockMap) -> Option<i64> {
    let piece = map.pieces.last()?;
    let tick = TickLength {
        num: map.tick_num,
        den: map.tick_den,
    };
    let device = tick.ns(piece.ticks_ref)?;
    piece
        .host_ref
        .checked_sub(device)?
        .checked_sub(map.latency_ns)
}

/// Keeps the minimum and maximum of each interval of a long series.
fn thin(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    if points.len() <= 2 * MAX_POINTS {
        return points;
    }
    let part = points.len().div_ceil(MAX_POINTS);
    let mut kept = Vec::with_capacity(2 * MAX_POINTS);
    for part in points.chunks(part) {
        let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let min = part.iter().min_by(by_value);
        let max = part.iter().max_by(by_value);
        if let (Some(a), Some(b)) = (min, max) {
            let (first, second) = if a.0 <= b.0 { (a, b) } else { (b, a) };
            kept.extend([*first, *second]);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_minimum_and_maximum() {
        let mut points: Vec<(f64, f64)> = (0..100_000).map(|i| (f64::from(i), 1.0)).collect();
        points[77_777].1 = 9.0;
        points[33_333].1 = -9.0;
        let thinned = thin(points);
        assert!(thinned.len() <= 2 * MAX_POINTS);
        assert!(thinned.contains(&(77_777.0, 9.0)) && thinned.contains(&(33_333.0, -9.0)));
        assert!(thinned.windows(2).all(|w| w[0].0 <= w[1].0));
    }

    #[test]
    fn a_gap_splits_a_span() {
        let at = |time| Sample {
            time,
            step_ns: NO_STEP,
        };
        let samples = [0, 10, 20, 30, 90, 100].map(at);
        assert_eq!(recorded(&samples), [(0, 30, 0), (90, 100, 0)]);
    }
}
