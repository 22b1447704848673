//! Rolling-shutter compensation: motion of a view while its rows are exposed one after another.
//!
//! A rolling shutter exposes the lowest row some milliseconds after the topmost one, and a walker
//! rotates by a fraction of a degree meanwhile. Points of a row are transformed to the pose at the
//! exposure of the middle row, which is known: to first order in time.

use cad_transforms::RigidTransform;
use scene_bundle::Trajectory;
use scene_bundle::outputs::depth::DepthView;
use scene_bundle::outputs::rig::RigCamera;

use crate::pipeline::stages::pose_interpolation::pose_at;

/// Time over which the motion is measured, ns.
const STEP_NS: i64 = 10_000_000;

/// See the module. The default is a global shutter, or a view at rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RowMotion {
    /// Exposure offset of the topmost row of the view against the middle row of the recorded image,
    /// and of each row against the one above, s.
    first_s: f64,
    row_s: f64,
    /// Velocity and angular rate of the view in its own axes, m/s and rad/s.
    speed: [f64; 3],
    rate: [f64; 3],
}

impl RowMotion {
    /// Motion of a frame at a time.
    pub(super) fn new(
        camera: &RigCamera,
        view: &DepthView,
        trajectory: &Trajectory,
        time_ns: i64,
    ) -> Self {
        let pose = |time_ns: i64| {
            let world_from_rig = pose_at(trajectory, time_ns)?;
            Some(world_from_rig * camera.rig_from_left * view.view_from_left.inverse())
        };
        let motion = pose(time_ns - STEP_NS / 2)
            .zip(pose(time_ns + STEP_NS / 2))
            .map(|(from, to)| from.inverse() * to);
        let Some(motion) = motion.filter(|_| camera.line_s > 0.0) else {
            return Self::default();
        };
        Self::of(camera, view, &motion, STEP_NS as f64 * 1e-9)
    }

    /// From a motion in `seconds`. Rectification rotates rows only slightly.
    fn of(camera: &RigCamera, view: &DepthView, motion: &RigidTransform, seconds: f64) -> Self {
        let row_s = camera.line_s * camera.left.fy / view.model.fy;
        let middle = 0.5 * f64::from(camera.left.height - 1);
        Self {
            first_s: camera.line_s * (camera.left.cy - middle) - row_s * view.model.cy,
            row_s,
            speed: motion.translation_m().map(|v| v / seconds),
            rate: motion.rotation_vector().map(|w| w / seconds),
        }
    }

    /// Point of a row, in the view at the exposure of the middle row.
    pub(super) fn at_middle(&self, row: f64, x: [f64; 3]) -> [f64; 3] {
        self.compensate(row, x, 1.0)
    }

    /// Point of the view at the exposure of the middle row, in the view of a row.
    pub(super) fn at_row(&self, row: f64, x: [f64; 3]) -> [f64; 3] {
        self.compensate(row, x, -1.0)
    }

    fn compensate(&self, row: f64, x: [f64; 3], sign: f64) -> [f64; 3] {
        let time = sign * (self.first_s + self.row_s * row);
        let (v, w) = (&self.speed, &self.rate);
        let turned = [
            w[1] * x[2] - w[2] * x[1],
            w[2] * x[0] - w[0] * x[2],
            w[0] * x[1] - w[1] * x[0],
        ];
        [0, 1, 2].map(|k| x[k] + time * (v[k] + turned[k]))
    }
}

#[cfg(test)]
mod tests {
    use camera_models::{CameraModel, Distortion};

    use super::*;

    #[test]
    fn rows_are_transformed_to_the_middle_row() {
        let model = CameraModel {
            width: 60,
            height: 41,
            fx: 50.0,
            fy: 50.0,
            cx: 29.5,
            cy: 20.0,
            distortion: Distortion::None,
        };
        let view = DepthView {
            camera: "front".to_owned(),
            model: CameraModel {
                fy: 100.0,
                cy: 40.0,
                height: 81,
                ..model
            },
            view_from_left: RigidTransform::identity(),
        };
        let camera = RigCamera {
            name: "front".to_owned(),
            left: model,
            right: model,
            rig_from_left: RigidTransform::identity(),
            rig_from_left_covariance: None,
            right_from_left: RigidTransform::identity(),
            right_from_left_covariance: None,
            line_s: 1e-3,
        };
        // 0.02 s from the middle to the lowest row, which is row 80 of the view.
        let motion = RigidTransform::from_rotation_vector([0.0, 0.01, 0.0], [0.0, 0.0, 0.1]);
        let row_motion = RowMotion::of(&camera, &view, &motion.expect("finite"), 0.1);
        let x = [0.5, 0.2, 4.0];
        assert_eq!(row_motion.at_middle(40.0, x), x);
        let seen = row_motion.at_middle(80.0, x);
        for (found, expected) in seen.iter().zip([0.508, 0.2, 4.019]) {
            assert!((found - expected).abs() < 1e-9, "{seen:?}");
        }
        let back = row_motion.at_row(80.0, seen);
        assert!(
            back.iter().zip(x).all(|(a, b)| (a - b).abs() < 1e-4),
            "{back:?}"
        );
    }
}
