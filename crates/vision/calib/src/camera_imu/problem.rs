//! The joint problem: all views, the IMU between them, and the priors; and its solver.
//!
//! States, one per view: pose and velocity of the IMU in the target's frame, and its biases. All
//! other parameters are shared: `imu_from_left`, time offset and drift, direction of gravity, size
//! of the board, scale and skew of the sensors. Damped Gauss–Newton; each iteration preintegrates
//! the IMU again at the current offset and biases, so that nothing is approximated but the second
//! derivatives.

use camera_models::ImuNoise;
use nalgebra::{Cholesky, Matrix3, SMatrix, SVector, Vector3};

use super::chain::{Chain, Covariance};
use super::config::SolverConfig;
use super::observability::FixedDirections;
use super::preintegrate::{ACCEL_SHAPE, GYRO_SHAPE, SENSOR, preintegrate};
use super::recording::{Cameras, GRAVITY};
use super::so3;
use super::track::{Correction, Raw, Track};
use super::view::{CameraMotion, Pose, Quadric, VIEW, View};

/// Error state: rotation 3, position 3, velocity 3, gyroscope bias 3, accelerometer bias 3.
pub(super) const STATE: usize = 15;
const VELOCITY: usize = 6;
const BIAS: usize = 9;

/// Shared: rotation 3, translation 3, offset, drift, gravity 2, board, shapes 9 and 9.
pub(super) const SHARED: usize = 29;
pub(super) const ROTATION: usize = 0;
pub(super) const TRANSLATION: usize = 3;
pub(super) const OFFSET: usize = 6;
pub(super) const DRIFT: usize = 7;
pub(super) const DOWN: usize = 8;
pub(super) const BOARD: usize = 10;
pub(super) const SHAPES: usize = 11;

/// State of one instant: coordinates of the IMU in the target's frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    pub rotation: Matrix3<f64>,
    pub position: Vector3<f64>,
    pub velocity: Vector3<f64>,
    pub gyro_bias: Vector3<f64>,
    pub accel_bias: Vector3<f64>,
}

/// Parameters shared by all instants.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shared {
    /// Rotation of `imu_from_left`.
    pub rotation: Matrix3<f64>,
    pub translation: Vector3<f64>,
    pub offset_s: f64,
    pub drift: f64,
    /// In the target's frame, m/s².
    pub gravity: Vector3<f64>,
    pub board_scale: f64,
    pub gyro_shape: Matrix3<f64>,
    pub accel_shape: Matrix3<f64>,
}

/// Prior on the shared parameters: values, and one sigma for each (infinite for none).
#[derive(Clone, Debug)]
pub(super) struct Prior {
    pub shared: Shared,
    pub sigmas: SVector<f64, SHARED>,
    /// Directions that are fixed, whatever their sigma.
    pub fixed: FixedDirections,
    pub biases: [f64; 2],
}

/// Noise factors: factors on the standard deviations of each kind of measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Factors {
    pub poses: f64,
    pub gyro: f64,
    pub accel: f64,
    pub gyro_walk: f64,
    pub accel_walk: f64,
}

impl Factors {
    pub(super) const ONE: Self = Self {
        poses: 1.0,
        gyro: 1.0,
        accel: 1.0,
        gyro_walk: 1.0,
        accel_walk: 1.0,
    };
}

/// Input of the fit.
pub(super) struct Problem<'a> {
    pub config: &'a SolverConfig,
    pub cameras: &'a Cameras,
    pub views: &'a [View<'a>],
    /// The pose that fits each view alone.
    pub poses: &'a [Pose],
    pub track: &'a Track,
    /// Whether IMU samples are complete from view `i` to the next.
    pub links: &'a [bool],
    pub noise: ImuNoise,
    pub prior: Prior,
    pub corner_scale: f64,
    pub factors: Factors,
    /// Whether the robust loss is used.
    pub robust: bool,
    /// Time at which the drift has no effect.
    pub middle_s: f64,
}

/// A quadric as a whitened residual: `root x + offset`.
struct WhitenedView {
    pose: Pose,
    board_scale: f64,
    root: SMatrix<f64, VIEW, VIEW>,
    offset: SVector<f64, VIEW>,
    /// Rank: 6 for a single eye.
    rank: usize,
}

impl WhitenedView {
    fn new(quadric: &Quadric) -> Option<Self> {
        let mut information = quadric.information;
        let six: SMatrix<f64, 6, 6> = information.fixed_view::<6, 6>(0, 0).into();
        let with_board: SVector<f64, 6> = information.fixed_view::<6, 1>(0, 6).into();
        let six = Cholesky::new(six)?;
        let alone = information[(6, 6)] - with_board.dot(&six.solve(&with_board));
        let seen = alone > 1e-7 * information[(6, 6)];
        information[(6, 6)] += 1e-9 * information[(6, 6)] + 1e-9;
        let lower = Cholesky::new(information)?.unpack();
        Some(Self {
            pose: quadric.pose,
            board_scale: quadric.board_scale,
            root: lower.transpose(),
            offset: lower.solve_lower_triangular(&quadric.gradient)?,
            rank: if seen { 7 } else { 6 },
        })
    }
}

/// Residual sums of one kind of measurement.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ResidualSum {
    pub squares: f64,
    /// Number of residuals minus their leverage.
    pub redundancy: f64,
}

/// Residuals of one view and of the interval that follows it, in sigmas.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct IntervalResiduals {
    /// Mean squares.
    pub pose: f64,
    pub gyro: Option<f64>,
    pub accel: Option<f64>,
    /// Weight of the view in the robust loss.
    pub weight: f64,
}

/// Result of the fit.
pub(super) struct FitResult {
    pub states: Vec<State>,
    pub shared: Shared,
    pub covariance: Covariance<STATE, SHARED>,
    /// Poses, gyroscope, accelerometer, gyroscope bias walk, accelerometer bias walk.
    pub sums: [ResidualSum; 5],
    /// Medians over views and intervals of the mean squares of the first three kinds.
    pub medians: [f64; 3],
    pub locals: Vec<IntervalResiduals>,
}

/// Whitened residual and Jacobians of one factor.
struct WhitenedFactor<const M: usize> {
    residual: SVector<f64, M>,
    own: SMatrix<f64, M, STATE>,
    next: Option<SMatrix<f64, M, STATE>>,
    shared: SMatrix<f64, M, SHARED>,
    /// Weight from the robust loss.
    weight: f64,
}

impl<const M: usize> WhitenedFactor<M> {
    /// Applies the Huber loss with this threshold, infinite for none; returns the cost.
    fn apply_loss(&mut self, threshold: f64) -> f64 {
        let length = self.residual.norm();
        if length <= threshold || threshold == f64::INFINITY {
            return length * length;
        }
        self.weight = threshold / length;
        2.0 * threshold * length - threshold * threshold
    }

    fn add(&self, i: usize, chain: &mut Chain<STATE, SHARED>) {
        let root = self.weight.sqrt();
        let next = self.next.map(|n| n * root);
        chain.add(
            i,
            &(self.residual * root),
            &(self.own * root),
            next.as_ref(),
            &(self.shared * root),
        );
    }

    fn leverage(&self, i: usize, covariance: &Covariance<STATE, SHARED>) -> [f64; M] {
        let taken = covariance.leverage(i, &self.own, self.next.as_ref(), &self.shared);
        taken.map(|v| v * self.weight)
    }
}

impl Shared {
    /// Pose of the left camera at a state.
    pub(super) fn camera(&self, state: &State) -> Pose {
        Pose {
            rotation: state.rotation * self.rotation,
            position: state.position + state.rotation * self.translation,
        }
    }

    /// Pose of the IMU from that of the left camera.
    pub(super) fn imu(&self, camera: &Pose) -> (Matrix3<f64>, Vector3<f64>) {
        let rotation = camera.rotation * self.rotation.transpose();
        (rotation, camera.position - rotation * self.translation)
    }

    /// Basis of the tangent plane of gravity.
    fn gravity_tangent(&self) -> SMatrix<f64, 3, 2> {
        let down = self.gravity.normalize();
        let other = match down.x.abs() < 0.7 {
            true => Vector3::x(),
            false => Vector3::y(),
        };
        let first = down.cross(&other).normalize();
        SMatrix::<f64, 3, 2>::from_columns(&[first, down.cross(&first)])
    }

    fn moved(&self, step: &SVector<f64, SHARED>) -> Self {
        let three = |k: usize| -> Vector3<f64> { step.fixed_rows::<3>(k).into() };
        let nine = |k: usize| Matrix3::from_row_slice(&step.as_slice()[k..k + 9]);
        let gravity_tangent =
            self.gravity_tangent() * SVector::<f64, 2>::new(step[DOWN], step[DOWN + 1]);
        Self {
            rotation: so3::tidy(&(self.rotation * so3::exp(&three(ROTATION)))),
            translation: self.translation + three(TRANSLATION),
            offset_s: self.offset_s + step[OFFSET],
            drift: self.drift + step[DRIFT],
            gravity: (self.gravity.normalize() + gravity_tangent).normalize() * GRAVITY,
            board_scale: self.board_scale + step[BOARD],
            gyro_shape: self.gyro_shape + nine(SHAPES),
            accel_shape: self.accel_shape + nine(SHAPES + 9),
        }
    }

    fn correction(&self, state: &State) -> Option<Correction> {
        Some(Correction {
            gyro_bias: state.gyro_bias,
            accel_bias: state.accel_bias,
            gyro_shape_inverse: self.gyro_shape.try_inverse()?,
            accel_shape_inverse: self.accel_shape.try_inverse()?,
        })
    }

    fn imu_time(&self, time_s: f64, middle_s: f64) -> f64 {
        time_s + self.offset_s + self.drift * (time_s - middle_s)
    }
}

impl State {
    fn moved(&self, step: &SVector<f64, STATE>) -> Self {
        let three = |k: usize| -> Vector3<f64> { step.fixed_rows::<3>(k).into() };
        Self {
            rotation: so3::tidy(&(self.rotation * so3::exp(&three(0)))),
            position: self.position + three(3),
            velocity: self.velocity + three(VELOCITY),
            gyro_bias: self.gyro_bias + three(BIAS),
            accel_bias: self.accel_bias + three(BIAS + 3),
        }
    }
}

impl Prior {
    fn factor(&self, shared: &Shared, fixed_sigma: [f64; 3]) -> WhitenedFactor<SHARED> {
        let nominal = &self.shared;
        let turn = so3::log(&(nominal.rotation.transpose() * shared.rotation));
        let mut residual = SVector::<f64, SHARED>::zeros();
        residual.fixed_rows_mut::<3>(ROTATION).copy_from(&turn);
        residual
            .fixed_rows_mut::<3>(TRANSLATION)
            .copy_from(&(shared.translation - nominal.translation));
        residual[OFFSET] = shared.offset_s - nominal.offset_s;
        residual[DRIFT] = shared.drift - nominal.drift;
        residual[BOARD] = shared.board_scale - nominal.board_scale;
        let shapes = [
            shared.gyro_shape - nominal.gyro_shape,
            shared.accel_shape - nominal.accel_shape,
        ];
        for (s, shape) in shapes.iter().enumerate() {
            for k in 0..9 {
                residual[SHAPES + 9 * s + k] = shape[(k / 3, k % 3)];
            }
        }
        let mut by_shared = SMatrix::<f64, SHARED, SHARED>::identity();
        by_shared
            .fixed_view_mut::<3, 3>(ROTATION, ROTATION)
            .copy_from(&so3::right_jacobian_inverse(&turn));
        let mut root = SMatrix::<f64, SHARED, SHARED>::from_diagonal(&self.sigmas.map(|s| 1.0 / s));
        for (at, fixed) in [
            (ROTATION, &self.fixed.rotation),
            (TRANSLATION, &self.fixed.translation),
        ] {
            for direction in fixed {
                let mut block = root.fixed_view_mut::<3, 3>(at, at);
                block +=
                    direction * direction.transpose() * (1.0 / fixed_sigma[usize::from(at > 0)]);
            }
        }
        if self.fixed.offset {
            root[(OFFSET, OFFSET)] = 1.0 / fixed_sigma[2];
        }
        let residual = root * residual;
        let by_shared = root * by_shared;
        WhitenedFactor {
            residual,
            own: SMatrix::zeros(),
            next: None,
            shared: by_shared,
            weight: 1.0,
        }
    }
}

impl Problem<'_> {
    fn loss_threshold(&self) -> f64 {
        match self.robust {
            true => self.config.huber_sigma,
            false => f64::INFINITY,
        }
    }

    /// Motion of the left camera at each view of a fit, by the IMU where it has samples.
    pub(super) fn motions(&self, fitted: &FitResult) -> Vec<CameraMotion> {
        let shared = &fitted.shared;
        let readout_s = self.cameras.line_s.abs() * f64::from(self.cameras.left.model().height);
        let half_s = (0.5 * readout_s).max(self.track.period_s);
        let of = |(view, state): (&View<'_>, &State)| {
            let middle_s = shared.imu_time(view.time_s, self.middle_s);
            let measured = self.track.means(middle_s - half_s, middle_s + half_s);
            let (Some([gyro, accel]), Some(correction)) = (measured, shared.correction(state))
            else {
                return view.motion;
            };
            let raw = Raw {
                time_s: middle_s,
                gyro,
                accel,
            };
            let rate = correction.gyro(&raw);
            CameraMotion {
                rate: shared.rotation.transpose() * rate,
                velocity: state.velocity + state.rotation * rate.cross(&shared.translation),
            }
        };
        self.views.iter().zip(&fitted.states).map(of).collect()
    }

    fn view_factor(
        &self,
        rooted: &WhitenedView,
        state: &State,
        shared: &Shared,
    ) -> WhitenedFactor<VIEW> {
        let camera = shared.camera(state);
        let turn = so3::log(&(rooted.pose.rotation.transpose() * camera.rotation));
        let mut x = SVector::<f64, VIEW>::zeros();
        x.fixed_rows_mut::<3>(0).copy_from(&turn);
        x.fixed_rows_mut::<3>(3)
            .copy_from(&(camera.position - rooted.pose.position));
        x[6] = shared.board_scale - rooted.board_scale;
        let bent = so3::right_jacobian_inverse(&turn);
        let mut own = SMatrix::<f64, VIEW, STATE>::zeros();
        own.fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(bent * shared.rotation.transpose()));
        own.fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&-(state.rotation * shared.translation.cross_matrix()));
        own.fixed_view_mut::<3, 3>(3, 3).fill_with_identity();
        let mut by_shared = SMatrix::<f64, VIEW, SHARED>::zeros();
        by_shared
            .fixed_view_mut::<3, 3>(0, ROTATION)
            .copy_from(&bent);
        by_shared
            .fixed_view_mut::<3, 3>(3, TRANSLATION)
            .copy_from(&state.rotation);
        by_shared[(6, BOARD)] = 1.0;
        let weight = 1.0 / self.factors.poses;
        WhitenedFactor {
            residual: (rooted.root * x + rooted.offset) * weight,
            own: rooted.root * own * weight,
            next: None,
            shared: rooted.root * by_shared * weight,
            weight: 1.0,
        }
    }

    fn inertial(
        &self,
        i: usize,
        states: &[State],
        shared: &Shared,
        raw: &mut Vec<Raw>,
    ) -> Option<WhitenedFactor<9>> {
        let (mut plain, covariance) = self.inertial_plain(i, states, shared, raw)?;
        let lower = Cholesky::new(covariance)?;
        let lower = lower.l_dirty();
        lower.solve_lower_triangular_mut(&mut plain.residual);
        lower.solve_lower_triangular_mut(&mut plain.own);
        lower.solve_lower_triangular_mut(plain.next.as_mut()?);
        lower.solve_lower_triangular_mut(&mut plain.shared);
        Some(plain)
    }

    /// Residual in rad, m/s and m, with its covariance.
    fn inertial_plain(
        &self,
        i: usize,
        states: &[State],
        shared: &Shared,
        raw: &mut Vec<Raw>,
    ) -> Option<(WhitenedFactor<9>, SMatrix<f64, 9, 9>)> {
        let (a, b) = (&states[i], &states[i + 1]);
        let [from, to] = [i, i + 1].map(|k| shared.imu_time(self.views[k].time_s, self.middle_s));
        self.track.between(from, to, raw)?;
        let densities = [
            self.noise.gyro_noise_density,
            self.noise.accel_noise_density,
        ];
        let moved = preintegrate(raw, &shared.correction(a)?, densities);
        let t = moved.seconds;
        let gravity = &shared.gravity;
        let back = a.rotation.transpose();
        let rotated = back * b.rotation;
        let turn = so3::log(&(moved.turn.transpose() * rotated));
        let gained = back * (b.velocity - a.velocity - gravity * t);
        let shifted = back * (b.position - a.position - a.velocity * t - gravity * (0.5 * t * t));
        let mut residual = SVector::<f64, 9>::zeros();
        residual.fixed_rows_mut::<3>(0).copy_from(&turn);
        residual
            .fixed_rows_mut::<3>(3)
            .copy_from(&(gained - moved.velocity));
        residual
            .fixed_rows_mut::<3>(6)
            .copy_from(&(shifted - moved.displacement));

        let bent = so3::right_jacobian_inverse(&turn);
        let mut own = SMatrix::<f64, 9, STATE>::zeros();
        let mut next = SMatrix::<f64, 9, STATE>::zeros();
        let mut put = |row: usize, column: usize, block: Matrix3<f64>| {
            own.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        put(0, 0, -bent * rotated.transpose());
        put(3, 0, gained.cross_matrix());
        put(6, 0, shifted.cross_matrix());
        put(3, VELOCITY, -back);
        put(6, VELOCITY, -back * t);
        put(6, 3, -back);
        let mut put = |row: usize, column: usize, block: Matrix3<f64>| {
            next.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        put(0, 0, bent);
        put(3, VELOCITY, back);
        put(6, 3, back);

        // Jacobian of the logarithm for a small rotation on the right of the preintegrated
        // rotation.
        let through = -bent * so3::exp(&turn).transpose();
        let mut by_sensor = -moved.by_sensor;
        let of_turn = moved.by_sensor.fixed_rows::<3>(0).into_owned();
        by_sensor
            .fixed_rows_mut::<3>(0)
            .copy_from(&(through * of_turn));
        own.fixed_columns_mut::<6>(BIAS)
            .copy_from(&by_sensor.fixed_columns::<6>(0));
        let mut by_shared = SMatrix::<f64, 9, SHARED>::zeros();
        by_shared
            .fixed_columns_mut::<{ SENSOR - GYRO_SHAPE }>(SHAPES)
            .copy_from(&by_sensor.fixed_columns::<{ SENSOR - GYRO_SHAPE }>(GYRO_SHAPE));
        const { assert!(ACCEL_SHAPE == GYRO_SHAPE + 9) };
        let by_time = [0, 1].map(|end: usize| {
            let sign = [-1.0, 1.0][end];
            let mut by = -moved.by_time[end];
            let of_turn: Vector3<f64> = moved.by_time[end].fixed_rows::<3>(0).into();
            by.fixed_rows_mut::<3>(0).copy_from(&(through * of_turn));
            let mut v = by.fixed_rows_mut::<3>(3);
            v -= back * gravity * sign;
            let mut p = by.fixed_rows_mut::<3>(6);
            p -= back * (a.velocity + gravity * t) * sign;
            by
        });
        by_shared.set_column(OFFSET, &(by_time[0] + by_time[1]));
        let [from, to] = [i, i + 1].map(|k| self.views[k].time_s - self.middle_s);
        by_shared.set_column(DRIFT, &(by_time[0] * from + by_time[1] * to));
        let by_down = back * shared.gravity_tangent() * GRAVITY;
        by_shared
            .fixed_view_mut::<3, 2>(3, DOWN)
            .copy_from(&(by_down * -t));
        by_shared
            .fixed_view_mut::<3, 2>(6, DOWN)
            .copy_from(&(by_down * (-0.5 * t * t)));

        let covariance = moved.gyro_noise * self.factors.gyro.powi(2)
            + moved.accel_noise * self.factors.accel.powi(2);
        let plain = WhitenedFactor {
            residual,
            own,
            next: Some(next),
            shared: by_shared,
            weight: 1.0,
        };
        Some((plain, covariance))
    }

    fn walk(&self, i: usize, states: &[State]) -> WhitenedFactor<6> {
        let (a, b) = (&states[i], &states[i + 1]);
        let root = (self.views[i + 1].time_s - self.views[i].time_s).sqrt();
        let gyro = 1.0 / (self.noise.gyro_random_walk * self.factors.gyro_walk * root);
        let accel = 1.0 / (self.noise.accel_random_walk * self.factors.accel_walk * root);
        let mut residual = SVector::<f64, 6>::zeros();
        residual
            .fixed_rows_mut::<3>(0)
            .copy_from(&((b.gyro_bias - a.gyro_bias) * gyro));
        residual
            .fixed_rows_mut::<3>(3)
            .copy_from(&((b.accel_bias - a.accel_bias) * accel));
        let mut next = SMatrix::<f64, 6, STATE>::zeros();
        for k in 0..3 {
            next[(k, BIAS + k)] = gyro;
            next[(3 + k, BIAS + 3 + k)] = accel;
        }
        WhitenedFactor {
            residual,
            own: -next,
            next: Some(next),
            shared: SMatrix::zeros(),
            weight: 1.0,
        }
    }

    /// Prior of a state: its velocity, and the biases of the first.
    fn isolated(&self, i: usize, state: &State) -> WhitenedFactor<9> {
        let mut residual = SVector::<f64, 9>::zeros();
        let mut own = SMatrix::<f64, 9, STATE>::zeros();
        let [gyro, accel] = self.prior.biases;
        for k in 0..3 {
            residual[k] = state.velocity[k] / self.config.max_speed_m_s;
            own[(k, VELOCITY + k)] = 1.0 / self.config.max_speed_m_s;
            if i == 0 {
                residual[3 + k] = state.gyro_bias[k] / gyro;
                own[(3 + k, BIAS + k)] = 1.0 / gyro;
                residual[6 + k] = state.accel_bias[k] / accel;
                own[(6 + k, BIAS + 3 + k)] = 1.0 / accel;
            }
        }
        WhitenedFactor {
            residual,
            own,
            next: None,
            shared: SMatrix::zeros(),
            weight: 1.0,
        }
    }

    /// Normal equations and cost; `None` where IMU samples are missing.
    fn equations(
        &self,
        rooted: &[WhitenedView],
        states: &[State],
        shared: &Shared,
    ) -> Option<(Chain<STATE, SHARED>, f64)> {
        let n = states.len();
        let mut chain = Chain::new(n);
        let mut raw = Vec::new();
        let prior = self.prior.factor(shared, self.config.fixed_sigma);
        chain.shared += prior.shared.transpose() * prior.shared;
        chain.shared_gradient += prior.shared.transpose() * prior.residual;
        let mut cost = prior.residual.norm_squared();
        for i in 0..n {
            let mut view_factor = self.view_factor(&rooted[i], &states[i], shared);
            cost += view_factor.apply_loss(self.loss_threshold());
            view_factor.add(i, &mut chain);
            let alone = self.isolated(i, &states[i]);
            cost += alone.residual.norm_squared();
            alone.add(i, &mut chain);
            if i + 1 == n {
                break;
            }
            let walk = self.walk(i, states);
            cost += walk.residual.norm_squared();
            walk.add(i, &mut chain);
            if self.links[i] {
                let mut inertial = self.inertial(i, states, shared, &mut raw)?;
                cost += inertial.apply_loss(self.loss_threshold());
                inertial.add(i, &mut chain);
            }
        }
        cost.is_finite().then_some((chain, cost))
    }

    /// Fits from initial values. Error: the number of iterations without convergence.
    pub(super) fn fit(
        &self,
        mut states: Vec<State>,
        mut shared: Shared,
    ) -> Result<FitResult, usize> {
        let mut iterations = 0;
        let most_rounds = self.config.max_relinearizations[usize::from(self.robust)];
        for round in 0.. {
            // In the first round, and wherever the motion contradicts a view, linearize at the pose
            // that fits the view alone: far from it all corners would appear as outliers.
            let rooted: Option<Vec<WhitenedView>> = (0..states.len())
                .map(|i| {
                    let at = |pose: &Pose, size: f64| {
                        self.views[i].linearise(self.cameras, pose, size, self.corner_scale)
                    };
                    let own = || at(&self.poses[i], 1.0);
                    let quadric = match round {
                        0 => own(),
                        _ => Some(at(&shared.camera(&states[i]), shared.board_scale))
                            .filter(|q| {
                                let inliers = self.views[i].inlier_corners as f64;
                                q.corners as f64 >= self.config.min_inlier_corner_ratio * inliers
                            })
                            .unwrap_or_else(own),
                    };
                    WhitenedView::new(&quadric)
                })
                .collect();
            let rooted = rooted.ok_or(iterations)?;
            let promised = self.optimize(&rooted, &mut states, &mut shared, &mut iterations)?;
            if (round > 0 && promised < self.config.relinearization_gain) || round == most_rounds {
                return self.fitted(&rooted, states, shared, iterations);
            }
        }
        unreachable!("the loop has no other end")
    }

    /// Descends to the minimum; returns the predicted decrease of the first step.
    fn optimize(
        &self,
        rooted: &[WhitenedView],
        states: &mut Vec<State>,
        shared: &mut Shared,
        iterations: &mut usize,
    ) -> Result<f64, usize> {
        let config = self.config;
        let (mut chain, mut cost) = self.equations(rooted, states, shared).ok_or(*iterations)?;
        let mut damping = config.initial_damping;
        let mut first = None;
        for tries in 0.. {
            *iterations += 1;
            let stepped = chain.factor(damping).map(|factor| factor.step());
            let Some(step) = stepped else {
                damping *= 10.0;
                if damping > config.max_damping {
                    return self.stop(first, *iterations);
                }
                continue;
            };
            let promised = -(step.shared.dot(&chain.shared_gradient)
                + (step.own.iter().zip(&chain.own_gradient))
                    .map(|(s, g)| s.dot(g))
                    .sum::<f64>());
            first.get_or_insert(promised);
            // In units of a squared sigma.
            let enough = match tries < config.max_iterations {
                true => config.convergence_gain,
                false => config
                    .max_stalled_gain
                    .max(config.max_stalled_gain_ratio * cost),
            };
            if promised < enough {
                return Ok(first.unwrap_or(promised));
            }
            if tries > config.max_iterations {
                return self.stop(first, *iterations);
            }
            let tried: Vec<State> = (states.iter().zip(&step.own))
                .map(|(state, step)| state.moved(step))
                .collect();
            let tried_shared = shared.moved(&step.shared);
            match self.equations(rooted, &tried, &tried_shared) {
                Some((next, lower)) if lower <= cost => {
                    (*states, *shared, chain) = (tried, tried_shared, next);
                    let gained = cost - lower;
                    cost = lower;
                    // Steps that achieve their prediction may be longer.
                    damping *= match gained / promised {
                        fixed if fixed > 0.75 => 0.1,
                        fixed if fixed > 0.25 => 1.0,
                        _ => 4.0,
                    };
                    damping = damping.max(config.min_damping);
                    // With the robust loss the last steps are small.
                    if gained < config.min_gain[0] && gained < config.min_gain[1] * cost {
                        return Ok(first.unwrap_or(promised));
                    }
                }
                _ if damping > config.max_damping => return self.stop(first, *iterations),
                _ => damping *= 10.0,
            }
        }
        unreachable!("the loop has no other end")
    }

    /// Without the robust loss a fit need not converge because of outliers. It only gives initial
    /// values.
    fn stop(&self, first: Option<f64>, iterations: usize) -> Result<f64, usize> {
        match self.robust {
            true => Err(iterations),
            false => Ok(first.unwrap_or(0.0)),
        }
    }

    fn fitted(
        &self,
        rooted: &[WhitenedView],
        states: Vec<State>,
        shared: Shared,
        iterations: usize,
    ) -> Result<FitResult, usize> {
        let (chain, _) = self.equations(rooted, &states, &shared).ok_or(iterations)?;
        let covariance = chain.factor(0.0).ok_or(iterations)?.covariance();
        let mut sums = [ResidualSum::default(); 5];
        let mut locals = Vec::with_capacity(states.len());
        let mut raw = Vec::new();
        let sum_up = |sum: &mut ResidualSum, squares: f64, taken: &[f64], weight: f64| {
            sum.squares += squares * weight;
            sum.redundancy += weight * taken.len() as f64 - taken.iter().sum::<f64>();
        };
        for i in 0..states.len() {
            let mut local = IntervalResiduals::default();
            let mut view_factor = self.view_factor(&rooted[i], &states[i], &shared);
            view_factor.apply_loss(self.loss_threshold());
            let rank = rooted[i].rank;
            let taken = view_factor.leverage(i, &covariance);
            let squares = view_factor.residual.norm_squared();
            sum_up(&mut sums[0], squares, &taken[..rank], view_factor.weight);
            local.pose = squares / rank as f64;
            local.weight = view_factor.weight;
            if i + 1 < states.len() {
                let walk = self.walk(i, &states);
                let taken = walk.leverage(i, &covariance);
                for (s, part) in [(3, 0..3), (4, 3..6)] {
                    let squares = walk.residual.rows(part.start, 3).norm_squared();
                    sum_up(&mut sums[s], squares, &taken[part], 1.0);
                }
            }
            if i + 1 < states.len() && self.links[i] {
                let inertial = self.inertial(i, &states, &shared, &mut raw);
                let mut inertial = inertial.ok_or(iterations)?;
                inertial.apply_loss(self.loss_threshold());
                let taken = inertial.leverage(i, &covariance);
                let gyro = inertial.residual.rows(0, 3).norm_squared();
                let accel = inertial.residual.rows(3, 6).norm_squared();
                sum_up(&mut sums[1], gyro, &taken[..3], inertial.weight);
                sum_up(&mut sums[2], accel, &taken[3..], inertial.weight);
                local.gyro = Some(gyro / 3.0);
                local.accel = Some(accel / 6.0);
            }
            locals.push(local);
        }
        let median = |of: &dyn Fn(&IntervalResiduals) -> Option<f64>| {
            let mut values: Vec<f64> = locals.iter().filter_map(of).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(0.0)
        };
        let medians = [
            median(&|local| Some(local.pose)),
            median(&|local| local.gyro),
            median(&|local| local.accel),
        ];
        Ok(FitResult {
            medians,
            states,
            shared,
            covariance,
            sums,
            locals,
        })
    }
}

pub(super) mod spline;
#[cfg(test)]
mod tests;
