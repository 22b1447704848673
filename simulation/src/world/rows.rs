//! Environments of a world, divided among threads.

use cad_transforms::RigidTransform;

use super::columns::columns;
use super::episode::{Episode, Phase};
use super::result::{ResultRows, StepResult};
use crate::agent::AgentState;
use crate::camera::FrameQueue;
use crate::episode::{EndReason, REWARD_TERMS};

columns! {
    /// What is kept of each environment.
    #[derive(Clone, Debug)]
    pub(crate) struct Environments, EnvironmentRows {
        /// Sector of the agent.
        sector: u32 = 0,
        /// The agent.
        state: AgentState = AgentState::default(),
        /// Its episode.
        episode: Episode = Episode::new(0),
        /// The camera on its mount.
        body_from_camera: RigidTransform = RigidTransform::identity(),
        /// Its frames. None before the first reset, and where each step has the frame of its end.
        queue: Option<Box<FrameQueue>> = None,
    }
}

/// Neighboring environments: kept, reported and observed.
pub(crate) struct Rows<'a> {
    pub(crate) first: usize,
    kept: EnvironmentRows<'a>,
    result: ResultRows<'a>,
    observations: &'a mut [f32],
    observation_len: usize,
}

/// One environment.
pub(crate) struct Row<'a> {
    pub(crate) sector: &'a mut u32,
    pub(crate) state: &'a mut AgentState,
    pub(crate) episode: &'a mut Episode,
    pub(crate) body_from_camera: &'a mut RigidTransform,
    pub(crate) queue: &'a mut Option<Box<FrameQueue>>,
    pub(crate) observation: &'a mut [f32],
    pub(crate) rewards: &'a mut f64,
    pub(crate) reward_terms: &'a mut [f64; REWARD_TERMS.len()],
    pub(crate) terminated: &'a mut bool,
    pub(crate) truncated: &'a mut bool,
    pub(crate) end_reasons: &'a mut i8,
    pub(crate) blocked: &'a mut i8,
    pub(crate) deviation_m: &'a mut f32,
    pub(crate) deviation_rad: &'a mut f32,
    pub(crate) support_db: &'a mut f32,
    pub(crate) collisions: &'a mut u32,
    pub(crate) clipped: &'a mut u32,
    pub(crate) steps: &'a mut u32,
    pub(crate) path_length_m: &'a mut f32,
    pub(crate) remaining_m: &'a mut f32,
    pub(crate) spl: &'a mut f32,
    pub(crate) soft_spl: &'a mut f32,
    pub(crate) frame_age_s: &'a mut f32,
}

/// Environments that one thread advances before it looks for others: about 0.1 ms of work.
const CHUNK: usize = 32;

impl<'a> Rows<'a> {
    pub(crate) fn new(
        kept: &'a mut Environments,
        result: &'a mut StepResult,
        observations: &'a mut [f32],
        observation_len: usize,
    ) -> Self {
        Self {
            first: 0,
            kept: kept.slices(),
            result: result.slices(),
            observations,
            observation_len,
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.kept.state.len()
    }

    fn split_at(self, middle: usize) -> (Self, Self) {
        let (kept, other_kept) = self.kept.split_at(middle);
        let (result, other_result) = self.result.split_at(middle);
        let len = self.observation_len;
        let (observations, other_observations) = self.observations.split_at_mut(middle * len);
        let rows = |first, kept, result, observations| Self {
            first,
            kept,
            result,
            observations,
            observation_len: len,
        };
        (
            rows(self.first, kept, result, observations),
            rows(
                self.first + middle,
                other_kept,
                other_result,
                other_observations,
            ),
        )
    }

    /// The environment at a position in these rows.
    pub(crate) fn row(&mut self, at: usize) -> Row<'_> {
        let (kept, result, len) = (&mut self.kept, &mut self.result, self.observation_len);
        Row {
            sector: &mut kept.sector[at],
            state: &mut kept.state[at],
            episode: &mut kept.episode[at],
            body_from_camera: &mut kept.body_from_camera[at],
            queue: &mut kept.queue[at],
            observation: &mut self.observations[at * len..(at + 1) * len],
            rewards: &mut result.rewards[at],
            reward_terms: &mut result.reward_terms[at],
            terminated: &mut result.terminated[at],
            truncated: &mut result.truncated[at],
            end_reasons: &mut result.end_reasons[at],
            blocked: &mut result.blocked[at],
            deviation_m: &mut result.deviation_m[at],
            deviation_rad: &mut result.deviation_rad[at],
            support_db: &mut result.support_db[at],
            collisions: &mut result.collisions[at],
            clipped: &mut result.clipped[at],
            steps: &mut result.steps[at],
            path_length_m: &mut result.path_length_m[at],
            remaining_m: &mut result.remaining_m[at],
            spl: &mut result.spl[at],
            soft_spl: &mut result.soft_spl[at],
            frame_age_s: &mut result.frame_age_s[at],
        }
    }

    /// Calls `work` with the index of each environment and its row. Environments do not depend on
    /// each other, so the number of threads changes nothing.
    pub(crate) fn for_each(mut self, work: &(impl Fn(usize, &mut Row<'_>) + Sync)) {
        let len = self.len();
        if len > CHUNK {
            let (a, b) = self.split_at(len / 2);
            rayon::join(|| a.for_each(work), || b.for_each(work));
            return;
        }
        for at in 0..len {
            let index = self.first + at;
            work(index, &mut self.row(at));
        }
    }
}

impl Row<'_> {
    /// No reward and no flag.
    pub(crate) fn clear_step(&mut self) {
        *self.rewards = 0.0;
        *self.reward_terms = [0.0; REWARD_TERMS.len()];
        *self.terminated = false;
        *self.truncated = false;
        *self.end_reasons = EndReason::None as i8;
        *self.blocked = 0;
    }
}

impl Environments {
    pub(crate) fn is_running(&self, environment: usize) -> bool {
        self.episode[environment].phase == Phase::Running
    }
}
