//! Residuals of pixels with derivatives, and their normal equations.
//!
//! Contract: in batches of single precision, which vectors compute; sums over batches are of double
//! precision.

use simd_dispatch::Kernel;

use crate::batch::{BATCH, Lane, Pixels, Plane, PlaneBatch};
use crate::levels::Levels;
use crate::template::{PatternBatch, Template};
use crate::tone::TonePair;
/// Unknowns that all eyes share: pose, blur, tone.
pub(crate) const SHARED: usize = 8;
pub(crate) const BLUR: usize = 6;
pub(crate) const TONE: usize = 7;
/// Unknowns of one patch: those that are shared, and its levels.
pub(crate) const OWN: usize = SHARED + 2;
/// Step of the difference by the exponent of the tone curve.
const TONE_STEP: f64 = 0.01;
/// Lanes of a sum.
const LANES: usize = 8;

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
#[derive(Clone)]
pub(crate) struct Batch {
    pub(crate) residuals: Lane,
    /// Derivatives by unknown.
    pub(crate) by: [Lane; OWN],
}

impl Batch {
    const ZERO: Self = Self {
        residuals: [0.0; BATCH],
        by: [[0.0; BATCH]; OWN],
    };

    /// Leaves a number of pixels.
    fn truncate(&mut self, count: usize) {
        self.residuals[count..].fill(0.0);
        for by in &mut self.by {
            by[count..].fill(0.0);
        }
    }
}

impl Residuals {
    pub(crate) fn values(&self) -> impl Iterator<Item = f32> {
        let values = self.batches.iter().flat_map(|batch| batch.residuals);
        values.take(self.count)
    }
}

/// Gray levels by the pattern.
pub(crate) struct LevelModel {
    black: f32,
    contrast: f32,
    /// The curve, and that with the exponent one step larger.
    curves: TonePair,
}

impl LevelModel {
    pub(crate) fn new(levels: &Levels, tone: f64) -> Self {
        Self {
            black: levels.black as f32,
            contrast: levels.contrast() as f32,
            curves: TonePair::new(&levels.tone(tone), &levels.tone(tone + TONE_STEP)),
        }
    }
}

/// Residuals of pixels with derivatives by all unknowns of a patch; `None` if a pixel does not show
/// the front of the tag.
pub(crate) struct Evaluate<'k> {
    pub(crate) pixels: &'k Pixels,
    pub(crate) plane: &'k Plane,
    pub(crate) template: &'k Template,
    /// Logarithm of the blur minus that of the template.
    pub(crate) growth: f32,
    pub(crate) model: &'k LevelModel,
    pub(crate) cell_m: f32,
}

impl Kernel for Evaluate<'_> {
    type Output = Option<Residuals>;

    #[inline(always)]
    fn run(self) -> Option<Residuals> {
        let mut residuals = Residuals {
            count: self.pixels.count,
            batches: vec![Batch::ZERO; self.pixels.batches.len()],
        };
        let (mut point, mut pattern) = (PlaneBatch::ZERO, PatternBatch::ZERO);
        let (mut shares, mut slopes, mut wider) = ([0.0; BATCH], [0.0; BATCH], [0.0; BATCH]);
        let (black, contrast) = (self.model.black, self.model.contrast);
        let (per_m, by_step) = (1.0 / self.cell_m, contrast / TONE_STEP as f32);
        for (pixels, to) in self.pixels.batches.iter().zip(&mut residuals.batches) {
            if !self.plane.meet(pixels, &mut point) {
                return None;
            }
            self.template.sample(&point, self.growth, &mut pattern);
            (self.model.curves).at(&pattern.value, [&mut shares, &mut slopes, &mut wider]);
            for k in 0..BATCH {
                let factor = contrast * slopes[k];
                // Derivatives by a place on the plane, per m, and by motion along the ray.
                let (x, y) = (factor * per_m * pattern.x[k], factor * per_m * pattern.y[k]);
                let along = x * point.slope_x[k] + y * point.slope_y[k];
                let (a, b) = (self.cell_m * point.x[k], self.cell_m * point.y[k]);
                to.by[0][k] = b * along;
                to.by[1][k] = -a * along;
                to.by[2][k] = b * x - a * y;
                to.by[3][k] = -x;
                to.by[4][k] = -y;
                to.by[5][k] = along;
                to.by[BLUR][k] = factor * pattern.by_log_blur[k];
                to.by[TONE][k] = by_step * (wider[k] - shares[k]);
                to.by[SHARED][k] = 1.0 - shares[k];
                to.by[SHARED + 1][k] = shares[k];
                to.residuals[k] = black + contrast * shares[k] - pixels.level[k];
            }
        }
        if let Some(last) = residuals.batches.last_mut() {
            last.truncate(self.pixels.count_of(self.pixels.batches.len() - 1));
        }
        Some(residuals)
    }
}

/// Inverse weight of a residual in multiples of the limit (Cauchy); its logarithm is the cost.
#[inline(always)]
fn robust_excess(scaled: f32) -> f32 {
    1.0 + scaled * scaled
}

/// Robust cost of residuals for pixels with this inverse limit, without priors.
pub(crate) struct Cost<'k> {
    pub(crate) residuals: &'k Residuals,
    pub(crate) by_limit: f32,
}

impl Kernel for Cost<'_> {
    type Output = f64;

    #[inline(always)]
    fn run(self) -> f64 {
        let mut cost = 0.0;
        for batch in &self.residuals.batches {
            // The sum of the logarithms; gray levels keep the product finite.
            let mut products = [1.0_f64; LANES];
            for part in batch.residuals.as_chunks::<LANES>().0 {
                for k in 0..LANES {
                    products[k] *= f64::from(robust_excess(part[k] * self.by_limit));
                }
            }
            let mut product = 1.0;
            for one in products {
                product *= one;
            }
            cost += libm::log(product);
        }
        cost
    }
}

/// Normal equations of one patch; of the symmetric matrix the upper half.
pub(crate) struct Sums {
    pub(crate) hessian: [[f64; OWN]; OWN],
    pub(crate) gradient: [f64; OWN],
    pub(crate) weights: f64,
    /// Of the weighted residuals.
    pub(crate) squares: f64,
}

/// Normal equations of a patch for pixels with this noise, levels, and a limit in multiples of it.
pub(crate) struct Accumulate<'k> {
    pub(crate) residuals: &'k Residuals,
    pub(crate) noise: f64,
    pub(crate) limit: f64,
}

impl Kernel for Accumulate<'_> {
    type Output = Sums;

    #[inline(always)]
    fn run(self) -> Sums {
        let mut hessian = [[[0.0_f64; LANES]; OWN]; OWN];
        let mut gradient = [[0.0_f64; LANES]; OWN];
        let (mut squares, mut weights) = ([0.0_f64; LANES], 0.0);
        let by_limit = (1.0 / (self.noise * self.limit)) as f32;
        let by_noise = (1.0 / (self.noise * self.noise)) as f32;
        let mut left = self.residuals.count;
        let (mut shares, mut weighted) = ([0.0_f32; BATCH], [0.0_f32; BATCH]);
        for batch in &self.residuals.batches {
            for k in 0..BATCH {
                shares[k] = 1.0 / robust_excess(batch.residuals[k] * by_limit);
                weighted[k] = shares[k] * batch.residuals[k];
            }
            add_products(&mut squares, &weighted, &batch.residuals);
            for share in &shares[..left.min(BATCH)] {
                weights += f64::from(*share);
            }
            left = left.saturating_sub(BATCH);
            for i in 0..OWN {
                for k in 0..BATCH {
                    weighted[k] = batch.by[i][k] * (shares[k] * by_noise);
                }
                add_products(&mut gradient[i], &weighted, &batch.residuals);
                for j in i..OWN {
                    add_products(&mut hessian[i][j], &weighted, &batch.by[j]);
                }
            }
        }
        let mut sums = Sums {
            hessian: [[0.0; OWN]; OWN],
            gradient: [0.0; OWN],
            weights,
            squares: sum(&squares),
        };
        for i in 0..OWN {
            sums.gradient[i] = sum(&gradient[i]);
            for j in i..OWN {
                sums.hessian[i][j] = sum(&hessian[i][j]);
            }
        }
        sums
    }
}

/// Adds products to the lanes of their sum.
#[inline(always)]
fn add_products(to: &mut [f64; LANES], a: &Lane, b: &Lane) {
    let mut lanes = [0.0_f32; LANES];
    for part in 0..BATCH / LANES {
        for k in 0..LANES {
            lanes[k] += a[part * LANES + k] * b[part * LANES + k];
        }
    }
    for k in 0..LANES {
        to[k] += f64::from(lanes[k]);
    }
}

#[inline(always)]
fn sum(lanes: &[f64; LANES]) -> f64 {
    let mut sum = 0.0;
    for lane in lanes {
        sum += lane;
    }
    sum
}
