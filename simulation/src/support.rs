//! Support of views by recorded ones: the PSNR of what an agent sees, predicted on all ground.
//!
//! A [`SupportGrid`] has places about half a metre apart on all ground on which an agent can stand.
//! At each of them the image of its camera is judged in some headings by what the training saw
//! ([`ObservedScene`](crate::ObservedScene)); between places and headings the prediction is
//! interpolated, a look-up in a table.
//!
//! Contract: a function of scene, mount of the camera, agent and [`SupportConfig`], on any number
//! of threads. Where no place is around, or it is more than 1 m above or below, the prediction
//! is 0 dB. Pitch and roll are those of an agent at rest on the ground; others are not in it.

pub(crate) mod config;
pub(crate) mod grid;

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};

use cad_transforms::RigidTransform;
use rayon::prelude::*;

pub use config::SupportConfig;
pub use grid::{SupportGrid, SupportNode};

use crate::agent::AgentState;
use crate::camera::pinhole;
use crate::error::SimulationError;
use crate::view_judge::ViewJudge;
use crate::world::shared::Shared;
use grid::{Node, Places};

/// Distance beyond which an agent has left a sector, up to which the sector has places, m: those
/// around the last positions in it.
const MARGIN_M: f64 = 1.0;
/// Size of the images, px.
const SIZE: [u32; 2] = [48, 36];

/// Grids of all sectors.
///
/// # Errors
/// As [`GaussianSource::observed`](crate::GaussianSource::observed);
/// [`SimulationError::State`] if the callback ended it.
pub(crate) fn grids(
    shared: &Shared,
    config: &SupportConfig,
    progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
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
    progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
) -> Result<SupportGrid, SimulationError> {
    let terrain = &shared.terrains[sector];
    let is_of_sector = |at_m| !shared.scene.is_left(sector, at_m, MARGIN_M);
    let places = Places::new(&terrain.ground, is_of_sector, config.cell_m);
    let Some(judge) = judge(shared, sector, config)? else {
        return Ok(SupportGrid::new(places, config.headings, Vec::new()));
    };
    let count = places.nodes.len() * config.headings;
    let done = AtomicUsize::new(0);
    let predicted = (0..count).into_par_iter().map(|number| {
        let node = &places.nodes[number / config.headings];
        let yaw_rad = config.yaw_rad(number % config.headings);
        let psnr_db = judge.psnr_db(&camera_at(shared, sector, node, yaw_rad))?;
        let before = done.fetch_add(1, Ordering::Relaxed);
        match progress(before + 1, count) {
            ControlFlow::Continue(()) => Ok(psnr_db),
            ControlFlow::Break(()) => Err(SimulationError::State(
                "the prediction of the PSNR was ended".to_owned(),
            )),
        }
    });
    let predicted: Vec<f32> = predicted.collect::<Result<_, SimulationError>>()?;
    Ok(SupportGrid::new(places, config.headings, predicted))
}

/// The camera of an agent that stands at a place of a sector.
fn camera_at(shared: &Shared, sector: usize, node: &Node, yaw_rad: f64) -> RigidTransform {
    let (ground, agent) = (&shared.terrains[sector].ground, &shared.config.agent);
    let state = AgentState::on_ground(ground, agent, node.position_m, yaw_rad);
    let state = state.unwrap_or(AgentState {
        position_m: node.position_m,
        yaw_rad,
        ..AgentState::default()
    });
    state.world_from_body() * shared.mount
}

/// The judge of a sector; `None` where it is not known what the training saw.
fn judge(
    shared: &Shared,
    sector: usize,
    config: &SupportConfig,
) -> Result<Option<ViewJudge>, SimulationError> {
    let Some(gaussians) = &shared.scene.sectors[sector].gaussians else {
        return Ok(None);
    };
    if !gaussians.is_observed() {
        return Ok(None);
    }
    let lens = pinhole(SIZE, config.field_of_view_rad)?;
    ViewJudge::new(gaussians, gaussians.load()?, lens)
}

#[cfg(test)]
pub(crate) mod tests;
