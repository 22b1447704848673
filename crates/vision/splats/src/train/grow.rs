//! Splitting and removal of Gaussians.
//!
//! By error: a Gaussian that shows much error in at least two instants is split along its longest
//! axis, largest errors first. The two halves lie at ±0.6 standard deviations with 0.8 of it, which
//! keeps the variance; their opacity is `1 - (1 - o)^0.71` (Brush). By gradient: Kerbl et al. 2023
//! with the absolute gradients of AbsGS: small ones are copied, large ones replaced by two samples
//! of themselves with scales / 1.6.

use super::adam::Adam;
use super::codec::{Codec, State};
use super::config::GrowthConfig;
use super::view::TrainingView;
use crate::error::SplatError;
use crate::render::Gradients;
use crate::scene::{Plane, Splat, Splats, morton_order};

/// Offset and scale of the halves along the axis.
const OFFSET: f32 = 0.6;
const SHRINK: f32 = 0.8;
/// Exponent of the halves' transparency. Source: Brush.
const TRANSPARENCY: f32 = 0.71;
/// Source: Kerbl et al. 2023.
const SPLIT_SCALE: f32 = 1.6;
/// Stream of random numbers of the samples.
const STREAM: u64 = 0x7370_6c69;

/// What was gathered of a Gaussian since the last round.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GrowthStatistics {
    /// Largest error that it showed in a view, times pixels.
    pub error_px: f32,
    /// Instants with an error above the limit, counted as they change.
    pub instants: u32,
    /// The last one of them.
    pub last_instant: Option<u32>,
    /// Sum of absolute gradients, per half image.
    pub gradient: f32,
    /// Number of views that showed it.
    pub views: u32,
    /// Most pixels that it filled in a view.
    pub weight_px: f32,
}

#[derive(Clone, Debug)]
pub(super) struct Growth {
    pub(super) observed: Vec<GrowthStatistics>,
    seed: u64,
    rounds: u64,
}

/// Size of the scene and which share of it may be split.
#[derive(Clone, Copy, Debug)]
pub(super) struct Round {
    pub(super) radius_m: f32,
    pub(super) max_share: f32,
}

impl Growth {
    pub(super) fn new(count: usize, seed: u64) -> Self {
        Self {
            observed: vec![GrowthStatistics::default(); count],
            seed,
            rounds: 0,
        }
    }

    /// Number of Gaussians.
    pub(super) fn len(&self) -> usize {
        self.observed.len()
    }

    /// Gathers from the gradients of a view that was reduced by `reduction`.
    pub(super) fn gather(
        &mut self,
        gradients: &Gradients,
        view: &TrainingView,
        reduction: u32,
        config: &GrowthConfig,
    ) {
        let model = view.camera.model();
        let half = [model.width, model.height].map(|v| v as f32 / 2.0);
        let area = (reduction * reduction) as f32;
        for (k, index) in gradients.indices.iter().enumerate() {
            let observed = &mut self.observed[*index as usize];
            let [x, y] = gradients.absolute[k];
            let (x, y) = (x * half[0], y * half[1]);
            observed.gradient += (x * x + y * y).sqrt();
            observed.views += 1;
            observed.weight_px = observed.weight_px.max(gradients.weight[k] * area);
            let error_px = gradients.error[k] * area;
            observed.error_px = observed.error_px.max(error_px);
            if error_px >= config.min_error_px && observed.last_instant != Some(view.instant) {
                observed.instants += 1;
                observed.last_instant = Some(view.instant);
            }
        }
    }

    /// Splits and removes Gaussians, and forgets what was gathered.
    pub(super) fn round(
        &mut self,
        splats: &mut Splats,
        adam: &mut Adam,
        config: &GrowthConfig,
        round: Round,
    ) {
        let kept: Vec<u32> = (0..splats.len() as u32)
            .filter(|i| {
                self.is_kept(
                    &splats.get(*i as usize),
                    *i as usize,
                    config,
                    round.radius_m,
                )
            })
            .collect();
        let chosen = self.choose(&kept, config, round.max_share);
        let mut indices = kept.clone();
        let mut changed: Vec<(usize, Splat)> = Vec::new();
        for (position, old) in chosen {
            let parent = splats.get(old as usize);
            let [a, b] = match config.by_gradient {
                true => self.sampled(&parent, old, config.clone_size * round.radius_m),
                false => halves(&parent),
            };
            changed.push((position, a));
            changed.push((indices.len(), b));
            indices.push(old);
        }
        *splats = splats.select(&indices);
        adam.select(&indices);
        for (index, splat) in changed {
            adam.reset(index);
            set(splats, index, &splat);
        }
        let order = morton_order(splats);
        *splats = splats.select(&order);
        adam.select(&order);
        self.observed = vec![GrowthStatistics::default(); splats.len()];
        self.rounds += 1;
    }

    fn is_kept(&self, splat: &Splat, index: usize, config: &GrowthConfig, radius_m: f32) -> bool {
        let observed = &self.observed[index];
        let opacity = 1.0 / (1.0 + libm::expf(-splat.opacity_logit));
        let largest = splat
            .log_scale
            .into_iter()
            .fold(f32::NEG_INFINITY, f32::max);
        opacity >= config.min_opacity
            && (observed.views == 0 || observed.weight_px >= config.min_weight_px)
            && libm::expf(largest) <= config.max_size * radius_m
    }

    /// Positions among the kept ones and indices of Gaussians to split.
    fn choose(&self, kept: &[u32], config: &GrowthConfig, max_share: f32) -> Vec<(usize, u32)> {
        let score = |index: u32| {
            let observed = &self.observed[index as usize];
            match config.by_gradient {
                true => {
                    let mean = observed.gradient / observed.views.max(1) as f32;
                    (mean > config.min_gradient).then_some(mean)
                }
                false => (observed.instants >= config.min_instants
                    && observed.error_px >= config.min_error_px)
                    .then_some(observed.error_px),
            }
        };
        let mut chosen: Vec<(f32, usize, u32)> = kept
            .iter()
            .enumerate()
            .filter_map(|(position, index)| Some((score(*index)?, position, *index)))
            .collect();
        chosen.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let share = (max_share * kept.len() as f32).ceil() as usize;
        chosen.truncate(share.min(config.max_splats.saturating_sub(kept.len())));
        chosen
            .into_iter()
            .map(|(_, position, index)| (position, index))
            .collect()
    }

    /// Two copies of a small Gaussian, or two samples of a large one.
    fn sampled(&self, parent: &Splat, index: u32, clone_size_m: f32) -> [Splat; 2] {
        let scale = parent.log_scale.map(libm::expf);
        if scale.into_iter().fold(0.0, f32::max) <= clone_size_m {
            return [*parent; 2];
        }
        let axes = axes(parent);
        [0, 1].map(|child| {
            let mut splat = *parent;
            for k in 0..3 {
                let stream = STREAM + 8 * self.rounds + 3 * child + k as u64;
                let along =
                    counter_random::bell(self.seed, stream, u64::from(index)) as f32 * scale[k];
                for (c, position) in splat.position_m.iter_mut().enumerate() {
                    *position += along * axes[k][c];
                }
                splat.log_scale[k] -= libm::logf(SPLIT_SCALE);
            }
            splat
        })
    }
}

impl State for GrowthStatistics {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.error_px.visit(codec)?;
        self.instants.visit(codec)?;
        let mut is_some = self.last_instant.is_some();
        let mut instant = self.last_instant.unwrap_or_default();
        is_some.visit(codec)?;
        instant.visit(codec)?;
        self.last_instant = is_some.then_some(instant);
        self.gradient.visit(codec)?;
        self.views.visit(codec)?;
        self.weight_px.visit(codec)
    }
}

/// The seed is that of the training.
impl State for Growth {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.observed.visit(codec)?;
        self.rounds.visit(codec)
    }
}

/// Two halves along the longest axis.
fn halves(parent: &Splat) -> [Splat; 2] {
    let longer = |a: usize, b: usize| match parent.log_scale[b] > parent.log_scale[a] {
        true => b,
        false => a,
    };
    let longest = (0..3).fold(0, longer);
    let axis = axes(parent)[longest];
    let offset = OFFSET * libm::expf(parent.log_scale[longest]);
    let opacity = 1.0 / (1.0 + libm::expf(-parent.opacity_logit));
    let opacity = 1.0 - libm::powf(1.0 - opacity, TRANSPARENCY);
    // Both are below 1 in f32 up to logits of 16.
    let logit = libm::logf(opacity / (1.0 - opacity).max(1e-7));
    [-offset, offset].map(|offset| {
        let mut half = *parent;
        for (c, position) in half.position_m.iter_mut().enumerate() {
            *position += offset * axis[c];
        }
        half.log_scale[longest] += libm::logf(SHRINK);
        half.opacity_logit = logit;
        half
    })
}

/// Axes of a Gaussian in the world.
fn axes(splat: &Splat) -> [[f32; 3]; 3] {
    let [w, x, y, z] = splat.rotation_wxyz.map(f64::from);
    let q = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
    let m = q.to_rotation_matrix();
    std::array::from_fn(|k| std::array::from_fn(|c| m[(c, k)] as f32))
}

/// Replaces the parameters of a Gaussian.
fn set(splats: &mut Splats, index: usize, splat: &Splat) {
    let harmonics = splat.harmonics.as_flattened();
    let values = (splat.position_m.iter())
        .chain(&splat.log_scale)
        .chain(&splat.rotation_wxyz)
        .chain([&splat.opacity_logit])
        .chain(harmonics);
    for (plane, value) in splats.planes_mut().iter_mut().zip(values) {
        plane[index] = *value;
    }
}

/// Lowers all opacities to at most a value.
pub(super) fn reset_opacities(splats: &mut Splats, adam: &mut Adam, opacity: f32) {
    let logit = libm::logf(opacity / (1.0 - opacity));
    for value in &mut splats.planes_mut()[Plane::OPACITY] {
        *value = value.min(logit);
    }
    adam.reset_plane(Plane::OPACITY);
}
