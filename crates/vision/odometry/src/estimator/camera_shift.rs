//! Detection of a camera that is moved on its plate while recording.
//!
//! Its residuals of old landmarks suddenly fit one common rotation, while those of the other
//! cameras agree with the prediction. The window then rotates the camera by it, with a sigma as
//! large as the rotation, and forgets what the camera observed before. It is unknown which cameras
//! moved relative to the plate, so that a fraction of the rotation is added to the uncertainty of
//! poses.

use cad_transforms::so3;
use nalgebra::{Matrix3, Vector3, Vector6};

use crate::backend::extrinsics;
use crate::backend::observation::{CameraPose, transfer};
use crate::backend::state::ROTATION;
use crate::backend::window::Window;
use crate::config::CameraShiftConfig;

/// Detected shift of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraShift {
    /// Time of the frame set in which it was detected, ns.
    pub time_ns: i64,
    /// Index of the camera in the rig.
    pub camera: usize,
    /// Angle of the rotation, rad.
    pub rotation_rad: f64,
}

/// Predicted and measured bearing of a landmark, as unit rays in the left optical frame.
type Pair = (Vector3<f64>, Vector3<f64>);

/// Camera that was moved since the previous frame, if any, and the rotation from predicted to
/// measured bearings in its axes. The pose of the newest frame is known.
pub(super) fn find(
    config: &CameraShiftConfig,
    window: &Window,
) -> Option<(CameraShift, Vector3<f64>)> {
    let frame = window.newest();
    let mut pairs: Vec<Vec<Pair>> = vec![Vec::new(); window.cameras.len()];
    for landmark in window.landmarks.values() {
        let (host_number, host) = &landmark.observations[0];
        let Some(at) = window.position(*host_number) else {
            continue;
        };
        let from = CameraPose::new(&window.frames[at].state, host.exposure_offset_s);
        for (_, observation) in &landmark.observations[landmark.since(frame.number)..] {
            let to = CameraPose::new(&frame.state, observation.exposure_offset_s);
            let transferred = transfer(
                &host.left.ray,
                landmark.rho,
                (&window.cameras[host.camera], &from),
                (&window.cameras[observation.camera], &to),
            );
            pairs[observation.camera].push((transferred.x.normalize(), observation.left.ray));
        }
    }
    let judged: Vec<(usize, usize)> = (pairs.iter().enumerate())
        .map(|(k, pairs)| {
            (
                count_inliers(config, window, k, pairs, &Vector3::zeros()),
                pairs.len(),
            )
        })
        .collect();
    (0..pairs.len()).find_map(|camera| {
        let (inliers, all) = judged[camera];
        let others = judged.iter().enumerate().filter(|(k, _)| *k != camera);
        let (others_good, others_all) =
            others.fold((0, 0), |sum, (_, one)| (sum.0 + one.0, sum.1 + one.1));
        let is_alone = all >= config.min_observations
            && others_all >= config.min_observations
            && inliers as f64 <= config.max_static_inlier_ratio * all as f64
            && others_good as f64 >= config.min_other_inlier_ratio * others_all as f64;
        let rotation = is_alone.then(|| rotation(config, window, camera, &pairs[camera]))??;
        let inliers = count_inliers(config, window, camera, &pairs[camera], &rotation);
        let shift = CameraShift {
            time_ns: frame.state.time_ns,
            camera,
            rotation_rad: rotation.norm(),
        };
        (inliers as f64 >= config.min_rotated_inlier_ratio * all as f64)
            .then_some((shift, rotation))
    })
}

/// Rotates a camera of the window by a rotation of its bearings with this variance, rad², by the
/// sigmas of the solver, and removes its observations and the landmarks that it hosts.
pub(super) fn rotate_camera(
    window: &mut Window,
    camera: usize,
    rotation: &Vector3<f64>,
    variance: f64,
) {
    window.landmarks.retain(|_, landmark| {
        let is_host = landmark.observations[0].1.camera == camera;
        landmark.observations.retain(|(_, o)| o.camera != camera);
        !is_host
    });
    let mut error = Vector6::zeros();
    error.fixed_rows_mut::<3>(ROTATION).copy_from(&-rotation);
    extrinsics::apply_error(&mut window.cameras[camera].body_from_left, &error);
    if let Some(at) = window.prior.extrinsics.get_mut(camera) {
        extrinsics::apply_error(at, &error);
        window.prior.add_rotation_variance(camera, variance);
    }
}

fn residual(pair: &Pair, rotation: &Vector3<f64>) -> Vector3<f64> {
    pair.1 - so3::exp(*rotation) * pair.0
}

fn count_inliers(
    config: &CameraShiftConfig,
    window: &Window,
    camera: usize,
    pairs: &[Pair],
    rotation: &Vector3<f64>,
) -> usize {
    let scale = window.cameras[camera].left.model().fx;
    let inliers = pairs
        .iter()
        .filter(|p| scale * residual(p, rotation).norm() < config.inlier_px);
    inliers.count()
}

/// Small rotation that explains most residuals.
fn rotation(
    config: &CameraShiftConfig,
    window: &Window,
    camera: usize,
    pairs: &[Pair],
) -> Option<Vector3<f64>> {
    let scale = window.cameras[camera].left.model().fx;
    let mut rotation = Vector3::zeros();
    for _ in 0..config.iterations {
        let (mut h, mut g) = (Matrix3::zeros(), Vector3::zeros());
        for pair in pairs {
            let residual = residual(pair, &rotation);
            // Large residuals have little weight, so that moving objects do not dominate.
            let weight = config.inlier_px / (scale * residual.norm()).max(config.inlier_px);
            h += (Matrix3::identity() - pair.0 * pair.0.transpose()) * weight;
            g += pair.0.cross(&residual) * weight;
        }
        rotation += h.cholesky()?.solve(&g);
    }
    Some(rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::covariance::CALIBRATION_DIM;
    use crate::backend::solver::tests::window;
    use crate::backend::state::{POSE_DIM, STATE_DIM};
    use nalgebra::DMatrix;

    /// Bearings of one camera with a rotation.
    fn window_with_rotated_camera(by: Vector3<f64>) -> Window {
        let mut window = window(4, 0.0);
        let number = window.newest().number;
        let observations = window
            .landmarks
            .values_mut()
            .flat_map(|l| &mut l.observations);
        for (_, observation) in observations.filter(|(n, s)| *n == number && s.camera == 1) {
            observation.left.ray = so3::exp(by) * observation.left.ray;
        }
        window
    }

    #[test]
    fn rotated_camera_is_detected() {
        for by in [[0.02, -0.01, 0.03], [0.06, -0.1, 0.12]].map(Vector3::from) {
            let window = window_with_rotated_camera(by);
            let (shift, rotation) = find(&Default::default(), &window).expect("a camera shift");
            assert_eq!(shift.camera, 1);
            assert!((rotation - by).norm() < 1e-3, "{rotation}");
            assert!((shift.rotation_rad - by.norm()).abs() < 1e-3, "{shift:?}");
        }
    }

    /// Bearings of the landmarks of the other camera fit the camera again, and the prior of its
    /// rotation is as wide as the rotation.
    #[test]
    fn window_follows_the_camera() {
        let by = Vector3::new(0.02, -0.01, 0.03);
        let mut window = window_with_rotated_camera(by);
        let cameras = window.cameras.len();
        let size = cameras * CALIBRATION_DIM;
        let information = DMatrix::identity(size, size) * 1e8;
        window.prior = (window.prior).with_calibrations(&window.cameras, &information);
        let number = window.newest().number;
        let observed = window.clone();
        let (shift, rotation) = find(&Default::default(), &window).expect("a camera shift");
        let variance = rotation.norm_squared();
        rotate_camera(&mut window, shift.camera, &rotation, variance);
        let each = window.landmarks.values().flat_map(|l| &l.observations);
        assert!(each.clone().count() > 100 && each.clone().all(|(_, o)| o.camera == 0));
        let mut checked = 0;
        for (id, landmark) in &window.landmarks {
            let of_id = &observed.landmarks[id];
            let (host_number, host) = &landmark.observations[0];
            let frame = window.position(*host_number).expect("in the window");
            let from = CameraPose::new(&window.frames[frame].state, host.exposure_offset_s);
            for (n, observation) in &of_id.observations {
                if (*n, observation.camera) != (number, 1) {
                    continue;
                }
                let to = CameraPose::new(&window.newest().state, observation.exposure_offset_s);
                let [from, to] = [(&window.cameras[0], &from), (&window.cameras[1], &to)];
                let x = transfer(&host.left.ray, landmark.rho, from, to).x;
                let angle = x.normalize().cross(&observation.left.ray).norm();
                assert!(angle < 2e-3, "{angle}");
                checked += 1;
            }
        }
        assert!(checked > 10, "{checked}");
        let error = extrinsics::error(
            &window.prior.extrinsics[1],
            &window.cameras[1].body_from_left,
        );
        assert!(error.amax() < 1e-12, "{error}");
        let at = STATE_DIM + POSE_DIM + ROTATION;
        let inverse = window
            .prior
            .information
            .try_inverse()
            .expect("a covariance");
        assert!((inverse[(at, at)] - variance - 1e-8).abs() < 1e-9);
        assert!((inverse[(at - POSE_DIM, at - POSE_DIM)] - 1e-8).abs() < 1e-12);
    }

    #[test]
    fn static_camera_and_random_residuals_are_not_detected() {
        assert_eq!(
            find(
                &Default::default(),
                &window_with_rotated_camera(Vector3::zeros())
            ),
            None
        );
        let mut window = window_with_rotated_camera(Vector3::zeros());
        let number = window.newest().number;
        let observations = window
            .landmarks
            .values_mut()
            .flat_map(|l| &mut l.observations);
        let own = observations.filter(|(n, s)| *n == number && s.camera == 1);
        for (k, (_, observation)) in own.enumerate() {
            let direction = Vector3::new((k as f64).sin(), (1.7 * k as f64).cos(), 0.0);
            observation.left.ray = (observation.left.ray + direction * 0.05).normalize();
        }
        assert_eq!(find(&Default::default(), &window), None);
    }
}
