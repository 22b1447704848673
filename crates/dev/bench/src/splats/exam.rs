//! A walk with its test views, and what a training of it scores.

use anyhow::Result;
use reconstruction::pipeline::stages::splats::SplatsConfig;
use serde_json::{Value, json};
use splats::{Evaluation, Scene, TrainingView};

use super::fit::{self, Fit, evaluate};
use super::off_path::{self, OffPathView};
use super::views::{Part, TestView, ViewOptions, WalkViews};
use super::walks::short_name;
use crate::terrain::walks::{Walk, WalkInputs};

/// Seed of the views off the path.
const OFF_PATH_SEED: u64 = 17;
/// Points of a curve over time.
const CURVE_POINTS: usize = 7;

/// A walk with its test views.
pub(crate) struct Exam {
    walk: Walk,
    pub(crate) views: WalkViews,
    /// Truth at the instants of the validation, and in the gaps.
    instants: Vec<TestView>,
    gaps: Vec<TestView>,
    off_path: Vec<OffPathView>,
}

impl Exam {
    /// With a number of views off the path for each offset and angle. `variant` names what differs
    /// from the usual walk of this name.
    ///
    /// # Errors
    /// A pair that cannot be rectified, or an I/O error.
    pub(crate) fn new(prepared: WalkInputs, variant: &str, off_path_views: usize) -> Result<Self> {
        let walk = prepared.walk;
        let views = WalkViews::load(prepared, variant)?;
        let options = ViewOptions::STAGE;
        Ok(Self {
            walk,
            instants: views.truth(Part::Validation, &options)?,
            gaps: views.truth(Part::Gap, &options)?,
            off_path: off_path::off_path(&views, off_path_views, OFF_PATH_SEED, &options)?,
            views,
        })
    }

    /// Trains from recorded views, and scores. `case` names what is special.
    ///
    /// # Errors
    /// A pose that is not finite.
    pub(crate) fn run(
        &self,
        case: &str,
        preset: &str,
        config: &SplatsConfig,
        options: &ViewOptions,
    ) -> Result<Value> {
        let training = self.views.recorded(Part::Training, options)?;
        self.run_with(case, preset, config, training, options)
    }

    /// The same from given views. A training that fails is a result.
    ///
    /// # Errors
    /// A pose that is not finite.
    pub(crate) fn run_with(
        &self,
        case: &str,
        preset: &str,
        config: &SplatsConfig,
        training: Vec<TrainingView>,
        options: &ViewOptions,
    ) -> Result<Value> {
        let validation = self.views.recorded(Part::Validation, options)?;
        let count = training.len();
        let mut row = json!({
            "walk": short_name(self.walk.kind, self.walk.light),
            "size": self.walk.size,
            "seconds": self.walk.span_s[1] - self.walk.span_s[0],
            "case": case,
            "preset": preset,
            "steps": config.train.steps,
            "views": count,
            "instants_trained": self.views.instants(Part::Training),
            "instants_in_gaps": self.views.instants(Part::Gap),
        });
        let gaps = plain(&self.gaps);
        let curve = (&gaps[..], CURVE_POINTS);
        match fit::fit(training, &validation, config, curve) {
            Err(error) => row["error"] = format!("{error:#}").into(),
            Ok(fit) => {
                add_costs(&mut row, &fit);
                row["recorded"] = scores(&evaluate(&fit.scene, &validation, config)?);
                row["instants"] = self.test_scores(&fit.scene, &self.instants, config)?;
                row["gaps"] = self.test_scores(&fit.scene, &self.gaps, config)?;
                row["off_path"] = self.off_path(&fit.scene, config)?.into();
            }
        }
        Ok(row)
    }

    /// Quality in test views, and which of them is the worst.
    fn test_scores(
        &self,
        scene: &Scene,
        tests: &[TestView],
        config: &SplatsConfig,
    ) -> Result<Value> {
        let evaluation = evaluate(scene, &plain(tests), config)?;
        let mut row = scores(&evaluation);
        let all = tests.iter().zip(&evaluation.psnr_db);
        if let Some((worst, _)) = all.min_by(|a, b| a.1.total_cmp(b.1)) {
            let cameras = self.views.prepared.simulation.cameras();
            row["worst_camera"] = cameras[worst.camera].name.as_str().into();
            row["worst_frame"] = worst.frame.into();
        }
        Ok(row)
    }

    fn off_path(&self, scene: &Scene, config: &SplatsConfig) -> Result<Vec<Value>> {
        let mut rows = Vec::new();
        for offset_m in off_path::OFFSETS_M {
            for angle_deg in off_path::ANGLES_DEG {
                let own = self.off_path.iter();
                let own = own.filter(|v| v.offset_m == offset_m && v.angle_deg == angle_deg);
                let own: Vec<TrainingView> = own.map(|v| v.test.view.clone()).collect();
                if own.is_empty() {
                    continue;
                }
                let mut row = scores(&evaluate(scene, &own, config)?);
                row["offset_m"] = offset_m.into();
                row["angle_deg"] = angle_deg.into();
                rows.push(row);
            }
        }
        Ok(rows)
    }
}

fn plain(tests: &[TestView]) -> Vec<TrainingView> {
    tests.iter().map(|test| test.view.clone()).collect()
}

/// What a training took.
pub(crate) fn add_costs(row: &mut Value, fit: &Fit) {
    let curve = fit.curve.iter().map(|point| {
        json!({
            "step": point.step,
            "cpu_s": point.cpu_s,
            "gaussians": point.splats,
            "psnr_db": point.psnr_db,
        })
    });
    let checks = fit.checks.iter().map(|check| {
        json!({
            "step": check.step,
            "gaussians": check.splats,
            "psnr_db": check.psnr_db,
            "gain_db": check.gain_db,
            "continues": check.continues,
        })
    });
    row["start"] = fit.start_count.into();
    row["gaussians"] = fit.scene.splats.len().into();
    row["steps_with_checks"] = fit.steps.into();
    row["cpu_s"] = fit.timing.cpu_s.into();
    row["wall_s"] = fit.timing.wall_s.into();
    row["steps_per_cpu_s"] = (fit.steps as f64 / fit.timing.cpu_s).into();
    row["curve"] = curve.collect::<Vec<Value>>().into();
    row["checks"] = checks.collect::<Vec<Value>>().into();
}

/// Quality in test views.
pub(crate) fn scores(of: &Evaluation) -> Value {
    json!({
        "views": of.psnr_db.len(),
        "psnr_db": of.mean_psnr_db(),
        "worst_db": of.worst_psnr_db(),
        "ssim": of.mean_ssim(),
        "depth_error": of.depth_error,
        "known_depth_error": of.known_depth_error,
    })
}
