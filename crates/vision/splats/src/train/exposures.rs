//! Corrections of exposures: one gain per group of images, with a prior.

use super::adam::update;
use super::codec::{Codec, State};
use super::config::{ExposureConfig, OptimizerConfig};
use super::view::TrainingView;
use crate::error::SplatError;
use crate::scene::Exposure;

/// Gains by group, in sigmas of their logarithm.
#[derive(Clone, Debug)]
pub(super) struct Exposures {
    groups: Vec<Group>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Group {
    value: f32,
    first: f32,
    second: f32,
    steps: usize,
}

impl Exposures {
    /// # Panics
    /// Never: a group number is an index after [`super::trainer::Trainer::new`] has counted them.
    pub(super) fn new(groups: usize) -> Self {
        Self {
            groups: vec![Group::default(); groups],
        }
    }

    pub(super) fn len(&self) -> usize {
        self.groups.len()
    }

    /// The exposure of a view.
    pub(super) fn of(&self, view: &TrainingView, config: &ExposureConfig) -> Exposure {
        let gain = libm::expf(self.groups[view.exposure_group as usize].value * config.sigma);
        Exposure {
            matrix: view.exposure.matrix.map(|row| row.map(|v| v * gain)),
        }
    }

    /// Follows the gradient with respect to the matrix of a view's exposure.
    pub(super) fn step(
        &mut self,
        view: &TrainingView,
        gradient: &[[f64; 4]; 3],
        config: &ExposureConfig,
        optimizer: &OptimizerConfig,
        corrections: &[f32],
    ) {
        let matrix = self.of(view, config).matrix;
        // The derivative of each entry with respect to the gain's logarithm is the entry.
        let entries = matrix.as_flattened().iter().zip(gradient.as_flattened());
        let by_log: f64 = entries.map(|(m, g)| f64::from(*m) * g).sum();
        let group = &mut self.groups[view.exposure_group as usize];
        let gradient = by_log as f32 * config.sigma + config.prior_weight * group.value;
        let correction = corrections[group.steps.min(corrections.len() - 1)];
        group.steps += 1;
        let change = update(
            &mut group.first,
            &mut group.second,
            gradient,
            correction,
            optimizer,
        );
        group.value -= config.rate * change;
    }
}

impl State for Group {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.value.visit(codec)?;
        self.first.visit(codec)?;
        self.second.visit(codec)?;
        self.steps.visit(codec)
    }
}

impl State for Exposures {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.groups.visit(codec)
    }
}
