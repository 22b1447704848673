//! A stage in a process of its own, and its cost.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, ensure};
use reconstruction::Input;
use reconstruction::pipeline::observer::NoObserver;
use reconstruction::pipeline::stages::{self, Options, Preset};
use reconstruction::pipeline::{Meter, Observer, Outcome, Selection, Sources};
use scene_bundle::outputs::{self, KEYFRAMES, TRAJECTORY};
use scene_bundle::{Bundle, Scene};
use serde::{Deserialize, Serialize};

use super::walk;
use crate::meter::{cpu_s, median, timed};
use crate::odometry::run::forget_peak;

/// First argument of the process; session, bundle and stage follow.
const STAGE: &str = "--stage";
const MINUTE_NS: i64 = 60_000_000_000;

/// Cost of a stage.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct StageCost {
    pub(super) stage: String,
    /// Processor time of all threads, s.
    pub(super) cpu_s: f64,
    /// Time on this machine with its other load, s.
    pub(super) wall_s: f64,
    /// Peak of the resident memory, minus what is resident before the stage, MB.
    pub(super) peak_mb: f64,
    /// Of each minute of the walk, for stages that read frame by frame.
    pub(super) minutes: Vec<Minute>,
}

/// Cost of a minute of the walk in all passes of a stage.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct Minute {
    pub(super) frames: usize,
    pub(super) cpu_s: f64,
    /// Most memory of the stage at the end of a frame, MB.
    pub(super) memory_mb: f64,
}

/// Runs a stage, if this process was started for that.
pub(super) fn answer(args: &[String]) -> Option<Result<()>> {
    let [first, session, bundle, stage] = args else {
        return None;
    };
    (first == STAGE).then(|| {
        let cost = measured(Path::new(session), Path::new(bundle), stage)?;
        println!("{}", serde_json::to_string(&cost)?);
        Ok(())
    })
}

/// Runs stages one after the other, each in a process of its own. Times are medians of `repeats`
/// runs of a stage.
///
/// # Errors
/// A stage fails.
pub(super) fn run(
    session: &Path,
    bundle: &Path,
    stages: &[&str],
    repeats: usize,
) -> Result<Vec<StageCost>> {
    let program = std::env::current_exe().context("finding this program")?;
    let once = |stage: &str| -> Result<StageCost> {
        let mut command = Command::new(&program);
        command.args(["feet_length", STAGE]);
        command.arg(session).arg(bundle).arg(stage);
        let output = command.output().context("starting a stage")?;
        let errors = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "stage {stage} failed: {errors}");
        serde_json::from_slice(&output.stdout).context("reading the cost of a stage")
    };
    let all = stages.iter().map(|stage| {
        let runs = (0..repeats).map(|_| once(stage));
        let runs = runs.collect::<Result<Vec<_>>>()?;
        let mut cost = runs.last().context("a run")?.clone();
        cost.cpu_s = median(runs.iter().map(|run| run.cpu_s));
        cost.wall_s = median(runs.iter().map(|run| run.wall_s));
        Ok(cost)
    });
    all.collect()
}

/// Runs stages of the pipeline in this process, without measuring them.
///
/// # Errors
/// A stage fails.
pub(super) fn prepare(session: &Path, bundle: &Path, from: &str, to: &str) -> Result<()> {
    run_stages(&walk::open(session)?, bundle, [from, to], &NoObserver)
}

fn measured(session: &Path, bundle: &Path, stage: &str) -> Result<StageCost> {
    let input = walk::open(session)?;
    let minutes = minute_of_frame(bundle, stage)?;
    let base = forget_peak()?;
    let watch = MinuteMeter::new(minutes, base);
    let (done, took) = timed(|| run_stages(&input, bundle, [stage; 2], &watch));
    done?;
    let peak = harness::soak::memory()?.peak;
    Ok(StageCost {
        stage: stage.to_owned(),
        cpu_s: took.cpu_s,
        wall_s: took.wall_s,
        peak_mb: 1e-6 * peak.saturating_sub(base) as f64,
        minutes: watch.minutes(),
    })
}

/// Minute of each frame that a stage reads in a pass; empty for stages that read all in one step.
fn minute_of_frame(bundle: &Path, stage: &str) -> Result<Vec<usize>> {
    let scene = Scene::open(bundle)?;
    let trajectory = outputs::trajectory::read(&scene.output(TRAJECTORY)?)?;
    let times: Vec<i64> = trajectory.poses().iter().map(|pose| pose.time_ns).collect();
    let first = times.first().copied().unwrap_or_default();
    let times = match stage {
        // One camera, with a pose for each of its frames.
        "tags" => times,
        "terrain" => {
            let keyframes = outputs::keyframes::read(&scene.output(KEYFRAMES)?)?;
            keyframes.iter().map(|key| key.time_ns).collect()
        }
        _ => Vec::new(),
    };
    let minute = |time_ns: &i64| ((time_ns - first) / MINUTE_NS) as usize;
    Ok(times.iter().map(minute).collect())
}

/// Adds the cost between two reports of progress to the minute of the frame.
struct MinuteMeter {
    of_frame: Vec<usize>,
    base_bytes: u64,
    state: Mutex<State>,
}

struct State {
    last_cpu_s: f64,
    minutes: Vec<Minute>,
}

impl MinuteMeter {
    fn new(of_frame: Vec<usize>, base_bytes: u64) -> Self {
        let count = of_frame.last().map_or(0, |last| last + 1);
        Self {
            of_frame,
            base_bytes,
            state: Mutex::new(State {
                last_cpu_s: cpu_s(),
                minutes: vec![Minute::default(); count],
            }),
        }
    }

    fn minutes(self) -> Vec<Minute> {
        let state = self.state.into_inner();
        state.unwrap_or_else(PoisonError::into_inner).minutes
    }
}

impl Observer for MinuteMeter {
    fn begin(&self, _: &str, _: usize, _: usize) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.last_cpu_s = cpu_s();
    }

    fn progress(&self, done: u64, _: u64) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let (frames, now) = (self.of_frame.len(), cpu_s());
        let cpu_s = now - state.last_cpu_s;
        state.last_cpu_s = now;
        let Some(frame) = (done as usize).checked_sub(1).filter(|_| frames > 0) else {
            return;
        };
        // The first frame of a later pass comes after work on the whole: reported by no minute.
        if frame > 0 && frame.is_multiple_of(frames) {
            return;
        }
        let memory = harness::soak::memory().map_or(0, |own| own.resident);
        let minute = &mut state.minutes[self.of_frame[frame % frames]];
        minute.frames += 1;
        minute.cpu_s += cpu_s;
        let memory_mb = 1e-6 * memory.saturating_sub(self.base_bytes) as f64;
        minute.memory_mb = minute.memory_mb.max(memory_mb);
    }

    fn end(&self, _: &Outcome) {}
}

fn run_stages(
    input: &Input,
    bundle: &Path,
    [from, to]: [&str; 2],
    observer: &dyn Observer,
) -> Result<()> {
    let provenance = Scene::open(bundle)?.manifest().provenance.clone();
    let hash = provenance.handoff_blake3.clone();
    let bundle = Bundle::create_or_open(bundle, provenance)?;
    let sources = Sources {
        source: input,
        hashes: BTreeMap::from([(stages::HANDOFF.to_owned(), hash)]),
    };
    let selection = Selection {
        from: Some(from.to_owned()),
        to: Some(to.to_owned()),
        force: true,
    };
    let pipeline = stages::pipeline(Options {
        preset: Preset::Fast,
        ..Options::default()
    })?;
    pipeline.run(&sources, &bundle, &selection, observer, &Meter::STILL)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_both_passes_count_for_their_minute() {
        let meter = MinuteMeter::new(vec![0, 0, 1], 0);
        (1..=6).for_each(|done| meter.progress(done, 6));
        let minutes = meter.minutes();
        // The first frame of the second pass is left out.
        assert_eq!([minutes[0].frames, minutes[1].frames], [3, 2]);
        assert!(minutes.iter().all(|own| own.cpu_s >= 0.0));
    }
}
