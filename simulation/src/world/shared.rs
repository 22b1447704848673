//! What all environments of a world share and no step changes.

use std::sync::Arc;

use cad_transforms::RigidTransform;

use super::config::WorldConfig;
use super::observation::Layout;
use crate::SimulationError;
use crate::agent::AgentState;
use crate::camera::nanoseconds;
use crate::episode::path::Path;
use crate::episode::start::candidates::Candidates;
use crate::episode::task::goals::Goal;
use crate::ground::{Cover, Ground};
use crate::reference_poses::{Deviation, DeviationConfig, ReferencePoses};
use crate::scene::{Area, Place, SceneData, Sector};

/// A sector, as agents on the ground use it.
#[derive(Debug)]
pub(crate) struct Terrain {
    /// Ground; sectors of one recording share it.
    pub(crate) ground: Arc<Ground>,
    /// Number of the recording: positions of sectors with the same one are in the same frame.
    pub(crate) frame: u32,
    pub(crate) references: Option<Arc<ReferencePoses>>,
    pub(crate) path: Arc<Path>,
    pub(crate) area: Area,
    /// The component of walkable ground with most cells, on which episodes start.
    pub(crate) component: Option<u32>,
}

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
}

impl Shared {
    /// # Errors
    /// [`SimulationError::Setting`]; [`SimulationError::Scene`] for a sector without ground.
    pub(crate) fn new(scene: Arc<SceneData>, config: WorldConfig) -> Result<Self, SimulationError> {
        config.check()?;
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
            scene,
            config,
            terrains,
            candidates,
        })
    }

    /// Deviation of a camera from recorded ones as its limits count it, and the PSNR predicted from
    /// it; 0 dB without a support map.
    pub(crate) fn deviation(
        &self,
        sector: u32,
        world_from_camera: &RigidTransform,
    ) -> (Option<Deviation>, f64) {
        let Some(references) = &self.terrains[sector as usize].references else {
            return (None, 0.0);
        };
        let deviation = references.nearest_by(world_from_camera, &self.limits);
        let support_db = self.config.support.as_ref().map_or(0.0, |support| {
            let nearest = references.nearest_by(world_from_camera, &self.config.deviation);
            support.support_db(&nearest).max(0.0)
        });
        (Some(deviation), support_db)
    }

    /// The edges over which an agent leaves its sector, if it does: the sector and state after
    /// them. A position that is given is carried along.
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
        *carried_m = moved_m;
        let [x, y, z] = sector_from_body.translation_m();
        let [forward_x, forward_y, _] = sector_from_body.rotate([1.0, 0.0, 0.0]);
        let surface = to.ground.surface([x, y], z);
        let state = AgentState {
            position_m: [x, y, surface.map_or(z, |surface| surface.height_m)],
            yaw_rad: libm::atan2(forward_y, forward_x),
            level: surface.map_or(0, |surface| surface.level),
            is_on_ground: surface.is_some(),
            ..*state
        };
        Some((sector as u32, state))
    }
}

/// The sectors of a scene. What sectors share is made once.
fn terrains(scene: &SceneData, config: &WorldConfig) -> Result<Vec<Terrain>, SimulationError> {
    let mut terrains: Vec<Terrain> = Vec::new();
    for (number, sector) in scene.sectors.iter().enumerate() {
        let levels = sector
            .levels
            .as_ref()
            .ok_or_else(|| SimulationError::Scene {
                place: format!("scene {}, sector {}", scene.name, sector.name),
                found: "no maps".to_owned(),
                expected: "output maps, on which agents walk".to_owned(),
            })?;
        let same_ground = (0..number).find(|&other| {
            let of_other = &scene.sectors[other].levels;
            of_other.as_ref().is_some_and(|of| Arc::ptr_eq(of, levels))
        });
        let (ground, frame, component) = match same_ground {
            Some(other) => {
                let other = &terrains[other];
                (other.ground.clone(), other.frame, other.component)
            }
            None => {
                let ground = Ground::new(levels.to_vec(), &config.agent)?;
                let component = largest_component(&ground);
                (Arc::new(ground), number as u32, component)
            }
        };
        let same_references = (0..number)
            .find(|&other| Arc::ptr_eq(&scene.sectors[other].references, &sector.references));
        let references = match same_references {
            Some(other) => terrains[other].references.clone(),
            None if sector.references.is_empty() => None,
            None => {
                let poses = sector.references.to_vec();
                let references = ReferencePoses::new(poses)?;
                Some(Arc::new(references))
            }
        };
        let same_recording = (0..number)
            .find(|&other| Arc::ptr_eq(&scene.sectors[other].recording, &sector.recording));
        let path = match same_recording {
            Some(other) => terrains[other].path.clone(),
            None => Arc::new(recorded_path(sector, &ground, config)),
        };
        terrains.push(Terrain {
            ground,
            frame,
            references,
            path,
            area: sector.area,
            component,
        });
    }
    Ok(terrains)
}

/// The trajectory of the rig on the ground below it; where that is not known, below it by the
/// height of the eyes.
fn recorded_path(sector: &Sector, ground: &Ground, config: &WorldConfig) -> Path {
    let poses = sector.recording.trajectory.iter().flat_map(|t| t.usable());
    Path::new(poses.map(|pose| {
        let [x, y, z] = pose.world_from_rig.translation_m();
        let below_m = z - config.agent.eye_height_m;
        let surface = ground.surface([x, y], below_m);
        [x, y, surface.map_or(below_m, |surface| surface.height_m)]
    }))
}

/// The component with most free cells, of equal ones the first.
fn largest_component(ground: &Ground) -> Option<u32> {
    let mut counts: Vec<usize> = Vec::new();
    for (number, level) in ground.levels().iter().enumerate() {
        for cell in 0..level.grid.cells() {
            let center_m = level.grid.center_m(cell);
            if !matches!(ground.cover(center_m, number), Cover::Free) {
                continue;
            }
            if let Some(component) = ground.component(center_m, number) {
                let component = component as usize;
                if counts.len() <= component {
                    counts.resize(component + 1, 0);
                }
                counts[component] += 1;
            }
        }
    }
    let most = *counts.iter().max()?;
    let first = counts.iter().position(|count| *count == most)?;
    Some(first as u32)
}
