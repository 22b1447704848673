//! Where the depths of a plane end and something farther begins.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::assignment::{Assigner, Assignment, Extent, NONE, STRIDE};
use crate::view::{DepthView, PixelClass, Pose};

/// Difference to a plane from which on a depth beside it is farther, in its sigmas and m.
const FARTHER_SIGMAS: f64 = 5.0;
const FARTHER_M: f64 = 0.03;
/// Pixels from the last one of a plane within which something farther is searched. Matchers join
/// both sides of a depth step by a ramp of some pixels, whatever the size of the image.
const RAMP_PX: usize = 14;
/// Pixels behind the first farther one that are still of the ramp.
const RAMP_END_PX: usize = 3;
/// Pixels to both sides of the middle of a ramp over which its slope is measured, and the least
/// slope against the plane: 63 degrees. Rough ground is less steep.
const SLOPE_PX: f64 = 2.0;
const MIN_RAMP_SLOPE: f64 = 2.0;

/// Points in coordinates of planes: where depths beside the last pixel of a plane are half as far
/// behind it as what is there. The plane ends there; where depths beside are nearer, the plane may
/// go on behind them.
///
/// *Why the half:* on simulated stairs ramps of the preset `balanced` are 3 to 12 pixels long, and
/// their middle is within 2 pixels of the edge; where they begin is up to 8 pixels before it.
pub(crate) fn ends(assigner: &Assigner<'_>, assignment: &Assignment) -> Vec<(u16, [f64; 2])> {
    let columns = assignment.columns;
    let rows = assignment.labels.len() / columns.max(1);
    let found: Vec<Vec<(u16, [f64; 2])>> = (0..rows)
        .into_par_iter()
        .map(|row| {
            let mut found = Vec::new();
            for column in 0..columns {
                let sample = row * columns + column;
                let label = assignment.labels[sample];
                let is_change = |other: usize| assignment.labels[other] != label;
                if column + 1 < columns && is_change(sample + 1) {
                    between(assigner, [column, row], [1, 0], &mut found);
                }
                if row + 1 < rows && is_change(sample + columns) {
                    between(assigner, [column, row], [0, 1], &mut found);
                }
            }
            found
        })
        .collect();
    found.into_iter().flatten().collect()
}

/// Ends of planes at the pixels from one sample to the next.
fn between(
    assigner: &Assigner<'_>,
    sample: [usize; 2],
    step: [usize; 2],
    found: &mut Vec<(u16, [f64; 2])>,
) {
    let pixel = |k: usize| [0, 1].map(|axis| STRIDE * sample[axis] + k * step[axis]);
    let label = |[u, v]: [usize; 2]| assigner.hit(u, v).map_or(NONE, |hit| hit.plane);
    let labels: [u16; STRIDE + 1] = std::array::from_fn(|k| label(pixel(k)));
    for k in 0..STRIDE {
        if labels[k] == labels[k + 1] {
            continue;
        }
        for (from, sign) in [(k, 1.0), (k + 1, -1.0)] {
            if labels[from] == NONE {
                continue;
            }
            let end = End {
                extent: &assigner.extents[usize::from(labels[from])],
                view: assigner.view,
                pose: &assigner.pose,
                from: pixel(from).map(|v| v as f64),
                direction: step.map(|s| sign * s as f64),
            };
            found.extend(end.position().map(|end| (labels[from], end)));
        }
    }
}

/// A plane and its last pixel in a direction.
struct End<'a> {
    extent: &'a Extent,
    view: &'a DepthView<'a>,
    pose: &'a Pose,
    from: [f64; 2],
    direction: [f64; 2],
}

impl End<'_> {
    /// Coordinates of the point where the plane ends.
    fn position(&self) -> Option<[f64; 2]> {
        // Depths behind the plane, by the number of pixels from its last one.
        let mut ramp: Vec<(f64, f64)> = vec![(0.0, 0.0)];
        let (mut farthest, mut last) = (0.0f64, RAMP_PX);
        for n in 1..=RAMP_PX + RAMP_END_PX {
            if n > last || self.class(n as f64) != PixelClass::Static {
                break;
            }
            let Some((behind, sigma)) = self.behind(n as f64) else {
                continue;
            };
            ramp.push((n as f64, behind));
            let is_farther = behind >= FARTHER_M.max(FARTHER_SIGMAS * sigma);
            if is_farther && farthest == 0.0 {
                last = n + RAMP_END_PX;
            }
            if is_farther {
                farthest = farthest.max(behind);
            }
        }
        if farthest == 0.0 {
            return None;
        }
        let half = 0.5 * farthest;
        let crossing = ramp.windows(2).find(|pair| pair[1].1 >= half)?;
        let [(n, a), (m, b)] = [crossing[0], crossing[1]];
        let at = n + (m - n) * ((half - a) / (b - a)).clamp(0.0, 1.0);
        // Else depths may be those of a riser that is seen, or of rough ground.
        if !self.is_ramp(at) {
            return None;
        }
        let x = self.on_plane(at)?;
        let [s, t, _] = self.extent.frame.coordinates(&x);
        Some([s, t])
    }

    fn pixel(&self, n: f64) -> [f64; 2] {
        [0, 1].map(|k| self.from[k] + n * self.direction[k])
    }

    fn index(&self, [u, v]: [f64; 2]) -> Option<usize> {
        let size = self.view.size.map(|size| size as f64);
        let inside = u >= 0.0 && v >= 0.0 && u < size[0] && v < size[1];
        inside.then(|| v as usize * self.view.size[0] + u as usize)
    }

    fn class(&self, n: f64) -> PixelClass {
        let index = self.index(self.pixel(n));
        index.map_or(PixelClass::Excluded, |index| self.view.class(index))
    }

    /// Depth of the plane, at the pose of the row.
    fn depth_of_plane(&self, [u, v]: [f64; 2]) -> Option<f64> {
        let from = Vector3::from(self.view.position(self.pose, u, v, 0.0));
        let to = Vector3::from(self.view.position(self.pose, u, v, 1.0));
        let normal = &self.extent.frame.normal;
        let slope = normal.dot(&(to - from));
        // Rays from outside only, and not along the plane.
        (slope < -0.05).then(|| normal.dot(&(self.extent.frame.origin - from)) / slope)
    }

    /// Depth of a pixel behind the plane, and its sigma.
    fn behind(&self, n: f64) -> Option<(f64, f64)> {
        self.behind_at(self.pixel(n))
    }

    fn behind_at(&self, pixel: [f64; 2]) -> Option<(f64, f64)> {
        let (depth, sigma) = self.view.depth(self.index(pixel)?)?;
        let behind = f64::from(depth) - self.depth_of_plane(pixel)?;
        Some((behind, f64::from(sigma)))
    }

    fn on_plane(&self, n: f64) -> Option<Vector3<f64>> {
        self.on_plane_at(self.pixel(n))
    }

    fn on_plane_at(&self, [u, v]: [f64; 2]) -> Option<Vector3<f64>> {
        let depth = self.depth_of_plane([u, v])?;
        Some(self.view.position(self.pose, u, v, depth).into())
    }

    /// Whether depths around a pixel fall too steeply for ground, away from the eye: only rays that
    /// pass over an edge do not see the riser below it.
    fn is_ramp(&self, n: f64) -> bool {
        let [u, v] = self.pixel(n).map(f64::round);
        let around = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
        let behind = around.map(|[du, dv]| self.behind_at([u + SLOPE_PX * du, v + SLOPE_PX * dv]));
        let [Some(right), Some(left), Some(below), Some(above)] = behind else {
            return false;
        };
        let gradient = [right.0 - left.0, below.0 - above.0];
        let fall = gradient[0].hypot(gradient[1]);
        let [du, dv] = gradient.map(|g| SLOPE_PX * g / fall.max(1e-9));
        let (from, to) = ([u - du, v - dv], [u + du, v + dv]);
        let [Some(from), Some(to)] = [from, to].map(|pixel| self.on_plane_at(pixel)) else {
            return false;
        };
        let eye = Vector3::from(self.view.position(self.pose, u, v, 0.0));
        fall >= MIN_RAMP_SLOPE * (to - from).norm() && (to - eye).dot(&(to - from)) > 0.0
    }
}
