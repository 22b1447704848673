//! Residuals of pixels with derivatives, and their normal equations.
//!
//! Contract: in batches of single precision, which vectors compute; sums over batches are of double
//! precision.

use crate::levels::Levels;
use crate::tone::Tone;

/// Unknowns that all eyes share: pose, blur, tone.
pub(crate) const SHARED: usize = 8;
pub(crate) const BLUR: usize = 6;
pub(crate) const TONE: usize = 7;
/// Unknowns of one patch: those that are shared, and its levels.
pub(crate) const OWN: usize = SHARED + 2;
/// Step of the difference by the exponent of the tone curve.
const TONE_STEP: f64 = 0.01;
/// Pixels of a batch.
const BATCH: usize = 32;

/// Residuals at a state, by patch.
pub(crate) struct Evaluation {
    pub(crate) patches: Vec<Residuals>,
    /// Unknowns with a prior: index, deviation from it, and sigma.
    pub(crate) priors: [(usize, f64, f64); 2],
}

/// Residuals of the pixels of a patch, levels.
#[derive(Default)]
pub(crate) struct Residuals {
    pub(crate) count: usize,
    pub(crate) batches: Vec<Batch>,
}

/// Pixels, the last ones of which may be none: these have no residuals and derivatives.
pub(crate) struct Batch {
    pub(crate) residuals: [f32; BATCH],
    /// Derivatives by unknown.
    by: [[f32; BATCH]; OWN],
}

impl Residuals {
    pub(crate) fn push(&mut self, residual: f32, by: &[f32; OWN]) {
        let n = self.count % BATCH;
        if n == 0 {
            self.batches.push(Batch {
                residuals: [0.0; BATCH],
                by: [[0.0; BATCH]; OWN],
            });
        }
        self.count += 1;
        let Some(batch) = self.batches.last_mut() else {
            return;
        };
        batch.residuals[n] = residual;
        for (of_batch, by) in batch.by.iter_mut().zip(by) {
            of_batch[n] = *by;
        }
    }

    pub(crate) fn values(&self) -> impl Iterator<Item = f32> {
        let values = self.batches.iter().flat_map(|batch| batch.residuals);
        values.take(self.count)
    }
}

/// Gray levels by the pattern.
pub(crate) struct LevelModel {
    black: f32,
    contrast: f32,
    curve: Tone,
    /// With the exponent one step larger.
    wider: Tone,
}

impl LevelModel {
    pub(crate) fn new(levels: &Levels, tone: f64) -> Self {
        Self {
            black: levels.black as f32,
            contrast: levels.contrast() as f32,
            curve: levels.tone(tone),
            wider: levels.tone(tone + TONE_STEP),
        }
    }

    /// Residual of a pixel, and its derivatives by all unknowns of the patch, from those of the
    /// pattern by pose and blur.
    pub(crate) fn residual(
        &self,
        pattern: f32,
        by_shared: [f32; 7],
        level: f32,
    ) -> (f32, [f32; OWN]) {
        let (share, slope) = self.curve.at(pattern);
        let factor = self.contrast * slope;
        let mut by = [0.0; OWN];
        for (to, by) in by.iter_mut().zip(by_shared) {
            *to = factor * by;
        }
        let by_step = self.contrast / TONE_STEP as f32;
        by[TONE] = by_step * (self.wider.at(pattern).0 - share);
        by[SHARED] = 1.0 - share;
        by[SHARED + 1] = share;
        (self.black + self.contrast * share - level, by)
    }
}

/// Inverse weight of a residual in multiples of the limit (Cauchy); its logarithm is the cost.
pub(crate) fn robust_excess(scaled: f32) -> f32 {
    1.0 + scaled * scaled
}

/// Normal equations of one patch; of the symmetric matrix the upper half.
pub(crate) struct Sums {
    pub(crate) hessian: [[f64; OWN]; OWN],
    pub(crate) gradient: [f64; OWN],
    pub(crate) weights: f64,
    /// Of the weighted residuals.
    pub(crate) squares: f64,
}

impl Sums {
    /// For pixels with this noise, levels, and a limit in multiples of it.
    pub(crate) fn new(residuals: &Residuals, noise: f64, limit: f64) -> Self {
        let mut sums = Self {
            hessian: [[0.0; OWN]; OWN],
            gradient: [0.0; OWN],
            weights: 0.0,
            squares: 0.0,
        };
        let by_limit = (1.0 / (noise * limit)) as f32;
        let by_noise = (1.0 / (noise * noise)) as f32;
        let mut left = residuals.count;
        for batch in &residuals.batches {
            let shares = batch.residuals.map(|v| 1.0 / robust_excess(v * by_limit));
            let weights = shares.map(|share| share * by_noise);
            for i in 0..OWN {
                let weighted = times(&batch.by[i], &weights);
                sums.gradient[i] += f64::from(dot(&weighted, &batch.residuals));
                for j in i..OWN {
                    sums.hessian[i][j] += f64::from(dot(&weighted, &batch.by[j]));
                }
            }
            let squares = times(&batch.residuals, &shares);
            sums.squares += f64::from(dot(&squares, &batch.residuals));
            sums.weights += f64::from(shares.iter().take(left).sum::<f32>());
            left = left.saturating_sub(BATCH);
        }
        sums
    }
}

fn times(a: &[f32; BATCH], b: &[f32; BATCH]) -> [f32; BATCH] {
    std::array::from_fn(|k| a[k] * b[k])
}

/// In an order of its own, which the compiler can use vectors for.
fn dot(a: &[f32; BATCH], b: &[f32; BATCH]) -> f32 {
    const LANES: usize = 8;
    let mut sums = [0.0_f32; LANES];
    for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
        for k in 0..LANES {
            sums[k] += a[k] * b[k];
        }
    }
    let half: [f32; 4] = std::array::from_fn(|k| sums[k] + sums[k + 4]);
    (half[0] + half[2]) + (half[1] + half[3])
}
