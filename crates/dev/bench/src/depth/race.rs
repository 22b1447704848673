//! Errors over time: ours and OpenCV's on the same images.

use anyhow::{Result, ensure};
use depth::evaluate::{BAD_PX, Scores};
use depth::{Band, Census, Config, Downsample, Matcher, Matching, Paths, Penalties, Preset};
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use serde_json::{Value, json};

use super::frames::{Frame, Walk};
use super::imperfect;
use super::peers::{Peers, SgbmConfig};
use crate::meter::{median, timed};

/// Threads of both sides.
pub(super) const THREADS: usize = 2;
/// Where "bad-2" is among [`BAD_PX`].
pub(crate) const BAD_2: usize = 2;
/// Targets on the real pair: this density, with at most this ratio of bad answers.
const TARGET_DENSITY: f64 = 0.90;
const MAX_BAD_RATIO: f64 = 0.035;
/// Targets of `fast`: pairs per second, at this size and number of disparities.
const RATE_HZ: f64 = 16.0;
const RATE_SIZE: [u32; 2] = [640, 480];
const RATE_RANGE: usize = 128;

/// A matcher with its settings, on all frames.
struct Point {
    name: String,
    /// Ours, or a mode of OpenCV's.
    kind: &'static str,
    /// Mean over frames of the median over runs, ms.
    ms: f64,
    scores: Scores,
    /// Density and share of bad answers, if only those with the smallest sigmas count; ours alone.
    curve: Vec<[f64; 2]>,
}

/// Time, scores, and of each answer that counts its sigma and whether it is bad.
type Own = (f64, Scores, Vec<(f32, bool)>);

/// All of them.
pub(crate) struct Race {
    points: Vec<Point>,
    opencv: String,
    frames: usize,
}

/// Our presets, and settings between them.
fn ours() -> Vec<(String, Config)> {
    let mut all: Vec<(String, Config)> = (Preset::ALL.iter())
        .map(|preset| (preset.name().to_owned(), Config::preset(*preset)))
        .collect();
    for (windows, census) in [("5x5", Census::Full5x5), ("7x7", Census::Full7x7)] {
        for (count, paths) in [(3, Paths::Three), (4, Paths::Four), (8, Paths::Eight)] {
            for (downsample, what) in [
                (None, ""),
                (Some(Downsample::Rows), ", half the rows"),
                (Some(Downsample::Both), ", halved"),
            ] {
                let preset = Config::preset(Preset::Balanced);
                let clear = Matching {
                    census,
                    penalties: Penalties::for_costs_up_to(
                        census.bits() + preset.clear.max_gray_cost,
                    ),
                    ..preset.clear
                };
                let mut config = preset;
                (config.downsample, config.paths, config.clear) = (downsample, paths, clear);
                // The presets are included already.
                if all.iter().all(|(_, other)| *other != config) {
                    all.push((format!("{windows}, {count} paths{what}"), config));
                }
            }
        }
    }
    all
}

impl Race {
    /// Lets ours and these of OpenCV's match all frames, `runs` times each, and once before that.
    ///
    /// # Errors
    /// Python fails.
    pub(crate) fn run(
        peers: &mut Peers,
        configs: &[SgbmConfig],
        frames: &[&Frame],
        runs: usize,
    ) -> Result<Self> {
        let ours = ours();
        let mut theirs: Vec<(f64, Scores)> = vec![Default::default(); configs.len()];
        let mut own: Vec<Own> = vec![Default::default(); ours.len()];
        for frame in frames {
            peers.show(frame)?;
            let (_, maps) = peers.run(frame, configs, THREADS, true)?;
            for ((_, scores), map) in theirs.iter_mut().zip(&maps) {
                scores.add(&Scores::of(map, frame.truth())?);
            }
            let [left, right] = frame.images();
            let band = Band::full(0, frame.range, frame.height)?;
            let mut matchers = Vec::new();
            for ((_, settings), (_, scores, answers)) in ours.iter().zip(&mut own) {
                let mut matcher = Matcher::new(*settings, frame.width, frame.height)?;
                // The first run fills buffers.
                let map = matcher.run(&left, &right, &band)?;
                scores.add(&Scores::of(map, frame.truth())?);
                let counted = (0..map.disparity.len()).filter(|i| {
                    frame.visible[*i] && !frame.truth[*i].is_nan() && !map.disparity[*i].is_nan()
                });
                answers.extend(counted.map(|i| {
                    let error = (map.disparity[i] - frame.truth[i]).abs();
                    (map.sigma[i], error > BAD_PX[BAD_2])
                }));
                matchers.push(matcher);
            }
            let mut times = vec![Vec::new(); ours.len() + configs.len()];
            for _ in 0..runs {
                for (matcher, times) in matchers.iter_mut().zip(&mut times) {
                    let (result, took) = timed(|| matcher.run(&left, &right, &band).map(drop));
                    result?;
                    times.push(1e3 * took.wall_s);
                }
                let (ms, _) = peers.run(frame, configs, THREADS, false)?;
                for (ms, times) in ms.iter().zip(&mut times[ours.len()..]) {
                    times.push(*ms);
                }
            }
            let of_frame: Vec<f64> = times.into_iter().map(median).collect();
            let share = 1.0 / frames.len() as f64;
            for ((ms, ..), of) in own.iter_mut().zip(&of_frame) {
                *ms += share * of;
            }
            for ((ms, _), of) in theirs.iter_mut().zip(&of_frame[ours.len()..]) {
                *ms += share * of;
            }
        }
        let own = ours.into_iter().zip(own);
        let mut points: Vec<Point> = own
            .map(|((name, _), (ms, scores, answers))| Point {
                name,
                kind: "ours",
                ms,
                curve: curve(answers, scores.pixels),
                scores,
            })
            .collect();
        points.extend(
            configs
                .iter()
                .zip(theirs)
                .map(|(config, (ms, scores))| Point {
                    name: config.name(),
                    kind: config.mode,
                    ms,
                    scores,
                    curve: Vec::new(),
                }),
        );
        Ok(Self {
            points,
            opencv: peers.version.clone(),
            frames: frames.len(),
        })
    }

    /// One of ours that takes at most `max_ms` and has fewer bad answers at the density of one of
    /// OpenCV's.
    fn more_accurate_than(&self, theirs: &Point, max_ms: f64) -> Option<&Point> {
        let (density, bad) = (theirs.scores.density(), theirs.scores.bad_ratio(BAD_2));
        let ours = self.points.iter().filter(|p| p.kind == "ours");
        let mut fast_enough = ours.filter(|p| p.ms <= max_ms);
        fast_enough.find(|p| p.at(density).is_some_and(|at| at < bad))
    }

    fn beaten_by(&self, theirs: &Point) -> Option<&Point> {
        self.more_accurate_than(theirs, theirs.ms)
    }

    /// Names of OpenCV's than which none of ours is more accurate, however fast.
    #[cfg(test)]
    pub(super) fn less_accurate_than(&self) -> Vec<&str> {
        let is_missed = |p: &&Point| self.more_accurate_than(p, f64::INFINITY).is_none();
        self.theirs()
            .filter(is_missed)
            .map(|p| p.name.as_str())
            .collect()
    }

    fn theirs(&self) -> impl Iterator<Item = &Point> {
        self.points.iter().filter(|p| p.kind != "ours")
    }

    /// Points of OpenCV's that none of ours beats.
    fn unbeaten(&self) -> Vec<&Point> {
        self.theirs()
            .filter(|p| self.beaten_by(p).is_none())
            .collect()
    }

    /// Progress line.
    pub(crate) fn print(&self, part: &str) {
        println!("{part}: {} frames", self.frames);
        let unbeaten = self.unbeaten();
        for point in &self.points {
            let ours = point.kind == "ours";
            let here = unbeaten.iter().any(|p| p.name == point.name);
            if !ours && !here {
                continue;
            }
            println!(
                "  {:28} {:7.1} ms, density {:.3}, bad-2 {:.2} %{}{}",
                point.name,
                point.ms,
                point.scores.density(),
                100.0 * point.scores.bad_ratio(BAD_2),
                match point.at(TARGET_DENSITY) {
                    Some(bad) => format!(", {:.2} % at density {TARGET_DENSITY}", 100.0 * bad),
                    None => String::new(),
                },
                if here { " NOT BEATEN" } else { "" }
            );
        }
        println!(
            "  {} of {} of OpenCV's are beaten",
            self.theirs().count() - unbeaten.len(),
            self.theirs().count()
        );
    }

    /// All points and what follows from them.
    pub(crate) fn json(&self) -> Value {
        let usual = |p: &&Point| p.kind == "HH" && p.name == SgbmConfig::usual("HH", 5).name();
        let hh_ms = self.theirs().find(usual).map(|p| p.ms);
        let points = self.points.iter().map(|point| {
            let scores = &point.scores;
            let beaten_by = match point.kind {
                "ours" => None,
                _ => self.beaten_by(point).map(|p| p.name.clone()),
            };
            json!({
                "name": point.name,
                "kind": point.kind,
                "ms": point.ms,
                "density": scores.density(),
                "bad_1": scores.bad_ratio(1),
                "bad_2": scores.bad_ratio(BAD_2),
                "bad_3": scores.bad_ratio(3),
                "bad_2_or_absent": scores.bad_ratio_of_all(BAD_2),
                "mean_error_px": scores.mean_error_px(),
                "bad_2_at_density": point.at(TARGET_DENSITY),
                "curve": point.curve,
                "beaten_by": beaten_by,
            })
        });
        json!({
            "frames": self.frames,
            "threads": THREADS,
            "opencv": self.opencv,
            "target": { "density": TARGET_DENSITY, "bad_2": MAX_BAD_RATIO, "ms": hh_ms.map(|ms| ms / 2.0) },
            "not_beaten": self.unbeaten().iter().map(|p| &p.name).collect::<Vec<_>>(),
            "points": points.collect::<Vec<_>>(),
        })
    }
}

impl Point {
    /// Ratio of bad answers at this density; `None` if the density is lower.
    fn at(&self, density: f64) -> Option<f64> {
        let enough = self.curve.iter().filter(|[of, _]| *of >= density);
        enough.map(|[_, bad]| *bad).reduce(f64::min)
    }
}

/// Density and share of bad answers for each limit of sigma.
fn curve(mut answers: Vec<(f32, bool)>, pixels: u64) -> Vec<[f64; 2]> {
    answers.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut points: Vec<[f64; 2]> = Vec::new();
    let mut bad = 0_u64;
    for (k, (sigma, is_bad)) in answers.iter().enumerate() {
        bad += u64::from(*is_bad);
        // Answers of one sigma come together.
        let is_last = answers.get(k + 1).is_none_or(|(next, _)| next > sigma);
        let count = (k + 1) as f64;
        let density = count / pixels.max(1) as f64;
        let step = points.last().is_none_or(|[last, _]| density >= last + 0.01);
        if is_last && (step || k + 1 == answers.len()) {
            points.push([density, bad as f64 / count]);
        }
    }
    points
}

/// Pairs per second of our presets.
///
/// # Errors
/// There is no such walk.
pub(super) fn rate(quick: bool) -> Result<Value> {
    let walk = Walk::new(
        Kind::Plaza,
        Lighting::Day,
        8,
        20.0,
        RATE_SIZE,
        Quality::FAST,
        &imperfect::NONE,
    )?;
    let frames = walk.frames(0, &[90, 150])?;
    let runs = if quick { 3 } else { 25 };
    let mut rows = Vec::new();
    for preset in Preset::ALL {
        let mut all = Vec::new();
        for frame in &frames {
            ensure!(
                frame.width == RATE_SIZE[0] as usize,
                "an image of another size"
            );
            let [left, right] = frame.images();
            let band = Band::full(0, RATE_RANGE, frame.height)?;
            let mut matcher = Matcher::new(Config::preset(preset), frame.width, frame.height)?;
            matcher.run(&left, &right, &band)?;
            for _ in 0..runs {
                let (result, took) = timed(|| matcher.run(&left, &right, &band).map(drop));
                result?;
                all.push(1e3 * took.wall_s);
            }
        }
        let ms = median(all);
        println!("rate: {:9} {ms:.1} ms, {:.1} Hz", preset.name(), 1e3 / ms);
        rows.push(json!({ "preset": preset.name(), "ms": ms, "hz": 1e3 / ms }));
    }
    Ok(json!({
        "size": RATE_SIZE, "disparities": RATE_RANGE, "threads": THREADS, "target_hz": RATE_HZ, "presets": rows,
    }))
}
