//! Floors: surfaces of a cell that one can stand on, and which of them are connected.

use std::collections::{BTreeMap, VecDeque};

use super::samples::{Cell, Sample};
use crate::config::MapConfig;

/// Ground of a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Floor {
    pub(super) elevation: f32,
    pub(super) lower: f32,
    pub(super) upper: f32,
    pub(super) sigma: f32,
    pub(super) normal: [f32; 3],
    pub(super) views: u8,
    /// Height to the next surface above, m.
    pub(super) clearance: f32,
}

/// A floor by its cell and its number in the cell, from below.
pub(super) type Place = (Cell, usize);

/// Floors of a column of samples, from below. Surfaces that are apart by more than a step are
/// different floors: the seat of a bench is not the ground beside it.
pub(super) fn floors(samples: &[Sample], config: &MapConfig) -> Vec<Floor> {
    let is_ground = |sample: &Sample| f64::from(sample.normal[2]) >= config.min_ground_cos;
    let mut groups: Vec<Vec<Sample>> = Vec::new();
    for sample in samples.iter().filter(|sample| is_ground(sample)) {
        let same = groups.last_mut().filter(|group| {
            let last = group[group.len() - 1];
            f64::from(sample.z - last.z) <= config.max_step_m
        });
        match same {
            Some(group) => group.push(*sample),
            None => groups.push(vec![*sample]),
        }
    }
    let of = |group: &Vec<Sample>| {
        let (lower, upper) = (group[0].z, group[group.len() - 1].z);
        let at_center = group.iter().rev().find(|sample| sample.is_center());
        // Without surface at the center, the sample of median height.
        let chosen = at_center.unwrap_or(&group[group.len() / 2]);
        let above = samples
            .iter()
            .find(|sample| f64::from(sample.z - upper) > config.level_gap_m);
        let close = |sample: &&Sample| f64::from((sample.z - chosen.z).abs()) < config.min_edge_m;
        let normals = group.iter().filter(close).fold([0.0f32; 3], |sum, sample| {
            [0, 1, 2].map(|k| sum[k] + sample.normal[k])
        });
        let norm = normals.iter().map(|v| v * v).sum::<f32>().sqrt();
        Floor {
            elevation: chosen.z,
            lower,
            upper,
            sigma: chosen.sigma,
            normal: normals.map(|v| v / norm),
            views: group.iter().map(|sample| sample.views).max().unwrap_or(0),
            clearance: above.map_or(f32::INFINITY, |above| above.z - upper),
        }
    };
    groups.iter().map(of).collect()
}

/// Connected floors as levels: at most one floor of each cell is in a level. Seeds come first, then
/// the floors in the order of their places.
pub(super) fn connect(
    floors: &BTreeMap<Cell, Vec<Floor>>,
    seeds: &[Place],
    config: &MapConfig,
) -> Vec<BTreeMap<Cell, usize>> {
    let mut taken: BTreeMap<Place, ()> = BTreeMap::new();
    let all = floors
        .iter()
        .flat_map(|(cell, of)| (0..of.len()).map(|number| (*cell, number)));
    let mut levels = Vec::new();
    for start in seeds.iter().copied().chain(all) {
        if taken.contains_key(&start) {
            continue;
        }
        let mut level: BTreeMap<Cell, usize> = BTreeMap::from([start]);
        let mut open = VecDeque::from([start]);
        taken.insert(start, ());
        while let Some((cell, number)) = open.pop_front() {
            let floor = &floors[&cell][number];
            for (down, right) in [(0, 1), (0, -1), (1, 0), (-1, 0)] {
                let next = (cell.0 + down, cell.1 + right);
                let Some(others) = floors.get(&next).filter(|_| !level.contains_key(&next)) else {
                    continue;
                };
                let difference = |other: &Floor| {
                    // Ground of both cells may meet at any of their heights.
                    let apart = (other.lower - floor.upper).max(floor.lower - other.upper);
                    f64::from(apart.max(0.0))
                };
                let nearest = (0..others.len())
                    .filter(|k| !taken.contains_key(&(next, *k)))
                    .min_by(|a, b| difference(&others[*a]).total_cmp(&difference(&others[*b])));
                if let Some(k) = nearest.filter(|k| difference(&others[*k]) <= config.max_step_m) {
                    level.insert(next, k);
                    taken.insert((next, k), ());
                    open.push_back((next, k));
                }
            }
        }
        levels.push(level);
    }
    levels
}
