//! The ground around the feet of a walk, as a map of the stage `terrain` shows it.
//!
//! Contract: points in a grid with the errors of such a map, all of what the feet pass by.
//! Errors of neighboring points are independent.

use std::collections::HashSet;

use feet::track::GroundHeights;
use rig_sim::random;
use rig_sim::simulation::Simulation;

/// Distance of points, m, and how far they are from the middle of a foot.
const SPACING_M: f64 = 0.02;
const AROUND_M: f64 = 0.28;
/// Standard deviation of their heights, m.
const SIGMA_M: f64 = 0.007;
/// Height above a foot up to which the ground is searched, m.
const ABOVE_M: f64 = 0.5;
/// Stream of these errors.
const STREAM: u64 = 0x6f00;

/// The ground around places of the feet, m.
pub(super) fn ground(
    simulation: &Simulation,
    seed: u64,
    feet: impl Iterator<Item = [f64; 3]>,
) -> GroundHeights {
    let count = (AROUND_M / SPACING_M).round() as i64;
    let mut known = HashSet::new();
    let mut points = Vec::new();
    for [x, y, z] in feet {
        let middle = [x, y].map(|v| (v / SPACING_M).round() as i64);
        let storey = z.round() as i64;
        for i in -count..=count {
            for j in -count..=count {
                let key = [middle[0] + i, middle[1] + j, storey];
                if known.insert(key) {
                    points.extend(point(simulation, seed, key, z + ABOVE_M));
                }
            }
        }
    }
    GroundHeights::new(points)
}

fn point(simulation: &Simulation, seed: u64, key: [i64; 3], below: f64) -> Option<[f64; 3]> {
    let [x, y] = [key[0], key[1]].map(|k| SPACING_M * k as f64);
    let ground = simulation.scene().ground(x, y, below)?;
    let index = (key[0] as u64)
        .wrapping_mul(0x1_0001)
        .wrapping_add((key[1] as u64) << 24);
    let error = SIGMA_M * random::bell(seed, STREAM, index);
    Some([x, y, ground.height + error])
}
