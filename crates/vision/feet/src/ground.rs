//! Heights of the ground between contacts.
//!
//! Contract: heights are known in square cells by points on the ground, of which several storeys
//! may lie above each other. Where few points are, nothing is known. A point that stands alone, of
//! a pole or by an error of depth, is no ground.

use std::collections::HashMap;

/// Side of a cell, m.
const CELL_M: f64 = 0.04;
/// Least number of cells that are known of the nine around a place.
const MIN_CELLS: usize = 5;

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct GroundHeights {
    /// Heights of points by cell.
    cells: HashMap<[i32; 2], Vec<f64>>,
}

impl GroundHeights {
    /// From points on the ground in the world, with z up, m.
    pub fn new(points: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let mut cells: HashMap<[i32; 2], Vec<f64>> = HashMap::new();
        for [x, y, z] in points {
            cells.entry(cell([x, y])).or_default().push(z);
        }
        Self { cells }
    }

    /// Height of the ground at a place, of the highest storey that is not above a limit, m.
    pub(crate) fn below(&self, place: [f64; 2], limit_m: f64) -> Option<f64> {
        let [row, column] = cell(place);
        let around = (-1..=1).flat_map(|i| (-1..=1).map(move |j| [row + i, column + j]));
        let top = |cell: [i32; 2]| {
            let heights = self.cells.get(&cell)?.iter().copied();
            heights.filter(|z| *z <= limit_m).reduce(f64::max)
        };
        let mut tops: Vec<f64> = around.filter_map(top).collect();
        tops.sort_by(f64::total_cmp);
        (tops.len() >= MIN_CELLS).then(|| tops[tops.len() / 2])
    }
}

fn cell(place: [f64; 2]) -> [i32; 2] {
    place.map(|v| (v / CELL_M).floor() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(z: f64) -> impl Iterator<Item = [f64; 3]> {
        (0..50)
            .flat_map(move |i| (0..50).map(move |j| [0.02 * f64::from(i), 0.02 * f64::from(j), z]))
    }

    #[test]
    fn a_storey_above_the_limit_is_not_the_ground() {
        let ground = GroundHeights::new(plane(0.0).chain(plane(3.0)));
        assert_eq!(ground.below([0.5, 0.5], 0.5), Some(0.0));
        assert_eq!(ground.below([0.5, 0.5], 3.5), Some(3.0));
        assert_eq!(ground.below([0.5, 0.5], -0.5), None);
    }

    #[test]
    fn steps_are_as_high_on_either_side_of_their_edge_as_they_are() {
        let step = plane(0.0).map(|[x, y, _]| [x, y, if x < 0.5 { 0.0 } else { 0.17 }]);
        let ground = GroundHeights::new(step);
        assert_eq!(ground.below([0.4, 0.5], 0.5), Some(0.0));
        assert_eq!(ground.below([0.6, 0.5], 0.5), Some(0.17));
        assert_eq!(ground.below([2.0, 0.5], 0.5), None);
    }

    #[test]
    fn a_pole_is_no_ground() {
        let pole = (0..20).map(|k| [0.5, 0.5, 0.02 * f64::from(k)]);
        let ground = GroundHeights::new(plane(0.0).chain(pole));
        assert_eq!(ground.below([0.5, 0.5], 0.5), Some(0.0));
    }
}
