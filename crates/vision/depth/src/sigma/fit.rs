//! Fitting a model of sigma to errors that are known.
//!
//! The least sum of the pinball loss of the 95 % quantile (Koenker and Bassett, "Regression quantiles", Econometrica 1978) over an
//! additive model, one kind of evidence after the other: given the others, the best number of a class is the
//! quantile of what is left in it.

use super::{CLASSES, Evidence, KINDS, MIN_ERROR_PX, Model, class};

/// A disparity whose error is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// What there was to judge it by.
    pub evidence: Evidence,
    /// How far off it was, px.
    pub error_px: f32,
}

/// The share of errors that are to be below two sigma.
const QUANTILE: f64 = 0.95;
/// Times each kind of evidence is gone through.
const ITERATIONS: usize = 8;
/// A class with less samples says nothing of its own.
const MIN_SAMPLES: usize = 50;

impl Model {
    /// Fits a model; none with too few samples to tell anything.
    pub fn fit(samples: &[Sample]) -> Option<Self> {
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
        let classes: Vec<[usize; KINDS]> = kinds
            .iter()
            .map(|of| std::array::from_fn(|kind| class(&model.edges[kind], of[kind])))
            .collect();
        let logs: Vec<f32> = samples
            .iter()
            .map(|sample| (sample.error_px + MIN_ERROR_PX).ln())
            .collect();
        // All of it goes to the first kind to begin with.
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

    /// Gives classes without samples the number of the next one that has some.
    fn fill(&mut self, kind: usize, counts: &[usize; CLASSES]) {
        let known: Vec<usize> = (0..CLASSES).filter(|k| counts[*k] >= MIN_SAMPLES).collect();
        for k in 0..CLASSES {
            if let Some(next) = known.iter().min_by_key(|other| other.abs_diff(k)) {
                self.logs[kind][k] = self.logs[kind][*next];
            }
        }
    }

    /// The model as Rust source, as it stands in `tables.rs`.
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

/// Four digits behind the point.
fn rounded(value: f32) -> f64 {
    (f64::from(value) * 1e4).round() / 1e4
}

/// The value that the share of all is below.
fn quantile(values: &mut [f32]) -> f32 {
    let at = ((values.len() - 1) as f64 * QUANTILE).round() as usize;
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}
