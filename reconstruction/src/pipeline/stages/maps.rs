//! Stage `maps`: maps of the walkable levels for foothold planning, and convex parts for physics.
//!
//! Contract: the ground below soles at rest is known from them. They give heights where depth has
//! none, and win where it contradicts them; both are flagged. What no view saw and no foot touched
//! is unknown, not free.

use scene_bundle::outputs::contacts::FootContact;
use scene_bundle::outputs::terrain::MeshDetail;
use scene_bundle::outputs::{self, COLLISION, CONTACTS, MAPS, RIG_REFINED, TERRAIN};
use serde_json::{Value, json};
use terrain::convex::{collision_parts, obstacle_parts};
use terrain::edges::without_ramps;
use terrain::maps::{FREE, GroundSample, build};

use self::config::MapsConfig;
use self::sole_samples::sole_samples;
use super::soles::outline;
use super::terrain::surface::of_files;
use crate::input::Input;
use crate::pipeline::{Stage, StageError, Work};

mod config;
mod layers;
mod sole_samples;

pub use layers::{map_collision, map_levels};

/// See the module.
pub(super) struct MapsStage;

impl Stage<Input> for MapsStage {
    fn name(&self) -> &'static str {
        "maps"
    }

    fn version(&self) -> u32 {
        6
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[TERRAIN, CONTACTS, RIG_REFINED]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[MAPS, COLLISION]
    }

    fn settings(&self) -> Value {
        json!({ "config": MapsConfig::default() })
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let config = MapsConfig::default();
        let reader = work.read(TERRAIN)?;
        let stored = outputs::terrain::read(&reader)?;
        let dense = outputs::terrain::read_mesh(&reader, MeshDetail::Dense, &stored)?;
        let (mesh, planes, edges) = of_files(&stored, dense);
        let mesh = without_ramps(&mesh, &planes, &edges, &config.convex.ramps);
        let contacts = outputs::contacts::read(&work.read(CONTACTS)?)?;
        let rig = outputs::rig::read(&work.read(RIG_REFINED)?)?;
        let of_sole = |(number, own): (usize, &FootContact)| {
            sole_samples(number, own, &outline(&rig, own.foot), &config)
        };
        let samples: Vec<GroundSample> = contacts.iter().enumerate().flat_map(of_sole).collect();
        let steps = 3;
        let levels = build(&mesh, &edges, &samples, &config.maps);
        work.progress(1, steps);
        let parts = collision_parts(&planes, &edges, &levels, &config.convex);
        work.progress(2, steps);
        let obstacles = obstacle_parts(&mesh, &planes, &levels, &config.obstacles);
        work.progress(steps, steps);
        let area_m2: f64 = levels
            .iter()
            .map(|level| {
                let free = level.occupancy.iter().filter(|cell| **cell == FREE);
                free.count() as f64 * level.cell_m * level.cell_m
            })
            .sum();
        work.note(format!(
            "{} levels with {area_m2:.0} m2 of free ground; {} convex parts of ground and walls, \
             {} of obstacles",
            levels.len(),
            parts.parts.len(),
            obstacles.len()
        ));
        outputs::maps::write(work.draft(MAPS), &map_levels(levels))?;
        let collision = map_collision(parts, obstacles, &planes, &config.convex);
        outputs::collision::write(work.draft(COLLISION), &collision)?;
        Ok(())
    }
}
