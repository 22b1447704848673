//! Configuration of a world.

use cad_transforms::RigidTransform;
use estimator_config::config;
use serde::{Deserialize, Serialize};

use crate::agent::{AgentConfig, Drive};
use crate::camera::{CameraConfig, TimingConfig};
use crate::episode::{EndConfig, RandomizationConfig, RewardConfig, StartConfig, TaskConfig};
use crate::error::{SimulationError, check_range};
use crate::support::config::SupportConfig;

/// Everything that determines a world besides its scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldConfig {
    /// Number of environments.
    pub environments: usize,
    /// Seed of the first environment; environment `i` has the `i`-th one after it.
    pub seed: u64,
    /// Duration of a step, s.
    pub dt_s: f64,
    /// How actions move the agent.
    pub drive: Drive,
    /// The agent's body and limits.
    pub agent: AgentConfig,
    /// The camera on the body. `None` is at eye height above the agent, level, facing forward.
    pub body_from_camera: Option<RigidTransform>,
    /// When the camera captures, and when its frames are delivered. By default each step has the
    /// frame of its end.
    pub timing: TimingConfig,
    /// How the PSNR of views is predicted. `None` predicts it only where a `min_support_db` needs
    /// it.
    pub support: Option<SupportConfig>,
    /// Where episodes start.
    pub start: StartConfig,
    /// When they end.
    pub end: EndConfig,
    /// What they are for.
    pub task: TaskConfig,
    /// What they are worth.
    pub reward: RewardConfig,
    /// What differs between them.
    pub randomization: RandomizationConfig,
    /// What an agent observes.
    pub observation: ObservationConfig,
}

config! {
    /// Observation vector besides goal, velocity and attitude.
    pub struct ObservationConfig {
        /// Number of columns of the scan of heights, to the sides; 0 for no scan.
        pub scan_columns: usize = 3,
        /// Number of its rows, ahead.
        pub scan_rows: usize = 4,
        /// Distance between its points, m. The first row is one spacing ahead of the agent.
        pub scan_spacing_m: f64 = 0.25,
        /// Heights above and below the agent at which the scan is cut, m. Unknown ground is
        /// reported as this far below: it is not free.
        pub max_scan_m: f64 = 0.5,
        /// Number of rays to obstacles, edges and unknown ground; the first looks ahead, the
        /// others follow counterclockwise.
        pub rays: usize = 16,
        /// Length of the rays, m.
        pub max_ray_m: f64 = 3.0,
    }
}

/// Environments at most.
const MAX_ENVIRONMENTS: usize = 1 << 20;

impl Default for WorldConfig {
    fn default() -> Self {
        Self {
            environments: 1,
            seed: 0,
            dt_s: 0.1,
            drive: Drive::Differential,
            agent: AgentConfig::default(),
            body_from_camera: None,
            timing: TimingConfig::default(),
            support: None,
            start: StartConfig::default(),
            end: EndConfig::default(),
            task: TaskConfig::default(),
            reward: RewardConfig::default(),
            randomization: RandomizationConfig::default(),
            observation: ObservationConfig::default(),
        }
    }
}

impl WorldConfig {
    /// Takes mount and timing from a camera.
    pub fn set_camera(&mut self, camera: &CameraConfig) {
        self.body_from_camera = Some(camera.body_from_camera);
        self.timing = camera.timing;
    }

    /// # Errors
    /// [`SimulationError::Setting`] with the name of the first setting out of its range.
    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        let count = |name, value: usize, least: usize, most: usize| {
            let expected = format!("{least} to {most}");
            check_range(name, value as f64, [least as f64, most as f64], &expected)
        };
        count("environments", self.environments, 1, MAX_ENVIRONMENTS)?;
        check_range("dt_s", self.dt_s, [1e-4, 10.0], "0.0001 to 10 s")?;
        self.timing.check_steps(self.dt_s)?;
        let observation = &self.observation;
        count("observation.scan_columns", observation.scan_columns, 0, 64)?;
        count("observation.scan_rows", observation.scan_rows, 0, 64)?;
        count("observation.rays", observation.rays, 0, 360)?;
        for (name, value) in [
            ("observation.scan_spacing_m", observation.scan_spacing_m),
            ("observation.max_scan_m", observation.max_scan_m),
            ("observation.max_ray_m", observation.max_ray_m),
        ] {
            check_range(name, value, [1e-3, 100.0], "0.001 to 100 m")?;
        }
        if let Some(support) = &self.support {
            support.check()?;
        }
        self.start.check()?;
        self.end.check()?;
        self.task.check()?;
        self.reward.check()?;
        self.randomization.check()
    }

    /// The setting that needs a prediction of the PSNR, its value, and how that is made; `None`
    /// where nothing does.
    pub(crate) fn predicts_support(&self) -> Option<(&'static str, String, SupportConfig)> {
        let thresholds = [
            ("end.min_support_db", self.end.min_support_db),
            ("start.min_support_db", self.start.min_support_db),
        ];
        let config = self.support.unwrap_or_default();
        let used = thresholds.into_iter().find(|(_, value)| *value > 0.0);
        match used {
            Some((name, value)) => Some((name, value.to_string(), config)),
            None => self
                .support
                .map(|config| ("support", "some".to_owned(), config)),
        }
    }

    /// The camera without errors of its mount.
    pub(crate) fn nominal_mount(&self) -> RigidTransform {
        self.body_from_camera.unwrap_or_else(|| {
            let up = [0.0, 0.0, self.agent.eye_height_m];
            let body_from_eye = RigidTransform::from_translation_m(up);
            body_from_eye.unwrap_or_else(|_| RigidTransform::identity())
                * RigidTransform::body_from_optical()
        })
    }

    /// Steps of an episode at most.
    pub(crate) fn max_steps(&self) -> u64 {
        // A limit that is a multiple of the step is not one step more by rounding.
        libm::ceil(self.end.time_limit_s / self.dt_s - 1e-6).max(1.0) as u64
    }

    /// Hash of everything but the number of environments and the seed: environments of worlds
    /// with equal ones can be exchanged.
    pub(crate) fn hash(&self) -> [u8; 32] {
        let common = Self {
            environments: 0,
            seed: 0,
            ..self.clone()
        };
        // A configuration that passed its checks has no value that JSON cannot hold.
        let text = serde_json::to_vec(&common).unwrap_or_default();
        *blake3::hash(&text).as_bytes()
    }
}
