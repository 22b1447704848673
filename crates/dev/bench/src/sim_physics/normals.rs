//! Slope of a collision shape under a foot against the true one: the angle between planes through
//! the points of the foot.

use nalgebra::{Matrix3, Vector2, Vector3};
use serde_json::{Value, json};

/// A point farther from the plane of its foot, m, is beyond an edge: there is no slope there.
const SMOOTH_M: f64 = 0.005;

/// Quantiles of angles, degrees.
pub(super) fn angles(mut angles_deg: Vec<f64>) -> Value {
    angles_deg.sort_by(f64::total_cmp);
    let of = |share: f64| match angles_deg.is_empty() {
        true => Value::Null,
        false => crate::meter::quantile(&angles_deg, share).into(),
    };
    json!({
        "count": angles_deg.len(),
        "median_deg": of(0.5),
        "p95_deg": of(0.95),
        "max_deg": of(1.0),
    })
}

/// The angle between the slopes of two surfaces under a foot, degrees; `None` where the second, the
/// truth, has an edge, and where one of them has a hole. Edges of the first are errors of its
/// slope.
pub(super) fn angle_deg(
    points: &[Vector2<f64>],
    found: impl Fn(Vector2<f64>) -> Option<f64>,
    truth: impl Fn(Vector2<f64>) -> Option<f64>,
) -> Option<f64> {
    let (expected, residual_m) = normal(points, truth)?;
    let (normal, _) = normal(points, found)?;
    (residual_m <= SMOOTH_M).then(|| normal.angle(&expected).to_degrees())
}

/// Upward unit normal of the plane through a surface at places, by least squares of heights, and
/// the largest residual, m.
fn normal(
    places: &[Vector2<f64>],
    height: impl Fn(Vector2<f64>) -> Option<f64>,
) -> Option<(Vector3<f64>, f64)> {
    let heights: Option<Vec<f64>> = places.iter().map(|at| height(*at)).collect();
    let heights = heights?;
    let middle = places.iter().sum::<Vector2<f64>>() / places.len() as f64;
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    let row = |at: &Vector2<f64>| Vector3::new(at.x - middle.x, at.y - middle.y, 1.0);
    for (at, z) in places.iter().zip(&heights) {
        let row = row(at);
        matrix += row * row.transpose();
        right += row * *z;
    }
    let plane = matrix.cholesky()?.solve(&right);
    let errors = places.iter().zip(&heights);
    let errors = errors.map(|(at, z)| (row(at).dot(&plane) - z).abs());
    let residual_m = errors.fold(0.0, f64::max);
    Some((
        Vector3::new(-plane.x, -plane.y, 1.0).normalize(),
        residual_m,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn foot() -> Vec<Vector2<f64>> {
        let at = |k: i32| Vector2::new(0.01 * f64::from(k % 3), 0.01 * f64::from(k / 3));
        (0..9).map(|k| at(k) + Vector2::new(40.0, -7.0)).collect()
    }

    #[test]
    fn a_slope_is_that_of_the_surface() {
        let slope = |x: f64, y: f64| move |at: Vector2<f64>| Some(x * at.x + y * at.y);
        let found = angle_deg(&foot(), slope(0.1, 0.0), slope(0.0, 0.0)).expect("an angle");
        assert!(
            (found - 0.1_f64.atan().to_degrees()).abs() < 1e-6,
            "{found}"
        );
        let same = angle_deg(&foot(), slope(0.3, -0.2), slope(0.3, -0.2)).expect("an angle");
        assert!(same < 1e-5, "{same}");
    }

    #[test]
    fn edges_and_holes_of_the_truth_have_no_slope() {
        let level = |_: Vector2<f64>| Some(0.0);
        let step = |at: Vector2<f64>| Some(if at.x > 40.005 { 0.1 } else { 0.0 });
        let hole = |at: Vector2<f64>| (at.x < 40.005).then_some(0.0);
        assert!(angle_deg(&foot(), level, step).is_none());
        assert!(angle_deg(&foot(), level, hole).is_none());
        assert!(angle_deg(&foot(), hole, level).is_none());
        let tilted = angle_deg(&foot(), step, level).expect("an angle");
        assert!(tilted > 45.0, "{tilted}");
    }
}
