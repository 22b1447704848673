//! Agents that are put somewhere from outside: by physics, or where the recorded wearer was.

use super::{World, report, rows};
use crate::SimulationError;
use crate::agent::AgentState;

impl World {
    /// Puts the agent of an environment somewhere, as physics outside of this world does before a
    /// step of [`Drive::Free`](crate::Drive::Free): the other drives put the agent on the ground
    /// in the next step. Frames with a [`WorldConfig::timing`](crate::WorldConfig::timing) follow
    /// in that step, too. A state that is not [valid](AgentState::is_valid) is not taken over: the
    /// next step ends the episode with
    /// [`EndReason::PhysicsFault`](crate::EndReason::PhysicsFault).
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for an environment, sector or level that does not exist and
    /// for a sector of another recording, [`SimulationError::State`] where no episode is running.
    pub fn place(
        &mut self,
        environment: usize,
        sector: usize,
        state: &AgentState,
    ) -> Result<(), SimulationError> {
        self.check_index(environment)?;
        let terrains = &self.shared.terrains;
        let frame = terrains[self.environments.sector[environment] as usize].frame;
        let terrain = terrains
            .get(sector)
            .filter(|terrain| terrain.frame == frame);
        let levels = terrain.map_or(0, |terrain| terrain.ground.levels().len());
        if state.level >= levels {
            return Err(SimulationError::Setting {
                name: "place".to_owned(),
                found: format!("level {} of sector {sector}", state.level),
                expected: "a level of a sector of the same recording".to_owned(),
            });
        }
        if !self.environments.is_running(environment) {
            return Err(SimulationError::State(format!(
                "environment {environment} has no running episode to place an agent in"
            )));
        }
        if !state.is_valid() {
            self.environments.episode[environment].is_faulty = true;
            return Ok(());
        }
        self.environments.state[environment] = *state;
        self.environments.sector[environment] = sector as u32;
        let shared = &self.shared;
        let mut rows = rows(
            shared,
            &mut self.environments,
            &mut self.result,
            &mut self.observations,
        );
        report::report(shared, &mut rows.row(environment));
        Ok(())
    }

    /// Puts the agent of an environment where the recorded wearer was, with its velocity, at a
    /// time of the recording of the agent's sector, ns. `false` where there is no pose, or no
    /// ground below it, and nothing changed. Steps, path length and rewards are those of
    /// [`Self::step`] alone.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for a sector without a trajectory; [`SimulationError::Setting`]
    /// with a [`WorldConfig::timing`](crate::WorldConfig::timing), whose frames only steps
    /// capture; those of [`Self::place`].
    pub fn play(&mut self, environment: usize, time_ns: i64) -> Result<bool, SimulationError> {
        self.check_index(environment)?;
        let shared = &self.shared;
        if !shared.config.timing.is_immediate() {
            return Err(SimulationError::Setting {
                name: "play".to_owned(),
                found: format!("{:?}", shared.config.timing),
                expected: "no timing of frames, which only steps capture".to_owned(),
            });
        }
        let from = self.environments.sector[environment];
        let terrain = &shared.terrains[from as usize];
        let wearer = terrain
            .wearer
            .as_ref()
            .ok_or_else(|| SimulationError::Scene {
                place: format!(
                    "scene {}, sector {}",
                    shared.scene.name, shared.scene.sectors[from as usize].name
                ),
                found: "no trajectory".to_owned(),
                expected: "output trajectory, the walk of the wearer".to_owned(),
            })?;
        let Some(state) = wearer.state(&terrain.ground, &shared.config.agent, time_ns) else {
            return Ok(false);
        };
        let crossed = shared.cross(from, &state, &mut [0.0; 3]);
        let sector = crossed.map_or(from, |(sector, _)| sector);
        let is_here = shared.terrains[sector as usize].frame == terrain.frame;
        let sector = if is_here { sector } else { from };
        self.place(environment, sector as usize, &state)?;
        Ok(true)
    }
}
