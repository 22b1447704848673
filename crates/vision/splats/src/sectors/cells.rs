//! Cells of the ground: each position of the world is in one of them.
//!
//! The ground is cut across its longer extent, again and again, so that each side has its share of
//! the positions. A walk along a road is cut across it; a place that is passed twice is in one
//! cell both times. Heights are not cut: where an agent stands decides what it sees.

use super::config::SectorConfig;

/// Cells of the ground.
///
/// ```
/// use splats::{Cells, SectorConfig};
///
/// // Cameras along a road.
/// let positions: Vec<[f64; 3]> = (0..100).map(|k| [f64::from(k), 0.0, 1.4]).collect();
/// let cells = Cells::of_positions(&positions, 40, &SectorConfig::default());
/// assert_eq!(cells.count(), 3);
/// let count = |cell| positions.iter().filter(|p| cells.cell_of(**p) == cell).count();
/// assert!((0..3).all(|cell| (30..=40).contains(&count(cell))));
/// assert_eq!(cells.within(0, 0.0), [0, 1]);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// The first one is the root.
    nodes: Vec<Node>,
    boxes: Vec<CellBox>,
}

/// A rectangle of the ground, m; infinite at the outer borders. The lower borders belong to it,
/// the upper ones do not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellBox {
    /// Least x and y.
    pub min_m: [f64; 2],
    /// x and y below which it ends.
    pub max_m: [f64; 2],
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Node {
    Cell(usize),
    /// Positions below `at_m` along the axis are in the first node, the others in the second.
    Cut {
        axis: usize,
        at_m: f64,
        nodes: [usize; 2],
    },
}

impl CellBox {
    /// The whole ground.
    const ALL: Self = Self {
        min_m: [f64::NEG_INFINITY; 2],
        max_m: [f64::INFINITY; 2],
    };

    /// Distance between two rectangles, m; 0 where they touch.
    fn distance_m(&self, other: &Self) -> f64 {
        let gap = |k: usize| {
            let before = self.min_m[k] - other.max_m[k];
            before.max(other.min_m[k] - self.max_m[k]).max(0.0)
        };
        (gap(0) * gap(0) + gap(1) * gap(1)).sqrt()
    }
}

impl Cells {
    /// As few cells as possible with at most `most` of the positions in each, world, m. Positions
    /// that are within [`SectorConfig::min_extent_m`] of each other stay in one cell, however many
    /// they are.
    pub fn of_positions(positions: &[[f64; 3]], most: usize, config: &SectorConfig) -> Self {
        let mut cells = Self {
            nodes: Vec::new(),
            boxes: Vec::new(),
        };
        let ground = positions.iter().map(|[x, y, _]| [*x, *y]).collect();
        cells.divide(ground, CellBox::ALL, most.max(1), config);
        cells
    }

    /// Adds a node of these positions; gives its index.
    fn divide(
        &mut self,
        mut positions: Vec<[f64; 2]>,
        within: CellBox,
        most: usize,
        config: &SectorConfig,
    ) -> usize {
        let node = self.nodes.len();
        self.nodes.push(Node::Cell(self.boxes.len()));
        let Some((axis, count)) = cut(&mut positions, most, config) else {
            self.boxes.push(within);
            return node;
        };
        let at_m = between(positions[count - 1][axis], positions[count][axis]);
        let (mut lower, mut upper) = (within, within);
        (lower.max_m[axis], upper.min_m[axis]) = (at_m, at_m);
        let above = positions.split_off(count);
        let nodes = [
            self.divide(positions, lower, most, config),
            self.divide(above, upper, most, config),
        ];
        self.nodes[node] = Node::Cut { axis, at_m, nodes };
        node
    }

    /// Number of cells, at least one.
    pub fn count(&self) -> usize {
        self.boxes.len()
    }

    /// The cell of a position in the world, m.
    pub fn cell_of(&self, position_m: [f64; 3]) -> usize {
        let mut node = 0;
        loop {
            match self.nodes[node] {
                Node::Cell(cell) => return cell,
                Node::Cut { axis, at_m, nodes } => {
                    node = nodes[usize::from(position_m[axis] >= at_m)];
                }
            }
        }
    }

    /// The rectangle of a cell.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn bounds(&self, cell: usize) -> CellBox {
        self.boxes[cell]
    }

    /// Cells within a distance of a cell, m, itself and those that touch it among them, in order.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn within(&self, cell: usize, reach_m: f64) -> Vec<usize> {
        let of = self.boxes[cell];
        let all = 0..self.boxes.len();
        all.filter(|other| self.boxes[*other].distance_m(&of) <= reach_m)
            .collect()
    }
}

/// Sorts positions along the axis across which they are cut; gives it, and how many are below the
/// cut. `None` where they stay together.
fn cut(positions: &mut [[f64; 2]], most: usize, config: &SectorConfig) -> Option<(usize, usize)> {
    if positions.len() <= most {
        return None;
    }
    let extent = |axis: usize| {
        let along = || positions.iter().map(|position| position[axis]);
        let (low, high) = (along().reduce(f64::min), along().reduce(f64::max));
        low.zip(high).map_or(0.0, |(low, high)| high - low)
    };
    let axis = usize::from(extent(1) > extent(0));
    if extent(axis) <= config.min_extent_m {
        return None;
    }
    positions.sort_by(|a, b| a[axis].total_cmp(&b[axis]));
    let cells = positions.len().div_ceil(most);
    let share = (positions.len() * (cells / 2)).div_ceil(cells);
    // Positions that are equal stay together: the nearest place where two differ.
    let differ = |count: &usize| positions[*count - 1][axis] < positions[*count][axis];
    let counts = (1..positions.len()).filter(differ);
    let count = counts.min_by_key(|count| count.abs_diff(share))?;
    Some((axis, count))
}

/// Above the lower one of two different numbers and not above the other one.
fn between(low: f64, high: f64) -> f64 {
    let middle = 0.5 * low + 0.5 * high;
    match middle > low {
        true => middle.min(high),
        false => high,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(cells: &Cells, positions: &[[f64; 3]]) -> Vec<usize> {
        let mut counts = vec![0; cells.count()];
        for position in positions {
            counts[cells.cell_of(*position)] += 1;
        }
        counts
    }

    /// A walk around a block, twice, with a step aside the second time.
    fn around() -> Vec<[f64; 3]> {
        let at = |k: u32| {
            let along = f64::from(k % 160) * 0.5;
            let aside = f64::from(k / 160) * 0.3;
            let (side, on) = ((along / 20.0) as usize, along % 20.0);
            match side {
                0 => [on, aside, 1.4],
                1 => [20.0 - aside, on, 1.4],
                2 => [20.0 - on, 20.0 - aside, 1.4],
                _ => [aside, 20.0 - on, 1.4],
            }
        };
        (0..320).map(at).collect()
    }

    #[test]
    fn few_positions_are_in_one_cell() {
        let positions = around();
        let cells = Cells::of_positions(&positions, 320, &SectorConfig::default());
        assert_eq!(cells.bounds(0), CellBox::ALL);
        assert_eq!((cells.count(), cells.cell_of([1e9, -4.0, 0.0])), (1, 0));
        assert_eq!(
            Cells::of_positions(&[], 5, &SectorConfig::default()).count(),
            1
        );
    }

    #[test]
    fn each_cell_has_its_share_and_each_point_one_cell() {
        let positions = around();
        let config = SectorConfig::default();
        for most in [200, 160, 100, 50, 33] {
            let cells = Cells::of_positions(&positions, most, &config);
            let counts = counts(&cells, &positions);
            assert!(counts.iter().all(|n| (1..=most).contains(n)), "{counts:?}");
            assert!(cells.count() <= 320_usize.div_ceil(most) + 2, "{counts:?}");
            // The boxes say the same as the tree, for points anywhere, also on borders.
            let borders: Vec<f64> = (0..cells.count())
                .flat_map(|cell| [cells.bounds(cell).min_m, cells.bounds(cell).max_m].concat())
                .filter(|border| border.is_finite())
                .collect();
            let along = || borders.iter().copied().chain([-1e6, 3.3, 1e6]);
            for (x, y) in along().flat_map(|x| along().map(move |y| (x, y))) {
                let inside = |cell: &usize| {
                    let CellBox { min_m, max_m } = cells.bounds(*cell);
                    let is_in = |k: usize, v: f64| min_m[k] <= v && v < max_m[k];
                    is_in(0, x) && is_in(1, y)
                };
                let of: Vec<usize> = (0..cells.count()).filter(inside).collect();
                assert_eq!(of, [cells.cell_of([x, y, 0.0])]);
            }
        }
    }

    #[test]
    fn a_place_that_is_passed_twice_is_in_one_cell() {
        let cells = Cells::of_positions(&around(), 100, &SectorConfig::default());
        assert!(cells.count() > 2);
        for place in [[10.0, 0.0], [20.0, 10.0], [10.0, 20.0]] {
            let [x, y] = place;
            let first = cells.cell_of([x, y, 0.0]);
            let inward = [0.97 * x + 0.3, 0.97 * y + 0.3, 0.0];
            assert_eq!(first, cells.cell_of(inward), "{place:?}");
        }
    }

    #[test]
    fn positions_without_extent_stay_together() {
        let config = SectorConfig::default();
        let still: Vec<[f64; 3]> = (0..90).map(|k| [0.01 * f64::from(k), 0.0, 0.0]).collect();
        assert_eq!(Cells::of_positions(&still, 10, &config).count(), 1);
        // Many at the ends, none between: no cut through equal ones.
        let mut ends = vec![[0.0, 1.0, 0.0]; 70];
        ends.extend([[5.0, 1.0, 0.0]; 30]);
        let cells = Cells::of_positions(&ends, 40, &config);
        assert_eq!(counts(&cells, &ends), [70, 30]);
        // Neighboring numbers.
        let next = f64::from_bits(5.0_f64.to_bits() + 1);
        assert_eq!(between(5.0, next), next);
    }

    #[test]
    fn neighbors_touch_and_distances_are_those_of_the_rectangles() {
        let positions: Vec<[f64; 3]> = (0..80).map(|k| [f64::from(k), 0.0, 0.0]).collect();
        let cells = Cells::of_positions(&positions, 20, &SectorConfig::default());
        assert_eq!(cells.count(), 4);
        assert_eq!(cells.within(0, 0.0), [0, 1]);
        assert_eq!(cells.within(2, 0.0), [1, 2, 3]);
        assert_eq!(cells.within(0, 19.0), [0, 1]);
        assert_eq!(cells.within(0, 21.0), [0, 1, 2]);
        let corner = CellBox {
            min_m: [3.0, 4.0],
            max_m: [5.0, 5.0],
        };
        let other = CellBox {
            min_m: [-1.0, -1.0],
            max_m: [0.0, 0.0],
        };
        assert_eq!(corner.distance_m(&other), 5.0);
        assert_eq!(corner.distance_m(&CellBox::ALL), 0.0);
    }
}
