//! A twice continuously differentiable rigid motion with exact derivatives.
//!
//! A cumulative cubic B-spline on uniform knots, of positions in R³ and of rotations in SO(3) (Kim,
//! Kim and Shin 1995; derivatives by the recursion of Sommer et al., CVPR 2020). The spline passes
//! near its control poses, not through them: the spline is the ground truth, not the controls.

use nalgebra::{UnitQuaternion, Vector3};

use cad_transforms::so3;

/// Pose of a body with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Origin of the body in the world, m.
    pub position: Vector3<f64>,
    /// Maps vectors of the body frame to the world.
    pub rotation: UnitQuaternion<f64>,
    /// Velocity of the origin in the world, m/s.
    pub velocity: Vector3<f64>,
    /// Acceleration of the origin in the world, m/s².
    pub acceleration: Vector3<f64>,
    /// Angular rate in the body's frame, rad/s.
    pub angular_rate: Vector3<f64>,
    /// Its derivative in the body's frame, rad/s².
    pub angular_acceleration: Vector3<f64>,
}

/// A rigid motion; see the module documentation.
#[derive(Clone, Debug)]
pub(crate) struct Spline {
    spacing_s: f64,
    controls: Vec<(Vector3<f64>, UnitQuaternion<f64>)>,
    /// Rotation from each control to the next, in the former's frame: rotation vector, rad.
    turns: Vec<Vector3<f64>>,
}

impl Spline {
    /// Controls at times `0, spacing, 2 spacing, …`; valid from `spacing` to the last but one.
    ///
    /// # Panics
    /// With fewer than four controls.
    pub(crate) fn new(spacing_s: f64, controls: Vec<(Vector3<f64>, UnitQuaternion<f64>)>) -> Self {
        assert!(controls.len() >= 4, "a cubic spline needs four controls");
        let turns = controls
            .windows(2)
            .map(|pair| so3::log(&(pair[0].1.inverse() * pair[1].1)))
            .collect();
        Self {
            spacing_s,
            controls,
            turns,
        }
    }

    /// First and last time at which it is defined, s.
    fn domain_s(&self) -> (f64, f64) {
        let last = (self.controls.len() - 2) as f64;
        (self.spacing_s, last * self.spacing_s)
    }

    /// Pose and derivatives at a time; before the first and after the last time, those at the end.
    pub(crate) fn at(&self, time_s: f64) -> State {
        let (first, last) = self.domain_s();
        let u = time_s.clamp(first, last) / self.spacing_s;
        let i = (u.floor() as usize).clamp(1, self.controls.len() - 3);
        let s = u - i as f64;
        let per_s = 1.0 / self.spacing_s;
        // Cumulative basis of the three differences, and its derivatives by time.
        let value = [
            (5.0 + s * (3.0 + s * (-3.0 + s))) / 6.0,
            (1.0 + s * (3.0 + s * (3.0 - 2.0 * s))) / 6.0,
            s * s * s / 6.0,
        ];
        let first = [
            (3.0 + s * (-6.0 + 3.0 * s)) / 6.0,
            (3.0 + s * (6.0 - 6.0 * s)) / 6.0,
            0.5 * s * s,
        ]
        .map(|v| v * per_s);
        let second = [s - 1.0, 1.0 - 2.0 * s, s].map(|v| v * per_s * per_s);

        let (start, mut rotation) = self.controls[i - 1];
        let mut state = State {
            position: start,
            rotation,
            velocity: Vector3::zeros(),
            acceleration: Vector3::zeros(),
            angular_rate: Vector3::zeros(),
            angular_acceleration: Vector3::zeros(),
        };
        for j in 0..3 {
            let step = self.controls[i + j].0 - self.controls[i + j - 1].0;
            state.position += step * value[j];
            state.velocity += step * first[j];
            state.acceleration += step * second[j];

            let turn = self.turns[i + j - 1];
            let part = so3::exp(turn * value[j]);
            rotation *= part;
            let back = part.inverse();
            let added = turn * first[j];
            state.angular_rate = back * state.angular_rate + added;
            state.angular_acceleration = back * state.angular_acceleration
                + turn * second[j]
                + state.angular_rate.cross(&added);
        }
        state.rotation = UnitQuaternion::new_normalize(rotation.into_inner());
        state
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wild() -> Spline {
        let controls = (0..40).map(|i| {
            let t = f64::from(i) * 0.05;
            let position = Vector3::new((3.0 * t).sin(), t * t, (7.0 * t).cos());
            let turn = Vector3::new((5.0 * t).sin(), 2.0 * t, (3.0 * t).cos());
            (position, so3::exp(turn))
        });
        Spline::new(0.05, controls.collect())
    }

    #[test]
    fn derivatives_agree_with_difference_quotients() {
        let spline = wild();
        let h = 1e-5;
        for k in 0..300 {
            let t = 0.06 + 0.006 * f64::from(k);
            let (a, b, c) = (spline.at(t - h), spline.at(t), spline.at(t + h));
            let velocity = (c.position - a.position) / (2.0 * h);
            let acceleration = (c.velocity - a.velocity) / (2.0 * h);
            let rate = so3::log(&(a.rotation.inverse() * c.rotation)) / (2.0 * h);
            let angular = (c.angular_rate - a.angular_rate) / (2.0 * h);
            assert!((velocity - b.velocity).norm() < 1e-6, "{t}");
            // The third derivative jumps at a knot, so a difference quotient across one has an
            // error.
            assert!((acceleration - b.acceleration).norm() < 2e-2, "{t}");
            assert!((rate - b.angular_rate).norm() < 1e-6, "{t}");
            assert!((angular - b.angular_acceleration).norm() < 2e-2, "{t}");
        }
    }

    #[test]
    fn second_derivatives_are_continuous_at_the_knots() {
        let spline = wild();
        for k in 2..37 {
            let t = 0.05 * f64::from(k);
            let (a, b) = (spline.at(t - 1e-9), spline.at(t + 1e-9));
            assert!((a.acceleration - b.acceleration).norm() < 1e-4, "{t}");
            assert!(
                (a.angular_acceleration - b.angular_acceleration).norm() < 1e-4,
                "{t}"
            );
        }
    }
}
