//! Smooth paths of cameras, for a flight through the scene.
//!
//! Contract: for each camera its poses at equal steps of time, weighted means of the recorded ones
//! with a Gaussian of [`SIGMA_S`] or the median interval of its images, whichever is larger: steps
//! of a walking person do not shake the view. The camera that looks along its path comes first.

use camera_models::Eye;
use scene_bundle::outputs::splats::SplatView;

/// Standard deviation of the smoothing, s.
const SIGMA_S: f64 = 0.5;
/// Least step, s.
const MIN_STEP_S: f64 = 0.25;
/// Largest number of poses of a camera.
const MAX_POSES: usize = 1000;

/// Logarithm of a weight beside the largest one below which a pose does not count.
const MIN_EXPONENT: f64 = -30.0;

/// Path of a camera.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FlyPath {
    /// Name of the camera.
    pub(super) name: String,
    /// Time between poses, s.
    pub(super) step_s: f64,
    /// Position in the world, m, and quaternion `w x y z` of `world_from_camera`.
    pub(super) poses: Vec<[f64; 7]>,
}

/// Paths of all cameras of a scene.
pub(super) fn of_views(views: &[SplatView]) -> Vec<FlyPath> {
    let mut names: Vec<&str> = views.iter().map(|view| view.camera.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    let mut paths: Vec<FlyPath> = names
        .into_iter()
        .filter_map(|name| {
            let of_eye = |eye: Eye| {
                let is_of = |view: &&SplatView| view.camera == name && view.eye == eye;
                views.iter().filter(is_of).collect::<Vec<_>>()
            };
            let left = of_eye(Eye::Left);
            let of_camera = match left.is_empty() {
                true => of_eye(Eye::Right),
                false => left,
            };
            smooth(name, of_camera)
        })
        .collect();
    // The sort is stable: equal cameras stay in the order of their names.
    paths.sort_by(|a, b| ahead(b).total_cmp(&ahead(a)));
    paths
}

fn smooth(name: &str, mut views: Vec<&SplatView>) -> Option<FlyPath> {
    views.sort_by_key(|view| view.time_ns);
    let (first, last) = (views.first()?.time_ns, views.last()?.time_ns);
    let seconds = |ns: i64| (ns - first) as f64 * 1e-9;
    let mut knots: Vec<(f64, [f64; 7])> = Vec::with_capacity(views.len());
    for view in &views {
        let [x, y, z] = view.world_from_camera.translation_m();
        let q = view.world_from_camera.rotation();
        let mut pose = [x, y, z, q.w, q.i, q.j, q.k];
        // A quaternion and its negative are the same rotation; means need neighbors of one sign.
        let cosine = knots.last().map_or(1.0, |(_, before)| {
            (3..7).map(|k| before[k] * pose[k]).sum::<f64>()
        });
        if cosine < 0.0 {
            pose[3..].iter_mut().for_each(|v| *v = -*v);
        }
        knots.push((seconds(view.time_ns), pose));
    }
    let mut intervals: Vec<f64> = knots.windows(2).map(|two| two[1].0 - two[0].0).collect();
    intervals.sort_by(f64::total_cmp);
    let median = intervals.get(intervals.len() / 2).copied().unwrap_or(0.0);
    let sigma = SIGMA_S.max(median);
    let length = seconds(last);
    let steps = ((length / MIN_STEP_S) as usize).clamp(1, MAX_POSES - 1);
    let step_s = length / steps as f64;
    let poses = (0..=steps).map(|k| mean(&knots, k as f64 * step_s, sigma));
    Some(FlyPath {
        name: name.to_owned(),
        step_s,
        poses: poses.collect(),
    })
}

/// Weighted mean of the poses around a time.
fn mean(knots: &[(f64, [f64; 7])], time_s: f64, sigma: f64) -> [f64; 7] {
    // Relative to the nearest one, so that weights in a gap do not vanish.
    let distance = |knot: &(f64, [f64; 7])| (knot.0 - time_s).powi(2) / (2.0 * sigma * sigma);
    let nearest = knots.iter().map(distance).fold(f64::INFINITY, f64::min);
    let mut sum = [0.0; 7];
    let mut weights = 0.0;
    for knot in knots {
        let exponent = nearest - distance(knot);
        if exponent < MIN_EXPONENT {
            continue;
        }
        let weight = libm::exp(exponent);
        weights += weight;
        for (sum, value) in sum.iter_mut().zip(knot.1) {
            *sum += weight * value;
        }
    }
    let norm = sum[3..].iter().map(|v| v * v).sum::<f64>().sqrt();
    // Digits beyond these are not seen.
    let rounded = |value: f64, digits: f64| libm::round(value * digits) / digits;
    std::array::from_fn(|k| match k {
        0..3 => rounded(sum[k] / weights, 1e4),
        _ => rounded(sum[k] / norm.max(f64::MIN_POSITIVE), 1e6),
    })
}

/// Mean cosine between optical axis and direction of travel.
fn ahead(path: &FlyPath) -> f64 {
    let (mut along, mut total) = (0.0, 0.0);
    for two in path.poses.windows(2) {
        let [.., w, x, y, z] = two[0];
        let axis = [
            2.0 * (x * z + w * y),
            2.0 * (y * z - w * x),
            1.0 - 2.0 * (x * x + y * y),
        ];
        let travel = [0, 1, 2].map(|k| two[1][k] - two[0][k]);
        along += axis.iter().zip(travel).map(|(a, b)| a * b).sum::<f64>();
        total += travel.iter().map(|v| v * v).sum::<f64>().sqrt();
    }
    if total > 0.0 { along / total } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;

    use super::*;

    fn view(camera: &str, eye: Eye, time_s: f64, position: [f64; 3], yaw: f64) -> SplatView {
        let turn = RigidTransform::from_rotation_vector([0.0, 0.0, yaw], position);
        // Camera axes in a rig with x forward, y left, z up.
        let rows = [0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0];
        let level = RigidTransform::from_rotation_rows(rows, [0.0; 3]).expect("a rotation");
        SplatView {
            camera: camera.to_owned(),
            eye,
            frame: 0,
            set: 0,
            time_ns: (time_s * 1e9) as i64,
            world_from_camera: turn.expect("a rotation") * level,
            shutter: None,
            reduction: 1,
            exposure: [[0.0; 4]; 3],
            held_out: None,
        }
    }

    #[test]
    fn steps_of_the_walk_are_smoothed_and_the_camera_ahead_is_first() {
        let mut views = Vec::new();
        for k in 0..60 {
            let time = 0.3 * f64::from(k);
            let bob = if k % 2 == 0 { 0.05 } else { -0.05 };
            let position = [1.2 * time, 0.0, 1.5 + bob];
            views.push(view("aside", Eye::Left, time, position, 1.5));
            views.push(view("front", Eye::Left, time, position, 0.1 * bob));
            views.push(view("front", Eye::Right, time, [9.0; 3], 3.0));
        }
        let paths = of_views(&views);
        let names: Vec<&str> = paths.iter().map(|path| path.name.as_str()).collect();
        assert_eq!(names, ["front", "aside"]);
        let front = &paths[0];
        assert!(
            (front.step_s - 17.7 / 70.0).abs() < 1e-6,
            "{}",
            front.step_s
        );
        assert_eq!(front.poses.len(), 71);
        for (k, pose) in front.poses.iter().enumerate().skip(8).take(54) {
            assert!(
                (pose[0] - 1.2 * k as f64 * front.step_s).abs() < 0.02,
                "{pose:?}"
            );
            assert!((pose[2] - 1.5).abs() < 0.02, "{pose:?}");
            let norm: f64 = pose[3..].iter().map(|v| v * v).sum();
            assert!((norm - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn one_image_and_a_long_gap_have_finite_poses() {
        assert_eq!(of_views(&[]), []);
        let one = of_views(&[view("a", Eye::Right, 5.0, [1.0, 2.0, 3.0], 0.0)]);
        assert_eq!((one[0].poses.len(), one[0].step_s), (2, 0.0));
        assert_eq!(one[0].poses[0][..3], [1.0, 2.0, 3.0]);
        let gap = [0.0, 0.1, 0.2, 4000.0];
        let views: Vec<_> = gap
            .map(|t| view("a", Eye::Left, t, [t, 0.0, 0.0], 0.0))
            .into();
        let path = &of_views(&views)[0];
        assert_eq!(path.poses.len(), MAX_POSES);
        assert!(path.poses.as_flattened().iter().all(|v| v.is_finite()));
        assert_eq!(path.poses[MAX_POSES - 1][0], 4000.0);
    }
}
