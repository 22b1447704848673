//! Support of views by recorded ones: the PSNR of what an agent sees, predicted all over the ground.
//!
//! A [`SupportGrid`] has places about half a metre apart on all ground on which an agent can stand.
//! At each of them the image of its camera is judged in some headings by what the training saw
//! ([`ObservedScene`](crate::ObservedScene)); between places and headings the prediction is
//! interpolated, which costs a step of an environment nothing to speak of.
//!
//! Contract: a function of scene, mount of the camera, agent and [`SupportConfig`], on any number of
//! threads. Where an agent cannot stand, or more than 1 m above or below, the prediction is 0 dB.
//! Pitch and roll are those of an agent at rest on the ground; others are not in it.

mod grid;

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use cad_transforms::RigidTransform;
use estimator_config::config;
use rayon::prelude::*;
use splats::{Camera, Renderer, Scene};

pub use grid::{SupportGrid, SupportNode};

use crate::agent::AgentState;
use crate::camera::pinhole;
use crate::confidence::{ObservedScene, renderer};
use crate::error::{SimulationError, check_range};
use crate::scene::SceneData;
use crate::world::shared::Shared;
use grid::{Node, Places};

config! {
    /// How the PSNR of views is predicted.
    pub struct SupportConfig {
        /// Distance of the places at which images are judged, m.
        pub cell_m: f64 = 0.5,
        /// Headings at each place.
        pub headings: usize = 8,
        /// Field of view of the images from left to right, rad.
        pub field_of_view_rad: f64 = 1.6,
    }
}

/// Size of the images, px.
const SIZE: [u32; 2] = [48, 36];

impl SupportConfig {
    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        for (name, value, range, expected) in [
            ("support.cell_m", self.cell_m, [0.05, 10.0], "0.05 to 10 m"),
            (
                "support.headings",
                self.headings as f64,
                [1.0, 64.0],
                "1 to 64",
            ),
            (
                "support.field_of_view_rad",
                self.field_of_view_rad,
                [0.1, 3.0],
                "0.1 to 3 rad",
            ),
        ] {
            check_range(name, value, range, expected)?;
        }
        Ok(())
    }

    /// Yaw of a heading, rad.
    fn yaw_rad(&self, heading: usize) -> f64 {
        std::f64::consts::TAU * heading as f64 / self.headings as f64
    }
}

/// Refuses a scene of which it is not known what the training saw, for a setting that needs it.
pub(crate) fn check_scene(
    scene: &SceneData,
    name: &str,
    found: &str,
) -> Result<(), SimulationError> {
    let is_observed = |sector: &&crate::scene::Sector| {
        let gaussians = sector.gaussians.as_ref();
        !gaussians.is_some_and(|gaussians| gaussians.is_observed())
    };
    match scene.sectors.iter().find(is_observed) {
        None => Ok(()),
        Some(sector) => Err(SimulationError::Setting {
            name: name.to_owned(),
            found: found.to_owned(),
            expected: format!(
                "none: sector {} has no record of what the training of its Gaussians saw, which \
                 the stage splats writes",
                sector.name
            ),
        }),
    }
}

/// Grids of all sectors.
///
/// # Errors
/// As [`GaussianSource::observed`](crate::GaussianSource::observed).
pub(crate) fn grids(
    shared: &Shared,
    config: &SupportConfig,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<SupportGrid>, SimulationError> {
    let sectors = 0..shared.terrains.len();
    sectors
        .map(|sector| grid(shared, sector, config, progress))
        .collect()
}

fn grid(
    shared: &Shared,
    sector: usize,
    config: &SupportConfig,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<SupportGrid, SimulationError> {
    let terrain = &shared.terrains[sector];
    let places = Places::new(&terrain.ground, &terrain.area, config.cell_m);
    let Some(judge) = Judge::new(shared, sector, config)? else {
        return Ok(SupportGrid::new(places, config.headings, Vec::new()));
    };
    let count = places.nodes.len() * config.headings;
    let done = AtomicUsize::new(0);
    let predicted = (0..count).into_par_iter().map(|number| {
        let node = &places.nodes[number / config.headings];
        let yaw_rad = config.yaw_rad(number % config.headings);
        let psnr_db = judge.psnr_db(&judge.camera_at(shared, sector, node, yaw_rad))?;
        let before = done.fetch_add(1, Ordering::Relaxed);
        progress(before + 1, count);
        Ok(psnr_db)
    });
    let predicted: Vec<f32> = predicted.collect::<Result<_, SimulationError>>()?;
    Ok(SupportGrid::new(places, config.headings, predicted))
}

/// Judges images of an agent's camera in a sector.
struct Judge {
    observed: Arc<ObservedScene>,
    scene: Arc<Scene>,
    renderer: Renderer,
    model: camera_models::CameraModel,
}

impl Judge {
    /// `None` for a sector of which it is not known what the training saw.
    fn new(
        shared: &Shared,
        sector: usize,
        config: &SupportConfig,
    ) -> Result<Option<Self>, SimulationError> {
        let Some(gaussians) = &shared.scene.sectors[sector].gaussians else {
            return Ok(None);
        };
        let Some(observed) = gaussians.observed()? else {
            return Ok(None);
        };
        Ok(Some(Self {
            observed,
            scene: gaussians.load()?,
            renderer: renderer(gaussians.is_compensated())?,
            model: pinhole(SIZE, config.field_of_view_rad)?,
        }))
    }

    /// The camera of an agent that stands at a place.
    fn camera_at(
        &self,
        shared: &Shared,
        sector: usize,
        node: &Node,
        yaw_rad: f64,
    ) -> RigidTransform {
        let (ground, agent) = (&shared.terrains[sector].ground, &shared.config.agent);
        let state = AgentState::on_ground(ground, agent, node.position_m, yaw_rad);
        let state = state.unwrap_or(AgentState {
            position_m: node.position_m,
            yaw_rad,
            ..AgentState::default()
        });
        state.world_from_body() * shared.mount
    }

    fn psnr_db(&self, world_from_camera: &RigidTransform) -> Result<f32, SimulationError> {
        let camera = Camera::new(self.model, world_from_camera.inverse());
        let camera = camera.map_err(|error| SimulationError::Scene {
            place: "a camera whose images are judged".to_owned(),
            found: error.to_string(),
            expected: "a lens that images can be rendered with".to_owned(),
        })?;
        let confidence = self
            .observed
            .confidence(&self.renderer, &self.scene, &camera)?;
        Ok(confidence.psnr_db)
    }
}

#[cfg(test)]
pub(crate) mod tests;
