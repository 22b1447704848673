//! Voxel grid: one point for all points in a voxel.
//!
//! A point is the mean of the observations in its voxel, each weighted by the inverse square of its
//! sigma. Pixels of one view are not independent, so together they weigh as much as one of them;
//! views count as independent. The sigma of a point is therefore that of depth only: errors common
//! to all views, such as those of calibration or pose, are not included.

use std::collections::HashMap;

use scene_bundle::outputs::cloud::CloudPoint;

/// A point of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    /// m.
    pub(super) x_in_world: [f64; 3],
    /// One standard deviation, m.
    pub(super) sigma_m: f64,
    /// Red, green, blue.
    pub(super) color: [u8; 3],
}

/// Weighted sums. Positions are relative to the center of the voxel, so that single precision is
/// enough.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    weight: f32,
    offset: [f32; 3],
    color: [f32; 3],
}

/// All voxels with observations.
#[derive(Debug)]
pub(super) struct Voxels {
    /// Edge of a voxel, m.
    edge_m: f64,
    cells: HashMap<[i32; 3], Sums>,
}

impl Sums {
    fn add(&mut self, weight: f32, offset: [f32; 3], color: [f32; 3]) {
        self.weight += weight;
        for k in 0..3 {
            self.offset[k] += weight * offset[k];
            self.color[k] += weight * color[k];
        }
    }

    /// Mean position and color.
    fn means(&self) -> ([f32; 3], [f32; 3]) {
        let mean = |sum: f32| sum / self.weight;
        (self.offset.map(mean), self.color.map(mean))
    }
}

/// Center of a cell, m.
fn middle(edge_m: f64, cell: [i32; 3]) -> [f64; 3] {
    cell.map(|c| (f64::from(c) + 0.5) * edge_m)
}

impl Voxels {
    /// An empty grid with this edge of a voxel, m.
    pub(super) fn new(edge_m: f64) -> Self {
        Self {
            edge_m,
            cells: HashMap::new(),
        }
    }

    /// Adds the points of one view.
    pub(super) fn add(&mut self, points: &[Point]) {
        let mut of_look: HashMap<[i32; 3], (u32, Sums)> = HashMap::new();
        for point in points {
            let cell = point.x_in_world.map(|c| (c / self.edge_m).floor() as i32);
            let middle = middle(self.edge_m, cell);
            let offset = [0, 1, 2].map(|k| (point.x_in_world[k] - middle[k]) as f32);
            let (count, sums) = of_look.entry(cell).or_default();
            *count += 1;
            let weight = 1.0 / (point.sigma_m * point.sigma_m);
            sums.add(weight as f32, offset, point.color.map(f32::from));
        }
        for (cell, (count, sums)) in of_look {
            let (offset, color) = sums.means();
            let weight = sums.weight / count as f32;
            self.cells
                .entry(cell)
                .or_default()
                .add(weight, offset, color);
        }
    }

    /// One point for each voxel, in the order of their positions.
    pub(super) fn into_points(self) -> Vec<CloudPoint> {
        let Self { edge_m, cells } = self;
        let mut cells: Vec<([i32; 3], Sums)> = cells.into_iter().collect();
        cells.sort_unstable_by_key(|(cell, _)| *cell);
        let point = |(cell, sums): &([i32; 3], Sums)| {
            let (offset, color) = sums.means();
            let middle = middle(edge_m, *cell);
            CloudPoint {
                x_in_world: [0, 1, 2].map(|k| (middle[k] + f64::from(offset[k])) as f32),
                color: color.map(|c| c.round() as u8),
                sigma_m: 1.0 / sums.weight.sqrt(),
            }
        };
        cells.iter().map(point).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f64, sigma_m: f64, gray: u8) -> Point {
        Point {
            x_in_world: [x, 0.01, -0.02],
            sigma_m,
            color: [gray; 3],
        }
    }

    #[test]
    fn a_voxel_has_the_weighted_mean_and_each_view_counts_once() {
        let mut voxels = Voxels::new(0.05);
        voxels.add(&[point(0.010, 0.02, 100); 7]);
        voxels.add(&[point(0.020, 0.04, 200)]);
        voxels.add(&[point(-0.010, 0.03, 50)]);
        let points = voxels.into_points();
        assert_eq!(points.len(), 2);
        let near = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-6;
        assert!(near(points[0].x_in_world[0], -0.010));
        // Weights of 4 and 1, whatever the number of pixels.
        assert!(near(points[1].x_in_world[0], 0.012), "{:?}", points[1]);
        assert_eq!(points[1].color, [120; 3]);
        let together = 1.0 / (1.0 / 0.02_f64.powi(2) + 1.0 / 0.04_f64.powi(2)).sqrt();
        assert!(near(points[1].sigma_m, together));
    }

    #[test]
    fn far_points_are_as_accurate() {
        let mut voxels = Voxels::new(0.05);
        voxels.add(&[point(812.345, 0.02, 1)]);
        let x = voxels.into_points()[0].x_in_world[0];
        assert!((f64::from(x) - 812.345).abs() < 1e-4);
    }
}
