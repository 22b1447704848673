//! Steps of a training on a device in place of the processor.
//!
//! The device takes a copy of the state, runs some steps without the processor, and returns the
//! state after them; the trainer is unchanged if it fails. The number of Gaussians and the degree
//! change between such runs, on the processor. Poses and exposures are not refined on a device.

#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::ops::Range;

use super::Trainer;
use crate::camera::Camera;
use crate::error::SplatError;
use crate::render::Renderer;
use crate::scene::{Exposure, Scene};
use crate::train::config::TrainConfig;
use crate::train::grow::GrowthStatistics;
use crate::train::schedule;
use crate::train::view::TrainingView;

/// Most steps of one run on a device.
const AT_ONCE: usize = 100;

/// What steps of a training change.
#[derive(Clone, Debug)]
pub struct TrainingState {
    /// The scene.
    pub scene: Scene,
    /// First moments, in the order of the scene's planes.
    pub first: Vec<Vec<f32>>,
    /// Second moments.
    pub second: Vec<Vec<f32>>,
    /// Steps of each Gaussian: of the harmonics above degree 0, of all others.
    pub steps: [Vec<u16>; 2],
    /// Both moments of the background's colors.
    pub background: Vec<[[f32; 2]; 3]>,
    /// What was gathered of each Gaussian since its number changed last.
    pub observed: Vec<GrowthStatistics>,
}

/// One step of a training.
#[derive(Clone, Debug)]
pub struct TrainingStep<'a> {
    /// Number of the step, from 0.
    pub step: usize,
    /// The image, reduced as the step has it.
    pub view: Cow<'a, TrainingView>,
    /// Factor by which it is reduced.
    pub reduction: u32,
    /// Its camera.
    pub camera: Camera,
    /// Its exposure.
    pub exposure: Exposure,
    /// Learning rate of positions: the same for all Gaussians, m.
    pub position_rate_m: f32,
    /// Added to it, as a share of the largest scale of a Gaussian.
    pub position_rate_by_size: f32,
    /// Learning rate of the harmonics above degree 0; 0 where they are not trained.
    pub harmonics_rate: f32,
    /// Weight of the depth's loss.
    pub depth_weight: f32,
}

/// Steps that a device runs.
#[derive(Clone, Debug)]
pub struct TrainingRun<'a> {
    trainer: &'a Trainer,
    /// The steps.
    pub steps: Range<usize>,
}

/// Runs steps in place of the processor.
pub trait TrainingDevice {
    /// The state after the steps of a run.
    ///
    /// # Errors
    /// [`SplatError::Diverged`] as [`Trainer::step`]; [`SplatError::Device`] if the device fails.
    fn run(
        &mut self,
        run: &TrainingRun<'_>,
        state: TrainingState,
    ) -> Result<TrainingState, SplatError>;
}

impl<'a> TrainingRun<'a> {
    /// The configuration of the training.
    pub fn config(&self) -> &TrainConfig {
        &self.trainer.config
    }

    /// The renderer whose images the device computes.
    pub fn renderer(&self) -> &Renderer {
        &self.trainer.renderer
    }

    /// Factors from the bias of both moments, by number of steps from 1 on.
    pub fn corrections(&self) -> &[f32] {
        &self.trainer.corrections
    }

    /// What a step trains on.
    ///
    /// # Errors
    /// [`SplatError::Camera`] if the camera of a reduced image is invalid.
    pub fn step(&self, step: usize) -> Result<TrainingStep<'a>, SplatError> {
        let Trainer { config, views, .. } = self.trainer;
        let index = schedule::view(self.trainer.seed, step, views.len());
        let reduction = schedule::reduction(config, step);
        let view = match reduction {
            1 => Cow::Borrowed(&views[index]),
            _ => Cow::Owned(views[index].reduced(reduction)?),
        };
        let trains_harmonics = step.is_multiple_of(config.harmonics_interval.max(1));
        Ok(TrainingStep {
            step,
            reduction,
            camera: self.trainer.poses.of(index, &view.camera, &config.poses)?,
            exposure: self.trainer.exposures.of(&view, &config.exposure),
            position_rate_m: schedule::position_rate(config, step) * self.trainer.radius_m,
            position_rate_by_size: schedule::position_rate_by_size(config, step),
            harmonics_rate: match trains_harmonics {
                true => config.optimizer.harmonics,
                false => 0.0,
            },
            depth_weight: schedule::depth_weight(config, step),
            view,
        })
    }
}

impl Trainer {
    /// Runs steps on a device: at least one, at most `most`, and no more than until the number of
    /// Gaussians or the degree changes. Returns how many.
    ///
    /// # Errors
    /// [`SplatError::Setting`] if the configuration refines poses or exposures; those of the
    /// device. The trainer is unchanged then.
    pub fn run_on(
        &mut self,
        device: &mut dyn TrainingDevice,
        most: usize,
    ) -> Result<usize, SplatError> {
        let (poses, exposures) = (self.config.poses.refine, self.config.exposure.refine);
        for (name, refines) in [("poses.refine", poses), ("exposure.refine", exposures)] {
            if refines {
                return Err(SplatError::Setting {
                    name,
                    found: 1.0,
                    expected: "0 on a device",
                });
            }
        }
        self.raise_degree(self.steps)?;
        let count = self.steps_at_once(most);
        let run = TrainingRun {
            trainer: self,
            steps: self.steps..self.steps + count,
        };
        let state = device.run(&run, self.state())?;
        self.scene = state.scene;
        (self.adam.first, self.adam.second) = (state.first, state.second);
        self.adam.steps = state.steps;
        self.background = state.background;
        self.growth.observed = state.observed;
        self.finish_steps(count);
        Ok(count)
    }

    fn state(&self) -> TrainingState {
        TrainingState {
            scene: self.scene.clone(),
            first: self.adam.first.clone(),
            second: self.adam.second.clone(),
            steps: self.adam.steps.clone(),
            background: self.background.clone(),
            observed: self.growth.observed.clone(),
        }
    }

    /// Steps until something changes that only the processor changes.
    fn steps_at_once(&self, most: usize) -> usize {
        let config = &self.config;
        let degree = schedule::degree(config, self.steps);
        let ends = |step: usize| {
            step.is_multiple_of(AT_ONCE)
                || step >= config.steps
                || schedule::is_growth_round(config, step)
                || schedule::is_growth_round(config, step + 1)
                || schedule::is_reset(config, step)
                || schedule::degree(config, step) != degree
        };
        let last = self.steps + most.max(1);
        let end = (self.steps + 1..last).find(|step| ends(*step));
        end.unwrap_or(last) - self.steps
    }
}
