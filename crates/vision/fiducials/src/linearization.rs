//! Normal equations of a fit.

use cad_transforms::RigidTransform;
use nalgebra::{DMatrix, DVector, Matrix6};

use crate::blur::Blur;
use crate::config::Config;
use crate::levels::Levels;
use crate::moments::Moments;
use crate::patch::Patch;
use crate::pattern::PatternSample;
use crate::tag::Tag;
use crate::template::Template;
use crate::tone::Tone;
use crate::view::{Motion, by_motion};

/// Unknowns that all eyes share: pose, blur, tone.
const SHARED: usize = 8;
const BLUR: usize = 6;
const TONE: usize = 7;
/// Limits of the logarithm of the blur, and of the exponent of the tone curve.
const LOG_BLUR_LIMIT: f64 = 1.5;
const TONE_LIMITS: [f64; 2] = [0.25, 1.2];
/// Step of the difference by the exponent.
const TONE_STEP: f64 = 0.01;
/// Standard deviation of a normal distribution by the median of its absolute values.
const SIGMA_BY_MEDIAN: f64 = 1.4826;

/// All unknowns.
#[derive(Clone, Debug)]
pub(crate) struct State {
    pub(crate) pose: RigidTransform,
    /// Logarithm of the blur of lens and sensor relative to the configured one.
    pub(crate) log_blur: f64,
    pub(crate) tone: f64,
    /// By patch.
    pub(crate) levels: Vec<Levels>,
}

impl State {
    /// The state after a step.
    pub(crate) fn after(&self, step: &DVector<f64>) -> Option<Self> {
        let [a, b, c, x, y, z] = std::array::from_fn(|k| step[k]);
        let small = RigidTransform::from_rotation_vector([a, b, c], [x, y, z]).ok()?;
        let levels = self.levels.iter().enumerate().map(|(k, levels)| Levels {
            black: levels.black + step[SHARED + 2 * k],
            white: levels.white + step[SHARED + 2 * k + 1],
        });
        let log_blur = self.log_blur + step[BLUR];
        Some(Self {
            pose: self.pose * small,
            log_blur: log_blur.clamp(-LOG_BLUR_LIMIT, LOG_BLUR_LIMIT),
            tone: (self.tone + step[TONE]).clamp(TONE_LIMITS[0], TONE_LIMITS[1]),
            levels: levels.collect(),
        })
    }
}

/// Normal equations at a state.
#[derive(Clone, Debug)]
pub(crate) struct Linearization {
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
    /// Robust cost, in units of the noise.
    pub(crate) cost: f64,
    /// Residual of the pixels, weighted, levels.
    pub(crate) rms_levels: f64,
    /// Blur on the tag in the sharpest eye, m.
    blur_m: f64,
}

impl Linearization {
    /// The damped step.
    pub(crate) fn step(&self, damping: f64) -> Option<DVector<f64>> {
        let mut hessian = self.hessian.clone();
        for k in 0..hessian.nrows() {
            hessian[(k, k)] *= 1.0 + damping;
        }
        Some(-hessian.cholesky()?.solve(&self.gradient))
    }

    /// Covariance of the pose: of the noise, and no better than the floor at the corners, since
    /// neighboring pixels share errors of the model.
    pub(crate) fn covariance(&self, tag: &Tag, config: &Config) -> Option<Matrix6<f64>> {
        let inverse = self.hessian.clone().cholesky()?.inverse();
        let pose = inverse.fixed_view::<6, 6>(0, 0).into_owned();
        let half = 0.5 * tag.size_m;
        let in_plane = 0.5 * (pose[(3, 3)] + pose[(4, 4)]) + pose[(2, 2)] * half * half;
        let floor = (config.corner_floor_ratio * self.blur_m).powi(2);
        let mut covariance = pose * (1.0 + floor / in_plane.max(1e-18));
        for k in 0..2 {
            covariance[(k, k)] += config.tilt_floor_rad * config.tilt_floor_rad;
        }
        Some(covariance)
    }
}

/// What is fitted.
pub(crate) struct Problem<'a> {
    pub(crate) patches: Vec<PatternedPatch<'a>>,
    tag: &'a Tag,
    motion: &'a Motion,
    config: &'a Config,
}

/// Pixels of an eye, and the pattern that they are compared with.
pub(crate) struct PatternedPatch<'a> {
    pub(crate) patch: Patch<'a>,
    pub(crate) blur: Blur,
    template: Template,
    /// Logarithm of the lens's blur in the template. Near it the pattern is extrapolated.
    log_blur: f64,
}

impl PatternedPatch<'_> {
    /// The pattern at a place of the tag's plane, with derivatives per metre.
    pub(crate) fn pattern(&self, tag: &Tag, at: [f64; 2], log_blur: f64) -> PatternSample {
        let per_m = 1.0 / tag.cell_m();
        let mut sample = self.template.at(at.map(|v| v * per_m));
        sample.value += (log_blur - self.log_blur) * sample.by_log_blur;
        sample.gradient = sample.gradient.map(|v| v * per_m);
        sample
    }
}

/// A pixel's pattern before the tone curve, and its derivatives by pose and blur.
#[derive(Clone, Copy, Debug)]
struct Row {
    pattern: f32,
    by_shared: [f32; 7],
    level: f32,
}

/// Patterns of all pixels at a pose and a blur, by patch.
pub(crate) struct Evaluation {
    patches: Vec<Vec<Row>>,
}

/// Unknowns of one patch: those that are shared, and its levels.
const OWN: usize = SHARED + 2;
/// Pixels whose normal equations are summed in single precision.
const BATCH: usize = 32;

impl<'a> Problem<'a> {
    /// Pixels of each eye near a pose, with patterns of its blur; `None` without pixels.
    pub(crate) fn new(
        patches: Vec<Patch<'a>>,
        tag: &'a Tag,
        motion: &'a Motion,
        config: &'a Config,
        at: (&RigidTransform, f64),
    ) -> Option<Self> {
        let none = Self {
            patches: Vec::new(),
            tag,
            motion,
            config,
        };
        none.with_patches(patches, at)
    }

    /// The problem with other pixels, with the patterns that still hold; `None` without pixels.
    pub(crate) fn with_patches(
        mut self,
        patches: Vec<Patch<'a>>,
        (pose, log_blur): (&RigidTransform, f64),
    ) -> Option<Self> {
        let lens_px = self.config.blur_px * libm::exp(log_blur);
        let mut earlier = std::mem::take(&mut self.patches);
        for patch in patches {
            let blur = Blur::new(&patch.view, self.tag, pose, self.motion, lens_px)?;
            let kept = earlier.iter().position(|own| {
                own.patch.eye == patch.eye && blur.is_near(&own.blur)
            });
            self.patches
                .push(match kept.map(|at| earlier.swap_remove(at)) {
                    Some(own) => PatternedPatch { patch, ..own },
                    None => PatternedPatch {
                        patch,
                        template: Template::new(self.tag, &blur),
                        blur,
                        log_blur,
                    },
                });
        }
        (!self.patches.is_empty()).then_some(self)
    }

    /// Patterns at a pose and the logarithm of a blur; `None` without pixels, or if one of them
    /// does not show the front of the tag: with fewer residuals a state would have a lower cost.
    pub(crate) fn evaluate(&self, pose: &RigidTransform, log_blur: f64) -> Option<Evaluation> {
        let of_patch = |patterned: &PatternedPatch<'_>| {
            let pixels = &patterned.patch.pixels;
            let mut rows = Vec::with_capacity(pixels.len());
            patterned
                .patch
                .for_each(pose, self.motion, |pixel, row_pose| {
                    let Some(point) = row_pose.meet(&pixel.ray) else {
                        return;
                    };
                    let pattern = patterned.pattern(self.tag, point.at, log_blur);
                    let [a, b] = by_motion(&point);
                    let [x, y] = pattern.gradient;
                    let mut by_shared = [0.0; 7];
                    for n in 0..BLUR {
                        by_shared[n] = (x * a[n] + y * b[n]) as f32;
                    }
                    by_shared[BLUR] = pattern.by_log_blur as f32;
                    rows.push(Row {
                        pattern: pattern.value as f32,
                        by_shared,
                        level: pixel.level as f32,
                    });
                });
            (!rows.is_empty() && rows.len() == pixels.len()).then_some(rows)
        };
        let patches: Vec<Vec<Row>> = self.patches.iter().map(of_patch).collect::<Option<_>>()?;
        (!patches.is_empty()).then_some(Evaluation { patches })
    }

    /// Lowest correlation of the eyes' gray levels with the pattern.
    pub(crate) fn correlation(&self, evaluation: &Evaluation) -> f64 {
        let of = |rows: &Vec<Row>| {
            let mut moments = Moments::default();
            for row in rows {
                moments.add(f64::from(row.pattern), f64::from(row.level));
            }
            moments.correlation()
        };
        evaluation.patches.iter().map(of).fold(1.0, f64::min)
    }

    /// The state at a pose where patterns are known; `None` without contrast.
    pub(crate) fn start(
        &self,
        pose: &RigidTransform,
        log_blur: f64,
        evaluation: &Evaluation,
    ) -> Option<State> {
        let tone = Tone::new(self.config.tone, 0.05);
        let levels = |rows: &Vec<Row>| {
            let mut moments = Moments::default();
            for row in rows {
                moments.add(f64::from(tone.at(row.pattern).0), f64::from(row.level));
            }
            let (black, contrast) = moments.line()?;
            (contrast > self.config.min_contrast_levels).then_some(Levels {
                black,
                white: black + contrast,
            })
        };
        Some(State {
            pose: *pose,
            log_blur,
            tone: self.config.tone,
            levels: evaluation
                .patches
                .iter()
                .map(levels)
                .collect::<Option<_>>()?,
        })
    }

    /// Noise of a pixel, levels: the spread of the residuals, and no less than the configured one.
    pub(crate) fn noise(&self, state: &State, evaluation: &Evaluation) -> f64 {
        let mut sizes = Vec::with_capacity(evaluation.patches.iter().map(Vec::len).sum());
        for (levels, rows) in state.levels.iter().zip(&evaluation.patches) {
            let tone = levels.tone(state.tone);
            let [black, contrast] = [levels.black, levels.contrast()].map(|v| v as f32);
            sizes.extend(
                rows.iter()
                    .map(|row| (black + contrast * tone.at(row.pattern).0 - row.level).abs()),
            );
        }
        let middle = sizes.len() / 2;
        let (_, median, _) = sizes.select_nth_unstable_by(middle, f32::total_cmp);
        (SIGMA_BY_MEDIAN * f64::from(*median)).max(self.config.noise_levels)
    }

    /// Normal equations at a state and its patterns, for pixels with this noise.
    pub(crate) fn linearize(
        &self,
        state: &State,
        evaluation: &Evaluation,
        noise: f64,
    ) -> Linearization {
        let config = self.config;
        let count = SHARED + 2 * self.patches.len();
        let mut hessian = DMatrix::zeros(count, count);
        let mut gradient = DVector::zeros(count);
        let (mut cost, mut weights, mut squares) = (0.0, 0.0, 0.0);
        for (patch, rows) in evaluation.patches.iter().enumerate() {
            let sums = Sums::new(rows, &state.levels[patch], state.tone, config, noise);
            cost += sums.cost;
            weights += sums.weights;
            squares += sums.squares;
            let place = |n: usize| if n < SHARED { n } else { n + 2 * patch };
            for i in 0..OWN {
                gradient[place(i)] += sums.gradient[i];
                for j in i..OWN {
                    hessian[(place(i), place(j))] += sums.hessian[i][j];
                }
            }
        }
        let priors = [
            (BLUR, state.log_blur, config.blur_sigma),
            (TONE, state.tone - config.tone, config.tone_sigma),
        ];
        for (k, difference, sigma) in priors {
            cost += (difference / sigma).powi(2);
            gradient[k] += difference / (sigma * sigma);
            hessian[(k, k)] += 1.0 / (sigma * sigma);
        }
        hessian.fill_lower_triangle_with_upper_triangle();
        let blurs = self.patches.iter().map(|patterned| {
            let growth = libm::exp(state.log_blur - patterned.log_blur);
            let [x, y] = patterned.blur.reach_cells(growth);
            (x * y).sqrt() * self.tag.cell_m()
        });
        Linearization {
            hessian,
            gradient,
            cost,
            rms_levels: (squares / weights.max(1.0)).sqrt(),
            blur_m: blurs.fold(f64::INFINITY, f64::min),
        }
    }
}

/// Normal equations of one patch; of the symmetric matrix the upper half.
struct Sums {
    hessian: [[f64; OWN]; OWN],
    gradient: [f64; OWN],
    cost: f64,
    weights: f64,
    squares: f64,
}

impl Sums {
    fn new(rows: &[Row], levels: &Levels, tone: f64, config: &Config, noise: f64) -> Self {
        let mut sums = Self {
            hessian: [[0.0; OWN]; OWN],
            gradient: [0.0; OWN],
            cost: 0.0,
            weights: 0.0,
            squares: 0.0,
        };
        let (curve, wider) = (levels.tone(tone), levels.tone(tone + TONE_STEP));
        let limit = config.robust_ratio;
        let [black, contrast] = [levels.black, levels.contrast()].map(|v| v as f32);
        let by_limit = (1.0 / (noise * limit)) as f32;
        let by_noise = (1.0 / noise) as f32;
        let by_step = contrast / TONE_STEP as f32;
        for batch in rows.chunks(BATCH) {
            // Derivatives and residuals times the root of the weight, by unknown.
            let mut by = [[0.0_f32; BATCH]; OWN];
            let mut residuals = [0.0_f32; BATCH];
            let mut weights = 0.0_f32;
            let mut product = 1.0;
            for (n, row) in batch.iter().enumerate() {
                let (share, slope) = curve.at(row.pattern);
                let residual = black + contrast * share - row.level;
                let scaled = residual * by_limit;
                let excess = 1.0 + scaled * scaled;
                product *= f64::from(excess);
                weights += 1.0 / excess;
                let root = by_noise / excess.sqrt();
                residuals[n] = root * residual;
                let factor = root * contrast * slope;
                for (by, own) in by.iter_mut().zip(row.by_shared) {
                    by[n] = factor * own;
                }
                by[TONE][n] = root * by_step * (wider.at(row.pattern).0 - share);
                by[SHARED][n] = root * (1.0 - share);
                by[SHARED + 1][n] = root * share;
            }
            for i in 0..OWN {
                sums.gradient[i] += f64::from(dot(&by[i], &residuals));
                for j in i..OWN {
                    sums.hessian[i][j] += f64::from(dot(&by[i], &by[j]));
                }
            }
            // The sum of the logarithms; gray levels keep the product finite.
            sums.cost += limit * limit * libm::log(product);
            sums.weights += f64::from(weights);
            sums.squares += f64::from(dot(&residuals, &residuals)) * noise * noise;
        }
        sums
    }
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
