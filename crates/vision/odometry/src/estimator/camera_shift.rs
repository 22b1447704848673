//! Detection of a camera that is moved on its plate while recording.
//!
//! Its residuals of old landmarks suddenly fit one common rotation, while those of the other
//! cameras agree with the prediction. Afterwards it is unknown which cameras moved relative to the
//! plate and how wrong the extrinsics are, so that a fraction of the rotation is added to the
//! uncertainty of poses.

use nalgebra::{Matrix3, Vector3};

use crate::backend::observation::{CameraPose, transfer};
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

/// Camera that was moved since the previous frame, if any. The pose of the newest frame is known.
pub(crate) fn find(config: &CameraShiftConfig, window: &Window) -> Option<CameraShift> {
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
        (inliers as f64 >= config.min_rotated_inlier_ratio * all as f64).then_some(CameraShift {
            time_ns: frame.state.time_ns,
            camera,
            rotation_rad: rotation.norm(),
        })
    })
}

fn residual(pair: &Pair, rotation: &Vector3<f64>) -> Vector3<f64> {
    pair.1 - pair.0 - rotation.cross(&pair.0)
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
    use crate::backend::solver::tests::window;
    use cad_transforms::so3;

    /// Bearings of one camera with a rotation.
    fn rotation_rad(by: Vector3<f64>) -> Window {
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
        let by = Vector3::new(0.02, -0.01, 0.03);
        let shift = find(&Default::default(), &rotation_rad(by)).expect("a camera shift");
        assert_eq!(shift.camera, 1);
        assert!((shift.rotation_rad - by.norm()).abs() < 1e-3, "{shift:?}");
    }

    #[test]
    fn static_camera_and_random_residuals_are_not_detected() {
        assert_eq!(
            find(&Default::default(), &rotation_rad(Vector3::zeros())),
            None
        );
        let mut window = rotation_rad(Vector3::zeros());
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
