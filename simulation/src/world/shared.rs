//! What all environments of a world share and no step changes.

use std::sync::Arc;

use cad_transforms::RigidTransform;

use super::config::WorldConfig;
use super::observation::Layout;
use super::terrain::{Terrain, terrains};
use crate::SimulationError;
use crate::agent::{self, AgentState};
use crate::camera::nanoseconds;
use crate::episode::start::candidates::Candidates;
use crate::episode::task::goals::Goal;
use crate::reference_poses::{Deviation, DeviationConfig};
use crate::scene::{Place, SceneData};
use crate::support::config::check_scene;
use crate::support::grid::SupportGrid;

/// What all environments share.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) scene: Arc<SceneData>,
    pub(crate) config: WorldConfig,
    pub(crate) terrains: Vec<Terrain>,
    pub(crate) candidates: Candidates,
    pub(crate) layout: Layout,
    /// Camera on the body without errors of its mount.
    pub(crate) mount: RigidTransform,
    pub(crate) max_steps: u64,
    /// Duration of a step, ns.
    pub(crate) step_ns: i64,
    /// Which recorded camera counts for the limits of the deviation.
    pub(crate) limits: DeviationConfig,
    pub(crate) config_hash: [u8; 32],
    /// Goals of the task; drawn at the first reset, which may start threads.
    pub(crate) goals: Vec<Goal>,
    /// Predicted PSNR of views in each sector, where the configuration needs it; made at the first
    /// reset.
    pub(crate) support: Vec<SupportGrid>,
}

impl Shared {
    /// # Errors
    /// [`SimulationError::Setting`]; [`SimulationError::Scene`] for a sector without ground.
    pub(crate) fn new(scene: Arc<SceneData>, config: WorldConfig) -> Result<Self, SimulationError> {
        config.check()?;
        if let Some((name, found, _)) = config.predicts_support() {
            check_scene(&scene, name, &found)?;
        }
        let terrains = terrains(&scene, &config)?;
        let candidates = Candidates::new(&terrains, config.start.min_clearance_m);
        Ok(Self {
            layout: Layout::new(&config),
            mount: config.nominal_mount(),
            max_steps: config.max_steps(),
            step_ns: nanoseconds(config.dt_s),
            limits: config.end.units(),
            config_hash: config.hash(),
            goals: Vec::new(),
            support: Vec::new(),
            scene,
            config,
            terrains,
            candidates,
        })
    }

    /// Deviation of a camera from recorded ones as its limits count it; `None` without any.
    pub(crate) fn deviation(
        &self,
        sector: u32,
        world_from_camera: &RigidTransform,
    ) -> Option<Deviation> {
        let references = self.terrains[sector as usize].references.as_ref()?;
        Some(references.nearest_by(world_from_camera, &self.limits))
    }

    /// Predicted PSNR of what an agent sees, dB; 0 where it is not predicted.
    pub(crate) fn support_db(&self, sector: u32, state: &AgentState) -> f64 {
        let grid = self.support.get(sector as usize);
        grid.map_or(0.0, |grid| grid.psnr_db(state.position_m, state.yaw_rad))
    }

    /// The edges over which an agent leaves its sector, if it does: the sector and state after
    /// them. A position that is given is carried along. An agent that cannot be on the ground of
    /// another recording keeps its sector, whose ground it stands on: where the other one knows no
    /// ground, or shows it at another height, there is no place for it.
    pub(crate) fn cross(
        &self,
        from: u32,
        state: &AgentState,
        carried_m: &mut [f64; 3],
    ) -> Option<(u32, AgentState)> {
        if self.terrains.len() == 1 {
            return None;
        }
        let place = Place {
            sector: from as usize,
            sector_from_body: state.world_from_body(),
        };
        let mut moved_m = *carried_m;
        let Place {
            sector,
            sector_from_body,
        } = self.scene.cross_by(&place, |edge| {
            moved_m = edge.to_from_here.apply(moved_m);
        });
        if sector == from as usize {
            return None;
        }
        let to = &self.terrains[sector];
        if to.frame == self.terrains[from as usize].frame {
            return Some((sector as u32, *state));
        }
        let WorldConfig { agent, drive, .. } = &self.config;
        let state = agent::enter(&to.ground, agent, *drive, state, &sector_from_body)?;
        *carried_m = moved_m;
        Some((sector as u32, state))
    }
}
