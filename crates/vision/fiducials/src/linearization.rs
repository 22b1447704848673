//! Normal equations of a fit.

use cad_transforms::RigidTransform;
use nalgebra::{DMatrix, DVector, Matrix6};

use crate::blur::Blur;
use crate::config::Config;
use crate::levels::Levels;
use crate::moments::Moments;
use crate::patch::Patch;
use crate::tag::Tag;
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
    pub(crate) patches: &'a [Patch<'a>],
    pub(crate) tag: &'a Tag,
    pub(crate) motion: &'a Motion,
    pub(crate) config: &'a Config,
}

/// A pixel's pattern before the tone curve, and its derivatives by pose and blur.
struct Row {
    patch: usize,
    pattern: f64,
    by_shared: [f64; 7],
    level: f64,
}

/// Patterns of all pixels at a pose and a blur.
pub(crate) struct Evaluation {
    rows: Vec<Row>,
}

/// Unknowns of one patch: those that are shared, and its levels.
const OWN: usize = SHARED + 2;

impl Problem<'_> {
    /// The blur in a patch.
    pub(crate) fn blur(&self, patch: &Patch<'_>, pose: &RigidTransform, log: f64) -> Option<Blur> {
        let lens_px = self.config.blur_px * libm::exp(log);
        Blur::new(&patch.view, self.tag, pose, self.motion, lens_px)
    }

    /// Patterns at a pose and the logarithm of a blur; `None` without pixels, or if one of them
    /// does not show the front of the tag: with fewer residuals a state would have a lower cost.
    pub(crate) fn evaluate(&self, pose: &RigidTransform, log_blur: f64) -> Option<Evaluation> {
        let count: usize = self.patches.iter().map(|patch| patch.pixels.len()).sum();
        let mut rows = Vec::with_capacity(count);
        for (k, patch) in self.patches.iter().enumerate() {
            let blur = self.blur(patch, pose, log_blur)?;
            patch.for_each(pose, self.motion, |pixel, row_pose| {
                let Some(point) = row_pose.meet(&pixel.ray) else {
                    return;
                };
                let blurred = blur.sample(self.tag, &point);
                let [a, b] = by_motion(&point);
                let mut by_shared = [0.0; 7];
                for n in 0..BLUR {
                    by_shared[n] = blurred.gradient[0] * a[n] + blurred.gradient[1] * b[n];
                }
                by_shared[BLUR] = blurred.by_log_blur;
                rows.push(Row {
                    patch: k,
                    pattern: blurred.value,
                    by_shared,
                    level: pixel.level,
                });
            });
        }
        (!rows.is_empty() && rows.len() == count).then_some(Evaluation { rows })
    }

    /// Lowest correlation of the eyes' gray levels with the pattern.
    pub(crate) fn correlation(&self, evaluation: &Evaluation) -> f64 {
        let of = |patch: usize| {
            let own = evaluation.rows.iter().filter(|row| row.patch == patch);
            let mut moments = Moments::default();
            own.for_each(|row| moments.add(row.pattern, row.level));
            moments.correlation()
        };
        (0..self.patches.len()).map(of).fold(1.0, f64::min)
    }

    /// The state at a pose where patterns are known; `None` without patches or contrast.
    pub(crate) fn start(&self, pose: &RigidTransform, evaluation: &Evaluation) -> Option<State> {
        let tone = Tone::new(self.config.tone, 0.05);
        let levels = |patch: usize| {
            let own = evaluation.rows.iter().filter(|row| row.patch == patch);
            let mut moments = Moments::default();
            own.for_each(|row| moments.add(tone.at(row.pattern).0, row.level));
            let (black, contrast) = moments.line()?;
            (contrast > self.config.min_contrast_levels).then_some(Levels {
                black,
                white: black + contrast,
            })
        };
        let levels: Vec<Levels> = (0..self.patches.len()).map(levels).collect::<Option<_>>()?;
        (!levels.is_empty()).then_some(State {
            pose: *pose,
            log_blur: 0.0,
            tone: self.config.tone,
            levels,
        })
    }

    fn tones(&self, state: &State, step: f64) -> Vec<Tone> {
        let levels = state.levels.iter();
        levels
            .map(|levels| levels.tone(state.tone + step))
            .collect()
    }

    /// Noise of a pixel, levels: the spread of the residuals, and no less than the configured one.
    pub(crate) fn noise(&self, state: &State, evaluation: &Evaluation) -> f64 {
        let tones = self.tones(state, 0.0);
        let residual = |row: &Row| {
            let levels = &state.levels[row.patch];
            let share = tones[row.patch].at(row.pattern).0;
            (levels.black + levels.contrast() * share - row.level).abs()
        };
        let mut sizes: Vec<f64> = evaluation.rows.iter().map(residual).collect();
        let middle = sizes.len() / 2;
        let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
        (SIGMA_BY_MEDIAN * *median).max(self.config.noise_levels)
    }

    /// Normal equations at a state and its patterns, for pixels with this noise.
    pub(crate) fn linearize(
        &self,
        state: &State,
        evaluation: &Evaluation,
        noise: f64,
    ) -> Option<Linearization> {
        let config = self.config;
        let count = SHARED + 2 * self.patches.len();
        let mut hessian = DMatrix::zeros(count, count);
        let mut gradient = DVector::zeros(count);
        let (mut cost, mut weights, mut squares) = (0.0, 0.0, 0.0);
        let (tones, wider) = (self.tones(state, 0.0), self.tones(state, TONE_STEP));
        let limit = config.robust_ratio;
        for patch in 0..self.patches.len() {
            let levels = &state.levels[patch];
            let (tone, wider) = (&tones[patch], &wider[patch]);
            let contrast = levels.contrast();
            let mut own_hessian = [[0.0; OWN]; OWN];
            let mut own_gradient = [0.0; OWN];
            for row in evaluation.rows.iter().filter(|row| row.patch == patch) {
                let (share, slope) = tone.at(row.pattern);
                let residual = levels.black + contrast * share - row.level;
                let scaled = residual / (noise * limit);
                let weight = 1.0 / (1.0 + scaled * scaled);
                cost += limit * limit * libm::log1p(scaled * scaled);
                weights += weight;
                squares += weight * residual * residual;
                let mut by = [0.0; OWN];
                for (to, by) in by.iter_mut().zip(&row.by_shared) {
                    *to = contrast * slope * by;
                }
                by[TONE] = contrast * (wider.at(row.pattern).0 - share) / TONE_STEP;
                by[SHARED] = 1.0 - share;
                by[SHARED + 1] = share;
                let factor = weight / (noise * noise);
                for i in 0..OWN {
                    let weighted = factor * by[i];
                    own_gradient[i] += weighted * residual;
                    for j in i..OWN {
                        own_hessian[i][j] += weighted * by[j];
                    }
                }
            }
            let place = |n: usize| if n < SHARED { n } else { n + 2 * patch };
            for i in 0..OWN {
                gradient[place(i)] += own_gradient[i];
                for j in i..OWN {
                    hessian[(place(i), place(j))] += own_hessian[i][j];
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
        let blurs = self.patches.iter().map(|patch| {
            let [x, y] = self
                .blur(patch, &state.pose, state.log_blur)?
                .reach_cells(1.0);
            Some((x * y).sqrt() * self.tag.cell_m())
        });
        let blurs: Vec<f64> = blurs.collect::<Option<_>>()?;
        Some(Linearization {
            hessian,
            gradient,
            cost,
            rms_levels: (squares / weights.max(1.0)).sqrt(),
            blur_m: blurs.into_iter().fold(f64::INFINITY, f64::min),
        })
    }
}
