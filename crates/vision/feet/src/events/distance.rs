//! Distance of a point of a foot from where it rests.

use nalgebra::{Vector3, Vector6};

use crate::stance::FootObservation;

/// Distance of a point of a foot, which is `at` in the world, from a place there, m, and its
/// variance along the direction to it: a tilt that is uncertain moves the ends of the sole up and
/// down.
pub(super) fn distance(
    seen: &FootObservation,
    point: &[f64; 3],
    place: &Vector3<f64>,
    at: &Vector3<f64>,
) -> [f64; 2] {
    let moved = seen.world_from_foot.rotation().inverse() * (at - place);
    let matrix = seen.covariance.matrix();
    let point = Vector3::from(*point);
    // Motion of the point by a translation and a rotation of the foot, along a direction.
    let variance = |direction: &Vector3<f64>| {
        let turned = point.cross(direction);
        let [x, y, z] = (*direction).into();
        let by_motion = Vector6::new(x, y, z, turned.x, turned.y, turned.z);
        by_motion.dot(&(matrix * by_motion))
    };
    let distance = moved.norm();
    let largest = (0..3)
        .map(|k| variance(&Vector3::ith(k, 1.0)))
        .fold(0.0, f64::max);
    // Near the place the direction is unknown.
    let along = match distance * distance > largest {
        true => variance(&(moved / distance)),
        false => largest,
    };
    [distance, along]
}
