//! Maps of the ground for foothold planning: grids of every walkable level.
//!
//! Contract: stairs may turn over themselves and bridges cross ways, so a place may have several
//! levels; each has one height per cell. What no view saw is unknown, not free. Only holes that
//! are narrow and have a plane rim are filled, and flagged ([`FILLED`]). Heights with a large
//! sigma are flagged ([`UNCERTAIN`]). Ground samples, points that carried a foot for one, give
//! heights where depth has none, and win where it contradicts them, unless the foot hangs over an
//! edge there. Levels with samples come first, then larger ones before smaller ones. A level whose
//! grid would be large and mostly empty is divided into several that overlap.

use std::collections::BTreeMap;

use crate::config::MapConfig;
use crate::edges::Edge;
use crate::mesh::Mesh;

mod distance;
mod division;
mod floors;
mod holes;
mod level;
mod measures;
mod samples;

pub use level::{
    CONTRADICTED, EDGE, FILLED, FREE, KNOWN, Level, OCCUPIED, SAMPLED, UNCERTAIN, UNKNOWN,
};

use floors::{Floor, Place};
use samples::{Cell, Sample};

/// A point of the ground that is known other than by depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundSample {
    /// Position in the world, m.
    pub position: [f64; 3],
    /// One standard deviation of its height, m.
    pub sigma_m: f64,
    /// What it belongs to, one contact of a foot for example: where a sole rests on an edge, its
    /// other samples are in the air.
    pub contact: usize,
}

/// Cells of free border around a level.
const BORDER: i32 = 2;
/// Distance of a ground sample from the floor that it is on, m: tall grass, water.
const MAX_SAMPLE_M: f64 = 0.4;

/// The walkable levels of a mesh, which must not be simplified.
pub fn build(
    mesh: &Mesh,
    edges: &[Edge],
    ground: &[GroundSample],
    config: &MapConfig,
) -> Vec<Level> {
    let columns = samples::columns(mesh, config.cell_m);
    let floors: BTreeMap<Cell, Vec<Floor>> = columns
        .iter()
        .map(|(cell, samples)| (*cell, floors::floors(samples, config)))
        .filter(|(_, floors)| !floors.is_empty())
        .collect();
    let columns: BTreeMap<Cell, Vec<Sample>> = columns.into_iter().collect();
    let seeds: Vec<Place> = ground
        .iter()
        .filter_map(|s| seed(&floors, s, config))
        .collect();
    let mut connected = floors::connect(&floors, &seeds, config);
    let is_seeded = |level: &BTreeMap<Cell, usize>| {
        seeds
            .iter()
            .any(|(cell, number)| level.get(cell) == Some(number))
    };
    let min_cells = config.min_level_m2 / (config.cell_m * config.cell_m);
    connected.retain(|level| level.len() as f64 >= min_cells || is_seeded(level));
    // Pieces of a level, with its number.
    let mut pieces: Vec<(usize, BTreeMap<Cell, usize>)> = Vec::new();
    for (number, level) in connected.into_iter().enumerate() {
        let own = division::divide(level, config).into_iter();
        pieces.extend(own.map(|piece| (number, piece)));
    }
    pieces.sort_by_key(|(_, piece)| (!is_seeded(piece), std::cmp::Reverse(piece.len())));
    // The level that a sample belongs to.
    let mut used: Vec<Option<usize>> = vec![None; ground.len()];
    pieces
        .iter()
        .map(|(number, cells)| {
            let mut level = grid(&floors, cells, config);
            let is_overhang = overhangs(&level, ground, config);
            for (index, sample) in ground.iter().enumerate() {
                if used[index].is_some_and(|other| other != *number) {
                    continue;
                }
                if is_overhang[index] || add_sample(&mut level, sample, config) {
                    used[index] = Some(*number);
                }
            }
            holes::fill(&mut level, config);
            flag_uncertain(&mut level, config);
            measures::measure(&mut level, config);
            occupancy(&mut level, &columns, config);
            distance::measure(&mut level, edges, config);
            level
        })
        .collect()
}

fn cell_of(position: &[f64; 3], config: &MapConfig) -> Cell {
    let [column, row] = [0, 1].map(|k| (position[k] / config.cell_m).floor() as i32);
    (row, column)
}

/// The floor that a ground sample is on.
fn seed(
    floors: &BTreeMap<Cell, Vec<Floor>>,
    sample: &GroundSample,
    config: &MapConfig,
) -> Option<Place> {
    let cell = cell_of(&sample.position, config);
    let of_cell = floors.get(&cell)?;
    let away = |floor: &Floor| (f64::from(floor.elevation) - sample.position[2]).abs();
    let nearest =
        (0..of_cell.len()).min_by(|a, b| away(&of_cell[*a]).total_cmp(&away(&of_cell[*b])))?;
    (away(&of_cell[nearest]) <= MAX_SAMPLE_M).then_some((cell, nearest))
}

/// The heights of a level.
fn grid(
    floors: &BTreeMap<Cell, Vec<Floor>>,
    cells: &BTreeMap<Cell, usize>,
    config: &MapConfig,
) -> Level {
    let (mut low, mut high) = ([i32::MAX; 2], [i32::MIN; 2]);
    for (row, column) in cells.keys() {
        for (k, of) in [*column, *row].into_iter().enumerate() {
            low[k] = low[k].min(of - BORDER);
            high[k] = high[k].max(of + BORDER);
        }
    }
    let origin = low.map(|k| (f64::from(k) + 0.5) * config.cell_m);
    let size = [0, 1].map(|k| (high[k] - low[k] + 1) as usize);
    let mut level = Level::new(config.cell_m, origin, size);
    for ((row, column), number) in cells {
        let floor = &floors[&(*row, *column)][*number];
        let index = (row - low[1]) as usize * size[0] + (column - low[0]) as usize;
        level.elevation[index] = floor.elevation;
        (level.lower[index], level.upper[index]) = (floor.lower, floor.upper);
        level.sigma[index] = floor.sigma;
        level.normal[index] = floor.normal;
        level.clearance[index] = floor.clearance;
        level.views[index] = floor.views;
        level.flags[index] = KNOWN;
        // Heights that the slope of the ground does not explain.
        let steepest = 2.0 * config.cell_m;
        if f64::from(floor.upper - floor.lower) > config.min_edge_m.max(steepest) {
            level.flags[index] |= EDGE;
        }
    }
    level
}

/// Which ground samples are in the air above a level: of a contact of which enough others agree
/// with it.
fn overhangs(level: &Level, ground: &[GroundSample], config: &MapConfig) -> Vec<bool> {
    #[derive(Clone, Copy, PartialEq)]
    enum Fit {
        Unknown,
        Agrees,
        Above,
    }
    let fits: Vec<Fit> = ground
        .iter()
        .map(|sample| {
            let [x, y, z] = sample.position;
            let index = level
                .index(x, y)
                .filter(|index| level.has_height(*index) && level.flags[*index] & EDGE == 0);
            let Some(index) = index else {
                return Fit::Unknown;
            };
            let above_m = z - f64::from(level.elevation[index]);
            let sigma_m = sample.sigma_m.hypot(f64::from(level.sigma[index]));
            if above_m.abs() <= config.max_sample_sigmas * sigma_m {
                Fit::Agrees
            } else if (config.min_overhang_m + 2.0 * sigma_m..=MAX_SAMPLE_M).contains(&above_m) {
                Fit::Above
            } else {
                Fit::Unknown
            }
        })
        .collect();
    // Of each contact, samples that agree and those above.
    let mut counts: BTreeMap<usize, [usize; 2]> = BTreeMap::new();
    for (sample, fit) in ground.iter().zip(&fits) {
        let count = counts.entry(sample.contact).or_default();
        count[0] += usize::from(*fit == Fit::Agrees);
        count[1] += usize::from(*fit == Fit::Above);
    }
    let hangs = |(sample, fit): (&GroundSample, &Fit)| {
        let [agrees, above] = counts[&sample.contact];
        let share = agrees as f64 / (agrees + above).max(1) as f64;
        *fit == Fit::Above && share >= config.min_agreeing_share
    };
    ground.iter().zip(&fits).map(hangs).collect()
}

/// Adds a ground sample to a level that it is on. A level without height there is the one of its
/// neighbors.
fn add_sample(level: &mut Level, sample: &GroundSample, config: &MapConfig) -> bool {
    let [x, y, z] = sample.position;
    let Some(index) = level.index(x, y) else {
        return false;
    };
    let sigma = sample.sigma_m;
    if !level.has_height(index) {
        let near = level.near(index, 5.0 * level.cell_m);
        let is_level = near
            .map(|(other, _)| (f64::from(level.elevation[other]) - z).abs())
            .reduce(f64::min)
            .is_some_and(|nearest| nearest <= config.max_step_m);
        if is_level {
            (level.elevation[index], level.sigma[index]) = (z as f32, sigma as f32);
            (level.lower[index], level.upper[index]) = (z as f32, z as f32);
            level.normal[index] = [0.0, 0.0, 1.0];
            level.clearance[index] = f32::INFINITY;
            level.flags[index] |= SAMPLED;
        }
        return is_level;
    }
    let (elevation, of_depth) = (
        f64::from(level.elevation[index]),
        f64::from(level.sigma[index]),
    );
    let difference = z - elevation;
    if difference.abs() > MAX_SAMPLE_M {
        return false;
    }
    level.flags[index] |= SAMPLED;
    if level.flags[index] & EDGE != 0 {
        // Which of the two heights the sample is on is not known.
        return true;
    }
    let (height, combined) = if difference.abs() > config.max_sample_sigmas * sigma.hypot(of_depth)
    {
        level.flags[index] |= CONTRADICTED;
        (z, sigma)
    } else {
        let share = of_depth * of_depth / (of_depth * of_depth + sigma * sigma);
        (
            elevation + share * difference,
            sigma * of_depth / sigma.hypot(of_depth),
        )
    };
    level.elevation[index] = height as f32;
    level.sigma[index] = combined as f32;
    (level.lower[index], level.upper[index]) = (height as f32, height as f32);
    true
}

/// Flags heights whose sigma is too large.
fn flag_uncertain(level: &mut Level, config: &MapConfig) {
    for index in 0..level.flags.len() {
        // True for NaN.
        let is_certain = f64::from(level.sigma[index]) <= config.max_certain_sigma_m;
        if level.has_height(index) && !is_certain {
            level.flags[index] |= UNCERTAIN;
        }
    }
}

/// Obstacles are surfaces between the height of a step and the head room above the ground of a cell
/// or of a neighbor.
fn occupancy(level: &mut Level, columns: &BTreeMap<Cell, Vec<Sample>>, config: &MapConfig) {
    for index in 0..level.flags.len() {
        let [x, y] = level.center(index);
        let height = match level.has_height(index) {
            true => Some(level.upper[index]),
            false => {
                let near = level.near(index, 1.5 * level.cell_m);
                near.map(|(other, _)| level.upper[other]).reduce(f32::max)
            }
        };
        let Some(height) = height else {
            continue;
        };
        let samples = columns
            .get(&cell_of(&[x, y, 0.0], config))
            .map_or(&[][..], Vec::as_slice);
        let is_obstacle = samples.iter().any(|sample| {
            let above = f64::from(sample.z - height);
            above > config.max_step_m && above < config.head_room_m
        });
        level.occupancy[index] = match (is_obstacle, level.has_height(index)) {
            (true, _) => OCCUPIED,
            (false, true) => FREE,
            (false, false) => UNKNOWN,
        };
    }
}
