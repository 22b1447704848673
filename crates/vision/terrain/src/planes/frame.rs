//! Coordinates on a plane.

use nalgebra::Vector3;

/// Axes of a plane in the world: two on it, and its outward normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlaneFrame {
    pub(crate) origin: Vector3<f64>,
    pub(crate) u: Vector3<f64>,
    pub(crate) v: Vector3<f64>,
    pub(crate) normal: Vector3<f64>,
}

impl PlaneFrame {
    /// Through a point, with an outward normal of length 1. The first axis is horizontal.
    pub(crate) fn new(origin: Vector3<f64>, normal: Vector3<f64>) -> Self {
        let level = Vector3::new(-normal.y, normal.x, 0.0);
        let u = match level.norm() {
            norm if norm > 1e-3 => level / norm,
            _ => Vector3::x(),
        };
        let u = (u - normal * normal.dot(&u)).normalize();
        Self {
            origin,
            u,
            v: normal.cross(&u),
            normal,
        }
    }

    /// Coordinates on the plane, and height above it.
    pub(crate) fn coordinates(&self, x: &Vector3<f64>) -> [f64; 3] {
        let d = x - self.origin;
        [self.u.dot(&d), self.v.dot(&d), self.normal.dot(&d)]
    }

    pub(crate) fn position(&self, [s, t]: [f64; 2]) -> Vector3<f64> {
        self.origin + self.u * s + self.v * t
    }

    /// Rotated and displaced so that the plane is at this height above the present one: at the
    /// origin, and per metre along both axes.
    pub(crate) fn adjusted(&self, height: [f64; 3]) -> Self {
        let normal = (self.normal - self.u * height[1] - self.v * height[2]).normalize();
        let u = (self.u - normal * normal.dot(&self.u)).normalize();
        Self {
            origin: self.origin + self.normal * height[0],
            u,
            v: normal.cross(&u),
            normal,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_and_adjustments_are_those_of_the_plane() {
        let normal = Vector3::new(0.3, -0.2, 0.9).normalize();
        let frame = PlaneFrame::new(Vector3::new(1.0, 2.0, 3.0), normal);
        let x = frame.position([0.4, -0.7]) + normal * 0.05;
        let [s, t, h] = frame.coordinates(&x);
        assert!((s - 0.4).abs() < 1e-12 && (t + 0.7).abs() < 1e-12 && (h - 0.05).abs() < 1e-12);
        let adjusted = frame.adjusted([0.01, 0.02, -0.03]);
        for at in [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]] {
            let expected = 0.01 + 0.02 * at[0] - 0.03 * at[1];
            let x = frame.position(at) + normal * expected;
            assert!(adjusted.coordinates(&x)[2].abs() < 1e-9);
        }
    }
}
