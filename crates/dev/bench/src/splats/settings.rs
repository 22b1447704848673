//! Settings at equal steps: is each worth it on test views?

use anyhow::Result;
use serde_json::Value;

use super::exam::Exam;
use super::fit;
use super::views::{KnownExposure, ViewOptions};

/// A row per setting, `as the stage` first.
///
/// # Errors
/// A preset that there is not, or a pose that is not finite.
pub(crate) fn settings(exam: &Exam, preset: &str, steps: Option<usize>) -> Result<Vec<Value>> {
    let config = fit::config(preset, steps)?;
    let stage = ViewOptions {
        reduction: config.reduction,
        ..ViewOptions::STAGE
    };
    let mut rows = Vec::new();
    let mut add = |case: &str, config: &_, options: &ViewOptions| -> Result<()> {
        rows.push(exam.run(case, preset, config, options)?);
        Ok(())
    };
    add("as the stage", &config, &stage)?;
    let exposure = |exposure| ViewOptions { exposure, ..stage };
    let left = ViewOptions {
        right_images: false,
        ..stage
    };
    add("left images only", &config, &left)?;
    add(
        "exposure unknown",
        &config,
        &exposure(KnownExposure::Nothing),
    )?;
    add(
        "exposure and gain known across cameras",
        &config,
        &exposure(KnownExposure::TimeAndGain),
    )?;
    let mut refined = config;
    refined.train.exposure.refine = true;
    add("exposure refined", &refined, &stage)?;
    let mut refined = config;
    refined.train.poses.refine = true;
    refined.train.poses.start = config.train.steps / 7;
    add("poses refined", &refined, &stage)?;
    let mut plain = config;
    plain.train.loss.depth_weight = 0.0;
    add("depth at the start only", &plain, &stage)?;
    Ok(rows)
}
