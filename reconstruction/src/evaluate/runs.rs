//! Several runs in one table, with error, time, memory and completion side by side.
//!
//! Contract: a run is *lost* if too little of the ground truth's time has a pose, or nothing could
//! be compared. If a run is lost there is no mean, but a count: an average over the others would be
//! biased. The worst run is always named: the least complete of the lost ones, else the one with
//! the largest error.

use serde::Serialize;

use super::{Evaluation, Relative};

mod table;

/// One run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Run {
    /// Its name in tables.
    pub name: String,
    /// Its errors.
    #[serde(flatten)]
    pub evaluation: Evaluation,
    /// Time and memory.
    pub cost: Cost,
}

/// Time and memory of a run, as far as they are known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Cost {
    /// Time, s.
    pub seconds: Option<f64>,
    /// Peak memory, bytes.
    pub peak_bytes: Option<u64>,
}

/// See the module.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Runs {
    /// In the order given.
    pub runs: Vec<Run>,
    /// Ratio of the ground truth's time below which a run is lost.
    pub least_completion: f64,
    /// Number of lost runs.
    pub lost: usize,
    /// Name of the worst; `None` without runs.
    pub worst: Option<String>,
    /// Means over all runs; `None` if one is lost.
    pub mean: Option<Mean>,
}

/// Means over runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Mean {
    /// Mean of the RMSE, m.
    pub translation_rmse_m: f64,
    /// rad; `None` if a run has none.
    pub rotation_rmse_rad: Option<f64>,
    /// Mean of the ratios.
    pub completion: f64,
}

impl Runs {
    /// Collects runs; one whose completion is below `least_completion` is lost.
    pub fn new(runs: Vec<Run>, least_completion: f64) -> Self {
        let is_lost = |run: &&Run| run.is_lost(least_completion);
        let lost = runs.iter().filter(is_lost).count();
        let error = |run: &Run| {
            let absolute = run.evaluation.absolute.as_ref();
            absolute.map_or(f64::INFINITY, |a| a.translation_m.rmse)
        };
        let completion = |run: &Run| run.evaluation.completion.share;
        let worst = runs.iter().max_by(|a, b| {
            let lost = [a, b].map(|run| run.is_lost(least_completion));
            lost[0].cmp(&lost[1]).then_with(|| match lost[0] {
                true => completion(b).total_cmp(&completion(a)),
                false => error(a).total_cmp(&error(b)),
            })
        });
        let worst = worst.map(|run| run.name.clone());
        let mean = (lost == 0 && !runs.is_empty()).then(|| {
            let count = runs.len() as f64;
            let mean = |of: &dyn Fn(&Run) -> f64| runs.iter().map(of).sum::<f64>() / count;
            let rotation = |run: &Run| {
                let absolute = run.evaluation.absolute.as_ref()?;
                Some(absolute.rotation_rad?.rmse)
            };
            let rotations: Option<Vec<f64>> = runs.iter().map(rotation).collect();
            Mean {
                translation_rmse_m: mean(&error),
                rotation_rmse_rad: rotations.map(|r| r.iter().sum::<f64>() / count),
                completion: mean(&completion),
            }
        });
        Self {
            runs,
            least_completion,
            lost,
            worst,
            mean,
        }
    }

    /// Summary line: error of the worst run.
    pub(super) fn summary(&self) -> String {
        let worst = self
            .runs
            .iter()
            .find(|r| Some(&r.name) == self.worst.as_ref());
        let Some(worst) = worst else {
            return "nothing to compare".to_owned();
        };
        let complete = 100.0 * worst.evaluation.completion.share;
        let off = match &worst.evaluation.absolute {
            Some(absolute) => format!(
                "ATE {:.4} m (root mean square), at most {:.4} m",
                absolute.translation_m.rmse, absolute.translation_m.max
            ),
            None => "not comparable".to_owned(),
        };
        format!("{off}, {complete:.1} % complete")
    }

    /// As text: a row per run, then the worst and the mean.
    pub fn table(&self) -> String {
        table::text(self)
    }
}

impl Run {
    /// Whether it is lost.
    pub fn is_lost(&self, least_completion: f64) -> bool {
        let Evaluation {
            absolute,
            completion,
            ..
        } = &self.evaluation;
        absolute.is_none() || completion.share < least_completion
    }

    /// Drift over a path length or time, if it was requested.
    fn relative(&self, delta: super::Delta) -> Option<&Relative> {
        let mut relative = self.evaluation.relative.iter();
        relative.find(|r| r.delta == delta)
    }
}

#[cfg(test)]
mod tests;
