//! Camera poses during the exposure of the rows of an image.
//!
//! Contract: one pose with a global shutter, one per row with a rolling shutter. Poses are computed
//! every [`MAX_STEP_S`] and interpolated linearly: at an angular acceleration of 200 rad/s² the
//! error is below 1e-6 rad, less than a thousandth of a pixel.

use nalgebra::{UnitQuaternion, Vector3};

use super::Shutter;
use super::placed::Motion;
use super::raster::View;

/// Maximum time between two computed poses, s.
const MAX_STEP_S: f64 = 2e-4;

type Pose = (Vector3<f64>, UnitQuaternion<f64>);

/// Times at which poses are computed, with the camera poses.
pub(super) struct Rows {
    /// Ascending times, each with the camera pose in the world.
    knots: Vec<(f64, Pose)>,
    /// Rows from one knot to the next.
    step: usize,
    /// Number of views.
    count: usize,
}

impl Rows {
    /// Rows of an image whose middle row is exposed at `time_s`.
    pub(super) fn new(
        shutter: Shutter,
        height: usize,
        eye_pose: &dyn Fn(f64) -> Pose,
        time_s: f64,
    ) -> Self {
        let knot = |t: f64| (t, eye_pose(t));
        match shutter {
            Shutter::Global => Self {
                knots: vec![knot(time_s)],
                step: 1,
                count: 1,
            },
            Shutter::Rolling { line_s } => {
                let step = ((MAX_STEP_S / line_s) as usize).clamp(1, height);
                let middle = 0.5 * (height - 1) as f64;
                let at = |row: usize| knot(time_s + line_s * (row as f64 - middle));
                // The last one is at or after the last row.
                let last = (height - 1).div_ceil(step);
                Self {
                    knots: (0..=last).map(|k| at(k * step)).collect(),
                    step,
                    count: height,
                }
            }
        }
    }

    /// Views of a body from the first row to the last.
    pub(super) fn views(&self, body: &dyn Motion) -> Vec<View> {
        let knots = self.knots.iter().map(|(t, eye)| view(eye, &body.at(*t)));
        let knots: Vec<View> = knots.collect();
        let between = |row: usize| {
            let (k, rest) = (row / self.step, row % self.step);
            match rest {
                0 => knots[k],
                _ => mix(&knots[k], &knots[k + 1], rest as f32 / self.step as f32),
            }
        };
        (0..self.count).map(between).collect()
    }

    /// A few views: near the first, the middle and the last row.
    pub(super) fn few(&self, body: &dyn Motion) -> Vec<View> {
        let last = self.knots.len() - 1;
        let mut some = vec![0, last / 2, last];
        some.dedup();
        let at = |k: usize| view(&self.knots[k].1, &body.at(self.knots[k].0));
        some.into_iter().map(at).collect()
    }
}

/// Converts a camera pose in the world to a view of a body with a pose in the world.
fn view(eye: &Pose, body: &Pose) -> View {
    let origin = body.1.inverse() * (eye.0 - body.0);
    let rotation = (eye.1.inverse() * body.1).to_rotation_matrix();
    let m = rotation.matrix();
    View {
        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)] as f32)),
        origin: [origin.x as f32, origin.y as f32, origin.z as f32],
    }
}

fn mix(a: &View, b: &View, part: f32) -> View {
    let mix = |a: f32, b: f32| a + (b - a) * part;
    View {
        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| mix(a.rotation[i][j], b.rotation[i][j]))),
        origin: [0, 1, 2].map(|i| mix(a.origin[i], b.origin[i])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cad_transforms::so3;

    /// Agreement with the reference implementation, a pose for every row. Camera and body rotate
    /// with about 500 rad/s² relative to each other.
    #[test]
    fn interpolated_views_agree_with_poses_per_row() {
        let swing = |t: f64, hz: f64, size: f64| {
            let angle = 2.0 * std::f64::consts::PI * hz * t;
            Vector3::new(angle.sin(), (1.1 * angle).cos(), (0.9 * angle).sin()) * size
        };
        let eye = |t: f64| (swing(t, 5.0, 0.05), so3::exp(swing(t, 6.0, 0.15)));
        let body = |t: f64| (swing(t, 2.0, 0.3), so3::exp(swing(t, 3.0, 0.4)));
        let (height, line_s) = (376, 0.0085 / 376.0);
        let rows = Rows::new(Shutter::Rolling { line_s }, height, &eye, 1.3);
        assert!(rows.knots.len() < height / 6);
        let views = rows.views(&body);
        assert_eq!(views.len(), height);
        for (row, found) in views.iter().enumerate() {
            let t = 1.3 + line_s * (row as f64 - 187.5);
            let expected = view(&eye(t), &body(t));
            let pairs = found.rotation.as_flattened().iter().chain(&found.origin);
            let expected = expected
                .rotation
                .as_flattened()
                .iter()
                .chain(&expected.origin);
            for (a, b) in pairs.zip(expected) {
                assert!((a - b).abs() < 2.5e-6, "row {row}: {a} {b}");
            }
        }
        let once = Rows::new(Shutter::Global, height, &eye, 1.3);
        assert_eq!(once.views(&body), [view(&eye(1.3), &body(1.3))]);
        assert_eq!(once.few(&body), once.views(&body));
    }
}
