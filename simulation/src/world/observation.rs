//! Observation vector: what an agent knows besides images.

use std::ops::Range;

use super::config::WorldConfig;
use crate::agent::AgentState;
use crate::episode::Task;
use crate::episode::task::MAX_GOAL_M;
use crate::ground::Ground;

/// A named part of the observation vector.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservationField {
    /// Its name: `goal`, `command`, `velocity`, `attitude`, `heights` or `rays`.
    pub name: &'static str,
    /// Its elements.
    pub elements: Range<usize>,
}

/// Elements of the observation vector with their bounds, which values are clipped to.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub(crate) fields: Vec<ObservationField>,
    pub(crate) low: Vec<f32>,
    pub(crate) high: Vec<f32>,
    /// Points of the scan, forward and left of the agent, m.
    scan_m: Vec<[f64; 2]>,
    max_scan_m: f64,
    /// Directions of rays, forward and left.
    rays: Vec<[f64; 2]>,
    max_ray_m: f64,
}

/// Edges and bumps under the agent end no ray up to here, m: it stands on them already.
const RAY_BEGIN_M: f64 = 0.15;

impl Layout {
    pub(crate) fn new(config: &WorldConfig) -> Self {
        let scan = &config.observation;
        let point = |row: usize, column: usize| {
            let left = 0.5 * (scan.scan_columns as f64 - 1.0) - column as f64;
            [(row + 1) as f64, left].map(|v| v * scan.scan_spacing_m)
        };
        let columns = |row| (0..scan.scan_columns).map(move |column| point(row, column));
        let ray = |k: usize| {
            let angle = std::f64::consts::TAU * k as f64 / scan.rays as f64;
            [libm::cos(angle), libm::sin(angle)]
        };
        let mut layout = Self {
            fields: Vec::new(),
            low: Vec::new(),
            high: Vec::new(),
            scan_m: (0..scan.scan_rows).flat_map(columns).collect(),
            max_scan_m: scan.max_scan_m,
            rays: (0..scan.rays).map(ray).collect(),
            max_ray_m: scan.max_ray_m,
        };
        let pi = std::f64::consts::PI;
        let speed = config.agent.max_speed_m_s * config.randomization.speed_scale[1];
        let yaw_rate = config.agent.max_yaw_rate_rad_s * config.randomization.yaw_rate_scale[1];
        match config.task.task {
            Task::Velocity => layout.add(
                "command",
                [config.task.command_m_s, config.task.command_rad_s],
            ),
            _ => layout.add("goal", [[0.0, MAX_GOAL_M], [-pi, pi]]),
        }
        layout.add(
            "velocity",
            [speed, speed, yaw_rate].map(|limit| [-limit, limit]),
        );
        layout.add("attitude", [[-pi, pi], [-0.5 * pi, 0.5 * pi]]);
        let heights = vec![[-layout.max_scan_m, layout.max_scan_m]; layout.scan_m.len()];
        layout.add("heights", heights);
        let rays = vec![[0.0, layout.max_ray_m]; layout.rays.len()];
        layout.add("rays", rays);
        layout
    }

    fn add(&mut self, name: &'static str, bounds: impl IntoIterator<Item = [f64; 2]>) {
        let first = self.low.len();
        for [low, high] in bounds {
            self.low.push(low as f32);
            self.high.push(high as f32);
        }
        let elements = first..self.low.len();
        if !elements.is_empty() {
            self.fields.push(ObservationField { name, elements });
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.low.len()
    }

    /// Writes the observation of an agent. `target` is the goal's distance and bearing (counter-
    /// clockwise from the heading; Habitat-Lab's polar goal), or the command.
    pub(crate) fn write(
        &self,
        ground: &Ground,
        state: &AgentState,
        target: [f64; 2],
        into: &mut [f32],
    ) {
        let (sine, cosine) = (libm::sin(state.yaw_rad), libm::cos(state.yaw_rad));
        let [x, y, z] = state.position_m;
        let at = |[forward, left]: [f64; 2]| {
            [
                x + forward * cosine - left * sine,
                y + forward * sine + left * cosine,
            ]
        };
        let head = [
            target[0],
            target[1],
            state.velocity[0],
            state.velocity[1],
            state.velocity[2],
            state.roll_rad,
            state.pitch_rad,
        ];
        let heights = self.scan_m.iter().map(|point| {
            let surface = ground.surface(at(*point), z);
            surface.map_or(-self.max_scan_m, |surface| surface.height_m - z)
        });
        let rays = self.rays.iter().map(|direction| {
            let direction = [
                direction[0] * cosine - direction[1] * sine,
                direction[0] * sine + direction[1] * cosine,
            ];
            self.ray_m(ground, [x, y], state.level, direction)
        });
        let values = head.into_iter().chain(heights).chain(rays);
        let bounds = self.low.iter().zip(&self.high);
        for ((element, value), (low, high)) in into.iter_mut().zip(values).zip(bounds) {
            *element = (value as f32).clamp(*low, *high);
        }
    }

    /// Length of a ray up to where the ground has no clearance, at most the longest: sphere tracing
    /// of the distance to edges, obstacles and unknown cells, in steps of at least a cell.
    fn ray_m(&self, ground: &Ground, from: [f64; 2], level: usize, direction: [f64; 2]) -> f64 {
        let layer = &ground.layers()[level];
        let least_step_m = layer.grid().cell_m;
        let mut length_m = 0.0;
        while length_m < self.max_ray_m {
            let at = [0, 1].map(|k| from[k] + length_m * direction[k]);
            let clearance_m = layer.clearance_m(at);
            if clearance_m <= 0.0 && length_m >= RAY_BEGIN_M {
                return length_m;
            }
            length_m += clearance_m.max(least_step_m);
        }
        self.max_ray_m
    }
}

/// Distance, m, and bearing of a point as an agent sees it, horizontally.
pub(crate) fn polar(state: &AgentState, goal_m: [f64; 3]) -> [f64; 2] {
    let [x, y] = [0, 1].map(|k| goal_m[k] - state.position_m[k]);
    let (sine, cosine) = (libm::sin(state.yaw_rad), libm::cos(state.yaw_rad));
    let (forward, left) = (x * cosine + y * sine, y * cosine - x * sine);
    [(x * x + y * y).sqrt(), libm::atan2(left, forward)]
}
