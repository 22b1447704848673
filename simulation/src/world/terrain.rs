//! Sectors as agents on the ground use them.

use std::sync::Arc;

use super::config::WorldConfig;
use crate::SimulationError;
use crate::agent::Playback;
use crate::episode::path::Path;
use crate::ground::{Cover, Ground};
use crate::reference_poses::ReferencePoses;
use crate::scene::{Area, SceneData, Sector};

/// A sector, as agents on the ground use it.
#[derive(Debug)]
pub(crate) struct Terrain {
    /// Ground; sectors of one recording share it.
    pub(crate) ground: Arc<Ground>,
    /// Number of the recording: positions of sectors with the same one are in the same frame.
    pub(crate) frame: u32,
    pub(crate) references: Option<Arc<ReferencePoses>>,
    pub(crate) path: Arc<Path>,
    /// The recorded wearer; `None` without a trajectory.
    pub(crate) wearer: Option<Arc<Playback>>,
    pub(crate) area: Area,
    /// The component of walkable ground with most cells, on which episodes start.
    pub(crate) component: Option<u32>,
}

/// The sectors of a scene. What sectors share is made once.
pub(super) fn terrains(
    scene: &SceneData,
    config: &WorldConfig,
) -> Result<Vec<Terrain>, SimulationError> {
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
                let references = ReferencePoses::new(poses, &config.end.units())?;
                Some(Arc::new(references))
            }
        };
        let same_recording = (0..number)
            .find(|&other| Arc::ptr_eq(&scene.sectors[other].recording, &sector.recording));
        let (path, wearer) = match same_recording {
            Some(other) => (terrains[other].path.clone(), terrains[other].wearer.clone()),
            None => (
                Arc::new(recorded_path(sector, &ground, config)),
                Playback::of(&sector.recording).map(Arc::new),
            ),
        };
        terrains.push(Terrain {
            ground,
            frame,
            references,
            path,
            wearer,
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
