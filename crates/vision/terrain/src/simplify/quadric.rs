//! Quadrics: sums of squared distances from planes.

use nalgebra::{Matrix3, Vector3};

/// A quadric around an origin, weighted by area.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Quadric {
    square: [f64; 6],
    linear: [f64; 3],
    constant: f64,
    pub(super) weight: f64,
}

impl Quadric {
    /// Squared distance from a plane with a normal of length 1, times a weight.
    pub(super) fn of_plane(normal: &Vector3<f64>, offset: f64, weight: f64) -> Self {
        let [x, y, z] = [normal.x, normal.y, normal.z];
        Self {
            square: [x * x, x * y, x * z, y * y, y * z, z * z].map(|v| v * weight),
            linear: [x, y, z].map(|v| -v * offset * weight),
            constant: offset * offset * weight,
            weight,
        }
    }

    pub(super) fn sum(&self, other: &Self) -> Self {
        let mut sum = *self;
        sum.square
            .iter_mut()
            .zip(other.square)
            .for_each(|(a, b)| *a += b);
        sum.linear
            .iter_mut()
            .zip(other.linear)
            .for_each(|(a, b)| *a += b);
        sum.constant += other.constant;
        sum.weight += other.weight;
        sum
    }

    fn matrix(&self) -> Matrix3<f64> {
        let [xx, xy, xz, yy, yz, zz] = self.square;
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }

    pub(super) fn error(&self, x: &Vector3<f64>) -> f64 {
        let linear = Vector3::from(self.linear);
        (x.dot(&(self.matrix() * x)) + 2.0 * linear.dot(x) + self.constant).max(0.0)
    }

    /// The point of least error, if there is one.
    pub(super) fn minimum(&self) -> Option<Vector3<f64>> {
        let matrix = self.matrix();
        // Flat surroundings have no single best point.
        let scale = matrix.trace() / 3.0;
        if matrix.determinant() < 1e-3 * scale * scale * scale {
            return None;
        }
        matrix
            .try_inverse()
            .map(|inverse| inverse * -Vector3::from(self.linear))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corner_of_three_planes_has_no_error() {
        let planes = [
            (Vector3::x(), 1.0),
            (Vector3::y(), 2.0),
            (Vector3::z(), -0.5),
        ];
        let sum = planes
            .iter()
            .fold(Quadric::default(), |sum, (normal, offset)| {
                sum.sum(&Quadric::of_plane(normal, *offset, 2.0))
            });
        let corner = sum.minimum().unwrap();
        assert!((corner - Vector3::new(1.0, 2.0, -0.5)).norm() < 1e-12);
        assert!(sum.error(&corner) < 1e-12);
        // A metre from one plane, with its weight.
        assert!((sum.error(&Vector3::new(2.0, 2.0, -0.5)) - 2.0).abs() < 1e-12);
        assert!(
            Quadric::of_plane(&Vector3::z(), 0.0, 1.0)
                .minimum()
                .is_none()
        );
    }
}
