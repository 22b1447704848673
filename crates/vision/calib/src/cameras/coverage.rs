//! Image coverage: which parts of the image have observations, and from which directions.

use cad_transforms::RigidTransform;

use super::config::CoverageConfig;
use crate::adjust::Point;

/// Columns and rows of the coverage map.
const CELLS: (usize, usize) = (12, 8);

/// Coverage of one eye.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Number of views used.
    pub views: usize,
    /// Corners per cell of the image, rows first.
    pub cells: Vec<u32>,
    /// Number of views with corners near the left, right, upper and lower border.
    pub borders: [usize; 4],
    /// Largest tilt of a target against the image plane, degrees.
    pub largest_tilt_deg: f64,
    /// Number of views tilted by more than [`CoverageConfig::min_tilt_deg`].
    pub tilted: usize,
    /// Nearest and farthest target, m.
    pub distances_m: (f64, f64),
}

impl Coverage {
    /// Coverage by views with poses `eye_from_target`.
    pub fn of<'a>(
        (width, height): (u32, u32),
        views: impl IntoIterator<Item = (RigidTransform, &'a [Point])>,
        config: &CoverageConfig,
    ) -> Self {
        let border = config.border_ratio;
        let mut all = Self {
            views: 0,
            cells: vec![0; CELLS.0 * CELLS.1],
            borders: [0; 4],
            largest_tilt_deg: 0.0,
            tilted: 0,
            distances_m: (f64::INFINITY, 0.0),
        };
        let (w, h) = (f64::from(width), f64::from(height));
        for (eye_from_target, points) in views {
            all.views += 1;
            let mut near = [false; 4];
            for point in points {
                let (x, y) = ((point.pixel[0] + 0.5) / w, (point.pixel[1] + 0.5) / h);
                let cell = |v: f64, n: usize| ((v * n as f64).max(0.0) as usize).min(n - 1);
                all.cells[cell(y, CELLS.1) * CELLS.0 + cell(x, CELLS.0)] += 1;
                let sides = [x < border, x > 1.0 - border, y < border, y > 1.0 - border];
                near.iter_mut()
                    .zip(sides)
                    .for_each(|(near, side)| *near |= side);
            }
            all.borders
                .iter_mut()
                .zip(near)
                .for_each(|(n, near)| *n += usize::from(near));
            let n = points.len().max(1) as f64;
            let middle =
                std::array::from_fn(|i| points.iter().map(|p| p.x_in_target[i]).sum::<f64>() / n);
            let at = eye_from_target.apply(middle);
            let distance = at.iter().map(|v| v * v).sum::<f64>().sqrt();
            let normal = eye_from_target.rotate([0.0, 0.0, 1.0]);
            let tilt = normal[2].abs().min(1.0).acos().to_degrees();
            all.largest_tilt_deg = all.largest_tilt_deg.max(tilt);
            all.tilted += usize::from(tilt > config.min_tilt_deg);
            all.distances_m.0 = all.distances_m.0.min(distance);
            all.distances_m.1 = all.distances_m.1.max(distance);
        }
        all
    }

    /// What is missing, as instructions for the user.
    pub fn missing(&self, config: &CoverageConfig) -> Vec<String> {
        let mut missing = Vec::new();
        let names = ["left", "right", "upper", "lower"];
        let absent: Vec<&str> = names
            .iter()
            .zip(self.borders)
            .filter(|(_, views)| *views < config.min_views)
            .map(|(name, _)| *name)
            .collect();
        if !absent.is_empty() {
            missing.push(format!(
                "hardly any views near the {} edge: hold the target there",
                absent.join(", ")
            ));
        }
        if self.tilted < config.min_views {
            missing.push(format!(
                "only {} views with the target tilted by more than {:.0} degrees (the largest is {:.0}): \
                 tilt it to all sides",
                self.tilted, config.min_tilt_deg, self.largest_tilt_deg
            ));
        }
        missing
    }
}
