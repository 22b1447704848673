//! The simulated walks of a configuration: cameras of one walk share it. Always empty in a program
//! that was built without the simulator.

#[cfg(feature = "simulator")]
use std::sync::Arc;

#[cfg(feature = "simulator")]
use cad_transforms::rig::Rig;
#[cfg(feature = "simulator")]
use rig_sim::faults::WearerFaults;
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
    /// The walk with these settings and faults of the wearer.
    ///
    /// # Errors
    /// [`SimulationError`].
    pub fn with(
        &mut self,
        settings: &Settings,
        rig: &Rig,
        faults: &WearerFaults,
    ) -> Result<Arc<Simulation>, SimulationError> {
        let is_same =
            |walk: &&Arc<Simulation>| walk.settings() == settings && walk.wearer_faults() == faults;
        if let Some(walk) = self.walks.iter().find(is_same) {
            return Ok(walk.clone());
        }
        let walk = Arc::new(Simulation::with_wearer_faults(settings, rig, faults)?);
        self.walks.push(walk.clone());
        Ok(walk)
    }
}
