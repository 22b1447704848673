//! Drift of the heading of causal poses, and of their positions by it.
//!
//! Errors of matches are small but have the same sign over many frames, which the solver does not
//! model. They act like a rate of the heading that remains correlated for a minute, and like a
//! scale of rotations about the vertical. What is walked under a wrong heading leads to a wrong
//! position, as in dead reckoning: heading and position drift together, and are correlated.

use cad_transforms::RigidTransform;
use nalgebra::{Matrix3, Matrix4, Matrix6, SMatrix, Vector2, Vector3};

use crate::config::CovarianceConfig;

/// Row of the heading in the covariance of the drift by the rate, behind that of the rate. The
/// horizontal position follows.
const HEADING: usize = 1;

/// Covariance of heading, rad, and horizontal position, m, of the rig in the world by the drift.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct HeadingDrift {
    last: Option<(i64, RigidTransform)>,
    /// Joint covariance of the rate, a Gauss-Markov process, and of heading and position by it.
    by_rate: Matrix4<f64>,
    /// Heading and position by a scale error of 1: the net turn of the rig about the vertical, and
    /// its effect on the position.
    by_scale: Vector3<f64>,
}

impl HeadingDrift {
    /// Adds the pose of the rig at a later time.
    pub(crate) fn add(
        &mut self,
        config: &CovarianceConfig,
        time_ns: i64,
        world_from_rig: &RigidTransform,
    ) {
        let variance = config.heading_rate_sigma.powi(2);
        let Some((last_ns, last)) = self.last.replace((time_ns, *world_from_rig)) else {
            self.by_rate[(0, 0)] = variance;
            return;
        };
        let step = world_from_rig.translation() - last.translation();
        let rotation = world_from_rig.rotation() * last.rotation().inverse();
        // A rotation of the world about the vertical moves the end of a step by this.
        let across = Vector2::new(-step.y, step.x);
        let correlation_s = config.heading_rate_correlation_s;
        let seconds = 1e-9 * (time_ns - last_ns) as f64;
        let decay = (-seconds / correlation_s).exp();
        let heading_by_rate = correlation_s * (1.0 - decay);

        let mut transition = Matrix4::identity();
        transition[(0, 0)] = decay;
        transition[(HEADING, 0)] = heading_by_rate;
        let mut position = transition.fixed_view_mut::<2, 2>(HEADING + 1, 0);
        position.set_column(0, &(across * (0.5 * heading_by_rate)));
        position.set_column(1, &across);
        self.by_rate = transition * self.by_rate * transition.transpose();
        self.by_rate[(0, 0)] += variance * (1.0 - decay * decay);

        let turn = self.by_scale[0];
        let turned = rotation.scaled_axis().z;
        let moved = across * (turn + 0.5 * turned);
        self.by_scale += Vector3::new(turned, moved.x, moved.y);
    }

    /// Covariance of the last pose, as a small motion in the axes of the rig.
    pub(crate) fn covariance(&self, config: &CovarianceConfig) -> Matrix6<f64> {
        let Some((_, world_from_rig)) = &self.last else {
            return Matrix6::zeros();
        };
        let scale = self.by_scale * config.turn_scale_sigma;
        let by_rate = self.by_rate.fixed_view::<3, 3>(HEADING, HEADING);
        let drift: Matrix3<f64> = by_rate + scale * scale.transpose();
        let back = world_from_rig.rotation().inverse().to_rotation_matrix();
        let mut to_rig = SMatrix::<f64, 6, 3>::zeros();
        let horizontal = back.matrix().fixed_columns::<2>(0);
        to_rig.fixed_view_mut::<3, 2>(0, 1).copy_from(&horizontal);
        let up = back.matrix().column(2);
        to_rig.fixed_view_mut::<3, 1>(3, 0).copy_from(&up);
        to_rig * drift * to_rig.transpose()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    /// Heading of a rig that is rolled to the side: its y axis is vertical.
    fn pose(heading: f64, x: f64, y: f64) -> RigidTransform {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let rolled = RigidTransform::from_wxyz([half, half, 0.0, 0.0], [0.0; 3]).unwrap();
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
        RigidTransform::from_wxyz([turn.w, turn.i, turn.j, turn.k], [x, y, 1.0]).unwrap() * rolled
    }

    /// A walk at 10 Hz.
    fn walk(
        config: &CovarianceConfig,
        seconds: usize,
        pose_at: impl Fn(f64) -> RigidTransform,
    ) -> HeadingDrift {
        let mut drift = HeadingDrift::default();
        for k in 0..=10 * seconds as i64 {
            drift.add(config, k * 100_000_000, &pose_at(k as f64 * 0.1));
        }
        drift
    }

    #[test]
    fn heading_and_position_drift_by_a_rate() {
        let config = CovarianceConfig::default();
        let straight = |seconds| {
            let drift = walk(&config, seconds, |t| pose(0.0, 1.5 * t, 0.0));
            drift.covariance(&config)
        };
        assert_eq!(straight(0), Matrix6::zeros());
        // At first the rate is constant: of 2 s at 1.5 m/s, half of the heading error times 3 m.
        // To the left is along -z of the rig.
        let early = straight(2);
        let heading = early[(4, 4)].sqrt() / (2.0 * config.heading_rate_sigma);
        assert!((0.97..1.0).contains(&heading), "{heading}");
        let ratio = early[(2, 2)].sqrt() / early[(4, 4)].sqrt();
        assert!((ratio - 1.5).abs() < 0.02, "{ratio}");
        let correlation = early[(2, 4)] / (early[(2, 2)] * early[(4, 4)]).sqrt();
        assert!(correlation < -0.99, "{correlation}");
        let other = early.trace() - early[(2, 2)] - early[(4, 4)];
        assert!(other.abs() < 1e-15, "{early}");
        // Later it is a random walk.
        let late = (straight(8000)[(4, 4)] / straight(2000)[(4, 4)]).sqrt();
        assert!((late - 2.0).abs() < 0.05, "{late}");
    }

    #[test]
    fn heading_and_position_drift_by_the_net_turn() {
        let config = CovarianceConfig {
            heading_rate_sigma: 0.0,
            ..CovarianceConfig::default()
        };
        // Three quarters of a circle of 2 m in 20 s; headings in proportion to those of `scale`.
        let rate = 1.5 * std::f64::consts::PI / 20.0;
        let circle = |scale: f64| {
            move |t: f64| {
                let rate = scale * rate;
                let radius = 2.0 / scale;
                let (sin, cos) = (rate * t).sin_cos();
                pose(rate * t, radius * sin, radius * (1.0 - cos))
            }
        };
        let drift = walk(&config, 20, circle(1.0));
        let covariance = drift.covariance(&config);
        let (end, wrong) = (circle(1.0)(20.0), circle(1.0 + 1e-4)(20.0));
        let moved = (wrong.translation() - end.translation()) * 1e4;
        let moved = end.rotation().inverse() * moved;
        let turned = end.rotation().inverse() * Vector3::new(0.0, 0.0, 1.5 * std::f64::consts::PI);
        let expected = nalgebra::Vector6::from_iterator(moved.iter().chain(&turned).copied())
            * config.turn_scale_sigma;
        let error = covariance - expected * expected.transpose();
        assert!(
            error.amax() < 2e-3 * covariance.amax(),
            "{covariance} {expected}"
        );

        // As far to the right: neither a net turn nor its effect remains on the spot.
        let mut drift = HeadingDrift::default();
        for k in (0..=20).chain((0..20).rev()) {
            drift.add(&config, 0, &pose(0.1 * f64::from(k), 0.0, 0.0));
        }
        assert!(drift.covariance(&config).amax() < 1e-20);
    }
}
