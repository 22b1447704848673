//! `frame_sync`: errors of IMU times against those of its camera, with a simulated ZED Mini of
//! known truth.
//!
//! Two methods get the same reports, timestamps and arrivals: the frame-sync estimator of crate
//! `zed`, and the method of zed-open-capture. Errors are those of a sample's time against the
//! camera's stamps, less the stamps' constant latency, from [`SCORED_FROM_S`] on. Varied are what
//! delays the reader of the IMU (jitter, bursts, load), what delays the camera's stamps, and for
//! the uptime of the device; then the decrease of the error with the observed time.
//!
//! The estimator is *silently wrong* where the error of a time is more than five of its sigmas; the
//! peer states none.

mod methods;
mod world;

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use charts::{Axis, Chart, Series};
use serde_json::{Value, json};

use self::methods::{FrameSyncMethod, Method, ZedOpenCapture};
use self::world::{Event, MS, S, World};
use crate::arguments::Arguments;
use crate::meter::quantile;
use crate::stamp;

/// Errors count from here on.
const SCORED_FROM_S: f64 = 10.0;
/// Target: p99 of the error with 5 ms of jitter, ms.
const TARGET_P99_MS: f64 = 0.5;
/// Number of sigmas beyond which an error is silently wrong.
const FLAG_SIGMAS: f64 = 5.0;
/// Sampling stride of the stored errors.
const ERROR_STRIDE: u64 = 16;
/// First seed; the method was tuned on others.
const FIRST_SEED: u64 = 40_000;
/// Ends of the time spans of the third chart, s.
const OBSERVED_S: [f64; 8] = [3.0, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0, 300.0];

/// A varied quantity: file, description, unit, strengths, and the effect of a strength.
struct Sweep {
    name: &'static str,
    words: &'static str,
    unit: &'static str,
    strengths: &'static [f64],
    /// Strengths are spread over decades.
    log: bool,
    make: fn(&mut World, f64),
}

const SWEEPS: &[Sweep] = &[
    Sweep {
        name: "jitter",
        words: "mean delay of the IMU's reader",
        unit: "ms",
        strengths: &[0.0, 1.0, 2.0, 5.0, 10.0, 20.0],
        log: false,
        make: |w, ms| w.reader_jitter = ms * MS,
    },
    Sweep {
        name: "bursts",
        words: "delay of all reports, one second in ten",
        unit: "ms",
        strengths: &[0.0, 2.0, 5.0, 10.0, 20.0],
        log: false,
        make: |w, ms| w.burst = ms * MS,
    },
    Sweep {
        name: "load",
        words: "share of time in which the processor is busy",
        unit: "",
        strengths: &[0.0, 0.2, 0.4, 0.6, 0.8, 0.95],
        log: false,
        make: |w, share| w.load = share,
    },
    Sweep {
        name: "stamps",
        words: "mean delay of the camera's timestamps",
        unit: "ms",
        strengths: &[0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0],
        log: true,
        make: |w, ms| w.stamp_jitter = ms * MS,
    },
    Sweep {
        name: "uptime",
        words: "uptime of the device, without delays",
        unit: "h",
        strengths: &[1.0 / 6.0, 1.0, 8.0, 24.0, 168.0, 720.0],
        log: true,
        make: |w, hours| {
            w.uptime_s = hours * 3600.0;
            w.reader_jitter = 0.0;
        },
    },
];

/// Errors of one method, ns.
#[derive(Default)]
struct Score {
    /// Absolute errors, sorted at the end.
    errors: Vec<f64>,
    /// The same by observed time.
    by_time: Vec<Vec<f64>>,
    samples: u64,
    without: u64,
    silent: u64,
    /// Errors of more than half a frame period.
    wrong_frame: u64,
    sigma_sum: f64,
}

/// One method at one strength.
struct Point {
    sweep: usize,
    strength: f64,
    method: &'static str,
    score: Score,
}

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. A target that is missed is a result and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let origin = stamp::stamp("frame_sync", args)?;
    let (seconds, seeds) = if quick { (60.0, 2) } else { (600.0, 5) };
    let mut points = Vec::new();
    for (k, sweep) in SWEEPS.iter().enumerate() {
        for &strength in sweep.strengths {
            let scores = measure(seeds, |seed| {
                let mut world = World::new(FIRST_SEED + seed, seconds);
                (sweep.make)(&mut world, strength);
                world
            });
            for (method, score) in scores {
                print(sweep, strength, method, &score);
                points.push(Point {
                    sweep: k,
                    strength,
                    method,
                    score,
                });
            }
        }
    }
    let rates = rates(seeds, seconds);
    write(&points, &rates, &origin, &out)
}

/// Sample and frame rates of this camera model, without load and with 5 ms of jitter.
fn rates(seeds: u64, seconds: f64) -> Vec<Value> {
    let mut rows = Vec::new();
    for imu_hz in [400.0, 800.0] {
        for frame_hz in [15.0, 30.0, 60.0, 100.0] {
            let scores = measure(seeds, |seed| World {
                imu_hz,
                frame_hz,
                ..World::new(FIRST_SEED + seed, seconds.min(120.0))
            });
            for (method, score) in scores {
                let row = json!({ "imu_hz": imu_hz, "frame_hz": frame_hz, "method": method, "score": score.json() });
                println!("{row}");
                rows.push(row);
            }
        }
    }
    rows
}

/// Both methods on the worlds of some seeds.
fn measure(seeds: u64, world: impl Fn(u64) -> World) -> Vec<(&'static str, Score)> {
    let mut scores = [Score::default(), Score::default()];
    let mut names = [""; 2];
    for seed in 0..seeds {
        let world = world(seed);
        let methods: [Box<dyn Method>; 2] = [
            Box::new(FrameSyncMethod::new()),
            Box::new(ZedOpenCapture::default()),
        ];
        for ((mut method, score), name) in methods.into_iter().zip(&mut scores).zip(&mut names) {
            *name = method.name();
            evaluate(method.as_mut(), &world, score);
        }
    }
    for score in &mut scores {
        score.errors.sort_by(f64::total_cmp);
        for errors in &mut score.by_time {
            errors.sort_by(f64::total_cmp);
        }
    }
    names.into_iter().zip(scores).collect()
}

fn evaluate(method: &mut dyn Method, world: &World, score: &mut Score) {
    score.by_time.resize(OBSERVED_S.len(), Vec::new());
    let mut count = 0_u64;
    world.run(&mut |event| match event {
        Event::Frame(frame) => method.frame(&frame),
        Event::Sample(arrival) => {
            let stamp = method.sample(&arrival.sample, arrival.host_ns);
            count += 1;
            if !count.is_multiple_of(ERROR_STRIDE) {
                return;
            }
            let observed_s = arrival.taken / S;
            let error = stamp.map(|s| (s.time - method.base() - arrival.taken).abs());
            // The spans are centered on their nominal times.
            let here = |&s: &f64| (s / 1.2..s * 1.2).contains(&observed_s);
            if let (Some(span), Some(error)) = (OBSERVED_S.iter().position(here), error) {
                score.by_time[span].push(error);
            }
            if observed_s < SCORED_FROM_S {
                return;
            }
            score.samples += 1;
            let (Some(stamp), Some(error)) = (stamp, error) else {
                score.without += 1;
                return;
            };
            score.errors.push(error);
            score.wrong_frame += u64::from(error > 0.5 * S / world.frame_hz);
            if let Some(sigma) = stamp.sigma {
                score.silent += u64::from(error > FLAG_SIGMAS * sigma);
                score.sigma_sum += sigma;
            }
        }
    });
}

impl Score {
    fn ms(&self, share: f64) -> f64 {
        quantile(&self.errors, share) / MS
    }

    fn json(&self) -> Value {
        let us = |ns: f64| ns.is_finite().then(|| (ns / 1e3 * 10.0).round() / 10.0);
        let timed = self.errors.len().max(1) as f64;
        json!({
            "median_us": us(quantile(&self.errors, 0.5)),
            "p99_us": us(quantile(&self.errors, 0.99)),
            "max_us": us(quantile(&self.errors, 1.0)),
            "mean_sigma_us": if self.sigma_sum > 0.0 { us(self.sigma_sum / timed) } else { None },
            "without_share": self.without as f64 / self.samples.max(1) as f64,
            "wrong_frame_share": self.wrong_frame as f64 / timed,
            "silently_wrong": if self.sigma_sum > 0.0 { Some(self.silent) } else { None },
            "samples_judged": self.samples,
        })
    }
}

fn print(sweep: &Sweep, strength: f64, method: &str, score: &Score) {
    println!(
        "{:8} {strength:>8.3} {:2}  {method:24} median {:>8.4} ms  p99 {:>9.4} ms  max {:>9.3} ms  without {:>5.1} %  silent {}",
        sweep.name,
        sweep.unit,
        score.ms(0.5),
        score.ms(0.99),
        score.ms(1.0),
        100.0 * score.without as f64 / score.samples.max(1) as f64,
        score.silent,
    );
}

fn write(points: &[Point], rates: &[Value], origin: &Value, out: &Path) -> Result<()> {
    let put = |name: &str, text: String| {
        let path = out.join(name);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))
    };
    let rows = points.iter().map(|p| {
        let sweep = &SWEEPS[p.sweep];
        json!({
            "varied": sweep.words,
            "strength": p.strength,
            "unit": sweep.unit,
            "method": p.method,
            "score": p.score.json(),
        })
    });
    let goal = points
        .iter()
        .find(|p| SWEEPS[p.sweep].name == "jitter" && p.strength == 5.0)
        .map(|p| p.score.ms(0.99));
    if let Some(p99) = goal {
        let met = if p99 < TARGET_P99_MS { "met" } else { "MISSED" };
        println!("target p99 < {TARGET_P99_MS} ms at 5 ms of jitter: {p99:.4} ms, {met}");
    }
    let report = json!({
        "benchmark": "frame_sync",
        "origin": origin,
        "goal": { "p99_ms_at_5_ms_of_jitter": TARGET_P99_MS, "found": goal, "met": goal.map(|p| p < TARGET_P99_MS) },
        "points": rows.collect::<Vec<_>>(),
        "rates": rates,
    });
    put(
        "frame_sync.json",
        serde_json::to_string_pretty(&report)? + "\n",
    )?;
    let foot = stamp::line(origin);
    for (k, sweep) in SWEEPS.iter().enumerate() {
        put(
            &format!("frame_sync-{}.svg", sweep.name),
            sweep_chart(points, k, &foot),
        )?;
    }
    put("frame_sync-time.svg", time_chart(points, &foot))
}

fn methods(points: &[Point]) -> Vec<&'static str> {
    let mut names: Vec<&str> = Vec::new();
    for point in points {
        if !names.contains(&point.method) {
            names.push(point.method);
        }
    }
    names
}

fn sweep_chart(points: &[Point], k: usize, foot: &str) -> String {
    let sweep = &SWEEPS[k];
    let axis = if sweep.log { Axis::log } else { Axis::linear };
    let mut chart = Chart::new("Error of IMU time against camera time")
        .subtitle("99th percentile; 800 Hz, 30 frames per second; the IMU's reader 5 ms late on average unless stated")
        .x_axis(axis(sweep.words, sweep.unit))
        .y_axis(Axis::log("error", "ms"))
        .hline(TARGET_P99_MS, "goal")
        .footnote(foot);
    for (slot, method) in methods(points).into_iter().enumerate() {
        let mine = points.iter().filter(|p| p.sweep == k && p.method == method);
        let p99 = mine.map(|p| (p.strength, p.score.ms(0.99)));
        chart = chart.series(Series::line(method, p99).slot(slot));
    }
    chart.to_svg(760, 420)
}

fn time_chart(points: &[Point], foot: &str) -> String {
    let mut chart = Chart::new("Error against observed time")
        .subtitle(
            "99th percentile; 800 Hz, 30 frames per second; the IMU's reader 5 ms late on average",
        )
        .x_axis(Axis::log("time since the start", "s"))
        .y_axis(Axis::log("error", "ms"))
        .hline(TARGET_P99_MS, "goal")
        .footnote(foot);
    for (slot, method) in methods(points).into_iter().enumerate() {
        let mine = points
            .iter()
            .find(|p| SWEEPS[p.sweep].name == "jitter" && p.strength == 5.0 && p.method == method);
        let line = mine.into_iter().flat_map(|p| {
            let spans = OBSERVED_S.iter().zip(&p.score.by_time);
            spans.map(|(s, errors)| (*s, quantile(errors, 0.99) / MS))
        });
        chart = chart.series(Series::line(method, line).slot(slot));
    }
    chart.to_svg(760, 420)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A short slice of the benchmark: the target is met, and the peer is compared.
    #[test]
    fn the_estimator_meets_its_target_and_the_peer_does_not() {
        let scores = measure(1, |seed| World::new(7 + seed, 40.0));
        let [(_, tied), (_, peer)] = &scores[..] else {
            panic!("two methods");
        };
        assert!(tied.errors.len() > 1000 && tied.without == 0);
        assert!(tied.ms(0.99) < TARGET_P99_MS, "{}", tied.ms(0.99));
        assert_eq!(tied.silent, 0);
        assert!(peer.ms(0.99) > TARGET_P99_MS, "{}", peer.ms(0.99));
    }

    /// Without delays and losses the peer, too, is near the truth, which confirms its
    /// reimplementation.
    #[test]
    fn the_peer_is_accurate_without_delays() {
        let scores = measure(1, |seed| World {
            reader_jitter: 0.0,
            stamp_jitter: 0.0,
            frame_jitter: 0.0,
            uptime_s: 1.0,
            ..World::new(7 + seed, 40.0)
        });
        let (name, peer) = &scores[1];
        assert!(name.starts_with("zed-open-capture"));
        assert!(peer.ms(0.99) < 4.0, "{}", peer.ms(0.99));
    }
}
