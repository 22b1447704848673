//! When environments that ended are reset, as Gymnasium's vector environments name it.

use pyo3::PyResult;
use simulation::{FrameRequest, REWARD_TERMS, SimulationError, StepResult, World};

use crate::error::SettingError;

/// When an environment that ended begins its next episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Autoreset {
    /// In the next step, which ignores its action.
    NextStep,
    /// In the step of the end.
    SameStep,
    /// When the caller resets it.
    Disabled,
}

impl Autoreset {
    pub(crate) fn from_code(code: u8) -> PyResult<Self> {
        match code {
            0 => Ok(Self::NextStep),
            1 => Ok(Self::SameStep),
            2 => Ok(Self::Disabled),
            _ => Err(SettingError::new_err(format!(
                "autoreset: found {code}, expected 0, 1 or 2"
            ))),
        }
    }
}

/// A world with the results of its last step, which an autoreset does not overwrite.
pub(crate) struct Batch {
    pub(crate) world: World,
    pub(crate) step: Step,
    pub(crate) ended: Option<EpisodeEnds>,
    /// Environments that had ended before the last step.
    had_ended: Vec<bool>,
    /// Whether there was a reset; the world refuses steps before it.
    has_begun: bool,
    /// Whether environments moved in a step that then failed, so that nobody has its results.
    is_incomplete: bool,
}

/// Results of the last step.
#[derive(Default)]
pub(crate) struct Step {
    pub(crate) rewards: Vec<f64>,
    pub(crate) reward_terms: Vec<[f64; REWARD_TERMS.len()]>,
    pub(crate) terminated: Vec<bool>,
    pub(crate) truncated: Vec<bool>,
}

/// Environments before their reset in the step of the end.
pub(crate) struct EpisodeEnds {
    pub(crate) mask: Vec<bool>,
    /// Observations of all environments.
    pub(crate) observations: Vec<f32>,
    pub(crate) result: StepResult,
    /// The frames that those that ended saw last.
    pub(crate) frames: Vec<FrameRequest>,
}

impl Batch {
    pub(crate) fn new(world: World) -> Self {
        let count = world.environments();
        Self {
            world,
            step: Step {
                rewards: vec![0.0; count],
                reward_terms: vec![[0.0; REWARD_TERMS.len()]; count],
                terminated: vec![false; count],
                truncated: vec![false; count],
            },
            ended: None,
            had_ended: vec![false; count],
            has_begun: false,
            is_incomplete: false,
        }
    }

    /// Begins episodes.
    pub(crate) fn reset(
        &mut self,
        mask: Option<&[bool]>,
        seeds: Option<&[Option<u64>]>,
    ) -> Result<(), SimulationError> {
        self.world.reset(mask, seeds)?;
        self.has_begun = true;
        self.is_incomplete &= mask.is_some_and(|mask| mask.contains(&false));
        Ok(())
    }

    /// Environments that had ended before the last step, which ignored their actions.
    pub(crate) fn had_ended(&self) -> &[bool] {
        &self.had_ended
    }

    pub(crate) fn observation_len(&self) -> usize {
        self.world.observation_bounds().0.len()
    }

    /// Advances all environments.
    ///
    /// If an autoreset finds no start, the environments have moved and those that ended wait. The
    /// results of that step are lost and a second try would draw the same start, so that steps are
    /// refused until all environments are reset.
    pub(crate) fn step(
        &mut self,
        actions: &[f64],
        autoreset: Autoreset,
    ) -> Result<(), SimulationError> {
        if self.is_incomplete {
            return Err(SimulationError::State(
                "the last step found no start for an environment that ended, and its results are \
                 lost: reset all environments, with other seeds"
                    .to_owned(),
            ));
        }
        self.ended = None;
        for (index, had_ended) in self.had_ended.iter_mut().enumerate() {
            *had_ended = self.world.has_ended(index);
        }
        let first_ended = match self.has_begun {
            true => self.had_ended.iter().position(|ended| *ended),
            false => None,
        };
        if let (Autoreset::Disabled, Some(index)) = (autoreset, first_ended) {
            return Err(SimulationError::State(format!(
                "environment {index} has ended and was not reset"
            )));
        }
        let result = self.world.step(actions)?;
        self.step.rewards.copy_from_slice(&result.rewards);
        self.step.reward_terms.copy_from_slice(&result.reward_terms);
        self.step.terminated.copy_from_slice(&result.terminated);
        self.step.truncated.copy_from_slice(&result.truncated);
        let reset = match autoreset {
            Autoreset::NextStep if first_ended.is_some() => {
                self.world.reset(Some(&self.had_ended), None)
            }
            Autoreset::SameStep => self.reset_in_same_step(),
            Autoreset::NextStep | Autoreset::Disabled => Ok(()),
        };
        self.is_incomplete = reset.is_err();
        reset
    }

    /// Begins episodes where one ended in this step, whose results are kept, or before it: a
    /// snapshot of an end was restored.
    fn reset_in_same_step(&mut self) -> Result<(), SimulationError> {
        let has_ended: Vec<bool> = (0..self.world.environments())
            .map(|index| self.world.has_ended(index))
            .collect();
        if !has_ended.contains(&true) {
            return Ok(());
        }
        let Step {
            terminated,
            truncated,
            ..
        } = &self.step;
        let flags = terminated.iter().zip(truncated);
        let mask: Vec<bool> = flags.map(|(end, cut)| *end || *cut).collect();
        let ended = mask.contains(&true).then(|| EpisodeEnds {
            observations: self.world.observations().to_vec(),
            result: self.world.result().clone(),
            frames: (0..mask.len())
                .filter(|index| mask[*index])
                .map(|index| self.world.frame_request(index))
                .collect(),
            mask,
        });
        self.world.reset(Some(&has_ended), None)?;
        self.ended = ended;
        Ok(())
    }

    /// An environment was restored: it has no reward and no flag.
    pub(crate) fn mark_restored(&mut self, environment: usize) {
        self.has_begun = true;
        self.step.rewards[environment] = 0.0;
        self.step.reward_terms[environment] = [0.0; REWARD_TERMS.len()];
        self.step.terminated[environment] = false;
        self.step.truncated[environment] = false;
    }
}
