//! Evaluation of a session: every metric of [`session_health::TABLE`], measured and compared.
//!
//! Evaluation is arithmetic on the result of [`crate::scan_session`]: the same session and limits
//! give the same findings. A stream without a single sample is a finding (all samples are missing).
//! A metric that cannot be measured (no frame sets, no clock) is either a finding or left out,
//! never a pass.

use std::collections::BTreeSet;

use console_output::text;
use session_access::Frames;
use session_access::decode_check::DecodeCheck;
use session_archive::manifest::{Camera, Manifest};
use session_archive::verify::{Report, StreamReport};
use session_health::{Finding, Limits, Unit, finding};
use video::raw_image::coded_size;

use crate::cadence::{Cadence, median, percentile_99_9};
use crate::condition::Condition;
use crate::scan_session::SessionScan;
use crate::session_stats::{FrameStats, SessionStats};

/// Evaluates a session. `decoded` is the result of the decode check, if requested.
pub(crate) fn evaluate(
    manifest: &Manifest,
    found: &SessionScan,
    decoded: Option<&[DecodeCheck]>,
    limits: &Limits,
) -> Vec<Finding> {
    let mut evaluator = Evaluator {
        manifest,
        stats: &found.stats,
        report: &found.report,
        limits,
        findings: Vec::new(),
    };
    evaluator.session();
    for (i, camera) in manifest.cameras.iter().enumerate() {
        evaluator.camera(i, camera);
    }
    for i in 0..manifest.imus.len() {
        evaluator.imu(i);
    }
    evaluator.offsets();
    evaluator.rig();
    for decoded in decoded.unwrap_or_default() {
        let images = text::count(decoded.images, "image");
        let mut detail = format!("{images} decoded");
        if let Some(problem) = &decoded.first_problem {
            detail.push_str(&format!("; first: {problem}"));
        }
        let missing = decoded.missing as f64;
        evaluator.find("camera.undecoded", &decoded.camera, missing, 0.0, &detail);
    }
    evaluator.findings
}

/// Period of health records, ns.
const HEALTH_PERIOD_NS: f64 = 1e9;

struct Evaluator<'a> {
    manifest: &'a Manifest,
    stats: &'a SessionStats,
    report: &'a Report,
    limits: &'a Limits,
    findings: Vec<Finding>,
}

impl Evaluator<'_> {
    /// Adds a finding: compares `value` with the limits of `metric` for a stream with this nominal
    /// period (ns; 0 if it has none).
    fn find(&mut self, metric: &str, of: &str, value: f64, period_ns: f64, detail: &str) {
        let found = finding(self.limits, metric, of, value, period_ns, detail);
        self.findings.extend(found);
    }

    /// Integrity: damage, and whether the recorder closed the session.
    fn session(&mut self) {
        let condition = Condition::of(self.manifest.state, self.report);
        let faults = faults(self.report);
        let damaged = condition == Condition::Damaged;
        let mut detail = faults.join(", ");
        if damaged {
            detail.push_str("; `paws recover` makes an undamaged copy");
        }
        // An unclosed session may end in the middle of a chunk; this is not damage.
        let count = if damaged { faults.len().max(1) } else { 0 };
        let detail = if damaged { detail } else { String::new() };
        self.find("session.damage", "session", count as f64, 0.0, &detail);
        let detail = match self.report.closed {
            true => "",
            false => "`paws recover` closes a copy of it",
        };
        let open = f64::from(u8::from(!self.report.closed));
        self.find("session.unclosed", "session", open, 0.0, detail);
        self.degraded();
    }

    /// Duration of degraded recording (load shedding). Left out if the recorder does not report it.
    fn degraded(&mut self) {
        let steps = self
            .stats
            .health
            .iter()
            .map(|(_, h)| h.degradation.as_str());
        let steps_reported: Vec<&str> = steps.filter(|step| !step.is_empty()).collect();
        let lowered = |step: &&str| matches!(*step, "lower bitrate" | "lower frame rate");
        let degraded: Vec<&str> = steps_reported.iter().copied().filter(lowered).collect();
        let kinds: BTreeSet<&str> = degraded.iter().copied().collect();
        let detail = kinds.into_iter().collect::<Vec<_>>().join(", ");
        if !steps_reported.is_empty() {
            let time = degraded.len() as f64 * HEALTH_PERIOD_NS;
            self.find("session.degraded", "session", time, 0.0, &detail);
        }
    }

    fn camera(&mut self, i: usize, camera: &Camera) {
        let (name, frames) = (camera.name.as_str(), &self.stats.cameras[i]);
        let period = period_ns(camera.rate_hz);
        let stream = self.stream(name);
        self.missing("camera", name, &stream, "frame");
        let cadence = Cadence::of(frames.iter().map(|f| f.sample));
        self.rhythm("camera", name, &cadence, camera.rate_hz);
        let bad = stream.bad_payloads + stream.repeated;
        self.find("camera.bad", name, bad as f64, 0.0, "");
        self.find("camera.frozen", name, longest_frozen(frames), period, "");
        let sigma = median(&mut frames.iter().map(|f| f.sigma_ns).collect::<Vec<_>>());
        self.sigma(name, sigma);
        let unreliable = frames.iter().filter(|f| f.time_unreliable).count();
        self.find(
            "stream.unreliable_time",
            name,
            unreliable as f64 * period,
            period,
            "",
        );
        self.eyes_apart(name, frames);
        let eyes = ["left", "right"].map(|eye| format!("{name}/{eye}"));
        let without = eyes.iter().filter(|eye| {
            let calibration = self.stats.calibrations.get(*eye);
            calibration.is_none_or(|c| c.k.first().is_none_or(|fx| *fx <= 0.0))
        });
        let without: Vec<_> = without.map(String::as_str).collect();
        let detail = match without.is_empty() {
            true => String::new(),
            false => format!(
                "{}; remedy: {}",
                without.join(", "),
                command_line::remedy::after_recording()
            ),
        };
        self.find(
            "camera.calibration",
            name,
            without.len() as f64,
            0.0,
            &detail,
        );
        self.calibration_size(camera, &eyes);
    }

    /// Difference between the size of the images and that of their calibration, pixels, and eyes
    /// with padded images, which reconstruction reads as images of the calibrated size. Left out
    /// without calibration.
    fn calibration_size(&mut self, camera: &Camera, eyes: &[String]) {
        let (width, height) = (camera.width / 2, camera.height);
        let (mut largest, mut with_padding, mut wrong) = (None, Vec::new(), Vec::new());
        for eye in eyes {
            let Some(calibration) = self.stats.calibrations.get(eye) else {
                continue;
            };
            let (columns, rows) = (calibration.width, calibration.height);
            let difference = columns.abs_diff(width).max(rows.abs_diff(height));
            let text = format!("{eye} {columns}x{rows}");
            // Padding is one pixel at most. A size in a file may be too large to be rounded up.
            let difference = match difference {
                0 => 0,
                1 if coded_size(columns, rows) == (width, height) => {
                    with_padding.push(text);
                    0
                }
                _ => {
                    wrong.push(text);
                    difference
                }
            };
            largest = largest.max(Some(difference));
        }
        let Some(largest) = largest else {
            return;
        };
        let detail = match wrong.is_empty() {
            true => String::new(),
            false => format!(
                "{}, expected {width}x{height}; remedy: a calibration for images of this size, {}",
                wrong.join(", "),
                command_line::remedy::after_recording()
            ),
        };
        let (metric, name) = ("camera.calibration_size", &camera.name);
        self.find(metric, name, largest.into(), 0.0, &detail);
        let detail = match with_padding.is_empty() {
            true => String::new(),
            false => format!(
                "{}, images {width}x{height}: the last row or column is repeated; reconstruction reads them",
                with_padding.join(", ")
            ),
        };
        let (metric, count) = ("camera.calibration_padding", with_padding.len());
        self.find(metric, name, count as f64, 0.0, &detail);
    }

    /// Time offset between left and right images. Left out if one device delivers both.
    fn eyes_apart(&mut self, name: &str, frames: &[FrameStats]) {
        let offsets = frames.iter().filter_map(|f| f.eyes_apart_ns);
        let mut offsets: Vec<i64> = offsets.collect();
        let Some(middle) = median(&mut offsets) else {
            return;
        };
        let mut lengths: Vec<u64> = offsets.iter().map(|ns| ns.unsigned_abs()).collect();
        let max = percentile_99_9(&mut lengths).unwrap_or_default() as f64;
        let side = if middle < 0 { "earlier" } else { "later" };
        let middle = Unit::Time.show(middle.unsigned_abs() as f64);
        let detail = format!("right ones {middle} {side} in the median");
        self.find("camera.eyes_apart", name, max, 0.0, &detail);
    }

    fn imu(&mut self, i: usize) {
        let imu = &self.manifest.imus[i];
        let (name, stats) = (imu.name.as_str(), &self.stats.imus[i]);
        let stream = self.stream(name);
        self.missing("imu", name, &stream, "sample");
        let cadence = Cadence::of(stats.samples.iter().copied());
        self.rhythm("imu", name, &cadence, imu.rate_hz);
        let bad = stream.bad_payloads + stream.repeated;
        self.find("imu.bad", name, bad as f64, 0.0, "");
        let repeated = stats.stuck_ns as f64;
        self.find("imu.stuck_value", name, repeated, 0.0, "");
        self.sigma(name, median(&mut stats.sigmas_ns.clone()));
        let period = period_ns(imu.rate_hz);
        let unreliable = stats.unreliable_samples as f64 * period;
        self.find("stream.unreliable_time", name, unreliable, period, "");
        self.frame_sync(name);
    }

    /// Clock offset between an IMU and its camera, by frame sync. Left out if the device does not
    /// report it.
    fn frame_sync(&mut self, name: &str) {
        let streams = self.stats.health.iter().flat_map(|(_, h)| &h.streams);
        let ties = streams
            .filter(|s| s.name == name)
            .filter_map(|s| s.frame_sync.as_ref());
        let mut ties: Vec<_> = ties.collect();
        ties.sort_by_key(|tie| tie.offset_ns);
        let Some(middle) = ties.get(ties.len() / 2) else {
            return;
        };
        let show = |ns: f64| Unit::Time.show(ns);
        let side = if middle.offset_ns < 0 {
            "early"
        } else {
            "late"
        };
        let detail = format!(
            "{side}, sigma {}; stamps are above their line by {} (99 %)",
            show(middle.sigma_ns as f64),
            show(middle.residual_p99_ns as f64),
        );
        let offset = middle.offset_ns.unsigned_abs() as f64;
        self.find("imu.frame_sync", name, offset, 0.0, &detail);
    }

    fn stream(&self, name: &str) -> StreamReport {
        self.report.streams.get(name).cloned().unwrap_or_default()
    }

    /// Fraction of expected samples that are missing.
    fn missing(&mut self, kind: &str, name: &str, stream: &StreamReport, word: &str) {
        let missing = stream.gaps.saturating_add(stream.lost);
        let expected = stream.expected();
        let (ratio, detail) = match (stream.samples, expected) {
            (0, _) => (1.0, format!("not one {word} was recorded")),
            (_, expected) if missing == 0 => (0.0, format!("{expected} {word}s")),
            (_, expected) => (
                missing as f64 / expected.max(1) as f64,
                format!("{missing} of {}", text::count(expected, word)),
            ),
        };
        self.find(&format!("{kind}.dropped"), name, ratio, 0.0, &detail);
    }

    fn rhythm(&mut self, kind: &str, name: &str, cadence: &Cadence, nominal_hz: f64) {
        let nominal = period_ns(nominal_hz);
        let start = self.stats.span().map_or(0, |(start, _)| start);
        let at = cadence.longest_gap_at.saturating_sub(start) as f64 / 1e9;
        let detail = match cadence.longest_gap_ns {
            0 => String::new(),
            _ => format!("{at:.2} s after the start"),
        };
        let gap = cadence.longest_gap_ns as f64;
        self.find(&format!("{kind}.longest_gap"), name, gap, nominal, &detail);
        let backwards = cadence.backwards as f64;
        self.find(&format!("{kind}.non_monotonic"), name, backwards, 0.0, "");
        if cadence.period_ns > 0.0 {
            let metric = format!("{kind}.period_deviation");
            self.find(&metric, name, cadence.deviation_ns, nominal, "");
        }
        if cadence.period_ns > 0.0 && nominal > 0.0 {
            let rate = cadence.rate_hz();
            let detail = format!("{rate:.2} Hz, nominal {nominal_hz:.2} Hz");
            let off = (rate / nominal_hz - 1.0).abs();
            self.find(&format!("{kind}.rate"), name, off, 0.0, &detail);
        }
    }

    fn sigma(&mut self, name: &str, sigma_ns: Option<u64>) {
        if let Some(sigma) = sigma_ns {
            self.find("stream.clock_sigma", name, sigma as f64, 0.0, "");
        }
    }

    /// Start and end offsets of each stream from the session's span.
    fn offsets(&mut self) {
        let Some((start, end)) = self.stats.span() else {
            return;
        };
        let cameras = self.manifest.cameras.iter().map(|c| &c.name);
        let camera_times = self.stats.cameras.iter().map(|frames| {
            let times = frames.iter().map(|f| f.sample.time);
            times.clone().min().zip(times.max())
        });
        let imus = self.manifest.imus.iter().map(|i| &i.name);
        let imu_times = self.stats.imus.iter().map(|imu| {
            let times = imu.samples.iter().map(|s| s.time);
            times.clone().min().zip(times.max())
        });
        let streams = cameras.zip(camera_times).chain(imus.zip(imu_times));
        for (name, times) in streams.collect::<Vec<_>>() {
            if let Some((first, last)) = times {
                let late = first.saturating_sub(start) as f64;
                self.find("stream.start_offset", name, late, 0.0, "");
                let early = end.saturating_sub(last) as f64;
                self.find("stream.end_offset", name, early, 0.0, "");
            }
        }
    }

    /// Metrics of several cameras: alignment, frame sets, extrinsics.
    fn rig(&mut self) {
        let cameras = &self.manifest.cameras;
        let mut triggers: Vec<&String> =
            cameras.iter().filter_map(|c| c.trigger.as_ref()).collect();
        triggers.sort();
        triggers.dedup();
        // Times flagged as unreliable are excluded here; they have their own metric.
        let of_camera = |(i, frames): (usize, &Vec<FrameStats>)| {
            let unreliable = frames.iter().filter(|f| f.time_unreliable);
            unreliable.map(|f| (i, f.sample.time)).collect::<Vec<_>>()
        };
        let camera_stats = self.stats.cameras.iter().enumerate();
        let unreliable: BTreeSet<(usize, i64)> = camera_stats.flat_map(of_camera).collect();
        for trigger in triggers {
            let group: Vec<usize> = (0..cameras.len())
                .filter(|i| cameras[*i].trigger.as_ref() == Some(trigger))
                .collect();
            let mut spreads: Vec<u64> = self
                .stats
                .sets
                .iter()
                .filter(|set| !set.members.iter().any(|m| unreliable.contains(m)))
                .filter_map(|set| spread(&set.members, &group))
                .collect();
            if let Some(spread) = percentile_99_9(&mut spreads) {
                let names: Vec<_> = group.iter().map(|i| cameras[*i].name.as_str()).collect();
                let of = names.join(" and ");
                self.find("rig.misalignment", &of, spread as f64, 0.0, "");
            }
        }
        let slowest = cameras.iter().map(|c| period_ns(c.rate_hz));
        let slowest = slowest.fold(0.0, f64::max);
        let free = cameras
            .iter()
            .enumerate()
            .filter(|(_, c)| c.trigger.is_none());
        for (i, camera) in free {
            let sets = self.stats.sets.iter();
            let mut distances: Vec<u64> = sets
                .filter_map(|set| {
                    let own = set.members.iter().find(|m| m.0 == i)?;
                    Some(own.1.abs_diff(set.time))
                })
                .collect();
            if let Some(distance) = percentile_99_9(&mut distances) {
                let distance = distance as f64;
                self.find("rig.free_misalignment", &camera.name, distance, slowest, "");
            }
        }
        if cameras.len() > 1 {
            let without = if self.stats.sets.is_empty() {
                cameras.len()
            } else {
                0
            };
            let detail = text::count(self.stats.sets.len() as u64, "frame set");
            self.find("rig.frame_sets", "rig", without as f64, 0.0, &detail);
        }
        self.poses();
    }

    /// Whether every camera has stereo extrinsics, and a pose on the rig if the rig is described at
    /// all.
    fn poses(&mut self) {
        let transforms = self.stats.transforms.clone().unwrap_or_default();
        let frames = Frames::of(&transforms);
        let cameras = &self.manifest.cameras;
        let has_pose = |name: &str| frames.transform("rig", &format!("{name}/left")).is_some();
        let described = cameras.iter().any(|c| has_pose(&c.name));
        let without_pose: Vec<&str> = cameras
            .iter()
            .map(|c| c.name.as_str())
            .filter(|name| {
                let [left, right] = ["left", "right"].map(|eye| format!("{name}/{eye}"));
                frames.transform(&left, &right).is_none() || (described && !has_pose(name))
            })
            .collect();
        let detail = match (without_pose.is_empty(), described) {
            (false, _) => {
                let names = without_pose.join(", ");
                format!(
                    "{names}; remedy: {}",
                    command_line::remedy::after_recording()
                )
            }
            (true, true) => "all on the rig".to_owned(),
            (true, false) => format!(
                "stereo only; no rig file gives poses of the cameras, which `{}` estimates",
                command_line::remedy::CALIBRATE
            ),
        };
        self.find(
            "rig.transforms",
            "rig",
            without_pose.len() as f64,
            0.0,
            &detail,
        );
    }
}

fn period_ns(rate_hz: f64) -> f64 {
    if rate_hz.is_finite() && rate_hz > 0.0 {
        1e9 / rate_hz
    } else {
        0.0
    }
}

/// Longest time with an unchanged image, ns: from the last good frame to the last frozen one.
fn longest_frozen(frames: &[FrameStats]) -> f64 {
    let mut longest = 0;
    let mut fresh = None;
    for frame in frames {
        if !frame.frozen || fresh.is_none() {
            fresh = Some(frame.sample.time);
        }
        if let (true, Some(since)) = (frame.frozen, fresh) {
            // A recording that begins frozen: one nanosecond makes the value nonzero.
            longest = longest.max(frame.sample.time.saturating_sub(since).max(1));
        }
    }
    longest as f64
}

/// Time spread of the members of a group, ns, if at least two are in the set.
fn spread(members: &[(usize, i64)], group: &[usize]) -> Option<u64> {
    let times = members.iter().filter(|m| group.contains(&m.0)).map(|m| m.1);
    let (first, last) = (times.clone().min()?, times.clone().max()?);
    (times.count() > 1).then(|| last.abs_diff(first))
}

/// Faults of a session, as text.
pub(crate) fn faults(report: &Report) -> Vec<String> {
    let mut faults = Vec::new();
    faults.extend(report.manifest_note.clone());
    if !report.missing_segments.is_empty() {
        faults.push(format!("missing segments {:?}", report.missing_segments));
    }
    if !report.bad_rig_files.is_empty() {
        let files = report.bad_rig_files.join(", ");
        faults.push(format!("rig files missing or altered: {files}"));
    }
    let bytes = report
        .damage
        .iter()
        .map(|d| d.damage.bytes.end.saturating_sub(d.damage.bytes.start))
        .fold(0, u64::saturating_add);
    if !report.damage.is_empty() {
        let poses = text::count(report.damage.len() as u64, "place");
        faults.push(format!("{poses} with damage ({})", text::bytes(bytes)));
    }
    if report.undecodable > 0 {
        let messages = text::count(report.undecodable, "message");
        faults.push(format!("{messages} that cannot be decoded"));
    }
    for (name, stream) in &report.streams {
        for (n, what) in [
            (stream.lost, "lost without a gap record"),
            (stream.repeated, "twice or out of order"),
            (stream.contradicted, "present against a gap record"),
            (stream.bad_payloads, "with a bad payload"),
        ] {
            if n > 0 {
                faults.push(format!("{name}: {} {what}", text::count(n, "sample")));
            }
        }
    }
    faults
}
