//! The simulated walks of a configuration: cameras of one walk share it. Always empty in a program
//! that was built without the simulator.

#[cfg(feature = "simulator")]
use std::sync::Arc;

#[cfg(feature = "simulator")]
use cad_transforms::rig::Rig;
#[cfg(feature = "simulator")]
use rig_sim::simulation::{Settings, Simulation, SimulationError};

/// Existing walks, so that cameras of one walk share it.
#[derive(Debug, Default)]
pub struct Walks {
    #[cfg(feature = "simulator")]
    walks: Vec<Arc<Simulation>>,
}

#[cfg(feature = "simulator")]
impl Walks {
    /// The walk with these settings.
    ///
    /// # Errors
    /// [`SimulationError`].
    pub fn with(
        &mut self,
        settings: &Settings,
        rig: &Rig,
    ) -> Result<Arc<Simulation>, SimulationError> {
        if let Some(walk) = self.walks.iter().find(|walk| walk.settings() == settings) {
            return Ok(walk.clone());
        }
        let walk = Arc::new(Simulation::new(settings, rig)?);
        self.walks.push(walk.clone());
        Ok(walk)
    }
}
