//! `bench sync`: accuracy of clock mapping from arrival times.
//!
//! Devices with known clocks send samples through latencies of known shape; four methods map ticks
//! to times ([`methods`]). For each this measures the errors of the times, whether the method
//! flagged them, and the cost: against the number of samples, against the strength of each fault
//! ([`faults`]), and error against cost.
//!
//! An error is that of a time against the instant at which the sample was taken, the device's tick
//! (39 us) rounded down included.
//!
//! A method that gives a sigma is *silently wrong* where the error of a time is more than 5 of them
//! and it neither was nor is flagged; one that gives none, where the error is more than 1 ms.

#![expect(
    clippy::disallowed_methods,
    reason = "a benchmark measures durations, and records its date"
)]

mod faults;
mod methods;
mod report;
mod scoring;
mod world;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, bail};
use serde_json::{Value, json};

use self::faults::Fault;
use self::scoring::{Class, Score, run as score_run};
pub(crate) use self::world::Random;
use self::world::{LATENCY_NS, Sample, US, World};
use crate::meter::quantile;

/// Sample rates: a camera and an IMU, Hz.
const RATES: [f64; 2] = [30.0, 400.0];
/// First seed; the method was tuned on smaller ones.
const FIRST_SEED: u64 = 20_000;
/// Lower ends of the windows of sample numbers in which errors are collected.
const COUNTS: [usize; 9] = [3, 10, 30, 100, 300, 1000, 3000, 10_000, 30_000];

/// Runs the benchmark; `--quick` for a few seeds only, `--out DIR` for another folder.
pub(crate) fn run(args: &[String]) -> anyhow::Result<()> {
    let mut out = PathBuf::from("docs/benchmarks");
    let mut seeds = 20;
    let mut args_left = args.iter();
    while let Some(arg) = args_left.next() {
        match arg.as_str() {
            "--quick" => seeds = 3,
            "--out" => out = args_left.next().context("--out needs a folder")?.into(),
            _ => bail!("unknown argument {arg:?}; known are --quick and --out DIR"),
        }
    }
    let mut results = Results::default();
    for rate_hz in RATES {
        results.by_samples.extend(by_samples(rate_hz, seeds));
        results.costs.extend(costs(rate_hz));
        for fault in faults::all() {
            for &strength in &fault.strengths {
                results
                    .points
                    .extend(point(&fault, strength, rate_hz, seeds));
            }
        }
    }
    report::print(&results);
    report::write(&results, seeds, args, &out)
}

/// All results.
#[derive(Default)]
struct Results {
    by_samples: Vec<BySamples>,
    points: Vec<Point>,
    costs: Vec<Cost>,
}

/// Errors of one method around the n-th sample.
struct BySamples {
    method: &'static str,
    rate_hz: f64,
    samples: usize,
    median_ns: f64,
    p99_ns: f64,
}

/// One method at one strength of one fault.
struct Point {
    method: &'static str,
    fault: &'static str,
    unit: &'static str,
    strength: f64,
    label: String,
    rate_hz: f64,
    score: Score,
}

/// Cost of one method.
struct Cost {
    method: &'static str,
    rate_hz: f64,
    cost_ns: f64,
}

/// Mean latency above the minimum, which the averaging methods are given.
fn mean_latency(samples: &[Sample]) -> f64 {
    let late = |s: &Sample| s.arrival as f64 - s.taken - LATENCY_NS as f64;
    samples.iter().map(late).sum::<f64>() / samples.len().max(1) as f64
}

fn by_samples(rate_hz: f64, seeds: u64) -> Vec<BySamples> {
    let counts: Vec<usize> = COUNTS
        .into_iter()
        .filter(|&n| n as f64 <= 110.0 * rate_hz)
        .collect();
    let last = counts.last().map_or(0, |n| n * 6 / 5);
    // By method and window.
    let mut errors: Vec<Vec<Vec<f64>>> = Vec::new();
    let mut names = Vec::new();
    for seed in 0..5 * seeds {
        let samples = World::new(FIRST_SEED + seed, rate_hz, last as f64 / rate_hz + 1.0).samples();
        for (m, method) in methods::all(mean_latency(&samples), None)
            .iter_mut()
            .enumerate()
        {
            if errors.len() == m {
                errors.push(vec![Vec::new(); counts.len()]);
                names.push(method.name());
            }
            for (i, s) in samples.iter().enumerate() {
                let stamp = method.stamp(s);
                let n = i + 1;
                let Some(window) = counts.iter().position(|&c| c <= n && n <= c * 6 / 5) else {
                    continue;
                };
                if let Some(stamp) = stamp {
                    errors[m][window].push((stamp.time - s.taken).abs());
                }
            }
        }
    }
    let mut rows = Vec::new();
    for (method, windows) in names.into_iter().zip(errors) {
        for (&samples, mut errors) in counts.iter().zip(windows) {
            errors.sort_by(f64::total_cmp);
            rows.push(BySamples {
                method,
                rate_hz,
                samples,
                median_ns: quantile(&errors, 0.5),
                p99_ns: quantile(&errors, 0.99),
            });
        }
    }
    rows
}

fn point(fault: &Fault, strength: f64, rate_hz: f64, seeds: u64) -> Vec<Point> {
    let mut scores: Vec<Vec<Score>> = Vec::new();
    let mut names = Vec::new();
    for seed in 0..seeds {
        let world = (fault.make)(
            World::new(FIRST_SEED + seed, rate_hz, fault.seconds),
            strength,
        );
        let samples = world.samples();
        for (m, method) in methods::all(mean_latency(&samples), world.bits)
            .iter_mut()
            .enumerate()
        {
            if scores.len() == m {
                scores.push(Vec::new());
                names.push(method.name());
            }
            scores[m].push(score_run(method.as_mut(), &samples));
        }
    }
    names
        .into_iter()
        .zip(scores)
        .map(|(method, scores)| Point {
            method,
            fault: fault.name,
            unit: fault.unit,
            strength,
            label: (fault.label)(strength),
            rate_hz,
            score: Score::join(scores),
        })
        .collect()
}

/// Nanoseconds per sample, the least of several runs: what else the machine does only adds.
fn costs(rate_hz: f64) -> Vec<Cost> {
    let samples = World::new(1, rate_hz, 40_000.0 / rate_hz).samples();
    let mean = mean_latency(&samples);
    let runs: Vec<Vec<(&'static str, f64)>> = (0..7)
        .map(|_| {
            let time = |method: &mut Box<dyn methods::Method>| {
                let started = Instant::now();
                for s in &samples {
                    std::hint::black_box(method.stamp(s));
                }
                let ns = started.elapsed().as_nanos() as f64;
                (method.name(), ns / samples.len() as f64)
            };
            methods::all(mean, None).iter_mut().map(time).collect()
        })
        .collect();
    (0..runs[0].len())
        .map(|m| Cost {
            method: runs[0][m].0,
            rate_hz,
            cost_ns: runs
                .iter()
                .map(|run| run[m].1)
                .fold(f64::INFINITY, f64::min),
        })
        .collect()
}

impl Point {
    fn to_json(&self) -> Value {
        let s = &self.score;
        let us = |ns: f64| (ns.is_finite()).then(|| (ns / US * 1000.0).round() / 1000.0);
        let with_sigma = s.sigma_sum > 0.0;
        json!({
            "fault": self.fault,
            "strength": self.strength,
            "unit": self.unit,
            "rate_hz": self.rate_hz,
            "method": self.method,
            "class": s.class().name(),
            "median_us": us(s.quantile(0.5)),
            "p99_us": us(s.quantile(0.99)),
            "max_us": us(s.quantile(1.0)),
            "p99_mapped_again_us": us(quantile(&s.again, 0.99)),
            "mean_sigma_us": if with_sigma { us(s.mean_sigma()) } else { None },
            "worst_error_in_sigmas": with_sigma.then_some(s.worst_sigmas),
            "flagged_share": s.flagged as f64 / s.samples.max(1) as f64,
            "samples": s.samples,
            "silently_wrong_when_given": s.silent_at_first,
            "silently_wrong": s.silent,
        })
    }
}

impl Results {
    /// Points of one method that ended as `class`.
    fn count(&self, method: &str, class: Class) -> usize {
        let mine = |p: &&Point| p.method == method && p.score.class() == class;
        self.points.iter().filter(mine).count()
    }
}
