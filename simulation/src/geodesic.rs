//! Lengths of shortest paths to a goal over walkable ground.
//!
//! Contract: paths are taut strings around what blocks the agent, not chains of eight directions:
//! lengths are horizontal, at most half a percent above those of a visibility graph. The method is
//! Dijkstra's with visibility from the point before (Theta*: Nash, Daniel, Koenig and Felner
//! 2007), so that the predecessor of a cell is the next corner of its path.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::agent::AgentConfig;
use crate::ground::Ground;
use crate::ground::{Layer, neighbors};

/// Not reached.
const NONE: u32 = u32::MAX;

/// Distances to a goal.
///
/// ```
/// use simulation::testing::SyntheticScene;
/// use simulation::{AgentConfig, DistanceField, Ground};
///
/// let plane = SyntheticScene::tilted_plane([0.0, 0.0])?;
/// let levels = plane.scene.sectors[0].levels.as_ref().unwrap();
/// let config = AgentConfig::default();
/// let ground = Ground::new(levels.to_vec(), &config)?;
/// let field = DistanceField::new(&ground, &config, [1.0, 1.0, 0.0]);
/// let distance = field.distance_m([4.0, 5.0, 0.0]).unwrap();
/// assert!((distance - 5.0).abs() < 0.05);
/// assert!(field.direction([4.0, 5.0, 0.0]).unwrap()[0] < 0.0);
/// assert_eq!(field.distance_m([40.0, 5.0, 0.0]), None);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Clone, Debug)]
pub struct DistanceField {
    goal_m: [f64; 3],
    max_step_m: f64,
    levels: Vec<FieldLevel>,
}

/// Distances of a level.
#[derive(Clone, Debug)]
struct FieldLevel {
    grid: scene_bundle::outputs::grid::Grid,
    /// Height of the ground of each cell, m; NaN where none is known.
    heights_m: Vec<f32>,
    /// Next corner of the path from each cell: its position, m, and the distance from there, m.
    corners: Vec<Corner>,
}

/// A corner of a path.
#[derive(Clone, Copy, Debug)]
struct Corner {
    at_m: [f32; 2],
    /// Length of the path from it to the goal, m; infinite where there is none.
    left_m: f32,
}

impl DistanceField {
    /// Distances to a goal on the ground, m. Where the agent cannot be at the goal, the field is
    /// empty.
    pub fn new(ground: &Ground, agent: &AgentConfig, goal_m: [f64; 3]) -> Self {
        Search::new(ground, agent.max_step_m).run(goal_m)
    }

    /// The goal, m.
    pub fn goal_m(&self) -> [f64; 3] {
        self.goal_m
    }

    /// Length of the shortest path from a position, m; `None` where there is none.
    pub fn distance_m(&self, at_m: [f64; 3]) -> Option<f64> {
        let corner = self.corner(at_m)?;
        let offset = [0, 1].map(|k| f64::from(corner.at_m[k]) - at_m[k]);
        Some(f64::from(corner.left_m) + (offset[0] * offset[0] + offset[1] * offset[1]).sqrt())
    }

    /// Horizontal unit vector along the shortest path from a position; `None` at the goal and where
    /// there is no path.
    pub fn direction(&self, at_m: [f64; 3]) -> Option<[f64; 2]> {
        let corner = self.corner(at_m)?;
        let offset = [0, 1].map(|k| f64::from(corner.at_m[k]) - at_m[k]);
        let length = (offset[0] * offset[0] + offset[1] * offset[1]).sqrt();
        (length > 1e-6).then(|| offset.map(|v| v / length))
    }

    /// Next corner of the path from the cell at a position, on the ground of nearest height; of
    /// levels that a step connects there, on the one with a path.
    fn corner(&self, at_m: [f64; 3]) -> Option<Corner> {
        // The difference in height of a level, m, and its corner.
        let cells = || {
            self.levels.iter().filter_map(|level| {
                let cell = level.grid.cell([at_m[0], at_m[1]])?;
                let difference_m = (f64::from(level.heights_m[cell]) - at_m[2]).abs();
                (!difference_m.is_nan()).then_some((difference_m, level.corners[cell]))
            })
        };
        let (nearest_m, _) = cells().min_by(|a, b| a.0.total_cmp(&b.0))?;
        let reachable = cells().filter(|(difference_m, corner)| {
            *difference_m <= nearest_m + self.max_step_m && corner.left_m.is_finite()
        });
        let (_, corner) = reachable.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(corner)
    }
}

/// A search over the cells of all levels.
struct Search<'a> {
    ground: &'a Ground,
    max_step_m: f64,
    /// Number of the first cell of each level.
    first: Vec<usize>,
    distance_m: Vec<f64>,
    /// Cell of the next corner.
    parent: Vec<u32>,
}

impl<'a> Search<'a> {
    fn new(ground: &'a Ground, max_step_m: f64) -> Self {
        let mut first = vec![0];
        for layer in ground.layers() {
            first.push(first[first.len() - 1] + layer.grid().cells());
        }
        let count = first[first.len() - 1];
        Self {
            ground,
            max_step_m,
            first,
            distance_m: vec![f64::INFINITY; count],
            parent: vec![NONE; count],
        }
    }

    fn layer(&self, node: usize) -> (usize, &'a Layer, usize) {
        let level = self.first.partition_point(|first| *first <= node) - 1;
        (
            level,
            &self.ground.layers()[level],
            node - self.first[level],
        )
    }

    fn run(mut self, goal_m: [f64; 3]) -> DistanceField {
        let at_m = [goal_m[0], goal_m[1]];
        let surface = self.ground.surface(at_m, goal_m[2]);
        let start = surface.and_then(|surface| {
            let layer = &self.ground.layers()[surface.level];
            let cell = layer.grid().cell(at_m)?;
            layer.walkable_m(cell)?;
            Some(self.first[surface.level] + cell)
        });
        if let Some(start) = start {
            self.spread(start);
        }
        let levels = self.ground.layers().iter().enumerate();
        let levels = levels.map(|(number, layer)| {
            let cells = 0..layer.grid().cells();
            let heights = cells.clone().map(|cell| layer.height_of_cell_m(cell));
            FieldLevel {
                grid: *layer.grid(),
                heights_m: heights.collect(),
                corners: cells
                    .map(|cell| self.corner(self.first[number] + cell, start, at_m))
                    .collect(),
            }
        });
        DistanceField {
            goal_m,
            max_step_m: self.max_step_m,
            levels: levels.collect(),
        }
    }

    fn corner(&self, node: usize, start: Option<usize>, goal_m: [f64; 2]) -> Corner {
        if !self.distance_m[node].is_finite() {
            let at_m = [0.0; 2];
            let left_m = f32::INFINITY;
            return Corner { at_m, left_m };
        }
        let parent = self.parent[node] as usize;
        // The goal is a point in its cell.
        let at_m = match Some(parent) == start {
            true => goal_m,
            false => self.center_m(parent),
        };
        Corner {
            at_m: at_m.map(|v| v as f32),
            left_m: self.distance_m[parent] as f32,
        }
    }

    fn center_m(&self, node: usize) -> [f64; 2] {
        let (_, layer, cell) = self.layer(node);
        layer.grid().center_m(cell)
    }

    fn spread(&mut self, start: usize) {
        let key = |distance_m: f64, node: usize| Reverse((distance_m.to_bits(), node));
        let mut open = BinaryHeap::new();
        self.distance_m[start] = 0.0;
        self.parent[start] = start as u32;
        open.push(key(0.0, start));
        let mut is_closed = vec![false; self.parent.len()];
        while let Some(Reverse((_, node))) = open.pop() {
            if std::mem::replace(&mut is_closed[node], true) {
                continue;
            }
            let (level, _, cell) = self.layer(node);
            for (to_level, to_cell) in neighbors(self.ground.layers(), self.max_step_m, level, cell)
            {
                let to = self.first[to_level] + to_cell;
                if is_closed[to] {
                    continue;
                }
                let parent = self.parent[node] as usize;
                let via = if self.is_visible(parent, to) {
                    parent
                } else {
                    node
                };
                let distance_m = self.distance_m[via] + self.length_m(via, to);
                if distance_m < self.distance_m[to] {
                    self.distance_m[to] = distance_m;
                    self.parent[to] = via as u32;
                    open.push(key(distance_m, to));
                }
            }
        }
    }

    fn length_m(&self, a: usize, b: usize) -> f64 {
        let (a, b) = (self.center_m(a), self.center_m(b));
        ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt()
    }

    /// Whether the agent can walk straight from one cell to another: on one level, over cells that
    /// the line passes, each at most a step from the one before.
    fn is_visible(&self, from: usize, to: usize) -> bool {
        let (level, layer, a) = self.layer(from);
        let (other, _, b) = self.layer(to);
        if level != other {
            return false;
        }
        let columns = layer.grid().columns;
        let place = |cell: usize| [(cell % columns) as i64, (cell / columns) as i64];
        let (a, b) = (place(a), place(b));
        let span = [0, 1].map(|k| (b[k] - a[k]).abs());
        let sign = [0, 1].map(|k| (b[k] - a[k]).signum());
        let mut at = a;
        let mut error = span[0] - span[1];
        let Some(mut height_m) = layer.walkable_m((at[1] * columns as i64 + at[0]) as usize) else {
            return false;
        };
        // Every cell that the line touches (Amanatides and Woo 1987), with integers.
        for _ in 0..span[0] + span[1] {
            match error.cmp(&0) {
                std::cmp::Ordering::Greater => {
                    at[0] += sign[0];
                    error -= 2 * span[1];
                }
                std::cmp::Ordering::Less => {
                    at[1] += sign[1];
                    error += 2 * span[0];
                }
                std::cmp::Ordering::Equal => {
                    // Through the corner of four cells, of which none may block.
                    let beside = [(at[0] + sign[0], at[1]), (at[0], at[1] + sign[1])];
                    let is_free =
                        |(x, y): (i64, i64)| layer.walkable_m((y * columns as i64 + x) as usize);
                    if beside.into_iter().any(|place| is_free(place).is_none()) {
                        return false;
                    }
                    at[0] += sign[0];
                    at[1] += sign[1];
                    error += 2 * (span[0] - span[1]);
                }
            }
            let index = (at[1] * columns as i64 + at[0]) as usize;
            let Some(next_m) = layer.walkable_m(index) else {
                return false;
            };
            if f64::from((next_m - height_m).abs()) > self.max_step_m {
                return false;
            }
            height_m = next_m;
            if at == b {
                break;
            }
        }
        at == b
    }
}
