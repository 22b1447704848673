//! Fits a sigma model to known errors.
//!
//! Minimizes the pinball loss of the 95 % quantile (Koenker and Bassett, "Regression quantiles",
//! Econometrica 1978) over an additive model by coordinate descent: given the other components, the
//! optimal entry of a class is the quantile of its residuals.

use super::{CLASSES, Evidence, KINDS, LR_DIFFERENCE, MIN_ERROR_PX, Model, class};

/// A disparity whose error is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Evidence of the disparity.
    pub evidence: Evidence,
    /// Absolute error, px.
    pub error_px: f32,
}

/// Fraction of errors that must be below two sigma.
const QUANTILE: f64 = 0.95;
/// Upper edges of the classes of the left-right difference, px: most differences are 0 or 1.
const LR_DIFFERENCE_EDGES: [f32; CLASSES - 1] = [1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 16.0, 32.0, 64.0];
/// Number of passes over all components.
const ITERATIONS: usize = 8;
/// Minimum number of samples of a class; smaller classes take the entry of a neighbor.
const MIN_SAMPLES: usize = 50;

impl Model {
    /// Fits a model; `None` if there are too few samples. Samples with NaN do not count.
    ///
    /// ```
    /// use depth::sigma::{Evidence, Model, Sample};
    ///
    /// // Disparities with a small margin have errors of up to 4 px, the others of up to 0.4 px.
    /// let sample = |i: u32| {
    ///     let (margin, most) = if i % 2 == 0 { (0.01, 4.0) } else { (1.0, 0.4) };
    ///     let share = (i / 2 % 100) as f32 / 100.0;
    ///     let evidence = Evidence { second_best_margin: margin, ..Evidence::default() };
    ///     Sample { evidence, error_px: most * share }
    /// };
    /// let samples: Vec<Sample> = (0..4000).map(sample).collect();
    /// let model = Model::fit(&samples).ok_or("too few samples")?;
    /// let [ambiguous, clear] = [0, 1].map(|i| model.sigma_px(&samples[i].evidence));
    /// // Half of the 95 % quantile of each.
    /// assert!((1.5..2.5).contains(&ambiguous), "{ambiguous}");
    /// assert!((0.1..0.3).contains(&clear), "{clear}");
    /// assert!(Model::fit(&samples[..10]).is_none());
    /// # Ok::<(), &str>(())
    /// ```
    pub fn fit(samples: &[Sample]) -> Option<Self> {
        let is_known = |s: &&Sample| {
            !s.error_px.is_nan() && s.evidence.kinds().iter().all(|value| !value.is_nan())
        };
        let samples: Vec<&Sample> = samples.iter().filter(is_known).collect();
        if samples.len() < MIN_SAMPLES * CLASSES {
            return None;
        }
        let mut model = Self {
            edges: [[0.0; CLASSES - 1]; KINDS],
            logs: [[0.0; CLASSES]; KINDS],
        };
        let kinds: Vec<[f32; KINDS]> = samples.iter().map(|s| s.evidence.kinds()).collect();
        for (kind, edges) in model.edges.iter_mut().enumerate() {
            let mut values: Vec<f32> = kinds.iter().map(|of| of[kind]).collect();
            values.sort_unstable_by(f32::total_cmp);
            for (k, edge) in edges.iter_mut().enumerate() {
                *edge = values[(k + 1) * values.len() / CLASSES];
            }
        }
        model.edges[LR_DIFFERENCE] = LR_DIFFERENCE_EDGES;
        let classes: Vec<[usize; KINDS]> = kinds
            .iter()
            .map(|of| std::array::from_fn(|kind| class(&model.edges[kind], of[kind])))
            .collect();
        let logs: Vec<f32> = samples
            .iter()
            .map(|sample| (sample.error_px + MIN_ERROR_PX).ln())
            .collect();
        // Initially the first component holds the whole quantile.
        model.logs[0] = [quantile(&mut logs.clone()); CLASSES];
        for _ in 0..ITERATIONS {
            for kind in 0..KINDS {
                let mut left: [Vec<f32>; CLASSES] = std::array::from_fn(|_| Vec::new());
                for (of, log) in classes.iter().zip(&logs) {
                    let others = (0..KINDS).filter(|other| *other != kind);
                    let predicted: f32 = others.map(|other| model.logs[other][of[other]]).sum();
                    left[of[kind]].push(log - predicted);
                }
                for (log, left) in model.logs[kind].iter_mut().zip(&mut left) {
                    if left.len() >= MIN_SAMPLES {
                        *log = quantile(left);
                    }
                }
                model.fill(kind, &left.map(|left| left.len()));
            }
        }
        Some(model)
    }

    /// Gives classes with too few samples the entry of the nearest class with enough.
    fn fill(&mut self, kind: usize, counts: &[usize; CLASSES]) {
        let known: Vec<usize> = (0..CLASSES).filter(|k| counts[*k] >= MIN_SAMPLES).collect();
        for k in 0..CLASSES {
            if let Some(next) = known.iter().min_by_key(|other| other.abs_diff(k)) {
                self.logs[kind][k] = self.logs[kind][*next];
            }
        }
    }

    /// The model as Rust source, in the form of `tables.rs`.
    pub fn source(&self) -> String {
        let mut text = String::from("Model {\n    edges: [\n");
        for edges in &self.edges {
            text += &format!("        {:?},\n", edges.map(rounded));
        }
        text += "    ],\n    logs: [\n";
        for logs in &self.logs {
            text += &format!("        {:?},\n", logs.map(rounded));
        }
        text + "    ],\n}"
    }
}

/// Rounds to four decimals.
fn rounded(value: f32) -> f64 {
    (f64::from(value) * 1e4).round() / 1e4
}

/// Quantile [`QUANTILE`] of the values.
fn quantile(values: &mut [f32]) -> f32 {
    let at = ((values.len() - 1) as f64 * QUANTILE).round() as usize;
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}
