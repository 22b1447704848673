//! Adam (Kingma and Ba, ICLR 2015) on the Gaussians that a step shows.
//!
//! A Gaussian that a step does not show keeps its moments. The correction of their bias therefore
//! counts the steps of each Gaussian.

use rayon::prelude::*;

use super::codec::{Codec, State};
use super::config::OptimizerConfig;
use crate::error::SplatError;
use crate::render::Gradients;
use crate::scene::{Plane, Splats};

/// Steps after which the moments have no bias.
const MAX_STEPS: usize = 8192;

/// Moments of all Gaussians.
#[derive(Clone, Debug)]
pub(super) struct Adam {
    pub(super) first: Vec<Vec<f32>>,
    pub(super) second: Vec<Vec<f32>>,
    /// Steps of each Gaussian: of the harmonics above degree 0, of all others.
    pub(super) steps: [Vec<u16>; 2],
    /// Factor on the first step and so on, from the bias of both moments.
    corrections: Vec<f32>,
}

/// Learning rates of a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rates {
    /// Of positions: the same for all Gaussians, m, and as a share of their largest scale.
    pub(super) position_m: f32,
    pub(super) position_by_size: f32,
    /// Of the harmonics above degree 0; 0 where they are not trained.
    pub(super) harmonics: f32,
}

impl Rates {
    /// Of the position of each of some Gaussians, m.
    fn positions(&self, splats: &Splats, indices: &[u32]) -> Vec<f32> {
        let rate = |index: &u32| {
            let size_m = splats.largest_scale_m(*index as usize);
            self.position_by_size.mul_add(size_m, self.position_m)
        };
        indices.iter().map(rate).collect()
    }

    fn of(&self, plane: usize, config: &OptimizerConfig) -> f32 {
        const COLOR_END: usize = Plane::HARMONICS + 3;
        match plane {
            0..Plane::SCALE => self.position_m,
            Plane::SCALE..Plane::ROTATION => config.scale,
            Plane::ROTATION..Plane::OPACITY => config.rotation,
            Plane::OPACITY => config.opacity,
            Plane::HARMONICS..COLOR_END => config.color,
            _ => self.harmonics,
        }
    }
}

/// Factors from the bias of both moments, by number of steps.
pub(super) fn corrections(config: &OptimizerConfig) -> Vec<f32> {
    let (mut a, mut b) = (1.0_f64, 1.0_f64);
    let step = |_| {
        a *= f64::from(config.beta1);
        b *= f64::from(config.beta2);
        ((1.0 - b).sqrt() / (1.0 - a)) as f32
    };
    (0..MAX_STEPS).map(step).collect()
}

impl Adam {
    pub(super) fn new(splats: &Splats, config: &OptimizerConfig) -> Self {
        let zeros = vec![vec![0.0; splats.len()]; splats.planes().len()];
        let steps = vec![0; splats.len()];
        Self {
            first: zeros.clone(),
            second: zeros,
            steps: [steps.clone(), steps],
            corrections: corrections(config),
        }
    }

    /// Follows a change of the degree.
    pub(super) fn set_planes(&mut self, splats: &Splats) {
        for moments in [&mut self.first, &mut self.second] {
            moments.resize(splats.planes().len(), vec![0.0; splats.len()]);
        }
    }

    /// Follows a selection of Gaussians.
    pub(super) fn select(&mut self, indices: &[u32]) {
        for plane in self.first.iter_mut().chain(&mut self.second) {
            *plane = indices.iter().map(|i| plane[*i as usize]).collect();
        }
        for steps in &mut self.steps {
            *steps = indices.iter().map(|i| steps[*i as usize]).collect();
        }
    }

    /// Forgets the moments of a Gaussian.
    pub(super) fn reset(&mut self, index: usize) {
        for plane in self.first.iter_mut().chain(&mut self.second) {
            plane[index] = 0.0;
        }
        for steps in &mut self.steps {
            steps[index] = 0;
        }
    }

    /// Forgets the moments of a plane.
    pub(super) fn reset_plane(&mut self, plane: usize) {
        self.first[plane].fill(0.0);
        self.second[plane].fill(0.0);
    }

    /// Whether there are moments and steps of all parameters.
    pub(super) fn is_of(&self, splats: &Splats) -> bool {
        let count = splats.len();
        let fits = |moments: &Vec<Vec<f32>>| {
            moments.len() == splats.planes().len() && moments.iter().all(|m| m.len() == count)
        };
        let steps = self.steps.iter().all(|steps| {
            steps.len() == count && steps.iter().all(|n| usize::from(*n) <= MAX_STEPS)
        });
        fits(&self.first) && fits(&self.second) && steps
    }

    pub(super) fn step(
        &mut self,
        splats: &mut Splats,
        gradients: &Gradients,
        rates: &Rates,
        config: &OptimizerConfig,
    ) {
        let trains_harmonics = rates.harmonics > 0.0;
        for (of, steps) in self.steps.iter_mut().enumerate() {
            if of == 1 || trains_harmonics {
                for index in &gradients.indices {
                    let steps = &mut steps[*index as usize];
                    *steps = steps.saturating_add(1).min(MAX_STEPS as u16);
                }
            }
        }
        let position_rates = rates.positions(splats, &gradients.indices);
        let (steps, corrections) = (&self.steps, &self.corrections);
        splats
            .planes_mut()
            .par_iter_mut()
            .zip(&mut self.first)
            .zip(&mut self.second)
            .zip(&gradients.planes)
            .enumerate()
            .for_each(|(plane, (((values, first), second), gradient))| {
                let is_position = plane < Plane::SCALE;
                let rate = rates.of(plane, config);
                if rate == 0.0 && !is_position {
                    return;
                }
                let steps = &steps[usize::from(plane < Plane::HARMONICS + 3)];
                for (k, (index, g)) in gradients.indices.iter().zip(gradient).enumerate() {
                    let i = *index as usize;
                    let rate = if is_position { position_rates[k] } else { rate };
                    let correction = corrections[usize::from(steps[i]) - 1];
                    let change = update(&mut first[i], &mut second[i], *g, correction, config);
                    let value = values[i] - rate * change;
                    // A rate without measure must not break the contract of the scene.
                    if value.is_finite() {
                        values[i] = value;
                    }
                }
            });
    }
}

/// The corrections follow from the configuration.
impl State for Adam {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.first.visit(codec)?;
        self.second.visit(codec)?;
        self.steps.visit(codec)
    }
}

/// Updates the moments of a parameter; returns the change per unit of learning rate, negated.
pub(super) fn update(
    first: &mut f32,
    second: &mut f32,
    gradient: f32,
    correction: f32,
    config: &OptimizerConfig,
) -> f32 {
    *first += (1.0 - config.beta1) * (gradient - *first);
    *second += (1.0 - config.beta2) * (gradient * gradient - *second);
    correction * *first / (second.sqrt() + config.epsilon)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_have_the_length_of_the_rate_from_the_first_one_on() {
        let config = OptimizerConfig::default();
        let corrections = corrections(&config);
        let (mut first, mut second) = (0.0, 0.0);
        for correction in &corrections[..2000] {
            let step = update(&mut first, &mut second, 3.0, *correction, &config);
            assert!((step - 1.0).abs() < 1e-3, "{step}");
        }
        // A minimum that is reached, from far away.
        let (mut x, mut first, mut second) = (5.0_f32, 0.0, 0.0);
        for correction in &corrections[..2000] {
            x -= 0.02
                * update(
                    &mut first,
                    &mut second,
                    2.0 * (x - 1.0),
                    *correction,
                    &config,
                );
        }
        assert!((x - 1.0).abs() < 0.02, "{x}");
    }
}
