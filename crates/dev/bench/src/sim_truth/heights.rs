//! Heights of the simulator's ground.

use anyhow::Result;
use reconstruction::pipeline::stages::map_levels;
use serde_json::{Value, json};
use simulation::{AgentConfig, Cover, Ground};
use terrain::FusionConfig;

use crate::terrain::keyframes::{Source, depth_frames, keyframes};
use crate::terrain::scores::Quantiles;
use crate::terrain::surface::surface;
use crate::terrain::truth::{Truth, horizontal_distance};
use crate::terrain::walks::Walk;

/// Heights are compared at the centers of cells of this size, m, which are not those of the maps.
const SPACING_M: f64 = 0.07;
/// Ground near footsteps, and all that is compared, m.
const NEAR_M: f64 = 0.6;
const FAR_M: f64 = 2.5;
/// True ground is at most this much above the nearest footstep, m.
const ABOVE_M: f64 = 0.4;
/// Cells of the maps that touch a step edge have the height of one side.
const EDGE_M: f64 = 0.05;
/// 95th percentile near footsteps, mm.
pub(super) const GOAL_MM: f64 = 10.0;
/// Share of the heights elsewhere within two stated standard deviations.
const SHARE_GOAL: f64 = 0.95;

/// # Errors
/// A walk that cannot be rendered.
pub(super) fn measure(walk: Walk) -> Result<Value> {
    let prepared = walk.prepare()?;
    let rendered = keyframes(&prepared, &prepared.keyframes()?)?;
    let truth = Truth::new(&prepared);
    let frames = depth_frames(&rendered, Source::Stereo)?;
    let surface = surface(&frames, FusionConfig::default())?;
    let ground = Ground::new(map_levels(surface.levels), &AgentConfig::default())?;
    let (mut near, mut beside_edges, mut far) = (Vec::new(), Vec::new(), Vec::new());
    let (mut places, mut unknown, mut occupied) = ([0, 0], [0, 0], [0, 0]);
    for [x, y, step_z] in truth.cells(SPACING_M, FAR_M) {
        let Some(true_m) = truth.ground([x, y, step_z], ABOVE_M) else {
            continue;
        };
        let middles = truth.footprints.iter().map(|print| print.middle);
        let distance_m = middles
            .map(|middle| f64::hypot(middle[0] - x, middle[1] - y))
            .fold(f64::INFINITY, f64::min);
        let is_near = distance_m <= NEAR_M;
        places[usize::from(!is_near)] += 1;
        let Some(found) = ground.surface([x, y], true_m) else {
            unknown[usize::from(!is_near)] += 1;
            continue;
        };
        // Tops of furniture and walls, below which true ground may be.
        if ground.cover([x, y], found.level) == Cover::Occupied {
            occupied[usize::from(!is_near)] += 1;
            continue;
        }
        let error_m = found.height_m - true_m;
        let at_edge = truth.edges.iter().any(|own| {
            let z = own.edge.ends[0].z;
            (z - true_m).abs() < ABOVE_M && horizontal_distance(&own.edge, [x, y, z]) < EDGE_M
        });
        match (at_edge, is_near) {
            (true, _) => beside_edges.push(error_m.abs()),
            (false, true) => near.push(error_m.abs()),
            (false, false) => far.push((error_m.abs(), found.sigma_m)),
        }
    }
    let within = far
        .iter()
        .filter(|(error_m, sigma_m)| *error_m <= 2.0 * sigma_m);
    let share = |part: usize, whole: usize| part as f64 / whole.max(1) as f64;
    Ok(json!({
        "keyframes": frames.len(),
        "near": {
            "within_m": NEAR_M,
            "error": Quantiles::of(near.iter().copied()),
            "unknown_share": share(unknown[0], places[0]),
            "occupied_share": share(occupied[0], places[0]),
        },
        "at_step_edges": { "within_m": EDGE_M, "error": Quantiles::of(beside_edges.iter().copied()) },
        "elsewhere": {
            "to_m": FAR_M,
            "error": Quantiles::of(far.iter().map(|(error_m, _)| *error_m)),
            "share_within_two_sigmas": share(within.count(), far.len()),
            "unknown_share": share(unknown[1], places[1]),
            "occupied_share": share(occupied[1], places[1]),
        },
        "goal": { "near_p95_mm": GOAL_MM, "share_within_two_sigmas": SHARE_GOAL },
    }))
}
