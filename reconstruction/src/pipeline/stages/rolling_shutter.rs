//! Rolling-shutter compensation: motion of a view while its rows are exposed one after another.
//!
//! A rolling shutter exposes the lowest row some milliseconds after the topmost one, and a walker
//! rotates by a fraction of a degree meanwhile. Points of a row are transformed to the pose at the
//! exposure of the middle row, which is known: to first order in time.

use cad_transforms::RigidTransform;
use scene_bundle::Trajectory;
use scene_bundle::outputs::depth::DepthView;
use scene_bundle::outputs::rig::RigCamera;
use terrain::RowMotion;

use super::pose_interpolation::pose_at;

/// Time over which the motion is measured, ns.
const STEP_NS: i64 = 10_000_000;

/// Motion of the view of a frame at a time; time 0 of it is the exposure of the middle row of the
/// recorded image. At rest for a global shutter, and where the pose of the rig is not known.
pub(super) fn row_motion(
    camera: &RigCamera,
    view: &DepthView,
    trajectory: &Trajectory,
    time_ns: i64,
) -> RowMotion {
    let pose = |time_ns: i64| {
        let world_from_rig = pose_at(trajectory, time_ns)?;
        Some(world_from_rig * camera.rig_from_left * view.view_from_left.inverse())
    };
    let motion = pose(time_ns - STEP_NS / 2)
        .zip(pose(time_ns + STEP_NS / 2))
        .map(|(from, to)| from.inverse() * to);
    match motion.filter(|_| camera.line_s > 0.0) {
        Some(motion) => of_motion(camera, view, &motion, STEP_NS as f64 * 1e-9),
        None => RowMotion::default(),
    }
}

/// From a motion in `seconds`. Rectification rotates rows only slightly.
fn of_motion(
    camera: &RigCamera,
    view: &DepthView,
    motion: &RigidTransform,
    seconds: f64,
) -> RowMotion {
    let row_s = camera.line_s * camera.left.fy / view.model.fy;
    let middle = 0.5 * f64::from(camera.left.height - 1);
    RowMotion {
        first_s: camera.line_s * (camera.left.cy - middle) - row_s * view.model.cy,
        row_s,
        velocity: motion.translation_m().map(|v| v / seconds),
        angular_rate: motion.rotation_vector().map(|w| w / seconds),
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
        let row_motion = of_motion(&camera, &view, &motion.expect("finite"), 0.1);
        let x = [0.5, 0.2, 4.0];
        assert_eq!(row_motion.at_pose(40.0, x), x);
        let seen = row_motion.at_pose(80.0, x);
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
