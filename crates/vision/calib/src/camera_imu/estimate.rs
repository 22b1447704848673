//! The estimation: check, initialize, fit, reweight the noise, fit again, compare the halves.

use cad_transforms::RigidTransform;
use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::config::{Config, NoiseConfig};
use super::gates::{self, Evidence};
use super::initialization::{self, GravityEstimate};
use super::noise::{Noise, NoiseEstimates};
use super::observability;
use super::problem::{
    BOARD, DOWN, DRIFT, Factors, FitResult, OFFSET, Prior, Problem, ROTATION, ResidualSum, SHAPES,
    SHARED, Shared, State, TRANSLATION,
};
use super::recording::{Cameras, Corner, GRAVITY, Priors, Recording};
use super::result::{CameraImu, CameraImuError, Residual, Sigmas};
use super::so3;
use super::track::Track;
use super::view::{CameraMotion, Fit, Pose, View};

/// Runs the calibration with these `priors`; see the [module](super).
///
/// # Errors
/// Reasons for a missing result: [`CameraImuError`]. A questionable result is not an error but has
/// a failed [gate](CameraImu::gates) or an [unobservable direction](CameraImu::unobservable).
pub fn estimate(
    recording: &Recording,
    priors: &Priors,
    config: &Config,
) -> Result<CameraImu, CameraImuError> {
    check(recording)?;
    let mut posed_views = PosedViews::of(recording, *config)?;
    if recording.cameras.line_s == 0.0 {
        return Ok(posed_views.work(recording, priors).run()?.0);
    }
    // The motion of the camera during readout is poorly known from its views alone: at 10 Hz, an
    // oscillation of 1 Hz appears slower by a tenth. With a calibrated IMU it is known.
    posed_views.set_motions(&recording.cameras, &posed_views.motions());
    let (_, motions) = posed_views.work(recording, priors).run()?;
    posed_views.set_motions(&recording.cameras, &motions);
    Ok(posed_views.work(recording, priors).run()?.0)
}

/// IMU track and views with a pose.
struct PosedViews<'a> {
    config: Config,
    track: Track,
    views: Vec<View<'a>>,
    poses: Vec<Pose>,
    fits: Vec<Fit>,
}

impl<'a> PosedViews<'a> {
    fn of(recording: &'a Recording, config: Config) -> Result<Self, CameraImuError> {
        let zero_ns = recording.observations.first().map_or(0, |p| p.time_ns);
        let track = Track::new(&recording.imu, zero_ns, recording.range, &config.samples);
        let mut views = Vec::new();
        let mut poses = Vec::new();
        let mut fits = Vec::new();
        for observation in &recording.observations {
            let mut view = View {
                config: config.views,
                time_s: (observation.time_ns - zero_ns) as f64 * 1e-9,
                time_ns: observation.time_ns,
                corners: &observation.corners,
                inlier_corners: 0,
                motion: CameraMotion::NONE,
            };
            let found = view.pose(&recording.cameras);
            if let Some((pose, fit)) = found.filter(|(_, fit)| fit.scale < config.views.max_scale) {
                view.inlier_corners = fit.corners;
                views.push(view);
                poses.push(pose);
                fits.push(fit);
            }
        }
        if views.len() < config.samples.min_views {
            return Err(CameraImuError::TooFewViews {
                given: recording.observations.len(),
                found: views.len(),
                expected: config.samples.min_views,
            });
        }
        Ok(Self {
            config,
            track,
            views,
            poses,
            fits,
        })
    }

    fn work(&'a self, recording: &'a Recording, priors: &'a Priors) -> Estimator<'a> {
        Estimator {
            config: &self.config,
            recording,
            priors,
            track: &self.track,
            views: &self.views,
            poses: &self.poses,
            fits: &self.fits,
        }
    }

    /// Camera motion at each view, from the neighbouring views.
    fn motions(&self) -> Vec<CameraMotion> {
        let time_s = |i: usize| self.views[i].time_s;
        let of = |i: usize| {
            let near = |k: &usize| {
                (time_s(*k) - time_s(i)).abs() < self.config.views.max_motion_interval_s
            };
            let a = i.checked_sub(1).filter(near).unwrap_or(i);
            let b = (i + 1..self.views.len()).next().filter(near).unwrap_or(i);
            if a == b {
                return CameraMotion::NONE;
            }
            let seconds = time_s(b) - time_s(a);
            let (from, to) = (&self.poses[a], &self.poses[b]);
            CameraMotion {
                rate: so3::log(&(from.rotation.transpose() * to.rotation)) / seconds,
                velocity: (to.position - from.position) / seconds,
            }
        };
        (0..self.views.len()).map(of).collect()
    }

    /// Refines the poses for a camera with this motion.
    fn set_motions(&mut self, cameras: &Cameras, motions: &[CameraMotion]) {
        for (i, motion) in motions.iter().enumerate() {
            self.views[i].motion = *motion;
            let refined = self.views[i].refine(cameras, self.poses[i]);
            if let Some((pose, fit)) =
                refined.filter(|(_, fit)| fit.scale < self.config.views.max_scale)
            {
                (self.poses[i], self.fits[i]) = (pose, fit);
                self.views[i].inlier_corners = fit.corners;
            }
        }
    }
}

fn check(recording: &Recording) -> Result<(), CameraImuError> {
    let mut last = i64::MIN;
    for (index, observation) in recording.observations.iter().enumerate() {
        let what = "view";
        if observation.time_ns <= last && index > 0 {
            return Err(CameraImuError::Order { what, index });
        }
        last = observation.time_ns;
        let fine = |c: &Corner| {
            let finite = c.x_in_target.iter().chain(&c.pixel).all(|v| v.is_finite());
            finite && c.sigma_px.is_finite() && c.sigma_px > 0.0
        };
        if !observation.corners.iter().all(fine) {
            return Err(CameraImuError::NotFinite { what, index });
        }
    }
    let mut last = i64::MIN;
    for (index, sample) in recording.imu.iter().enumerate() {
        let what = "IMU sample";
        if sample.time_ns <= last && index > 0 {
            return Err(CameraImuError::Order { what, index });
        }
        last = sample.time_ns;
        if !sample
            .gyro
            .iter()
            .chain(&sample.accel)
            .all(|v| v.is_finite())
        {
            return Err(CameraImuError::NotFinite { what, index });
        }
    }
    Ok(())
}

struct Estimator<'a> {
    config: &'a Config,
    recording: &'a Recording,
    priors: &'a Priors,
    track: &'a Track,
    views: &'a [View<'a>],
    poses: &'a [Pose],
    fits: &'a [Fit],
}

impl Estimator<'_> {
    /// The result, and the camera motion at each view.
    fn run(&self) -> Result<(CameraImu, Vec<CameraMotion>), CameraImuError> {
        let config = &self.config.initialization;
        let times: Vec<f64> = self.views.iter().map(|v| v.time_s).collect();
        let nominal_rotation = self
            .priors
            .imu_from_left
            .map(|t| *t.rotation().to_rotation_matrix().matrix());
        let reach_s = config.offset_range_sigma * self.priors.time_offset_sigma_s;
        let rotation_estimate = initialization::from_rates(
            &times,
            self.poses,
            self.track,
            nominal_rotation.as_ref(),
            self.priors.time_offset_s,
            reach_s,
            config,
        );
        let links = self.links(rotation_estimate.time_offset_s);
        let linked = links.iter().filter(|&&linked| linked).count();
        if linked < self.config.samples.min_views {
            return Err(CameraImuError::NoOverlap {
                given: times.len() - 1,
                found: linked,
                expected: self.config.samples.min_views,
                searched_s: reach_s,
            });
        }
        if let Some(ratio) = rotation_estimate.rate_ratio
            && !(config.rate_ratio[0]..config.rate_ratio[1]).contains(&ratio)
        {
            return Err(CameraImuError::RateMismatch { ratio });
        }
        let gravity_estimate: Option<(Matrix3<f64>, GravityEstimate)> = rotation_estimate
            .rotations
            .iter()
            .filter_map(|rotation| {
                let gravity_estimate = initialization::from_forces(
                    &times,
                    self.poses,
                    self.track,
                    &rotation_estimate,
                    rotation,
                    self.priors,
                    config,
                )?;
                Some((*rotation, gravity_estimate))
            })
            .min_by(|a, b| a.1.error.total_cmp(&b.1.error));
        let Some((rotation, gravity_estimate)) = gravity_estimate else {
            return Err(CameraImuError::NoOverlap {
                given: times.len() - 1,
                found: linked,
                expected: self.config.samples.min_views,
                searched_s: reach_s,
            });
        };
        let gravity = gravity_estimate.gravity.norm();
        let [low, high] = config.gravity_ratio;
        if !(low * GRAVITY..high * GRAVITY).contains(&gravity) {
            return Err(CameraImuError::Gravity { found: gravity });
        }
        let fixed = observability::fixed_directions(
            &times,
            self.poses,
            (self.track, &self.recording.noise),
            &rotation_estimate,
            &rotation,
            self.priors,
            &self.config.observability,
        );
        let mut shared = Shared {
            rotation,
            translation: gravity_estimate.lever,
            offset_s: rotation_estimate.time_offset_s,
            drift: 0.0,
            gravity: gravity_estimate.gravity * (GRAVITY / gravity),
            board_scale: 1.0,
            gyro_shape: Matrix3::identity(),
            accel_shape: Matrix3::identity(),
        };
        let prior = self.prior(&shared, fixed);
        for direction in &prior.fixed.translation {
            let off = direction.dot(&(shared.translation - prior.shared.translation));
            shared.translation -= direction * off;
        }
        let states = self.states(
            &shared,
            rotation_estimate.gyro_bias,
            gravity_estimate.accel_bias,
        );
        let (first, last) = (times[0], times[times.len() - 1]);
        let mut scales: Vec<f64> = self.fits.iter().map(|fit| fit.scale).collect();
        scales.sort_by(f64::total_cmp);
        let mut problem = Problem {
            config: &self.config.solver,
            cameras: &self.recording.cameras,
            views: self.views,
            poses: self.poses,
            track: self.track,
            links: &links,
            noise: self.recording.noise,
            prior,
            corner_scale: scales[scales.len() / 2],
            factors: Factors::ONE,
            robust: false,
            middle_s: 0.5 * (first + last),
        };
        let no_end = |iterations| CameraImuError::NoEnd { iterations };
        let rough = problem.fit(states, shared).map_err(no_end)?;
        problem.factors = initial_factors(&problem.factors, &rough.medians, &self.config.noise);
        problem.robust = true;
        let mut fitted = problem.fit(rough.states, rough.shared).map_err(no_end)?;
        for _ in 1..self.config.noise.max_rounds {
            let Some(factors) = reweighted(&problem.factors, &fitted.sums, &self.config.noise)
            else {
                break;
            };
            problem.factors = factors;
            fitted = problem.fit(fitted.states, fitted.shared).map_err(no_end)?;
        }
        let halves = self.halves_chi2(&problem, &fitted);
        let motions = problem.motions(&fitted);
        Ok((
            self.result(&problem, &fitted, halves, rotation_estimate.correlation),
            motions,
        ))
    }

    /// Whether the IMU connects each view with the next one.
    fn links(&self, offset_s: f64) -> Vec<bool> {
        let config = &self.config.samples;
        let mut raw = Vec::new();
        let mut link = |pair: &[View<'_>]| {
            let (a, b) = (pair[0].time_s + offset_s, pair[1].time_s + offset_s);
            let near = b - a <= config.max_view_interval_s;
            near && self
                .track
                .between(
                    a - config.offset_margin_s,
                    b + config.offset_margin_s,
                    &mut raw,
                )
                .is_some()
        };
        self.views.windows(2).map(&mut link).collect()
    }

    /// States at the poses of the views; velocities from the neighbours.
    fn states(
        &self,
        shared: &Shared,
        gyro_bias: Vector3<f64>,
        accel_bias: Vector3<f64>,
    ) -> Vec<State> {
        let imu: Vec<_> = self.poses.iter().map(|pose| shared.imu(pose)).collect();
        (0..imu.len())
            .map(|i| {
                let (a, b) = (i.saturating_sub(1), (i + 1).min(imu.len() - 1));
                let seconds = self.views[b].time_s - self.views[a].time_s;
                State {
                    rotation: imu[i].0,
                    position: imu[i].1,
                    velocity: (imu[b].1 - imu[a].1) / seconds,
                    gyro_bias,
                    accel_bias,
                }
            })
            .collect()
    }

    fn prior(&self, start: &Shared, fixed: observability::FixedDirections) -> Prior {
        let priors = self.priors;
        let mut sigmas = SVector::<f64, SHARED>::repeat(f64::INFINITY);
        let [scale, skew] = priors.scale_and_skew_sigma;
        for k in 0..3 {
            sigmas[ROTATION + k] = priors.rotation_sigma_rad;
            sigmas[TRANSLATION + k] = priors.translation_sigma_m;
        }
        sigmas[OFFSET] = priors.time_offset_sigma_s;
        sigmas[DRIFT] = priors.time_drift_sigma;
        sigmas[BOARD] = priors.board_scale_sigma;
        for k in 0..9 {
            let sigma = if k % 4 == 0 { scale } else { skew };
            sigmas[SHAPES + k] = sigma;
            sigmas[SHAPES + 9 + k] = sigma;
        }
        let mut shared = *start;
        shared.translation = Vector3::zeros();
        if let Some(imu_from_left) = &priors.imu_from_left {
            shared.rotation = *imu_from_left.rotation().to_rotation_matrix().matrix();
            shared.translation = *imu_from_left.translation();
        }
        shared.offset_s = priors.time_offset_s;
        Prior {
            shared,
            sigmas,
            fixed,
            biases: priors.bias_sigma,
        }
    }

    /// Deviations of parts of the recording: rotation, translation and offset of each part minus
    /// those of all, with their covariance. Board size, drift, scale and skew are fixed to the
    /// values of all. `None` if a part has too little data.
    fn part_deviations(
        &self,
        problem: &Problem<'_>,
        fitted: &FitResult,
        count: usize,
    ) -> Option<Vec<(SVector<f64, 7>, SMatrix<f64, 7, 7>)>> {
        let links = problem.links;
        let mut prior = problem.prior.clone();
        prior.shared.drift = fitted.shared.drift;
        prior.shared.board_scale = fitted.shared.board_scale;
        prior.shared.gyro_shape = fitted.shared.gyro_shape;
        prior.shared.accel_shape = fitted.shared.accel_shape;
        for k in [DRIFT, BOARD].into_iter().chain(SHAPES..SHARED) {
            prior.sigmas[k] = 1e-8;
        }
        let part = |k: usize| {
            let [begin, end] = [k, k + 1].map(|k| k * self.views.len() / count);
            let links = &links[begin..end - 1];
            if links.iter().filter(|linked| **linked).count()
                < self.config.gates.min_intervals_per_half
            {
                return None;
            }
            let part = Problem {
                views: &self.views[begin..end],
                poses: &self.poses[begin..end],
                links,
                prior: prior.clone(),
                ..*problem
            };
            let found = part
                .fit(fitted.states[begin..end].to_vec(), fitted.shared)
                .ok()?;
            let mut off = SVector::<f64, 7>::zeros();
            let turn = so3::log(&(fitted.shared.rotation.transpose() * found.shared.rotation));
            off.fixed_rows_mut::<3>(0).copy_from(&turn);
            let shift = found.shared.translation - fitted.shared.translation;
            off.fixed_rows_mut::<3>(3).copy_from(&shift);
            off[6] = found.shared.offset_s - fitted.shared.offset_s;
            Some((off, found.covariance.shared.fixed_view::<7, 7>(0, 0).into()))
        };
        (0..count).map(part).collect()
    }

    /// Chi-squared of the difference of both halves, with seven degrees of freedom.
    fn halves_chi2(&self, problem: &Problem<'_>, fitted: &FitResult) -> Option<f64> {
        let [(a, of_a), (b, of_b)] = self.part_deviations(problem, fitted, 2)?.try_into().ok()?;
        let apart = b - a;
        Some(apart.dot(&(of_a + of_b).cholesky()?.solve(&apart)))
    }

    /// Variances of rotation and translation due to lens errors, rad² and m².
    fn lens_error_variances(&self) -> [f64; 2] {
        let model = self.recording.cameras.left.model();
        let angle = self.config.views.lens_error_px / (0.5 * (model.fx + model.fy));
        let distance_m = |(view, pose): (&View<'_>, &Pose)| {
            let sum: Vector3<f64> = view
                .corners
                .iter()
                .map(|c| Vector3::from(c.x_in_target))
                .sum();
            (sum / view.corners.len() as f64 - pose.position).norm()
        };
        let mut distances: Vec<f64> = self.views.iter().zip(self.poses).map(distance_m).collect();
        distances.sort_by(f64::total_cmp);
        [angle, angle * distances[distances.len() / 2]].map(|sigma| sigma * sigma)
    }

    fn result(
        &self,
        problem: &Problem<'_>,
        fitted: &FitResult,
        halves: Option<f64>,
        correlation: Vec<[f64; 2]>,
    ) -> CameraImu {
        let shared = &fitted.shared;
        // Fixed directions have the uncertainty of their prior and add nothing to the rest.
        let mut covariance = fitted.covariance.shared;
        let prior = &problem.prior;
        for (at, fixed) in [
            (ROTATION, &prior.fixed.rotation),
            (TRANSLATION, &prior.fixed.translation),
        ] {
            for direction in fixed {
                let mut block = covariance.fixed_view_mut::<3, 3>(at, at);
                block += direction * direction.transpose() * prior.sigmas[at].powi(2);
            }
        }
        for axis in &prior.fixed.rotation {
            // A lever arm from the views rotates with the IMU frame.
            let rotation_estimate = (shared.rotation * axis).cross(&shared.translation);
            let mut block = covariance.fixed_view_mut::<3, 3>(TRANSLATION, TRANSLATION);
            block +=
                rotation_estimate * rotation_estimate.transpose() * prior.sigmas[ROTATION].powi(2);
        }
        if prior.fixed.offset {
            covariance[(OFFSET, OFFSET)] += prior.sigmas[OFFSET].powi(2);
        }
        for (at, variance) in [ROTATION, TRANSLATION]
            .into_iter()
            .zip(self.lens_error_variances())
        {
            for k in at..at + 3 {
                covariance[(k, k)] += variance;
            }
        }
        let covariance = &covariance;
        let sigma = |k: usize| covariance[(k, k)].max(0.0).sqrt();
        let three = |k: usize| [sigma(k), sigma(k + 1), sigma(k + 2)];
        let middle = fitted.states.len() / 2;
        let state = &fitted.states[middle];
        let own = &fitted.covariance.own[middle];
        let bias = |k: usize| [0, 1, 2].map(|i| own[(k + i, k + i)].max(0.0).sqrt());
        let sigmas = Sigmas {
            rotation_rad: three(ROTATION),
            translation_m: three(TRANSLATION),
            time_offset_s: sigma(OFFSET),
            time_drift: sigma(DRIFT),
            gravity_rad: [sigma(DOWN), sigma(DOWN + 1)],
            gyro_bias: bias(9),
            accel_bias: bias(12),
            board_scale: sigma(BOARD),
        };
        let noises = noises(problem, &fitted.sums, self.fits);
        let residuals: Vec<Residual> = (self.views.iter().zip(self.fits).zip(&fitted.locals))
            .map(|((view, fit), local)| Residual {
                time_ns: view.time_ns,
                corners: [fit.corners, fit.outliers],
                corner: (fit.squares / (2 * fit.corners.max(1)) as f64).sqrt(),
                pose: local.pose.sqrt(),
                gyro: local.gyro.map(f64::sqrt),
                accel: local.accel.map(f64::sqrt),
            })
            .collect();
        let outliers = fitted
            .locals
            .iter()
            .filter(|l| l.weight < self.config.gates.outlier_weight)
            .count();
        let evidence = Evidence {
            config: &self.config.gates,
            noises: &noises,
            covariance,
            prior: &problem.prior,
            shared,
            halves,
            seconds: self.views[self.views.len() - 1].time_s - self.views[0].time_s,
            views: self.views.len(),
            outliers,
            linked: problem.links.iter().filter(|&&l| l).count(),
        };
        let unobservable = gates::unobservable(&evidence);
        let gates = gates::gates(&evidence, &unobservable);
        CameraImu {
            config: *self.config,
            imu_from_left: transform(shared),
            time_offset_s: shared.offset_s,
            time_drift: shared.drift,
            gravity_in_target: shared.gravity.into(),
            gyro_bias: state.gyro_bias.into(),
            accel_bias: state.accel_bias.into(),
            board_scale: shared.board_scale,
            gyro_shape: rows(&shared.gyro_shape),
            accel_shape: rows(&shared.accel_shape),
            sigmas,
            covariance: covariance.fixed_view::<7, 7>(0, 0).into(),
            unobservable,
            gates,
            noises,
            correlation,
            residuals,
            views: [
                self.recording.observations.len(),
                self.views.len(),
                outliers,
            ],
        }
    }
}

fn rows(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|r| [0, 1, 2].map(|c| m[(r, c)]))
}

fn transform(shared: &Shared) -> RigidTransform {
    let rotation = Rotation3::from_matrix_unchecked(shared.rotation);
    let q = UnitQuaternion::from_rotation_matrix(&rotation);
    RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], shared.translation.into())
        .expect("a fit that ended is finite")
}

/// Initial noise factors before outlier rejection: so large that half of all residuals fit. Their
/// median is below 1 even with nominal noise, since the fit absorbs a part.
fn initial_factors(factors: &Factors, medians: &[f64; 3], config: &NoiseConfig) -> Factors {
    let most = config.max_initial_median;
    let [poses, gyro, accel] = medians.map(|m| if m > most { (2.0 * m).sqrt() } else { 1.0 });
    Factors {
        poses: factors.poses * poses,
        gyro: factors.gyro * gyro,
        accel: factors.accel * accel,
        ..*factors
    }
}

/// Noise factors adjusted to the residuals (variance components: Förstner 1979); `None` if they
/// agree already. Bias random walks only grow: a small bias change proves nothing.
fn reweighted(factors: &Factors, sums: &[ResidualSum; 5], config: &NoiseConfig) -> Option<Factors> {
    let ratio = |s: usize, factor: f64| {
        let sum = &sums[s];
        if sum.redundancy < config.min_redundancy {
            return factor;
        }
        let ratio = sum.squares / sum.redundancy;
        let chance = config.significance_sigma * (2.0 / sum.redundancy).sqrt();
        if (ratio - 1.0).abs() < chance.max(config.min_variance_change) {
            return factor;
        }
        (factor * ratio.sqrt()).clamp(config.min_factors[s], config.max_factor)
    };
    let next = Factors {
        poses: ratio(0, factors.poses),
        gyro: ratio(1, factors.gyro),
        accel: ratio(2, factors.accel),
        gyro_walk: ratio(3, factors.gyro_walk),
        accel_walk: ratio(4, factors.accel_walk),
    };
    (next != *factors).then_some(next)
}

fn noises(problem: &Problem<'_>, sums: &[ResidualSum; 5], fits: &[Fit]) -> NoiseEstimates {
    let noise = |ratio_to_nominal: f64, s: usize| Noise {
        ratio_to_nominal,
        redundancy: sums[s].redundancy,
    };
    let corners: usize = fits.iter().map(|f| 2 * f.corners - 6).sum();
    let f = &problem.factors;
    NoiseEstimates {
        corners: Noise {
            ratio_to_nominal: problem.corner_scale,
            redundancy: corners as f64,
        },
        poses: noise(f.poses, 0),
        gyro: noise(f.gyro, 1),
        accel: noise(f.accel, 2),
        gyro_walk: noise(f.gyro_walk, 3),
        accel_walk: noise(f.accel_walk, 4),
    }
}

pub(super) mod reference;
