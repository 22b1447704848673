//! A stage in a process of its own, and its cost.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, ensure};
use reconstruction::pipeline::observer::NoObserver;
use reconstruction::pipeline::stages::{self, Options};
use reconstruction::pipeline::{Meter, Selection, Sources};
use scene_bundle::{Bundle, Scene};
use serde::{Deserialize, Serialize};

use super::walk;
use crate::meter::timed;
use crate::odometry::run::forget_peak;

/// First argument of the process; session, bundle and stage follow.
const STAGE: &str = "--stage";

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

/// Runs stages one after the other, each in a process of its own.
///
/// # Errors
/// A stage fails.
pub(super) fn run(session: &Path, bundle: &Path, stages: &[&str]) -> Result<Vec<StageCost>> {
    let program = std::env::current_exe().context("finding this program")?;
    let one = |stage: &&str| {
        let mut command = Command::new(&program);
        command
            .args(["feet_length", STAGE])
            .arg(session)
            .arg(bundle);
        let output = command.arg(stage).output().context("starting a stage")?;
        let errors = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "stage {stage} failed: {errors}");
        serde_json::from_slice(&output.stdout).context("reading the cost of a stage")
    };
    stages.iter().map(one).collect()
}

/// Runs stages of the pipeline in this process, and is not measured.
///
/// # Errors
/// A stage fails.
pub(super) fn prepare(session: &Path, bundle: &Path, from: &str, to: &str) -> Result<()> {
    let input = walk::open(session)?;
    run_stages(&input, bundle, from, to)
}

fn measured(session: &Path, bundle: &Path, stage: &str) -> Result<StageCost> {
    let input = walk::open(session)?;
    let base = forget_peak()?;
    let (done, took) = timed(|| run_stages(&input, bundle, stage, stage));
    done?;
    let peak = harness::soak::memory()?.peak;
    Ok(StageCost {
        stage: stage.to_owned(),
        cpu_s: took.cpu_s,
        wall_s: took.wall_s,
        peak_mb: 1e-6 * peak.saturating_sub(base) as f64,
    })
}

fn run_stages(input: &reconstruction::Input, bundle: &Path, from: &str, to: &str) -> Result<()> {
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
    let pipeline = stages::pipeline(Options::default())?;
    pipeline.run(&sources, &bundle, &selection, &NoObserver, &Meter::STILL)?;
    Ok(())
}
