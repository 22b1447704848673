//! Worlds: any number of environments with an agent each on one scene.
//!
//! [`World::reset`] begins episodes, [`World::step`] advances all that have not ended. Environments
//! that end stay as they are until they are reset, so that their final observation and camera pose
//! can be read. After an error nothing has changed. The results of an environment depend neither
//! on the others nor on the number of threads.

pub(crate) mod block;
pub(crate) mod columns;
pub(crate) mod config;
pub(crate) mod environment;
pub(crate) mod episode;
pub(crate) mod frames;
pub(crate) mod observation;
mod place;
mod prepare;
pub(crate) mod pursuit;
pub(crate) mod report;
pub(crate) mod result;
pub(crate) mod rows;
pub(crate) mod shared;
pub(crate) mod terrain;

use std::ops::ControlFlow;
use std::sync::Arc;

use cad_transforms::RigidTransform;

pub use block::block_code;
pub use config::{ObservationConfig, WorldConfig};
pub use observation::ObservationField;
pub use result::StepResult;

use crate::SimulationError;
use crate::agent::AgentState;
use crate::camera::{FrameRequest, NoiseKey};
#[cfg(test)]
use crate::episode::task::Task;
use crate::scene::SceneData;
use crate::support::SupportGrid;
use environment::EpisodeStart;
use episode::{Episode, Phase, Target};
use rows::{Environments, Rows};
use shared::Shared;

/// Environments with an agent each on one scene.
///
/// ```
/// use simulation::testing::SyntheticScene;
/// use simulation::{World, WorldConfig};
///
/// let scene = SyntheticScene::room()?.scene;
/// let mut config = WorldConfig::default();
/// config.environments = 4;
/// let mut world = World::new(scene, config)?;
/// world.reset(None, None)?;
/// // Speed and yaw rate of each of the four agents.
/// let result = world.step(&[0.5, 0.1, 0.5, -0.1, 1.0, 0.0, 0.0, 1.0])?;
/// assert_eq!(result.rewards.len(), 4);
/// let ended: Vec<bool> = (0..4).map(|environment| world.has_ended(environment)).collect();
/// world.reset(Some(&ended), None)?;
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Debug)]
pub struct World {
    pub(crate) shared: Shared,
    pub(crate) environments: Environments,
    pub(crate) result: StepResult,
    pub(crate) observations: Vec<f32>,
    /// First states of a reset before it succeeds.
    begins: Vec<Option<EpisodeStart>>,
}

impl World {
    /// A world on a scene. Starts no threads; they start at the first reset or step.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] with the name of a setting that is out of its range,
    /// [`SimulationError::Scene`] for a scene without maps.
    pub fn new(scene: Arc<SceneData>, config: WorldConfig) -> Result<Self, SimulationError> {
        let shared = Shared::new(scene, config)?;
        let count = shared.config.environments;
        let mut environments = Environments::new(count);
        for (index, episode) in environments.episode.iter_mut().enumerate() {
            *episode = Episode::new(shared.config.seed.wrapping_add(index as u64));
        }
        Ok(Self {
            environments,
            result: StepResult::new(count),
            observations: vec![0.0; count * shared.layout.len()],
            begins: vec![None; count],
            shared,
        })
    }

    /// Begins episodes in the environments of the mask, or in all. Of one with a seed they are
    /// counted from 0; without, the next episode of its seed begins. Seeds are one for each
    /// environment; those outside of the mask are ignored.
    ///
    /// # Errors
    /// [`SimulationError::Start`] if no start was found for one of them, or no goals,
    /// [`SimulationError::Setting`] for a mask or seeds of another length,
    /// [`SimulationError::Scene`] as [`Self::prepare`].
    pub fn reset(
        &mut self,
        mask: Option<&[bool]>,
        seeds: Option<&[Option<u64>]>,
    ) -> Result<(), SimulationError> {
        let count = self.shared.config.environments;
        for (name, len) in [
            ("mask", mask.map(<[_]>::len)),
            ("seeds", seeds.map(<[_]>::len)),
        ] {
            if let Some(len) = len.filter(|len| *len != count) {
                return Err(SimulationError::Setting {
                    name: name.to_owned(),
                    found: format!("{len} values"),
                    expected: format!("{count}, one per environment"),
                });
            }
        }
        self.shared.prepare(&|_, _| ControlFlow::Continue(()))?;
        let is_reset = |index: usize| mask.is_none_or(|mask| mask[index]);
        let (shared, episodes) = (&self.shared, &self.environments.episode);
        let begin = |(index, begin): (usize, &mut Option<EpisodeStart>)| {
            *begin = None;
            if is_reset(index) {
                let (seed, number) = next_episode(&episodes[index], seeds.and_then(|s| s[index]));
                *begin = Some(environment::begin(shared, seed, number)?);
            }
            Ok(())
        };
        begin_all(&mut self.begins, &begin)?;
        let begins = &self.begins;
        rows(
            shared,
            &mut self.environments,
            &mut self.result,
            &mut self.observations,
        )
        .for_each(&|index, row| {
            if let Some(begin) = &begins[index] {
                environment::reset(shared, row, begin);
            }
        });
        Ok(())
    }

    /// Makes what the first reset would make: goals of the task and, where the configuration needs
    /// it, predictions of the PSNR, which take a while. The callback gets the number of images that
    /// were judged and of all of a sector, from any thread, and may end it; what was made is lost.
    ///
    /// # Errors
    /// [`SimulationError::Start`] if no goals were found, [`SimulationError::Scene`] for files that
    /// changed since the scene was opened, [`SimulationError::State`] if the callback ended it.
    pub fn prepare(
        &mut self,
        progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
    ) -> Result<(), SimulationError> {
        self.shared.prepare(progress)
    }

    /// Predicted PSNR of views in each sector; none before the first reset or
    /// [`World::prepare`], and where no setting needs it.
    pub fn support(&self) -> &[SupportGrid] {
        &self.shared.support
    }

    /// Advances all environments that have not ended by one step. Actions are those of all
    /// environments in order, each of [`Drive::action_size`](crate::Drive::action_size) components
    /// of -1 to 1; what is beyond is clipped and counted. Actions of environments that have ended
    /// must be finite and are otherwise ignored.
    ///
    /// # Errors
    /// [`SimulationError::State`] before the first reset of an environment,
    /// [`SimulationError::Action`] for another number of components and for one that is not finite;
    /// no environment moved.
    pub fn step(&mut self, actions: &[f64]) -> Result<&StepResult, SimulationError> {
        let size = self.shared.config.drive.action_size();
        self.check_step(actions, size)?;
        let shared = &self.shared;
        rows(
            shared,
            &mut self.environments,
            &mut self.result,
            &mut self.observations,
        )
        .for_each(&|index, row| {
            let action = &actions[index * size..(index + 1) * size];
            environment::step(shared, row, action);
        });
        Ok(&self.result)
    }

    fn check_step(&self, actions: &[f64], size: usize) -> Result<(), SimulationError> {
        let count = self.shared.config.environments;
        if actions.len() != count * size {
            return Err(SimulationError::Action {
                environment: actions.len() / size.max(1),
                found: format!("{} components in all", actions.len()),
                expected: format!("{count} environments of {size} components"),
            });
        }
        if let Some(at) = actions.iter().position(|value| !value.is_finite()) {
            return Err(SimulationError::Action {
                environment: at / size,
                found: format!("{} as component {}", actions[at], at % size),
                expected: "finite numbers of -1 to 1".to_owned(),
            });
        }
        let is_new = |episode: &Episode| episode.phase == Phase::New;
        match self.environments.episode.iter().position(is_new) {
            None => Ok(()),
            Some(index) => Err(SimulationError::State(format!(
                "a step before the first reset of environment {index}"
            ))),
        }
    }

    /// Configuration.
    pub fn config(&self) -> &WorldConfig {
        &self.shared.config
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<SceneData> {
        &self.shared.scene
    }

    /// Number of environments.
    pub fn environments(&self) -> usize {
        self.shared.config.environments
    }

    /// Agents, one per environment.
    pub fn states(&self) -> &[AgentState] {
        &self.environments.state
    }

    /// Results of the last step or reset.
    pub fn result(&self) -> &StepResult {
        &self.result
    }

    /// Observation vectors of all environments, one after the other.
    pub fn observations(&self) -> &[f32] {
        &self.observations
    }

    /// Named parts of an observation vector.
    pub fn observation_fields(&self) -> &[ObservationField] {
        &self.shared.layout.fields
    }

    /// Least and greatest value of each element of an observation vector.
    pub fn observation_bounds(&self) -> (&[f32], &[f32]) {
        (&self.shared.layout.low, &self.shared.layout.high)
    }

    /// Whether an environment has ended and waits for a reset, or had none yet.
    ///
    /// # Panics
    /// Without such an environment.
    pub fn has_ended(&self, environment: usize) -> bool {
        !self.environments.is_running(environment)
    }

    /// Sector of the camera of an environment, and its pose in it.
    ///
    /// # Panics
    /// Without such an environment.
    pub fn world_from_camera(&self, environment: usize) -> (usize, RigidTransform) {
        let kept = &self.environments;
        let world_from_body = kept.state[environment].world_from_body();
        let pose = world_from_body * kept.body_from_camera[environment];
        (kept.sector[environment] as usize, pose)
    }

    /// Goal of an environment in the frame of the agent's sector, m; `None` before the first reset
    /// and for tasks without goals.
    ///
    /// # Panics
    /// Without such an environment.
    pub fn goal_m(&self, environment: usize) -> Option<[f64; 3]> {
        match self.environments.episode[environment].target {
            Target::Goal { position_m, .. } => Some(position_m),
            Target::Path { .. } | Target::Command => None,
        }
    }

    /// Seed of an environment and number of its episode: the key of its random numbers.
    ///
    /// # Panics
    /// Without such an environment.
    pub fn random_key(&self, environment: usize) -> (u64, u64) {
        let episode = &self.environments.episode[environment];
        (episode.seed, episode.number)
    }

    /// The frame that the agent of an environment sees: with a [`WorldConfig::timing`] the newest
    /// that was delivered, of age [`StepResult::frame_age_s`], otherwise that of now, with the
    /// motion of the agent in its last step.
    ///
    /// # Panics
    /// Without such an environment.
    pub fn frame_request(&self, environment: usize) -> FrameRequest {
        if let Some(queue) = &self.environments.queue[environment] {
            return queue.request(0);
        }
        let (sector, world_from_camera) = self.world_from_camera(environment);
        let kept = &self.environments;
        let episode = &kept.episode[environment];
        let [velocity_m_s, rate_rad_s] = frames::motion(
            &kept.state[environment],
            &kept.body_from_camera[environment],
            self.shared.config.drive,
        );
        FrameRequest {
            velocity_m_s,
            rate_rad_s,
            noise: NoiseKey {
                seed: episode.seed,
                episode: episode.number,
                frame: episode.steps,
                camera: 0,
            },
            ..FrameRequest::new(sector, world_from_camera)
        }
    }

    pub(crate) fn check_index(&self, environment: usize) -> Result<(), SimulationError> {
        let count = self.shared.config.environments;
        if environment < count {
            return Ok(());
        }
        Err(SimulationError::Setting {
            name: "environment".to_owned(),
            found: environment.to_string(),
            expected: format!("less than {count}"),
        })
    }
}

fn rows<'a>(
    shared: &Shared,
    environments: &'a mut Environments,
    result: &'a mut StepResult,
    observations: &'a mut [f32],
) -> Rows<'a> {
    Rows::new(environments, result, observations, shared.layout.len())
}

/// Seed and number of the episode that a reset begins.
fn next_episode(episode: &Episode, seed: Option<u64>) -> (u64, u64) {
    match (seed, episode.phase) {
        (Some(seed), _) => (seed, 0),
        (None, Phase::New) => (episode.seed, 0),
        (None, _) => (episode.seed, episode.number + 1),
    }
}

/// First states of all environments; of several errors that of the first.
fn begin_all(
    begins: &mut [Option<EpisodeStart>],
    begin: &(impl Fn((usize, &mut Option<EpisodeStart>)) -> Result<(), SimulationError> + Sync),
) -> Result<(), SimulationError> {
    fn of(
        first: usize,
        begins: &mut [Option<EpisodeStart>],
        begin: &(impl Fn((usize, &mut Option<EpisodeStart>)) -> Result<(), SimulationError> + Sync),
    ) -> Result<(), SimulationError> {
        /// Resets take longer than steps.
        const CHUNK: usize = 4;
        if begins.len() <= CHUNK {
            let numbers = first..;
            return numbers.zip(begins).try_for_each(begin);
        }
        let middle = begins.len() / 2;
        let (a, b) = begins.split_at_mut(middle);
        let (a, b) = rayon::join(|| of(first, a, begin), || of(first + middle, b, begin));
        a.and(b)
    }
    of(0, begins, begin)
}

#[cfg(test)]
pub(crate) mod tests;
