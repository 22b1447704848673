//! A walk along waypoints: poses of a rig, its camera, and contacts of feet on exact ground.

use cad_transforms::rig::Foot;
use cad_transforms::{Covariance, RigidTransform, TransformError};
use camera_models::{CameraModel, Distortion, Eye};
use nalgebra::{UnitQuaternion, Vector3};
use scene_bundle::outputs::contacts::{ContactEvent, FootContact};
use scene_bundle::{Pose, Trajectory};
use splats::Camera;

use super::surfaces::Surfaces;
use crate::camera::pinhole;
use crate::error::SimulationError;
use crate::scene::{RecordedView, Recording, RecordingCamera, rigid};

/// Height of the rig above the ground, m.
const RIG_HEIGHT_M: f64 = 1.4;
/// How far the camera looks down, rad.
const PITCH_RAD: f64 = 0.2;
/// What the camera sees from left to right, rad.
const FIELD_OF_VIEW_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// Distance of poses, m, and their time, ns: 1 m/s at 10 Hz.
const STEP_M: f64 = 0.1;
const STEP_NS: i64 = 100_000_000;
/// Poses from one contact to the next, and distance of a foot to the middle, m.
const POSES_PER_CONTACT: usize = 6;
const HALF_TRACK_M: f64 = 0.1;
/// Name of the only camera.
const CAMERA: &str = "front/left";

/// A pose moved in the horizontal plane along a direction, and rotated about the vertical axis.
///
/// # Errors
/// [`TransformError`] if a number is not finite.
pub fn offset_pose(
    world_from_camera: &RigidTransform,
    offset_m: f64,
    along_rad: f64,
    yaw_rad: f64,
) -> Result<RigidTransform, TransformError> {
    let turn = RigidTransform::from_rotation_vector([0.0, 0.0, yaw_rad], [0.0; 3])?;
    let [x, y, z] = world_from_camera.translation_m();
    let [dx, dy] = [libm::cos(along_rad), libm::sin(along_rad)].map(|v| offset_m * v);
    let rotation = (turn * *world_from_camera).rotation_wxyz();
    RigidTransform::from_wxyz(rotation, [x + dx, y + dy, z])
}

/// What a walk records. Waypoints are x, y and a height near which the ground is, m.
pub(super) fn record(surfaces: &Surfaces, waypoints: &[[f64; 3]]) -> Recording {
    let camera = camera();
    let (mut poses, mut views, mut contacts) = (Vec::new(), Vec::new(), Vec::new());
    for ends in waypoints.windows(2) {
        let [from, to] = [ends[0], ends[1]].map(Vector3::from);
        let along = to - from;
        let length = along.xy().norm();
        let yaw = libm::atan2(along.y, along.x);
        let world_from_yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        let count = (length / STEP_M).round() as usize;
        for i in 0..count {
            let at = from + along * (i as f64 / count as f64);
            let Some((height, normal)) = surfaces.ground([at.x, at.y], at.z) else {
                continue;
            };
            let number = poses.len();
            let time_ns = number as i64 * STEP_NS;
            let position = Vector3::new(at.x, at.y, height + RIG_HEIGHT_M);
            let world_from_rig = rigid(world_from_yaw, position);
            let mut pose = Pose::new(time_ns, world_from_rig);
            let rate = 1e9 * STEP_M / STEP_NS as f64 / length;
            pose.velocity_in_world = Some([along.x * rate, along.y * rate, 0.0]);
            poses.push(pose);
            views.push(RecordedView {
                camera: CAMERA.to_owned(),
                time_ns,
                world_from_camera: world_from_rig * camera.rig_from_camera,
                held_out_psnr_db: None,
            });
            if number.is_multiple_of(POSES_PER_CONTACT) {
                let (foot, side) = match (number / POSES_PER_CONTACT).is_multiple_of(2) {
                    true => (Foot::Left, HALF_TRACK_M),
                    false => (Foot::Right, -HALF_TRACK_M),
                };
                let beside = at + world_from_yaw * Vector3::new(0.0, side, 0.0);
                let ground = surfaces.ground([beside.x, beside.y], at.z);
                let (height, normal) = ground.unwrap_or((height, normal));
                let up = UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::from(normal));
                let rotation = up.unwrap_or_else(UnitQuaternion::identity) * world_from_yaw;
                let world_from_foot = rigid(rotation, Vector3::new(beside.x, beside.y, height));
                contacts.push(contact(foot, time_ns, world_from_foot));
            }
        }
    }
    Recording {
        // Times rise by construction.
        trajectory: Trajectory::new(poses).ok(),
        cameras: vec![camera],
        contacts,
        views,
        ..Recording::default()
    }
}

/// Every which view is one of those that gather what was seen, and how much smaller they are.
const VIEW_STEP: usize = 4;
const SCALE: u32 = 2;

/// Cameras that gather what the walk saw of the scene.
pub(super) fn recording_cameras(recording: &Recording) -> Result<Vec<Camera>, SimulationError> {
    let whole = camera().model;
    let model = pinhole(
        [whole.width / SCALE, whole.height / SCALE],
        FIELD_OF_VIEW_RAD,
    )?;
    let views = recording.views.iter().step_by(VIEW_STEP);
    let cameras = views.map(|view| Camera::new(model, view.world_from_camera.inverse()));
    cameras
        .collect::<Result<_, _>>()
        .map_err(|error| SimulationError::Scene {
            place: "cameras of a synthetic walk".to_owned(),
            found: error.to_string(),
            expected: "pinhole cameras".to_owned(),
        })
}

/// A camera of 320 x 180 px that sees 90 degrees across.
fn camera() -> RecordingCamera {
    let down = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), PITCH_RAD);
    let rig_from_body = rigid(down, Vector3::new(0.1, 0.0, 0.0));
    RecordingCamera {
        name: CAMERA.to_owned(),
        eye: Eye::Left,
        model: CameraModel::new((320, 180), [160.0, 160.0, 159.5, 89.5], Distortion::None),
        rig_from_camera: rig_from_body * RigidTransform::body_from_optical(),
        line_s: 0.0,
    }
}

/// A contact of 0.6 s around a time.
fn contact(foot: Foot, time_ns: i64, world_from_foot: RigidTransform) -> FootContact {
    let events = [-300, -200, 200, 300].map(|ms: i64| ContactEvent {
        time_ns: time_ns + ms * 1_000_000,
        sigma_s: 0.0,
        is_seen: true,
    });
    FootContact {
        foot,
        events,
        world_from_foot,
        covariance: Covariance::zero(),
    }
}
