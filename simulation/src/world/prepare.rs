//! What a world makes at its first reset: goals, and predictions of the PSNR.

use std::ops::ControlFlow;

use super::shared::Shared;
use crate::episode::task::Task;
use crate::episode::task::goals;
use crate::error::SimulationError;
use crate::support;

impl Shared {
    /// Makes what the first reset makes, or the restoring of a snapshot before it: goals, and
    /// predictions of the PSNR with a callback of how many images of a sector are judged, and of
    /// all of it, which may end them.
    ///
    /// # Errors
    /// Those of the goals and of [`support::grids`].
    pub(crate) fn prepare(
        &mut self,
        progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
    ) -> Result<(), SimulationError> {
        if let Some((.., config)) = self.config.predicts_support()
            && self.support.is_empty()
        {
            self.support = support::grids(self, &config, progress)?;
        }
        if self.goals.is_empty() && self.config.task.task == Task::PointGoal {
            self.goals = goals::draw::draw_all(self)?;
        }
        Ok(())
    }
}
