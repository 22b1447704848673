//! Normal equations of a fit.

use std::rc::Rc;

use cad_transforms::RigidTransform;
use nalgebra::{DMatrix, DVector, Matrix6};
use simd_dispatch::Kernel;

use crate::batch::{PixelBatch, Plane, PlaneBatch};
use crate::blur::Blur;
use crate::config::Config;
use crate::levels::Levels;
use crate::moments::Moments;
use crate::patch::Patch;
use crate::residuals::{
    Accumulate, BLUR, Cost, Evaluate, Evaluation, LevelModel, OWN, Residuals, SHARED, TONE,
};
use crate::tag::Tag;
use crate::template::{PatternBatch, Template};
use crate::tone::Tone;
use crate::view::Motion;
/// Limits of the logarithm of the blur, and of the exponent of the tone curve.
const LOG_BLUR_LIMIT: f64 = 1.5;
const TONE_LIMITS: [f64; 2] = [0.25, 1.2];
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
    /// Residual of the pixels, weighted, levels.
    pub(crate) rms_levels: f64,
    /// Blur on the tag in the sharpest eye, m.
    blur_m: f64,
    /// Motion during the exposure in the eye with the least, cells.
    pub(crate) motion_cells: f64,
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

    /// By how much a step lowers the cost, by the normal equations.
    pub(crate) fn decrease(&self, step: &DVector<f64>) -> f64 {
        -self.gradient.dot(step)
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
        let by_motion = config.tilt_per_cell_rad * self.motion_cells;
        for k in 0..2 {
            covariance[(k, k)] += config.tilt_floor_rad.powi(2) + by_motion * by_motion;
        }
        Some(covariance)
    }
}

/// What is fitted.
pub(crate) struct Problem<'a> {
    pub(crate) patches: Vec<PatchModel<'a>>,
    tag: &'a Tag,
    motion: &'a Motion,
    config: &'a Config,
}

/// Pixels of an eye, and the pattern that they are compared with.
pub(crate) struct PatchModel<'a> {
    pub(crate) patch: Patch<'a>,
    pub(crate) blur: Blur,
    /// Eyes with similar blur have the same one.
    template: Rc<Template>,
    /// Logarithm of the lens's blur at which the template has the blur of this eye. Near it the
    /// pattern is extrapolated.
    log_blur: f64,
}

impl PatchModel<'_> {
    /// Change of the logarithm of the blur from that of the template.
    pub(crate) fn growth(&self, log_blur: f64) -> f32 {
        (log_blur - self.log_blur) as f32
    }

    pub(crate) fn template(&self) -> &Template {
        &self.template
    }
}

/// Patterns before the tone curve, and gray levels, of the pixels of a patch.
pub(crate) type Patterns = Vec<[f32; 2]>;

/// The pattern at the places of a batch of pixels; false if one of them does not show the front of
/// the tag.
pub(crate) struct Sample<'k> {
    pub(crate) plane: &'k Plane,
    pub(crate) template: &'k Template,
    pub(crate) growth: f32,
    pub(crate) pixels: &'k PixelBatch,
    pub(crate) point: &'k mut PlaneBatch,
    pub(crate) pattern: &'k mut PatternBatch,
}

impl Kernel for Sample<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        let is_front = self.plane.meet(self.pixels, self.point);
        self.template.sample(self.point, self.growth, self.pattern);
        is_front
    }
}

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

    /// A state of this problem as one of other patches; `None` if one of them is of another eye.
    pub(crate) fn state_with(&self, state: &State, patches: &[Patch<'_>]) -> Option<State> {
        let levels = patches.iter().map(|patch| {
            let place = self
                .patches
                .iter()
                .position(|own| own.patch.eye == patch.eye)?;
            Some(state.levels[place])
        });
        Some(State {
            levels: levels.collect::<Option<_>>()?,
            ..state.clone()
        })
    }

    /// The problem with other pixels, with the patterns that still hold; `None` without pixels.
    pub(crate) fn with_patches(
        mut self,
        patches: Vec<Patch<'a>>,
        (pose, log_blur): (&RigidTransform, f64),
    ) -> Option<Self> {
        let lens_px = self.config.blur_px * libm::exp(log_blur);
        let earlier = std::mem::take(&mut self.patches);
        for patch in patches {
            let blur = Blur::new(&patch.view, self.tag, pose, self.motion, lens_px)?;
            let known = self.patches.iter().chain(&earlier);
            let near = known
                .filter_map(|own| Some((own, own.template.blur().log_growth_to(&blur)?)))
                .next();
            let (template, growth) = match near {
                Some((own, growth)) => (Rc::clone(&own.template), growth),
                None => (Rc::new(Template::new(self.tag, &blur)), 0.0),
            };
            self.patches.push(PatchModel {
                patch,
                blur,
                template,
                log_blur: log_blur - growth,
            });
        }
        (!self.patches.is_empty()).then_some(self)
    }

    /// Patterns by patch at a pose and the logarithm of a blur; `None` if a pixel does not show the
    /// front of the tag.
    pub(crate) fn patterns(&self, pose: &RigidTransform, log_blur: f64) -> Option<Vec<Patterns>> {
        let (mut point, mut pattern) = (PlaneBatch::ZERO, PatternBatch::ZERO);
        let mut of_patch = |own: &PatchModel<'_>| {
            let pixels = &own.patch.pixels;
            let plane = own.patch.plane(self.tag, pose, self.motion)?;
            let mut patterns = Vec::with_capacity(pixels.count);
            for (number, batch) in pixels.batches.iter().enumerate() {
                let is_front = simd_dispatch::run(Sample {
                    plane: &plane,
                    template: &own.template,
                    growth: own.growth(log_blur),
                    pixels: batch,
                    point: &mut point,
                    pattern: &mut pattern,
                });
                if !is_front {
                    return None;
                }
                let pairs =
                    (0..pixels.count_of(number)).map(|k| [pattern.value[k], batch.level[k]]);
                patterns.extend(pairs);
            }
            Some(patterns)
        };
        self.patches.iter().map(&mut of_patch).collect()
    }

    /// The state at a pose where patterns are known; `None` without contrast.
    pub(crate) fn start(
        &self,
        pose: &RigidTransform,
        log_blur: f64,
        patterns: &[Patterns],
    ) -> Option<State> {
        let tone = Tone::new(self.config.tone, 0.05);
        let levels = |patterns: &Patterns| {
            let mut moments = Moments::default();
            for [pattern, level] in patterns {
                moments.add(f64::from(tone.at(*pattern).0), f64::from(*level));
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
            levels: patterns.iter().map(levels).collect::<Option<_>>()?,
        })
    }

    /// Residuals of all pixels at a state, with derivatives; `None` if one of them does not show
    /// the front of the tag: with fewer residuals a state would have a lower cost.
    pub(crate) fn evaluate(&self, state: &State) -> Option<Evaluation> {
        let of_patch = |(own, levels): (&PatchModel<'_>, &Levels)| {
            let plane = own.patch.plane(self.tag, &state.pose, self.motion)?;
            simd_dispatch::run(Evaluate {
                pixels: &own.patch.pixels,
                plane: &plane,
                template: &own.template,
                growth: own.growth(state.log_blur),
                model: &LevelModel::new(levels, state.tone),
                cell_m: self.tag.cell_m() as f32,
            })
        };
        let patches = self.patches.iter().zip(&state.levels).map(of_patch);
        Some(Evaluation {
            patches: patches.collect::<Option<_>>()?,
            priors: self.priors(state),
        })
    }

    /// Unknowns with a prior: index, deviation from it, and sigma.
    fn priors(&self, state: &State) -> [(usize, f64, f64); 2] {
        let config = self.config;
        [
            (BLUR, state.log_blur, config.blur_sigma),
            (TONE, state.tone - config.tone, config.tone_sigma),
        ]
    }

    /// Noise of a pixel, levels: the spread of the residuals, and no less than the configured one.
    pub(crate) fn noise(&self, evaluation: &Evaluation) -> f64 {
        let residuals = evaluation.patches.iter().flat_map(Residuals::values);
        // Numbers that are not negative are in the order of their bits.
        let mut sizes: Vec<u32> = residuals.map(|v| v.abs().to_bits()).collect();
        let middle = sizes.len() / 2;
        let (_, median, _) = sizes.select_nth_unstable(middle);
        let median = f64::from(f32::from_bits(*median));
        (SIGMA_BY_MEDIAN * median).max(self.config.noise_levels)
    }

    /// Robust cost for pixels with this noise.
    pub(crate) fn cost(&self, evaluation: &Evaluation, noise: f64) -> f64 {
        let limit = self.config.robust_ratio;
        let by_limit = (1.0 / (noise * limit)) as f32;
        let of_patch = |residuals| {
            simd_dispatch::run(Cost {
                residuals,
                by_limit,
            })
        };
        let of_pixels: f64 = evaluation.patches.iter().map(of_patch).sum();
        let priors = evaluation.priors.iter();
        let of_priors: f64 = priors
            .map(|(_, deviation, sigma)| (deviation / sigma).powi(2))
            .sum();
        limit * limit * of_pixels + of_priors
    }

    /// Normal equations at a state, for pixels with this noise.
    pub(crate) fn linearize(
        &self,
        state: &State,
        evaluation: &Evaluation,
        noise: f64,
    ) -> Linearization {
        let count = SHARED + 2 * self.patches.len();
        let mut hessian = DMatrix::zeros(count, count);
        let mut gradient = DVector::zeros(count);
        let (mut weights, mut squares) = (0.0, 0.0);
        for (patch, residuals) in evaluation.patches.iter().enumerate() {
            let sums = simd_dispatch::run(Accumulate {
                residuals,
                noise,
                limit: self.config.robust_ratio,
            });
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
        for (k, deviation, sigma) in evaluation.priors {
            gradient[k] += deviation / (sigma * sigma);
            hessian[(k, k)] += 1.0 / (sigma * sigma);
        }
        hessian.fill_lower_triangle_with_upper_triangle();
        let blurs = self.patches.iter().map(|own| {
            let growth = libm::exp(state.log_blur - own.log_blur);
            let [x, y] = own.template.blur().reach_cells(growth);
            (x * y).sqrt() * self.tag.cell_m()
        });
        let motions = self.patches.iter().map(|own| own.blur.motion_cells());
        Linearization {
            motion_cells: motions.fold(f64::INFINITY, f64::min),
            hessian,
            gradient,
            rms_levels: (squares / weights.max(1.0)).sqrt(),
            blur_m: blurs.fold(f64::INFINITY, f64::min),
        }
    }
}

#[cfg(test)]
mod tests;
