//! Screening: which parts of a recording are static.
//!
//! The samples are processed in blocks of a second. Noise is the same in all of them, so that a
//! block whose spread or mean deviates is not noise. All thresholds are relative to the medians of
//! the recording itself, except for the last: no IMU worth calibrating is as noisy as one that is
//! carried.

use std::ops::Range;

use super::config::ScreeningConfig;
use super::series::{AXES, Finding, Series, Severity};

/// Result of the screening.
pub(super) struct Screening {
    /// Sample period, s.
    pub(super) period_s: f64,
    /// Static runs without gap.
    pub(super) still: Vec<Range<usize>>,
    /// Axes that never change.
    pub(super) dead: [bool; 6],
    pub(super) findings: Vec<Finding>,
}

/// An excluded span.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Span {
    from: usize,
    to: usize,
}

struct Screen<'a> {
    config: &'a ScreeningConfig,
    series: &'a Series,
    period_s: f64,
    findings: Vec<Finding>,
    spans: Vec<Span>,
    dead: [bool; 6],
}

pub(super) fn screen(series: &Series, config: &ScreeningConfig) -> Screening {
    let (mut samples, mut seconds) = (0, 0.0);
    for run in series.runs.iter().filter(|run| run.len() > 1) {
        samples += run.len() - 1;
        seconds += series.times_s[run.end - 1] - series.times_s[run.start];
    }
    let mut screen = Screen {
        config,
        series,
        period_s: seconds / samples as f64,
        findings: Vec::new(),
        spans: Vec::new(),
        dead: [false; 6],
    };
    let usable = screen.period_s.is_finite() && screen.period_s > 0.0;
    if !usable {
        screen.finding(
            Severity::Fail,
            "short",
            "there are no two samples whose times differ".to_owned(),
        );
        screen.period_s = 1.0;
    } else {
        screen.rate();
        screen.gaps();
        screen.not_finite();
        for axis in 0..6 {
            screen.values(axis);
        }
        screen.repeats();
        screen.motion();
        screen.temperature();
    }
    let still = if usable { screen.left() } else { Vec::new() };
    Screening {
        period_s: screen.period_s,
        still,
        dead: screen.dead,
        findings: screen.findings,
    }
}

impl Screen<'_> {
    fn finding(&mut self, severity: Severity, kind: &'static str, text: String) {
        self.findings.push(Finding {
            severity,
            kind,
            text,
        });
    }

    fn seconds(&self, at: usize) -> f64 {
        let times = &self.series.times_s;
        times[at.min(times.len() - 1)] - times[0]
    }

    fn between(&self, span: Span) -> String {
        let (from, to) = (self.seconds(span.from), self.seconds(span.to - 1));
        format!("between {from:.1} s and {to:.1} s")
    }

    /// Checks rate and jitter of the samples.
    fn rate(&mut self) {
        let (rate, nominal) = (1.0 / self.period_s, self.series.nominal_rate_hz);
        if (rate / nominal - 1.0).abs() > self.config.max_rate_deviation {
            let text = format!("sample rate {rate:.2} Hz, nominal {nominal:.2} Hz");
            self.finding(Severity::Note, "rate", text);
        }
        let (mut steps, mut off, mut worst) = (0_u64, 0_u64, 0.0_f64);
        for run in &self.series.runs {
            for pair in self.series.times_s[run.clone()].windows(2) {
                let away = ((pair[1] - pair[0]) / self.period_s - 1.0).abs();
                steps += 1;
                off += u64::from(away > self.config.jitter_periods);
                worst = worst.max(away);
            }
        }
        let share = off as f64 / steps.max(1) as f64;
        if share > self.config.max_jitter_ratio {
            let text = format!(
                "{:.1} % of the samples come more than {} periods early or late, the worst by {:.1} \
                 periods: averages over a fixed number of samples are not over a fixed time",
                100.0 * share,
                self.config.jitter_periods,
                worst
            );
            self.finding(Severity::Warn, "jitter", text);
        }
    }

    fn gaps(&mut self) {
        let runs = self.series.runs.len();
        if runs > 1 {
            let longest = self.series.runs.iter().map(Range::len).max().unwrap_or(0);
            let text = format!(
                "{} cut the recording; the longest stretch without one is {:.0} s, and averages longer than a \
                 fifth of that cannot be made",
                if runs == 2 {
                    "a gap".to_owned()
                } else {
                    format!("{} gaps", runs - 1)
                },
                longest as f64 * self.period_s
            );
            self.finding(Severity::Note, "gaps", text);
        }
    }

    fn not_finite(&mut self) {
        let samples = 0..self.series.times_s.len();
        let bad = |i: &usize| self.series.axes.iter().any(|axis| !axis[*i].is_finite());
        let bad: Vec<usize> = samples.filter(bad).collect();
        if let Some(first) = bad.first() {
            let text = format!(
                "{} samples are not finite numbers, the first at {:.1} s; left out",
                bad.len(),
                self.seconds(*first)
            );
            self.finding(Severity::Warn, "not finite", text);
            self.spans
                .extend(bad.iter().map(|&i| Span { from: i, to: i + 1 }));
        }
    }

    /// Checks one axis for frozen, saturated and coarse values.
    fn values(&mut self, index: usize) {
        let (axis, name) = (&self.series.axes[index], AXES[index]);
        let all: Vec<f64> = axis.iter().copied().filter(|v| v.is_finite()).collect();
        let (Some(least), Some(greatest)) = (
            all.iter().copied().reduce(f64::min),
            all.iter().copied().reduce(f64::max),
        ) else {
            return;
        };
        let unit = if index < 3 { "rad/s" } else { "m/s²" };
        if least == greatest {
            self.dead[index] = true;
            let text = format!("{name} never changes: it is always {least} {unit}");
            self.finding(Severity::Warn, "frozen", text);
            return;
        }
        // A repetition has a probability that the recording itself gives; a run of n repetitions
        // has its power.
        let equal = all.windows(2).filter(|w| w[0] == w[1]).count();
        let chance = (equal as f64 / all.len() as f64).clamp(1e-6, 0.999_999);
        let unlikely =
            ((self.config.frozen_odds * all.len() as f64).ln() / -chance.ln()).ceil() as usize;
        let long = unlikely.max(self.config.min_frozen_samples);
        let mut frozen: Vec<Span> = Vec::new();
        let mut from = 0;
        for i in 1..=axis.len() {
            if i == axis.len() || axis[i] != axis[from] {
                if i - from > long {
                    frozen.push(Span { from, to: i });
                }
                from = i;
            }
        }
        if let Some(first) = frozen.first() {
            let samples: usize = frozen.iter().map(|s| s.to - s.from).sum();
            let text = format!(
                "{name} is frozen {}{}, {:.1} s in all; left out",
                self.between(*first),
                match frozen.len() {
                    1 => String::new(),
                    n => format!(" and {} times more", n - 1),
                },
                samples as f64 * self.period_s
            );
            self.finding(Severity::Warn, "frozen", text);
            self.spans.extend(frozen);
        }
        let mut levels: Vec<f64> = Vec::new();
        for value in &all {
            if levels.len() > self.config.min_levels {
                break;
            }
            if !levels.contains(value) {
                levels.push(*value);
            }
        }
        if levels.len() < self.config.min_levels {
            let text = format!(
                "{name} takes only {} different values: its counts are coarser than its noise",
                levels.len()
            );
            self.finding(Severity::Warn, "coarse", text);
            return;
        }
        for end in [least, greatest] {
            let there = all.iter().filter(|v| **v == end).count() as f64 / all.len() as f64;
            if there > self.config.max_clipped_ratio {
                let text = format!(
                    "{name}: {:.2} % of the values are exactly {end} {unit}, the end of its range: clipped",
                    100.0 * there
                );
                self.finding(Severity::Warn, "clipped", text);
            }
        }
    }

    /// Checks for repeated samples.
    fn repeats(&mut self) {
        let n = self.series.times_s.len();
        let live: Vec<&Vec<f64>> = (0..6)
            .filter(|i| !self.dead[*i])
            .map(|i| &self.series.axes[i])
            .collect();
        let same = |i: &usize| live.iter().all(|axis| axis[*i] == axis[*i - 1]);
        let repeated = (1..n).filter(same).count() as f64 / n.max(1) as f64;
        if !live.is_empty() && repeated > self.config.max_repeated_ratio {
            let text = format!(
                "{:.0} % of the samples repeat the one before: the sensor gives new values at about {:.0} Hz only",
                100.0 * repeated,
                (1.0 - repeated) / self.period_s
            );
            self.finding(Severity::Warn, "repeated", text);
        }
    }

    /// Finds blocks with motion.
    fn motion(&mut self) {
        let config = self.config;
        let size = ((config.block_s / self.period_s).round() as usize).max(8);
        let whole = |run: &Range<usize>| {
            let (start, end) = (run.start, run.end);
            (start..end)
                .step_by(size)
                .filter(move |at| at + size <= end)
        };
        let starts: Vec<usize> = self.series.runs.iter().flat_map(whole).collect();
        let mut moved = vec![false; starts.len()];
        let mut wild: Vec<(usize, usize)> = Vec::new();
        for (index, axis) in self.series.axes.iter().enumerate() {
            if self.dead[index] {
                continue;
            }
            let sensor = index / 3;
            let blocks: Vec<(f64, f64)> = starts
                .iter()
                .map(|&at| mean_and_spread(&axis[at..at + size]))
                .collect();
            let of = |pick: fn(&(f64, f64)) -> f64| median(blocks.iter().map(pick).collect());
            let (usual_mean, usual) = (of(|b| b.0), of(|b| b.1));
            if usual > config.max_motion[sensor] {
                let text = format!(
                    "the IMU moved all the time: {} spreads by {usual:.2} {} within a second",
                    AXES[index],
                    if sensor == 0 { "rad/s" } else { "m/s²" }
                );
                self.finding(Severity::Fail, "moved", text);
                return;
            }
            for (i, &(mean, spread)) in blocks.iter().enumerate() {
                let away = (mean - usual_mean).abs()
                    > config.max_mean_change[sensor].max(config.max_spread_ratio * usual);
                // The first quiet block after a motion is also a step, but no motion.
                let follows = i > 0 && starts[i] == starts[i - 1] + size && !moved[i - 1];
                let step = follows
                    && (mean - blocks[i - 1].0).abs()
                        > config.max_step[sensor].max(config.max_spread_ratio * usual);
                // Frozen values have no spread; they are found elsewhere.
                let hot = spread > config.max_spread_ratio * usual && usual > 0.0;
                if !(away || step || hot) {
                    continue;
                }
                let block = &axis[starts[i]..starts[i] + size];
                let middle = median(block.to_vec());
                let is_wild = |v: &&f64| (**v - middle).abs() > config.outlier_sigma * usual;
                let count = block.iter().filter(is_wild).count();
                if hot
                    && (1..=config.max_outliers).contains(&count)
                    && (middle - usual_mean).abs() < config.max_mean_change[sensor]
                {
                    wild.push((starts[i], index));
                } else {
                    moved[i] = true;
                }
            }
        }
        wild.retain(|(at, _)| starts.iter().zip(&moved).all(|(s, m)| s != at || !m));
        wild.sort_unstable();
        if let Some(&(first, index)) = wild.first() {
            let text = format!(
                "single values stand out by more than {:.0} times the usual spread in {} s, first of {} at {:.1} s; \
                 these seconds are left out",
                config.outlier_sigma,
                wild.len(),
                AXES[index],
                self.seconds(first)
            );
            self.finding(Severity::Warn, "outliers", text);
            let spans = wild.iter().map(|&(at, _)| Span {
                from: at,
                to: at + size,
            });
            self.spans.extend(spans);
        }
        let margin = (config.motion_margin_s / self.period_s).round() as usize;
        let end = self.series.times_s.len();
        let mut motions: Vec<(Span, Span)> = Vec::new();
        for (&at, _) in starts.iter().zip(&moved).filter(|(_, moved)| **moved) {
            let exact = Span {
                from: at,
                to: at + size,
            };
            let wide = Span {
                from: at.saturating_sub(margin),
                to: (at + size + margin).min(end),
            };
            match motions.last_mut() {
                Some((seen, left_out)) if wide.from <= left_out.to => {
                    seen.to = exact.to;
                    left_out.to = wide.to;
                }
                _ => motions.push((exact, wide)),
            }
        }
        for (seen, _) in motions.iter().take(3) {
            let text = format!("the IMU moved {}; left out", self.between(*seen));
            self.finding(Severity::Warn, "moved", text);
        }
        if motions.len() > 3 {
            let text = format!("the IMU moved {} times more", motions.len() - 3);
            self.finding(Severity::Warn, "moved", text);
        }
        self.spans.extend(motions.iter().map(|m| m.1));
    }

    fn temperature(&mut self) {
        let known = || {
            self.series
                .temperature_c
                .iter()
                .copied()
                .filter(|t| t.is_finite())
        };
        let (Some(least), Some(greatest)) = (known().reduce(f32::min), known().reduce(f32::max))
        else {
            return;
        };
        let (first, last) = (
            known().next().unwrap_or(least),
            known().next_back().unwrap_or(least),
        );
        if greatest - least > self.config.max_temperature_change_k {
            let text = format!(
                "the temperature went from {first:.1} to {last:.1} °C, between {least:.1} and {greatest:.1} °C: \
                 biases follow it, and B and K come out larger than at rest"
            );
            self.finding(Severity::Warn, "temperature", text);
        }
    }

    /// The runs without the excluded spans.
    fn left(&mut self) -> Vec<Range<usize>> {
        self.spans.sort_by_key(|span| (span.from, span.to));
        let mut still = Vec::new();
        for run in &self.series.runs {
            let mut from = run.start;
            for span in self
                .spans
                .iter()
                .filter(|s| s.to > run.start && s.from < run.end)
            {
                if span.from > from {
                    still.push(from..span.from);
                }
                from = from.max(span.to);
            }
            if from < run.end {
                still.push(from..run.end);
            }
        }
        let longest = still.iter().map(Range::len).max().unwrap_or(0) as f64 * self.period_s;
        let least = self.config.min_static_s;
        if longest < least {
            let text = format!(
                "the longest stretch that can be used is {longest:.1} s, and at least {least:.0} s are needed"
            );
            self.finding(Severity::Fail, "short", text);
        }
        still
    }
}

fn mean_and_spread(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares = values.iter().map(|v| (v - mean).powi(2));
    (mean, (squares.sum::<f64>() / n).sqrt())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.retain(|v| v.is_finite());
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
