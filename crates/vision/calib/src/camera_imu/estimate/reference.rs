//! Both formulations from the same initial values: the one that [`estimate`] uses, and the
//! reference implementation.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::super::config::Config;
use super::super::observability;
use super::super::problem::spline::{Motion, Whole};
use super::super::problem::{Factors, Problem, Shared};
use super::super::recording::{Priors, Recording};
use super::super::result::CameraImuError;
use super::super::so3;
use super::super::track::Raw;
use super::{PosedViews, estimate};
use camera_models::ImuSample;

/// A recording prepared for both formulations, with nominal noise and the same initial values, 9
/// mrad, 7 mm and 0.5 ms from the result of [`estimate`]. For recordings without a rolling shutter.
/// Comparison: docs/decisions/0006-camera-imu.md.
pub struct Formulations<'a> {
    recording: &'a Recording,
    posed_views: PosedViews<'a>,
    priors: Priors,
    shared: Shared,
}

/// Result of a formulation.
#[derive(Clone, Copy, Debug)]
pub struct FormulationResult {
    /// Rotation matrix of `imu_from_left`.
    pub rotation: Matrix3<f64>,
    /// Its translation, m.
    pub translation: Vector3<f64>,
    /// `t_imu - t_camera`, s.
    pub time_offset_s: f64,
    /// Covariance of rotation (in the left optical frame, rad), translation (m) and time offset
    /// (s).
    pub covariance: SMatrix<f64, 7, 7>,
    /// Mean squared residual over its variance: by degree of freedom, for the spline by residual.
    pub misfit: f64,
}

impl<'a> Formulations<'a> {
    /// # Errors
    /// Those of [`estimate`].
    pub fn new(recording: &'a Recording) -> Result<Self, CameraImuError> {
        let priors = Priors::default();
        let found = estimate(recording, &priors, &Config::default())?;
        let rotation = found.imu_from_left.rotation().to_rotation_matrix();
        let shared = Shared {
            rotation: rotation.matrix() * so3::exp(&Vector3::new(5e-3, -5e-3, 5e-3)),
            translation: found.imu_from_left.translation() + Vector3::new(5e-3, 0.0, -5e-3),
            offset_s: found.time_offset_s + 5e-4,
            drift: 0.0,
            gravity: Vector3::from(found.gravity_in_target),
            board_scale: 1.0,
            gyro_shape: Matrix3::identity(),
            accel_shape: Matrix3::identity(),
        };
        Ok(Self {
            recording,
            posed_views: PosedViews::of(recording, Config::default())?,
            priors,
            shared,
        })
    }

    /// States at the views, IMU samples between them preintegrated. `None` if the fit does not
    /// converge.
    pub fn preintegrated(&self) -> Option<FormulationResult> {
        self.with(|problem| {
            let work = self.posed_views.work(self.recording, &self.priors);
            let states = work.states(&self.shared, Vector3::zeros(), Vector3::zeros());
            let fitted = problem.fit(states, self.shared).ok()?;
            let squares: f64 = fitted.sums.iter().map(|s| s.squares).sum();
            let freedom: f64 = fitted.sums.iter().map(|s| s.redundancy).sum();
            let covariance = fitted.covariance.shared.fixed_view::<7, 7>(0, 0).into();
            Some(FormulationResult::of(
                &fitted.shared,
                covariance,
                squares / freedom,
            ))
        })
    }

    /// A cubic B-spline with a knot spacing of `knot_s`, every IMU sample a residual. `None` if the
    /// fit does not converge.
    pub fn spline(&self, knot_s: f64) -> Option<FormulationResult> {
        let zero_ns = self.recording.observations[0].time_ns;
        let raw = |s: &ImuSample| Raw {
            time_s: (s.time_ns - zero_ns) as f64 * 1e-9,
            gyro: Vector3::from(s.gyro),
            accel: Vector3::from(s.accel),
        };
        let raw: Vec<Raw> = self.recording.imu.iter().map(raw).collect();
        let posed_views = self.posed_views.poses.iter().zip(&self.posed_views.views);
        let poses: Vec<_> = posed_views
            .map(|(pose, view)| {
                let (rotation, position) = self.shared.imu(pose);
                (view.time_s, rotation, position)
            })
            .collect();
        let whole = Whole {
            motion: Motion::near(knot_s, &poses, 0.0),
            shared: self.shared,
            biases: [Vector3::zeros(); 2],
        };
        self.with(|problem| {
            let fit = problem.fit_spline(&raw, whole)?;
            let covariance = fit.covariance.fixed_view::<7, 7>(0, 0).into();
            Some(FormulationResult::of(
                &fit.whole.shared,
                covariance,
                fit.misfit,
            ))
        })
    }

    fn with<T>(&self, of: impl FnOnce(&Problem<'_>) -> T) -> T {
        let work = self.posed_views.work(self.recording, &self.priors);
        let views = &self.posed_views.views;
        of(&Problem {
            config: &self.posed_views.config.solver,
            cameras: &self.recording.cameras,
            views,
            poses: &self.posed_views.poses,
            track: &self.posed_views.track,
            links: &work.links(self.shared.offset_s),
            noise: self.recording.noise,
            prior: work.prior(&self.shared, observability::FixedDirections::default()),
            corner_scale: 1.0,
            factors: Factors::ONE,
            robust: true,
            middle_s: 0.5 * views[views.len() - 1].time_s,
        })
    }
}

impl FormulationResult {
    fn of(shared: &Shared, covariance: SMatrix<f64, 7, 7>, misfit: f64) -> Self {
        Self {
            rotation: shared.rotation,
            translation: shared.translation,
            time_offset_s: shared.offset_s,
            covariance,
            misfit,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::simulate::{Scene, simulate};
    use super::*;

    #[test]
    fn formulations_agree() {
        let scene = Scene {
            board: ([6, 5], 0.11),
            ..Scene::lively(5.0)
        };
        let recording = simulate(&scene, 3).recording;
        let both = Formulations::new(&recording).unwrap();
        let (ours, reference) = (both.preintegrated().unwrap(), both.spline(0.03).unwrap());
        let turn = so3::log(&(ours.rotation.transpose() * reference.rotation));
        let shift = reference.translation - ours.translation;
        let late = reference.time_offset_s - ours.time_offset_s;
        let sigma = |of: &FormulationResult, at: usize, n: usize| {
            of.covariance.view((at, at), (n, n)).trace().sqrt()
        };
        let apart = [turn.norm(), shift.norm(), late.abs()];
        for ((at, n), apart) in [(0, 3), (3, 3), (6, 1)].into_iter().zip(apart) {
            let (ours, reference) = (sigma(&ours, at, n), sigma(&reference, at, n));
            assert!(apart < ours, "{apart} of {ours}");
            // A spline with this knot spacing absorbs a little less noise.
            assert!(
                (0.6..1.1).contains(&(reference / ours)),
                "{ours} {reference}"
            );
        }
    }
}
