//! Growth by need: training that stops to add Gaussians when held-out views stop to gain.
//!
//! PSNR scatters by more from one evaluation to the next than a tenth more Gaussians gains. A check
//! therefore continues the training twice from the same state, as it is and with a share of the
//! Gaussians split, for the same steps and on the same views, and compares view by view.

use super::config::TrainConfig;
use super::evaluate::Evaluation;
use super::trainer::Trainer;
use super::view::TrainingView;
use crate::error::SplatError;

/// Smallest number of held-out views for a check.
const MIN_VIEWS: usize = 4;

/// A comparison of two scenes that differ in their number of Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GrowthCheck {
    /// Step at which the two trainings parted.
    pub step: usize,
    /// Gaussians of the smaller and of the larger scene.
    pub splats: [usize; 2],
    /// Mean PSNR of the held-out views in both scenes, dB.
    pub psnr_db: [f64; 2],
    /// Gain of a tenth more Gaussians, dB.
    pub gain_db: f64,
    /// The gain plus two standard errors, dB.
    pub upper_gain_db: f64,
    /// Whether growth continues. It ends after [`GrowthConfig::failed_checks`] checks in a row that
    /// say no, and pauses after one.
    ///
    /// [`GrowthConfig::failed_checks`]: super::GrowthConfig::failed_checks
    pub continues: bool,
}

/// Result of [`train`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrainReport {
    /// All checks of growth: the curve of PSNR over the number of Gaussians.
    pub checks: Vec<GrowthCheck>,
    /// Held-out views at the end.
    pub evaluation: Evaluation,
}

/// Runs a training to its end. Without at least four held-out views, growth ends by schedule alone.
///
/// # Errors
/// Those of [`Trainer::step`].
pub fn train(trainer: &mut Trainer, held_out: &[TrainingView]) -> Result<TrainReport, SplatError> {
    let config = *trainer.config();
    let growth = &config.growth;
    let mut report = TrainReport::default();
    let checks = growth.min_gain_db > 0.0 && held_out.len() >= MIN_VIEWS;
    let ends = (growth.stop * config.steps as f32) as usize;
    // Number of Gaussians and step of the next check, failed checks in a row.
    let (mut next_count, mut next_step, mut failed) = (0.0, growth.start.saturating_sub(1), 0);
    while trainer.steps() < config.steps {
        let step = trainer.steps();
        let is_possible = checks
            && failed < growth.failed_checks
            && step + growth.check_steps < ends
            && trainer.is_before_round();
        let has_grown = failed > 0 || trainer.scene().splats.len() as f32 >= next_count;
        if is_possible && has_grown && step >= next_step {
            // The check takes the place of the round, which would forget what was gathered.
            trainer.set_growth(false);
            trainer.step()?;
            let check = check(trainer, held_out, &config)?;
            next_count = check.splats[0] as f32 * growth.check_factor;
            next_step = trainer.steps() + 2 * growth.check_steps;
            failed = if check.continues { 0 } else { failed + 1 };
            report.checks.push(check);
        } else {
            trainer.step()?;
        }
    }
    report.evaluation = trainer.evaluate(held_out);
    Ok(report)
}

/// Compares both continuations; the trainer becomes the chosen one.
fn check(
    trainer: &mut Trainer,
    held_out: &[TrainingView],
    config: &TrainConfig,
) -> Result<GrowthCheck, SplatError> {
    let step = trainer.steps();
    let mut same = trainer.clone();
    let mut larger = trainer.clone();
    larger.grow(config.growth.check_share);
    let mut evaluations = [Evaluation::default(), Evaluation::default()];
    for (trainer, evaluation) in [&mut same, &mut larger].into_iter().zip(&mut evaluations) {
        trainer.set_growth(false);
        for _ in 0..config.growth.check_steps {
            trainer.step()?;
        }
        *evaluation = trainer.evaluate(held_out);
    }
    let splats = [&same, &larger].map(|trainer| trainer.scene().splats.len());
    let (mean, error) = paired(&evaluations[0].psnr_db, &evaluations[1].psnr_db);
    // A gain is proportional to the logarithm of the number.
    let ratio = (splats[1] as f64 / splats[0].max(1) as f64).max(1.0 + 1e-6);
    let per_tenth = libm::log(1.1) / libm::log(ratio);
    let upper_gain_db = (mean + 2.0 * error) * per_tenth;
    let has_grown = splats[1] > splats[0];
    let continues = has_grown && upper_gain_db >= f64::from(config.growth.min_gain_db);
    *trainer = if continues { larger } else { same };
    trainer.set_growth(continues);
    Ok(GrowthCheck {
        step,
        splats,
        psnr_db: evaluations.map(|evaluation| evaluation.mean_psnr_db()),
        gain_db: mean * per_tenth,
        upper_gain_db,
        continues,
    })
}

/// Mean of paired differences and its standard error.
fn paired(a: &[f64], b: &[f64]) -> (f64, f64) {
    let n = a.len() as f64;
    let differences = || a.iter().zip(b).map(|(a, b)| b - a);
    let mean = differences().sum::<f64>() / n;
    let squares: f64 = differences().map(|d| (d - mean) * (d - mean)).sum();
    (mean, (squares / (n - 1.0).max(1.0) / n).sqrt())
}
