//! `odometry_length`: one hour. Growth of the cost of poses over time, and cost of the bundle
//! adjustment of the whole.
//!
//! One simulated walk of an hour, repeated rounds of the same closed path among people who walk
//! independently, with all three stereo cameras and their IMUs. Every image is rendered (none is
//! used twice), but small and with reduced quality: 336x188, since an hour at full size takes most
//! of a day. Times of single frames are therefore not those of full size; their growth is measured.
//! Another process renders ([`pipe`]); a minute of its images is read and then tracked.
//!
//! Memory is the peak of resident memory within a minute, minus that before the first pose. Data
//! stored by this benchmark are excluded: the minute of images and the poses are allocated in
//! advance, keyframes are in a file. After the last minute the keyframes of the first minutes, of
//! more and of all are adjusted, each time in a new mapping that is dropped afterwards.

use ::odometry::mapping::OdomPose;
use ::odometry::{ImuSample, Keyframe, Mapping, Odometry};
use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use harness::sequences::{self, OwnedFrameSet, Sequence, WalkSettings, named};
use nalgebra::Matrix6;
use rig_sim::camera::Quality;
use scene_bundle::{Pose, Trajectory};
use serde::Serialize;
use serde_json::json;

mod charts;
mod keyframe_store;
mod pipe;

use super::figures::Figures;
use super::options::Options;
use super::run::forget_peak;
use super::{results, settings};
use crate::meter::{median, timed};
use crate::stamp;
use keyframe_store::KeyframeStore;
use pipe::Pipe;

const WALK: &str = "plaza-day-51-3600";
const QUICK: &str = "plaza-day-51-120";
/// Columns and rows of one eye.
const SIZE: [u32; 2] = [336, 188];
/// Minutes after which all keyframes so far are adjusted.
const CHECKPOINT_MINUTES: [usize; 7] = [1, 2, 5, 10, 20, 40, 60];
/// Maximum growth of time and memory of causal poses.
const MAX_GROWTH: f64 = 1.10;
/// Warm-up minutes that are not compared: maps and window are filling.
const WARMUP_MINUTES: usize = 1;

/// One minute of causal poses.
#[derive(Clone, Debug, Serialize)]
struct Minute {
    /// From 1.
    minute: usize,
    /// Time and processor time of tracking it, s.
    wall_s: f64,
    cpu_s: f64,
    /// Peak memory of odometry in it, MB.
    memory_mb: f64,
    /// Keyframes in it.
    keyframes: usize,
}

/// Bundle adjustment of everything so far.
#[derive(Clone, Debug, Serialize)]
struct Adjustment {
    minutes: usize,
    keyframes: usize,
    landmarks: usize,
    loops: usize,
    rounds: usize,
    wall_s: f64,
    cpu_s: f64,
    /// Peak memory of the adjustment, including keyframes, MB.
    peak_mb: f64,
    causal: Figures,
    adjusted: Figures,
}

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. Growth is a result and not an error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    if let Some(answer) = pipe::answer(args, sequence) {
        return answer;
    }
    let options = Options::parse(args, &[])?;
    let stamp = stamp::stamp("odometry_length", args)?;
    let name = if options.quick { QUICK } else { WALK };
    let walk = named::settings(name)?;
    let minutes = (walk.seconds / 60.0) as usize;
    let per_minute = (60.0 * walk.rate_hz) as usize;
    let sequence = sequence(name)?;
    let mut hour = Hour::new(&sequence)?;
    let mut pipe = Pipe::new(name, &sequence)?;
    let none = OwnedFrameSet {
        time_ns: 0,
        views: Vec::new(),
        imu: Vec::new(),
    };
    let mut images = vec![none; per_minute];
    let (mut each, mut marks) = (Vec::new(), Vec::new());
    for minute in 1..=minutes {
        pipe.fill(&mut images)?;
        let done = hour.track(minute, &images)?;
        println!(
            "minute {minute:2}: {:.2} s, {:.2} s CPU, {:.1} MB, {} keyframes",
            done.wall_s, done.cpu_s, done.memory_mb, done.keyframes
        );
        each.push(done);
    }
    drop(images);
    // Only now, so that memory effects of the adjustment do not affect later minutes.
    for minutes in CHECKPOINT_MINUTES.into_iter().filter(|m| *m <= each.len()) {
        let keyframes = each[..minutes].iter().map(|m| m.keyframes).sum();
        let mark = hour.adjust(minutes, keyframes, minutes * per_minute)?;
        println!(
            "{minutes:2} min adjusted: {} keyframes, {} landmarks, {} loops, {} rounds: {:.1} s, {:.1} s CPU, {:.0} MB; error {:?} % before, {:?} % after",
            mark.keyframes,
            mark.landmarks,
            mark.loops,
            mark.rounds,
            mark.wall_s,
            mark.cpu_s,
            mark.peak_mb,
            mark.causal.ate_percent,
            mark.adjusted.ate_percent
        );
        marks.push(mark);
    }
    let growth = [
        ("cpu_time", growth(&each, |m| m.cpu_s)),
        ("wall_time", growth(&each, |m| m.wall_s)),
        ("memory", growth(&each, |m| m.memory_mb)),
    ];
    for (what, grown) in growth {
        println!("{what}: last third over first {grown:.3}");
    }
    let report = json!({
        "benchmark": "odometry_length",
        "stamp": stamp,
        "walk": name,
        "size": SIZE,
        "growth": growth.map(|(what, grown)| json!({ "of": what, "last_third_over_first": grown, "within_limit": grown <= MAX_GROWTH })),
        "minutes": each,
        "adjusted": marks,
    });
    let mut files = vec![("odometry_length.json".to_owned(), format!("{report:#}\n"))];
    files.extend(charts::draw(name, &each, &marks, &stamp::line(&stamp)));
    results::write(&options.out, files)
}

/// The walk, small and quick to render.
fn sequence(name: &str) -> Result<Sequence> {
    sequences::walk(&WalkSettings {
        quality: Quality::FAST,
        size: SIZE,
        ..named::settings(name)?
    })
}

/// Median of the last third of the minutes over that of the first, but for the very first minutes.
fn growth(minutes: &[Minute], of: impl Fn(&Minute) -> f64) -> f64 {
    let used = &minutes[WARMUP_MINUTES.min(minutes.len())..];
    let third = used.len().div_ceil(3);
    let (first, last) = (&used[..third], &used[used.len() - third..]);
    median(last.iter().map(&of)) / median(first.iter().map(&of))
}

struct Hour<'a> {
    sequence: &'a Sequence,
    odometry: Odometry,
    keyframes: KeyframeStore,
    /// Poses and ground truth of sets up to `done`.
    causal: Vec<Pose>,
    odom: Vec<OdomPose>,
    truth: Vec<Pose>,
    done: usize,
    /// Resident memory with only the first images loaded, bytes.
    base: Option<u64>,
}

impl<'a> Hour<'a> {
    fn new(sequence: &'a Sequence) -> Result<Self> {
        let balanced = settings::parse("balanced")?;
        Ok(Self {
            sequence,
            odometry: Odometry::new(sequence.rig(), balanced),
            keyframes: KeyframeStore::new()?,
            // All written to, so that their memory is resident from the beginning.
            causal: vec![Pose::new(0, RigidTransform::identity()); sequence.len()],
            odom: vec![
                OdomPose {
                    time_ns: 0,
                    odom_from_rig: RigidTransform::identity(),
                    relative_covariance: Matrix6::zeros(),
                };
                sequence.len()
            ],
            truth: vec![Pose::new(0, RigidTransform::identity()); sequence.len()],
            done: 0,
            base: None,
        })
    }

    /// Tracks the images of a minute.
    fn track(&mut self, minute: usize, sets: &[OwnedFrameSet]) -> Result<Minute> {
        let resident = forget_peak()?;
        let base = *self.base.get_or_insert(resident);
        let before = self.keyframes.len();
        let (done, took) = timed(|| -> Result<()> {
            let poses = self.causal[self.done..].iter_mut();
            for ((set, pose), odom) in sets.iter().zip(poses).zip(&mut self.odom[self.done..]) {
                for (k, samples) in set.imu.iter().enumerate() {
                    for sample in samples {
                        self.odometry.add_imu(k, sample);
                    }
                }
                let estimate = self.odometry.add_frames(&set.borrowed());
                *pose = harness::tracking::pose(&estimate)?;
                *odom = OdomPose::from(&estimate);
                for keyframe in self.odometry.take_keyframes(false) {
                    self.keyframes.push(&keyframe)?;
                }
            }
            Ok(())
        });
        done?;
        let peak = harness::soak::memory()?.peak;
        for (set, pose) in sets.iter().zip(&mut self.truth[self.done..]) {
            let truth = self.sequence.world_from_rig(set.time_ns);
            let truth = truth.context("the ground truth ends before the images")?;
            *pose = Pose::new(set.time_ns, truth);
        }
        self.done += sets.len();
        Ok(Minute {
            minute,
            wall_s: took.wall_s,
            cpu_s: took.cpu_s,
            memory_mb: (peak as f64 - base as f64) * 1e-6,
            keyframes: self.keyframes.len() - before,
        })
    }

    /// Adjusts the first `minutes`: `keyframes` keyframes of `sets` sets.
    fn adjust(&mut self, minutes: usize, keyframes: usize, sets: usize) -> Result<Adjustment> {
        let (causal, truth) = (&self.causal[..sets], &self.truth[..sets]);
        let balanced = settings::parse("balanced")?;
        let before = forget_peak()?;
        let mut mapping = Mapping::new(self.sequence.rig(), &balanced);
        let (adjusted, took) = timed(|| {
            let mut next = 0;
            for keyframe in self.keyframes.iter()?.take(keyframes) {
                let keyframe = keyframe?;
                feed(&mut mapping, &self.sequence.imu()[0], &mut next, &keyframe);
                mapping.add_keyframe(keyframe);
            }
            anyhow::Ok(mapping.optimize(|_| {}))
        });
        let adjusted = adjusted?;
        let peak = harness::soak::memory()?.peak.saturating_sub(before);
        let causal = Trajectory::new(causal.to_vec())?;
        let finished =
            harness::tracking::refined_trajectory(&causal, &self.odom[..sets], &adjusted)?;
        let truth = Trajectory::new(truth.to_vec())?;
        Ok(Adjustment {
            minutes,
            keyframes,
            landmarks: adjusted.landmarks,
            loops: adjusted.loop_closures.len(),
            rounds: adjusted.iterations,
            wall_s: took.wall_s,
            cpu_s: took.cpu_s,
            peak_mb: peak as f64 * 1e-6,
            causal: Figures::of(&causal, &truth)?,
            adjusted: Figures::of(&finished, &truth)?,
        })
    }
}

/// Passes the samples up to a keyframe's time, and one more.
fn feed(mapping: &mut Mapping, samples: &[ImuSample], next: &mut usize, keyframe: &Keyframe) {
    let older = samples.partition_point(|s| s.time_ns < keyframe.state.time_ns);
    let until = (older + 1).min(samples.len()).max(*next);
    for sample in &samples[*next..until] {
        mapping.add_imu(0, sample);
    }
    *next = until;
}
