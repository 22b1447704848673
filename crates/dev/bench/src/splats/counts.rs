//! PSNR over the number of Gaussians: from the same start, growth up to different numbers.

use anyhow::Result;
use serde_json::Value;

use super::exam::Exam;
use super::fit;
use super::views::ViewOptions;

/// Largest numbers of Gaussians.
const COUNTS: [usize; 6] = [25_000, 50_000, 100_000, 150_000, 300_000, 600_000];
/// Discs at the start, and rounds in which the largest number could be reached.
const START: usize = 12_500;
const ROUNDS: usize = 30;
/// Share of the steps in which the number grows.
const GROWING: f64 = 0.6;

/// A row per number; growth is not limited by need.
///
/// # Errors
/// A preset that there is not, or a pose that is not finite.
pub(crate) fn counts(exam: &Exam, preset: &str, steps: Option<usize>) -> Result<Vec<Value>> {
    let mut rows = Vec::new();
    for count in COUNTS {
        let mut config = fit::config(preset, steps)?;
        config.start.max_points = START;
        let growth = &mut config.train.growth;
        let last = GROWING * config.train.steps as f64;
        growth.min_gain_db = 0.0;
        growth.max_splats = count;
        growth.interval = ((last / ROUNDS as f64) as usize).max(1);
        growth.start = growth.interval;
        growth.stop = GROWING as f32;
        growth.max_share = libm::pow(count as f64 / START as f64, 1.0 / ROUNDS as f64) as f32 - 1.0;
        growth.min_instants = 1;
        let options = ViewOptions {
            reduction: config.reduction,
            ..ViewOptions::STAGE
        };
        let mut row = exam.run(&format!("at most {count}"), preset, &config, &options)?;
        row["most"] = count.into();
        rows.push(row);
    }
    Ok(rows)
}
